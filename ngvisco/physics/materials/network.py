"""Networks of materials in parallel that share one volume, each branch with its own flow rule.

A network has branches i with energies phi_i(z_i, J), where z_i are the tensors of the branch's distortion:

    phi = sum_i phi_i(z_i, J),   Pi_i = rate_i(M_i),   M_i the Mandel stress of phi_i alone.

The stress is the sum of the branches' stresses. The dissipation is sum_i M_i : Pi_i, and each term is >= 0.
phi is jointly convex if every phi_i is jointly convex.  J = det F, 1/J and other functions of the volume,
which creep does not change, are carried once.  A branch without a flow rule is a spring.  A spring and a
Maxwell branch make the standard linear solid. Several Maxwell branches make a Prony series (1795), and two
Maxwell branches a fluid of Burgers (1935).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add, attrgetter

from ngvisco.errors import ParameterError
from ngvisco.physics.flow_rules.rule import FlowRule
from ngvisco.physics.material import ElasticState, Material, check_material, part_of, rest_stress_and_modulus
from ngvisco.physics.parameters import Checked, Parameter, distinct
from ngvisco.physics.tensors import Tensor
from ngvisco.physics.variables import SmallStrain, Values, Variable
from ngvisco.words import Words, call


@dataclass(frozen=True, kw_only=True)
class Branch(Checked):
    """A branch of a ``Network``: a material and its flow rule.

    Raises ParameterError for a part of the wrong type.

    Parameters
    ----------
    material : Material
        Material whose energy is a part of the network's energy.  The material's tensors are those of the
        branch's distortion.  All branches share J and 1/J.  K_e may be 0 for a branch that does not resist
        changes of volume.
    creep : FlowRule, optional
        Flow rule of the branch, local (nu = 0); None (default) makes the branch a spring.
    """

    material: Material
    creep: FlowRule | None = None

    @property
    def flows(self) -> bool:
        """Whether the branch creeps."""
        return self.creep is not None and self.creep.flows


class _Parts(dict[str, Branch]):
    """Branches by name, immutable and hashable, so that a material can be a dictionary's key."""

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(tuple(self.items()))

    def __setitem__(self, name: str, branch: Branch) -> None:
        message = "the branches of a network cannot change; make another network by dataclasses.replace"
        raise TypeError(message)


@dataclass(frozen=True, kw_only=True)
class Network(Material):
    """Materials in parallel, with one volume, and with tensors and a flow rule for each branch.

    A branch ``slow`` of a material with the variable B carries ``B_slow``; its hardening carries
    ``plastic_content_slow``. Branches that leave ``elastic_state`` open are by B = F F^T if any branch flows,
    or if m = 0. The bulk modulus is the sum of the branches' moduli; K_e = 0 is allowed for branches of small
    strain, ``Referential...``, ``IsochoricNeoHookean``, ``Gent``, ``Ogden``, ``OldroydB`` and ``FENEP``.
    Raises ParameterError for an invalid name, a part of the wrong type, and a network without branches or
    without a bulk modulus.  Also refused are materials with heat, damage or branches, materials without a
    common volume, flow rules with a gradient term, and flow rules without the conformation tensor that they
    need.

    Example::

        import ngvisco as nv
        from ngvisco.geometries import box

        spring = nv.Branch(material=nv.ReferentialNeoHookean(K_e=50.0, G_e=1.0))
        slow = nv.Branch(material=nv.ReferentialNeoHookean(K_e=0.0, G_e=4.0), creep=nv.Creep(G_m=2.0))
        material = nv.Network(branches={"spring": spring, "slow": slow})
        run = nv.Simulation(box((1, 1), maxh=0.5), nv.Model(material=material), dt=0.05)
        print([v.name for v in material.variables], run.advance()["dissipation_creep_slow"])

    Parameters
    ----------
    branches : mapping of str to Branch
        Branches by their names, which are identifiers.
    """

    branches: Mapping[str, Branch]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.branches:
            raise ParameterError("Network.branches", self.branches, "at least one branch")
        for name, branch in self.branches.items():
            if not name.isidentifier():
                raise ParameterError("Network.branches", name, "names of letters, digits and _")
            for part, fault in _faults(branch):
                raise ParameterError(f"Network.branches[{name!r}].{part}", attrgetter(part)(branch), fault)
        object.__setattr__(self, "branches", _Parts(self.branches))
        _ = self.variables  # raises ParameterError if variables of branches contradict each other
        self._check_names()
        self._check_volume()

    @property
    def parts(self) -> dict[str, Branch]:
        """The branches by their names, a copy."""
        return dict(self.branches)

    def with_elastic_state(self, state: ElasticState) -> Network:
        state = "B" if any(branch.flows for branch in self.parts.values()) else state
        parts = self.parts.items()
        branches = {n: replace(b, material=b.material.with_elastic_state(state)) for n, b in parts}
        return replace(self, branches=branches)

    def own(self, name: str) -> dict[str, Variable]:
        """The variables of the branch ``name`` that no other branch carries, by their names in the branch's
        material."""
        tensors = (v for v in self.branches[name].material.variables if v.creeps)
        return {v.name: replace(v, name=f"{v.name}_{name}") for v in tensors}

    @cached_property
    def _names(self) -> dict[str, dict[str, str]]:
        """Names of each branch's variables in the network, by branch and by names in the branch's material.

        Energies read these names at each evaluation.
        """
        return {
            name: {v.name: v.name for v in branch.material.variables}
            | {in_branch: variable.name for in_branch, variable in self.own(name).items()}
            for name, branch in self.branches.items()
        }

    @property
    def distortions(self) -> dict[str, tuple[str, ...]]:
        return {name: tuple(v.name for v in self.own(name).values()) for name in self.parts}

    @property
    def summed(self) -> tuple[tuple[str, ...], ...]:
        return tuple(self.distortions.values())

    def conformation_of(self, branch: str) -> str | None:
        name = self.parts[branch].material.conformation
        return None if name is None else f"{name}_{branch}"

    @cached_property
    def variables(self) -> tuple[Variable, ...]:
        tensors = [v for name in self.parts for v in self.own(name).values()]
        shared: dict[str, Variable] = {}
        for name, branch in self.parts.items():
            for v in branch.material.variables:
                if v.creeps or isinstance(v, Parameter):
                    continue
                if shared.setdefault(v.name, v) != v:
                    expected = (
                        f"a material whose variable {v.name!r} has another name, or is equal to the variable "
                        f"{v.name!r} of the branches before"
                    )
                    raise ParameterError(f"Network.branches[{name!r}].material", branch.material, expected)
        materials = (branch.material for branch in self.parts.values())
        parameters = distinct(v for m in materials for v in m.variables if isinstance(v, Parameter))
        return (*tensors, *shared.values(), *parameters)

    @property
    def continued(self) -> frozenset[str]:
        names: set[str] = set()
        for name, branch in self.parts.items():
            own = self.own(name)
            new_names = {v.name: own[v.name].name for v in branch.material.variables if v.name in own}
            names |= {new_names[name] for name in branch.material.continued if name in new_names}
        # a shared variable is continued only if the energies of all branches that have it are continued
        for shared in {v.name for b in self.parts.values() for v in b.material.variables if not v.creeps}:
            materials = (b.material for b in self.parts.values())
            if all(shared in m.continued for m in materials if shared in {v.name for v in m.variables}):
                names.add(shared)
        return frozenset(names)

    @property
    def referential_density(self) -> float | Tensor | None:
        densities = (branch.material.referential_density for branch in self.parts.values())
        return next((density for density in densities if density is not None), None)

    def values_of(self, name: str, z: Values) -> dict[str, Tensor]:
        """The values of a branch's variables, by their names in the branch's material."""
        return {in_branch: z[of_network] for in_branch, of_network in self._names[name].items()}

    def energy_of(self, name: str, z: Values) -> Tensor:
        """The energy phi_i of a branch, Pa."""
        return self.branches[name].material.energy(self.values_of(name, z))

    def domain(self, z: Values) -> Values:
        domains = {
            name: branch.material.domain(self.values_of(name, z)) for name, branch in self.parts.items()
        }
        return {
            f"{bound} of {name}": value for name, bounds in domains.items() for bound, value in bounds.items()
        }

    def energy(self, z: Values) -> Tensor:
        return reduce(add, (self.energy_of(name, z) for name in self.branches))

    def _check_names(self) -> None:
        """Raise ParameterError if two variables of the branches have one name."""
        names = [v.name for v in self.variables]
        if twice := [name for name in names if names.count(name) > 1]:
            expected = f"other names of branches, since two variables would have the name {twice[0]!r}"
            raise ParameterError("Network.branches", list(self.parts), expected)

    def _check_volume(self) -> None:
        """Raise ParameterError for a branch of small strain beside one of large strain, and for a bulk
        modulus <= 0."""
        small = {
            n: any(isinstance(v, SmallStrain) for v in b.material.variables) for n, b in self.parts.items()
        }
        if len(set(small.values())) > 1:
            expected = (
                "either only branches of small strain or only branches of large strains, since branches "
                "share one volume"
            )
            raise ParameterError("Network.branches", list(small), expected)
        if not rest_stress_and_modulus(self)[1] > 0:
            expected = "at least one branch with a bulk modulus > 0, since the network has to carry pressure"
            raise ParameterError("Network.branches", list(self.parts), expected)


@dataclass(frozen=True, kw_only=True)
class Branches(Material):
    """The energy of some branches of a network, as a function of all variables of the network."""

    network: Network
    names: tuple[str, ...]

    @property
    def variables(self) -> tuple[Variable, ...]:
        return self.network.variables

    def energy(self, z: Values) -> Tensor:
        return reduce(add, (self.network.energy_of(name, z) for name in self.names))


def rules_of(material: Material, creep: FlowRule | None) -> dict[str | None, FlowRule]:
    """Flow rules by the name of the branch.  A material without branches has the rule ``creep`` under the key
    None."""
    network = part_of(material, Network)
    rules = {None: creep} if network is None else {n: b.creep for n, b in network.parts.items()}
    return {name: rule for name, rule in rules.items() if rule is not None}


def _faults(branch: Branch) -> Iterator[tuple[str, str]]:
    """Yield the faults of a branch, as pairs of the key and the value that would be right."""
    material, rule = branch.material, branch.creep
    check_material(material)
    if part_of(material, Network) is not None:
        yield "material", "a material without branches; give the inner branches to this network"
    if any(v.is_conserved for v in material.variables) or material.lagged:
        expected = "a material without heat and damage; give these to the network, as in "
        yield "material", Words(expected, call("Thermal", material=...))
    if material.response(3) is not None:
        expected = "a material whose energy is an expression; put the Yosida approximation around the network"
        yield "material", expected
    if rule is None:
        return
    if not rule.is_local:
        yield "creep.nu", "0, since the creep of a branch has no gradient term"
    if rule.flows and rule.reads_conjugate and material.conformation is None:
        expected = "a flow rule that reads no conformation tensor, or a material with one (OldroydB, FENEP)"
        yield "creep", expected
