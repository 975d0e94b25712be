"""The ledger's columns of momentum: the momentum, the impulses that change it, and the defect.

    momentum - momentum_old = sum of impulse_* + momentum_defect

holds at every step of every scheme, and likewise for angular momentum about the origin.  No force causes
``momentum_defect``; the scheme itself makes this momentum (``ngvisco.forms.impulses``).  The columns
``defect_*`` are parts of ``momentum_defect``; the remainder comes from the iteration and the limiter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ngvisco.errors import NgviscoWarning
from ngvisco.forms.boundary.wall_terms import HELD_BY_WALLS
from ngvisco.forms.fields import Fields
from ngvisco.forms.impulses import DEFECTS, Impulses
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand

SIZE, DEFECT, RELATIVE = "momentum_size", "momentum_defect", "momentum_defect_relative"
"""Columns of int |rho v|, of a step's defect, and of the relative defect since the start."""
IMPULSE, ANGULAR = "impulse_", "angular_"
"""Beginnings of the names of columns of impulses, and of angular quantities."""
TRANSFERRED = "impulse_transfer"
"""Column of the change of momentum when a state is carried over to another mesh or other parameters."""
_ROUNDING = 1e-9
"""Fraction of the largest exchange, and of the stresses' impulse, that is added to the moving momentum of
every direction, to allow for rounding."""
LOST = 0.05
"""Value of ``momentum_defect_relative`` above which a run warns."""


OfMotion = TypeVar("OfMotion")


class MomentumWarning(NgviscoWarning):
    """The scheme makes momentum without a force: jumps push the body, though the energy's ledger closes."""


def column(quantity: str, motion: str) -> str:
    """The name of a column: quantity_1 for ``"force_1"``, angular_quantity_1 for ``"torque_1"``."""
    kind, _, axis = motion.partition("_")
    return (ANGULAR if kind == "torque" else "") + quantity + (f"_{axis}" if axis else "")


def unit(name: str) -> str | None:
    """SI unit of a column of momentum (per metre of thickness in plane strain); None for other columns."""
    if name == RELATIVE:
        return "1"
    quantity = name.removeprefix(ANGULAR)
    if quantity.startswith(("momentum", IMPULSE, *(f"defect_{where}" for where in DEFECTS))):
        return "kg m/s" if quantity == name else "kg m^2/s"
    return None


@dataclass(frozen=True)
class _Totals:
    """Totals of all rows so far: for each motion the defect, the exchange and the last momentum; the largest
    |momentum|; and the impulse of stresses within the body."""

    defect: np.ndarray
    exchanged: np.ndarray
    moving: float
    stressed: float
    last: np.ndarray


class Momentum:
    """Columns of momentum of a run's ledger; ``velocity`` gives the run's velocity scale, m/s."""

    def __init__(self, step: Step, sampler: Sampler, velocity: Callable[[], float]) -> None:
        self.impulses, self._ranks, self._velocity = Impulses(step), sampler.ranks, velocity
        self.motions = list(self.impulses.motions)
        self._length = reach = self._ranks.most(np.linalg.norm(coordinates(step.mesh), axis=1))
        self._reach = np.array([reach if motion.startswith("torque") else 1.0 for motion in self.motions])
        """Lever arm of each motion, m: the mesh's reach for rotations; 1 for translations."""
        self._given = [IMPULSE + name for name in self.impulses.names]
        self._at_once: list[str] = []
        """Names of impulses that only earlier parts of the run have, and of impulses by transfers between
        parts."""
        self._has_warned, self._is_alone = False, len(step.model.bodies) < 2
        self.resume([])

    @property
    def columns(self) -> list[str]:
        """Names of the columns, in the order of the CSV file."""
        quantities = ["momentum", *self._given, *self._at_once, DEFECT, *_PARTS]
        return [*(name for quantity in quantities for name in self._names(quantity)), SIZE, RELATIVE]

    def _names(self, quantity: str) -> list[str]:
        return [column(quantity, motion) for motion in self.motions]

    def _array(self, row: Mapping[str, float], quantity: str) -> np.ndarray:
        return np.array([row[name] for name in self._names(quantity)])

    def densities(self, u: Fields | None = None) -> dict[str, Integrand]:
        """Densities that are integrated over the cells, by columns, at ``u`` or the present state."""
        parts = map(Integrand, self.impulses.momentum(u))
        return dict(zip([*self._names("momentum"), SIZE], parts, strict=True))

    def foreign(self, names: Iterable[str]) -> list[str]:
        """Columns of impulses in an earlier part of the run that this part does not have."""
        names = set(names)
        return [name for quantity in self._others(names) for name in self._names(quantity) if name in names]

    def _others(self, names: Iterable[str]) -> list[str]:
        first = column("", self.motions[0])
        impulses = [n.removesuffix(first) for n in names if n.startswith(IMPULSE) and n.endswith(first)]
        return sorted(set(impulses) - {*self._given, *self._at_once})

    def keep(self, names: Iterable[str]) -> None:
        """Add columns for the impulses in ``names`` that this part of the run does not have."""
        self._at_once += self._others(names)

    def forces(self) -> dict[str, float]:
        """Forces, N, and torques, N m, at the present stage, by the names of their impulses' columns."""
        return self._named({name: values.tolist() for name, values in self.impulses().items()})

    def force_densities(self, u: Fields) -> dict[str, list[Integrand]]:
        """Integrands of ``forces`` at ``u``, by columns; the rows of the residual, a part of the walls'
        impulses, are left out."""
        return self._named(self.impulses.integrands(u))

    def _named(self, of_causes: Mapping[str, Sequence[OfMotion]]) -> dict[str, OfMotion]:
        """Values by columns, from values for each motion by the names of impulses and of ``DEFECTS``."""
        by_columns: dict[str, OfMotion] = {}
        for name, values in of_causes.items():
            quantity = f"defect_{name}" if name in DEFECTS else IMPULSE + name
            by_columns |= dict(zip(self._names(quantity), values, strict=True))
        return by_columns

    @property
    def of_steps(self) -> list[str]:
        """Columns whose value in a step is the step's length times the mean of ``forces`` over the stages."""
        return [name for quantity in (*self._given, *_PARTS) for name in self._names(quantity)]

    @property
    def held(self) -> dict[str, int]:
        """The columns of the impulse of walls that hold v, and the number of each column's motion."""
        name = IMPULSE + HELD_BY_WALLS
        return {column: i for i, column in enumerate(self._names(name))} if name in self._given else {}

    @property
    def balances(self) -> dict[str, tuple[str, list[str]]]:
        """For each column of the defect, the columns of the momentum and of the impulses: the defect is the
        change of the momentum less the sum of the impulses."""
        impulses = [self._names(quantity) for quantity in self._given]
        names = zip(self._names("momentum"), *impulses, strict=True)
        return {
            defect: (momentum, list(of_defect))
            for defect, (momentum, *of_defect) in zip(self._names(DEFECT), names, strict=True)
        }

    def transferred(self, before: Mapping[str, float], after: Mapping[str, float]) -> dict[str, float]:
        """The impulse of a transfer, by columns, from the rows before and after the transfer."""
        change = self._array(after, "momentum") - self._array(before, "momentum")
        return dict(zip(self._names(TRANSFERRED), map(float, change), strict=True))

    def start(self, values: Mapping[str, float]) -> dict[str, float]:
        """The columns of a run's first row, in which all impulses and defects are zero."""
        return dict.fromkeys(self.columns, 0.0) | {name: values[name] for name in self.densities()}

    def row(self, values: Mapping[str, float], tau: float, at_end: np.ndarray | None) -> dict[str, float]:
        """The columns of a step over ``tau``, s.

        ``values`` are integrals of the state, forces as means over the step's stages, and impulses of a
        transfer before the step; ``at_end`` is the walls' reaction in the rows of v at the step's end, N.
        """
        row = {name: values[name] for name in (*self._names("momentum"), SIZE)}
        for quantity in (*self._given, *_PARTS):
            row |= {name: tau * values.get(name, 0.0) for name in self._names(quantity)}
        for quantity in self._at_once:
            row |= {name: values.get(name, 0.0) for name in self._names(quantity)}
        if at_end is not None and IMPULSE + HELD_BY_WALLS in self._given:
            names = self._names(IMPULSE + HELD_BY_WALLS)
            for name, force in zip(names, self.impulses.of_rows(at_end), strict=True):
                row[name] += tau * float(force)
        impulses = [self._array(row, quantity) for quantity in (*self._given, *self._at_once)]
        defect = self._array(row, "momentum") - self._totals.last - sum(impulses, np.zeros(len(self.motions)))
        row |= dict(zip(self._names(DEFECT), map(float, defect), strict=True))
        totals = self._added(row | {"stored": values["stored"], "dt": tau})
        # in a direction without a load two rounding errors remain: the error of impulses in other directions,
        # and the error of walls that clamp a body under stress, although the walls' reactions add up to zero
        rounding = _ROUNDING * ((totals.exchanged / self._reach).max(initial=0.0) + totals.stressed)
        moving = totals.moving + values["mass"] * self._velocity() + rounding
        # a defect may be larger than the whole momentum. If one material fills the domain, the walls bear
        # this defect, as they bear the stress. A body in other matter may be moved by it, against viscosity
        is_borne = self._is_alone & (abs(totals.defect) > self._reach * moving)
        borne = np.where(is_borne, self._reach * totals.stressed, 0.0)
        scale = self._reach * moving + totals.exchanged + borne
        row[RELATIVE] = float((abs(totals.defect) / np.where(scale > 0, scale, 1.0)).max())
        return row

    def _added(self, row: Mapping[str, float]) -> _Totals:
        """The totals after one more row."""
        before, exchanged = self._totals, self._totals.exchanged
        for quantity in self._given:
            exchanged = exchanged + abs(self._array(row, quantity))
        defect, moving = before.defect + self._array(row, DEFECT), max(before.moving, row[SIZE])
        stressed = before.stressed + abs(row["stored"]) * row["dt"] / self._length
        return _Totals(defect, exchanged, moving, stressed, self._array(row, "momentum"))

    def count(self, row: Mapping[str, float]) -> None:
        """Add the next row to the totals."""
        self._totals = self._added(row)

    def resume(self, rows: Iterable[Mapping[str, float]]) -> None:
        """Start the totals anew, and add ``rows`` to them."""
        zero = np.zeros(len(self.motions))
        self._totals = _Totals(zero, zero, 0.0, 0.0, zero)
        for row in rows:
            self.count(row)

    def check(self, row: Mapping[str, float]) -> None:
        """Warn, once, if a row's relative defect is larger than ``LOST``."""
        if self._has_warned or not row[RELATIVE] > LOST:
            return
        self._has_warned = True
        self._ranks.warn(self.said(row), MomentumWarning, stacklevel=4)

    def said(self, row: Mapping[str, float]) -> str:
        """The message about the momentum defect in a row."""
        parts = {where: float(np.abs(self._array(row, f"defect_{where}")).max()) for where in DEFECTS}
        where = max(parts, key=lambda name: parts[name])
        return (
            f"at t = {row['time']:.4g} s the scheme itself has created {row[RELATIVE]:.1%} of the "
            f"present momentum; in the last step the largest part came from {_CAUSES[where]}. Forces that "
            "belong to no load, wall or stress move the body, although the energy's ledger closes. Take a "
            "finer mesh where carried variables jump, and shorter steps"
        )


_PARTS = [f"defect_{where}" for where in DEFECTS]
_CAUSES = {
    "facets": "jumps of the state between cells (defect_facets)",
    "cells": "the quadrature in cells (defect_cells)",
    "inertia": "the skew form of inertia (defect_inertia)",
}
