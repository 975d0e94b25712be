"""The derivative of the hyperviscosity's rows in a direction of (v, a), for the flow's linear system."""

from __future__ import annotations

import numpy as np

from ngvisco.forms.side_points import SidePoints
from ngvisco.solver.split.hyper import MatrixHyperviscosity, SideJumps


class HyperDerivative:
    """The derivative at the state of the last ``update``.

    For k = 2 on straight cells the penalty has as many points on a side as P_1 has functions.
    (Means over the sides in place of that rule left an eigenvalue of 0.38 of the preconditioned error on
    762 triangles, this rule next to none.  For k = 3 the like rule leaves one of 0.5, and steps on curved
    cells failed: there the rule is that of the forms.)
    """

    def __init__(self, hyper: MatrixHyperviscosity) -> None:
        step = hyper.step
        self.h = hyper
        coarse = step.discretisation.k == 2 and step.mesh.GetCurveOrder() <= 1
        self.sides = SideJumps(hyper, SidePoints(step.mesh, 2)) if coarse else hyper.sides

    def update(self) -> None:
        """Linearise at the present state."""
        h, law, sides = self.h, self.h.law, self.sides
        if law.is_linear:
            self._weight = sides.penalty * (law.mu + law.mu_1)
            return
        self._at = h.h_values(h.hess)
        self._c, self._slope = h.s_values(h.c), law.slope(h.s_values(h.s))
        self._j = sides.jump(np.concatenate([h.v, h.a], axis=1))
        q, size = self._sizes()
        slope = law.slope(size)
        bend = 0.5 * (law.p - 4) * slope / size * q  # c'' |j|^2
        squared = sides.h**2
        self._weight = sides.penalty * (law.coefficient(size) + slope * q / squared)
        self._weight_s = sides.penalty * (slope + bend / squared)
        self._weight_q = sides.penalty * (2 * slope + bend / squared) / squared
        self._own_s, self._own_q = sides.penalty * bend, sides.penalty * (slope + bend / squared)

    def _sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """|j|^2 and s + |j|^2/h^2 + chi^2 at the sides' points."""
        h, sides = self.h, self.sides
        q = np.einsum("ip,ip->p", self._j, self._j)
        return q, sides.scalar(h.s) + q / sides.h**2 + h.term.context.curvature.Get() ** 2

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The rows' derivative in the direction x = (v, a) side by side, (dim, unknowns)."""
        h, law, sides = self.h, self.h.law, self.sides
        at, dj = h.h_values(h.lifted(x)), sides.jump(x)
        if law.is_linear:
            stress = (law.mu + law.mu_1) * at
            return h.tested(h.h_values.test(stress)) + sides.jump.test(self._weight * dj)
        stress, load = self._c * at, self._weight * dj
        ds_coefficients = h.s_inverse(h.s_values.test(2 * np.einsum("bp,bp->p", self._at, at)))
        ds = sides.scalar(ds_coefficients)
        dq = 2 * np.einsum("ip,ip->p", self._j, dj)
        load += (self._weight_s * ds + self._weight_q * dq) * self._j
        dc = h.s_values.test(self._slope * h.s_values(ds_coefficients))
        dc += sides.scalar.test(self._own_s * ds + self._own_q * dq)
        stress += self._at * h.s_values(h.s_inverse(dc))
        return h.tested(h.h_values.test(stress)) + sides.jump.test(load)

    def tangent_coefficients(self) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of |Hs|^2, (cells,), and of the penalty, (sides' points,), for ``HyperTangent``."""
        h, law, sides = self.h, self.h.law, self.sides
        if law.is_linear:
            return np.full(h.step.mesh.ne, law.mu + law.mu_1), sides.penalty * (law.mu + law.mu_1)
        weights = h.points.weights.reshape(h.step.mesh.ne, -1)
        c = (h.s_values(h.c).reshape(weights.shape) * weights).sum(axis=1) / weights.sum(axis=1)
        c_penalty = law.coefficient(np.maximum(self._sizes()[1], 0))
        stretch = 0.5 * law.p
        c, c_penalty = (law.mu_1 + stretch * (np.maximum(each, 0) - law.mu_1) for each in (c, c_penalty))
        return c, sides.penalty * c_penalty
