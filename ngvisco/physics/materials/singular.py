"""Convex functions s(J) that blow up as J -> 0+, and their linear continuation below J_min.

The continuation is the paper's rem-neo-Hookean-ref: for energies f(F, H, J) + s(J) only the singular
part is changed, s(J_min) + s'(J_min)(J - J_min) for J < J_min, which keeps it convex and C1 and is
inactive as long as J >= J_min.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

from ngsolve import CoefficientFunction

from ngvisco.physics.tensors import if_positive, log

Scalar: TypeAlias = CoefficientFunction


def continued(
    s: Callable[[Scalar], Scalar], slope: Callable[[Scalar], Scalar], J: Scalar, J_min: float | None
) -> Scalar:
    """s(J), linear below ``J_min`` (None: nowhere); ``slope`` is s'.

    With J_+ = max(J, J_min) this is s(J_+) + s'(J_+)(J - J_+): the singular function is never evaluated
    below J_min, not even in the branch that is thrown away.
    """
    if J_min is None:
        return s(J)
    above = if_positive(J - J_min, J, J_min)
    return s(above) + slope(above) * (J - above)


def continued_in_J(J_min: float | None, is_total: bool = True) -> frozenset[str]:
    """``Material.continued`` of a material with ``J_min``; ``is_total`` if no other term ends at J = 0."""
    return frozenset({"J"}) if J_min is not None and is_total else frozenset()


def minus_log(epsilon: Any, J: Scalar, J_min: float | None) -> Scalar:
    """-epsilon ln J (paper: neo-Hookean-potential-actual)."""
    return continued(lambda a: -epsilon * log(a), lambda a: -epsilon / a, J, J_min)


def inverse_power(epsilon: Any, kappa: float, J: Scalar, J_min: float | None) -> Scalar:
    """epsilon / J^kappa, convex for kappa >= 0 (paper: exa-polyconvex-general)."""
    return continued(lambda a: epsilon * a**-kappa, lambda a: -epsilon * kappa * a ** (-kappa - 1), J, J_min)
