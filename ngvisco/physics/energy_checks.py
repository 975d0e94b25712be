"""Checks that an energy is a function of the state alone, the same for all observers, and convex.

**The state alone.**  The ledger's conjugates are derivatives by the state.  An energy that also depends on
place, time, a grid function or the mesh is refused: no term of the equations balances this part of its rate.

**All observers.**  phi(z*) = phi(z) for the values z* that an observer turned by a rotation Q sees: Q F for
F, a rotated cofactor in the same way, and Q E Q^T for spatial tensors.  phi is then isotropic in spatial
tensors. Therefore S E = E S, the Cauchy stress is symmetric, and phi depends on F only through B = F F^T.

**Convexity.**  The scheme never creates energy because every step's Bregman distance phi(b) - phi(a) -
phi'(a) : (b - a) is >= 0.  The distance is >= 0 where phi is convex in all strains together, at fixed
parameters. The strains count as independent, because the discrete J is not exactly det F.
``check_convexity`` evaluates the distance for random states a and several states b for each a.  Some states b
lie near a, and farther along the eigenvector of the Hessian's smallest eigenvalue; one b is another random
state.  Variables of some states fit together as in a motion (J = det F, ...). These states are cited first: a
violation at other states matters only as far as variables drift apart.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.errors import (
    Declared,
    NgviscoError,
    NgviscoWarning,
    ParameterError,
    require_numbers,
    require_type,
)
from ngvisco.physics.material import Material
from ngvisco.physics.materials.wrapped import Carrying
from ngvisco.physics.pointwise import energies_at, evaluated, respond, rest_state, states_of
from ngvisco.physics.response import Response
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
"""NGSolve's names of the leaves of an expression, and the names that messages use."""
_PAIRINGS = 8
"""Number of pairs for each sampled state in the check that a set of states is convex."""


def check_energy(material: Material) -> None:
    """Raise ParameterError unless ``material.energy`` is a scalar function of the variables' values alone."""
    inner = getattr(material, "material", None)
    if isinstance(inner, Material) and not isinstance(material, Carrying):
        check_energy(inner)  # a wrapper derives its energy from the energy of the inner material
        return
    phi, slopes = _of_state(material, *_given(material), material.energy)
    if max(slopes) <= 1e-14 * max(np.abs(sampled(phi))):  # derivatives that cancel leave rounding only
        expected = f"an energy that changes with {_names(material)}, but the given energy is a constant"
        raise ParameterError(*_given(material), expected)


def check_bound(material: Material, field: str, function: Callable[..., CoefficientFunction]) -> None:
    """Raise ParameterError unless ``function`` can bound the domain of an energy.

    A bound is a scalar function of the variables' values alone, the same for all observers, positive at rest,
    and positive on a convex set of states.

    Parameters
    ----------
    field : str
        Name of the bound in messages.
    function : callable
        Function of the variables' values, by keyword; the energy has a value where the function is > 0.
    """
    _of_state(material, field, function, lambda z: function(**z))
    sampling = _sampling("check_bound", material, 3, 0.4, 0)

    def at(states: np.ndarray) -> np.ndarray:
        return evaluated(lambda c: function(**sampling.space.tensors(lambda: c)), states)[:, 0]

    z_rest, states = rest_state(material, 3), sampling.changed(sampling.fitting())
    if not (value := float(at(z_rest[None])[0])) > 0:
        expected = f"a function that is positive at rest, but the value at rest is {value:.4g}"
        raise ParameterError(field, function, expected)
    Q = np.linalg.qr(sampling._rng.standard_normal((3, 3)))[0]
    Q[:, 0] *= np.linalg.det(Q)
    if not np.allclose(at(_turned(material, 3, Q, states)), at(states), rtol=1e-8, equal_nan=True):
        raise ParameterError(field, function, "a function that is the same for all observers")
    # states near rest are sampled too, because every bound admits some of them
    states = np.concatenate([states, *(z_rest + share * (states - z_rest) for share in (0.3, 0.1, 0.03))])
    inside = states[at(states) > 0]
    for shift in range(1, _PAIRINGS + 1):
        middle = 0.5 * (inside + np.roll(inside, shift, axis=0))
        outside = np.flatnonzero(~(at(middle) > 0))
        if len(outside):
            point = _text(sampling.named(middle[outside[0]]), " = ")
            expected = (
                "a function that is positive on a convex set of states, as a concave function is; the given "
                f"function is not positive at {point}, half way between two states at which it is positive"
            )
            raise ParameterError(field, function, expected)


def _names(material: Material) -> str:
    return ", ".join(v.name for v in material.variables)


def _of_state(
    material: Material, field: str, argument: object, function: Callable[[Values], CoefficientFunction]
) -> tuple[CoefficientFunction, list[float]]:
    """The value of ``function`` at a state without symmetries, and absolute entries of its derivatives.

    Raises ParameterError unless the function is a real scalar of the variables' values alone.
    """
    names, but = _names(material), "but the given function"

    def refusal(expected: str) -> ParameterError:
        return ParameterError(field, argument, expected)

    F = CF((1.2, 0.1, 0, -0.2, 0.9, 0, 0, 0, 1.05), dims=(3, 3))
    z = {v.name: v.from_distortion(F).MakeVariable() for v in material.variables}
    try:
        phi = function(z)
    except NgviscoError:
        raise
    except Exception as error:  # a user's function may raise any error
        hint = "; the arguments are the names of transported variables" * ("argument" in str(error))
        raise refusal(f"a function of {names}, {but} raises {type(error).__name__}: {error}{hint}") from error
    if not isinstance(phi, CoefficientFunction):
        raise refusal(f"a function of {names} that returns a coefficient function, not {phi!r:.60}")
    if phi.dim != 1 or phi.is_complex:
        description = "a complex number" if phi.is_complex else f"an array of shape {tuple(phi.dims)}"
        raise refusal(f"a function of {names} that returns a real scalar, not {description}")
    text = str(phi)
    read = [description for leaves, description in _OTHERS.items() if any(leaf in text for leaf in leaves)]
    if reads_time(phi):
        read.append("the time")
    if read:
        raise refusal(f"a function of {names} alone, {but} reads {read[0]}")
    if not one_value(sampled(phi)):
        raise refusal(f"a function of {names} alone, {but} differs from place to place at one state")
    return phi, [abs(part) for value in z.values() for part in np.ravel(sampled(phi.Diff(value)))]


def _given(material: Material) -> tuple[str, object]:
    """Name of the parameter that holds the energy, as Material.parameter, and its value."""
    field = material.energy_parameter
    return f"{type(material).__name__}.{field}", getattr(material, field)


class StateSampling:
    """Sampling of a material's states, (states, components), on a mesh of dimension ``dim``."""

    def __init__(self, material: Material, dim: int, spread: float, rng: np.random.Generator) -> None:
        self.material, self.dim, self.space = material, dim, material.states(dim)
        self._spread, self._rng = spread, rng

    def fitting(self) -> np.ndarray:
        """States of random F with |F_ij - I_ij| <= ``spread``; their variables fit together as in a
        motion."""
        F = np.eye(3) + self._spread * self._rng.uniform(-1, 1, (_STATES, 3, 3))
        if self.dim == 2:
            F[:, 2, :2] = F[:, :2, 2] = 0
        F[np.linalg.det(F) < 0.2] = np.eye(3)
        return states_of(self.material, F, self.dim)

    def changed(self, fitting: np.ndarray) -> np.ndarray:
        """The states, with an independent random change of each strain. The changes are independent because
        the discrete strains of a state need not belong to one F."""
        states = fitting.copy()
        for variable in self.material.variables:
            part = states[:, self.space.slices[variable.name]]
            if not variable.is_strain:
                continue
            if part.shape[1] == 1 and variable.positive(CF(1.0)):
                part *= np.exp(self._spread * self._rng.uniform(-1, 1, part.shape))
            else:
                part += self._spread * self._rng.uniform(-1, 1, part.shape)
        return states

    def named(self, components: np.ndarray) -> dict[str, np.ndarray]:
        """The values of one state's components, scalars and 3x3 arrays by the variables' names."""
        values = {}
        for name, space in self.space.spaces.items():
            part = components[self.space.slices[name]]
            values[name] = np.array(part[0]) if space.is_scalar else (space.columns @ part).reshape(3, 3)
        return values


_STATES = 256


def _sampling(owner: str, material: Material, dim: int, spread: float, seed: int) -> StateSampling:
    """The sampling of states, after a check of the arguments; raises ParameterError."""
    require_type(f"{owner}.material", material, Material)
    require_numbers(owner, "> 0", float, spread=spread)
    dimension = Declared("from 2 to 3", (int,)).taken(f"{owner}.dim", dim)
    number = Declared(">= 0", (int,)).taken(f"{owner}.seed", seed)
    return StateSampling(material, dimension, spread, np.random.default_rng(number))


class ConvexityWarning(NgviscoWarning):
    """A stored energy is not jointly convex: the ledger's bregman column may be negative."""


@dataclass(frozen=True)
class ConvexityReport:
    """The result of sampling pairs of states a, b."""

    samples: int
    """Number of compared pairs with finite energies."""
    worst: float = 0.0
    """Smallest [phi(b) - phi(a) - phi'(a):(b - a)]/|b - a|^2, Pa; 0 when the energy passed."""
    point: dict[str, np.ndarray] | None = None
    """The state a of the cited pair, as 3x3 or scalar values by name; None if the energy passed."""
    direction: dict[str, np.ndarray] | None = None
    """The increment b - a of the cited pair."""
    reachable: bool = False
    """Whether a motion can reach a."""
    distance: float = 0.0
    """Frobenius distance of a from the nearest of ``states``, or from rest if none were given."""
    from_run: bool = False
    """Whether ``states`` were given."""

    @property
    def passed(self) -> bool:
        return self.point is None

    def __str__(self) -> str:
        if self.point is None or self.direction is None:
            return f"no violation of convexity in {self.samples} samples"
        at, along = _text(self.point, " = "), _text(self.direction, ": ")
        who = "a motion can reach this state" if self.reachable else "no motion reaches this state exactly"
        where = "the nearest state of the run's start" if self.from_run else "rest"
        far = f"{who}, whose distance from {where} is {self.distance:.2g} in the norm of all variables"
        return f"not convex at {at} ({far}) in the direction {along}"


def check_convexity(
    material: Material,
    *,
    dim: int = 3,
    spread: float = 0.4,
    seed: int = 0,
    warn: bool = True,
    states: np.ndarray | None = None,
) -> ConvexityReport:
    """Look for states where a material's energy is not jointly convex.

    Raises ParameterError for an argument of the wrong type or out of its range.

    Parameters
    ----------
    material : Material
    dim : int
        Dimension of the run's mesh; 2 samples plane-strain tensors.
    spread : float
        Size of the sampled region: largest entry of F - I and relative change of each variable.
    seed : int
        Seed of the random states.
    warn : bool
        Whether to issue a ConvexityWarning with the point where the energy fails.
    states : array (count, components), optional
        Components of a run's states, from which the report measures distances; default rest.
    """
    sampling = _sampling("check_convexity", material, dim, spread, seed)
    dim = sampling.dim
    strains, response = sampling.space.strains, respond(material, dim)
    fitting = sampling.fitting()
    if states is not None and not strains.all():
        chosen = sampling._rng.choice(np.asarray(states, dtype=float), len(fitting))
        fitting[:, ~strains] = chosen[:, ~strains]
    a = sampling.changed(fitting)
    second = sampling.fitting()
    b = sampling.changed(second)
    for end in (second, b):  # both ends of a pair have the same parameters
        end[:, ~strains] = fitting[:, ~strains]
    steps = [t * spread for t in (1.0, 0.1, -1.0, -0.1)]
    # (reachable, states, their response, increments) in the order in which violations are cited
    rounds = [(True, fitting, at_fitting := response(fitting), [second - fitting])]
    for reachable, start, answer, far in ((True, fitting, at_fitting, []), (False, a, response(a), [b - a])):
        weakest = _weakest_directions(answer, start, strains)
        rounds.append((reachable, start, answer, [t * weakest for t in steps] + far))
    worst, samples = 0.0, 0
    violation: tuple[bool, np.ndarray, np.ndarray] | None = None
    for reachable, start, answer, increments in rounds:
        count, smallest, pair = _worst_bregman(sampling, answer, start, increments)
        samples, worst = samples + count, min(worst, smallest)
        if violation is None and pair is not None:
            violation = (reachable, *pair)
    if violation is None:
        return ConvexityReport(samples)
    reachable, at, along = violation
    near = rest_state(material, dim)[None] if states is None else np.asarray(states, dtype=float)
    distance = float(np.linalg.norm(near - at, axis=1).min())
    point, direction = sampling.named(at), sampling.named(along)
    report = ConvexityReport(samples, worst, point, direction, reachable, distance, states is not None)
    if warn:
        warnings.warn(
            f"{type(material).__name__}: the stored energy is {report}. The scheme stays consistent, "
            "but the numerical dissipation (the ledger's bregman) may be negative at such states",
            ConvexityWarning,
            stacklevel=2,
        )
    return report


def _weakest_directions(response: Response, states: np.ndarray, strains: np.ndarray) -> np.ndarray:
    """Unit eigenvectors of the smallest eigenvalue of the Hessian, in ``response``, by the strains."""
    hessian = np.nan_to_num(response.hessian, posinf=0, neginf=0)
    weakest = np.zeros_like(states)
    weakest[:, strains] = np.linalg.eigh(hessian[:, strains][:, :, strains])[1][:, :, 0]
    return weakest


def _worst_bregman(
    sampling: StateSampling, at_a: Response, states: np.ndarray, increments: Sequence[np.ndarray]
) -> tuple[int, float, tuple[np.ndarray, np.ndarray] | None]:
    """The number of pairs; the most negative Bregman distance divided by |b - a|^2, or 0; and the pair (a, b
    - a) of this distance.

    The first state a of every pair is one of ``states``; ``at_a`` is the response of these states.
    """
    material, repeats = sampling.material, len(increments)
    a, step = np.tile(states, (repeats, 1)), np.concatenate(increments)
    phi_a, slope_a = np.tile(at_a.energy, repeats), np.tile(at_a.slope, (repeats, 1))

    def bounds(components: CoefficientFunction) -> CoefficientFunction:
        """Functions that are > 0 where the energy has to be convex: J, the minors of B, ... det F is not
        among them, because the set of F with det F > 0 is not convex."""
        z = sampling.space.tensors(lambda: components)
        variables = (v for v in material.variables if v.kind != "full" and v.name not in material.continued)
        return CF((1.0, *(value for v in variables for value in v.positive(z[v.name]).values())))

    phi_b = energies_at(material, a + step, sampling.dim)
    first_order = np.einsum("ij,ij->i", slope_a, step)
    bregman = phi_b - phi_a - first_order
    size = np.einsum("ij,ij->i", step, step)
    finite = np.isfinite(bregman) & (size > 0) & np.all(evaluated(bounds, a + step) > 0, axis=1)
    rounding = 1e-9 * (abs(phi_a) + abs(phi_b) + abs(first_order))
    relative = np.where(finite & (bregman < -rounding), bregman / np.where(size > 0, size, 1), 0.0)
    i, samples = int(np.argmin(relative)), int(finite.sum())
    return (samples, float(relative[i]), (a[i], step[i])) if relative[i] < 0 else (samples, 0.0, None)


@dataclass(frozen=True)
class IsotropyReport:
    """The result of comparing energies at states z and at turned states z*."""

    samples: int
    """Number of pairs with finite energies."""
    worst: float = 0.0
    """Largest |phi(z*) - phi(z)|, Pa; 0 when the energy passed."""
    rotation: np.ndarray | None = None
    """Rotation Q of the worst pair, 3x3; None when the energy passed."""
    point: dict[str, np.ndarray] | None = None
    """State z of the worst pair, 3x3 or scalar values by name."""

    @property
    def passed(self) -> bool:
        return self.rotation is None

    def __str__(self) -> str:
        if self.rotation is None or self.point is None:
            return f"no change under rotations in {self.samples} samples"
        rotation, at = _text({"": self.rotation}, ""), _text(self.point, " = ")
        return f"changes by {self.worst:.3g} Pa under the rotation {rotation} of {at}"


def check_isotropy(material: Material, *, dim: int = 3, spread: float = 0.4, seed: int = 0) -> IsotropyReport:
    """Look for a rotation of the observer under which a material's energy changes.

    Raises ParameterError for an argument of the wrong type or out of its range.

    Parameters
    ----------
    material : Material
    dim : int
        Dimension of the run's mesh; if it is 2, all rotations are in the plane.
    spread : float
        Size of the sampled region, as for ``check_convexity``.
    seed : int
        Seed of the random states and rotations.
    """
    sampling = _sampling("check_isotropy", material, dim, spread, seed)
    dim = sampling.dim
    states = sampling.changed(sampling.fitting())
    energy = energies_at(material, states, dim)
    report, samples = IsotropyReport(0), 0
    for _ in range(4):
        Q = np.eye(3)
        Q[:dim, :dim], R = np.linalg.qr(sampling._rng.standard_normal((dim, dim)))
        Q[:dim, :dim] *= np.sign(np.diag(R))
        Q[:, 0] *= np.linalg.det(Q)
        with np.errstate(invalid="ignore"):  # both energies may be infinite
            change = np.abs(energies_at(material, _turned(material, dim, Q, states), dim) - energy)
        finite = np.isfinite(change)
        samples += int(finite.sum())
        if not finite.any():
            continue
        energies = energy[np.isfinite(energy)]
        # the bound is above rounding, and relative to the spread, because a constant in the energy is free
        bound = 1e-8 * np.ptp(energies) + 1e-13 * np.abs(energies).max()
        change = np.where(finite & (change > bound), change, 0.0)
        i = int(np.argmax(change))
        if change[i] > report.worst:
            report = IsotropyReport(0, float(change[i]), Q, sampling.named(states[i]))
    return IsotropyReport(samples, report.worst, report.rotation, report.point)


def _turned(material: Material, dim: int, Q: np.ndarray, states: np.ndarray) -> np.ndarray:
    """The given states as seen by an observer that is turned by Q."""

    def turn(state: CoefficientFunction) -> CoefficientFunction:
        z = material.states(dim).tensors(lambda: state)
        seen = {v.name: v.turned(z[v.name], constant(Q)) for v in material.variables}
        return material.states(dim).components(seen)

    return evaluated(turn, states)


def require_isotropy(material: Material) -> None:
    """Raise ParameterError if a material's energy depends on the observer; the message shows a rotation."""
    report = check_isotropy(material)
    if not report.passed:
        expected = f"an energy that is the same for all observers, but the given energy {report}"
        raise ParameterError(*_given(material), expected)


def _text(values: dict[str, np.ndarray], sign: str) -> str:
    """One line of text with arrays by name."""
    texts = {n: np.array2string(v, precision=3, suppress_small=True) for n, v in values.items()}
    return ", ".join(f"{n}{sign}{text}".replace("\n", "") for n, text in texts.items())
