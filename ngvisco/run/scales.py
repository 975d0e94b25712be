"""Typical scales of a run, its dimensionless numbers, and what they say about dt and maxh."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from ngsolve import CF, CoefficientFunction, Integrate, Mesh

from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.forms.tension import unborne_weight
from ngvisco.forms.terms.momentum import Loading
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import cell_numbers
from ngvisco.physics.arrays import Array
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.defects import may_part
from ngvisco.physics.flow_rules.check import values_at_rest
from ngvisco.physics.material import Material, cauchy_stress, part_of
from ngvisco.physics.materials.network import Network
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.model import Model
from ngvisco.physics.parameters import Parameter, moduli_in, parameters_in
from ngvisco.physics.pointwise import evaluated, rest_state, squares
from ngvisco.physics.tensors import constant, square
from ngvisco.timestepping.scheme import TimeScheme, backward_euler, midpoint

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

_STEP = 1e-5
"""Strain of the differences from which moduli are taken."""
_AT_REST = 1e-12
"""Components of the variables that differ by less from those at rest do so by rounding."""
_FOLLOWED, _RELAXED, _ACROSS = 20, 5, 4
"""Steps in a wave's passage or in a relaxation time, and cells across the body, that are enough."""
_RINGING, _STIFF, _DENSER = 10.0, 1e4, 1e2
"""Cells that waves cross in a step, ratios of moduli and of densities, above which a step is hard."""


@dataclass(frozen=True)
class Scales:
    """Scales in SI units; what does not exist is inf (times) or 0 (speeds, viscosities).

    Of moduli that differ from place to place and from body to body, each by itself, those are taken that ask
    most of dt and maxh.
    """

    length: float
    """Shortest edge of the body's bounding box, m."""
    cell: float
    """Median size of a cell, m."""
    velocity: float
    """The run's typical velocity, m/s."""
    speeds: tuple[float, float]
    """Of the fastest longitudinal and the fastest shear waves at rest, m/s."""
    kinematic_viscosity: float
    """The least G_v/rho that is not zero, m^2/s."""
    maxwell: float
    """The shortest relaxation time of shear by creep, G_m/(2 G), s."""
    dt: float
    scheme: TimeScheme = field(default_factory=backward_euler)
    densities: float = 1.0
    """The largest over the least density at the start."""
    one_bulk_energy: bool = True
    """Whether all bodies have the same."""
    parting: str | None = None
    """Where variables that stand for one distortion may part, in words."""
    unborne: str | None = None
    """What the pressure of the start does not bear, where a law reads it, in words."""

    @property
    def numbers(self) -> dict[str, float]:
        """Dimensionless numbers by name; those that do not exist are left out."""
        fast, slow = self.speeds
        found = {"Courant, v dt/h": self.velocity * self.dt / self.cell}
        if fast > 0:
            found["Mach, v/c of longitudinal waves"] = self.velocity / fast
            found["Courant of longitudinal waves, c dt/h"] = fast * self.dt / self.cell
        if slow > 0:
            found["Mach of shear waves"] = self.velocity / slow
        if self.kinematic_viscosity > 0:
            found["Reynolds, rho v L/G_v"] = self.velocity * self.length / self.kinematic_viscosity
        if math.isfinite(self.maxwell):
            found["Deborah, Maxwell time v/L"] = self.maxwell * self.velocity / self.length
            found["Maxwell time/dt"] = self.maxwell / self.dt
        if fast > 0 and slow > 0:
            found["longitudinal over shear modulus, about K_e/G_e"] = (fast / slow) ** 2
        if self.densities > 1 + 1e-6:
            found["largest over least density"] = self.densities
        return found

    @property
    def advice(self) -> list[str]:
        """What to think of about dt and maxh; empty where nothing stands out."""
        fast, slow = self.speeds
        said = []
        wave, name = (slow, "shear") if slow > 0 else (fast, "longitudinal")
        if wave > 0 and self.dt * wave * _FOLLOWED > self.length:
            passage = self.length / wave
            does = "damps them" if self.scheme.order == 1 else "does not resolve them"
            said.append(
                f"{name} waves cross the body in {passage:.2g} s, {passage / self.dt:.2g} steps: the scheme "
                f"{self.scheme.name} {does}; to follow them take dt <= {passage / _FOLLOWED:.2g} s"
            )
        hard = fast * self.dt / self.cell
        if self.scheme.A == midpoint().A and hard > _RINGING:
            said.append(
                f"longitudinal waves cross {hard:.3g} cells a step, which {self.scheme.name} does not damp: "
                "they ring from step to step; take another scheme, the first steps by backward Euler "
                f"(time.startup = 2), or dt <= {_RINGING * self.cell / fast:.2g} s"
            )
        if slow > 0 and (fast / slow) ** 2 > _STIFF:
            said.append(
                f"the modulus of compression is {(fast / slow) ** 2:.2g} times that of shear: cells lock "
                "with k = 2 (take discretisation.k = 3), and steps are hard to solve; or take a smaller K_e"
            )
        is_denser = self.densities > _DENSER * (1 + 1e-6)
        if is_denser:
            said.append(
                f"densities differ {self.densities:.2g} times: where their boundary moves through cells what "
                "is light is thrown about, and steps are hard to solve; take a ratio up to "
                f"{_DENSER:g}, and what is light as viscous as the other"
            )
        if is_denser and not self.one_bulk_energy:
            said.append(
                "bodies of such densities have different bulk energies: few steps are solved; where it does "
                "not matter give all of them one, e.g. a medium beside ReferentialNeoHookean "
                'kind = "Custom" with energy = "K_e/2*(J + 1/J - 2)"'
            )
        if self.velocity * self.dt > self.cell:
            said.append(
                f"the body moves by {self.velocity * self.dt / self.cell:.2g} cells a step: steps are hard "
                f"to solve and upwinding smears; take dt <= {self.cell / self.velocity:.2g} s"
            )
        if self.maxwell < _RELAXED * self.dt * (1 - 1e-6):  # moduli are differences
            said.append(
                f"stress relaxes in {self.maxwell:.2g} s, {self.maxwell / self.dt:.2g} steps: only the end "
                f"of its relaxation is seen; to follow it take dt <= {self.maxwell / _RELAXED:.2g} s"
            )
        said += filter(None, (self.parting, self.unborne))
        layer = math.sqrt(self.kinematic_viscosity * self.length / self.velocity)
        if self.cell * _ACROSS > self.length:
            across, enough = self.length / self.cell, self.length / _ACROSS
            said.append(f"{across:.1f} cells across the body: take maxh <= {enough:.2g} m")
        elif 0 < layer < self.cell:
            said.append(
                f"viscous layers are {layer:.2g} m thick, thinner than a cell: where they matter take maxh "
                f"or refine <= {layer / 2:.2g} m"
            )
        return said


def scales(simulation: Simulation) -> Scales:
    """The scales of a simulation at its present state, the initial one of a run that has not begun."""
    mesh, step = simulation.mesh, simulation.rothe_step
    places = extreme_places(step, simulation.sampler)
    if not places:
        mass = float(step.quadrature.integrate_cells(step.now.rho))
        places = [Place(step.model, {}, mass / Integrate(CF(1.0), mesh), np.empty(0))]
    fast, slow, viscosities, maxwell = zip(*(place.scales(mesh.dim) for place in places), strict=True)
    least, most = simulation.sampler.extrema(step.now.rho)
    material = step.model.material
    return Scales(
        length=float(np.ptp(coordinates(mesh), axis=0).min()),
        cell=float(np.median(step.context.h.vec.FV().NumPy())),
        velocity=simulation.velocity_scale,
        speeds=(max(fast), max(slow)),
        kinematic_viscosity=min((value for value in viscosities if value > 0), default=0.0),
        maxwell=min(maxwell),
        dt=simulation.dt,
        scheme=simulation.scheme,
        densities=most / least,
        one_bulk_energy=not isinstance(material, Mixture) or material.has_one_volume,
        unborne=unborne_weight(step, simulation.sampler),
        parting=may_part(material, bool(step.moving_walls.moving), step.discretisation.m),
    )


@dataclass(frozen=True)
class Place:
    """Laws at a point, of one body alone where there are bodies, with the values that parameters have."""

    laws: Model
    parameters: dict[str, float]
    density: float
    """kg/m^3."""
    state: np.ndarray
    """Components of the material's variables, (n,)."""

    def scales(self, dim: int) -> tuple[float, float, float, float]:
        """Speeds of longitudinal and shear waves, m/s, G_v/rho, m^2/s, and the Maxwell time, s, at F = I."""
        viscosity, creep, z = self.laws.viscosity, self.laws.creep, self.parameters
        rest = values_at_rest(self.laws.material, z)
        thickness: Any = 0.0 if viscosity is None else viscosity.shear_viscosity(rest)
        longitudinal, shear = moduli(self.laws.material, dim, z)
        maxwell, network = math.inf, part_of(self.laws.material, Network)
        if creep is not None and creep.flows and shear > 0:
            maxwell = creep.relaxation_time(shear, rest)
        for branch in () if network is None else network.parts.values():
            _, own = moduli(branch.material, dim, z)
            if branch.creep is not None and branch.creep.flows and own > 0:
                maxwell = min(maxwell, branch.creep.relaxation_time(own, rest))
        return (
            math.sqrt(max(longitudinal, 0.0) / self.density),
            math.sqrt(max(shear, 0.0) / self.density),
            float(np.max(thickness.value if isinstance(thickness, Array) else thickness)) / self.density,
            maxwell,
        )


def extreme_places(step: Step, sampler: Sampler) -> list[Place]:
    """Where each parameter is least and where it is largest, the same places on all ranks.

    With bodies those of each body, among the points where there is most of it, at which it is then alone; a
    body without parameters has one place.  None where there are neither parameters nor bodies.
    """
    u, material, slices = step.now, step.model.material, step.layout.states.slices
    carried = [v.name for v in material.variables if isinstance(v, Parameter)]
    bodies = material.bodies if isinstance(material, Mixture) else ()
    if not (carried or bodies):
        return []
    own = cell_numbers(step.mesh)[sampler.cells]
    order = np.argsort(np.concatenate(sampler.ranks.gathered(own)), kind="stable")

    def everywhere(f: CoefficientFunction) -> np.ndarray:
        """At the points of all ranks, in the order of one process: what is equal is met there first."""
        return np.concatenate(sampler.ranks.gathered(np.asarray(sampler.values(f))))[order]

    values, rho = {name: everywhere(u.z_tensors[name]) for name in carried}, everywhere(u.rho)
    states = everywhere(u.z).reshape(len(rho), -1)

    def chosen(names: Sequence[str], among: np.ndarray, usual: int = 0) -> dict[int, dict[str, float]]:
        """Points at which one of the named values is least or largest, and all values there.

        Values that differ by rounding count once: an end is often taken along a line.
        """
        found: dict[int, dict[str, float]] = {}
        ends = [values[name][among] for name in names]
        for i in sorted({int(among[at]) for v in ends for at in (v.argmin(), v.argmax())}) or [usual]:
            here = {name: float(value[i]) for name, value in values.items()}
            if not any(np.allclose(list(here.values()), list(z.values()), 1e-6, 0) for z in found.values()):
                found[i] = here
        return found

    if not isinstance(material, Mixture):
        points = chosen(carried, np.arange(len(rho)))
        return [Place(step.model, z, float(rho[i]), states[i]) for i, z in points.items()]
    amounts = states[:, [slices[AMOUNT + body.name].start for body in bodies]]
    total, most, kept = amounts.sum(axis=1), amounts.argmax(axis=1), ~step.layout.states.by_flux
    places = []
    for number, body in enumerate(bodies):
        names = [p.name for p in parameters_in((body,))]
        names += [v.name for v in body.material.variables if isinstance(v, Parameter)]
        among = np.flatnonzero(most == number)
        if not len(among):  # it is smaller than a cell
            among = amounts[:, [number]].argmax(axis=0)
        alone = np.zeros(states.shape[1])
        for variable in material.densities(body.name):
            alone[slices[variable.name]] = 1.0
        laws = Model(material=body.material, viscosity=body.viscosity, creep=body.creep)
        for i, z in chosen(names, among, int(among[amounts[among, number].argmax()])).items():
            state = states[i] * alone * (total[i] / amounts[i, number])
            state[kept] = states[i, kept]
            places.append(Place(laws, z, (body.density or 0.0) * float(total[i]), state))
    return places


def moduli(
    material: Material, dim: int, parameters: Mapping[str, float] | None = None
) -> tuple[float, float]:
    """dT_11/dF_11 and dT_12/dF_12 at F = I, Pa: moduli of longitudinal and of shear waves.

    Carried parameters have the values in ``parameters``, by default their typical ones.
    """
    state = _rest(material, dim, parameters or {})
    longitudinal, shear = (acoustic_tensor(material, state, dim, j)[0, 0] for j in (0, 1))
    return float(longitudinal), float(shear)


def _rest(material: Material, dim: int, parameters: Mapping[str, float]) -> np.ndarray:
    state, slices = rest_state(material, dim), material.states(dim).slices
    for name in slices.keys() & parameters.keys():
        state[slices[name]] = parameters[name]
    return state


def stress_of(material: Material, state: np.ndarray, dim: int) -> np.ndarray:
    """The Cauchy stress of a state's components, (n,): 3x3, Pa."""
    # constants of their own: derivatives by one variable must not see it within another
    at, state = squares(1)[1], state.reshape(1, -1)
    z = material.states(dim).tensors(lambda: CF(tuple(float(c) for c in state[0])))
    respond, phi, zeta = material.response(dim), None, None
    if respond is not None:
        answer = respond(state)
        phi = CF(float(answer.energy[0]))
        zeta = material.states(dim).tensors(lambda: CF(tuple(float(c) for c in answer.slope[0])))
    return np.asarray(cauchy_stress(material, z, zeta, phi)(at)).reshape(3, 3)


def acoustic_tensor(material: Material, state: np.ndarray, dim: int, j: int) -> np.ndarray:
    """Q, Pa, of a state's components, (n,), and the direction n = e_j: Q a = (dT/dz : rate(a x n; z)) n,
    whatever the variables are."""
    states, zero, Q = material.states(dim), constant(np.zeros((3, 3))), np.empty((dim, dim))
    for i in range(dim):
        unit = np.zeros((3, 3))
        unit[i, j] = 1.0
        a_n = constant(unit)

        def rates(c: CoefficientFunction, L: CoefficientFunction = a_n) -> CoefficientFunction:
            z = states.tensors(lambda: c)
            return states.components({v.name: v.rate(z, L, zero) for v in material.variables})

        change = _STEP * evaluated(rates, state[None])[0]
        ends = [stress_of(material, state + sign * change, dim)[:dim, j] for sign in (1, -1)]
        Q[:, i] = (ends[0] - ends[1]) / (2 * _STEP)
    return Q


def wave_speed(step: Step, state: np.ndarray, density: float) -> float:
    """The speed of the fastest plane wave along an axis of small amplitude about a state, m/s; 0 without any.

    ``state`` are the components of the material's variables, (n,); ``density`` is in kg/m^3.
    """
    dim, fastest = step.mesh.dim, 0.0
    for j in range(dim):
        Q = acoustic_tensor(step.model.material, state, dim, j)
        if np.isfinite(Q).all():
            fastest = max(fastest, float(np.linalg.eigvals(Q).real.max()))
    return math.sqrt(fastest / density)


def rest_pressure(material: Material, dim: int) -> float:
    """-tr T/3 of the material at F = I, Pa."""
    return -float(np.trace(stress_of(material, _rest(material, dim, {}), dim))) / 3


def typical_velocity(step: Step, sampler: Sampler, dt: float) -> float:
    """How fast a run will be, m/s, by its state at the start and its step length ``dt``, s.

    The largest of what moves, of free fall and of elastic release; where all is at rest a tenth of the speed
    of sound.
    """
    u, model, ranks = step.now, step.model, sampler.ranks
    speed = math.sqrt(sampler.extrema(square(u.v))[1])
    length, fall = diameter(step.mesh, ranks), 0.0
    for load in model.loads:
        acceleration = square(Loading(load, step.mesh.dim).force(u) / u.rho)
        largest = math.sqrt(sampler.extrema(acceleration)[1])
        fall = max(fall, math.sqrt(largest * length))
    rest = model.material.at_rest(u.z_tensors)
    least = sampler.extrema(u.rho)[0]
    places = extreme_places(step, sampler)
    strains = [abs(sampler.values(u.z_tensors[name] - value)).max(initial=0) for name, value in rest.items()]
    elastic = 0.0
    if ranks.most(np.array(strains)) > _AT_REST:  # an energy's rounding is no elastic release
        excess = step.energy.samples(u.z_tensors, sampler) - step.energy.samples(rest, sampler)
        # energy that a place has stored moves the mass of that place
        inertia = np.asarray(sampler.values(u.rho)).reshape(excess.shape) if places else least
        elastic = math.sqrt(2 * ranks.most(abs(excess) / inertia))
    walls = step.moving_walls.velocities().values()
    moving = ranks.most(np.concatenate([np.zeros(1), *(abs(v).ravel() for v in walls)]))
    # the smoothed upwinding spreads jumps at its width: by 1e-4 of the domain a step, at most
    farthest = length / dt
    known = max(speed, moving, min(max(fall, elastic), farthest))
    if known > 0:
        return known
    # at rest, and nothing says how fast it will be: strains of a tenth
    if places:
        return min(0.1 * max(wave_speed(step, p.state, p.density) for p in places), farthest) or 1.0
    own = np.asarray(sampler.values(u.z)).reshape(-1, step.layout.states.size)
    state = np.concatenate(ranks.gathered(own))[0]
    return min(0.1 * wave_speed(step, state, least), farthest) or 1.0


def diameter(mesh: Mesh, ranks: Communicator) -> float:
    """Diagonal of a mesh's bounding box, m, of all ranks' parts."""
    sides = [ranks.most(along) - ranks.least(along) for along in coordinates(mesh).T]
    return float(np.linalg.norm(sides))


def cause_of_negative_power(step: Step, sampler: Sampler) -> str:
    """Why creep gives energy at a point, in words: a modulus of the wrong sign, or the rule.

    Collective; all ranks say the same.
    """
    for flow in step.model.flows:
        for name, expression, _ in moduli_in(flow.rule):
            least = sampler.extrema(expression.at(step.now.z_tensors))[0]
            if least < 0:
                return (
                    f"{name} is {least:.3g} at a point: a parameter that is carried as its arithmetic mean "
                    'overshoots where it jumps; nv.Parameter(mean="geometric") does not change its sign'
                )
    return "its flow rule is none"
