"""Verification: the paper's claims and exact solutions, measured, in one report that anyone can rebuild.

``python -m tests.verification -o report/`` runs all cases.  Each states its bounds before it runs
(``case.Case``), is run by ``runner`` and written by ``report``; the cases stand in ``verification.cases``,
one module a theme, and ``manufactured``, ``convergence``, ``setups`` are what they and the tests share.
"""
