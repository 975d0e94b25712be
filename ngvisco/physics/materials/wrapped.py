"""Materials that wrap another material: the paper's regularisations of energies, and materials with carried
parameters and plastic strains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Annotated

import numpy as np
from ngsolve import CF

from ngvisco.errors import NgviscoError, ParameterError, Quantity, listed, require_known
from ngvisco.physics.flow_rules.rule import Hardening, PlasticContent
from ngvisco.physics.material import Material, Wrapper
from ngvisco.physics.parameters import Parameter, distinct, substituted
from ngvisco.physics.pointwise import respond, rest_state
from ngvisco.physics.response import Respond, Response
from ngvisco.physics.tensors import Tensor, inner
from ngvisco.physics.variables import ReciprocalJacobian, Values, Variable


@dataclass(frozen=True, kw_only=True)
class Carrying(Wrapper):
    """phi(z, theta) + A phi_h(K/A): a material whose moduli read carried parameters theta. If the material
    hardens, the second term is the energy of the carried plastic strain k = K/A, and A = 1/J is carried too.

    ``Model`` makes this wrapper if a modulus of its laws is not a number, or a flow rule hardens.
    """

    carried: tuple[Parameter, ...] = ()
    """Parameters of the material's moduli and of the model's other laws, which the material does not
    carry."""
    hardening: tuple[tuple[PlasticContent, Hardening], ...] = ()
    """Pairs of a carried plastic content and its energy, one for each branch that hardens."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        variables = self.material.variables
        if not self.hardening:
            return (*variables, *self.carried)
        volume = () if ReciprocalJacobian() in variables else (ReciprocalJacobian(),)
        return (*variables, *volume, *self.carried, *(content for content, _ in self.hardening))

    @property
    def lagged(self) -> frozenset[str]:
        return self.material.lagged

    @property
    def summed(self) -> tuple[tuple[str, ...], ...]:
        return self.material.summed

    def energy(self, z: Values) -> Tensor:
        at_this_point = substituted(self.material, lambda expression: expression.at(z))
        phi = at_this_point.energy({v.name: z[v.name] for v in self.material.variables})
        return reduce(add, (law.energy(z["A"], z[content.name], z) for content, law in self.hardening), phi)

    def domain(self, z: Values) -> Values:
        at_this_point = substituted(self.material, lambda expression: expression.at(z))
        return at_this_point.domain({v.name: z[v.name] for v in self.material.variables})


def carrying(
    material: Material,
    parameters: Sequence[Parameter],
    hardening: tuple[tuple[PlasticContent, Hardening], ...] = (),
) -> Material:
    """The material with ``parameters`` among its variables, and with ``hardening`` as its only hardening.

    Regularising wrappers stay the outermost ones.  Raises ParameterError for a parameter with the name of a
    different parameter of the material.
    """
    if isinstance(material, (WithQuadratic, Yosida)):
        return replace(material, material=carrying(material.material, parameters, hardening))
    if isinstance(material, Carrying):
        return carrying(material.material, (*material.carried, *parameters), hardening)
    if not (parameters or hardening):
        return material
    present = tuple(v for v in material.variables if isinstance(v, Parameter))
    carried = distinct((*present, *parameters))[len(present) :]
    return Carrying(material=material, carried=carried, hardening=hardening)


@dataclass(frozen=True, kw_only=True)
class WithQuadratic(Wrapper):
    """phi + sqrt(delta)/2 sum_i |z_i|^2 (paper: varphi-regularized).

    The added term makes a convex energy strongly convex, and adds a stress of the order of sqrt(delta) at
    rest. The ledger has the added energy within ``stored``, and alone as ``stored_quadratic``.  Raises
    ParameterError for a delta that is not positive, and for names that belong in part to the variables by F,
    in part to those by B; raises UnknownNameError for an unknown variable.

    Parameters
    ----------
    material : Material
        The material that is regularised.
    delta : float
        Coefficient of the term sqrt(delta)/2 |z|^2 that is added to the energy.
    only : tuple of str, optional
        Names of the variables in the added term, no parameters; default all strains (paper:
        rem-neo-Hookean-ref omits variables in which phi is strongly convex already).  If ``elastic_state``
        is not given, names that belong to F alone or to B alone determine the elastic state.
    """

    delta: Annotated[float, Quantity("Pa^2", "> 0", 1e-6)]
    only: Annotated[tuple[str, ...] | None, Quantity(example=["J"])] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        forms = [self.material.with_elastic_state("F"), self.material.with_elastic_state("B")]
        strains = [{v.name for v in form.variables if v.is_strain} for form in forms]
        strain_names, named = strains[0] | strains[1], set(self.only or ())
        require_known("material variable", sorted(named), strain_names, "WithQuadratic.only")
        having = [form for form, names in zip(forms, strains, strict=True) if named <= names]
        if not having:
            expected = " or ".join(f"names among {listed(sorted(names))} only" for names in strains)
            raise ParameterError("WithQuadratic.only", self.only, expected)
        if len(having) == 1:  # the names belong to F alone or to B alone
            object.__setattr__(self, "material", having[0])

    @property
    def _regularised(self) -> list[str]:
        """Names of the variables in the added term."""
        return list(self.only or (v.name for v in self.variables if v.is_strain))

    @property
    def conformation(self) -> str | None:
        return None  # because the added energy has a stress at rest

    def conformation_of(self, branch: str) -> str | None:
        return None

    def energy(self, z: Values) -> Tensor:
        return self.material.energy(z) + self.added_energy(z)

    def response(self, dim: int) -> Respond | None:
        inner_response = self.material.response(dim)
        if inner_response is None:
            return None
        slices, weights = self.states(dim).slices, np.zeros(self.states(dim).size)
        for name in self._regularised:
            weights[slices[name]] = self.delta**0.5

        def respond(states: np.ndarray) -> Response:
            part = inner_response(states)
            energy = part.energy + 0.5 * (states * states) @ weights
            hessian = part.hessian + np.diag(weights)
            return Response(energy, part.slope + weights * states, hessian, part.failure)

        return respond

    def added_energy(self, z: Values) -> Tensor:
        """The added energy sqrt(delta)/2 sum_i |z_i|^2, Pa."""
        return 0.5 * self.delta**0.5 * reduce(add, [inner(z[name], z[name]) for name in self._regularised])


@dataclass(frozen=True, kw_only=True)
class Yosida(Wrapper):
    """phi_eps(z) = min over y of phi(y) + |z - y|^2/(2 eps), over all strains jointly, at fixed parameters.

    If phi is convex, phi_eps is convex and phi_eps <= phi. The slope phi_eps'(z) = (z - y)/eps = phi'(y) has
    a Lipschitz constant of at most 1/eps. phi_eps is finite for all z, also for J <= 0.  Stress and stiffness
    at rest change by O(eps): for phi = K z^2/2, K becomes K/(1 + eps K).

    A damped Newton iteration finds y at every quadrature point, from a start value that depends on z alone.
    phi_eps has no expression: ``energy`` raises an error, and the Cauchy stress for output uses the cellwise
    L2 projection of phi_eps.  Raises ParameterError if eps is not a finite positive number or ``material`` is
    no Material.

    Parameters
    ----------
    material : Material
        The material that is regularised; phi, or at least |z|^2/(2 eps) + phi, has to be convex.
    eps : float
        Width of the approximation, the paper's epsilon.
    """

    eps: Annotated[float, Quantity("1/Pa", "> 0", 1e-3)]

    @property
    def continued(self) -> frozenset[str]:
        return frozenset(variable.name for variable in self.variables if variable.is_strain)

    def domain(self, z: Values) -> Values:
        return {}

    def energy(self, z: Values) -> Tensor:
        raise NgviscoError(
            "the energy of a Yosida approximation is not an expression; use "
            "ngvisco.physics.pointwise.respond(material, dim), which gives the energy and its derivatives "
            "for arrays of states"
        )

    def response(self, dim: int) -> Respond:
        return _Approximation(self, dim)


_MAX_ITERATIONS = 200
_MAX_HALVINGS = 40
_CONVERGED = 1e-8
"""Relative size of the last Newton increment; by quadratic convergence the error is then rounding."""
_ROUNDING = 1e-12
"""Relative size below which a residual is rounding, if no step reduces it."""
_SHARE = 0.1
"""Least factor by which a step multiplies a positive variable; also the least start value of the variable."""


class _Approximation:
    """The response phi_eps and its derivatives, from the minimisers y."""

    def __init__(self, material: Yosida, dim: int) -> None:
        self.eps = material.eps
        self.inner = respond(material.material, dim)
        self.rest = rest_state(material, dim)
        space = material.states(dim)
        self.weights = np.where(space.strains, material.eps, 0.0)
        """eps for every component; 0 for parameters, which are fixed in the minimisation."""
        scalars = (v for v in material.variables if v.kind == "scalar" and v.positive(CF(1.0)))
        places = (space.slices[v.name].start for v in scalars)
        self.positive = [i for i in places if not self._goes_on(i)]
        """Components of y that must stay positive: J or A, if the energy is singular at 0 or undefined below
        0."""

    def _goes_on(self, i: int) -> bool:
        states = np.tile(self.rest, (3, 1))
        states[:, i] = (0.0, -0.01, -1.0)
        return bool(self.inner(states).finite.all())

    def __call__(self, states: np.ndarray) -> Response:
        n, size = states.shape
        energy, slope = np.full(n, np.nan), np.full((n, size), np.nan)
        hessian = np.full((n, size, size), np.nan)
        finite = np.flatnonzero(np.isfinite(states).all(axis=1))
        with np.errstate(all="ignore"):
            y, at_y, solved = self._minimise(states[finite])
            z, where = states[finite][solved], finite[solved]
            S, H = at_y.slope[solved], at_y.hessian[solved]
            root = np.sqrt(self.weights)
            # a convex energy has eigenvalues >= 1
            definite = np.linalg.eigvalsh(np.eye(size) + root[:, None] * H * root)[:, 0] > 0
            where, z, S, H = (a[definite] for a in (where, z, S, H))
            H = np.linalg.solve(np.eye(size) + H * self.weights, H)
            H = 0.5 * (H + H.transpose(0, 2, 1))
            # for small eps, phi'(y) has more correct digits than (z - y)/eps; here the slope S = phi'(y) is
            # corrected for the rounding of y
            S = S + np.einsum("nij,nj->ni", H, z - y[solved][definite] - self.weights * S)
            energy[where] = at_y.energy[solved][definite] + 0.5 * (S * S) @ self.weights
            slope[where], hessian[where] = S, H
        return Response(energy, slope, hessian, self._failure(states, finite, solved, definite))

    def _failure(
        self, states: np.ndarray, finite: np.ndarray, solved: np.ndarray, definite: np.ndarray
    ) -> str | None:
        text = f"the Yosida approximation with eps = {self.eps:g} has "
        if len(finite) < len(states):
            return f"{text}variables that are not finite at {len(states) - len(finite)} points"
        for good, at, fault, remedy in (
            (solved, finite, "no minimiser at {} points", ", or stays finite at the end of its domain"),
            (definite, finite[solved], "no minimum at {} stationary points", "; take a smaller eps"),
        ):
            if not good.all():
                example = np.array2string(states[at[~good][0]], precision=4)
                description = f"{fault.format(int((~good).sum()))}, e.g. for the components {example}"
                return f"{text}{description}, since the energy is not convex{remedy}"
        return None

    def _minimise(self, z: np.ndarray) -> tuple[np.ndarray, Response, np.ndarray]:
        """The minimisers y, the inner response at y, and the mask of points where y was found.

        Newton's method solves r(y) = y - z + eps phi'(y) = 0, with eps = 0 for parameters.  r' >= I for a
        convex phi, so that halving the step until |r| decreases converges from every start.
        """
        y, at_y = self._start(z)
        energy, slope, hessian = at_y.energy, at_y.slope, at_y.hessian
        solved, active = np.zeros(len(z), dtype=bool), np.flatnonzero(at_y.finite)
        for _ in range(_MAX_ITERATIONS):
            if not len(active):
                break
            r = y[active] - z[active] + self.weights * slope[active]
            d = _solve(np.eye(z.shape[1]) + self.weights[:, None] * hessian[active], -r)
            length = self._admitted(y[active], d)
            small = np.abs(d).max(axis=1) <= _CONVERGED * np.abs(y[active]).max(axis=1)
            small &= (np.abs(d) <= _CONVERGED * y[active])[:, self.positive].all(axis=1)
            bound = np.linalg.norm(r, axis=1)
            trying, moved = np.arange(len(active)), np.zeros(len(active), dtype=bool)
            for _ in range(_MAX_HALVINGS):
                trial = y[active[trying]] + length[trying, None] * d[trying]
                at = self.inner(trial)
                next_r = np.linalg.norm(trial - z[active[trying]] + self.weights * at.slope, axis=1)
                shorter = next_r <= (1 - 1e-4 * length[trying]) * bound[trying]
                good = at.finite & (small[trying] | shorter)
                accepted = active[trying[good]]
                y[accepted], energy[accepted] = trial[good], at.energy[good]
                slope[accepted], hessian[accepted] = at.slope[good], at.hessian[good]
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

    def _start(self, z: np.ndarray) -> tuple[np.ndarray, Response]:
        """The start y: z moved into the domain; the rest state where the moved z is still outside."""
        y = z.copy()
        y[:, self.positive] = np.maximum(y[:, self.positive], _SHARE)
        at_y = self.inner(y)
        outside = ~at_y.finite
        if outside.any():
            y[outside] = np.where(self.weights > 0, self.rest, z[outside])
            at_y = self.inner(y)
        return y, at_y

    def _admitted(self, y: np.ndarray, d: np.ndarray) -> np.ndarray:
        """The largest step length, at most 1, with which positive components keep the share ``_SHARE``."""
        y, d = y[:, self.positive], d[:, self.positive]
        return np.where(d < 0, (_SHARE - 1) * y / d, 1.0).min(axis=1, initial=1.0)


def _solve(matrices: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solutions of many small systems; NaN for singular systems."""
    solution, regular = np.full_like(rhs, np.nan), np.abs(np.linalg.det(matrices)) > 0
    solution[regular] = np.linalg.solve(matrices[regular], rhs[regular][:, :, None])[:, :, 0]
    return solution
