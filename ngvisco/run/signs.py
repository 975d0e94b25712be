"""Checks the sign of each dissipation in every step: the sign of its column, and of its integrand at points.

The energy's ledger closes for a dissipation of the wrong sign too, since form and column share the sign.  A
mechanism that gives energy has a law with a wrong sign, and a warning names the dissipation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce

import numpy as np
from ngsolve import CF, L2, CoefficientFunction, LinearForm

from ngvisco.errors import NgviscoWarning
from ngvisco.forms.boundary.boundaries import cells_at
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.forms.term import PRODUCTION, Entry, Integrand
from ngvisco.forms.terms.regularisation import DELTA_FIELDS
from ngvisco.forms.terms.transport import UPWINDING
from ngvisco.physics.materials.thermal import entropy_in
from ngvisco.physics.parameters import moduli_in
from ngvisco.physics.tensors import if_positive
from ngvisco.physics.variables import Values

CREEP_POWER = "creep_power_min"
"""Column of the least M : Pi over all points, bodies and branches."""
_NEGATIVE = 1e-9
"""Share of the total dissipation, or of the total production of entropy, by which one mechanism may be
negative through the iteration's error."""
_ROUNDING = 1e-12
"""Share of the largest power at a point that rounding may give to a power of zero."""
_MISSED = 0.01
"""Share of the total dissipation by which the projection of conjugates may lower a column."""
_OF_CREEP, _OF_VISCOSITY = "dissipation_creep", "dissipation_stokes"
"""Columns of creep, whose power is checked at points for each body and branch, and of viscosity."""
_BY_UPWINDING = PRODUCTION + UPWINDING.removeprefix("dissipation_")
_WALLS_EVERY = 10
"""Number of steps between checks of single facets of walls."""

Warn = Callable[[str, type[NgviscoWarning]], None]


class CreepPowerWarning(NgviscoWarning):
    """Creep gives energy at a point: the flow rule has a rate of the wrong sign there."""


class DissipationWarning(NgviscoWarning):
    """A dissipative mechanism gives energy: a law has the wrong sign, though the ledger closes."""


class EntropyWarning(NgviscoWarning):
    """A mechanism destroys entropy: the mesh does not resolve the temperature, or a law is wrong."""


class Signs:
    """Checks the dissipations of a step; ``warn`` takes a message and its category."""

    def __init__(
        self, step: Step, sampler: Sampler, entries: list[Entry], warn: Warn, cause: Callable[[], str]
    ) -> None:
        """Sort the dissipations by their signs; ``cause`` returns the reason why creep gives energy."""
        self._step, self._sampler, self._warn, self._cause = step, sampler, warn, cause
        entropy, volume = entropy_in(step.model.material), step.quadrature.integrate_cells(CF(1.0))
        self._capacity = 0.0 if entropy is None else entropy.unit * float(volume)
        """Scale of the entropy, J/K, that rounding is compared with where the entropy is zero."""
        self._productions = [entry.name for entry in entries if entry.name.startswith(PRODUCTION)]
        self._nearly: list[str] = []
        """Columns whose sign is certain only up to the error of the projection of conjugates."""
        self._columns: dict[str, list[str]] = {}
        """Columns of each checked sum: only the sum of the viscous columns has a sign."""
        powers = step.context.rates.powers_of_creep(step.now)
        power = reduce(lambda a, b: if_positive(a - b, b, a), powers) if powers else None
        at_points = {} if power is None else {CREEP_POWER: power}
        # an energy may be known at the points of the forms only. A law that reads this energy has no values
        # at other points, and its dissipation is not sampled
        everywhere = step.energy.projected is None
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
                at_points[together] = at_points[together] + value if together in at_points else value
        self.at_points: dict[str, CoefficientFunction] = at_points
        """Dissipations that are not negative at any point, W/m^3."""
        self._on_walls = self._wall_forms()

    def _wall_forms(self) -> dict[str, LinearForm]:
        """Linear forms of the dissipation on walls, by columns, with an entry for each cell's facets."""
        step, forms = self._step, {}
        space = L2(step.mesh, order=0)
        for term in step.point_terms:
            for entry in () if term.wall is None else term.entries(step.now):
                if entry.name in self._columns and entry.integrand.facets is not None:
                    forms[entry.name] = LinearForm(space)
                    density = Integrand(facets=entry.integrand.facets * space.TestFunction())
                    cells = cells_at(step.mesh, step.walls.region([str(term.wall)]))
                    step.quadrature.add(forms[entry.name], [density], cells)
        return forms

    def check_points(self, values: Mapping[str, np.ndarray], shares: Values, time: float) -> None:
        """Warn of a power of ``at_points`` that is negative at a point; ``shares`` name the bodies there."""
        for name, power in values.items():
            least, largest = self._sampler.ranks.least(power), self._sampler.ranks.most(abs(power))
            if least >= -_ROUNDING * largest:
                continue
            where = self._sampler.largest_in_words(-power, shares)
            if name == CREEP_POWER:
                message = (
                    f"at t = {time:.4g} s creep produces energy, although the ledger closes: the least M : "
                    f"Pi is {least:.3g} W/m^3, {where}. The cause is that {self._cause()}"
                )
                self._warn(message, CreepPowerWarning)
            elif least < -_NEGATIVE * largest:
                self._say(name, f"{least:.3g} W/m^3 {where}", time)

    def check(self, row: Mapping[str, float]) -> None:
        """Warn of a row's columns, and of a wall's facets, that give energy or destroy entropy."""
        sums = {name: sum(row[part] for part in parts) for name, parts in self._columns.items()}
        nearly = {name: row[name] for name in self._nearly}
        total = sum(map(abs, (*sums.values(), *nearly.values())))
        power = (abs(row["kinetic"]) + abs(row["stored"])) / row["dt"]
        for columns, share, rounding in ((sums, _NEGATIVE, _ROUNDING), (nearly, _MISSED, _NEGATIVE)):
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

    def _say(self, name: str, power: str, time: float) -> None:
        cause = self._of_upwinding() if name == UPWINDING else "a law has the wrong sign there"
        message = (
            f"at t = {time:.4g} s {name} is negative ({power}) and produces energy, although the ledger "
            f"closes; the cause is that {cause}"
        )
        self._warn(message, DissipationWarning)

    def _of_upwinding(self) -> str:
        """The reason why upwinding produces energy."""
        if self._step.layout.states.strains.all():
            return "the cells are too large for jumping variables, or the energy is not convex"
        return "a carried modulus jumps, and the energy is not convex in the modulus"

    def _check_entropy(self, row: Mapping[str, float]) -> None:
        productions = {name: row[name] for name in self._productions}
        least = min(productions, key=lambda name: productions[name], default="")
        # near rest a production is an error of the iteration, which is proportional to the whole entropy
        rate = (abs(row.get("entropy", 0.0)) + self._capacity) / row["dt"]
        share, rounding = _NEGATIVE, _ROUNDING * rate
        # production by upwinding is >= 0 up to an error of projection
        if least == _BY_UPWINDING:
            share, rounding = _MISSED, _NEGATIVE * rate
        if productions and productions[least] < -share * sum(map(abs, productions.values())) - rounding:
            coarse = "the cells are too large for the slopes of the temperature"
            causes = {PRODUCTION + "conduction": coarse, _BY_UPWINDING: self._of_upwinding()}
            message = (
                f"at t = {row['time']:.4g} s {least} is {productions[least]:.3g} W/K; the cause is that "
                f"{causes.get(least, 'its law produces energy')}"
            )
            self._warn(message, EntropyWarning)


def cause_of_negative_power(step: Step, sampler: Sampler) -> str:
    """The reason, in words, why creep gives energy at a point: a modulus of the wrong sign, or the flow rule.

    Collective; all ranks return the same text.
    """
    for mechanism in step.model.mechanisms:
        for name, expression, _ in moduli_in(mechanism.rule):
            least = sampler.extrema(expression.at(step.now.z_tensors))[0]
            if least < 0:
                return (
                    f"{name} is {least:.3g} at a point, since a parameter with an arithmetic mean in cells "
                    'overshoots where the parameter jumps; nv.Parameter(mean="geometric") keeps the sign'
                )
    return "the flow rule does not dissipate for every stress"
