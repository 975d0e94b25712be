"""What is asked of an energy: a function of the state alone, convex, and the same for all observers.

A stored energy must be a function of the state alone: what else one may read by mistake is refused.

The ledger's conjugates are derivatives by the state.  An energy that also depends on the place, on the time,
on a grid function or on the mesh has a rate that no term of the equations holds.

A sampling check of the joint convexity on which the ledger's guarantee rests.

The scheme never creates energy because every step's Bregman distance
phi(b) - phi(a) - phi'(a) : (b - a) is >= 0, which is convexity in all strains together, taken as
independent ones (the discrete J is not exactly det F), at fixed parameters.  ``check_convexity`` evaluates
that distance for random states a and, for each, b along the eigenvector of the smallest eigenvalue of the
Hessian, near and farther, and at another random state; it reports the worst negative one.

States whose variables fit together (J = det F, H = Cof F, ...), which a motion can reach, are cited first,
and of those the ones that another such state b shows: a violation elsewhere matters only as far as the
discrete variables drift apart.

A sampling check that an energy does not change when the observer turns.

phi(z*) = phi(z) for the values z* that an observer turned by a rotation Q sees: Q F of F and its cofactor,
Q E Q^T of spatial tensors.  For these the same condition says that phi is an isotropic function, which is
what makes S E = E S, the Cauchy stress symmetric, and B = F F^T enough to know of F.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.errors import (
    NgviscoError,
    NgviscoWarning,
    ParameterError,
    as_integer,
    require_positive,
    require_type,
)
from ngvisco.physics.material import Material
from ngvisco.physics.materials.wrapped import Heterogeneous
from ngvisco.physics.pointwise import Respond, energies_at, evaluated, respond, states_of
from ngvisco.physics.signals import one_value, reads_time, sampled
from ngvisco.physics.tensors import constant
from ngvisco.physics.variables import Values

_OTHERS = {
    ("coordinate",): "the position",
    ("GridFunction",): "a grid function",
    ("MeshSize",): "the size of the cells",
    ("normal vector", "tangential vector", "Curvature"): "the direction of a facet",
    ("DomainWise", "RegionCF"): "the region of the mesh",
    ("Voxel",): "values on a grid",
    ("ReferenceCoordinate", "Jacobian"): "the map of the cells",
    ("ProxyFunction",): "a trial or test function",
}
"""What NGSolve calls the leaves of an expression, and what they are."""


def check_energy(material: Material) -> None:
    """Raise ParameterError unless ``material.energy`` is a scalar function of the variables' values alone."""
    inner = getattr(material, "material", None)
    if isinstance(inner, Material) and not isinstance(material, Heterogeneous):
        # a wrapper's energy is made of that of another material
        check_energy(inner)
        return
    owner = f"{type(material).__name__}.{material.energy_parameter}"
    function = getattr(material, material.energy_parameter)
    names = ", ".join(v.name for v in material.variables)
    F = CF((1.2, 0.1, 0, -0.2, 0.9, 0, 0, 0, 1.05), dims=(3, 3))  # a state without symmetries
    z = {v.name: v.from_distortion(F).MakeVariable() for v in material.variables}
    phi = _evaluated(material, z, owner, function, names)
    text = str(phi)
    for leaves, what in _OTHERS.items():
        if any(leaf in text for leaf in leaves):
            raise ParameterError(owner, function, f"a function of {names} alone; it reads {what}")
    if reads_time(phi):
        raise ParameterError(owner, function, f"a function of {names} alone; it reads the time")
    if _is_constant(phi, z):
        expected = f"an energy that changes with {names}: this one is a constant, without any stress"
        raise ParameterError(owner, function, expected)
    if not one_value(sampled(phi)):
        expected = f"a function of {names} alone; it differs from place to place at one state"
        raise ParameterError(owner, function, expected)


def _is_constant(phi: CoefficientFunction, z: Values) -> bool:
    """Whether no variable's conjugate differs from zero, but for what rounding leaves of sums that vanish."""
    slopes = [abs(part) for variable in z.values() for part in np.ravel(sampled(phi.Diff(variable)))]
    size = max(np.abs(sampled(phi)))
    return bool(max(slopes) <= 1e-14 * size)


def _evaluated(
    material: Material, z: Values, owner: str, function: object, names: str
) -> CoefficientFunction:
    try:
        phi = material.energy(z)
    except NgviscoError:
        raise
    except Exception as error:  # whatever a function of the user raises
        expected = f"a function of {names}; it raises {type(error).__name__}: {error}"
        raise ParameterError(owner, function, expected) from error
    if not isinstance(phi, CoefficientFunction):
        expected = f"a function of {names} that returns a coefficient function, not {phi!r:.60}"
        raise ParameterError(owner, function, expected)
    if phi.dim != 1 or phi.is_complex:
        what = "a complex number" if phi.is_complex else f"an array of shape {tuple(phi.dims)}"
        raise ParameterError(owner, function, f"a function of {names} that returns a real scalar, not {what}")
    return phi


_STATES = 256
_DISTANCES = (1.0, 0.1)
_ROUNDING = 1e-9


class ConvexityWarning(NgviscoWarning):
    """A stored energy is not jointly convex: the ledger's bregman column may be negative."""


@dataclass(frozen=True)
class ConvexityReport:
    """What the sampling found.

    Attributes
    ----------
    samples : int
        Pairs with finite energies that were compared.
    worst : float
        Smallest [phi(b) - phi(a) - phi'(a):(b - a)]/|b - a|^2 found, Pa; 0 when the energy passed.
    point, direction : mapping of names to arrays, or None
        a and b - a of the pair that is cited, 3x3 or scalar; None when the energy passed.
    reachable : bool
        Whether a motion can reach the state a.
    distance : float
        Of a from the nearest of the ``states`` that were given, without such from rest: the Frobenius norm
        over all variables; 0 when the energy passed.
    """

    samples: int
    worst: float
    point: dict[str, np.ndarray] | None
    direction: dict[str, np.ndarray] | None
    reachable: bool = False
    distance: float = 0.0
    from_run: bool = False

    @property
    def passed(self) -> bool:
        return self.point is None

    def __str__(self) -> str:
        if self.point is None or self.direction is None:
            return f"no violation of convexity in {self.samples} samples"
        at = ", ".join(f"{name} = {array_text(value)}" for name, value in self.point.items())
        along = ", ".join(f"{name}: {array_text(value)}" for name, value in self.direction.items())
        who = "which a motion can reach" if self.reachable else "which no motion reaches exactly"
        where = "the nearest state of the run's start" if self.from_run else "rest"
        far = f"{who}, {self.distance:.2g} from {where} in the norm of all variables"
        return f"not convex at {at} ({far}) in the direction {along}"


def check_convexity(
    material: Material,
    *,
    dim: int = 3,
    spread: float = 0.4,
    seed: int = 0,
    warn: bool = True,
    states: np.ndarray | None = None,
    name: str | None = None,
) -> ConvexityReport:
    """Look for states where a material's energy is not jointly convex.

    Raises ParameterError if an argument is not what is said of it.

    Parameters
    ----------
    material : Material
    dim : int
        Dimension of the mesh it is for; 2 samples plane-strain tensors.
    spread : float
        Size of the sampled region: entries of F - I, and relative changes of the single variables.
    seed : int
        Of the random states.
    warn : bool
        Whether to issue a ConvexityWarning with the point where the energy fails.
    states : array (count, components), optional
        Components of a run's states, to say how far from them the energy fails; default rest.
    name : str, optional
        What a warning calls the material; default its class.

    Returns
    -------
    ConvexityReport
    """
    require_type("check_convexity.material", material, Material)
    require_positive("check_convexity", spread=spread)
    dim, number = as_integer(dim) or 0, as_integer(seed)
    if dim not in (2, 3):
        raise ParameterError("check_convexity.dim", dim, "2 or 3")
    if number is None or number < 0:
        raise ParameterError("check_convexity.seed", seed, "an integer >= 0")
    rng = np.random.default_rng(number)
    sampling = StateSampling(material, dim)
    fitting = sampling.with_parameters(sampling.fitting_states(rng, spread), states, rng)
    a = sampling.changed(fitting, rng, spread)
    other = sampling.fitting_states(rng, spread)
    b = sampling.changed(other, rng, spread)
    for end in (other, b):  # at the same parameters
        end[:, ~sampling.strains] = fitting[:, ~sampling.strains]
    steps = [t * spread for t in (*_DISTANCES, *(-t for t in _DISTANCES))]
    # (states, increments) in the order in which violations are cited
    rounds: list[tuple[bool, np.ndarray, list[np.ndarray]]] = [(True, fitting, [other - fitting])]
    for reachable, start, far in ((True, fitting, []), (False, a, [b - a])):
        weakest = sampling.weakest_directions(start)
        rounds.append((reachable, start, [t * weakest for t in steps] + far))
    worst, samples = 0.0, 0
    found: tuple[bool, np.ndarray, np.ndarray] | None = None
    for reachable, start, increments in rounds:
        count, smallest, pair = sampling.worst_bregman(start, increments)
        samples, worst = samples + count, min(worst, smallest)
        if found is None and pair is not None:
            found = (reachable, *pair)
    if found is None:
        return ConvexityReport(samples, 0.0, None, None)
    reachable, at, along = found
    near = sampling.rest()[None] if states is None else np.asarray(states, dtype=float)
    report = ConvexityReport(
        samples,
        worst,
        sampling.named(at),
        sampling.named(along),
        reachable,
        float(np.linalg.norm(near - at, axis=1).min()),
        states is not None,
    )
    if warn:
        warnings.warn(
            f"{name or type(material).__name__}: the stored energy is {report}; the scheme stays consistent, "
            "but its numerical dissipation (the ledger's bregman) may be negative there",
            ConvexityWarning,
            stacklevel=2,
        )
    return report


class StateSampling:
    """Random states of a material, (states, components), and its energy at them."""

    def __init__(self, material: Material, dim: int) -> None:
        self.material, self.dim, self.space = material, dim, material.states(dim)
        self.size, self.strains = self.space.size, self.space.strains

    @cached_property
    def response(self) -> Respond:
        """The energy and its derivatives at states."""
        return respond(self.material, self.dim)

    def fitting_states(self, rng: np.random.Generator, spread: float) -> np.ndarray:
        """States of a random F: variables that fit together, as those of a motion."""
        F = np.eye(3) + spread * rng.uniform(-1, 1, (_STATES, 3, 3))
        if self.dim == 2:
            F[:, 2, :2] = F[:, :2, 2] = 0
        F[np.linalg.det(F) < 0.2] = np.eye(3)
        return states_of(self.material, F, self.dim)

    def with_parameters(
        self, states: np.ndarray, run: np.ndarray | None, rng: np.random.Generator
    ) -> np.ndarray:
        """The states with parameters of some of a run's states, (count, components), where there is one."""
        if run is None or self.strains.all():
            return states
        states = states.copy()
        states[:, ~self.strains] = rng.choice(np.asarray(run, dtype=float), len(states))[:, ~self.strains]
        return states

    def rest(self) -> np.ndarray:
        """The state of F = I, (components,)."""
        return states_of(self.material, np.eye(3)[None], self.dim)[0]

    def changed(self, fitting: np.ndarray, rng: np.random.Generator, spread: float) -> np.ndarray:
        """The states with every strain changed on its own: the discrete ones do not fit exactly."""
        states = fitting.copy()
        for variable in self.material.variables:
            part = states[:, self.space.slices[variable.name]]
            if not variable.is_strain:
                continue
            if part.shape[1] == 1 and variable.positive(CF(1.0)):
                part *= np.exp(spread * rng.uniform(-1, 1, part.shape))
            else:
                part += spread * rng.uniform(-1, 1, part.shape)
        return states

    def random_states(self, rng: np.random.Generator, spread: float) -> np.ndarray:
        """States of a random F, with every strain then changed on its own."""
        return self.changed(self.fitting_states(rng, spread), rng, spread)

    def worst_bregman(
        self, a: np.ndarray, increments: Sequence[np.ndarray]
    ) -> tuple[int, float, tuple[np.ndarray, np.ndarray] | None]:
        """Number of pairs, smallest Bregman distance over |b - a|^2, and its pair (a, b - a) if negative."""
        at_a = self.response(a)
        samples, worst, pair = 0, 0.0, None
        for step in increments:
            phi_b = energies_at(self.material, a + step, self.dim)
            first_order = np.einsum("ij,ij->i", at_a.slope, step)
            bregman = phi_b - at_a.energy - first_order
            size = np.einsum("ij,ij->i", step, step)
            finite = np.isfinite(bregman) & (size > 0) & self.is_inside(a + step)
            samples += int(finite.sum())
            rounding = _ROUNDING * (abs(at_a.energy) + abs(phi_b) + abs(first_order))
            relative = np.where(finite & (bregman < -rounding), bregman / np.where(size > 0, size, 1), 0.0)
            i = int(np.argmin(relative))
            if relative[i] < worst:
                worst, pair = float(relative[i]), (a[i], step[i])
        return samples, worst, pair

    def is_inside(self, states: np.ndarray) -> np.ndarray:
        """Where the energy is asked to be convex: where J, the minors of B, ... are positive, but not det F,
        whose domain is not convex; everywhere in variables for which the energy goes on."""

        def bounds(components: CoefficientFunction) -> CoefficientFunction:
            z = self.space.tensors(lambda: components)
            asked = (v for v in self.material.variables if v.kind != "full")
            parts = (v.positive(z[v.name]) for v in asked if v.name not in self.material.continued)
            return CF((1.0, *(value for each in parts for value in each.values())))

        inside: np.ndarray = np.all(evaluated(bounds, states) > 0, axis=1)
        return inside

    def weakest_directions(self, states: np.ndarray) -> np.ndarray:
        """Unit eigenvectors of the smallest eigenvalue of the Hessian by the strains."""
        hessian = np.nan_to_num(self.response(states).hessian, posinf=0, neginf=0)
        weakest = np.zeros_like(states)
        weakest[:, self.strains] = np.linalg.eigh(hessian[:, self.strains][:, :, self.strains])[1][:, :, 0]
        return weakest

    def named(self, components: np.ndarray) -> dict[str, np.ndarray]:
        """Components as scalars and 3x3 arrays by name."""
        found = {}
        for name, space in self.space.spaces.items():
            own = components[self.space.slices[name]]
            found[name] = np.array(own[0]) if space.is_scalar else (space.columns @ own).reshape(3, 3)
        return found


def array_text(value: np.ndarray) -> str:
    """An array for messages, in one line."""
    return np.array2string(np.asarray(value), precision=3, suppress_small=True).replace("\n", "")


_ROTATIONS = 4
_TOLERANCE = 1e-8
"""Of |phi(z*) - phi(z)| over the spread of phi among the samples; rounding is far below it."""


@dataclass(frozen=True)
class IsotropyReport:
    """What the sampling found.

    Attributes
    ----------
    samples : int
        Pairs of a state and a turned one with finite energies.
    worst : float
        Largest |phi(z*) - phi(z)| found, Pa; 0 when the energy passed.
    rotation : (3, 3) array or None
        Q of the worst pair; None when the energy passed.
    point : mapping of names to arrays, or None
        z of the worst pair, 3x3 or scalar.
    """

    samples: int
    worst: float
    rotation: np.ndarray | None
    point: dict[str, np.ndarray] | None

    @property
    def passed(self) -> bool:
        return self.rotation is None

    def __str__(self) -> str:
        if self.rotation is None or self.point is None:
            return f"no change under rotations in {self.samples} samples"
        at = ", ".join(f"{name} = {array_text(value)}" for name, value in self.point.items())
        return f"changes by {self.worst:.3g} Pa under the rotation {array_text(self.rotation)} of {at}"


def check_isotropy(material: Material, *, dim: int = 3, spread: float = 0.4, seed: int = 0) -> IsotropyReport:
    """Look for a rotation of the observer under which a material's energy changes.

    Raises ParameterError if an argument is not what is said of it.

    Parameters
    ----------
    material : Material
    dim : int
        Dimension of the mesh it is for; in 2 the rotations are those in the plane.
    spread : float
        Size of the sampled region, as for ``check_convexity``.
    seed : int
        Of the random states and rotations.

    Returns
    -------
    IsotropyReport
    """
    rng = np.random.default_rng(seed)
    sampling = StateSampling(material, dim)
    states = sampling.random_states(rng, spread)
    energy = energies_at(material, states, dim)
    worst, found, samples = 0.0, None, 0
    for _ in range(_ROTATIONS):
        Q = _rotation(rng, dim)
        turned = energies_at(material, evaluated(_turning(material, dim, Q), states), dim)
        with np.errstate(invalid="ignore"):  # infinite at both
            change = np.abs(turned - energy)
        finite = np.isfinite(change)
        samples += int(finite.sum())
        if not finite.any():
            continue
        known = energy[np.isfinite(energy)]
        # the spread, since a constant in the energy says nothing; and its rounding
        bound = _TOLERANCE * np.ptp(known) + 1e-13 * np.abs(known).max()
        change = np.where(finite & (change > bound), change, 0.0)
        i = int(np.argmax(change))
        if change[i] > worst:
            worst, found = float(change[i]), (Q, states[i])
    if found is None:
        return IsotropyReport(samples, 0.0, None, None)
    return IsotropyReport(samples, worst, found[0], sampling.named(found[1]))


def require_isotropy(material: Material, field: str, value: object, dim: int = 3) -> None:
    """Raise ParameterError with the rotation that shows that a material's energy depends on the observer."""
    report = check_isotropy(material, dim=dim)
    if not report.passed:
        raise ParameterError(field, value, f"an energy that no rotation of the observer changes: it {report}")


def _turning(material: Material, dim: int, Q: np.ndarray):  # type: ignore[no-untyped-def]
    """The map of components to those that the turned observer sees."""
    rotation = constant(Q)

    def turn(state: CoefficientFunction) -> CoefficientFunction:
        z = material.states(dim).tensors(lambda: state)
        turned = {v.name: v.turned(z[v.name], rotation) for v in material.variables}
        return material.states(dim).components(turned)

    return turn


def _rotation(rng: np.random.Generator, dim: int) -> np.ndarray:
    """A random rotation, in the plane for dim = 2."""
    Q = np.eye(3)
    Q[:dim, :dim], R = np.linalg.qr(rng.standard_normal((dim, dim)))
    Q[:dim, :dim] *= np.sign(np.diag(R))
    Q[:, 0] *= np.linalg.det(Q)
    return Q
