"""Typical scales of a run, its dimensionless numbers, and what they say about dt and maxh."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from ngsolve import CF, Integrate

from ngvisco.forms.mesh_arrays import coordinates
from ngvisco.physics.material import Material, cauchy_stress
from ngvisco.physics.parameters import typical_value
from ngvisco.physics.pointwise import squares
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
    # constants of their own: derivatives by one variable must not see it within another
    state = np.asarray(CF(material.states(dim).components(values))(at)).reshape(1, -1)
    z = material.states(dim).tensors(lambda: CF(tuple(float(c) for c in state[0])))
    respond, phi, zeta = material.response(dim), None, None
    if respond is not None:
        answer = respond(state)
        phi = CF(float(answer.energy[0]))
        zeta = material.states(dim).tensors(lambda: CF(tuple(float(c) for c in answer.slope[0])))
    return np.asarray(cauchy_stress(material, z, zeta, phi)(at)).reshape(3, 3)


def rest_pressure(material: Material, dim: int) -> float:
    """-tr T/3 of the material at F = I, Pa."""
    return -float(np.trace(_stress(material, np.eye(3), dim))) / 3
