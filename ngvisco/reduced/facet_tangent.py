"""dR/dz of the terms by which cells act on each other across facets; the facet means are eliminated.

A term on a cell's side reads the cell's z, its conjugates zeta, and facet means (``FacetMean``). A facet mean
reads z and zeta of both cells, and means that are computed before it. Derivatives are taken by complex
increments at the points, in all cells at once: along each basis function of the cells, and along each basis
function of the facets. Let A dz be the change of a mean by one side, and H the change of a side's rows by the
mean. The derivative of the side's rows is then

    (own + H A) dz + H A(other side) dz(other cell),    summed over the means,

where own is the derivative at constant means. The blocks contain all integrals over cells with a gradient of
the increment or of the test. The point tangent contains the integrals without gradients.  zeta follows z by
the projection of phi''(z), cell by cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm
from ngvisco.physics.arrays import TINY
from ngvisco.reduced.coupling import FacetCoupling
from ngvisco.reduced.one_point import OnePoint
from ngvisco.reduced.point_fields import moved

if TYPE_CHECKING:
    from ngvisco.reduced.residual import Evaluation, ReducedResidual


class FacetTangent:
    """Computes the blocks of the components of z in which the terms have rows.

    ``rows`` are the numbers of these components; ``columns`` are the components on which the rows depend.
    """

    def __init__(
        self,
        residual: ReducedResidual,
        terms: Sequence[PointTerm],
        rows: Sequence[int],
        coupling: FacetCoupling,
    ) -> None:
        self.residual, self.terms, self.coupling = residual, list(terms), coupling
        self.rows, self.columns = list(rows), list(rows)
        point = OnePoint(residual.step)
        asking, self.means = list(terms), list[_Mean]()
        for term, name in reversed(residual.means_of_sides):
            if not term.stays and (read := point.read(asking, [name])):
                asking.append(term)
                self.means.insert(0, _Mean(residual, term, name, [i for _, i in read], coupling))
        self._read = point.read(asking, ("z", "zeta"))
        self._projecting = residual.op.projection()

    def __call__(self, at: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of a cell's rows by z; also sets ``columns``.

        Each component of z has q functions in a cell.  The first array has the derivatives by the cell's own
        z, (cells, rows q, columns q).  The second array has the derivatives by z of the cells across its
        sides, (cells, sides, rows q, columns q).
        """
        r, coupling, q = self.residual, self.coupling, self.coupling.functions
        count, height = coupling.cells * coupling.sides, len(self.rows) * q
        along = [(name, i, a) for name, i in self._read for a in range(q)]
        of_cells = np.zeros((coupling.cells, height, len(along)))
        here = np.zeros((count, height, len(along)))
        loads = [np.zeros((count, mean.size, len(along))) for mean in self.means]
        inside, sides = at.cells, at.facets
        for column, (name, i, a) in enumerate(along):
            direction = {name: np.zeros_like(at.coefficients[name])}
            direction[name][i, a::q] = 1.0
            of_cells[:, :, column] = self._in_cells(inside, r.cell_terms.fields(direction), name)
            u = moved(sides, r.facet_terms.fields(direction), [name])
            here[:, :, column] = self._on_sides(u)
            for mean, load in zip(self.means, loads, strict=True):
                load[:, :, column] = mean.load(u)
        of_z = self._of_z(at)  # (cells, along, columns q)
        on_sides = np.repeat(of_z, coupling.sides, axis=0)
        of_cells, here, *loads = of_cells @ of_z, here @ on_sides, *(load @ on_sides for load in loads)
        across = np.zeros_like(here)
        for i, mean in enumerate(self.means):
            of_mean, later = mean.solved(loads[i]), self.means[i + 1 :]  # A
            rows = np.zeros((count, height, mean.size))  # H
            of_later = [np.zeros((count, later_mean.size, mean.size)) for later_mean in later]
            for p in range(mean.size):
                u = moved(sides, r.facet_terms.fields(mean.function(p, at.coefficients)), [mean.name])
                rows[:, :, p] = self._on_sides(u)
                for later_mean, load in zip(later, of_later, strict=True):
                    load[:, :, p] = later_mean.load(u)
            here += rows @ of_mean
            across += rows @ coupling.beyond(of_mean)
            for load, change in zip(loads[i + 1 :], of_later, strict=True):
                load += mean.of_both(change) @ of_mean
        by_sides = coupling.cells, coupling.sides, height, of_z.shape[2]
        return of_cells + here.reshape(by_sides).sum(axis=1), across.reshape(by_sides)

    def _of_z(self, at: Evaluation) -> np.ndarray:
        """Derivatives by z of the values that the terms read, z and zeta, (cells, read q, columns q)."""
        r, z, q, lagged = self.residual, at.cells.z.value, self.coupling.functions, self.residual.slope.lagged
        cells, size, slope = self.coupling.cells, len(z), r.slope.derivative(z)
        derivatives = np.zeros((cells, len(self._read), q, size, q))
        for n, (name, i) in enumerate(self._read):
            if name == "z":
                derivatives[:, n, :, i] = np.eye(q)
                continue
            unit = np.zeros_like(z)
            unit[i] = 1.0
            curvature = np.where(lagged == lagged[i], slope(unit), 0.0)  # phi'' is symmetric
            for j in np.flatnonzero((curvature != 0).any(axis=1)):
                values = curvature[j].reshape(cells, -1, 1) * r.op.z.blocks
                derivatives[:, n, :, j] = self._projecting @ values
        used = r.ranks.largest((derivatives != 0).any(axis=(0, 1, 2, 4)).astype(float))
        self.columns = [j for j in range(size) if used[j] or j in self.rows]
        return derivatives[:, :, :, self.columns].reshape(cells, len(self._read) * q, len(self.columns) * q)

    def _in_cells(self, u: Fields, d: Fields, name: str) -> np.ndarray:
        """Change of the cells' rows by the increment ``d`` of the unknown ``name``, (cells, rows q).

        Integrals of a value of the increment times a value of a test are left out.
        """
        r = self.residual
        by_all = r.cell_terms.factors(self.terms, moved(u, d, [name])).get("grad z")
        by_gradients = r.cell_terms.factors(self.terms, moved(u, d, [name], values=False)).get("z")
        rows = np.zeros((len(self.rows), r.op.z.width))
        if by_all is not None:
            slopes = self._change(by_all, r.op.points.count)
            rows += sum(D.test(slopes[:, j]) for j, D in enumerate(r.op.slopes("z")))
        if by_gradients is not None:
            rows += r.op.z.test(self._change(by_gradients, r.op.points.count))
        cells, q = self.coupling.cells, self.coupling.functions  # a rank may have no cells
        return rows.reshape(len(rows), cells, q).transpose(1, 0, 2).reshape(cells, len(rows) * q)

    def _on_sides(self, u: Fields) -> np.ndarray:
        """Change of the rows of each side with the increment in ``u``, (sides, rows q)."""
        factors = self.residual.facet_terms.factors(self.terms, u)
        if "z" not in factors:
            return np.zeros(())
        return self.coupling.tested(self._change(factors["z"], self.coupling.points))

    def _change(self, values: np.ndarray, count: int) -> np.ndarray:
        change = values[self.rows].imag / TINY
        return np.ascontiguousarray(np.broadcast_to(change, (*change.shape[:-1], count)))


class _Mean:
    """A facet mean of both sides: its equation, and its basis functions on facets."""

    def __init__(
        self,
        residual: ReducedResidual,
        term: PointTerm,
        name: str,
        components: Sequence[int],
        coupling: FacetCoupling,
    ) -> None:
        self.term, self.name, self._terms, self._coupling = term, name, residual.facet_terms, coupling
        self._mass, self._components = residual.mass_of(name), list(components)
        self._facet, self._functions = self._mass.facet, self._mass.unknowns.shape[1]
        self.size = len(self._components) * self._functions

    def load(self, u: Fields) -> np.ndarray:
        """Derivative of the mean's equation along the increment in ``u``, tested on each side, (sides,
        size)."""
        values = self._terms.factors([self.term], u)[self.name].imag / TINY
        values = np.atleast_2d(values)[self._components]
        full = np.broadcast_to(values, (len(values), self._coupling.points))
        return self._coupling.tested(full, self._mass.functions)

    def solved(self, loads: np.ndarray) -> np.ndarray:
        """Change of the mean's coefficients by the ``loads`` of one side alone, (sides, size, .)."""
        parts = loads.reshape(len(loads), len(self._components), self._functions, loads.shape[-1])
        return (-self._mass.inverses[self._facet][:, None] @ parts).reshape(loads.shape)

    def function(self, number: int, like: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Coefficients of the mean's basis function ``number`` on all facets."""
        which, place = divmod(number, self._functions)
        values = np.zeros(like[self.name].shape)
        np.atleast_2d(values)[self._components[which], self._mass.unknowns[:, place]] = 1.0
        return {self.name: values}

    def of_both(self, blocks: np.ndarray) -> np.ndarray:
        """The sum of both sides' blocks, (sides, ., .), on each side."""
        sums = np.zeros((len(self._mass.unknowns), *blocks.shape[1:]))
        np.add.at(sums, self._facet, blocks)
        return self._mass.of_facets.sum(np.moveaxis(sums, 0, -1))[..., self._facet].transpose(2, 0, 1)
