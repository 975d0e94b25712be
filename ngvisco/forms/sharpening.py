"""Conservative sharpening of interfaces between bodies at the end of a step, which keeps their width.

Transport smears a jump of the amounts n_i over ever more cells.  After each step (``Discretisation.sharp``)
bodies i and j are separated, in the cells that contain both, in two moves.

1. *Between two mixed cells.*  Through their facet the amount

       a = C tau int |v . n| |e . n| / |K_d|  min(n_i |K_d|, n_j |K_r|),    at most 1/8 of either,

   of body i goes to K_r, the cell with more of i, and the same amount of body j comes back; e is the
   direction in which theta_i grows.  Each body takes its tensors with it, a (X/n) of its cell.  An interface
   at rest does not change, as under upwinding, whose smearing this move balances.
2. *In a mixed cell* n_i becomes the mean plus the slope of the projected indicator of a half-space that has
   this mean and a boundary plane across e, scaled until theta_i is in [0, 1]; n_j is the rest of n_i + n_j,
   and X becomes n (X/n) with the quotient of the means.

The moves keep N at every point, int n_i and int X_i: masses, sum theta = 1, rho and momentum too, since
bodies have one density.  A common volumetric energy depends on N alone, and n f(X/n) = C : (X - n I), f
linear in X, on the integrals alone: the stored energy is kept to rounding, and the step's identity holds.
Other f would lose energy if they had degree one in (n, X); the bodies' f have it up to traces of matter only,
and are refused.  The cost is shape: a body of a few cells becomes somewhat angular along them (NOTES).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from ngsolve import (
    CF,
    ET,
    H1,
    VOL,
    ElementId,
    FacetFESpace,
    FESpace,
    GridFunction,
    IntegrationRule,
    LinearForm,
    Periodic,
    x,
    y,
    z,
)

from ngvisco.errors import ParameterError
from ngvisco.forms.mesh.mesh_arrays import VERTICES
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.bodies import AMOUNT, NO_INTERFACE
from ngvisco.physics.mixture import Mixture

_RATE = 1 / 4
"""Factor C: half of upwinding's smearing at a jump, 1/2 |v . n|; a larger C is sharper and less round."""
_MOST = 1 / 8
"""Largest share of a body in a cell that goes through one facet."""
_LEAST = 1e-3
"""Fraction below which a cell does not contain a body."""
_DEGREE = 20
"""Degree of the rule that places a plane in a cell."""
_FIELD = "Discretisation.sharp"


def check_sharp(step: Step) -> None:
    """Raise ParameterError, with the reason, for a model whose interfaces cannot be sharpened."""
    material, mesh = step.model.material, step.mesh
    if not isinstance(material, Mixture):
        raise ParameterError(_FIELD, True, "False for a model without bodies")
    densities = {float(body.density or 0.0) for body in material.bodies}
    for is_wrong, expected in (
        (step.layout.discretisation.m != 1, "False unless m = 1"),
        (
            len(densities) > 1,
            "False for bodies of different densities: momentum would go with what is put apart",
        ),
        (not material.has_one_volume, "False for bodies of different volumetric energies: energy would rise"),
        (
            not all(psi.is_linear for psi in material.energies.values()),
            "False unless energies are linear in B",
        ),
        (material.heat is not None, "False for bodies with heat"),
        (bool(material.plastic_contents), "False for bodies that harden"),
        (Communicator.of(mesh).is_distributed, "False over ranks"),
        ({cell.type for cell in mesh.Elements(VOL)} - {ET.TRIG, ET.TET}, "False on quadrilaterals"),
    ):
        if is_wrong:
            raise ParameterError(_FIELD, True, expected)


class Sharpening:
    """Separation of bodies in a step's present state; raises ParameterError for an unsuitable model."""

    def __init__(self, step: Step) -> None:
        check_sharp(step)
        self.step, self.mesh, self.dim = step, step.mesh, step.mesh.dim
        material, slices = step.model.material, step.layout.states.slices
        assert isinstance(material, Mixture)
        names = [body.name for body in material.bodies]
        self._amounts = [slices[AMOUNT + name].start for name in names]
        self._contents = [
            [i for X in material.contents(name) for i in range(slices[X.name].start, slices[X.name].stop)]
            for name in names
        ]
        self._kind = ET.TRIG if self.dim == 2 else ET.TET
        places = np.array(VERTICES[self._kind])
        rule = IntegrationRule([tuple(map(float, place)) for place in places], [0.0] * len(places))
        self._corners = self.mesh.MapToAllElements({self._kind: rule}, VOL)
        self._x = np.asarray(CF((x, y, z)[: self.dim])(self._corners)).reshape(-1, len(places), self.dim)
        self._basis, self._inverse, self._masses = self._of_cells()
        self._vertices, self._facets = self._of_vertices_and_facets()
        rule = IntegrationRule(self._kind, _DEGREE)
        points = np.hstack([np.array(rule.points)[:, : self.dim], np.ones((len(rule), 1))])
        self._lambda = points @ np.linalg.inv(np.hstack([places, np.ones((len(places), 1))]))
        self._shares = np.array(rule.weights) / sum(rule.weights)
        weighed = self._lambda.T * self._shares
        self._fit = np.linalg.solve(weighed @ self._lambda, weighed)
        edges = self._x[:, 1:] - self._x[:, :1]
        self._volumes = np.abs(np.linalg.det(edges)) / (2 if self.dim == 2 else 6)
        slopes = np.swapaxes(np.linalg.inv(edges), 1, 2)
        self._slopes = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)  # of lambda

    def put_apart(self, tau: float) -> None:
        """Separate bodies of the present state at the end of a step of length ``tau``, s."""
        dofs = self._basis
        state = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
        state = state.reshape(self.step.layout.states.size, -1)
        u = np.einsum("kcf,skf->skc", np.linalg.inv(self._inverse), state[:, dofs])
        v = np.asarray(self.step.now.v(self._corners)).reshape(self._x.shape)
        for i, j in combinations(range(len(self._amounts)), 2):
            mixed = self._mixed(self._means(u), i, j)
            heights = self._averaged(np.clip(u[self._amounts[i]] / sum(u[n] for n in self._amounts), 0, 1))
            self._between(u, i, j, heights, tau * v, mixed)
            self._within(u, i, j, heights, mixed)
        state[:, dofs] = np.einsum("kfc,skc->skf", self._inverse, u)

    def _means(self, u: np.ndarray) -> np.ndarray:
        """Cell means of linear functions with values (components, cells, corners)."""
        return np.einsum("skc,kc->sk", u, self._masses) / self._masses.sum(axis=1)

    def _averaged(self, values: np.ndarray) -> np.ndarray:
        """Values at corners of cells, (cells, corners), averaged over the corners at each vertex."""
        weights = np.repeat(self._volumes, values.shape[1])
        sums = [np.bincount(self._vertices.ravel(), sizes) for sizes in (weights * values.ravel(), weights)]
        averages: np.ndarray = (sums[0] / np.maximum(sums[1], np.finfo(float).tiny))[self._vertices]
        return averages

    def _mixed(self, means: np.ndarray, i: int, j: int) -> np.ndarray:
        """Mask of cells with bodies i and j and no other body, (cells,)."""
        amounts = means[self._amounts]
        least, both = _LEAST * amounts.sum(axis=0), amounts[[i, j]]
        return np.asarray((both > least).all(axis=0) & (both.sum(axis=0) > amounts.sum(axis=0) - least))

    def _between(
        self, u: np.ndarray, i: int, j: int, heights: np.ndarray, path: np.ndarray, mixed: np.ndarray
    ) -> None:
        """Exchange bodies i and j between mixed cells, in place; ``path`` is tau v at corners of cells."""
        slope = np.einsum("kc,kcd->kd", heights, self._slopes)
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        is_flat = np.ptp(heights, axis=1, keepdims=True) <= NO_INTERFACE
        slope = np.where(is_flat, 0.0, slope / np.where(is_flat, 1.0, size))
        facets = self._facets[mixed[self._facets[:, 0]] & mixed[self._facets[:, 2]]]
        (cell, corner), neighbour = facets[:, :2].T, facets[:, 2]
        normal = -self.dim * self._volumes[cell, None] * self._slopes[cell, corner]  # length = facet's area
        area = np.linalg.norm(normal, axis=1)
        up = 0.5 * ((slope[cell] + slope[neighbour]) * normal).sum(axis=1) / area
        opposite = np.arange(path.shape[1]) == corner[:, None]
        moved = np.where(opposite[:, :, None], 0.0, path[cell]).sum(axis=1) / self.dim
        swept = np.abs((moved * normal).sum(axis=1))
        giving, taking = np.where(up > 0, (cell, neighbour), (neighbour, cell))
        means, mass = self._means(u), self._masses.sum(axis=1)
        amounts_i, amounts_j = means[self._amounts[i]], means[self._amounts[j]]
        share = np.minimum(_RATE * np.abs(up) * swept / self._volumes[giving], _MOST)
        amount = share * np.minimum(amounts_i[giving] * mass[giving], amounts_j[taking] * mass[taking])
        for body, source, target in ((i, giving, taking), (j, taking, giving)):
            n = means[self._amounts[body], source]
            for component in (self._amounts[body], *self._contents[body]):
                carried = amount * means[component, source] / n
                count = len(mass)
                change = np.bincount(target, carried, count) - np.bincount(source, carried, count)
                u[component] += (change / mass)[:, None]

    def _within(self, u: np.ndarray, i: int, j: int, heights: np.ndarray, mixed: np.ndarray) -> None:
        """Separate bodies i and j in mixed cells by planes across the slope of heights, in place."""
        means, chosen = self._means(u), np.flatnonzero(mixed & (np.ptp(heights, axis=1) > NO_INTERFACE))
        amount_i, both = means[self._amounts[i]], means[self._amounts[i]] + means[self._amounts[j]]
        theta = amount_i[chosen] / both[chosen]
        above = heights[chosen] @ self._lambda.T
        order = np.argsort(-above, axis=1, kind="stable")
        sizes = self._shares[order]
        filled = np.clip((theta[:, None] - (np.cumsum(sizes, axis=1) - sizes)) / sizes, 0, 1)
        inside = np.empty_like(above)
        np.put_along_axis(inside, order, filled, axis=1)
        slope = inside @ self._fit.T
        weights = self._masses[chosen]
        slope -= (slope * weights).sum(axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True)
        tiny = np.finfo(float).tiny
        low = theta / np.maximum(-slope.min(axis=1), tiny)
        high = (1 - theta) / np.maximum(slope.max(axis=1), tiny)
        slope *= np.minimum(1.0, np.minimum(low, high))[:, None]
        n_i, n_j = self._amounts[i], self._amounts[j]
        total = u[n_i, chosen] + u[n_j, chosen]
        u[n_i, chosen] = amount_i[chosen, None] + both[chosen, None] * slope
        u[n_j, chosen] = total - u[n_i, chosen]
        for body, n in ((i, n_i), (j, n_j)):
            for component in self._contents[body]:
                u[component, chosen] = u[n, chosen] * (means[component, chosen] / means[n, chosen])[:, None]

    # --- arrays of cells, vertices and facets -----------------------------------------------------------

    def _of_cells(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Arrays of each cell: numbers of its functions, (cells, functions), the matrix from corner values to
        coefficients, (cells, functions, corners), and the integrals, by the rule of the forms, of linear
        functions that are 1 at one corner, (cells, corners)."""
        space = self.step.layout.scalar_space("z")
        dofs = _numbers(space)
        function, values = GridFunction(space), np.empty((*self._x.shape[:2], dofs.shape[1]))
        for j in range(dofs.shape[1]):
            function.vec.FV().NumPy()[:] = 0.0
            function.vec.FV().NumPy()[dofs[:, j]] = 1.0
            values[:, :, j] = np.asarray(function(self._corners)).reshape(values.shape[:2])
        form = LinearForm(space)
        form += self.step.quadrature.cells(space.TestFunction())
        integrals = form.Assemble().vec.FV().NumPy()[dofs]
        inverse = np.linalg.inv(values)
        return dofs, inverse, np.einsum("kf,kfc->kc", integrals, inverse)

    def _of_vertices_and_facets(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the cells' vertices, (cells, corners), and facets between two cells: rows of one cell,
        its corner opposite, and the other cell.  Identified vertices and facets count once."""
        periodic = bool(self.step.walls.periodic)
        nodes, facets = H1(self.mesh, order=1), FacetFESpace(self.mesh, order=0)
        vertices, sides = (_numbers(Periodic(s) if periodic else s) for s in (nodes, facets))
        points = np.array([vertex.point for vertex in self.mesh.vertices])
        first, rows = dict[int, tuple[int, int]](), []
        for cell, element in enumerate(self.mesh.Elements(VOL)):
            vertices_of = [vertex.nr for vertex in element.vertices]
            near = np.linalg.norm(self._x[cell][:, None] - points[vertices_of], axis=2).argmin(axis=1)
            vertices[cell] = vertices[cell][near]
            for number, facet in zip(sides[cell], element.facets, strict=True):
                on = {vertex.nr for vertex in self.mesh[facet].vertices}
                corner = next(c for c, at in enumerate(near) if vertices_of[at] not in on)
                if number in first:
                    rows.append([*first[number], cell])
                else:
                    first[number] = cell, corner
        return vertices, np.array(rows, dtype=int).reshape(-1, 3)


def _numbers(space: FESpace) -> np.ndarray:
    """Numbers of the unknowns of every cell, (cells, unknowns)."""
    return np.array([space.GetDofNrs(ElementId(VOL, cell)) for cell in range(space.mesh.ne)])
