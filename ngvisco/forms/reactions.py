"""The force and torque of the body on its walls, from the residual of the solved step.

The rows of the residual R(u; w) at the constrained coefficients of v are the walls' reaction.  The residual
also contains the terms of walls, which are subtracted.  The force of wall Gamma on the body in direction e is

    F_Gamma . e = R(u; w_Gamma) - (terms of Gamma)(u; e) + int (phi - z_f : zeta_f) (w_Gamma . n),

with w_Gamma = e at the coefficients that Gamma constrains. For the torque, e is the rotation e x (x - c). z_f
are the variables transported by their flux. The last integral appears because the scheme's elastic force is
B_h(w; z, zeta) = int T : grad w - int (phi - z_f : zeta_f) (w . n), which is int T : grad w only if w.n = 0
on walls.  The force is the consistent reaction of the elastic, viscous and hyperviscous stress. It converges
faster than an integral of T n.  If the trace on a wall has no energy (det B <= 0 beside a barrier), phi is
the projection of the energy in the cell.

If several walls constrain a component of v at a corner, they share the row of this component in proportion
to their n_i^2, so that each wall keeps its pressure; if all n_i are zero, their shares are equal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from ngsolve import CF, L2, CoefficientFunction, GridFunction, LinearForm, ds, specialcf, x, y, z

from ngvisco.errors import ParameterError, require_known
from ngvisco.forms.boundary.boundaries import facet_indicator
from ngvisco.forms.boundary.walls import MovingWalls
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.symmetry import Symmetry
from ngvisco.forms.projections import LocalProjection
from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand, tested
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange, Interpolation
from ngvisco.physics.tensors import if_positive, inner, is_number, masked


class WallReactions:
    """Force and torque on walls of a step, by default on all walls.

    Raises UnknownNameError for a name without a wall, ParameterError for a mesh without walls.

    Parameters
    ----------
    step : Step
    names : sequence of str, optional
    about : sequence of numbers
        The point c that torques refer to, m; of the mesh's dimension.
    """

    def __init__(self, step: Step, names: Sequence[str] | None, about: Sequence[float]) -> None:
        walls = step.walls.conditions
        self.step, self._ranks = step, Communicator.of(step.mesh)
        if not walls:
            expected = "at least one wall, but the mesh is periodic in all directions"
            raise ParameterError("WallForces.walls", "no walls", expected)
        self.names = list(walls) if names is None else list(names)
        require_known("wall", self.names, walls, "WallForces.walls")
        self.motions = rigid_motions(step.layout.symmetry, step.mesh.dim, about)
        space = step.layout.blocks["v"]
        interpolated, interpolate = GridFunction(space), Interpolation(space)
        self._tests: list[np.ndarray] = []
        for motion in self.motions.values():
            interpolate(interpolated, motion)
            self._tests.append(interpolated.vec.FV().NumPy().copy())
        self._weights = self._shares()
        # only walls in whose rows v is held need this integral: other walls have it in the residual or in the
        # term of their multipliers
        free = step.layout.velocity_space((None,) * step.mesh.dim)
        self._held = facet_indicator(step.mesh, {*walls} - {*step.walls.crossed, *step.walls.multiplied})
        normal_test = free.TestFunction() * step.context.normal
        self._energy = LinearForm(free)
        # a trace may have no energy although all points of the cells' rule have one
        self._projected = GridFunction(L2(step.mesh, order=step.discretisation.m))
        self._project = LocalProjection(
            self._projected, step.quadrature, tested(step.energy.density(step.now))
        )
        step.quadrature.add(self._energy, [Integrand(facets=self._energy_flux(step.now) * normal_test)])
        self._terms = {name: self._own_terms(name, step.now) for name in self.names}
        shared = sum((self._weights[name] for name in self.names), np.zeros(space.ndof))
        self._residual = step.residual_at(shared != 0)

    def _shares(self) -> dict[str, np.ndarray]:
        """Share of each wall in each coefficient of v, by names of walls."""
        step, mesh, walls = self.step, self.step.mesh, self.step.walls
        space = step.layout.velocity_space((None,) * mesh.dim)
        n, w = specialcf.normal(mesh.dim), space.TestFunction()
        squares = CF(tuple(n[i] * n[i] for i in range(mesh.dim)))
        hats = np.arange(space.ndof) % (space.ndof // mesh.dim) < mesh.nv  # other basis functions change sign
        exchange, masks, claims = Exchange.of(space, self._ranks), {}, {}
        for name in walls.conditions:
            region, is_held = walls.region([name]), name in walls.held
            regions = [region if is_held or name in of_axis else None for of_axis in walls.axis]
            masks[name] = mask = MovingWalls.constrained(step.layout, regions)
            load = LinearForm(inner(squares, w.Trace()) * ds(definedon=region))
            claims[name] = np.where(mask & hats, exchange.sum(load.Assemble().vec.FV().NumPy()), 0.0)
        scale = max((self._ranks.most(claim) for claim in claims.values()), default=0.0)
        total = sum(claims.values(), np.zeros(space.ndof))
        count = np.maximum(sum((mask.astype(float) for mask in masks.values()), np.zeros(space.ndof)), 1.0)
        claimed = total > 1e-8 * scale
        return {
            name: np.where(claimed, claims[name] / np.where(claimed, total, 1.0), mask / count)
            for name, mask in masks.items()
        }

    def _beside(self, u: Fields) -> CoefficientFunction:
        """Pressure phi - z_f : zeta_f, Pa, where every trace has a value of phi."""
        phi = self.step.energy.anywhere(u)
        return beside_the_stress(u, is_number(phi, phi, self._projected))

    def _energy_flux(self, u: Fields) -> CoefficientFunction:
        """The pressure that the residual lacks on walls that nothing crosses, Pa."""
        return if_positive(self._held, self._beside(u), 0.0)

    def _own_terms(self, name: str, u: Fields) -> list[list[CoefficientFunction]]:
        """Integrands of given stress, friction and multiplier on a wall, for each rigid motion."""
        step = self.step
        rows = []
        for motion in self.motions.values():
            w = Fields(step.layout, {"v": motion})
            parts = [part for term in step.point_terms if term.wall == name for part in term.on_body(u, w)]
            if name in step.walls.multiplied:
                excess = u.wall_stress
                if name not in step.walls.crossed:
                    excess = excess - self._beside(u)
                parts.append(facet_indicator(step.mesh, [name]) * excess * (motion * step.context.normal))
            rows.append(parts)
        return rows

    def of_rows(self, rows: np.ndarray) -> np.ndarray:
        """Force and torque on each wall, (walls, motions), from the reaction in the rows of v, N.

        Over ranks the rows are sums of the ranks' parts.
        """
        sums = np.array([[self.weights(n, motion) @ rows for motion in self.motions] for n in self.names])
        return self._ranks.totals(sums)

    def weights(self, name: str, motion: str) -> np.ndarray:
        """Weights -w_Gamma of the rows of v in a component of force or torque on a wall."""
        return -self._weights[name] * self._tests[list(self.motions).index(motion)]

    def beside_the_rows(self, name: str, motion: str, u: Fields) -> tuple[Integrand, Callable[[], None]]:
        """Summands at ``u`` of a component of force or torque on a wall, other than the residual's rows.

        After a call of the returned function, the derivative of the summands by u is exact at the present
        state.
        """
        step, energy = self.step, self.step.energy
        w = GridFunction(step.layout.blocks["v"])
        w.vec.FV().NumPy()[:] = self.weights(name, motion)
        normal = w * step.context.normal
        integrands = self._own_terms(name, u)[list(self.motions).index(motion)]
        # a projected energy has the derivative int phi' q, with q the projection of the energy's factor
        is_projected = CF(1.0)
        if energy.projected is None:
            is_projected = is_number(energy.anywhere(step.now), 0.0, 1.0)
        factor = if_positive(self._held, is_projected, 0.0) * normal
        if name in step.walls.multiplied and name not in step.walls.crossed:
            along = self.motions[motion] * step.context.normal
            factor = factor - facet_indicator(step.mesh, [name]) * is_projected * along
        q = GridFunction(self._projected.space)
        project = LocalProjection(q, step.quadrature, lambda test: [Integrand(facets=factor * test)])
        return Integrand(q * energy.near(u), sum(integrands, self._energy_flux(u) * normal)), project

    def __call__(self) -> dict[str, list[float]]:
        """The components of force, N, and of torque, N m, on each wall.

        In plane strain they are per metre; for a body of revolution the force is the axial force over 2 pi.
        The components belong to the solution of the last Rothe step: the state must be this solution, with
        the step's old state, length and loads in place.  For a scheme with stages or an extrapolated end see
        ``ngvisco.run.probes.WallForces``.
        """
        step, integrate = self.step, self.step.quadrature.integrate_facets
        residual = step.state.vec.CreateVector()
        self._residual.Apply(step.state.vec, residual)
        self._project()
        self._energy.Assemble()
        rows = residual.FV().NumPy()[step.layout.ranges["v"]] + self._energy.vec.FV().NumPy()
        result = {}
        for name, of_rows in zip(self.names, self.of_rows(rows), strict=True):
            sums = [sum(integrate(part) for part in parts) for parts in self._terms[name]]
            result[name] = [float(value) for value in of_rows + np.array(sums)]
        return result


def beside_the_stress(u: Fields, phi: CoefficientFunction) -> CoefficientFunction:
    """Pressure phi - z_f : zeta_f, Pa, that B_h(w; z, zeta) omits on a closed wall. z_f are the variables
    that are transported by their flux."""
    by_flux = u.layout.states.by_flux
    return phi - inner(masked(u.z, by_flux), u.zeta) if by_flux.any() else phi


def rigid_motions(symmetry: Symmetry, dim: int, about: Sequence[float]) -> dict[str, CoefficientFunction]:
    """Translations and rotations about a point, by the names of force and torque components.

    A body of revolution has the translation along its axis only.
    """
    r = [coordinate - c for coordinate, c in zip((x, y, z), about, strict=False)]
    units = [CF(tuple(float(i == j) for i in range(dim))) for j in range(dim)]
    motions = {f"force_{i + 1}": unit for i, unit in enumerate(units)}
    if symmetry.is_axisymmetric:
        return {"force_2": units[1]}
    if dim == 2:
        return motions | {"torque": CF((-r[1], r[0]))}
    spins = (CF((0.0, -r[2], r[1])), CF((r[2], 0.0, -r[0])), CF((-r[1], r[0], 0.0)))
    return motions | {f"torque_{i + 1}": spin for i, spin in enumerate(spins)}
