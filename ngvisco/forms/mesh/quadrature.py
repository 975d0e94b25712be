"""Quadrature of forms and ledger; no other module chooses the degrees.

The energy identity holds for any quadrature as long as a form and the ledger's integral of the same integrand
use one rule.  ``Quadrature`` provides both.  Integrands are straight-line programs, which NGSolve interprets
or, on request, compiles to machine code.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from ngsolve import (
    CF,
    VOL,
    BitArray,
    CoefficientFunction,
    GridFunction,
    Integrate,
    IntegrationRule,
    Mesh,
    VectorValued,
    ds,
    dx,
    x,
    y,
    z,
)
from ngsolve.comp import IntegrationRuleSpace

from ngvisco.errors import InitialDataError, ParameterError, planar
from ngvisco.forms.mesh.integrand import Integrand
from ngvisco.forms.mesh.mesh_arrays import VERTICES, is_simplicial, rules
from ngvisco.forms.mesh.symmetry import NO_SYMMETRY, Symmetry, weighted
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import number_of

SYMMETRIC_DEGREE = 6
"""Highest degree at which NGSolve's rules of triangles have all symmetries of the triangle.  The two sides of
a face number its vertices differently. With a less symmetric rule they would have different points, and the
flux out of one cell would not be the flux into the other."""
_FACET_BASE_ORDER = 5  # default order of NGSolve's Integrate on element boundaries


@dataclass(frozen=True)
class Quadrature:
    """Rules of the cells and of the facets, each of one degree, and a nodal rule for products of fields.

    Parameters
    ----------
    volume_degree, facet_degree : int
        Polynomial degrees integrated exactly on straight cells and facets.
    field_order : int
        Order of the fields. ``collocated`` integrates products of two such fields exactly, by a rule with one
        point per coefficient of a field in a cell. This holds on triangles up to order two, on tetrahedra up
        to order one.
    symmetry : Symmetry
        Symmetry of the mesh; in a body of revolution all integrals have the weight r.
    """

    mesh: Mesh
    volume_degree: int
    facet_degree: int
    field_order: int = 1
    symmetry: Symmetry = NO_SYMMETRY

    @classmethod
    def for_orders(
        cls, mesh: Mesh, k: int, m: int, bonus: int = 0, symmetry: Symmetry = NO_SYMMETRY
    ) -> Quadrature:
        """Return the rules for velocity order k and field order m.

        The polynomial terms with the highest degree are m~ . (L^T w) and rate(grad w; z) : zeta, of degree m
        + 2k + (k - 1) and (k - 1) + 2m.  Energies are not polynomials; the degree 2k + m + 1 resolves them at
        least as well as the fields do.  The degree is rounded up to an even number, since NGSolve has spaces
        of values at points for even degrees only.
        """
        degree = max(2 * k + m + 1, 2 * m + k) + bonus
        degree += degree % 2
        # the order of transport on facets needs the degree 2m + 1; see SYMMETRIC_DEGREE
        return cls(mesh, degree, degree if mesh.dim == 2 else min(degree, SYMMETRIC_DEGREE), m, symmetry)

    @property
    def collocation_order(self) -> int:
        """Half of the degree of ``collocated``. In a body of revolution the degree is higher: the points of
        degree 2 are the middles of sides, and have no weight on the axis."""
        return 2 if self.symmetry.is_axisymmetric and self.field_order == 1 else self.field_order

    @cached_property
    def cell_rules(self) -> dict[Any, IntegrationRule]:
        """The rules of all types of cells."""
        return rules(self.mesh.dim, self.volume_degree)

    @cached_property
    def has_constant_weights(self) -> bool:
        """Whether all integrals over cells have constant weights: on straight simplices without a
        symmetry."""
        is_plain = self.symmetry.radius is None
        # all ranks, including ranks without cells, make the same choice
        mesh, comm = self.mesh, self.mesh.comm
        return bool(is_plain and comm.Max(mesh.GetCurveOrder()) <= 1 and comm.Min(is_simplicial(mesh)))

    @cached_property
    def _facet_rules(self) -> dict[Any, IntegrationRule]:
        return rules(self.mesh.dim - 1, self.facet_degree)

    def cells(self, integrand: CoefficientFunction, cells: BitArray | None = None) -> Any:
        """The integral over all cells, or over ``cells``, with the common rule, for a form."""
        return self._in_cells(integrand) * dx(intrules=self.cell_rules, definedonelements=cells)

    def collocated(self, integrand: CoefficientFunction, cells: BitArray | None = None) -> Any:
        """The integral over all cells, or over ``cells``, with the nodal rule, for a form."""
        collocation_rules = rules(self.mesh.dim, 2 * self.collocation_order)
        return self._in_cells(integrand) * dx(intrules=collocation_rules, definedonelements=cells)

    def facets(self, integrand: CoefficientFunction, cells: BitArray | None = None) -> Any:
        """The integral over the boundaries of all cells, or of ``cells``, for a form; both sides of an inner
        facet count."""
        over = dx(element_boundary=True, intrules=self._facet_rules, definedonelements=cells)
        return self._on_facets(integrand) * over

    def walls(self, integrand: CoefficientFunction) -> Any:
        """The integral over the boundary of the mesh by the rule of ``facets``."""
        return self._on_facets(integrand) * ds(intrules=self._facet_rules)

    def _in_cells(self, integrand: CoefficientFunction) -> CoefficientFunction:
        return weighted(integrand, self.symmetry.radius)

    def _on_facets(self, integrand: CoefficientFunction) -> CoefficientFunction:
        return weighted(integrand, self.symmetry.on_facets)

    def vectors(self, size: int, collocated: bool = False) -> GridFunction:
        """A vector-valued function at the points of ``cells`` or ``collocated``, read by ``values_of``."""
        order = self.collocation_order if collocated else self.volume_degree // 2
        return GridFunction(VectorValued(IntegrationRuleSpace(self.mesh, order=order), size))

    def add(self, form: Any, integrands: Iterable[Integrand], cells: BitArray | None = None) -> None:
        """Add the integrands to an NGSolve form on all cells, or on ``cells``.

        The rules are those of ``cells``, ``facets`` and ``collocated``.
        """
        for integrand in integrands:
            if integrand.cells is not None:
                form += self.cells(compiled(integrand.cells), cells)
            if integrand.facets is not None:
                form += self.facets(compiled(integrand.facets), cells)
            if integrand.collocated is not None:
                form += self.collocated(compiled(integrand.collocated), cells)

    def integrate_cells(self, integrand: CoefficientFunction) -> Any:
        """Integral over the mesh, by the rule of ``cells``; a float, or a vector of floats."""
        return Integrate(self._in_cells(integrand), self.mesh, order=self.volume_degree)

    def each_cell(self, integrand: CoefficientFunction) -> np.ndarray:
        """Integrals of a scalar over the cells of this rank by the rule of ``cells``, (cells,)."""
        weighed = self._in_cells(integrand)
        return np.array(Integrate(weighed, self.mesh, order=self.volume_degree, element_wise=True).NumPy())

    def integrate_collocated(self, integrand: CoefficientFunction) -> Any:
        """Integral over the mesh, by the rule of ``collocated``."""
        return Integrate(self._in_cells(integrand), self.mesh, order=2 * self.collocation_order)

    def integrate_facets(self, integrand: CoefficientFunction) -> float:
        """Integral over the boundaries of all cells, by the rule of ``facets``."""
        order = self.facet_degree - _FACET_BASE_ORDER
        total = self._on_facets(integrand) * dx(element_boundary=True, bonus_intorder=order)
        # NGSolve does not sum this kind of integral over the ranks
        return float(self.mesh.comm.Sum(Integrate(total, self.mesh)))


def values_of(function: GridFunction) -> np.ndarray:
    """Values of a grid function at points, (components, points), as a view."""
    return function.vec.FV().NumPy().reshape(len(function.components) or 1, -1)


VARIABLE = "NGVISCO_COMPILE"
"""Environment variable for machine code: "1" compiles, "0" does not."""

SCRIPT = "ngscxx"
"""NGSolve's compiler script; pip installs it beside the interpreter."""


def compiled(integrand: CoefficientFunction) -> CoefficientFunction:
    """Compile an integrand to a program.

    Raises ParameterError if the environment variable is neither "0" nor "1", or there is no compiler for
    machine code.
    """
    value = os.environ.get(VARIABLE, "0")
    if value not in ("", "0", "1"):
        raise ParameterError(VARIABLE, value, '"1" for machine code, or "0"')
    if value != "1":
        return integrand.Compile()
    beside = str(Path(sys.executable).parent)
    if shutil.which(SCRIPT) is None and shutil.which(SCRIPT, path=beside) is not None:
        os.environ["PATH"] = os.pathsep.join([beside, os.environ.get("PATH", "")])
    if shutil.which(SCRIPT) is None or shutil.which("c++") is None:
        raise ParameterError(VARIABLE, value, f'"0", since {SCRIPT} (of NGSolve) or c++ is not on the path')
    return integrand.Compile(realcompile=True, wait=True)


class Sampler:
    """Evaluates coefficient functions at the vertices and quadrature points of all cells."""

    def __init__(self, mesh: Mesh, quadrature: Quadrature) -> None:
        self.mesh, self.quadrature = mesh, quadrature
        self.ranks = Communicator.of(mesh)

    @property
    def points(self) -> np.ndarray:
        """Mesh points at the cells' vertices (just inside each cell) and at the forms' quadrature points.

        The points are mapped at each access. Stored points would take 48 bytes each, and the map takes only
        20 ns a point.
        """
        rules = {}
        for et, vertices in VERTICES.items():
            if et in self.quadrature.cell_rules:
                inner_points = list(self.quadrature.cell_rules[et].points)
                points = [tuple(p)[: len(vertices[0])] for p in inner_points] + list(vertices)
                rules[et] = IntegrationRule(points, [0.0] * len(points))
        return self.mesh.MapToAllElements(rules, VOL)

    @property
    def cells(self) -> np.ndarray:
        """The number of each point's cell, (points,)."""
        return np.asarray(self.points["nr"])

    def values(self, f: CoefficientFunction) -> np.ndarray:
        """Values at all points of this rank, shape (points,) or (points, components)."""
        result = np.asarray(f(self.points))
        return result[:, 0] if result.ndim == 2 and result.shape[1] == 1 else result

    def rows(self, f: CoefficientFunction, some: np.ndarray | None = None) -> np.ndarray:
        """Values at all points, or at the points with the numbers ``some``: always (points, components)."""
        points = self.points if some is None else self.points[some]
        return np.asarray(f(points)).reshape(len(points), f.dim)

    def coordinates(self, indices: np.ndarray) -> np.ndarray:
        """Coordinates of the points with the numbers ``indices``, (indices, dim), m."""
        return self.rows(CF((x, y, z)[: self.mesh.dim]), indices)

    def integral(self, values: np.ndarray) -> float:
        """Integral over the whole mesh, from values at this rank's points: each cell counts by its points'
        mean."""
        volumes = self.quadrature.each_cell(CF(1.0))
        sums, counts = (np.bincount(self.cells, weights, len(volumes)) for weights in (values, None))
        return self.ranks.total(float(volumes @ (sums / np.maximum(counts, 1))))

    def extrema(self, f: CoefficientFunction) -> tuple[float, float]:
        """Minimum and maximum of a scalar over all ranks."""
        values = self.values(f)
        return self.ranks.least(values), self.ranks.most(values)

    def largest_in_words(self, sizes: np.ndarray, shares: Mapping[str, CoefficientFunction]) -> str:
        """Words for the place of the largest of ``sizes`` over all ranks, and for the largest share at this
        place."""
        mine, names = None, list(shares)
        if len(sizes):
            at = int(np.argmax(sizes))
            place = ", ".join(f"{c:.4g}" for c in self.coordinates(np.array([at]))[0])
            body = ""
            if names:
                theta = self.rows(CF(tuple(shares.values())), np.array([at]))[0]
                body = f" in body {names[int(theta.argmax())]!r}"
            mine = (float(sizes[at]), f"at ({place}) m{body}")
        return max(entry for entry in self.ranks.gathered(mine) if entry is not None)[1]

    def place_of_cells(self, cells: np.ndarray) -> str:
        """Words for the place of the first of this rank's ``cells``, and for the number on all ranks."""
        mine = None
        if len(cells):
            points = np.flatnonzero(self.cells == cells[0])
            middle = tuple(float(c) for c in self.coordinates(points).mean(axis=0))
            mine = number_of(self.mesh, int(cells[0])), middle
        every = [entry for entry in self.ranks.gathered(mine) if entry is not None]
        if not every:
            return "somewhere"
        cell, place = every[0]
        further = int(self.ranks.total(len(cells))) - 1
        at = f"at ({', '.join(f'{c:.4g}' for c in place)}) m"
        where = at if cell is None else f"in cell {cell} {at}"
        return where + (f" and in {further} other cell{'s' * (further > 1)}" if further else "")

    def require(
        self, f: CoefficientFunction, name: str, key: str = "Initial", minimum: float | None = None
    ) -> None:
        """Raise InitialDataError unless f is finite (and > ``minimum``) at all points."""
        values = self.values(planar(key, f, self.mesh.dim))
        if not self.ranks.all(np.isfinite(values).all()):
            raise InitialDataError(name, "the value is not finite somewhere", "finite values", key)
        if minimum is not None and (least := self.ranks.least(values)) <= minimum:
            raise InitialDataError(name, f"the minimum is {least:.6g}", f"values > {minimum:g}", key)
