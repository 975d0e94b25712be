"""The growth of damage after a step at fixed z, the second half of a staggered step.

The step (rho, v, z)_old -> (rho, v, z) carries the damage d and its slope q to d* and q*.  Then d and q
change by a continuous, piecewise linear delta, d = d* + delta and q = q* + G delta, where delta minimises

    int phi(z, d* + delta, q* + G delta) + sum_i m_i eta delta_i^2/(2 tau)      for low <= delta <= high,

with lumped masses m_i. G delta is grad delta, or F^T grad delta for the referential slope.  ``low`` is 0, so
that damage never falls. With healing ``low`` is -d*, and eta is the viscosity of healing where delta_i < 0.
``high`` is the minimum of 1 - d* over a vertex' cells, so that d <= 1 at all points.  phi is quadratic in (d,
q).  Let H be the second derivative of phi, and r the slope at the minimum with the viscosity's slope. Then

    E* - E = sum_i m_i eta delta_i^2/tau + delta.H delta/2 - r.delta

exactly. The three summands are ``dissipation_damage``, a Bregman distance, and the work of the bounds d = 1
and d = 0. By the signs at the bounds r_i delta_i <= 0; at low = 0 it is 0. The sum of distance and work is
``bregman_damage`` >= 0.

In the step the conjugates of z are phi'_z(z; d_old, q_old), and those of (d, q) are phi'_(d,q)(z; d, q)
(``StoredEnergy``).  The step's ``bregman`` is therefore the sum of two distances

    phi(z_old; d_old) - phi(z; d_old) - phi'_z(z; d_old):(z_old - z)   and the distance of (d, q) at z,

both >= 0, although phi is not jointly convex in (z, d, q).

For each step the ledger has the growth at a point and the new surface of cracks. A crack that runs within
one step has the stress of the step's start, so that the breaking load depends on the step's length.

If several bodies break, each has a damage.  Their volumes are held while damages grow, so that phi is
quadratic in (d, q). The equilibrium of pressure after the growth releases more energy, which
``bregman_damage`` contains (``HeldVolumes``).

With heat, the dissipation xi by the viscosity of damage raises the entropy of each cell by c_K xi tau/theta,
where c_K makes the cell's energy rise by tau int_K xi, to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import add
from typing import Any, Protocol

import numpy as np
from ngsolve import (
    ET,
    H1,
    L2,
    VOL,
    BilinearForm,
    GridFunction,
    IntegrationRule,
    LinearForm,
    Mesh,
    Periodic,
    grad,
)

from ngvisco.algebra.box import minimise_in_box
from ngvisco.errors import InputWarning, ParameterError, StepError
from ngvisco.forms.context import Context, StepLayout
from ngvisco.forms.energy import StoredEnergy
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.mesh_arrays import is_simplicial
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.mesh.quadrature import Quadrature, values_of
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.term import PRODUCTION, Entry, Integrand
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.gathered import Gathered
from ngvisco.physics.body_energies import InEquilibrium
from ngvisco.physics.material import conjugates, part_of
from ngvisco.physics.materials.damaged import DAMAGE, WHOLE_F, Damaged
from ngvisco.physics.materials.thermal import Entropy, Thermal, entropy_in
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.model import Model
from ngvisco.physics.parameters import substituted
from ngvisco.words import Mention, Words

DISSIPATION, BREGMAN = "dissipation_damage", "bregman_damage"
"""Two ledger columns: the dissipation by growing damage, W, and the numerical dissipation in the damage's
half of the step, J a step."""

GROWTH, CRACKED = "damage_growth", "crack_growth"
"""Two ledger columns: the largest growth of d at a point in a step; and the area of new cracks in a step,
m^2, or m in two dimensions, which is their energy divided by G_c."""


_POWER, _PRODUCTION = "power_heat_damage", PRODUCTION + "damage"
"""Two ledger columns: the heat from damage, W, and the entropy of this heat, W/K."""

_NEWTON, _ROUNDING = 10, 1e-15
"""Largest number of Newton steps for c_K; and the largest accepted defect, relative to the energy."""


class Breaking(Protocol):
    """Attributes of a step that the growth of damage uses."""

    mesh: Mesh
    model: Model
    layout: StepLayout
    discretisation: Discretisation
    quadrature: Quadrature
    context: Context
    energy: StoredEnergy
    state: GridFunction
    now: Fields

    def freeze(self) -> None: ...


class DamageGrowth:
    """Growth of the damages of a step's present state, of a material or of each body that breaks.

    Every rank solves the problem of all vertices.  Raises ParameterError for fields that are not linear in a
    cell, cells that are not straight simplices, and a regularisation that diffuses the material's variables.
    """

    def __init__(self, step: Breaking) -> None:
        self.step, self._ranks = step, Communicator.of(step.mesh)
        material = step.model.material
        law = part_of(material, Damaged)
        laws = {"": law} if law is not None else {}
        if isinstance(material, Mixture):
            laws |= {name: broken.law for name, broken in material.damages.items()}
        self._check(laws)
        mesh = step.mesh
        space: Any = H1(mesh, order=1)
        if step.layout.periodic:
            space = Periodic(space)
        self._delta = GridFunction(space)
        self._all = Gathered(Exchange.of(space, self._ranks))
        """Gathers delta's unknowns of all ranks."""
        rule = IntegrationRule([(*e,) for e in np.eye(mesh.dim + 1)[:, : mesh.dim]], [0.0] * (mesh.dim + 1))
        self._vertices = mesh.MapToAllElements({ET.TRIG if mesh.dim == 2 else ET.TET: rule}, VOL)
        self._delta.vec.FV().NumPy()[:] = np.arange(space.ndof)
        self._dofs = np.rint(self._at_vertices(self._delta)).astype(int)
        """Numbers of delta's unknowns at every vertex of every cell."""
        masses = LinearForm(space)
        masses += step.quadrature.cells(space.TestFunction())
        self._masses = self._all.sum(masses.Assemble().vec.FV().NumPy().copy())
        self._part = GridFunction(step.layout.scalar_space("z"))
        self._held = HeldVolumes(step, material) if isinstance(material, Mixture) else None
        self.fields = [self._field(name, law) for name, law in laws.items()]
        """The growing damages."""
        self.length = min(law.length for law in laws.values())
        """The least width of a smeared crack, m."""
        of_surface = reduce(add, (field.of_surface for field in self.fields))
        entropy = entropy_in(material)
        self._heat = None if entropy is None else _DamageHeat(step, entropy)
        self.entries = [
            Entry(DISSIPATION, "dissipation", Integrand()),
            Entry(BREGMAN, "numerical", Integrand()),
            Entry("stored_surface", "monitor", Integrand(of_surface)),
            Entry(GROWTH, "monitor", Integrand()),
            Entry(CRACKED, "monitor", Integrand()),
        ]
        if self._heat is not None:
            self.entries.append(Entry(_POWER, "power", Integrand()))
            self.entries.append(Entry(_PRODUCTION, "production", Integrand()))

    def _check(self, laws: Mapping[str, Damaged]) -> None:
        step = self.step
        if step.discretisation.m != 1:
            expected = "1 with damage, since the bounds of damage are imposed at the vertices of cells"
            raise ParameterError("Discretisation.m", step.discretisation.m, expected)
        if not is_simplicial(step.mesh) or step.mesh.GetCurveOrder() > 1:
            expected = (
                "a mesh of straight triangles or tetrahedra, since damage needs a slope that is linear in "
                "cells"
            )
            raise ParameterError("Simulation.mesh", step.mesh, expected)
        regularisation = step.model.regularisation
        if regularisation is not None and regularisation.delta_fields:
            expected = "0 with damage, since delta_fields would diffuse the damage"
            raise ParameterError("Regularisation.delta_fields", regularisation.delta_fields, expected)
        size = self._ranks.least(step.context.h.vec.FV().NumPy())
        length, body = min((law.length, name) for name, law in laws.items())
        if length < size:
            message = Words(
                Mention("Damaged.length"),
                f" = {length:g} m{f' of the body {body!r}' * bool(body)} is below the size of the smallest "
                f"cell, {size:.3g} m. A crack is then one row of cells wide, and takes more energy per area "
                "than G_c. Take cells whose size is at most half of this length",
            )
            self._ranks.warn(message, InputWarning, stacklevel=6)

    def _field(self, body: str, law: Damaged) -> _GrowingField:
        """The damage of a body, or of the material ("")."""
        step, space = self.step, self._delta.space
        z = step.now.z_tensors
        if self._held is not None:
            material = self._held.material
            weight = material.fractions.backed(z, body)
            broken = material.damages[body]
            names, driving = (broken.damage.name, broken.slope.name), self._held.driving[body].components[0]
            return _GrowingField(step, space, law, names, weight, driving)
        driving, _ = substituted(law, lambda expression: expression.at(z)).parts(z)
        thermal = part_of(step.model.material, Thermal)
        if thermal is not None and thermal.coupling:
            driving = driving + thermal.taken(z)[0]
        return _GrowingField(step, space, law, (DAMAGE.name, law.slope.name), law.weight(z), driving)

    def _at_vertices(self, function: Any) -> np.ndarray:
        return np.asarray(function(self._vertices)).reshape(-1)

    def start(self) -> None:
        """Make the present damages continuous, by the mean of each vertex' cells, and compute the slopes."""
        for field in self.fields:
            values, dofs, size = self._at_vertices(field.damage), self._dofs, self._delta.space.ndof
            parts = np.bincount(dofs, values, size), np.bincount(dofs, minlength=size).astype(float)
            sums, counts = map(self._all.sum, parts)
            self._z()[field.rows] = 0.0
            self._add(field, np.clip(sums / np.maximum(counts, 1), 0.0, 1.0))

    def __call__(self, tau: float) -> tuple[dict[str, float], dict[str, float]]:
        """Let the damages grow over ``tau``, s. Return two dictionaries by columns: dissipations, W, with
        ``GROWTH`` and ``CRACKED``; and numerical dissipations, J.

        Raises StepError if there is no minimum, because the energy is not convex in the damage.
        """
        if self._held is not None:
            self._held.refresh()
        rates, distance = {DISSIPATION: 0.0, GROWTH: 0.0, CRACKED: 0.0}, 0.0
        dissipated = np.zeros(len(self._masses))
        for field in self.fields:
            of_field, of_distance, growth, cracked = self._grow(field, tau)
            dissipated += of_field
            distance += of_distance
            rates[GROWTH] = max(rates[GROWTH], growth)
            rates[CRACKED] += cracked
        rates[DISSIPATION] = float(dissipated.sum()) / tau
        if self._heat is not None:
            density = dissipated / np.where(self._masses > 0, self._masses, 1.0)
            self._delta.vec.FV().NumPy()[:] = self._all.here(density)
            rates |= self._heat(self._delta, tau)
        if self._held is not None:
            distance += self._held.released()
        self.step.freeze()
        return rates, {BREGMAN: distance}

    def _grow(self, field: _GrowingField, tau: float) -> tuple[np.ndarray, float, float, float]:
        """Let one damage grow. Return the dissipated energy by vertices, J; the numerical dissipation, J; the
        largest growth at a point; and the area of new cracks."""
        law = field.law
        H = self._all.matrix(csr(field.hessian.Assemble().mat))
        f = self._all.sum(field.force.Assemble().vec.FV().NumPy().copy())
        low, high = self._bounds(field)
        healing = law.viscosity if law.healing_viscosity is None else law.healing_viscosity
        rising, falling = (self._masses * viscosity / tau for viscosity in (law.viscosity, healing))
        try:
            minimum = minimise_in_box(H, f, (rising, falling), low, high)
        except StepError as error:
            raise StepError(
                f"the new damage was not found ({error}); the energy of the material is negative somewhere"
            ) from error
        delta, before = minimum.x, field.surface()
        self._add(field, delta)
        dissipated = np.where(delta < 0, falling, rising) * delta * delta
        distance = float(0.5 * delta @ (H @ delta) - minimum.slope @ delta)
        return dissipated, distance, float(delta.max()), (field.surface() - before) / law.G_c

    def _bounds(self, field: _GrowingField) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of delta at every vertex of all ranks."""
        values, dofs, size = self._at_vertices(field.damage), self._dofs, self._delta.space.ndof
        low, high = np.full(size, -np.inf), np.full(size, np.inf)
        np.minimum.at(high, dofs, 1 - values)
        np.maximum.at(low, dofs, -values)
        low, high = -self._all.least(-low), self._all.least(high)
        unused = ~np.isfinite(high)
        low[unused] = high[unused] = 0.0
        if field.law.healing_viscosity is None:
            low[:] = 0.0
        return np.minimum(low, 0.0), np.maximum(high, 0.0)

    def _z(self) -> np.ndarray:
        """View of the present coefficients of z, (components, functions)."""
        values = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
        return values.reshape(self.step.layout.states.size, -1)

    def _add(self, field: _GrowingField, delta: np.ndarray) -> None:
        """Add delta, given at the vertices of all ranks, and its slope to the present damage."""
        self._delta.vec.FV().NumPy()[:] = self._all.here(delta)
        z, slope = self._z(), field.along(grad(self._delta))
        values = (self._delta, *(slope[j] for j in range(self.step.mesh.dim)))
        for row, value in zip(field.rows, values, strict=True):
            self._part.Set(value)
            z[row] += self._part.vec.FV().NumPy()


class _GrowingField:
    """One damage and its slope, with the forms of the second derivative and of the slope at delta = 0."""

    def __init__(
        self, step: Breaking, space: Any, law: Damaged, names: tuple[str, str], weight: Any, driving: Any
    ) -> None:
        """``names`` are the names of damage and slope, ``weight`` is the reference volume per actual volume,
        and ``driving`` is the energy that the damage degrades, Pa."""
        self.step, self.law = step, law
        z, slices = step.now.z_tensors, step.layout.states.slices
        self.damage, q = z[names[0]], z[names[1]][:, 0]
        where = slices[names[1]]
        self.rows = [slices[names[0]].start, *range(where.start, where.stop)]
        """Numbers of the components of damage and its slope."""
        own = {**z, "A": weight, DAMAGE.name: self.damage, law.slope.name: z[names[1]]}
        self.of_surface = law.surface_energy(own)
        (d, test), (of_damage, of_slope) = space.TnT(), law.surface
        is_quadratic, stiff = law.law == "AT2", 1 - law.floor
        self.hessian, self.force = BilinearForm(space, symmetric=True), LinearForm(space)
        curvature = 2 * stiff * driving + (2 * of_damage if is_quadratic else 0.0) * weight
        slopes = self.along(grad(d)) * self.along(grad(test))
        self.hessian += step.quadrature.cells(curvature * d * test + 2 * of_slope * weight * slopes)
        force = -2 * stiff * (1 - self.damage) * driving
        force += of_damage * weight * (2 * self.damage if is_quadratic else 1.0)
        carried = self.along(grad(test))
        along = sum(q[i] * carried[i] for i in range(step.mesh.dim))
        self.force += step.quadrature.cells(force * test + 2 * of_slope * weight * along)

    def along(self, gradient: Any) -> Any:
        """The slope that matter carries, for a gradient of the damage: the gradient, or F^T times it."""
        if self.law.area == "actual":
            return gradient
        dim = self.step.mesh.dim
        return self.step.now.z_tensors[WHOLE_F.name][:dim, :dim].trans * gradient

    def surface(self) -> float:
        """Energy of cracks, J."""
        return float(self.step.quadrature.integrate_cells(self.of_surface))


class HeldVolumes:
    """The volumes of bodies, which are held while damages grow, and the energies that damages degrade.

    The energy with held volumes is quadratic in the damages. It is not less than the energy of the bodies in
    equilibrium of pressure, and equal to this energy before the growth.
    """

    def __init__(self, step: Breaking, material: Mixture) -> None:
        response = material.response(step.mesh.dim)
        assert isinstance(response, InEquilibrium)
        self.step, self.material, self._response = step, material, response
        self._at_points = step.quadrature.vectors(step.layout.states.size)
        self.driving = {name: step.quadrature.vectors(1) for name in material.damages}
        """The energy that each damage degrades, Pa, at the points of the rule of the forms."""
        self._released = step.quadrature.vectors(1)
        self._J = np.zeros((0, len(material.bodies)))

    def _states(self) -> np.ndarray:
        self._at_points.Interpolate(self.step.now.z)
        return np.ascontiguousarray(values_of(self._at_points).T)

    def refresh(self) -> None:
        """Hold the volumes of the present state."""
        states = self._states()
        self._J = self._response.volumes_of(states)
        for name, field in self.driving.items():
            values_of(field)[0] = self._response.driving(name, states, self._J)

    def released(self) -> float:
        """The stored energy with held volumes, less the stored energy in equilibrium of pressure, J."""
        states = self._states()
        energy = self._response.held_energy(states, self._J) - self._response(states).energy
        values_of(self._released)[0] = energy
        return float(self.step.quadrature.integrate_cells(self._released.components[0]))


class _DamageHeat:
    """Heat from the viscosity of damage, added as entropy to each cell."""

    def __init__(self, step: Breaking, entropy: Entropy) -> None:
        self.step, self.entropy, self._place = step, entropy, step.layout.states.slices[entropy.name].start
        self._share = GridFunction(L2(step.mesh, order=0))
        self._added = GridFunction(step.layout.scalar_space("z"))
        self._heat = step.energy.density(step.now).Compile()
        theta = conjugates(step.model.material, step.now.z_tensors)[entropy.name]
        self._theta = (1 / entropy.unit * theta).Compile()

    def __call__(self, xi: GridFunction, tau: float) -> dict[str, float]:
        """Add the heat ``xi``, J/m^3, to the present state; return power, W, and entropy, W/K, by columns."""
        state, ranges, unit = self.step.state.vec.FV().NumPy(), self.step.layout.ranges, self.entropy.unit
        s = state[ranges["z"]].reshape(self.step.layout.states.size, -1)[self._place]
        before, of_cells, ranks = s.copy(), self.step.quadrature.each_cell, Communicator.of(self.step.mesh)
        heat, energy = of_cells(xi), of_cells(self._heat)
        self._added.Set((1 / unit) * xi / self._theta)
        direction = GridFunction(self._added.space)
        direction.vec.data = self._added.vec
        share = self._share.vec.FV().NumPy()
        share[:] = heat > 0
        for _ in range(_NEWTON):
            self._added.Set(self._share * direction)
            s[:] = before + self._added.vec.FV().NumPy()
            missing = heat - (self.step.quadrature.each_cell(self._heat) - energy)
            slope = unit * self.step.quadrature.each_cell(self._theta * direction)
            share += np.where(heat > 0, missing / np.where(slope > 0, slope, 1.0), 0.0)
            defect, size = ranks.totals(np.array([abs(missing).sum(), abs(energy).sum()]))
            if defect <= _ROUNDING * size:
                break
        produced = unit * self.step.quadrature.each_cell(self._added).sum()
        power, production = ranks.totals(np.array([heat.sum(), produced])) / tau
        return {_POWER: float(power), _PRODUCTION: float(production)}
