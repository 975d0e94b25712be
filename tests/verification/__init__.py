"""Verification: measurements of the paper's claims and of exact solutions, in a reproducible report.

``python -m tests.verification -o report/`` runs all cases.  A case states its bounds before it runs
(``case.Case``); ``runner`` runs it and ``report`` writes its results.  Each module of ``verification.cases``
has the cases of one theme. Cases and tests share ``manufactured``, ``convergence`` and ``setups``.

Cases run on one thread. Further threads of NGSolve would wait actively, so that a case beside other work
would take ten times as long, and the waiting would count as processor time.
"""

import os

for _name in ("NGS_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NGVISCO_THREADS"):
    os.environ.setdefault(_name, "1")  # read when NGSolve is loaded
