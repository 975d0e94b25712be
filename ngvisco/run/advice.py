"""Scales of a run, the run's dimensionless numbers, and advice from these about dt, maxh and the material."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from ngsolve import CF, Integrate

from ngvisco.errors import InputWarning
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.sharpening import FAR
from ngvisco.forms.system import Step
from ngvisco.forms.tension import unborne_weight
from ngvisco.physics.defects import may_part
from ngvisco.physics.material import part_of
from ngvisco.physics.materials.thermal import Thermal, temperature
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import is_even, square
from ngvisco.run.scales import ExtremePlace, edges_of, extreme_places, largest_acceleration
from ngvisco.run.state import RunState
from ngvisco.timestepping.scheme import TimeScheme, backward_euler, midpoint

_FOLLOWED, _RELAXED, _ACROSS = 20, 5, 4
"""Sufficient numbers of steps in a wave's passage and in a relaxation time, and of cells across a body."""
_RINGING, _STIFF, _DENSER = 10.0, 1e4, 1e2
"""Number of cells that waves cross in a step, ratio of moduli, and ratio of densities; above these values a
step is hard to solve."""
_LOCKS = 10.0
"""Ratio of moduli above which cells of order one lock: with 20 a disc stands still in a fluid in which it
sinks.  Cells with k = 2 damp a flow if the ratio of the modulus to rho v^2 is above the same value: with the
ratios 10, 30, 100 and 10,000 the vortices of Taylor and Green lose 0.8, 2.2, 3.1 and 3.7 % more energy than
with k = 3."""
_SLOW = 100.0
"""Number of times that waves cross the domain in a step, above which inertia has no part in the motion."""
_SINKS, _SMALL = 0.05, 0.01
"""Relative compressions of a body by its own weight: the least compression that is reported, and the
compression that the advice aims at."""
_SMEARED = 4.8
"""Cells across a body whose interface fills a quarter of the body after a strain of one.  In measurements
interfaces were 1.2 s^(1/4) cells wide after a strain s.  Where the interface filled a quarter of a body, the
area of fractions above 1/2 was 3 % too small."""
_HOT = 3.0
"""Ratio c dtheta/(theta_R K beta) above which the thermal stress is wrong.  In a ring that was two cells
thick, the hoop stress was wrong by 3 % with the ratio 1.1, by 40 % with 11, and by 4 % with 11 and m = 2."""
_MOVED = 1e-6
"""Displacement relative to the domain's shortest edge, above which the matter of a run counts as moved."""
_ABOVE_YIELD = 0.1
"""Ratio of viscous overstress and yield stress, above which the run advises a smaller G_m."""


@dataclass(frozen=True)
class Scales:
    """Scales in SI units; a time that does not exist is inf, a speed or viscosity that does not exist is 0.

    Where moduli differ from place to place or from body to body, each scale is the one that needs the
    smallest dt or maxh.  Lengths of the domain are those in directions that are not periodic.
    """

    length: float
    """Shortest edge of the domain's bounding box, m."""
    cell: float
    """Median size of a cell, m."""
    velocity: float
    """The largest velocity, m/s, as in ``largest_velocity``; 0 if no velocity is known."""
    speeds: tuple[float, float]
    """Speeds of the fastest longitudinal and the fastest shear waves at rest, m/s."""
    kinematic_viscosity: float
    """The least G_v/rho that is not zero, m^2/s."""
    maxwell: float
    """The shortest relaxation time of shear by creep, G_m/(2 G), s."""
    dt: float
    scheme: TimeScheme = field(default_factory=backward_euler)
    densities: float = 1.0
    """Ratio of the largest and the least density at the start."""
    one_bulk_energy: bool = True
    """Whether all bodies have one bulk energy."""
    extent: float = 0.0
    """Longest edge of the bounding box, m, which waves have to cross; 0 stands for ``length``."""
    weight: float = 0.0
    """Ratio of the largest load to the modulus of longitudinal waves, rho g L/(rho c^2)."""
    overstress: float = 0.0
    """Ratio of the stress's viscous part and the yield stress at the rate velocity/length."""
    floors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Floors of laws, and the scale of the rate that each law reads: v/L, 1/s, or v/L^2, 1/(m s)."""
    heat: float = 0.0
    """The ratio c dtheta/(theta_R K beta), dtheta the range of the temperature; 0 without expansion."""
    bodies: Mapping[str, float] = field(default_factory=dict)
    """Least extent of each body, in cells."""
    placed: tuple[str, ...] = ()
    """Names of the bodies that have a place."""
    smears: bool = False
    """Whether bodies are carried with m = 1 and without sharpening."""
    is_sharp: bool = False
    """Whether bodies are separated at the end of each step."""
    parting: str | None = None
    """Warning that variables of one distortion may drift apart; empty without such a warning."""
    unborne: str | None = None
    """Warning of a pressure at the start that does not bear the weight; empty without such a warning."""
    k: int = 2
    """Order of the velocity."""
    longest: float = 0.0
    """The longest step that the run may take, s: dt_max for adaptive steps, otherwise dt."""
    startup: int = 0
    """Number of first steps by backward Euler."""

    @property
    def passage(self) -> float:
        """Time in which shear waves, or else pressure waves, cross the domain, s."""
        fast, slow = self.speeds
        wave = slow if slow > 0 else fast
        return (self.extent or self.length) / wave if wave > 0 else math.inf

    @property
    def is_slow(self) -> bool:
        """Whether inertia has no part in the motion, because waves cross the domain many times in the longest
        step."""
        return self.passage * _SLOW < max(self.dt, self.longest)

    @property
    def _over_flow(self) -> float:
        """Ratio of the longitudinal modulus to the stress of the flow, which is the larger of rho v^2 and G_v
        v/L; 0 if no velocity is known."""
        if not self.velocity > 0:
            return 0.0
        viscous = self.kinematic_viscosity * self.velocity / self.length
        return float(self.speeds[0] ** 2 / max(self.velocity**2, viscous))

    @property
    def numbers(self) -> dict[str, float]:
        """Dimensionless numbers by name, without those that do not exist or are not known."""
        fast, slow = self.speeds
        numbers: dict[str, float] = {}
        if self.velocity > 0:
            numbers["Courant, v dt/h"] = self.velocity * self.dt / self.cell
            if fast > 0:
                numbers["Mach, v/c of longitudinal waves"] = self.velocity / fast
        if fast > 0:
            numbers["Courant of longitudinal waves, c dt/h"] = fast * self.dt / self.cell
        if slow > 0 and self.velocity > 0:
            numbers["Mach of shear waves"] = self.velocity / slow
        if self.kinematic_viscosity > 0 and self.velocity > 0:
            numbers["Reynolds, rho v L/G_v"] = self.velocity * self.length / self.kinematic_viscosity
        if math.isfinite(self.maxwell):
            if self.velocity > 0:
                numbers["Deborah, Maxwell time v/L"] = self.maxwell * self.velocity / self.length
            numbers["Maxwell time/dt"] = self.maxwell / self.dt
        if fast > 0 and slow > 0:
            numbers["longitudinal over shear modulus"] = (fast / slow) ** 2
        if self.weight > 0:
            numbers["weight over longitudinal modulus"] = self.weight
        if self.overstress > 0:
            numbers["overstress over yield, G_m v/(L sigma_Y)"] = self.overstress
        if self.densities > 1 + 1e-6:
            numbers["largest over least density"] = self.densities
        for name in self.placed:
            if (cells := self.bodies.get(name, 0.0)) > 0:
                numbers[f"cells across the body {name!r}"] = cells
                if self.smears:
                    numbers[f"strains until {name!r} has lost 3 % of its area"] = (cells / _SMEARED) ** 4
        return numbers

    @property
    def advice(self) -> list[str]:
        """Sentences of advice about dt, maxh and the material; empty if no number stands out."""
        return [*self._of_waves(), *self._of_matter(), *self._of_motion(), *self._of_cells()]

    def _of_waves(self) -> Iterator[str]:
        fast, slow = self.speeds
        name = "shear" if slow > 0 else "longitudinal"
        if math.isfinite(self.passage) and self.dt * _FOLLOWED > self.passage and not self.is_slow:
            does = "damps these waves" if self.scheme.order == 1 else "does not resolve these waves"
            yield (
                f"{name} waves cross the domain in {self.passage:.2g} s, {self.passage / self.dt:.2g} "
                f"steps, so that the scheme {self.scheme.name} {does}; to resolve these waves take "
                f"dt <= {self.passage / _FOLLOWED:.2g} s"
            )
        hard = fast * self.dt / self.cell
        if self.scheme.A == midpoint().A and hard > _RINGING:
            euler = "" if self.startup else "the first steps by backward Euler (time.startup = 2), or "
            shorter = "" if self.is_slow else f", or dt <= {_RINGING * self.cell / fast:.2g} s"
            yield (
                f"longitudinal waves cross {hard:.3g} cells in a step. The scheme {self.scheme.name} does "
                f"not damp such waves, so that they oscillate from step to step; take {euler}another scheme "
                f"('sdirk2' damps waves){shorter}"
            )

    def _of_matter(self) -> Iterator[str]:
        fast, slow = self.speeds
        if slow > 0 and (fast / slow) ** 2 > _STIFF:
            ratio, remedies = (fast / slow) ** 2, []
            if self.k < 3:
                remedies.append(f"take discretisation.k = 3, since cells lock with k = {self.k}")
            spare = _SMALL / self.weight if self.weight > 0 else ratio / _STIFF
            if spare >= 2:
                less = f"a K_e {max(1 / spare, _STIFF / ratio):.1g} times as large is still stiff enough"
                remedies.append(less + (" for the weight" if self.weight > 0 else ""))
            yield (
                f"the longitudinal modulus is {ratio:.2g} times the shear modulus, so that steps are hard "
                "to solve" + "".join(f"; {remedy}" for remedy in remedies)
            )
        # the flow is much slower than pressure waves, and the steps do not resolve these waves
        if self.k == 2 and slow == 0 and self._over_flow > _LOCKS and self.dt * _FOLLOWED > self.passage:
            yield (
                f"the longitudinal modulus is {self._over_flow:.2g} times the stress of the flow, the larger "
                "of rho v^2 and G_v v/L. Cells with k = 2 then lock: they damp motions at constant volume. "
                "Compare with discretisation.k = 3"
            )
        if self.k == 1 and slow > 0 and _LOCKS < (fast / slow) ** 2 <= _STIFF:
            yield (
                f"the longitudinal modulus is {(fast / slow) ** 2:.2g} times the shear modulus. Cells of "
                "order one then lock: they resist motions at constant volume, unless the cells are crossed "
                "rectangles (structured_box in the plane, crossed = true). Compare with k = 2"
            )
        if self.weight > _SINKS:
            yield (
                f"the weight is {self.weight:.2g} of the longitudinal modulus, and shortens a column by "
                f"about {50 * self.weight:.2g} %; for matter that is hardly compressible take a larger K_e"
            )
        is_denser = self.densities > _DENSER * (1 + 1e-6)
        if is_denser:
            yield (
                f"densities differ by the factor {self.densities:.2g}. In cells that the interface passes "
                "the lighter body is accelerated strongly, and steps are hard to solve. Take a factor up to "
                f"{_DENSER:g}, and a lighter body that is as viscous as the heavier one"
            )
        if is_denser and not self.one_bulk_energy:
            yield (
                "bodies of so different densities have different bulk energies, so that steps need many "
                "iterations, or are divided. If the bulk energies do not matter, give all bodies one, e.g. a "
                'medium around bodies of ReferentialNeoHookean the kind "Custom" with '
                'energy = "K_e/2*(J - 1)*(J - 1)/J"'
            )
        if self.overstress > _ABOVE_YIELD:
            yield (
                f"at the rate v/L the stress exceeds the yield stress by {self.overstress:.2g} times the "
                f"yield stress; for a smaller excess take a G_m {self.overstress / _ABOVE_YIELD:.2g} times "
                "smaller"
            )

        yield from _above_rates(self.floors)
        if self.heat > _HOT:
            yield (
                f"c dtheta, dtheta the range of the temperature, is {self.heat:.2g} times theta_R K beta, so "
                "that the thermal stress is wrong; take discretisation.m = 2, or with m = 2 smaller cells"
            )

    def _of_motion(self) -> Iterator[str]:
        passed, most = self.velocity * self.dt / self.cell, FAR if self.is_sharp else 1.0
        if passed > most:
            astray = ". With discretisation.sharp = true such steps displace interfaces"
            yield (
                f"matter moves by {passed:.2g} cells in a step{astray * self.is_sharp}"
                f"{'. Such steps are hard to solve, and upwinding smears jumps' * (passed > 1)}"
                f". Take dt <= {most * self.cell / self.velocity:.2g} s"
            )
        if self.maxwell < _RELAXED * self.dt * (1 - 1e-6):  # moduli by finite differences have rounding
            yield (
                f"stress relaxes in {self.maxwell:.2g} s, {self.maxwell / self.dt:.2g} steps, so that the "
                "steps do not resolve this relaxation; to resolve the relaxation take dt <= "
                f"{self.maxwell / _RELAXED:.2g} s"
            )
        yield from filter(None, (self.parting, self.unborne))

    def _of_cells(self) -> Iterator[str]:
        layer = (
            math.sqrt(self.kinematic_viscosity * self.length / self.velocity) if self.velocity > 0 else 0.0
        )
        if self.cell * _ACROSS > self.length:
            across, enough = self.length / self.cell, self.length / _ACROSS
            yield (f"there are {across:.1f} cells across the domain; take cells of {enough:.2g} m or less")
        elif 0 < layer < self.cell:
            yield (
                f"viscous layers are {layer:.2g} m thick, thinner than a cell; if these layers matter, take "
                f"maxh or refine <= {layer / 2:.2g} m"
            )
        for name, cells in self.bodies.items():
            if 0 < cells < _ACROSS:
                yield (
                    f"there are {cells:.1f} cells across the body {name!r} at its thinnest part; take cells "
                    f"{_ACROSS / cells:.2g} times smaller there"
                )


def scales(simulation: RunState) -> Scales:
    """The scales of a simulation at its present state."""
    mesh, step = simulation.mesh, simulation.rothe_step
    places = extreme_places(step, simulation.sampler)
    if not places:
        mass = float(step.quadrature.integrate_cells(step.now.rho))
        places = [ExtremePlace(step.model, {}, mass / Integrate(CF(1.0), mesh), np.empty(0))]
    fast, slow, viscosities, maxwell = zip(*(place.scales(mesh.dim) for place in places), strict=True)
    least, most = simulation.sampler.extrema(step.now.rho)
    material, edges = step.model.material, edges_of(step, simulation.ranks)
    velocity, length = largest_velocity(simulation), min(edges)
    return Scales(
        length=length,
        extent=max(edges),
        cell=float(np.median(step.context.h.vec.FV().NumPy())),
        velocity=velocity,
        speeds=(max(fast), max(slow)),
        kinematic_viscosity=min((value for value in viscosities if value > 0), default=0.0),
        maxwell=min(maxwell),
        dt=float(simulation.stepper.dt),
        longest=simulation.stepper.longest,
        scheme=simulation.scheme,
        densities=most / least,
        one_bulk_energy=not isinstance(material, Mixture) or material.has_one_volume,
        weight=largest_acceleration(step, simulation.sampler) * max(edges) / max(min(fast) ** 2, 1e-300),
        overstress=max(place.overstress(velocity / length) for place in places),
        floors=_floors(step.model, velocity / length, length),
        heat=_heat(step, simulation.sampler),
        bodies=_thickness(simulation),
        placed=tuple(body.name for body in step.model.bodies if body.where is not None),
        smears=step.discretisation.m == 1 and not step.discretisation.sharp,
        is_sharp=step.discretisation.sharp,
        k=step.discretisation.k,
        startup=simulation.integrator.startup,
        unborne=unborne_weight(step, simulation.sampler),
        parting=may_part(material, bool(step.moving_walls.moving)),
    )


def _heat(step: Step, sampler: Sampler) -> float:
    material = step.model.material
    thermal, theta = part_of(material, Thermal), temperature(material, step.now.zeta_tensors)
    if thermal is None or theta is None or thermal.is_absolute or not thermal.coupling:
        return 0.0
    return float(np.ptp(sampler.extrema(theta))) * thermal.c / (thermal.theta_R * thermal.coupling)


def _floors(model: Model, rate: float, length: float) -> dict[str, tuple[float, float]]:
    viscosities = [model.viscosity, *(body.viscosity for body in model.bodies)]
    laws: list[tuple[Any, float]] = [
        *((law, rate) for law in viscosities),
        (model.hyperviscosity, rate / length),
    ]
    read = ((law, scale) for law, scale in laws if not is_even(getattr(law, "p", 0.0)))
    return {f"{type(law).__name__}.floor": (law.floor, scale) for law, scale in read if hasattr(law, "floor")}


def _above_rates(floors: Mapping[str, tuple[float, float]]) -> Iterator[str]:
    for name, (floor, rate) in floors.items():
        if 0 < rate < floor:
            yield (
                f"{name} = {floor:.2g} exceeds the scale of the rates, {rate:.2g}, so that the law does "
                f"not change with the rate; take {name} <= {1e-2 * rate:.1g}"
            )


def warn_of_floors(simulation: RunState) -> None:
    """Warn of floors above the rates of a run in which matter moved."""
    length, velocity = min(edges_of(simulation.rothe_step, simulation.ranks)), largest_velocity(simulation)
    if velocity * simulation.t > _MOVED * length:
        for line in _above_rates(_floors(simulation.model, velocity / length, length)):
            simulation.ranks.warn(line, InputWarning, stacklevel=4)


def largest_velocity(simulation: RunState) -> float:
    """The largest velocity of a run so far, m/s; 0 if none is known.

    After a step the velocity is the largest one of all steps and of walls.  Before the first step the
    velocity is the given velocity scale, or else the largest velocity of the start and of walls.
    """
    ranks, given = simulation.ranks, simulation.given_velocity_scale
    velocities = [row["v_max"] for row in simulation.ledger.rows]
    walls = simulation.rothe_step.moving_walls.velocities().values()
    moving = ranks.most(np.concatenate([np.zeros(1), *(abs(v).ravel() for v in walls)]))
    if len(velocities) > 1:
        return max(*velocities, moving)
    return given or max(math.sqrt(simulation.sampler.extrema(square(simulation.rothe_step.now.v))[1]), moving)


def _thickness(simulation: RunState) -> dict[str, float]:
    """The least extent, in cells, of the part of each body with a fraction of at least one half."""
    step, sampler, ranks = simulation.rothe_step, simulation.sampler, simulation.ranks
    material, extents = step.model.material, {}
    if not isinstance(material, Mixture):
        return {}
    places = sampler.coordinates(np.arange(len(sampler.points)))
    sizes = sampler.rows(step.context.h)[:, 0]
    for name, fraction in material.fractions.at(step.now.z_tensors).items():
        inside = sampler.rows(CF(fraction))[:, 0] >= 0.5
        if not ranks.any(bool(inside.any())):
            continue
        spans = [ranks.most(along[inside]) - ranks.least(along[inside]) for along in places.T]
        extents[name] = min(spans) / float(np.median(np.concatenate(ranks.gathered(sizes[inside]))))
    return extents
