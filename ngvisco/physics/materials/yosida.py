"""The Yosida approximation of a stored energy (paper: varphi-regularized)."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.errors import NgviscoError, Quantity
from ngvisco.physics.material import Wrapper
from ngvisco.physics.pointwise import Respond, Response, respond, states_of
from ngvisco.physics.variables import Values, Variable

_MAX_ITERATIONS = 200
_MAX_HALVINGS = 40
_CONVERGED = 1e-8
"""Relative size of the last Newton increment: quadratic convergence takes it to rounding."""
_ROUNDING = 1e-12
"""Relative size of a residual that is rounding, where no step makes it smaller."""
_SHARE = 0.1
"""What a step leaves of a variable that must stay positive, at least; and its smallest start value."""


@dataclass(frozen=True, kw_only=True)
class Yosida(Wrapper):
    """phi_eps(z) = min over y of phi(y) + |z - y|^2/(2 eps), over all strains jointly, at fixed parameters.

    Convex where phi is, phi_eps <= phi, with the slope phi_eps'(z) = (z - y)/eps = phi'(y), whose Lipschitz
    constant is at most 1/eps; phi_eps = phi - eps/2 |phi'|^2 + O(eps^2).  It is finite for all z, also
    for J <= 0.  At rest the stress changes by O(eps), and so does a body's stiffness: K becomes
    K/(1 + eps K) for phi = K z^2/2.  |.| is the Frobenius norm of tensors.

    y is found by a damped Newton iteration at every quadrature point, from a start value that depends on
    z alone, so that the energy is a function of the state and of nothing else.  There is no expression
    for it: ``energy`` raises, and the Cauchy stress for output has the cellwise L2 projection of phi_eps.
    Raises ParameterError if eps is not a finite positive number or ``material`` is none.

    Parameters
    ----------
    material : Material
        The material that is regularised: its energy convex, or at least |z|^2/(2 eps) + phi so.
    eps : float
        Width of the approximation, the paper's epsilon.
    """

    eps: Annotated[float, Quantity("1/Pa", "> 0", 1e-3)]

    @property
    def continued(self) -> frozenset[str]:
        return frozenset(variable.name for variable in self.variables if variable.is_strain)

    def energy(self, z: Values) -> CoefficientFunction:
        raise NgviscoError(
            "a Yosida approximation has no expression: use ngvisco.physics.pointwise.respond(material, dim), "
            "which gives its energy and derivatives for arrays of states"
        )

    def response(self, dim: int) -> Respond:
        return _Approximation(self, dim)


class _Approximation:
    """phi_eps and its derivatives, from the minimisers y."""

    def __init__(self, material: Yosida, dim: int) -> None:
        self.eps = material.eps
        self.inner = respond(material.material, dim)
        self.rest = states_of(material, np.eye(3)[None], dim)[0]
        slices = material.states(dim).slices
        self.weights = np.zeros(material.states(dim).size)
        """eps of every component: 0 for parameters, which are not minimised over."""
        for variable in material.variables:
            if variable.is_strain:
                self.weights[slices[variable.name]] = material.eps
        self.positive = [slices[v.name].start for v in material.variables if self._is_bounded(v, slices)]

    def _is_bounded(self, variable: Variable, slices: dict[str, slice]) -> bool:
        """Whether y must be kept positive: J or A in an energy that is singular at 0 or undefined below."""
        if variable.kind != "scalar" or not variable.positive(CF(1.0)):
            return False
        states = np.tile(self.rest, (3, 1))
        states[:, slices[variable.name].start] = (0.0, -0.01, -1.0)
        return not bool(self.inner(states).finite.all())

    def __call__(self, states: np.ndarray) -> Response:
        n, size = states.shape
        energy, slope = np.full(n, np.nan), np.full((n, size), np.nan)
        hessian = np.full((n, size, size), np.nan)
        given = np.flatnonzero(np.isfinite(states).all(axis=1))
        with np.errstate(all="ignore"):
            y, at_y, solved = self._minimise(states[given])
            z, where = states[given][solved], given[solved]
            S, H = at_y.slope[solved], at_y.hessian[solved]
            root = np.sqrt(self.weights)
            system = np.eye(size) + root[:, None] * H * root
            # for a convex energy all are 1 and more
            definite = np.linalg.eigvalsh(system)[:, 0] > 0
            where, z, S, H = (a[definite] for a in (where, z, S, H))
            H = np.linalg.solve(np.eye(size) + H * self.weights, H)
            H = 0.5 * (H + H.transpose(0, 2, 1))
            # phi'(y) loses no digits for small eps, as (z - y)/eps does; corrected for the rounding in y
            rest = z - y[solved][definite] - self.weights * S
            S = S + np.einsum("nij,nj->ni", H, rest)
            energy[where] = at_y.energy[solved][definite] + 0.5 * (S * S) @ self.weights
            slope[where], hessian[where] = S, H
        return Response(energy, slope, hessian, self._failure(states, given, solved, definite))

    def _failure(
        self, states: np.ndarray, given: np.ndarray, solved: np.ndarray, definite: np.ndarray
    ) -> str | None:
        text = f"Yosida approximation with eps = {self.eps:g}: "
        if len(given) < len(states):
            return f"{text}the variables are not finite at {len(states) - len(given)} points"
        if not solved.all():
            i = given[~solved][0]
            return (
                f"{text}no minimiser at {int((~solved).sum())} points, e.g. for the components "
                f"{np.array2string(states[i], precision=4)}: the energy is not convex, or not "
                "singular where it ends"
            )
        if not definite.all():
            i = given[solved][~definite][0]
            return (
                f"{text}{int((~definite).sum())} points are no minima, e.g. for the components "
                f"{np.array2string(states[i], precision=4)}: the energy is not convex, take a smaller eps"
            )
        return None

    def _start(self, z: np.ndarray) -> tuple[np.ndarray, Response]:
        """z moved into the domain; the rest state where that is not enough."""
        y = z.copy()
        y[:, self.positive] = np.maximum(y[:, self.positive], _SHARE)
        at_y = self.inner(y)
        outside = ~at_y.finite
        if outside.any():
            y[outside] = np.where(self.weights > 0, self.rest, z[outside])
            at_y = self.inner(y)
        return y, at_y

    def _minimise(self, z: np.ndarray) -> tuple[np.ndarray, Response, np.ndarray]:
        """The minimisers y, the inner response there, and where they were found.

        Newton for r(y) = y - z + eps phi'(y) = 0, eps = 0 for parameters.  r' >= I where phi is convex, so
        that halving the step until |r| decreases converges from everywhere.
        """
        size = z.shape[1]
        y, at_y = self._start(z)
        energy, slope, hessian = at_y.energy, at_y.slope, at_y.hessian
        solved, active = np.zeros(len(z), dtype=bool), np.flatnonzero(at_y.finite)
        for _ in range(_MAX_ITERATIONS):
            if not len(active):
                break
            r = y[active] - z[active] + self.weights * slope[active]
            d = _solve(np.eye(size) + self.weights[:, None] * hessian[active], -r)
            length = self._admitted(y[active], d)
            small = np.abs(d).max(axis=1) <= _CONVERGED * np.abs(y[active]).max(axis=1)
            for i in self.positive:
                small &= np.abs(d[:, i]) <= _CONVERGED * y[active, i]
            bound = np.linalg.norm(r, axis=1)
            trying, moved = np.arange(len(active)), np.zeros(len(active), dtype=bool)
            for _ in range(_MAX_HALVINGS):
                trial = y[active[trying]] + length[trying, None] * d[trying]
                at = self.inner(trial)
                next_r = np.linalg.norm(trial - z[active[trying]] + self.weights * at.slope, axis=1)
                shorter = next_r <= (1 - 1e-4 * length[trying]) * bound[trying]
                good = at.finite & (small[trying] | shorter)
                taken = active[trying[good]]
                y[taken], energy[taken] = trial[good], at.energy[good]
                slope[taken], hessian[taken] = at.slope[good], at.hessian[good]
                moved[trying[good]] = True
                trying = trying[~good]
                if not len(trying):
                    break
                length[trying] /= 2
            magnitude = np.abs(y[active]).max(axis=1) + np.abs(z[active]).max(axis=1)
            magnitude += np.abs(self.weights * slope[active]).max(axis=1)
            done = (small & moved) | (~moved & (bound <= _ROUNDING * magnitude))
            solved[active[done]] = True
            active = active[moved & ~done]
        return y, Response(energy, slope, hessian), solved

    def _admitted(self, y: np.ndarray, d: np.ndarray) -> np.ndarray:
        """The longest step, 1 at most, that leaves a share of what must stay positive."""
        length = np.ones(len(y))
        for i in self.positive:
            down = d[:, i] < 0
            length[down] = np.minimum(length[down], (_SHARE - 1) * y[down, i] / d[down, i])
        return length


def _solve(matrices: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solutions of many small systems; NaN for all of a batch with a singular one, which then fails."""
    try:
        return np.linalg.solve(matrices, rhs[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        regular = np.abs(np.linalg.det(matrices)) > 0
        solution = np.full_like(rhs, np.nan)
        solution[regular] = np.linalg.solve(matrices[regular], rhs[regular][:, :, None])[:, :, 0]
        return solution
