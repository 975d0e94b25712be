"""Time schemes: diagonally implicit Runge-Kutta tableaux, each stage a Rothe step.

With u = (rho, m, z), m the momentum functional, f = du/dt and a_ii > 0, a step of length tau is

    u_i* = u_0 + tau sum_{j<i} a_ij f_j,     U_i = rothe(u_i*, a_ii tau),     f_i = (U_i - u_i*)/(a_ii tau),
    u_1  = u_0 + tau sum_i b_i f_i.

Each u_i* and u_1 is an affine combination of the states y_0 = u_0, y_i = U_i, with weights that sum to one:

    u_i* = sum_{k<i} w_ik y_k,     u_1 = sum_k omega_k y_k,     w_i, omega = e_0 + sum_j (a_ij, b_j)/a_jj
    (e_j - w_j).

A Rothe step from u_i* to U_i satisfies E'(U_i)[U_i - u_i*] = -a_ii tau (D_i - P_i) exactly, with the
dissipations D and the powers P.  The sum with weights b_i/a_ii, written with the Bregman distances B(a, b) =
E(a) - E(b) - E'(b)[a - b], is

    E_1 - E_0 + tau sum_i b_i (D_i - P_i) + R = 0,     R = sum_i sum_k c_ik B(y_k, U_i) - [B(u_1, U_s)].

R contains no difference of energies, which would cancel digits.  The last term of R is present if u_1 is not
U_s.  For the paper's scheme, a = b = 1, R is B(u_0, U) (Euler-ED-basic-energy-balance-disc, with the
inequality's remainder).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ngvisco.errors import ParameterError, as_number, as_numbers, require_collection, require_known

_ROUNDING = 1e-12


@dataclass(frozen=True)
class TimeScheme:
    """A diagonally implicit Runge-Kutta scheme.

    Raises ParameterError for a wrong type, for a matrix that is not lower triangular with a positive
    diagonal, and for weights whose sum is not 1.

    Parameters
    ----------
    name : str
        Name of the scheme in lists and files.
    A : tuple of rows, (s, s)
        Lower triangular matrix with a positive diagonal.
    b : tuple, (s,)
        Weights of the stages, with the sum 1.
    """

    name: str
    A: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ParameterError("TimeScheme.name", self.name, "a text")
        b = tuple(as_numbers("TimeScheme.b", self.b))
        rows = require_collection("TimeScheme.A", self.A, "a sequence of rows, each a sequence of numbers")
        A, s = tuple(tuple(as_numbers("TimeScheme.A", row)) for row in rows), len(b)
        is_square = s > 0 and [len(row) for row in A] == s * [s]
        if not is_square or np.triu(A, 1).any() or min(np.diag(A)) <= 0:
            expected = (
                "a lower triangular matrix with a positive diagonal, and with one row for each weight of b"
            )
            raise ParameterError("TimeScheme.A", self.A, expected)
        # tuples of floats, unlike arrays, can be compared with the tuples of a checkpoint
        object.__setattr__(self, "A", A)
        object.__setattr__(self, "b", b)
        if not math.isclose(sum(self.b), 1.0, rel_tol=_ROUNDING):
            raise ParameterError("TimeScheme.b", self.b, "weights whose sum is 1")

    @property
    def stages(self) -> int:
        """Number s of stages, each of which is one Rothe step."""
        return len(self.b)

    @cached_property
    def c(self) -> tuple[float, ...]:
        """Times of the stages from the start of the step, in units of the step."""
        return tuple(float(sum(row)) for row in self.A)

    @cached_property
    def tilts(self) -> tuple[float, ...]:
        """Tilts c_i - sum_j b_j c_j, by which a stage weights later loads more than earlier ones.

        A stage's load is int_0^1 (1 + 12 tilt_i (s - 1/2)) g(s) ds over the step, s from 0 to 1.  For any g
        the sum of the stages' loads with the weights b is the mean of g.  If the scheme is of order 2 and g
        is linear in time, the stage's load is g(c_i).
        """
        centre = sum(weight * c for weight, c in zip(self.b, self.c, strict=True))
        return tuple(c - centre for c in self.c)

    @cached_property
    def starts(self) -> np.ndarray:
        """Weights w_ik of y_0 ... y_s in each stage's start value u_i*, (stages, stages + 1)."""
        rows: list[np.ndarray] = []
        for i in range(self.stages):
            rows.append(self._affine(self.A[i][:i], rows))
        return np.array(rows)

    @cached_property
    def end(self) -> np.ndarray:
        """Weights omega_k of y_0 ... y_s in u_1, (stages + 1,)."""
        return self._affine(self.b, list(self.starts))

    def _affine(self, weights: Sequence[float], starts: Sequence[np.ndarray]) -> np.ndarray:
        """Affine weights e_0 + sum_j weights_j/a_jj (e_j - w_j), (stages + 1,)."""
        unit = np.eye(self.stages + 1)
        total = unit[0].copy()
        for j, weight in enumerate(weights):
            total += weight / self.A[j][j] * (unit[j + 1] - starts[j])
        return total

    @cached_property
    def ends_at_last_stage(self) -> bool:
        """Whether u_1 is U_s (stiffly accurate); the solver then ensures that u_1 is admissible."""
        return bool(np.allclose(self.end, np.eye(self.stages + 1)[-1], rtol=0, atol=_ROUNDING))

    @cached_property
    def distances(self) -> np.ndarray:
        """Weights c_ik of B(y_k, U_i) in R, (stages, stages + 1)."""
        result = np.array([b / self.A[i][i] for i, b in enumerate(self.b)])[:, None] * self.starts
        if not self.ends_at_last_stage:
            result[-1] += self.end
        for i in range(self.stages):
            result[i, i + 1] = 0.0  # B(U_i, U_i) = 0
        return result

    def moment(self, k: int) -> float:
        """Coefficient b . A^(k-1) 1 of z^k in the stability function; 1/k! is exact."""
        vector = np.ones(self.stages)
        for _ in range(k - 1):
            vector = np.array(self.A) @ vector
        return float(np.array(self.b) @ vector)

    @cached_property
    def order(self) -> int:
        """Order in time, 1, 2 or 3, by the order conditions on the tableau."""
        if abs(self.moment(2) - 1 / 2) > _ROUNDING:
            return 1
        squares = float(np.array(self.b) @ np.array(self.c) ** 2)
        return 3 if abs(self.moment(3) - 1 / 6) <= _ROUNDING >= abs(squares - 1 / 3) else 2

    @cached_property
    def error_constant(self) -> float:
        """Constant C of the local error C tau^(p+1) u^(p+1) for u' = lambda u and order p."""
        p = self.order
        return self.moment(p + 1) - 1 / math.factorial(p + 1)

    def __str__(self) -> str:
        return self.name


def backward_euler() -> TimeScheme:
    """The paper's scheme (Euler-small-viscoelastodyn+disc): order 1, L-stable; dissipates at every step."""
    return TimeScheme("backward-euler", ((1.0,),), (1.0,))


def midpoint() -> TimeScheme:
    """The implicit midpoint rule: order 2, one solve a step, R = O(tau^3) of either sign, no damping."""
    return TimeScheme("midpoint", ((0.5,),), (1.0,))


def theta_scheme(theta: float) -> TimeScheme:
    """The one-leg scheme U = rothe(u_0, theta tau), u_1 = u_0 + (U - u_0)/theta.

    Raises ParameterError unless 1/2 <= theta <= 1. The scheme is unstable for theta < 1/2, and its stage
    would lie after the step for theta > 1.
    """
    if not (as_number(theta) is not None and 0.5 <= theta <= 1.0):
        raise ParameterError("theta", theta, "a number in [1/2, 1] (1/2 is midpoint, 1 is backward-euler)")
    return TimeScheme("theta", ((float(theta),),), (1.0,))


def sdirk2() -> TimeScheme:
    """Alexander's two-stage scheme, gamma = 1 - 1/sqrt(2): order 2, L-stable, stiffly accurate."""
    gamma = 1 - 1 / math.sqrt(2)
    return TimeScheme("sdirk2", ((gamma, 0.0), (1 - gamma, gamma)), (1 - gamma, gamma))


SCHEMES: dict[str, Callable[..., TimeScheme]] = {
    "backward-euler": backward_euler,
    "midpoint": midpoint,
    "theta": theta_scheme,
    "sdirk2": sdirk2,
}
"""Makers of the schemes by their names in ``Simulation(scheme=...)`` and ``[time] scheme``; the maker of
``theta`` has a parameter."""


def scheme_of(scheme: str | TimeScheme, theta: float | None = None) -> TimeScheme:
    """The scheme with a given name; the name ``"theta"`` requires the parameter ``theta``.

    Raises UnknownNameError for an unknown name; ParameterError if theta is outside [1/2, 1], missing, or
    given for a scheme without this parameter.
    """
    if not isinstance(scheme, str | TimeScheme):
        raise ParameterError("scheme", scheme, f"one of {', '.join(SCHEMES)}, or a TimeScheme")
    require_known("time scheme", [scheme] if isinstance(scheme, str) else [], SCHEMES)
    if scheme == "theta":
        if theta is None:
            raise ParameterError("theta", theta, "a number in [1/2, 1] for the scheme 'theta'")
        return theta_scheme(theta)
    if theta is not None:
        expected = f"no theta with the scheme {str(scheme)!r}; only the scheme 'theta' has this parameter"
        raise ParameterError("theta", theta, expected)
    return SCHEMES[scheme]() if isinstance(scheme, str) else scheme
