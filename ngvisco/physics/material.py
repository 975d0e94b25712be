"""Materials: a list of transported variables and a stored energy; all stresses are derived.

For a material with variables z_i and stored energy phi(z) per actual volume (Pa = J/m^3), the energy balance
gives all other quantities, and none is written by hand:

* conjugates        zeta_i = d phi / d z_i
* Cauchy stress     T : A = sum_i zeta_i : rate_i(z; A, 0) + phi tr A     for all A
                    (paper: Cauchy-stress-polyconvex, Cauchy-stress-polyconvex+)
* Mandel stress     M : P = -sum_i zeta_i : rate_i(z; 0, P)   for all symmetric trace-free P
                    (paper: Mandel-stress-polyconvex, Mandel-stress-polyconvex+)

The energy ledger closes with a Bregman remainder that is >= 0 exactly when phi is jointly convex in
the variables z; this is the "generalised polyconvexity" of the paper's Section 3.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, reduce
from operator import add
from typing import Any, Literal, Self, TypeAlias, TypeVar

import numpy as np
from ngsolve import CF, Id

from ngvisco.errors import ParameterError
from ngvisco.physics.parameters import Checked, Modulus, substituted
from ngvisco.physics.response import Respond
from ngvisco.physics.signals import sampled
from ngvisco.physics.tensors import (
    IDENTITY,
    Tensor,
    TensorSpace,
    constant,
    inner,
    linear_map,
    skw,
    sym,
    tensor_space,
    tr,
    trace_free_tensors,
)
from ngvisco.physics.variables import INTERFACE, PARTED, Values, Variable


class StateSpace:
    """The space of a material's states: all components of its variables, side by side.

    Attributes
    ----------
    size : int
        Number of components N of a state.
    slices, spaces : dict
        Range of each variable's components in a state, and space of each variable's tensors, by name.
    strains, by_flux : (size,) arrays of bool
        Masks of the components of strains (not of parameters), and of densities transported by their flux.
    densities : (size,) array
        Mass per unit of each component: rho = sum densities_i z_i, kg/m^3; 0 if z_i is no amount of matter.
    """

    def __init__(self, variables: tuple[Variable, ...], dim: int) -> None:
        self.variables, self.dim = variables, dim
        self.spaces: dict[str, TensorSpace] = {v.name: tensor_space(v.kind, dim) for v in variables}
        sizes = [space.size for space in self.spaces.values()]
        ends = np.cumsum(sizes).tolist()
        places = (slice(end - size, end) for size, end in zip(sizes, ends, strict=True))
        self.slices = dict(zip(self.spaces, places, strict=True))
        self.size: int = ends[-1]
        self.strains = np.repeat([v.is_strain for v in variables], sizes)
        self.by_flux = np.repeat([v.by_flux for v in variables], sizes)
        self.densities = np.repeat([v.density for v in variables], sizes)

    @staticmethod
    @cache
    def of(variables: tuple[Variable, ...], dim: int) -> StateSpace:
        """The space of these variables, made once."""
        return StateSpace(variables, dim)

    def tensor(self, name: str, components: Tensor) -> Tensor:
        """A variable's value, a scalar or 3x3, from all components: a coefficient function or an array."""
        where, space = self.slices[name], self.spaces[name]
        if space.is_scalar:
            return components[where.start]
        # one constant matrix selects and embeds, which is far cheaper to linearise than sums of components
        matrix = np.zeros((9, self.size))
        matrix[:, where] = space.columns
        return linear_map(matrix, components, (3, 3))

    def tensors(self, components: Callable[[], Tensor], parts: Mapping[str, Tensor] | None = None) -> Values:
        """All values by name; each is made at its first access.

        ``parts`` are the components of each variable, if each variable has a function of its own.
        """
        return _Tensors(self, components, parts)

    def density(self, components: Tensor, size: int = 1) -> Tensor:
        """The density sum rho_i n_i of components.

        If each component has ``size`` entries, such as a gradient, the result has one sum for each entry.
        """
        return linear_map(np.kron(self.densities, np.eye(size)), components, (size,))

    def components(self, values: Values) -> Tensor:
        """The components of values by name, by orthogonal projection."""
        total = None
        for name, space in self.spaces.items():
            matrix = np.zeros((self.size, len(space.columns)))
            matrix[self.slices[name]] = space.columns.T
            value = space.components(values[name]) if space.is_scalar else values[name]
            part = linear_map(matrix, value, (self.size,))
            total = part if total is None else total + part
        return total


class _Tensors(Mapping[str, Tensor]):
    """Values by name; each is made of the components at its first access."""

    def __init__(
        self, space: StateSpace, components: Callable[[], Tensor], parts: Mapping[str, Tensor] | None
    ) -> None:
        self._space, self._components, self._parts = space, components, parts
        self._made: dict[str, Tensor] = {}

    def __getitem__(self, name: str) -> Tensor:
        if name not in self._space.slices:
            raise KeyError(name)
        if name not in self._made:
            if self._parts is None:
                self._made[name] = self._space.tensor(name, self._components())
            else:
                self._made[name] = self._space.spaces[name].tensor(self._parts[name])
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._space.slices)

    def __len__(self) -> int:
        return len(self._space.slices)


ElasticState: TypeAlias = Literal["F", "B"]


class Material(Checked, ABC):
    """A constitutive law: its ``variables`` and its ``energy``.

    A material that is a dataclass raises ParameterError for a parameter outside the range of its annotation.
    """

    energy_parameter = "energy"
    """Name, for messages, of the parameter that gives the energy."""

    @property
    @abstractmethod
    def variables(self) -> tuple[Variable, ...]:
        """The transported variables, in the order in which they are stored."""

    @abstractmethod
    def energy(self, z: Values) -> Tensor:
        """Stored energy per actual volume, Pa, from the variables' values by name."""

    def with_elastic_state(self, state: ElasticState) -> Material:
        """The material by F or by B = F F^T, as ``state`` says; a material of fixed state is unchanged."""
        return self

    @property
    def conformation(self) -> str | None:
        """Name of the conformation tensor, whose conjugate vanishes at rest, z = I; None without one."""
        return None

    def conformation_of(self, branch: str) -> str | None:
        """Name of the conformation tensor of a branch, by the branch's name (``Network``)."""
        return self.conformation

    @property
    def distortions(self) -> dict[str, tuple[str, ...]]:
        """Names of the tensors of each elastic distortion, by the name of its branch. All tensors of one
        distortion have the same creep rate. The key is "" for a material without branches."""
        return {"": tuple(v.name for v in self.variables if v.creeps)}

    @property
    def summed(self) -> tuple[tuple[str, ...], ...]:
        """Groups of variables. phi is a sum of energies; each reads one group and the variables in none."""
        return ()

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of variables in which phi is jointly linear: phi'' is zero between any two of them."""
        return ()

    @property
    def curved_part(self) -> Material:
        """A material of some of the variables; its energy has the phi'' of this material."""
        return self

    @property
    def referential_density(self) -> Modulus | None:
        """The referential density rho_R, kg/m^3, of an energy that reads rho = rho_R/J; None (default) for
        other energies. rho_R relates the initial J to the initial density."""
        return None

    @property
    def continued(self) -> frozenset[str]:
        """Names of variables with an energy that is continued beyond their bounds (``Variable.positive``).

        The parameter J_min and a Yosida approximation make an energy continued. An energy that merely has
        values at J <= 0, such as (J - 1)^2, is not continued: J <= 0 means interpenetration.
        """
        return frozenset()

    def domain(self, z: Values) -> Values:
        """Scalars that must be > 0 for the energy to have a value, besides the variables' bounds. The keys
        are their names in messages; empty by default.

        The set of states where all scalars are positive has to be convex, as it is for scalars that are
        concave in z.  The set then contains all states between a state and its cell's mean.
        """
        return {}

    def positive(self, z: Values) -> dict[str, Values]:
        """Functions of a state that must be > 0. The key is the name of the function's variable, for
        variables that are not ``continued``, and "" for functions of several variables.
        """
        kept = (v for v in self.variables if v.name not in self.continued)
        bounds = {v.name: v.positive(z[v.name]) for v in kept}
        domain = self.domain(z)
        return bounds | {"": domain} if domain else bounds

    @property
    def where_means_do(self) -> frozenset[str]:
        """Names of bounds that bind only in cells whose means satisfy them."""
        return frozenset()

    def at_rest(self, z: Values) -> Values:
        """The state of F = I, with parameters and concentrations from ``z``."""
        return {v.name: v.from_distortion(IDENTITY) if v.is_strain else z[v.name] for v in self.variables}

    @property
    def lagged(self) -> frozenset[str]:
        """Names of variables whose values at a step's start enter the conjugates of all other variables.

        The energy may then be convex in these variables and convex in all others, but not jointly convex: its
        Bregman distance is still >= 0.
        """
        return frozenset()

    def taking_part(self, z: Values) -> Values:
        """Factors >= 0 of sym L and Pi in the rates, by the names of variables. All other factors are 1."""
        return {}

    @property
    def at_interfaces(self) -> Any:
        """The law by which the strain rates on both sides of an interface differ (``Parting``, ``Layers``);
        None (default) for none."""
        return None

    def parted(self, z: Values) -> Values:
        """Shares of the motion at an interface that other matter takes, by variables. Others are 0."""
        return {}

    def rate(self, variable: Variable, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        """The rate of a variable at (z; L, Pi). The rate of a density omits -(tr L) z, a part of its flux.

        If ``z`` has ``PARTED`` and ``INTERFACE``, n x n, strain rates differ across this interface.
        """
        share = self.taking_part(z).get(variable.name)
        if share is not None:
            D, Pi = sym(L), share * Pi
            if PARTED in z and (parted := z[PARTED].get(variable.name)) is not None:
                D = D - parted * self.at_interfaces.motion(D, z[INTERFACE])
            L = skw(L) + share * D
        rate = variable.rate(z, L, Pi)
        return rate + tr(L) * z[variable.name] if variable.by_flux else rate

    def states(self, dim: int) -> StateSpace:
        """The space of the states on meshes of dimension ``dim``."""
        return StateSpace.of(tuple(self.variables), dim)

    def response(self, dim: int) -> Respond | None:
        """The response at points if ``energy`` has no expression; None (default) if it has one."""
        return None


def check_material(material: Material) -> None:
    """Raise ParameterError if a list of variables makes no sense; the message says what would be right."""
    field = f"{type(material).__name__}.variables"
    for variable in material.variables:
        if not isinstance(variable, Variable):
            raise ParameterError(field, variable, "Variable objects, e.g. Distortion()")
    names = [v.name for v in material.variables]
    if not names:
        raise ParameterError(field, names, "at least one variable")
    if len(set(names)) < len(names):
        raise ParameterError(field, names, "distinct names")
    for v in material.variables:
        for required in set(v.requires).difference(names):
            raise ParameterError(field, names, f"also {required!r}, which the rate of {v.name!r} reads")
    for distortion in material.distortions.values():
        tensors = (v for v in material.variables if v.name in distortion)
        frames = {v.frame: v.name for v in tensors if v.frame is not None}
        if len(frames) > 1:
            expected = (
                f"tensors of one configuration, but {frames['relaxed']!r} is of the relaxed configuration, "
                f'{frames["actual"]!r} of the actual one; take elastic_state = "B"'
            )
            raise ParameterError(field, names, expected)


M = TypeVar("M", bound=Material)


def part_of(material: object, kind: type[M]) -> M | None:
    """The material of class ``kind``, among a material and the materials that it wraps; None without one."""
    while isinstance(material, Material) and not isinstance(material, kind):
        material = getattr(material, "material", None)
    return material if isinstance(material, kind) else None


def conjugates(material: Material, z: Values) -> dict[str, Tensor]:
    """The conjugates zeta_i = d phi / d z_i as coefficient functions of the values ``z``, in their shapes."""
    variables = {name: value.MakeVariable() for name, value in z.items()}
    phi = material.energy(variables)
    return {name: phi.Diff(variable) for name, variable in variables.items()}


def along(f: Tensor, variables: Values, direction: Values) -> Tensor:
    """The derivative of a scalar ``f`` in a ``direction`` of some variables by name.

    ``variables`` are the arguments of ``f``, made by ``MakeVariable``.
    """
    return reduce(add, (f.Diff(variables[name], change) for name, change in direction.items()))


def conjugates_along(phi: Tensor, variables: Values, direction: Values) -> dict[str, Tensor]:
    """The products phi''(z) ``direction`` by name, for a direction of some variables by name.

    The product is the gradient of a directional derivative, since NGSolve 6.2.2608 differentiates a gradient
    wrongly if phi has a cofactor, the trace of a product or a scalar times a tensor.

    ``variables`` are the arguments of ``phi``, made by ``MakeVariable``.
    """
    change = along(phi, variables, direction)
    return {name: change.Diff(variable) for name, variable in variables.items()}


def rate_power(
    material: Material, z: Values, zeta: Values, L: Tensor, Pi: Tensor, names: Sequence[str] | None = None
) -> Tensor:
    """The power sum_i zeta_i : rate_i(z; L, Pi) per volume, Pa/s, over all variables or ``names`` alone."""
    total = 0.0 * tr(L)
    for v in material.variables:
        if names is not None and v.name not in names:
            continue
        total = total + inner(zeta[v.name], material.rate(v, z, L, Pi))
        total = total - tr(L) * inner(zeta[v.name], z[v.name]) if v.by_flux else total
    return total


def cauchy_stress(
    material: Material, z: Values, zeta: Values | None = None, phi: Tensor | None = None
) -> Tensor:
    """Cauchy stress T, 3x3, Pa (paper: Cauchy-stress-polyconvex).

    ``zeta`` defaults to the exact conjugates; the discretisation passes projected conjugates. ``phi``
    defaults to the expression of the energy. The affine part of a rate, such as eps(v) for E, is linear in L.
    Hence T : A = power(A) + phi tr A.
    """
    zeta = conjugates(material, z) if zeta is None else zeta
    zero = constant(np.zeros((3, 3)))
    entries = [rate_power(material, z, zeta, constant(unit), zero) for unit in np.eye(9).reshape(9, 3, 3)]
    phi = material.energy(z) if phi is None else phi
    return CF(tuple(entries), dims=(3, 3)) + phi * IDENTITY


def rest_stress_and_modulus(material: Material) -> tuple[float, float]:
    """Mean stress and bulk modulus at rest, Pa, for the parameters' typical values. They are the first and
    second derivatives of J phi by J along F = J^{1/3} I, at J = 1."""
    J, typical = CF(1.0).MakeVariable(), substituted(material, lambda expression: expression.typical)
    z = {v.name: v.from_distortion(J ** (1 / 3) * Id(3)) for v in material.variables}
    stress = (J * typical.energy(z)).Diff(J)
    modulus = conjugates_along(J * typical.energy(z), {"J": J}, {"J": CF(1.0)})["J"]
    return float(np.mean(sampled(stress))), float(np.mean(sampled(modulus)))


def mandel_stress(
    material: Material, z: Values, zeta: Values, dim: int, names: Sequence[str] | None = None
) -> Tensor:
    """Mandel stress M in R^{3x3}_dev, Pa, from the given conjugates of all variables, or of ``names`` alone.

    M is minus the derivative of sum_i zeta_i : rate_i(z; 0, Pi) by the symmetric trace-free Pi; for F it is
    sym dev(F^T S_F), paper: Mandel-stress-polyconvex.
    """
    space, zero, entries = trace_free_tensors(dim), constant(np.zeros((3, 3))), []
    for P in space.basis:
        powers = [
            inner(zeta[v.name], material.rate(v, z, zero, constant(np.array(P))))
            for v in material.variables
            if v.creeps and (names is None or v.name in names)
        ]
        entries.append(-sum(powers[1:], powers[0]) if powers else CF(0.0))
    return space.tensor(CF(tuple(entries)))


def volume_ratio(material: Material, z: Values) -> Tensor:
    """J from the first scalar that determines J, else from the first tensor whose determinant does."""
    variables = sorted(material.variables, key=lambda v: v.kind != "scalar")
    ratios = (v.volume_ratio(z[v.name]) for v in variables)
    power, exponent = next(ratio for ratio in ratios if ratio is not None and abs(ratio[1]) > 1e-12)
    return power ** (1 / exponent)


@dataclass(frozen=True, kw_only=True)
class Wrapper(Material):
    """A material that wraps another one, and has the other one's properties where it defines none.

    Raises ParameterError if ``material`` is no Material, or a parameter is out of its range.
    """

    material: Material

    def with_elastic_state(self, state: ElasticState) -> Self:
        return replace(self, material=self.material.with_elastic_state(state))

    @property
    def variables(self) -> tuple[Variable, ...]:
        return self.material.variables

    @property
    def referential_density(self) -> Modulus | None:
        return self.material.referential_density

    @property
    def conformation(self) -> str | None:
        return self.material.conformation

    def conformation_of(self, branch: str) -> str | None:
        return self.material.conformation_of(branch)

    @property
    def distortions(self) -> dict[str, tuple[str, ...]]:
        return self.material.distortions

    @property
    def continued(self) -> frozenset[str]:
        return self.material.continued

    def domain(self, z: Values) -> Values:
        return self.material.domain({v.name: z[v.name] for v in self.material.variables})
