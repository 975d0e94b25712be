"""Signs of what a run dissipates: each column, and its integrand at the points, is looked at in every step.

The energy's ledger closes for a dissipation of the wrong sign too, since form and column have it both.  No
term of the equations gives energy: where one does, a law has a wrong sign, and the run says so by its name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce

import numpy as np
from ngsolve import L2, CoefficientFunction, LinearForm

from ngvisco.errors import NgviscoWarning
from ngvisco.forms.boundary.boundaries import cells_at
from ngvisco.forms.boundary.on_wall import OnWall
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.forms.term import PRODUCTION, Entry, Integrand
from ngvisco.forms.terms.regularisation import DELTA_FIELDS
from ngvisco.forms.terms.transport import UPWINDING
from ngvisco.physics.tensors import if_positive
from ngvisco.physics.variables import Values

CREEP_POWER = "creep_power_min"
"""The column of the least M : Pi at a point, of bodies and branches the least of each."""
_NEGATIVE = 1e-9
"""Share of all that is dissipated, or of all entropy that is produced, that may be missing of a mechanism:
what an iteration leaves."""
_ROUNDING = 1e-12
"""Share of the largest power at a point that rounding may leave of one that is zero."""
_MISSED = 0.01
"""Share of all that is dissipated that the projection of conjugates may take from a column."""
_OF_CREEP, _OF_VISCOSITY = "dissipation_creep", "dissipation_stokes"
"""Columns of creep, which is looked at by bodies and branches at the points, and of viscosity."""
_WALLS_EVERY = 10
"""Steps after which the parts of walls are looked at again, each by itself."""

Warn = Callable[[str, type[NgviscoWarning]], None]


class CreepPowerWarning(NgviscoWarning):
    """Creep gives energy at a point: the flow rule has a rate of the wrong sign there."""


class DissipationWarning(NgviscoWarning):
    """A mechanism that is to dissipate gives energy: a law has the wrong sign, though the ledger closes."""


class EntropyWarning(NgviscoWarning):
    """A mechanism takes entropy away: the mesh does not resolve the temperature, or a law is none."""


class Signs:
    """Looks at the dissipations of a step; ``warn`` takes a message and its category."""

    def __init__(
        self, step: Step, sampler: Sampler, entries: list[Entry], warn: Warn, cause: Callable[[], str]
    ) -> None:
        """``cause`` says why creep gives energy."""
        self._step, self._sampler, self._warn, self._cause = step, sampler, warn, cause
        self._productions = [entry.name for entry in entries if entry.name.startswith(PRODUCTION)]
        self._nearly: list[str] = []
        """Columns with a sign up to what the projection of conjugates misses."""
        self._columns: dict[str, list[str]] = {}
        """Columns by what is looked at: the viscous ones together, of which each by itself has no sign."""
        powers = step.context.rates.powers_of_creep(step.now)
        power = reduce(lambda a, b: if_positive(a - b, b, a), powers) if powers else None
        found = {} if power is None else {CREEP_POWER: power}
        everywhere = (
            step.energy.projected is None
        )  # else laws may read what is known at the forms' points alone
        for entry in entries:
            name, value = entry.name, entry.integrand.cells
            if entry.kind != "dissipation" or name == _OF_CREEP:
                continue
            if not entry.has_sign:
                self._nearly.append(name)
                continue
            together = _OF_VISCOSITY if name.startswith(_OF_VISCOSITY) else name
            self._columns.setdefault(together, []).append(name)
            if value is not None and everywhere and name != DELTA_FIELDS:
                found[together] = found[together] + value if together in found else value
        self.at_points: dict[str, CoefficientFunction] = found
        """Dissipations that are not negative at any point, W/m^3."""
        self._on_walls = self._wall_forms()

    def _wall_forms(self) -> dict[str, LinearForm]:
        """Dissipation on walls, on the facets of each cell."""
        step, forms = self._step, {}
        space = L2(step.mesh, order=0)
        for term in step.terms:
            for entry in term.entries(step.now) if isinstance(term, OnWall) else ():
                if entry.name in self._columns and entry.integrand.facets is not None:
                    forms[entry.name] = LinearForm(space)
                    each = Integrand(facets=entry.integrand.facets * space.TestFunction())
                    cells = cells_at(step.mesh, step.walls.region([term.name]))
                    step.quadrature.add(forms[entry.name], [each], cells)
        return forms

    def check_points(self, values: Mapping[str, np.ndarray], shares: Values, time: float) -> None:
        """Warn of a power that is negative at a point of ``at_points``, and of bodies of ``shares`` where."""
        for name, power in values.items():
            least, largest = self._sampler.ranks.least(power), self._sampler.ranks.most(abs(power))
            if least >= -_ROUNDING * largest:
                continue
            where = self._sampler.largest_in_words(-power, shares)
            if name == CREEP_POWER:
                message = (
                    f"at t = {time:.4g} s creep gives energy, M : Pi = {least:.3g} W/m^3, most "
                    f"{where}: {self._cause()}, though the ledger closes"
                )
                self._warn(message, CreepPowerWarning)
            elif least < -_NEGATIVE * largest:
                self._say(name, f"{least:.3g} W/m^3 {where}", time)

    def check(self, row: Mapping[str, float]) -> None:
        """Warn of a column of a row that gives energy or takes entropy away, and of a part of a wall."""
        made = {name: sum(row[one] for one in parts) for name, parts in self._columns.items()}
        nearly = {name: row[name] for name in self._nearly}
        total = sum(map(abs, (*made.values(), *nearly.values())))
        power = (abs(row["kinetic"]) + abs(row["stored"])) / row["dt"]
        for columns, share, rounding in ((made, _NEGATIVE, _ROUNDING), (nearly, _MISSED, _NEGATIVE)):
            for name, value in columns.items():
                if value < -share * total - rounding * power:
                    self._say(name, f"{value:.3g} W", row["time"])
        if self._on_walls and (row["step"] <= 1 or row["step"] % _WALLS_EVERY == 0):
            self._check_walls(row["time"])
        self._check_entropy(row)

    def _check_walls(self, time: float) -> None:
        for name, form in self._on_walls.items():
            values, ranks = form.Assemble().vec.FV().NumPy(), self._sampler.ranks
            least, largest = ranks.least(values), ranks.most(abs(values))
            if least < -_NEGATIVE * largest:
                self._say(name, f"{least:.3g} W on the facet of a cell", time)

    def _say(self, name: str, what: str, time: float) -> None:
        cause = "a law has the wrong sign there"
        if name == UPWINDING and self._step.layout.states.strains.all():
            cause = "the cells are too large for what jumps, or the energy is not convex"
        elif name == UPWINDING:
            cause = "a carried modulus that jumps is smeared, in which the energy is not convex"
        message = f"at t = {time:.4g} s {name} gives energy, {what}: {cause}, though the ledger closes"
        self._warn(message, DissipationWarning)

    def _check_entropy(self, row: Mapping[str, float]) -> None:
        made = {name: row[name] for name in self._productions}
        least = min(made, key=lambda name: made[name], default="")
        # near rest all of them are what an iteration leaves of what there is
        rate = abs(row.get("entropy", 0.0)) / row["dt"]
        share, rounding = _NEGATIVE, _ROUNDING * rate
        if least == PRODUCTION + UPWINDING.removeprefix("dissipation_"):  # has a sign up to projections
            share, rounding = _MISSED, _NEGATIVE * rate
        if made and made[least] < -share * sum(map(abs, made.values())) - rounding:
            message = (
                f"at t = {row['time']:.4g} s {least} is {made[least]:.3g} W/K: where that is conduction, "
                "the cells are too large for the slopes of the temperature; else a law gives energy"
            )
            self._warn(message, EntropyWarning)
