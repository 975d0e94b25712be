"""The cases, one module a theme, in the report's order."""

from ngvisco.verification.cases import estimates, stability

MODULES = (stability, estimates)
