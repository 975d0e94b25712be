"""The equilibrium of a body at rest under its weight: the pressure that bears the loads, and the volume at
this pressure.

    grad p = f(rho),      p(J) = -tr T/3 at F = J^{1/3} I,      rho = rho_R/J, or the given density

p is continuous, one order above the variables, with int (grad p - f) . grad q = 0 for all q.  If the density
varies with the height alone, p is the weight of the matter above, for any domain and any layers.  If the
density also varies along a level, no pressure bears all loads, and a warning states the unborne share.  The
datum determines the constant in p.  J is the projected inverse of the bulk law, by Newton's method; each body
has its own J at the common p.

For k = 1 and m = 0 the cell means of p bear the loads that p bears, because div w is constant in cells.  m =
0 with any other k is refused, because the body would move. Constants in cells do not bear all loads on
velocities of order two: they bear at most 80, 90 and 95 % (in the dual of H1) on 2 x 4, 4 x 8 and 8 x 16
cells.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from ngsolve import (
    CF,
    H1,
    L2,
    BilinearForm,
    BitArray,
    CoefficientFunction,
    GridFunction,
    Integrate,
    LinearForm,
    Norm,
    Parameter,
    Periodic,
    dx,
    grad,
)

from ngvisco.errors import InitialDataError, InputWarning, ParameterError, require_known
from ngvisco.forms.given_values import bulk_pressure
from ngvisco.forms.mesh.locating import Located, as_points
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.mesh.symmetry import weighted
from ngvisco.forms.projections import LocalProjection
from ngvisco.forms.system import Step
from ngvisco.forms.term import tested
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.petsc import inverse_of, release
from ngvisco.physics.loads import force_of
from ngvisco.physics.material import part_of
from ngvisco.physics.materials.thermal import Thermal
from ngvisco.physics.materials.wrapped import carrying
from ngvisco.physics.parameters import parameters_in, value_at
from ngvisco.physics.tensors import if_positive
from ngvisco.physics.walls import Open

_ROUNDS, _STEPS = 100, 60
"""Largest numbers of iterations of the density, and of Newton steps for the volume."""
_CONVERGED = 1e-12
"""Change of J, relative to the largest J, at which both iterations end: the one for the density and Newton's
iteration for J."""
_FACTOR = 4.0
"""Largest factor of J in an iteration of the density.  If matter is too dense at first, its weight exceeds
the pressure at the ground.  The pressures above are then negative and have no J, until the matter has
expanded."""
_DIFFERENCE = 1e-5
"""Relative change of J in the difference quotient of the bulk law."""
_UNEQUAL = 0.01
"""Relative difference of the datum's pressure and its wall's pressure, above which a warning is given."""
_UNBORNE = 0.05
"""Share of the loads that no pressure bears, above which a warning is given."""


class Column:
    """The equilibrium of a step's loads.

    Parameters
    ----------
    given : mapping of names to functions
        Values of the material's parameters and of variables that are no strains.
    theta : coefficient function or None
        The temperature, K.
    shares : mapping of bodies' names to functions
        Volume fractions; empty for a single material.
    density : coefficient function or None
        Given density, kg/m^3; by default the density follows from rho_R or the bodies' densities, or is 1.
    """

    def __init__(
        self,
        step: Step,
        sampler: Sampler,
        given: Mapping[str, CoefficientFunction],
        theta: CoefficientFunction | None,
        shares: Mapping[str, CoefficientFunction],
        density: CoefficientFunction | None,
    ) -> None:
        self.step, self.sampler, self.given, self.theta = step, sampler, given, theta
        self.shares, self.mesh = shares, step.mesh
        self.density: CoefficientFunction | None = None
        if density is not None:  # the density is projected like the loads of a step
            self.density = GridFunction(L2(self.mesh, order=step.discretisation.m))
            LocalProjection(self.density, step.quadrature, tested(density))()
        laws = {body.name: body.material for body in step.model.bodies} or {"": step.model.material}
        self.laws = {name: carrying(law, parameters_in((law,))) for name, law in laws.items()}
        self.referential = {body.name: body.density or 0.0 for body in step.model.bodies}
        if not shares and (rho_R := step.model.material.referential_density) is not None:
            self.referential = {"": CF(value_at(rho_R, given))}
        if step.discretisation.m == 0 and step.discretisation.k > 1:
            expected = (
                "1 or 2, or k = 1 with m = 0, since a pressure that is constant in cells cannot balance the "
                f"weight of a hydrostatic start for velocities of order {step.discretisation.k}"
            )
            raise ParameterError("Discretisation.m", 0, expected)
        self.J = {name: GridFunction(L2(self.mesh, order=step.discretisation.m)) for name in self.laws}
        for J in self.J.values():
            J.vec[:] = 0.0
            J.Set(CF(1.0))
        space = H1(self.mesh, order=step.discretisation.m + 1)
        self.space = Periodic(space) if step.walls.periodic else space
        self.p, self.constant = GridFunction(self.space), Parameter(0.0)
        self.pressure = self.p + self.constant
        q, t = self.space.TnT()
        self._form = BilinearForm(self._weighed(grad(q) * grad(t)) * dx).Assemble()
        self._inverse = inverse_of(self._form.mat, self._solved(), sampler.ranks)

    def _weighed(self, integrand: CoefficientFunction) -> CoefficientFunction:
        return weighted(integrand, self.step.layout.symmetry.radius)

    def weight(self) -> CoefficientFunction:
        """Force density f of the loads, N/m^3, at t = 0."""
        dim, rho, loads = self.mesh.dim, self._rho(), self.step.model.loads
        forces = ((rho if load.is_weight else CF(1.0)) * force_of(load, dim) for load in loads)
        return sum(forces, CF((0.0,) * dim))

    def _rho(self) -> CoefficientFunction:
        if self.shares:
            return sum((self.referential[n] * self.shares[n] / self.J[n] for n in self.shares), CF(0.0))
        if self.density is not None:
            return self.density
        return self.referential[""] / self.J[""] if self.referential else CF(1.0)

    def pressure_of(self, name: str, J: CoefficientFunction, at_rest: bool = False) -> CoefficientFunction:
        """Pressure -tr T/3, Pa, of a body, or of a single material, "", at F = J^{1/3} I.

        ``at_rest`` takes the reference temperature in place of theta.
        """
        material, theta = self.laws[name], self.theta
        if at_rest and theta is not None and (thermal := part_of(material, Thermal)) is not None:
            theta = CF(thermal.theta_R)
        return bulk_pressure(material, J, self.given, theta)

    def solve(self, datum: object, above_rest: float) -> dict[str, GridFunction]:
        """Solve for J by the names of bodies, "" for a single material.

        At the datum the pressure exceeds its value at J = 1 and the reference temperature by ``above_rest``,
        Pa.  Raises InitialDataError if no pressure bears the weight, ParameterError or UnknownNameError for a
        datum that is neither a wall nor a point of the domain.
        """
        at, rest_pressure = self._at(datum), self._mean(lambda name: self.pressure_of(name, CF(1.0), True))
        for _ in range(_ROUNDS):
            weight = self._weighed(self.weight() * grad(self.space.TestFunction()))
            self.p.vec.data = self._inverse * LinearForm(weight * dx).Assemble().vec
            self.constant.Set(above_rest + at(rest_pressure) - at(self.p))
            if not (changed := [name for name in self.laws if not self._inverts(name)]):
                break
        else:
            low, high = self.sampler.extrema(self.pressure)
            law = "a bulk law" + (f" of body {changed[0]!r}" if changed[0] else "")
            expected = f"{law} that has a J at every pressure from {low:.4g} to {high:.4g} Pa"
            remedy = f"{expected}; take a lower column, or a larger pressure at the datum"
            raise InitialDataError("equilibrium", "no pressure was found that bears the weight", remedy)
        release(self._inverse)
        wall = self.step.walls.conditions[datum] if isinstance(datum, str) else None
        if isinstance(wall, Open) and wall.traction is None:
            given, inside = at(CF(wall.pressure)), at(self.pressure)
            if abs(inside - given) > _UNEQUAL * max(map(abs, (given, *self.sampler.extrema(self.pressure)))):
                self._warn(
                    f"Initial.datum_pressure gives {inside:.4g} Pa at the start on the wall {datum!r}, whose "
                    f"own pressure is {given:.4g} Pa; the difference loads the body from the first step on"
                )
        self._say_what_is_left()
        return self.J

    def _mean(self, value: Callable[[str], CoefficientFunction]) -> CoefficientFunction:
        """Mean of a function of the bodies, weighted by their volume fractions."""
        return (
            sum((share * value(n) for n, share in self.shares.items()), CF(0.0)) if self.shares else value("")
        )

    def _solved(self) -> BitArray:
        """The unknowns of p that are solved for: all free unknowns but one, which is set to 0."""
        exchange, free = Exchange.of(self.space, self.sampler.ranks), BitArray(self.space.FreeDofs())
        mine = np.flatnonzero(np.array(list(free), dtype=bool) & exchange.owned)
        first = [len(of_rank) > 0 for of_rank in self.sampler.ranks.gathered(mine)].index(True)
        is_zero = np.zeros(exchange.count)
        if self.sampler.ranks.rank == first:
            is_zero[mine[0]] = 1.0
        for number in np.flatnonzero(exchange.sum(is_zero)):
            free.Clear(int(number))
        return free

    def _inverts(self, name: str) -> bool:
        """Compute J, the projected inverse of the bulk law at p, within ``_FACTOR`` of the J before; return
        whether J has not changed."""
        J, ranks, values = self.J[name], self.sampler.ranks, self.J[name].vec.FV().NumPy()
        start, trial = GridFunction(J.space), GridFunction(J.space)
        start.vec.data, first = J.vec, values.copy()
        law, ahead, behind = (self.pressure_of(name, s * J) for s in (1.0, 1 + _DIFFERENCE, 1 - _DIFFERENCE))
        share = (law - self.pressure) * (2 * _DIFFERENCE) / (behind - ahead)  # relative increment of J
        share = if_positive(share - 1, CF(1.0), if_positive(share + 0.5, share, CF(-0.5)))
        low, better, high = start / _FACTOR, J * (1 + share), _FACTOR * start
        better = if_positive(low - better, low, if_positive(better - high, high, better)).Compile()
        for _ in range(_STEPS):
            trial.Set(better)
            new, before = trial.vec.FV().NumPy(), values.copy()
            if not ranks.all(np.isfinite(new).all()):
                break
            values[:] = new
            if ranks.most(abs(new - before)) <= (least := _CONVERGED * ranks.most(abs(new))):
                return ranks.most(abs(new - first)) <= least
        return False

    def _at(self, datum: object) -> Callable[[CoefficientFunction], float]:
        """Return a function that evaluates coefficient functions at the datum."""
        ranks, sampler = self.sampler.ranks, self.sampler
        if isinstance(datum, str):
            walls = self.step.walls
            require_known("wall", [datum], walls.conditions, "Initial.datum")
            region = walls.region([datum])
            area = float(Integrate(self._weighed(CF(1.0)), self.mesh, definedon=region))
            return lambda f: float(Integrate(self._weighed(f), self.mesh, definedon=region)) / area
        if datum is not None:
            where = as_points("Initial.datum_point", datum, self.mesh.dim)
            if len(where) != 1:
                raise ParameterError("Initial.datum_point", datum, "one point, in m")
            point = Located(self.mesh, where, ["Initial.datum_point"])
            return lambda f: float(np.asarray(point.values(CF((f, 0.0))))[0, 0])

        def highest(f: CoefficientFunction) -> float:
            pressures, mine = sampler.values(self.p), None
            if len(pressures):
                i = int(np.argmin(pressures))
                mine = float(pressures[i]), float(sampler.rows(f, np.array([i]))[0, 0])
            return min(entry for entry in ranks.gathered(mine) if entry is not None)[1]

        return highest

    def _say_what_is_left(self) -> None:
        """Warn if the loads are not a gradient."""
        force = self.weight()
        left, size = (
            float(Integrate(self._weighed(Norm(f)), self.mesh)) for f in (grad(self.p) - force, force)
        )
        if left > _UNBORNE * size:
            around = "the loads have a circulation around the periodic domain, or "
            self._warn(
                f"equilibrium: {left / size:.0%} of the loads are balanced by no pressure, since "
                f"{around * bool(self.step.layout.periodic)}the density varies within cells, or along level "
                "surfaces of the loads' potential. The body will therefore move"
            )

    def _warn(self, message: str) -> None:
        self.sampler.ranks.warn(message, InputWarning, stacklevel=5)


def require_open(step: Step, F: object, given: Mapping[str, object]) -> None:
    """Raise ParameterError for an equilibrium without loads, and for given strains that an equilibrium
    determines."""
    if not step.model.loads:
        expected = " without loads; an equilibrium needs a load, such as Gravity"
        raise ParameterError("Initial.equilibrium", "hydrostatic", None, expected)
    if F is not None:
        raise ParameterError("Initial.F", F, None, ", since F follows from the equilibrium")
    for v in step.model.material.variables:
        if v.is_strain and v.name in given:
            expected = "no value, since the strain follows from the equilibrium"
            raise ParameterError(f"Initial.values[{v.name!r}]", given[v.name], expected)
