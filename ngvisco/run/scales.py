"""Sizes, velocities and accelerations of a run, and the points where its laws need the smallest dt and
maxh."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngvisco.forms.boundary.boundaries import axis_parallel_walls, periodic_boundaries
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.forms.terms.momentum import Loading
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import cell_numbers
from ngvisco.physics.arrays import Array
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.flow_rules.check import values_at_rest
from ngvisco.physics.material import part_of
from ngvisco.physics.materials.network import Network
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.model import Model
from ngvisco.physics.parameters import Parameter, parameters_in
from ngvisco.physics.tensors import square
from ngvisco.run.waves import moduli, wave_speed

_AT_REST = 1e-12
"""Largest difference between a variable and its value at rest that counts as rounding."""


def edges_of(step: Step, ranks: Communicator) -> list[float]:
    """Edges of the domain's bounding box, m, without periodic directions."""
    sides = [ranks.most(along) - ranks.least(along) for along in coordinates(step.mesh).T]
    if not step.layout.periodic:
        return sides
    normals, _ = axis_parallel_walls(step.mesh)
    periodic = periodic_boundaries(step.mesh)
    between_walls = [
        side
        for side, names in zip(sides, normals, strict=True)
        if not names or not periodic.issuperset(names)
    ]
    return between_walls or sides


def largest_acceleration(step: Step, sampler: Sampler) -> float:
    """The largest acceleration that a load gives at the present state, m/s^2."""
    u, largest = step.now, 0.0
    for load in step.model.loads:
        square_of = square(Loading(load, step.mesh.dim).force(u) / u.rho)
        largest = max(largest, math.sqrt(sampler.extrema(square_of)[1]))
    return largest


@dataclass(frozen=True)
class ExtremePlace:
    """Laws and values of parameters at a point; with bodies the laws are those of one body alone."""

    laws: Model
    parameters: dict[str, float]
    density: float
    """Mass density, kg/m^3."""
    state: np.ndarray
    """Components of the material's variables, (n,)."""

    def overstress(self, rate: float) -> float:
        """Ratio of the stress beyond the yield stress to the yield stress, at a ``rate`` of shear, 1/s; 0
        without yield."""
        creep = self.laws.creep
        if creep is None:
            return 0.0
        return creep.overstress(rate, values_at_rest(self.laws.material, self.parameters))

    def scales(self, dim: int) -> tuple[float, float, float, float]:
        """Speeds of longitudinal and shear waves, m/s, G_v/rho, m^2/s, and the Maxwell time, s, at F = I."""
        viscosity, creep, z = self.laws.viscosity, self.laws.creep, self.parameters
        rest_values = values_at_rest(self.laws.material, z)
        thickness: Any = 0.0 if viscosity is None else viscosity.shear_viscosity(rest_values)
        longitudinal, shear = moduli(self.laws.material, dim, z)
        maxwell, network = math.inf, part_of(self.laws.material, Network)
        if creep is not None and creep.flows and shear > 0:
            maxwell = creep.relaxation_time(shear, rest_values)
        for branch in () if network is None else network.parts.values():
            _, branch_shear = moduli(branch.material, dim, z)
            if branch.creep is not None and branch.creep.flows and branch_shear > 0:
                maxwell = min(maxwell, branch.creep.relaxation_time(branch_shear, rest_values))
        return (
            math.sqrt(max(longitudinal, 0.0) / self.density),
            math.sqrt(max(shear, 0.0) / self.density),
            float(np.max(thickness.value if isinstance(thickness, Array) else thickness)) / self.density,
            maxwell,
        )


def extreme_places(step: Step, sampler: Sampler) -> list[ExtremePlace]:
    """The places where a parameter is least or largest; all ranks return the same places.

    With bodies each body has its own places, among the points where its amount is the largest; the laws there
    are those of the body alone.  A body without parameters has one place.  The result is empty without
    parameters and bodies.
    """
    u, material, slices = step.now, step.model.material, step.layout.states.slices
    carried = [v.name for v in material.variables if isinstance(v, Parameter)]
    bodies = material.bodies if isinstance(material, Mixture) else ()
    if not (carried or bodies):
        return []
    numbers = cell_numbers(step.mesh)[sampler.cells]
    order = np.argsort(np.concatenate(sampler.ranks.gathered(numbers)), kind="stable")

    def everywhere(f: CoefficientFunction) -> np.ndarray:
        """Values of f at all ranks' points, in the order of one process, so that the choice among equal
        values does not depend on ranks."""
        return np.concatenate(sampler.ranks.gathered(np.asarray(sampler.values(f))))[order]

    values, rho = {name: everywhere(u.z_tensors[name]) for name in carried}, everywhere(u.rho)
    states = everywhere(u.z).reshape(len(rho), -1)

    def chosen(names: Sequence[str], among: np.ndarray, usual: int = 0) -> dict[int, dict[str, float]]:
        """Points at which one of the named values is least or largest, and the values of all names there.

        Points whose values differ by rounding count once, since a whole line often has the least value.
        """
        places: dict[int, dict[str, float]] = {}
        ends = [values[name][among] for name in names]
        for i in sorted({int(among[at]) for v in ends for at in (v.argmin(), v.argmax())}) or [usual]:
            here = {name: float(value[i]) for name, value in values.items()}
            if not any(np.allclose(list(here.values()), list(z.values()), 1e-6, 0) for z in places.values()):
                places[i] = here
        return places

    if not isinstance(material, Mixture):
        points = chosen(carried, np.arange(len(rho)))
        return [ExtremePlace(step.model, z, float(rho[i]), states[i]) for i, z in points.items()]
    amounts = states[:, [slices[AMOUNT + body.name].start for body in bodies]]
    total, most, kept = amounts.sum(axis=1), amounts.argmax(axis=1), ~step.layout.states.by_flux
    places = []
    for number, body in enumerate(bodies):
        names = [p.name for p in parameters_in((body,))]
        own = material.own_names(body.name)
        names += [own.get(v.name, v.name) for v in body.material.variables if isinstance(v, Parameter)]
        among = np.flatnonzero(most == number)
        # another body has the larger share in every cell, because the body is smaller than a cell
        if not len(among):
            among = amounts[:, [number]].argmax(axis=0)
        alone = np.zeros(states.shape[1])
        for variable in material.densities(body.name):
            alone[slices[variable.name]] = 1.0
        laws = Model(material=body.material, viscosity=body.viscosity, creep=body.creep)
        for i, z in chosen(names, among, int(among[amounts[among, number].argmax()])).items():
            state = states[i] * alone * (total[i] / amounts[i, number])
            state[kept] = states[i, kept]
            z |= {name: z[carried_name] for name, carried_name in own.items()}
            places.append(ExtremePlace(laws, z, (body.density or 0.0) * float(total[i]), state))
    return places


def typical_velocity(step: Step, sampler: Sampler, dt: float) -> float:
    """The velocity to be expected in a run, m/s, from its start and its step length ``dt``, s.

    The result is the largest velocity of the start, of walls, of free fall and of elastic release.  Free fall
    and elastic release count with at most the velocity that crosses the domain in a step.  If all of these
    velocities are 0, the result is a tenth of the speed of waves, with the same bound; without waves it is 1.
    """
    u, model, ranks = step.now, step.model, sampler.ranks
    speed = math.sqrt(sampler.extrema(square(u.v))[1])
    length = diameter(step.mesh, ranks)
    fall = math.sqrt(largest_acceleration(step, sampler) * length)
    values_at_rest = model.material.at_rest(u.z_tensors)
    least = sampler.extrema(u.rho)[0]
    places = extreme_places(step, sampler)
    strains = [
        abs(sampler.values(u.z_tensors[name] - value)).max(initial=0)
        for name, value in values_at_rest.items()
    ]
    elastic = 0.0
    # rounding of the energy at rest gives no elastic release
    if ranks.most(np.array(strains)) > _AT_REST:
        excess = step.energy.samples(u.z_tensors, sampler) - step.energy.samples(values_at_rest, sampler)
        # the stored energy at a place accelerates the mass at the same place
        inertia = np.asarray(sampler.values(u.rho)).reshape(excess.shape) if places else least
        elastic = math.sqrt(2 * ranks.most(abs(excess) / inertia))
    walls = step.moving_walls.velocities().values()
    moving = ranks.most(np.concatenate([np.zeros(1), *(abs(v).ravel() for v in walls)]))
    # gravity and elastic energy move matter at most across the domain in a step
    farthest = length / dt
    typical = max(speed, moving, min(max(fall, elastic), farthest))
    if typical > 0:
        return typical
    # a body at rest has no velocity scale: strains of a tenth are assumed
    return min(0.1 * fastest_wave(step, sampler), farthest) or 1.0


def fastest_wave(step: Step, sampler: Sampler) -> float:
    """The largest speed of a plane wave at a place of ``extreme_places``, or else at the first point, m/s."""
    if places := extreme_places(step, sampler):
        return max(wave_speed(step, p.state, p.density) for p in places)
    states = np.asarray(sampler.values(step.now.z)).reshape(-1, step.layout.states.size)
    first = np.concatenate(sampler.ranks.gathered(cell_numbers(step.mesh)[sampler.cells])).argmin()
    state = np.concatenate(sampler.ranks.gathered(states))[first]
    return wave_speed(step, state, sampler.extrema(step.now.rho)[0])


def diameter(mesh: Mesh, ranks: Communicator) -> float:
    """Diagonal of the bounding box of the whole mesh over all ranks, m."""
    return float(np.linalg.norm([ranks.most(along) - ranks.least(along) for along in coordinates(mesh).T]))
