"""The nonlinear equation of local creep at a point, solved exactly after each increment of Newton's method.

An increment of z changes the Mandel stress M to a value from which a steep rule, by its tangent, relaxes to
a stress far off its graph: with |M|^10 the rate is a thousand times too large where the stress is twice what
it should be, and Newton's method comes back by a tenth in an iteration.  At fixed gradients of v all that
creep does within the step is to take kappa Pi from the stress, kappa = tau (dM/dz)(drate/dPi).  So what the
increment means is not M and the tangent's Pi, but their sum

    M + kappa rate(M) = M_lin + kappa Pi_lin,    Pi_lin = Pi + rate'(M) (M_lin - M_before),

whose solution is unique for a monotone rate: Newton's method for y = z + tau creep(z) instead of z, in which
the equations are nearly linear.  z gets what Pi differs from Pi_lin by.  Where the rate is linear nothing
changes; near the solution the difference is quadratic in the increment.

Yield at next to no viscosity, |M| <= s in the limit, has so steep a rate that Newton's method in a cell, some
points of which yield, goes to and fro between them.  There the rate is softened: rate_c(X) = rate(M) with
M + c rate(M) = X (Yosida) has a slope below 1/c, whatever the rule, and c falls to zero from solution to
solution.
"""

from __future__ import annotations

import numpy as np

from ngvisco.algebra.blocks import BlockInverse
from ngvisco.algebra.sparse import mass_matrix
from ngvisco.physics.arrays import Array
from ngvisco.physics.flows import Flow
from ngvisco.physics.increments import TINY
from ngvisco.reduced.evaluation import with_values
from ngvisco.solver.split.flow_operator import PointTangent

_BISECTIONS, _ITERATIONS = 25, 20
_SOFTENED = (*10.0 ** -np.arange(10.0), 0.0)
"""c of softened rates one after the other, in units of kappa, in cells that were not solved without."""
_STRESSES, _SETTLED = 3, 1e-2
"""Stresses of corrected z, which the tangent's stiffness knows to first order, and the correction that is
small beside an increment."""
_NEAR, _EXACT, _ROUNDING = 1e-2, 1e-8, 1e-15
"""Relative defects at which iterations end: at single points, where the cells' begin, and of these, whose
rest is for Newton's method of the step; and increments of softened stresses."""
_NOISE = 10 * _EXACT
"""Share of what creep does within the step below which an increment is not corrected: that would leave what
the cells' equations are not solved by."""


class LocalCreep:
    """Corrections of z's increments at the points of a tangent."""

    def __init__(self, tangent: PointTangent, flow: Flow) -> None:
        self.tangent, self.flow, self.rates = tangent, flow, tangent.residual.rates
        self.space = self.rates.creep_space
        first = self.rates.tensors.gradients + self.space.size * self.rates.flows.index(flow)
        self.own = slice(first, first + self.space.size)
        """The flow's Pi among what rates are linear in."""
        self.shapes = np.asarray(tangent.op.z.blocks)
        """Values of the cells' functions, (cells, points of a cell, functions)."""
        self._project = BlockInverse.of(mass_matrix(tangent.op.z.matrix, tangent.op.weights))

    def __call__(self, dz: np.ndarray) -> np.ndarray:
        """What is to be added to increments of z from the tangent's state; both coefficients (n, .)."""
        t = self.tangent
        columns, force = t.columns[:, :, self.own], t.force[:, self.own]
        self._read = self.rates.read_values(self.flow.rule, t.values, self.flow)
        M = self.space.components(self.rates.mandel(t.values, self.flow)).value.T
        change, added = t.op.z(dz), np.zeros_like(dz)
        z = t.z + change
        stress = self._stress(z)
        rate, slope = self._along(M, stress.T - M)
        new = self._rate(stress.T).T
        found, missed = self._taken(columns, new), self._taken(columns, new - rate - slope)
        small = max(_SETTLED * abs(dz).max(initial=0.0), _NOISE * abs(found).max(initial=0.0))
        on = self._cells_above(missed, small)
        if not len(on):  # the rule is straight within the increment
            return added
        kappa = t.tau * force @ columns
        held = self._projected(rate + self._along(M, -np.einsum("pjm,mp->pj", force, change))[1])
        by_cells, solved = kappa.reshape(*self.shapes.shape[:2], *kappa.shape[1:])[on], None
        for _ in range(_STRESSES):
            Y, Pi = stress + np.einsum("pij,jp->ip", kappa, held), held.copy()
            solved = self._solved(by_cells, self._by_cells(Y)[:, on].transpose(1, 2, 0), on, solved)
            self._by_cells(Pi)[:, on] = solved.transpose(2, 0, 1)
            Pi = self._projected(Pi)
            extra = self._taken(columns, Pi - held)
            if not np.isfinite(extra).all():
                return np.zeros_like(dz)
            added, z, held = added + extra, z + t.op.z(extra), Pi
            if abs(extra).max() <= small:
                break
            stress = self._stress(z)
        return added

    def _taken(self, columns: np.ndarray, change: np.ndarray) -> np.ndarray:
        """What z takes within the step from a change of the rate, (p, points); coefficients."""
        return self.tangent.tau * self._coefficients(np.einsum("pni,ip->np", columns, change))

    def _by_cells(self, values: np.ndarray) -> np.ndarray:
        """A view of values (..., points) by (..., cells, points of a cell)."""
        return values.reshape(*values.shape[:-1], *self.shapes.shape[:2])

    def _cells_above(self, coefficients: np.ndarray, size: float) -> np.ndarray:
        """Cells of which some coefficient is above ``size``."""
        by_cells = coefficients.reshape(len(coefficients), *self.shapes.shape[::2])
        return np.flatnonzero(abs(by_cells).max(axis=(0, 2)) > size)

    def _coefficients(self, values: np.ndarray) -> np.ndarray:
        """Of the projection of values at the points."""
        return self._project(self.tangent.op.z.test(values))

    def _projected(self, values: np.ndarray) -> np.ndarray:
        return self.tangent.op.z(self._coefficients(values))

    def _stress(self, z: np.ndarray) -> np.ndarray:
        """Mandel stress of the projected conjugates of z, (p, points)."""
        t = self.tangent
        zeta = self._projected(t.slope(z))
        u = with_values(t.values, z=z, zeta=zeta)
        return self.space.components(self.rates.mandel(u, self.flow)).value

    def _rate(self, M: np.ndarray, cells: np.ndarray | None = None) -> np.ndarray:
        """The rate, (points, ..., p), at stresses (points, ..., p) of some cells' points or of all."""
        stress, count = M.reshape(-1, M.shape[-1]).T, M[0, ..., 0].size
        z = {name: self._of_cells(value, cells, count) for name, value in self._read.items()}
        tensor = (1 / self.flow.share(z)) * self.space.tensor(Array(stress, None))
        Pi = self.flow.rule.rate(tensor, None, z)
        return np.broadcast_to(self.space.components(Pi).value, stress.shape).T.reshape(M.shape)

    def _of_cells(self, value: Array, cells: np.ndarray | None, count: int) -> Array:
        """Values at the points of some cells or of all, each as often as asked for."""
        found = value.value
        if found.shape[-1] == 1:
            return value
        if cells is not None:
            found = self._by_cells(found)[..., cells, :].reshape(*found.shape[:-1], -1)
        return Array(np.repeat(found, count, axis=-1) if count > 1 else found, None)

    def _softened(self, X: np.ndarray, c: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """M along X with M + c rate(M) = X, c one a cell: Newton's method within a bracket."""
        if not c.any():
            return X
        c, size = np.repeat(c, self.shapes.shape[1]), np.linalg.norm(X, axis=1)
        along = X / np.where(size > 0, size, 1.0)[:, None]
        low, high, s = np.zeros_like(size), size.copy(), size
        for _ in range(2 * _BISECTIONS):
            value = (self._rate((s + 1j * TINY)[:, None] * along, cells) * along).sum(axis=1)
            defect = s + c * value.real - size
            low, high = np.where(defect < 0, s, low), np.where(defect < 0, high, s)
            newton = s - defect / (1 + c * value.imag / TINY)
            before, s = s, np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
            if (abs(s - before) <= _ROUNDING * size).all():
                break
        return s[:, None] * along

    def _along(self, M: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rate at stresses and its derivative along a change of them, both (p, points)."""
        found = self._rate(M + 1j * TINY * change).T
        return found.real, found.imag / TINY

    def _slope(self, M: np.ndarray, cells: np.ndarray | None = None) -> np.ndarray:
        """The rate's derivative by the stress, (points, p, p)."""
        units = 1j * TINY * np.eye(M.shape[1])
        return self._rate(M[:, None] + units, cells).imag.swapaxes(1, 2) / TINY

    def _solved(
        self, kappa: np.ndarray, Y: np.ndarray, chosen: np.ndarray, start: np.ndarray | None
    ) -> np.ndarray:
        """rate(Y - kappa Pi_h) at the points of the ``chosen`` cells, (cells, points of one, p).

        Pi_h is its projection in every cell, of Newton's method for the cells' components, (cells, q, p),
        from rates ``start`` or those that solve the equation at the points.  Its length is held by the
        defect's power along kappa d, kappa the mean of the cell, which grows along an increment d by the
        rule's monotonicity and is zero with the defect.  Solved cells are left alone.
        """
        shapes, count, p = self.shapes[chosen], self.shapes.shape[1], Y.shape[2]
        weights = self.tangent.op.weights.reshape(-1, count)[chosen]
        weighted = shapes * weights[:, :, None]
        mass = np.einsum("cki,ckj->cij", weighted, shapes)
        mean = np.einsum("ck,ckij->cij", weights, kappa) / weights.sum(axis=1)[:, None, None]
        at_points = self._at_points(kappa, Y, chosen) if start is None else start
        x = np.linalg.solve(mass, np.einsum("cki,ckp->cip", weighted, at_points))

        def stress(x: np.ndarray, on: np.ndarray) -> np.ndarray:
            return (Y[on] - (kappa[on] @ (shapes[on] @ x)[..., None])[..., 0]).reshape(-1, p)

        def defect(x: np.ndarray, on: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            Pi = self._rate(self._softened(stress(x, on), c, chosen[on]), chosen[on])
            Pi, tests = Pi.reshape(len(on), count, p), weighted[on].swapaxes(1, 2)
            return mass[on] @ x - tests @ Pi, np.linalg.norm(abs(tests) @ abs(Pi), axis=(1, 2))

        def newton(on: np.ndarray, c: np.ndarray) -> np.ndarray:
            """Iterate in the cells ``on``; those that are left unsolved."""
            wrong, size = defect(x[on], on, c)
            for _ in range(_ITERATIONS):
                left = np.linalg.norm(wrong, axis=(1, 2)) > _EXACT * size
                on, wrong, c = on[left], wrong[left], c[left]
                if not len(on):
                    break
                slope = self._slope(self._softened(stress(x[on], on), c, chosen[on]), chosen[on])
                if c.any():  # of rate_c, by that of the rate
                    by_points = np.repeat(c, count)[:, None, None]
                    slope = np.linalg.solve(np.eye(p) + by_points * slope, slope)
                bent, w = np.eye(p) + slope.reshape(kappa[on].shape) @ kappa[on], weighted[on]
                matrix = np.einsum("cka,ckij,ckb->caibj", w, bent, shapes[on], optimize=True)
                n = shapes.shape[2] * p
                d = -np.linalg.solve(matrix.reshape(-1, n, n), wrong.reshape(-1, n, 1)).reshape(wrong.shape)
                along = np.einsum("cij,caj->cai", mean[on], d)
                enough = 0.5 * abs((along * wrong).sum(axis=(1, 2)))
                length, low, high = np.ones(len(on)), np.zeros(len(on)), np.ones(len(on))
                for _ in range(_BISECTIONS):
                    new = x[on] + length[:, None, None] * d
                    wrong, size = defect(new, on, c)
                    power = (along * wrong).sum(axis=(1, 2))
                    far, near = power > enough, (power < -enough) & (high < 1)
                    if not (far | near).any():
                        break
                    low, high = np.where(near, length, low), np.where(far, length, high)
                    length = np.where(far | near, 0.5 * (low + high), length)
                x[on] = new
            return on

        start, every = x.copy(), np.arange(len(chosen))
        hard = newton(every, np.zeros(len(chosen)))
        if len(hard):
            x[hard] = start[hard]
            size = np.trace(mean[hard], axis1=1, axis2=2) / p
            for softness in _SOFTENED:
                unsolved = np.isin(hard, newton(hard, softness * size))
                hard, size = hard[~unsolved], size[~unsolved]
                if not len(hard):
                    break
        return self._rate(stress(x, every), chosen).reshape(Y.shape)

    def _at_points(self, kappa: np.ndarray, Y: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """rate(M) of the M along Y with M + kappa rate(M) = Y: Newton's method held by a bracket."""
        shape, Y, kappa = Y.shape, Y.reshape(-1, Y.shape[-1]), kappa.reshape(-1, *kappa.shape[-2:])
        size = np.linalg.norm(Y, axis=1)
        along = Y / np.where(size > 0, size, 1.0)[:, None]
        stiffness = np.einsum("pi,pij,pj->p", along, kappa, along)
        low, high, s = np.zeros_like(size), size.copy(), 0.5 * size
        for _ in range(_BISECTIONS):
            value = (self._rate((s + 1j * TINY)[:, None] * along, cells) * along).sum(axis=1)
            defect = s + stiffness * value.real - size
            if (abs(defect) <= _NEAR * size).all():
                break
            low, high = np.where(defect < 0, s, low), np.where(defect < 0, high, s)
            newton = s - defect / (1 + stiffness * value.imag / TINY)
            s = np.where((newton > low) & (newton < high), newton, 0.5 * (low + high))
        return self._rate(s[:, None] * along, cells).reshape(shape)
