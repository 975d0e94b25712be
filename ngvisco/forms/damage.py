"""The growth of damage after a step at fixed z, the second half of a staggered step.

The step (rho, v, z)_old -> (rho, v, z) carries the damage d and its slope q to d* and q*.  Then d and q
change by a continuous, piecewise linear delta, d = d* + delta and q = q* + G delta, where delta minimises

    int phi(z, d* + delta, q* + G delta) + sum_i m_i eta delta_i^2/(2 tau)      for low <= delta <= high,

m_i lumped masses, G delta = grad delta, or F^T grad delta for the referential slope.  low = 0, so that damage
never falls, or -d* with healing, whose viscosity eta holds for delta_i < 0.  high = 1 - d*, the minimum over
a vertex' cells, so that d <= 1 at all points.  phi is quadratic in (d, q).  With the second derivative H of
phi, and the slope r at the minimum, which includes the viscosity's slope,

    E* - E = sum_i m_i eta delta_i^2/tau + delta.H delta/2 - r.delta

exactly: ``dissipation_damage``, a Bregman distance, and the work of the bounds d = 1 and d = 0.
r_i delta_i <= 0 by the signs at the bounds, and 0 at low = 0: ``bregman_damage`` >= 0 is the sum of distance
and work.

In the step the conjugates of z are phi'_z(z; d_old, q_old), and of (d, q) phi'_(d,q)(z; d, q)
(``StoredEnergy``).  The step's ``bregman`` is therefore the sum of two distances

    phi(z_old; d_old) - phi(z; d_old) - phi'_z(z; d_old):(z_old - z)   and the one of (d, q) at z,

both >= 0, although phi is not jointly convex.

For each step the ledger has the growth at a point and the new surface of cracks. A crack that runs within
one step has the stress of the step's start, so that the breaking load depends on the step's length.

With heat, the dissipation xi by the viscosity of damage raises the entropy of each cell by c_K xi tau/theta,
where c_K makes the cell's energy rise by tau int_K xi, to rounding.
"""

from __future__ import annotations

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
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.term import PRODUCTION, Entry, Integrand
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.material import conjugates, part_of
from ngvisco.physics.materials.damaged import DAMAGE, WHOLE_F, Damaged
from ngvisco.physics.materials.thermal import Entropy, Thermal, entropy_in
from ngvisco.physics.model import Model
from ngvisco.physics.parameters import substituted
from ngvisco.words import Mention, Words

DISSIPATION, BREGMAN = "dissipation_damage", "bregman_damage"
"""Ledger columns of the dissipation by growing damage, W, and of the numerical dissipation in the damage's
half of the step, J a step."""

GROWTH, CRACKED = "damage_growth", "crack_growth"
"""Ledger columns of the largest growth of d at a point in a step, and of the area of new cracks in a step
(their energy over G_c), m^2, or m in two dimensions."""


_POWER, _PRODUCTION = "power_heat_damage", PRODUCTION + "damage"
"""Ledger columns of the heat from damage, W, and of its entropy, W/K."""

_NEWTON, _ROUNDING = 10, 1e-15
"""Largest number of Newton steps for c_K, and the accepted defect relative to the energy."""


class Breaking(Protocol):
    """The part of a step that the growth of damage needs."""

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
    """Growth of the damage of a step's present state.

    Raises ParameterError for fields that are not linear in a cell, cells that are not straight simplices,
    several processes, or a regularisation that diffuses the material's variables.
    """

    def __init__(self, step: Breaking, law: Damaged) -> None:
        self.step, self.law = step, law
        self._check()
        mesh, z = step.mesh, step.now.z_tensors
        space: Any = H1(mesh, order=1)
        if step.layout.periodic:
            space = Periodic(space)
        self._delta = GridFunction(space)
        rule = IntegrationRule([(*e,) for e in np.eye(mesh.dim + 1)[:, : mesh.dim]], [0.0] * (mesh.dim + 1))
        self._vertices = mesh.MapToAllElements({ET.TRIG if mesh.dim == 2 else ET.TET: rule}, VOL)
        self._delta.vec.FV().NumPy()[:] = np.arange(space.ndof)
        self._dofs = np.rint(self._at_vertices(self._delta)).astype(int)
        """Numbers of delta's unknowns at every vertex of every cell."""
        self.damage = z[DAMAGE.name]
        self._hessian, self._slope = self._forms(space)
        masses = LinearForm(space)
        masses += step.quadrature.cells(space.TestFunction())
        self._masses = masses.Assemble().vec.FV().NumPy().copy()
        self._part = GridFunction(step.layout.scalar_space("z"))
        self._of_surface = law.surface_energy(z)
        entropy = entropy_in(step.model.material)
        self._heat = None if entropy is None else _DamageHeat(step, entropy)
        self.entries = [
            Entry(DISSIPATION, "dissipation", Integrand()),
            Entry(BREGMAN, "numerical", Integrand()),
            Entry("stored_surface", "monitor", Integrand(law.surface_energy(z))),
            Entry(GROWTH, "monitor", Integrand()),
            Entry(CRACKED, "monitor", Integrand()),
        ]
        if self._heat is not None:
            self.entries.append(Entry(_POWER, "power", Integrand()))
            self.entries.append(Entry(_PRODUCTION, "production", Integrand()))

    def _check(self) -> None:
        step, law = self.step, self.law
        ranks = Communicator.of(step.mesh)
        if ranks.size > 1:
            raise ParameterError("Model.material", law, "a material without damage, or one process")
        if step.discretisation.m != 1:
            expected = "1 with damage: its bounds are those at the vertices of cells"
            raise ParameterError("Discretisation.m", step.discretisation.m, expected)
        if not is_simplicial(step.mesh) or step.mesh.GetCurveOrder() > 1:
            expected = "a mesh of straight triangles or tetrahedra with damage, whose slope is linear there"
            raise ParameterError("Simulation.mesh", step.mesh, expected)
        regularisation = step.model.regularisation
        if regularisation is not None and regularisation.delta_fields:
            expected = "0 with damage, which it would diffuse"
            raise ParameterError("Regularisation.delta_fields", regularisation.delta_fields, expected)
        size = float(step.context.h.vec.FV().NumPy().min())
        if law.length < size:
            message = Words(
                Mention("Damaged.length"),
                f" = {law.length:g} m is below the size of the smallest cell, {size:.3g} m: "
                "what breaks is a row of cells and costs more than G_c; take cells of half of it or less",
            )
            ranks.warn(message, InputWarning, stacklevel=6)

    def _forms(self, space: Any) -> tuple[BilinearForm, LinearForm]:
        """Forms of the second derivative H, and of the slope at delta = 0."""
        law, step = self.law, self.step
        z = step.now.z_tensors
        driving, _ = substituted(law, lambda expression: expression.at(z)).parts(z)
        thermal = part_of(step.model.material, Thermal)
        if thermal is not None and thermal.coupling:
            driving = driving + thermal.taken(z)[0]
        (d, test), weight = space.TnT(), law.weight(z)
        of_damage, of_slope = law.surface
        is_quadratic = law.law == "AT2"
        stiff = 1 - law.floor
        q = z[law.slope.name][:, 0]
        hessian, slope = BilinearForm(space, symmetric=True), LinearForm(space)
        curvature = 2 * stiff * driving + (2 * of_damage if is_quadratic else 0.0) * weight
        slopes = self._along(grad(d)) * self._along(grad(test))
        hessian += step.quadrature.cells(curvature * d * test + 2 * of_slope * weight * slopes)
        force = -2 * stiff * (1 - self.damage) * driving
        force += of_damage * weight * (2 * self.damage if is_quadratic else 1.0)
        carried = self._along(grad(test))
        along = sum(q[i] * carried[i] for i in range(step.mesh.dim))
        slope += step.quadrature.cells(force * test + 2 * of_slope * weight * along)
        return hessian, slope

    def _along(self, gradient: Any) -> Any:
        """Carried slope of a gradient: the gradient, or F^T times the gradient."""
        if self.law.area == "actual":
            return gradient
        dim = self.step.mesh.dim
        return self.step.now.z_tensors[WHOLE_F.name][:dim, :dim].trans * gradient

    def _at_vertices(self, function: Any) -> np.ndarray:
        return np.asarray(function(self._vertices)).reshape(-1)

    def start(self) -> None:
        """Make the present damage continuous, by the mean of each vertex' cells, and compute its slope."""
        values, dofs = self._at_vertices(self.damage), self._dofs
        size = len(self._masses)
        sums, counts = np.bincount(dofs, values, size), np.bincount(dofs, minlength=size)
        self._z()[self._rows] = 0.0
        self._add(np.clip(sums / np.maximum(counts, 1), 0.0, 1.0))

    def __call__(self, tau: float) -> tuple[dict[str, float], dict[str, float]]:
        """Let the damage grow over ``tau``, s; return dissipations, W, with ``GROWTH`` and ``CRACKED``, and
        numerical dissipations, J, by columns.

        Raises StepError if there is no minimum, for an energy that is not convex in the damage.
        """
        law, step = self.law, self.step
        H, f = csr(self._hessian.Assemble().mat), self._slope.Assemble().vec.FV().NumPy().copy()
        low, high = self._bounds()
        healing = law.viscosity if law.healing_viscosity is None else law.healing_viscosity
        rising, falling = (self._masses * viscosity / tau for viscosity in (law.viscosity, healing))
        try:
            minimum = minimise_in_box(H, f, (rising, falling), low, high)
        except StepError as error:
            raise StepError(f"damage: {error}; the material's energy is negative somewhere") from error
        delta, before = minimum.x, self._surface()
        self._add(delta)
        dissipated = np.where(delta < 0, falling, rising) * delta * delta
        rates = {DISSIPATION: float(dissipated.sum()) / tau}
        rates |= {GROWTH: float(delta.max()), CRACKED: (self._surface() - before) / law.G_c}
        if self._heat is not None:
            self._delta.vec.FV().NumPy()[:] = dissipated / np.where(self._masses > 0, self._masses, 1.0)
            rates |= self._heat(self._delta, tau)
        step.freeze()
        distance = float(0.5 * delta @ (H @ delta) - minimum.slope @ delta)
        return rates, {BREGMAN: distance}

    def _surface(self) -> float:
        """Energy of cracks, J."""
        return float(self.step.quadrature.integrate_cells(self._of_surface))

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of delta at every vertex."""
        values, dofs, size = self._at_vertices(self.damage), self._dofs, len(self._masses)
        low, high = np.full(size, -np.inf), np.full(size, np.inf)
        np.minimum.at(high, dofs, 1 - values)
        np.maximum.at(low, dofs, -values)
        unused = ~np.isfinite(high)
        low[unused] = high[unused] = 0.0
        if self.law.healing_viscosity is None:
            low[:] = 0.0
        return np.minimum(low, 0.0), np.maximum(high, 0.0)

    @property
    def _rows(self) -> list[int]:
        """Numbers of the components of damage and its slope."""
        slices = self.step.layout.states.slices
        return [
            slices[DAMAGE.name].start,
            *range(slices[self.law.slope.name].start, slices[self.law.slope.name].stop),
        ]

    def _z(self) -> np.ndarray:
        """View of the present coefficients of z, (components, functions)."""
        values = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
        return values.reshape(self.step.layout.states.size, -1)

    def _add(self, delta: np.ndarray) -> None:
        """Add delta and its slope to the present damage."""
        self._delta.vec.FV().NumPy()[:] = delta
        z, slope = self._z(), self._along(grad(self._delta))
        values = (self._delta, *(slope[j] for j in range(self.step.mesh.dim)))
        for row, value in zip(self._rows, values, strict=True):
            self._part.Set(value)
            z[row] += self._part.vec.FV().NumPy()


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
        before, heat, energy = (
            s.copy(),
            self.step.quadrature.each_cell(xi),
            self.step.quadrature.each_cell(self._heat),
        )
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
            if abs(missing).sum() <= _ROUNDING * abs(energy).sum():
                break
        produced = unit * self.step.quadrature.each_cell(self._added).sum()
        return {_POWER: float(heat.sum()) / tau, _PRODUCTION: float(produced) / tau}
