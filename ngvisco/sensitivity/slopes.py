"""Slopes of columns: derivatives of their values by all coefficients of a state."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial

import numpy as np
from ngsolve import VOL, CoefficientFunction, ElementId

from ngvisco.errors import ParameterError
from ngvisco.expressions import parse
from ngvisco.forms.distance import energies
from ngvisco.forms.mesh.locating import as_points, locate
from ngvisco.forms.term import Integrand
from ngvisco.physics.parameters import Parameter
from ngvisco.physics.tensors import inner
from ngvisco.run.body_tables import Bodies
from ngvisco.run.fields import components
from ngvisco.run.probes import Integrals, Probes, WallForces
from ngvisco.sensitivity.body_slopes import BodySlopes
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.parameters import OFFSETS, differenced
from ngvisco.sensitivity.variations import Variations
from ngvisco.sensitivity.wall_rows import WallRows

_SPACING = 1e-3
"""Spacing of differences by a cell's coefficients, relative to the unknown's largest one in the cell."""


class Slopes:
    """The slopes of a follower's columns at its present state.

    Slopes of ledger columns and of integrals are variations of forms.  The value of a probe is differenced by
    the coefficients of the probe's cell.  A column with ``rows`` of the residual has two slopes: one by its
    rows, and the one computed here.  Raises ParameterError for a column without a slope, such as an integral
    of a coefficient function.
    """

    def __init__(self, follower: Follower) -> None:
        self.follower, self.step, self.rows = follower, follower.step, WallRows(follower)
        names = follower.columns.names
        self._of: dict[str, Callable[[], np.ndarray]] = {}
        self._variations = variations = Variations(self.step)
        trial = variations.trial
        integrands = {**energies(self.step, trial), "mass": Integrand(trial.rho)}
        integrands |= follower.simulation.ledger.momentum.densities(trial)
        if self.step.energy.projected is not None:  # energy and slope are known at the state only
            integrands["stored"] = Integrand(inner(self.step.energy.slope(self.step.now), trial.z))
        integrands |= {
            entry.name: entry.integrand for entry in self.step.entries(trial) if entry.evaluate is None
        }
        for table in follower.columns.tables:
            columns = table.prepare(follower.simulation)
            if isinstance(table, Integrals):
                self._of |= {
                    name: variations.of_fields(partial(_parsed, value))
                    for name, value in table.integrands.items()
                    if isinstance(value, str) and name in names
                }
            elif isinstance(table, Probes):
                columns_of_table = [name for name in names if name in columns]
                self._of |= {name: self._probe(table, name) for name in columns_of_table}
            elif isinstance(table, WallForces):
                for name in set(self.rows.forces) & set(columns):
                    wall, motion = name.rsplit(".", 1)
                    beside = table.reactions.beside_the_rows(wall, motion, trial)
                    self._of[name] = variations.of(*beside)
            elif isinstance(table, Bodies):
                bodies = BodySlopes(table, variations)
                self._of |= {name: bodies.of(name) for name in names if name in columns}
        self._of |= {name: lambda: np.zeros(len(follower.state)) for name in self.rows.powers}
        for name in names:
            if name in integrands:
                self._of[name] = variations.of(integrands[name])
        for name in names:
            if name not in self._of:
                raise ParameterError("of", name, "a column with a slope, for the adjoint; take the tangent")

    def __call__(self, name: str) -> np.ndarray:
        """Slope of a column at the present state by all coefficients, (unknowns,)."""
        return self._of[name]()

    def _probe(self, table: Probes, column: str) -> Callable[[], np.ndarray]:
        step, mesh = self.step, self.step.mesh
        name, field = column.rsplit(".", 1)
        at = locate(mesh, as_points(name, table.points[name], mesh.dim), [name])
        value = self._fields[field]
        dofs = np.array(step.layout.space.GetDofNrs(ElementId(VOL, int(at["nr"][0]))))
        dofs = dofs[dofs >= 0]
        is_linear = self._is_linear(field)
        kept: list[np.ndarray] = []

        def slope() -> np.ndarray:
            if not kept or not is_linear:
                kept[:] = [self._differenced(value, at, dofs)]
            return kept[0]

        return slope

    @cached_property
    def _fields(self) -> dict[str, CoefficientFunction]:
        """Components of the fields at the present state, by their names."""
        return components(self._variations.fields)

    def _is_linear(self, field: str) -> bool:
        """Whether a field is linear in the state, so that its slope is constant."""
        carried = {
            variable.name
            for variable in self.step.model.material.variables
            if not isinstance(variable, Parameter) or variable.mean == "arithmetic"
        }
        names = {"velocity", "density", *carried}
        return field in names or field.rpartition("_")[0] in names

    def _differenced(self, value: CoefficientFunction, at: np.ndarray, dofs: np.ndarray) -> np.ndarray:
        state, result = self.follower.state, np.zeros(len(self.follower.state))
        for block in self.step.layout.ranges.values():
            dofs_of = dofs[(block.start <= dofs) & (dofs < block.stop)]
            h = _SPACING * (abs(state[dofs_of]).max(initial=0.0) or 1.0)
            for dof in dofs_of:
                kept, values = state[dof], []
                for offset in OFFSETS[4]:
                    state[dof] = kept + offset * h
                    if self.step.energy.projected is not None:
                        self.step.local_unknowns.update_stored()
                    values.append(np.ravel(value(at))[0])
                state[dof] = kept
                result[dof] = differenced(values, h)
        return result


def _parsed(text: str, fields: dict[str, CoefficientFunction]) -> CoefficientFunction:
    """The function of components of fields that a text describes."""
    scalars = components(fields)
    return parse(text, tuple(scalars)).coefficient(scalars)
