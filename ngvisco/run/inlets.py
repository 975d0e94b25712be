"""Warnings about inflows whose given values do not fit the stress at the wall."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ngsolve import CoefficientFunction

from ngvisco.errors import NgviscoWarning
from ngvisco.forms.given_values import is_let_in_by_pressure
from ngvisco.forms.system import Step
from ngvisco.physics.material import rest_stress_and_modulus
from ngvisco.physics.tensors import square, sym

_MATTERS = 0.01
"""Shares above which a run warns: the share of all powers that entering matter loses, and the share of the
mass that has entered with an undetermined density."""
_FILLED = 0.2
"""Stresses are compared after this share of the mass has come in, because before this the stress inside is
that of the start."""
_DIFFERS = 0.1
"""Largest difference between the stresses inside and outside, as a share of the stresses; both are root mean
squares over the inflow."""
_ROUNDING = 1e-9
"""Share of the bulk modulus below which a stress counts as rounding."""


class InflowWarning(NgviscoWarning):
    """Entering matter has another stress than the body inside, or a density that nothing determines."""


class Inlets:
    """Warns of inflows through a run's walls; sums the mass that came in through each wall.

    Two measures tell whether the given values have another stress than the body. One is the power that is
    lost where given values and the body meet; in slow straining this power is small beside other powers. The
    other is the difference of the stresses' deviators, relative to elastic and viscous stresses. Pressures
    are compared only by the lost power, because nearly incompressible matter has the density of its
    neighbours at any pressure. Temperatures mix by their nature and bring no warning.  Bodies whose amounts
    are given come in unstrained.
    """

    def __init__(self, step: Step) -> None:
        law = step.model.material
        self._step = step
        strains = {v.name for v in law.variables if v.is_strain}
        self._given: dict[str, str] = {}
        """The given data in words, by the names of the walls that give strains or amounts."""
        known_densities = law.referential_density is not None
        self._unknown: list[str] = []
        """Walls through which matter of an undetermined density comes in."""
        for term in step.passages:
            wall: Any = step.walls.conditions[term.name]
            named = sorted(strains & wall.values.keys())
            if named or wall.amounts:
                self._given[term.name] = f"values of {', '.join(named)}" if named else "amounts"
            if not known_densities and is_let_in_by_pressure(wall, law):
                self._unknown.append(term.name)
        self._entered = dict.fromkeys((*self._given, *self._unknown), 0.0)
        """Mass, kg, that came in, by the wall's name."""
        # for an energy without an expression the stress of given values is not known
        named_alone = [name for name, kind in self._given.items() if kind != "amounts"]
        has_expression = law.response(step.mesh.dim) is None
        self._compared = {name for name in self._given if has_expression or name not in named_alone}
        """Walls whose stresses are compared."""
        self._integrands: dict[str, tuple[CoefficientFunction, ...]] = {}
        laws = [body.material for body in step.model.bodies] or [law]
        moduli = [abs(rest_stress_and_modulus(law)[1]) for law in laws] if self._given else [0.0]
        self._rounding = _ROUNDING * max(moduli)

    def _squares(self, name: str) -> tuple[CoefficientFunction, ...]:
        """Integrands on a wall: the inflow speed times the square of the stresses' difference, times the
        square of the stresses' size, and times 1."""
        step, u = self._step, self._step.now
        inward, inside, outside = next(term for term in step.passages if term.name == name).deviators(u)
        sizes = square(inside) + square(outside)
        if (law := step.model.viscosity) is not None:
            sizes = sizes + square(law.stress(sym(u.L), step.context.rates.read_values(law, u)))
        parts = (inward * square(outside - inside), inward * sizes, inward)
        return tuple(part.Compile() for part in parts)

    def _difference(self, name: str) -> tuple[float, float]:
        """Difference of the stresses' deviators at a wall, and the stresses' size, Pa; collective."""
        if name not in self._integrands:
            self._integrands[name] = self._squares(name)
        integrate = self._step.quadrature.integrate_facets
        difference, size, inflow = (integrate(integrand) for integrand in self._integrands[name])
        return ((difference / inflow) ** 0.5, (size / inflow) ** 0.5) if inflow > 0 else (0.0, 0.0)

    def resume(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Continue after the ``rows`` of a ledger."""
        self._entered = dict.fromkeys(self._entered, 0.0)
        for row in rows:
            self._add(row)

    def _add(self, row: Mapping[str, float]) -> None:
        for name in self._entered:
            self._entered[name] += max(row[f"inflow_{name}"], 0.0) * row["dt"]

    def message(self, row: Mapping[str, float]) -> str:
        """A warning about the step of a ledger's row, or ""; to be called once for each row; collective."""
        self._add(row)
        worked = sum(
            abs(value)
            for name, value in row.items()
            if name.startswith(("power_", "dissipation_")) and not name.startswith("power_stored_")
        )
        for name, given in self._given.items():
            loss, meeting = row[f"dissipation_inflow_{name}"], ""
            if loss > _MATTERS * worked:
                meeting = (
                    f"where inflow and body meet, {loss:.3g} W are lost, {loss / worked:.0%} of all powers"
                )
            elif name in self._compared and self._entered[name] > _FILLED * row["mass"]:
                difference, size = self._difference(name)
                if difference > max(_DIFFERS * size, self._rounding):
                    meeting = (
                        f"the deviators of the two stresses differ by {difference:.3g} Pa, while the "
                        f"stresses at the wall have the size {size:.3g} Pa"
                    )
            if meeting:
                return (
                    f"at t = {row['time']:.4g} s the inflow through {name!r} with the given "
                    f"{given} has another stress than the body inside: {meeting}. A jump stays at "
                    "the wall. Give values (and a density) that belong to the stress at the wall, or give no "
                    "values, so that incoming matter has the values inside"
                )
        for name in self._unknown:
            if self._entered[name] > _MATTERS * row["mass"]:
                return (
                    f"at t = {row['time']:.4g} s a fluid comes in through {name!r} at a pressure, but with "
                    "the density of the cell inside, since without rho_R the pressure does not determine the "
                    "density; give rho_R, or the wall's density and values"
                )
        return ""
