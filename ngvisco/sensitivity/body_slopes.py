"""Slopes of the columns of tables of bodies by all coefficients of a state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property, partial

import numpy as np
from ngsolve import (
    L2,
    VOL,
    BilinearForm,
    CoefficientFunction,
    Det,
    ElementId,
    Grad,
    GridFunction,
    LinearForm,
    Variation,
    dx,
    specialcf,
    sqrt,
)
from scipy.sparse.linalg import splu

from ngvisco.forms.mesh.mesh_arrays import rules
from ngvisco.forms.mesh.quadrature import compiled
from ngvisco.forms.term import Integrand
from ngvisco.physics.mixture import Mixture
from ngvisco.run.body_tables import Bodies
from ngvisco.run.fraction_samples import PIECES
from ngvisco.run.frames import Lattice
from ngvisco.run.outlines import closest
from ngvisco.sensitivity.outline_slopes import Corners, OutlineSlopes, of_gap
from ngvisco.sensitivity.variations import Slope, Variations, basis_at

_QUOTIENTS = ("x", "y", "z")
"""Columns that are integrals of densities over the body's volume."""
_OF_OUTLINES: dict[str, Callable[[OutlineSlopes], Corners]] = {
    **{name: partial(OutlineSlopes.deformation, column=name) for name in ("L", "B", "D", "angle")},
    "perimeter": OutlineSlopes.perimeter,
    "inside": OutlineSlopes.inside,
    "turning": OutlineSlopes.turning,
}


class BodySlopes:
    """Slopes of the columns of a prepared table of bodies.

    The slope of an integral is a variation of a form. A measure of an outline is a function of the fractions
    and the velocity at points in cells. The measure's slopes by these values are the weights of a sum over
    the points, and the variation of this sum is the slope by the state.  The force of other bodies has slopes
    by the stress and by the averaged fraction.
    """

    def __init__(self, table: Bodies, variations: Variations) -> None:
        self.table, self.variations, self.step = table, variations, variations.step
        material = self.step.model.material
        assert isinstance(material, Mixture)
        self._theta = material.fractions.at(variations.trial.z_tensors)

    def of(self, column: str) -> Slope:
        """Slope of a column that is a differentiable function of the state."""
        if (pair := self._pairs.get(column)) is not None:
            return lambda: self._of_gap(*pair)
        name = max((n for n in self.table.names if column.startswith(f"{n}_")), key=len)
        quantity = column[len(name) + 1 :]
        if (measure := _OF_OUTLINES.get(quantity)) is not None:
            return lambda: self._of_outline(name, measure)
        if (tractions := self.table.tractions) is not None and quantity in tractions.of_traction:
            return self._of_traction(name, quantity)
        if tractions is not None and quantity in tractions.of_stress:

            def share(fields: dict[str, CoefficientFunction]) -> CoefficientFunction:
                return tractions.shares(name, fields)[quantity]

            return self._quotient(name, self.variations.of_fields(share), share(self.variations.fields))
        slope = self.variations.of(Integrand(self.table.densities(name, self.variations.trial)[quantity]))
        if quantity in _QUOTIENTS:
            return self._quotient(name, slope, self.table.densities(name, self.step.now)[quantity])
        return slope

    @cached_property
    def _pairs(self) -> Mapping[str, tuple[str, str]]:
        return self.table.pairs if "gap" in self.table.measures else {}

    def _quotient(self, name: str, of_integral: Slope, density: CoefficientFunction) -> Slope:
        """Slope of an integral over a body's volume; ``density`` is the integrand at the present state."""
        of_volume = self.variations.of(Integrand(self._theta[name]))
        volume = self.table.densities(name, self.step.now)["volume"]
        integrands = [compiled(f) for f in (density, volume)]

        def slope() -> np.ndarray:
            self.table.fractions.place()
            total, size = (self.step.quadrature.integrate_cells(f) for f in integrands)
            return (of_integral() - total / size * of_volume()) / size

        return slope

    # measures of outlines

    def _outline(self, name: str, is_whole: bool) -> OutlineSlopes:
        return OutlineSlopes(*self.table.fractions.traced(name, is_whole))

    def _of_outline(self, name: str, measure: Callable[[OutlineSlopes], Corners]) -> np.ndarray:
        self.table.fractions.read()
        outline = self._outline(name, is_whole=True)
        if not len(outline.cut.inside):
            return np.full(self.step.layout.space.ndof, np.nan)
        return self._to_state({name: measure(outline)})

    def _of_gap(self, one: str, other: str) -> np.ndarray:
        self.table.fractions.read()
        outlines = {name: self._outline(name, is_whole=False) for name in (one, other)}
        first, second = cuts = [outline.cut for outline in outlines.values()]
        gap = closest(first.ends, second.ends, self.table.fractions.periods.images)
        if gap is None:
            return np.full(self.step.layout.space.ndof, np.nan)
        parts = zip(outlines.items(), of_gap(gap, *cuts), strict=True)
        return self._to_state({name: outline.of_ends(ends) for (name, outline), ends in parts})

    @cached_property
    def _weights(self) -> tuple[Callable[[np.ndarray], np.ndarray], list[GridFunction], Slope]:
        """Solver, functions and slope with which ``_to_state`` computes slopes by the state.

        The solver returns the coefficients of a function with given values at the points.  The functions hold
        the weights at the points, one function for each fraction and each component of the velocity.  The
        slope is that of the weighted sum of fractions and velocities by the state.
        """
        mesh, lattice = self.step.mesh, self.table.fractions.lattice
        space = L2(mesh, order=PIECES)
        functions = [GridFunction(space) for _ in range(len(self.table.names) + mesh.dim)]
        v = self.variations.trial.v
        values = [*(self._theta[name] for name in self.table.names), *(v[i] for i in range(mesh.dim))]
        # division by this volume gives points the weight 1, not |J|
        volume = sqrt(Det(specialcf.JacobianMatrix(mesh.dim)) ** 2)
        form, over = BilinearForm(self.step.layout.space), dx(intrules=lattice.rules)
        form += Variation(sum(f * value for f, value in zip(functions, values, strict=True)) / volume * over)
        return splu(basis_at(space, lattice)).solve, functions, self.variations.applied(form, lambda: None)

    def _to_state(self, corners: Mapping[str, Corners]) -> np.ndarray:
        """Slope by the state, computed from the slopes by the averaged fractions and the velocity at
        corners."""
        solve, functions, slope = self._weights
        samples, names = self.table.fractions, self.table.names
        for function in functions:
            function.vec[:] = 0.0
        cells, count = samples.lattice.cells.ravel(), len(samples.places)
        for name, (by_theta, by_v) in corners.items():
            of_places = np.bincount(samples.places[cells], by_theta.ravel())
            at_points = (of_places / np.bincount(samples.places))[samples.places]
            functions[names.index(name)].vec.FV().NumPy()[:] += solve(at_points)
            for function, part in zip(functions[len(names) :], np.moveaxis(by_v, 2, 0), strict=True):
                function.vec.FV().NumPy()[:] += solve(np.bincount(cells, part.ravel(), count))
        return slope()

    # forces of other bodies

    def _of_traction(self, name: str, column: str) -> Slope:
        """Slope of a force, or of a torque about the centroid c, int x x f - c x F."""
        tractions = self.table.tractions
        assert tractions is not None
        dim, names = self.step.mesh.dim, tractions.of_traction
        integrals = {key: self._of_integral(name, key) for key in names}
        if column.startswith("force"):
            return lambda: integrals[column][0]()
        axis = 2 if dim == 2 else names.index(column) - dim
        i, j = (axis + 1) % 3, (axis + 2) % 3  # the torque's component of c x F is c_i F_j - c_j F_i
        axes = "xyz"[:dim]
        of_centre = [self.of(f"{name}_{coordinate}") for coordinate in axes]
        first = self.table.densities(name, self.step.now)
        integrate = self.step.quadrature.integrate_cells

        def slope() -> np.ndarray:
            self.table.fractions.place()
            tractions.average()
            of_torque, _ = integrals[column]
            volume = integrate(first["volume"])
            c = [integrate(first[coordinate]) / volume for coordinate in axes]
            force = [integrals[key][1]() for key in names[:dim]]
            of_force = [integrals[key][0]() for key in names[:dim]]
            c_i, c_j, F_i, F_j = of_centre[i](), of_centre[j](), of_force[i], of_force[j]
            return of_torque() - c_i * force[j] - c[i] * F_j + c_j * force[i] + c[j] * F_i

        return slope

    def _of_integral(self, name: str, column: str) -> tuple[Slope, Callable[[], float]]:
        """Slope and value of the integral of a density of the traction."""
        tractions = self.table.tractions
        assert tractions is not None
        chi, quadrature = tractions.chi[name], self.step.quadrature
        by_stress = self.variations.of_fields(
            lambda fields: tractions.densities(name, fields, Grad(chi))[column]
        )
        space = chi.space
        of_chi = tractions.densities(name, self.variations.fields, Grad(space.TestFunction()))[column]
        load = LinearForm(space)
        load += quadrature.cells(compiled(of_chi))
        now = compiled(tractions.densities(name, self.variations.fields, Grad(chi))[column])

        def slope() -> np.ndarray:
            tractions.average()
            return by_stress() + self._averaged(name)(load.Assemble().vec.FV().NumPy().copy())

        return slope, lambda: float(quadrature.integrate_cells(now))

    def _averaged(self, name: str) -> Callable[[np.ndarray], np.ndarray]:
        """A function that maps weights w to the slope of sum_i w_i chi_i, where chi_i are the coefficients of
        a body's averaged fraction."""
        if name not in self._averages:
            tractions, step = self.table.tractions, self.step
            assert tractions is not None
            weights = GridFunction(L2(step.mesh, order=1))
            at_vertices = GridFunction(tractions.chi[name].space)
            lattice, of_cells = Lattice(step.mesh, 1), at_vertices.space
            met = [of_cells.GetDofNrs(ElementId(VOL, cell)) for cell in range(step.mesh.ne)]
            counts = np.bincount(np.concatenate([np.array(dofs) for dofs in met]), minlength=of_cells.ndof)
            basis = basis_at(weights.space, lattice)
            trial, test = weights.space.TnT()
            # NGSolve's Set has this rule for functions of order one
            over = dx(intrules=rules(step.mesh.dim, 2))
            mass, form = BilinearForm(weights.space, condense=True), BilinearForm(step.layout.space)
            mass += trial * test * over
            mass.Assemble()
            inverse = mass.inner_solve  # the inverse, cell by cell
            form += Variation(weights * self._theta[name] * over)
            apply, load = self.variations.applied(form, lambda: None), weights.vec.CreateVector()

            def slope(rows: np.ndarray) -> np.ndarray:
                at_vertices.vec.FV().NumPy()[:] = rows / np.maximum(counts, 1)
                load.FV().NumPy()[:] = basis.T @ lattice.values(at_vertices)[:, 0]
                weights.vec.data = inverse * load
                return apply()

            self._averages[name] = slope
        return self._averages[name]

    @cached_property
    def _averages(self) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
        return {}
