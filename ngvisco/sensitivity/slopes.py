"""Slopes of columns: derivatives of their values by all coefficients of a state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from ngsolve import CF, VOL, CoefficientFunction, ElementId

from ngvisco.errors import ParameterError
from ngvisco.expressions import parse
from ngvisco.forms.distance import NUMERICAL, energies
from ngvisco.forms.mesh.locating import as_points, locate
from ngvisco.forms.term import Integrand
from ngvisco.physics.parameters import Parameter
from ngvisco.physics.tensors import inner
from ngvisco.run.body_tables import Bodies
from ngvisco.run.extrema import defects_of
from ngvisco.run.fields import components, output_fields
from ngvisco.run.probes import Integrals, Probes, WallForces
from ngvisco.sensitivity.body_slopes import BodySlopes
from ngvisco.sensitivity.distance_slopes import DistanceSlopes
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.parameters import OFFSETS, differenced
from ngvisco.sensitivity.starts import Starts
from ngvisco.sensitivity.variations import Slope, Variations
from ngvisco.sensitivity.wall_rows import WallRows

_SPACING = 1e-3
"""Spacing of differences by a cell's coefficients, relative to the unknown's largest coefficient in the
cell."""


class Slopes:
    """The slopes of a follower's columns at its present state.

    Slopes of ledger columns and of integrals are variations of forms. The slope of a probe's value is taken
    by differences of the coefficients in the probe's cell.  A column with ``rows`` of the residual has two
    slopes: one by its rows, and the one computed here.  Raises ParameterError for a column without a slope,
    such as an integral of a coefficient function.
    """

    def __init__(self, follower: Follower) -> None:
        self.follower, self.step, self.rows = follower, follower.step, WallRows(follower)
        self.starts, names = Starts(follower), follower.columns.names
        self._extrema = follower.columns.extrema
        self._of = self._slopes(Variations(self.step), names)
        self.distances = DistanceSlopes(follower) if follower.columns.has_distances else None
        """Slopes of the scheme's dissipation, which depends on several states; None if no column needs
        them."""
        elsewhere = [*self.rows.powers, *NUMERICAL]
        self._of |= {name: lambda: np.zeros(len(follower.state)) for name in elsewhere}
        for name in names:
            if name not in self._of:
                expected = "a column with an adjoint derivative; take method = 'tangent'"
                raise ParameterError("of", name, expected)
        reading = self._reading_start() - set(elsewhere)
        self.reading_start = [name for name in names if name in reading]
        """Columns that depend on the state from which a stage, or the end of a step, starts."""
        self._of_start = self._slopes(self.starts.variations, self.reading_start)

    def _slopes(self, variations: Variations, names: Sequence[str]) -> dict[str, Slope]:
        """Slopes of columns by the trial functions of ``variations``."""
        if not names:
            return {}
        follower, trial, slopes = self.follower, variations.trial, dict[str, Slope]()
        integrands = {**energies(self.step, trial), "mass": Integrand(trial.rho)}
        integrands |= follower.simulation.ledger.momentum.densities(trial)
        if self.step.energy.projected is not None:  # energy and slope are known at the present state only
            integrands["stored"] = Integrand(inner(self.step.energy.slope(self.step.now), trial.z))
        integrands |= {
            entry.name: entry.integrand for entry in self.step.entries(trial) if entry.evaluate is None
        }
        for table in follower.columns.tables:
            columns = table.prepare(follower.simulation)
            if isinstance(table, Integrals):
                slopes |= {
                    name: variations.of_fields(partial(_parsed, value))
                    for name, value in table.integrands.items()
                    if isinstance(value, str) and name in names
                }
            elif isinstance(table, Probes):
                slopes |= {name: self._probe(table, name, variations) for name in names if name in columns}
            elif isinstance(table, WallForces):
                for name in set(self.rows.forces) & set(columns) & set(names):
                    wall, motion = name.rsplit(".", 1)
                    slopes[name] = variations.of(*table.reactions.beside_the_rows(wall, motion, trial))
            elif isinstance(table, Bodies):
                bodies = BodySlopes(table, variations)
                slopes |= {name: bodies.of(name) for name in names if name in columns}
        slopes |= {name: self._extremum(name, variations) for name in names if name in self._extrema.names}
        slopes |= self._norms(variations)
        momentum = follower.simulation.ledger.momentum
        if forces := [name for name in names if name in momentum.of_steps]:
            slopes |= variations.of_integrands(momentum.force_densities, forces)
        return slopes | {name: variations.of(integrands[name]) for name in names if name in integrands}

    def _reading_start(self) -> set[str]:
        """Names of the columns whose integrands or fields read the start of a stage.  All defects are among
        them."""
        names = set(self.follower.simulation.ledger.momentum.of_steps)
        for term in self.step.terms:
            u, reads_start = self.starts.fields()
            names |= {entry.name for entry in term.entries(u) if reads_start()}
        u, reads_start = self.starts.fields()
        output_fields(self.step, u)
        if reads_start():
            for table in self.follower.columns.tables:
                names |= set(table.prepare(self.follower.simulation)) - set(self.rows.forces)
            names |= {*self._extrema.names}
        return names

    def __call__(self, name: str) -> np.ndarray:
        """Slope of a column at the present state by all coefficients, (unknowns,)."""
        return self._of[name]()

    def of_start(self, name: str) -> np.ndarray:
        """Slope of a column by the coefficients of a start state, see ``Starts.put``, (unknowns,)."""
        return np.where(self.starts.evolving, self._of_start[name](), 0.0)

    def _probe(self, table: Probes, column: str, variations: Variations) -> Slope:
        mesh = self.step.mesh
        name, field = column.rsplit(".", 1)
        at = locate(mesh, as_points(name, table.points[name], mesh.dim), [name])
        value, cell = components(variations.fields)[field], int(at["nr"][0])
        is_linear = self._is_linear(field)
        kept: list[np.ndarray] = []

        def slope() -> np.ndarray:
            if not kept or not is_linear:
                kept[:] = [self._differenced(lambda: np.ravel(value(at))[0], cell, variations, is_linear)]
            return kept[0]

        return slope

    def _is_linear(self, field: str) -> bool:
        """Whether a field is linear in the evolving unknowns and reads no other unknowns.  The slope of such
        a field is constant."""
        carried = {
            variable.name
            for variable in self.step.model.material.variables
            if not isinstance(variable, Parameter) or variable.mean == "arithmetic"
        }
        names = {"velocity", "density", *carried}
        return field in names or field.rpartition("_")[0] in names

    def _extremum(self, name: str, variations: Variations) -> Slope:
        def slope() -> np.ndarray:
            place = self._extrema.found()[name]
            read = partial(self._extrema.at, name, place)
            return self._differenced(read, self._extrema.cell(place), variations)

        return slope

    def _norms(self, variations: Variations) -> dict[str, Slope]:
        """Slopes of the norms of defects; NaN where a norm is zero."""
        quadrature, model = self.step.quadrature, self.step.model
        gap, pairs = defects_of(model, variations.trial)
        present, of_pairs = defects_of(model, self.step.now)

        def of(
            value: CoefficientFunction, trial: CoefficientFunction
        ) -> Callable[[], tuple[float, np.ndarray]]:
            of_square = variations.of(Integrand(trial * trial))

            def norm() -> tuple[float, np.ndarray]:
                size = float(np.sqrt(quadrature.integrate_cells(value * value)))
                with np.errstate(divide="ignore", invalid="ignore"):
                    return size, of_square() / (2 * size)

            return norm

        norms = [of(of_pairs[pair], trial) for pair, trial in pairs.items()]
        root = float(np.sqrt(quadrature.integrate_cells(CF(1.0))))
        slopes: dict[str, Slope] = {}
        if norms:  # the column is the largest norm
            slopes["defect_rms"] = lambda: max((norm() for norm in norms), key=lambda n: n[0])[1] / root
        if gap is not None and present is not None:
            of_gap = of(present, gap)
            slopes["J_defect"] = lambda: of_gap()[1]
        return slopes

    def _differenced(
        self, read: Callable[[], float], cell: int, variations: Variations, is_linear: bool = False
    ) -> np.ndarray:
        """Slope of a function of the coefficients of a cell, by differences.

        If ``is_linear`` is True (see ``_is_linear``), two values for each evolving coefficient suffice."""
        order, spacing = (2, 1.0) if is_linear else (4, _SPACING)
        ranges, evolving = self.step.layout.ranges, self.step.layout.evolving
        dofs = np.array(self.step.layout.space.GetDofNrs(ElementId(VOL, cell)))
        dofs = dofs[dofs >= 0]
        state, result = variations.coefficients, np.zeros(len(self.follower.state))
        for block in (ranges[name] for name in ranges if not is_linear or name in evolving):
            dofs_of = dofs[(block.start <= dofs) & (dofs < block.stop)]
            h = spacing * (abs(state[dofs_of]).max(initial=0.0) or 1.0)
            for dof in dofs_of:
                kept, values = state[dof], []
                for offset in OFFSETS[order]:
                    state[dof] = kept + offset * h
                    if self.step.energy.projected is not None:
                        self.step.local_unknowns.update_stored()
                    values.append(np.array(read()))
                state[dof] = kept
                result[dof] = variations.weight.Get() * differenced(values, h)
        return result


def _parsed(text: str, fields: dict[str, CoefficientFunction]) -> CoefficientFunction:
    """The function of components of fields that a text describes."""
    scalars = components(fields)
    return parse(text, tuple(scalars)).coefficient(scalars)
