"""What is measured of each body of a run: mass, place, energies, dissipation, extent."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from ngsolve import CF, CoefficientFunction, x, y, z

from ngvisco.errors import ParameterError
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import inner, sym
from ngvisco.run.series import Series

if TYPE_CHECKING:
    from ngvisco.forms.system import Step
    from ngvisco.run.simulation import Simulation

_HALF = 0.5
"""Fraction from which on a point counts to a body's extent."""

UNITS = {"mass": "kg", "volume": "m^d", "kinetic": "J", "stored": "J", "dissipation": "W"}


class Bodies(Series):
    """Each body of a model over time.

    Parameters
    ----------
    path : path, optional
        CSV file; without one the rows are kept in memory only.
    every : int
        Every so many steps, and at the end.

    The columns are ``step``, ``time`` (s), and for each body, with theta its volume fraction and n its amount
    per volume, in SI units, per metre of thickness in plane strain:

    | column | meaning |
    |---|---|
    | ``NAME_mass`` | int rho_R n, kg; constant to rounding |
    | ``NAME_volume`` | int theta, m^d |
    | ``NAME_x``, ``_y``, ``_z`` | centroid int theta x over the volume, m |
    | ``NAME_momentum_x``, ... | int rho_R n v, kg m/s |
    | ``NAME_kinetic``, ``NAME_stored`` | kinetic, J; shear, n U(1) and theta of what else is in V, J |
    | ``NAME_dissipation`` | of viscosity and creep, of the present (limited) state, W |
    | ``NAME_x_min``, ``NAME_x_max``, ... | where theta >= 1/2 at points of cells, m; NaN without any |

    In a run's HDF5 file (``Checkpoints``) they are the group ``bodies``.
    A run raises ParameterError for a model without bodies.
    """

    group = "bodies"

    def __init__(self, path: str | os.PathLike[str] | None = None, every: int = 1) -> None:
        super().__init__(path, every)

    def prepare(self, simulation: Simulation) -> list[str]:
        step, material = simulation.rothe_step, simulation.model.material
        if not isinstance(material, Mixture):
            expected = "bodies, Model(bodies=[...]), which it would measure"
            raise ParameterError("Bodies.model", type(material).__name__, expected)
        axes = "xyz"[: simulation.mesh.dim]
        self._names = [body.name for body in material.bodies]
        quantities = ["mass", "volume", *axes, *(f"momentum_{axis}" for axis in axes)]
        quantities += ["kinetic", "stored", "dissipation"]
        self._integrand = CF(tuple(part for name in self._names for part in _integrands(step, name)))
        theta = material.fractions.at(step.now.z_tensors)
        self._theta = CF(tuple(theta[name] for name in self._names))
        sampler = simulation.sampler
        self._places = sampler.coordinates(np.arange(len(sampler.points)))
        quantities += [f"{axis}_{end}" for axis in axes for end in ("min", "max")]
        return [f"{name}_{quantity}" for name in self._names for quantity in quantities]

    def unit(self, column: str) -> str:
        """SI unit of a column (per metre of thickness in plane strain)."""
        if column in ("step", "time"):
            return {"step": "1", "time": "s"}[column]
        name = next(name for name in sorted(self._names, key=len)[::-1] if column.startswith(f"{name}_"))
        quantity = column[len(name) + 1 :]
        return "kg m/s" if quantity.startswith("momentum") else UNITS.get(quantity, "m")

    def _sample(self, simulation: Simulation) -> Any:
        dim = simulation.mesh.dim
        simulation.rothe_step.eliminate.refresh()
        totals = np.asarray(simulation.rothe_step.quadrature.integrate_cells(self._integrand), dtype=float)
        values = totals.reshape(len(self._names), -1)
        values[:, 2 : 2 + dim] /= np.where(values[:, 1:2] > 0, values[:, 1:2], np.nan)
        there = simulation.sampler.rows(self._theta).T >= _HALF
        # the least as the largest of the negative ones: a rank may have none
        ends = np.array([_ends(self._places[where]) for where in there])
        low, high = np.moveaxis(simulation.ranks.largest(ends), 1, 0)
        extents = np.stack([-low, high], axis=-1).reshape(len(self._names), -1)
        extents[np.isinf(extents)] = np.nan
        return [np.hstack([values, extents]).ravel()]


def _integrands(step: Step, name: str) -> list[CoefficientFunction]:
    """Of a body: densities of mass, volume, first moments, momentum, energies and dissipation."""
    u, material = step.now, step.model.material
    assert isinstance(material, Mixture)
    body = next(body for body in material.bodies if body.name == name)
    values, theta = u.z_tensors, material.fractions.at(u.z_tensors)[name]
    mass = (body.density or 0.0) * values[AMOUNT + name]
    place, v = (x, y, z)[: step.mesh.dim], u.v
    loss = CF(0.0)
    if body.viscosity is not None:
        eps, read = sym(u.L), step.context.rates.read_values(body.viscosity, u)
        share = material.fractions.not_negative(values)[name]
        loss = loss + share * body.viscosity.bulk_dissipation(eps, read)
        loss = loss + share * body.viscosity.shear_dissipation(eps, read)
    rates = step.context.rates
    for flow in rates.flows:
        if flow.body == name:
            loss = loss + rates.power_of_creep(flow, rates.local_creep(flow, u), u)
    shears, rest = material.shears(values), material.volumes_at_rest(values)
    of_volume = rates.stored(u) - sum((*shears.values(), *rest.values()), CF(0.0))
    return [
        mass,
        theta,
        *(theta * coordinate for coordinate in place),
        *(mass * v[i] for i in range(step.mesh.dim)),
        0.5 * mass * inner(v, v),
        shears.get(name, CF(0.0)) + rest[name] + theta * of_volume,
        loss,
    ]


def _ends(places: np.ndarray) -> np.ndarray:
    """Largest negative and largest coordinate along each axis, (2, dim); -inf without any place."""
    return np.stack([(-places).max(axis=0, initial=-np.inf), places.max(axis=0, initial=-np.inf)])
