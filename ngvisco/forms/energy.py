"""The stored energy phi and its derivative, as functions of a step's fields; no other module evaluates them.

For an energy with an expression, phi and phi' are expressions.  For any other energy (``Material.response``,
e.g. a Yosida approximation) phi(z_k) and phi'(z_k) are computed for a state z_k, and stored at the quadrature
points.  The slope is then

    slope(z) = phi'(z_k) + phi''(z_k) (z - z_k).

At z = z_k the slope and its derivative are exact, as a residual and its Jacobian need.  ``refresh`` updates
the stored values to the present state, and is called before every use. The values depend on z alone, so that
checkpoints omit them.  Further states (``follow``) have values of their own. The sides of cells have
projections of phi and phi'.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sp
from ngsolve import CF, L2, CoefficientFunction, Discontinuous, FacetFESpace, GridFunction
from scipy.sparse.linalg import splu

from ngvisco.errors import StepError
from ngvisco.forms.mesh.points import SidePoints
from ngvisco.forms.mesh.quadrature import Quadrature, Sampler, values_of
from ngvisco.forms.unknown_values import UnknownValues
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.material import Material, along, conjugates
from ngvisco.physics.response import Respond
from ngvisco.physics.tensors import inner
from ngvisco.physics.variables import Values


class StoredEnergy:
    """Energy phi and slope phi' of a material with an expression for phi."""

    failure: str | None = None
    """Reason why the energy is not a number at the state of the last ``refresh``, or None."""
    last_failure: str | None = None
    """The last ``failure`` at any state; code that looks for a new failure first sets it to None."""
    projected: GridFunction | None = None
    """Cellwise projection of the energy, for an energy that has values at quadrature points only; else
    None."""

    def __init__(self, material: Material, dim: int) -> None:
        self.material, self.dim = material, dim

    def lacked(self, u: UnknownValues) -> None:
        """Note as ``last_failure`` that an iterate had no energy; the note names bounds of the energy's
        domain."""
        bounds = " and ".join(f"{name} > 0" for name in self.material.domain(u.z_tensors))
        variables = ", ".join(variable.name for variable in self.material.variables)
        domain = f"; the energy of {variables} has values only where {bounds}" if bounds else ""
        self.last_failure = f"the stored energy of an iterate was not a number{domain}"

    def density(self, u: UnknownValues) -> CoefficientFunction:
        """Energy phi(z), Pa, for integrals by the rule of the forms."""
        return self.material.energy(u.z_tensors)

    def slope(self, u: UnknownValues) -> CoefficientFunction:
        """Components of phi'(z), Pa, for integrals by the rule of the forms."""
        return self.material.states(self.dim).components(self._conjugates(u))

    def _conjugates(self, u: UnknownValues) -> Values:
        """Conjugates phi'(z). Conjugates of variables that do not lag read the lagged variables of the step's
        start."""
        z, lagged = u.z_tensors, self.material.lagged
        if not lagged:
            return conjugates(self.material, z)
        before = u.context.lagged.z_tensors
        seen = {name: before[name] if name in lagged else value for name, value in z.items()}
        of_others, own_conjugates = conjugates(self.material, seen), conjugates(self.material, z)
        return {name: own_conjugates[name] if name in lagged else of_others[name] for name in z}

    def tested_slope(self, u: UnknownValues, w: UnknownValues) -> list[CoefficientFunction]:
        """Summands of phi'(z) : X, with their derivative by z; X is the test function of zeta."""
        return [inner(S, w.zeta_tensors[name]) for name, S in self._conjugates(u).items()]

    def curved(
        self, u: UnknownValues, slope: CoefficientFunction, test: CoefficientFunction
    ) -> list[CoefficientFunction]:
        """Summands phi''(z) q_j : Y_j, where j numbers the columns of a slope q of z and of Y, (components,
        dim).

        Each summand is a derivative in two directions, and therefore a scalar.  A gradient of the derivative
        in one direction would have tensors of fourth order. For ``Ogden``, NGSolve takes half a minute to
        find the pattern of these tensors.
        """
        states = self.material.states(self.dim)
        variables = {name: value.MakeVariable() for name, value in u.z_tensors.items()}
        summands = []
        for j in range(self.dim):
            derivative = self.material.energy(variables)
            for matrix in (slope, test):
                derivative = along(derivative, variables, states.tensors(partial(column, matrix, j)))
            summands.append(derivative)
        return summands

    def near(self, u: UnknownValues) -> CoefficientFunction:
        """Energy phi(z), Pa, for integrals by the rule of the forms, with its derivative by z."""
        return self.density(u)

    def anywhere(self, u: UnknownValues) -> CoefficientFunction:
        """Energy phi(z), Pa, for evaluation at any point."""
        return self.density(u)

    def on_sides(self, u: UnknownValues) -> CoefficientFunction:
        """Energy phi(z), Pa, or its mean over a cell's side, for integrals over sides; updated by
        ``refresh_sides``."""
        return self.density(u)

    def refresh_sides(self) -> None:
        """Update ``on_sides`` to the present state."""

    def samples(self, z: Values, sampler: Sampler) -> np.ndarray:
        """Energy phi(z), Pa, at the sampler's points. It is not finite where phi has no value
        (``last_failure``)."""
        return sampler.values(self.material.energy(z))

    def follow(self, u: UnknownValues) -> None:
        """Make phi(z) and phi'(z) available also at ``u``, fields of grid functions."""

    def refresh(self, u: UnknownValues | None = None) -> bool:
        """Update the energy to ``u``, by default the present state; return whether the energy changed."""
        return False

    def require(self) -> None:
        """Update the energy; raise StepError if the energy is not a number."""


class PointwiseEnergy(StoredEnergy):
    """Energy phi and slope phi' of a material with a response at points, at present and followed states."""

    def __init__(
        self, material: Material, response: Respond, quadrature: Quadrature, now: UnknownValues, order: int
    ) -> None:
        """``quadrature`` has an even degree; ``order`` is the order of the projected energy."""
        super().__init__(material, quadrature.mesh.dim)
        self.response, self.fields = response, now
        self._ranks = Communicator.of(quadrature.mesh)
        self._own_failure: str | None = None
        self._quadrature, self._size = quadrature, material.states(self.dim).size
        self._values: dict[UnknownValues, _Values] = {}
        self.follow(now)
        self._lagged = np.zeros((self._size, 1), dtype=bool)
        for name in material.lagged:
            self._lagged[material.states(self.dim).slices[name]] = True
        self._hessian = quadrature.vectors(self._size * self._size)
        self.projected = GridFunction(L2(quadrature.mesh, order=order))
        self._at_sides: _SideValues | None = None

    def follow(self, u: UnknownValues) -> None:
        self._values[u] = _Values(*(self._quadrature.vectors(size) for size in (1, self._size, self._size)))

    def density(self, u: UnknownValues) -> CoefficientFunction:
        return self._values.get(u, self._values[self.fields]).energy.components[0]

    def slope(self, u: UnknownValues) -> CoefficientFunction:
        if u is not self.fields and u in self._values:
            return self._values[u].slope
        now = self._values[self.fields]  # values must be linear in u.z, since u may have trial functions
        return now.slope + self._hessian.Reshape((self._size, self._size)) * (u.z - now.state)

    def tested_slope(self, u: UnknownValues, w: UnknownValues) -> list[CoefficientFunction]:
        slope = self.material.states(self.dim).tensors(lambda: self.slope(u))
        return [inner(S, w.zeta_tensors[name]) for name, S in slope.items()]

    def curved(
        self, u: UnknownValues, slope: CoefficientFunction, test: CoefficientFunction
    ) -> list[CoefficientFunction]:
        # phi'' at the state; Newton's matrix does not contain the derivative of phi''
        hessian = self._hessian.Reshape((self._size, self._size))
        return [inner(hessian * column(slope, j), column(test, j)) for j in range(self.dim)]

    def near(self, u: UnknownValues) -> CoefficientFunction:
        now = self._values[self.fields]
        return now.energy.components[0] + inner(now.slope, u.z - now.state)

    def anywhere(self, u: UnknownValues) -> CoefficientFunction:
        return self.projected

    def on_sides(self, u: UnknownValues) -> CoefficientFunction:
        if self._at_sides is None:
            self._at_sides = _SideValues(self._quadrature, self.fields, self._size)
        here = self._at_sides
        return here.energy if u is self.fields else here.energy + inner(here.slope, u.z - self.fields.z)

    def refresh_sides(self) -> None:
        if self._at_sides is not None:
            self._at_sides.refresh(self.response)

    def samples(self, z: Values, sampler: Sampler) -> np.ndarray:
        response = self.response(sampler.rows(self.material.states(self.dim).components(z)))
        self.last_failure = response.failure or self.last_failure
        return response.energy

    def refresh(self, u: UnknownValues | None = None) -> bool:
        u = self.fields if u is None else u
        # a change or a failure on one rank counts on all ranks
        results = self._ranks.gathered((self._refreshed(u), self._own_failure))
        changed = any(is_new for is_new, _ in results)
        if changed and u is self.fields:
            self.failure = next((failure for _, failure in results if failure is not None), None)
            self.last_failure = self.failure or self.last_failure
        return changed

    def _refreshed(self, u: UnknownValues) -> bool:
        """Update the energy on this rank; return whether the energy changed."""
        mine = self._values[u]
        seen = self._seen(u, mine.state)
        mine.state.Interpolate(u.z)
        states = values_of(mine.state)
        if mine.is_at(states, seen):
            return False
        of_lagged = () if seen is None else (np.where(self._lagged, seen, states).T,)
        if u is self.fields:
            response = self.response(states.T, *of_lagged)
            self._own_failure = response.failure
            values_of(self._hessian)[:] = response.hessian.reshape(len(response.energy), self._size**2).T
            energy, slope = response.energy, response.slope.T
        else:  # the values at this state are mostly known
            met = next((v for v in self._values.values() if v.is_at(states, seen)), None)
            if met is None:
                response = self.response(states.T, *of_lagged)
                energy, slope = response.energy, response.slope.T
            else:
                energy, slope = values_of(met.energy)[0].copy(), values_of(met.slope).copy()
        values_of(mine.energy)[0] = energy
        values_of(mine.slope)[:] = slope
        mine.at, mine.seen = states.copy(), seen
        return True

    def _seen(self, u: UnknownValues, at_points: GridFunction) -> np.ndarray | None:
        """z at the points with the lagged variables of the step's start; None without such variables."""
        if not self._lagged.any():
            return None
        at_points.Interpolate(u.context.lagged.z)
        return values_of(at_points).copy()

    def require(self) -> None:
        self.refresh()
        if self.failure is not None:
            raise StepError(self.failure)


def column(matrix: CoefficientFunction, j: int) -> CoefficientFunction:
    """Column j of a matrix-valued function."""
    return matrix * CF(tuple(float(i == j) for i in range(matrix.dims[1])))


@dataclass
class _Values:
    """Energy phi, state and slope phi' at the quadrature points, and the state at which they were
    computed."""

    energy: GridFunction
    state: GridFunction
    slope: GridFunction
    at: np.ndarray | None = None
    seen: np.ndarray | None = None
    """z of the step's start at the points; the slope reads its lagged variables. None without such
    variables."""

    def is_at(self, states: np.ndarray, seen: np.ndarray | None) -> bool:
        """Whether the stored energy and slope were computed at ``states``, and with the lagged variables
        ``seen``."""
        if self.at is None or not np.array_equal(states, self.at):
            return False
        return seen is None or (self.seen is not None and np.array_equal(seen, self.seen))


class _SideValues:
    """Energy phi and slope phi' on the sides of cells, L2 projections to P_m of each side.

    For z in P_m, integrals of phi and phi' : z over a side equal those of the values at the rule's points.
    """

    def __init__(self, quadrature: Quadrature, fields: UnknownValues, size: int) -> None:
        self._points = SidePoints(quadrature.mesh, quadrature.facet_degree, quadrature.symmetry)
        self._z, self._at_points = fields.z, self._points.values(fields.layout.scalar_space("z"))
        space = Discontinuous(FacetFESpace(quadrature.mesh, order=fields.layout.unknowns["z"].order))
        values = GridFunction(space ** (1 + size))
        self.energy, self.slope = values.components[0], CF(tuple(values.components[1:]))
        self._values = values
        onto = self._points.values(space)
        self._loads = (onto.T @ sp.diags(self._points.weights)).tocsr()
        self._mass = splu((self._loads @ onto).tocsc())
        self._at: np.ndarray | None = None

    def refresh(self, response: Respond) -> None:
        """Update the values to the present state."""
        z = self._z.vec.FV().NumPy()
        if not len(z) or (self._at is not None and np.array_equal(z, self._at)):  # a rank may have no cells
            return
        self._at = z.copy()
        responses = response(self._at_points @ z.reshape(-1, self._at_points.shape[1]).T)
        values = np.column_stack((responses.energy, responses.slope))
        self._values.vec.FV().NumPy()[:] = self._mass.solve(self._loads @ values).T.ravel()
