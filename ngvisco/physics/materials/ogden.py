"""Ogden's rubber elasticity: powers of the principal stretches, with any exponents.

The singular values sigma_i of a tensor A give sum sigma_i^alpha = tr C^s, C = A^T A, s = alpha/2.  tr C^s is
a smooth function of the invariants of C; formulas for eigenvalues are not smooth where two of them are equal,
as at rest.  For s = k + r with 0 < r < 1

    x^r = c_0 + c_1 x + sum_j w_j x/(t_j + x),    t_j = exp(j h),

is a quadrature of Stieltjes' integral for x^r, which makes tr C^s a sum of rational functions of the
invariants.  The weights come from least squares over stretches from 1/10 to 10, with exact value and two
exact derivatives at rest; 13 terms have a relative error of 1e-6.  The symbolic derivatives for one such
exponent take 8 times as long as those of Oldroyd's energy (0.2 ms and 0.03 ms a point). Even exponents are
exact and cheap.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, reduce
from operator import add
from typing import Annotated, Self

import numpy as np

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.material import ElasticState
from ngvisco.physics.materials.hyperelastic import ContinuedInJ, referential_volume
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import Tensor, cof, det, linear_map, square, tr
from ngvisco.physics.variables import (
    Cofactor,
    CofactorLeftCauchyGreen,
    Distortion,
    Jacobian,
    LeftCauchyGreen,
    Values,
    Variable,
)

_WIDTH, _TERMS, _RANGE = 1.15, 6, 4.7
"""The spacing h, the largest j, and the largest |ln x| of the fit."""
_EXACT = 1e6
"""Least-squares weight of the conditions at rest."""
_NODES = np.exp(_WIDTH * np.arange(-_TERMS, _TERMS + 1))


@cache
def _weights(r: float) -> np.ndarray:
    """The coefficients (c_0, c_1, w_j) of x^r."""
    x = np.exp(np.linspace(-_RANGE, _RANGE, 40 * len(_NODES)))[:, None]
    parts = np.hstack([np.ones_like(x), x, x / (x + _NODES)]) / x**r
    t = _NODES
    at_rest = [[1.0, 1.0, *1 / (1 + t)], [0.0, 1.0, *t / (1 + t) ** 2], [0.0, 0.0, *-2 * t / (1 + t) ** 3]]
    exact = np.array([1.0, r, r * (r - 1)])
    rows = np.vstack([parts, _EXACT * np.array(at_rest)])
    return np.linalg.lstsq(rows, np.concatenate([np.ones(len(x)), _EXACT * exact]), rcond=None)[0]


def _vector(factors: np.ndarray, value: Tensor) -> Tensor:
    """The product of the vector ``factors`` and a scalar."""
    return linear_map(np.asarray(factors)[:, None], value, (len(factors),))


def powers_of_stretches(invariants: tuple[Tensor, Tensor, Tensor], weights: Mapping[float, float]) -> Tensor:
    """sum_s a_s tr C^s for ``weights`` a_s by s > 0, from I_1 = tr C, I_2 = tr Cof C and I_3 = det C."""
    first, second, third = invariants
    sums = [3.0, first, first * first - 2 * second]  # tr C^k
    while len(sums) < max(weights) + 3:
        sums.append(first * sums[-1] - second * sums[-2] + third * sums[-3])
    parts, tops = [], []
    for s, factor in weights.items():
        k = math.floor(s)
        if s == k:
            parts.append(factor * sums[k])
            continue
        constant_part, linear_part, *of_nodes = factor * _weights(s - k)
        parts.append(float(linear_part) * sums[k + 1] + float(constant_part) * sums[k])
        # tr C^{k+1} (t + C)^{-1}, times det(t + C), by the theorem of Cayley and Hamilton
        mixed = (sums[k + 1], first * sums[k + 1] - sums[k + 2], third * sums[k])
        powers = (_NODES**2, _NODES, np.ones_like(_NODES))
        tops += [
            _vector(of_nodes * power, coefficient) for power, coefficient in zip(powers, mixed, strict=True)
        ]
    if tops:
        top = reduce(add, tops)
        below = _vector(_NODES**2, first) + _vector(_NODES, second) + _vector(np.ones_like(_NODES), third)
        parts += [top[j] / (float(t**3) + below[j]) for j, t in enumerate(_NODES)]
    return reduce(add, parts)


@dataclass(frozen=True, kw_only=True)
class Ogden(ContinuedInJ):
    """phi = K_e/2 (J - 2 + 1/J) + sum_p mu_p/alpha_p (sum_i lambda_i^alpha_p - 3) (Ogden 1972).

    lambda_i are the principal stretches of F_iso = J^{-1/3} F, the singular values of H = F_iso. For
    alpha_p < 0, lambda_i^alpha_p is a singular value of N = J^{-2/3} Cof F to the power -alpha_p.  If
    mu_p alpha_p > 0, phi is jointly convex in (H, N, J) for |alpha_p| >= 1. In terms of B and its cofactor it
    is convex for |alpha_p| >= 2 (Ball 1977).  The shear modulus at rest is sum mu_p alpha_p/2.  In uniaxial
    stretch lambda at constant volume T_11 - T_22 = sum mu_p (lambda^alpha_p - lambda^{-alpha_p/2}).  T(I) =
    0.

    Powers with exponents other than even integers have an error of 1e-6 for stretches from 1/10 to 10. Raises
    ParameterError for no moduli, unequal numbers of moduli and exponents, equal exponents, or no convexity.

    Example::

        import ngvisco as nv

        treloar = nv.Ogden(K_e=2e9, mu=(0.63e6, 0.0012e6, -0.01e6), alpha=(1.3, 5.0, -2.0))
        print([v.name for v in treloar.variables])

    Parameters
    ----------
    elastic_state : str, optional
        Variables by the distortion "F", or by "B" = F F^T.  The default is "B" if there is creep or m = 0,
        and if all |alpha_p| >= 2; else it is "F".
    K_e : float
        Bulk modulus.  The value 0 is for branches of a network only.
    mu : tuple of float
        Moduli mu_p, with the signs of alpha_p.
    alpha : tuple of float
        Exponents alpha_p.
    J_min : float, optional
        J below which the part singular at J = 0 is continued linearly.
    """

    elastic_state: Annotated[ElasticState | None, Quantity(example="F")] = None
    K_e: Annotated[Modulus, Quantity("Pa", ">= 0", 10.0)]
    mu: Annotated[tuple[float, ...], Quantity("Pa", example=[5.0, -0.5])]
    alpha: Annotated[tuple[float, ...], Quantity("1", example=[2.5, -2.0])]
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("mu", "alpha"):
            if not (values := getattr(self, name)):
                raise ParameterError(f"Ogden.{name}", values, "at least one number")
        if len(set(self.alpha)) < len(self.alpha):
            raise ParameterError("Ogden.alpha", self.alpha, "distinct exponents")
        if len(self.mu) != len(self.alpha):
            if len(self.alpha) > len(self.mu):
                expected = f"as many exponents as moduli, {len(self.mu)}"
                raise ParameterError("Ogden.alpha", self.alpha, expected)
            raise ParameterError("Ogden.mu", self.mu, f"as many moduli as exponents, {len(self.alpha)}")
        least = 2.0 if self.elastic_state == "B" else 1.0
        if not all(least <= abs(alpha) <= 12 for alpha in self.alpha):
            form = ' in B; with elastic_state = "F" 1 <= |alpha| suffices' if least == 2 else ""
            expected = f"{least:g} <= |alpha| <= 12, so that the energy is convex{form}"
            raise ParameterError("Ogden.alpha", self.alpha, expected)
        if not all(0 < mu * alpha < math.inf for mu, alpha in zip(self.mu, self.alpha, strict=True)):
            raise ParameterError("Ogden.mu", self.mu, "finite moduli, each with the sign of its exponent")

    def with_elastic_state(self, state: ElasticState) -> Self:
        if self.elastic_state is not None:
            return self
        return replace(self, elastic_state=state if min(map(abs, self.alpha)) >= 2 else "F")

    @property
    def variables(self) -> tuple[Variable, ...]:
        tensors: tuple[Variable, ...] = (Distortion("H", exponent=-1 / 3), Cofactor("N", exponent=-2 / 3))
        if self.elastic_state == "B":
            tensors = (LeftCauchyGreen(exponent=-2 / 3), CofactorLeftCauchyGreen(exponent=-4 / 3))
        used = (max(self.alpha) > 0, min(self.alpha) < 0)
        return (*(v for v, is_used in zip(tensors, used, strict=True) if is_used), Jacobian())

    def energy(self, z: Values) -> Tensor:
        phi = referential_volume(self.K_e, 0.0, 1.0, z["J"], self.J_min)
        for variable, sign in zip(self.variables, self._signs, strict=False):
            A = z[variable.name]
            both = zip(self.mu, self.alpha, strict=True)
            weights = {abs(alpha) / 2: mu / alpha for mu, alpha in both if alpha * sign > 0}
            measure, J = (tr, det(A)) if self.elastic_state == "B" else (square, det(A) * det(A))
            powers = powers_of_stretches((measure(A), measure(cof(A)), J), weights)
            phi = phi + powers - 3 * sum(weights.values())
        return phi

    @property
    def _signs(self) -> list[int]:
        """For each tensor variable, the sign of the exponents that belong to it."""
        return [sign for sign in (1, -1) if any(alpha * sign > 0 for alpha in self.alpha)]
