"""A sampling check of the joint convexity on which the ledger's guarantee rests.

The scheme never creates energy because every step's Bregman distance
phi(b) - phi(a) - phi'(a) : (b - a) is >= 0, which is convexity in all strains together, taken as
independent ones (the discrete J is not exactly det F), at fixed parameters.  ``check_convexity`` evaluates
that distance for random states a and, for each, b along the eigenvector of the smallest eigenvalue of the
Hessian, near and farther, and at another random state; it reports the worst negative one.

States whose variables fit together (J = det F, H = Cof F, ...), which a motion can reach, are cited first,
and of those the ones that another such state b shows: a violation elsewhere matters only as far as the
discrete variables drift apart.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve import CF, L2, CoefficientFunction, GridFunction, VectorValued

from ngvisco.errors import NgviscoWarning, ParameterError, as_integer, require_positive, require_type
from ngvisco.physics.material import Material, conjugates
from ngvisco.physics.pointwise import squares
from ngvisco.physics.tensors import tensor_space

_CELLS = 16  # random states are the values of a cellwise constant field on this many squares squared
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
    """Evaluates a material at many states at once, as cellwise constants on a mesh of squares."""

    def __init__(self, material: Material, dim: int) -> None:
        self.material, self.dim = material, dim
        self.mesh, self.points = squares(_CELLS)
        self.size, self.strains = material.states(dim).size, material.states(dim).strains
        self.state = GridFunction(VectorValued(L2(self.mesh, order=0), self.size))
        self.response = material.response(dim)
        if self.response is None:
            z = material.states(dim).tensors(lambda: self.state)
            slope = material.states(dim).components(conjugates(material, z))
            self.outputs = CF((material.energy(z), slope)).Compile()
        self.domain = self._domain()

    def _domain(self) -> CoefficientFunction | None:
        """What is positive where the energy is asked to be convex: J, the minors of B, ..., whose domains are
        convex, and not det F; nothing of variables for which the energy goes on."""
        z = self.material.states(self.dim).tensors(lambda: self.state)
        bounds = [
            value
            for variable in self.material.variables
            if variable.kind != "full" and variable.name not in self.material.continued
            for value in variable.positive(z[variable.name]).values()
        ]
        return CF(tuple(bounds)).Compile() if bounds else None

    def fitting_states(self, rng: np.random.Generator, spread: float) -> np.ndarray:
        """States of a random F: variables that fit together, as those of a motion."""
        count = self.mesh.ne
        F = np.eye(3) + spread * rng.uniform(-1, 1, (count, 3, 3))
        if self.dim == 2:
            F[:, 2, :2] = F[:, :2, 2] = 0
        F[np.linalg.det(F) < 0.2] = np.eye(3)
        return self._states_of(F)

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
        return self._states_of(np.tile(np.eye(3), (self.mesh.ne, 1, 1)))[0]

    def _states_of(self, F: np.ndarray) -> np.ndarray:
        gf = GridFunction(VectorValued(L2(self.mesh, order=0), 9))
        _set(gf, F.reshape(len(F), 9))
        tensor = gf.Reshape((3, 3))
        values = {v.name: v.from_distortion(tensor) for v in self.material.variables}
        return self._evaluate(self.material.states(self.dim).components(values))

    def changed(self, fitting: np.ndarray, rng: np.random.Generator, spread: float) -> np.ndarray:
        """The states with every strain changed on its own: the discrete ones do not fit exactly."""
        states, start = fitting.copy(), 0
        for variable in self.material.variables:
            size = tensor_space(variable.kind, self.dim).size
            part = states[:, start : start + size]
            if not variable.is_strain:
                pass
            elif size == 1 and variable.positive(CF(1.0)):
                part *= np.exp(spread * rng.uniform(-1, 1, part.shape))
            else:
                part += spread * rng.uniform(-1, 1, part.shape)
            start += size
        return states

    def random_states(self, rng: np.random.Generator, spread: float) -> np.ndarray:
        """States of a random F, with every strain then changed on its own."""
        return self.changed(self.fitting_states(rng, spread), rng, spread)

    def worst_bregman(
        self, a: np.ndarray, increments: Sequence[np.ndarray]
    ) -> tuple[int, float, tuple[np.ndarray, np.ndarray] | None]:
        """Number of pairs, smallest Bregman distance over |b - a|^2, and its pair (a, b - a) if negative."""
        phi_a, slope = self.energy_and_slope(a)
        samples, worst, pair = 0, 0.0, None
        for step in increments:
            phi_b, _ = self.energy_and_slope(a + step)
            first_order = np.einsum("ij,ij->i", slope, step)
            bregman = phi_b - phi_a - first_order
            size = np.einsum("ij,ij->i", step, step)
            finite = np.isfinite(bregman) & (size > 0) & self.is_inside(a + step)
            samples += int(finite.sum())
            rounding = _ROUNDING * (abs(phi_a) + abs(phi_b) + abs(first_order))
            relative = np.where(finite & (bregman < -rounding), bregman / np.where(size > 0, size, 1), 0.0)
            i = int(np.argmin(relative))
            if relative[i] < worst:
                worst, pair = float(relative[i]), (a[i], step[i])
        return samples, worst, pair

    def energy_and_slope(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.response is not None:
            found = self.response(states)
            return found.energy, found.slope
        _set(self.state, states)
        values = self._evaluate(self.outputs)
        return values[:, 0], values[:, 1:]

    def is_inside(self, states: np.ndarray) -> np.ndarray:
        """Whether states are in the energy's domain."""
        if self.domain is None:
            return np.ones(len(states), dtype=bool)
        _set(self.state, states)
        inside: np.ndarray = np.all(self._evaluate(self.domain) > 0, axis=1)
        return inside

    def energies(self, states: np.ndarray) -> np.ndarray:
        """phi at states, Pa; NaN outside its domain."""
        return self.energy_and_slope(states)[0]

    def mapped(
        self, states: np.ndarray, f: Callable[[CoefficientFunction], CoefficientFunction]
    ) -> np.ndarray:
        """The components f(z) for the components z of states."""
        _set(self.state, states)
        return self._evaluate(f(self.state))

    def weakest_directions(self, states: np.ndarray) -> np.ndarray:
        """Unit eigenvectors of the smallest eigenvalue of the Hessian by the strains (central differences of
        the slope).
        """
        hessian = np.empty((len(states), self.size, self.size))
        for i in range(self.size):
            shift = np.zeros(self.size)
            shift[i] = 1e-5
            ahead, behind = (self.energy_and_slope(states + s)[1] for s in (shift, -shift))
            hessian[:, i] = (ahead - behind) / 2e-5
        hessian = np.nan_to_num(0.5 * (hessian + hessian.transpose(0, 2, 1)), posinf=0, neginf=0)
        of_strains = np.ix_(np.arange(len(states)), self.strains.nonzero()[0], self.strains.nonzero()[0])
        weakest = np.zeros_like(states)
        weakest[:, self.strains] = np.linalg.eigh(hessian[of_strains])[1][:, :, 0]
        return weakest

    def named(self, components: np.ndarray) -> dict[str, np.ndarray]:
        """Components as scalars and 3x3 arrays by name."""
        constant = CF(tuple(float(c) for c in components))
        tensors = self.material.states(self.dim).tensors(lambda: constant)
        return {name: np.array(t(self.points[:1])).reshape(t.dims or ()) for name, t in tensors.items()}

    def _evaluate(self, f: CoefficientFunction) -> np.ndarray:
        return np.array(f(self.points)).reshape(self.mesh.ne, -1)


def _set(gf: GridFunction, values: np.ndarray) -> None:
    """Cellwise constants: component i of cell j is values[j, i]."""
    for i, component in enumerate(gf.components):
        component.vec.FV().NumPy()[:] = values[:, i]


def array_text(value: np.ndarray) -> str:
    """An array for messages, in one line."""
    return np.array2string(np.asarray(value), precision=3, suppress_small=True).replace("\n", "")
