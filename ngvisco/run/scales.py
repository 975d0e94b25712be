"""Typical scales of a run, its dimensionless numbers, and what they say about dt and maxh."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from ngsolve import CF, Id, Integrate, Mesh

from ngvisco.forms.mesh_arrays import coordinates
from ngvisco.forms.momentum import Loading
from ngvisco.forms.sampling import Sampler
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.material import Material, cauchy_stress
from ngvisco.physics.parameters import typical_value
from ngvisco.physics.pointwise import squares
from ngvisco.physics.tensors import square
from ngvisco.timestepping.scheme import TimeScheme, backward_euler

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

_STEP = 1e-5
"""Strain of the differences from which moduli are taken."""
_FOLLOWED, _RELAXED, _ACROSS = 20, 5, 4
"""Steps in a wave's passage or in a relaxation time, and cells across the body, that are enough."""


@dataclass(frozen=True)
class Scales:
    """Scales in SI units; what does not exist is inf (times) or 0 (moduli, speeds).

    Attributes
    ----------
    length, cell : float
        Shortest edge of the body's bounding box, and median cell size, m.
    velocity : float
        The run's typical velocity, m/s: the largest of the initial one, of free fall, of elastic release.
    density : float
        Mean, kg/m^3.
    longitudinal, shear : float
        Moduli of longitudinal and shear waves at rest, Pa.
    viscosity : float
        Shear viscosity G_v, Pa s.
    maxwell : float
        Relaxation time of shear by creep, G_m/(2 G), s.
    dt : float
        s.
    scheme : TimeScheme
    """

    length: float
    cell: float
    velocity: float
    density: float
    longitudinal: float
    shear: float
    viscosity: float
    maxwell: float
    dt: float
    scheme: TimeScheme = field(default_factory=backward_euler)

    @property
    def speeds(self) -> tuple[float, float]:
        """Of longitudinal and of shear waves, m/s."""
        fast, slow = (
            math.sqrt(max(modulus, 0.0) / self.density) for modulus in (self.longitudinal, self.shear)
        )
        return fast, slow

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
        if self.viscosity > 0:
            found["Reynolds, rho v L/G_v"] = self.density * self.velocity * self.length / self.viscosity
        if math.isfinite(self.maxwell):
            found["Deborah, Maxwell time v/L"] = self.maxwell * self.velocity / self.length
            found["Maxwell time/dt"] = self.maxwell / self.dt
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
        layer = math.sqrt(self.viscosity * self.length / (self.density * self.velocity))
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
    """The scales of a simulation at its initial state, of parameters with their typical values."""
    mesh, model = simulation.mesh, simulation.model
    u = simulation.rothe_step.now
    volume = Integrate(CF(1.0), mesh)
    longitudinal, shear = moduli(model.material, mesh.dim)
    maxwell = math.inf
    if model.creep is not None and shear > 0 and model.creep.R > 0:
        maxwell = 1 / (2 * shear * model.creep.R)
    return Scales(
        length=float(np.ptp(coordinates(mesh), axis=0).min()),
        cell=float(np.median(simulation.rothe_step.context.h.vec.FV().NumPy())),
        velocity=simulation.velocity_scale,
        density=float(simulation.rothe_step.quadrature.integrate_cells(u.rho)) / volume,
        longitudinal=longitudinal,
        shear=shear,
        viscosity=0.0 if model.viscosity is None else typical_value(model.viscosity.G_v),
        maxwell=maxwell,
        dt=simulation.dt,
        scheme=simulation.scheme,
    )


def moduli(material: Material, dim: int) -> tuple[float, float]:
    """dT_11/dF_11 and dT_12/dF_12 at F = I, Pa: moduli of longitudinal and of shear waves."""
    found = []
    for i, j in ((0, 0), (0, 1)):
        ends = []
        for sign in (1, -1):
            F = np.eye(3)
            F[i, j] += sign * _STEP
            ends.append(_stress(material, F, dim)[i, j])
        found.append(float(ends[0] - ends[1]) / (2 * _STEP))
    return found[0], found[1]


def _stress(material: Material, F: np.ndarray, dim: int) -> np.ndarray:
    """The Cauchy stress of a homogeneous F, 3x3, Pa."""
    at = squares(1)[1]
    values = {v.name: v.from_distortion(CF(tuple(F.ravel()), dims=(3, 3))) for v in material.variables}
    return stress_of(material, np.asarray(CF(material.states(dim).components(values))(at)).ravel(), dim)


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


def wave_speed(step: Step, state: np.ndarray, density: float) -> float:
    """The speed of the fastest plane wave along an axis of small amplitude about a state, m/s; 0 without any.

    The acoustic tensor of the direction n is Q a = (dT/dz : rate(a x n; z)) n, whatever the variables are.

    Parameters
    ----------
    step : Step
    state : (n,) array
        Components of the material's variables.
    density : float
        kg/m^3.
    """
    material, dim = step.model.material, step.mesh.dim
    columns = step.tabulated_rates.tensors.columns(state[:, None])[0]
    fastest = 0.0
    for j in range(dim):
        Q = np.empty((dim, dim))
        for i in range(dim):
            change = _STEP * columns[:, dim * i + j]
            ends = [stress_of(material, state + sign * change, dim)[:dim, j] for sign in (1, -1)]
            Q[:, i] = (ends[0] - ends[1]) / (2 * _STEP)
        if np.isfinite(Q).all():
            fastest = max(fastest, float(np.linalg.eigvals(Q).real.max()))
    return math.sqrt(fastest / density)


def rest_pressure(material: Material, dim: int) -> float:
    """-tr T/3 of the material at F = I, Pa."""
    return -float(np.trace(_stress(material, np.eye(3), dim))) / 3


def typical_velocity(step: Step, sampler: Sampler, dt: float) -> float:
    """How fast a run will be, m/s, by its state at the start: the largest of what moves, of free fall and of
    elastic release; where all is at rest a tenth of the speed of sound.

    Parameters
    ----------
    step : Step
        At the start values, ``ngvisco.time`` that of the start.
    sampler : Sampler
    dt : float
        Length of a step, s.
    """
    u, model, ranks = step.now, step.model, sampler.ranks
    speed = math.sqrt(sampler.extrema(square(u.v))[1])
    length, fall = diameter(step.mesh, ranks), 0.0
    for load in model.loads:
        acceleration = square(Loading(load, step.mesh.dim).force(u) / u.rho)
        largest = math.sqrt(sampler.extrema(acceleration)[1])
        fall = max(fall, math.sqrt(largest * length))
    rest = {
        v.name: v.from_distortion(Id(3)) if v.is_strain else u.z_tensors[v.name]
        for v in model.material.variables
    }
    excess = step.energy.samples(u.z_tensors, sampler) - step.energy.samples(rest, sampler)
    least = sampler.extrema(u.rho)[0]
    elastic = math.sqrt(2 * ranks.most(abs(excess)) / least)
    walls = step.moving_walls.velocities().values()
    moving = ranks.most(np.concatenate([np.zeros(1), *(abs(v).ravel() for v in walls)]))
    # the smoothed upwinding spreads jumps at its width: by 1e-4 of the domain a step, at most
    farthest = length / dt
    known = max(speed, moving, min(max(fall, elastic), farthest))
    if known > 0:
        return known
    # at rest, and nothing says how fast it will be: strains of a tenth
    own = np.asarray(sampler.values(u.z)).reshape(-1, step.layout.states.size)
    state = np.concatenate(ranks.gathered(own))[0]
    return min(0.1 * wave_speed(step, state, least), farthest) or 1.0


def diameter(mesh: Mesh, ranks: Communicator) -> float:
    """Diagonal of a mesh's bounding box, m, of all ranks' parts."""
    sides = [ranks.most(along) - ranks.least(along) for along in coordinates(mesh).T]
    return float(np.linalg.norm(sides))
