"""Verification: the paper's claims and exact solutions, measured, in one report that anyone can rebuild.

``python -m tests.verification -o report/`` runs all cases.  Each states its bounds before it runs
(``case.Case``), is run by ``runner`` and written by ``report``; the cases stand in ``verification.cases``,
one module a theme, and ``manufactured``, ``convergence``, ``setups`` are what they and the tests share.

Cases run on one thread: NGSolve's further ones wait actively, which costs ten times the time beside other
work, and processor time counts the wait.
"""

import os

for _name in ("NGS_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NGVISCO_THREADS"):
    os.environ.setdefault(_name, "1")  # read when NGSolve is loaded
