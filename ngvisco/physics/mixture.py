"""One material, one viscosity and one creep of several bodies, by their volume fractions.

The amounts n_i (``Amount``) are carried, and with theta_i = n_i/sum n_j

    phi = sum theta_i phi_i(z),     D = sum theta_i D_i,     R = sum theta_i R_i

over the union of the bodies' variables.  Variables of one name are one variable, of all bodies whose energy
reads it; a body whose energy does not read a variable lets it be.  sum n_i zeta_{n_i} = 0, since phi is of
degree zero in the amounts: they have no pressure of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError
from ngvisco.physics.bodies import Amount, Body
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.material import ElasticState, Material
from ngvisco.physics.parameters import Parameter, distinct, parameters_in, renamed, substituted
from ngvisco.physics.rheology import ValueOfModulus, Viscosity
from ngvisco.physics.variables import Values, Variable

AMOUNT = "n_"
"""What the name of a body's amount begins with."""


@dataclass(frozen=True)
class Fractions:
    """theta_i of the amounts of bodies, by name."""

    bodies: tuple[str, ...]

    def at(self, z: Values) -> dict[str, Any]:
        """theta_i at a point with the values ``z``, by the bodies' names; their sum is one."""
        amounts = [z[AMOUNT + name] for name in self.bodies]
        inverse = 1 / reduce(add, amounts)
        return {name: amount * inverse for name, amount in zip(self.bodies, amounts, strict=True)}


@dataclass(frozen=True, kw_only=True)
class Mixture(Material):
    """The material of bodies; a ``Model`` makes it.

    Parameters
    ----------
    bodies : tuple of Body
        Parameters that moduli became by themselves have the body's name before theirs.

    Raises
    ------
    ParameterError
        For two variables or parameters of one name that are not the same, and energies without an expression.
    """

    bodies: tuple[Body, ...]
    carried: tuple[Parameter, ...] = ()
    """Parameters of the model's other laws."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "bodies", tuple(_with_own_names(body) for body in self.bodies))
        for body in self.bodies:
            if body.material.response(3) is not None:
                expected = "a material whose energy is an expression; a Yosida approximation has none"
                raise ParameterError(f"bodies[{body.name!r}].material", body.material, expected)
        self._united()
        self._parameters()

    def _united(self) -> dict[str, Variable]:
        found: dict[str, Variable] = {}
        for body in self.bodies:
            for variable in body.material.variables:
                known = found.setdefault(variable.name, variable)
                if known != variable:
                    expected = (
                        f"the same {variable.name!r} in all bodies: here {_defined(variable)}, before it "
                        f"was {_defined(known)}; ReferentialNeoHookean, ReferentialMooneyRivlin and "
                        "IsochoricNeoHookean go together, and NeoHookean, MooneyRivlin and OldroydB do"
                    )
                    raise ParameterError(f"bodies[{body.name!r}].material", body.material, expected)
        return found

    def _parameters(self) -> tuple[Parameter, ...]:
        """Those of moduli, of the bodies' own variables and of the model's other laws."""
        own = (v for body in self.bodies for v in body.material.variables if isinstance(v, Parameter))
        return distinct((*parameters_in(self.bodies), *self.carried, *own))

    @property
    def fractions(self) -> Fractions:
        """theta_i of the amounts."""
        return Fractions(tuple(body.name for body in self.bodies))

    @property
    def variables(self) -> tuple[Variable, ...]:
        united = self._united()
        strains = tuple(v for v in united.values() if v.is_strain)
        amounts = tuple(Amount(AMOUNT + b.name, density=b.density or 0.0) for b in self.bodies)
        return (*strains, *amounts, *self._parameters())

    def readers(self, variable: str) -> tuple[str, ...]:
        """Names of the bodies whose energy reads a variable."""
        return tuple(b.name for b in self.bodies if variable in {v.name for v in b.material.variables})

    @property
    def conformation(self) -> str | None:
        names = {body.material.conformation for body in self.bodies} - {None}
        return names.pop() if len(names) == 1 else None

    @property
    def continued(self) -> frozenset[str]:
        """Where every body that reads a variable goes on beyond its bounds."""
        found = {v.name for v in self.variables if v.is_strain}
        for body in self.bodies:
            found -= {v.name for v in body.material.variables} - body.material.continued
        return frozenset(found)

    def with_elastic_state(self, state: ElasticState) -> Mixture:
        bodies = (replace(body, material=body.material.with_elastic_state(state)) for body in self.bodies)
        return replace(self, bodies=tuple(bodies))

    def with_carried(self, parameters: Sequence[Parameter]) -> Mixture:
        """The same with parameters of the model's other laws, those that it does not have yet."""
        own = self._parameters()
        more = distinct((*own, *parameters))[len(own) :]
        return replace(self, carried=(*self.carried, *more)) if more else self

    def energy(self, z: Values) -> CoefficientFunction:
        fractions = self.fractions.at(z)
        return reduce(add, (fractions[b.name] * energy_of(b, z) for b in self.bodies))


def energy_of(body: Body, z: Values) -> CoefficientFunction:
    """phi_i(z), Pa, at a point with the values ``z`` of all variables."""
    material = substituted(body.material, lambda expression: expression.at(z))
    return material.energy({v.name: z[v.name] for v in body.material.variables})


@dataclass(frozen=True, kw_only=True)
class MixedViscosity(Viscosity):
    """sum theta_i D_i eps."""

    parts: tuple[tuple[str, Viscosity], ...]
    """Names of the bodies that have a viscosity, and these."""
    fractions: Fractions

    @property
    def reads(self) -> frozenset[str]:  # type: ignore[override]
        return _read(self.parts)

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        return all(part.is_linear for _, part in self.parts)

    def stress(self, eps: CoefficientFunction, z: Values) -> CoefficientFunction:
        theta = self.fractions.at(z)
        return reduce(add, (theta[name] * part.stress(eps, z) for name, part in self.parts))

    def bulk_dissipation(self, eps: CoefficientFunction, z: Values) -> CoefficientFunction:
        theta = self.fractions.at(z)
        return reduce(add, (theta[name] * part.bulk_dissipation(eps, z) for name, part in self.parts))

    def shear_dissipation(self, eps: CoefficientFunction, z: Values) -> CoefficientFunction:
        theta = self.fractions.at(z)
        return reduce(add, (theta[name] * part.shear_dissipation(eps, z) for name, part in self.parts))

    def shear_viscosity(self, z: Values) -> ValueOfModulus:
        theta = self.fractions.at(z)
        return reduce(add, (theta[name] * part.shear_viscosity(z) for name, part in self.parts))

    def require_dimension(self, dim: int) -> None:
        for _, part in self.parts:
            part.require_dimension(dim)


@dataclass(frozen=True, kw_only=True)
class MixedCreep(FlowRule):
    """sum theta_i Pi_i of the bodies' local rules."""

    parts: tuple[tuple[str, FlowRule], ...]
    """Names of the bodies that creep, and their rules."""
    fractions: Fractions

    @property
    def reads_conjugate(self) -> bool:  # type: ignore[override]
        return any(part.reads_conjugate for _, part in self.parts)

    @property
    def has_trace(self) -> bool:  # type: ignore[override]
        return any(part.has_trace for _, part in self.parts)

    @property
    def reads(self) -> frozenset[str]:  # type: ignore[override]
        return _read(self.parts)

    @property
    def is_linear(self) -> bool:
        return all(part.is_linear for _, part in self.parts)

    def rate(
        self, M: CoefficientFunction, zeta: CoefficientFunction | None, z: Values
    ) -> CoefficientFunction:
        theta = self.fractions.at(z)
        return reduce(add, (theta[name] * part.rate(M, zeta, z) for name, part in self.parts))


def mixed_viscosity(bodies: Sequence[Body]) -> Viscosity | None:
    """That of the bodies; None without any."""
    parts = tuple((b.name, b.viscosity) for b in bodies if b.viscosity is not None)
    return MixedViscosity(parts=parts, fractions=_fractions(bodies)) if parts else None


def mixed_creep(bodies: Sequence[Body]) -> FlowRule | None:
    """That of the bodies; None without any.

    Raises
    ------
    ParameterError
        For a gradient term.
    """
    parts = tuple((b.name, b.creep) for b in bodies if b.creep is not None and b.creep.flows)
    for name, part in parts:
        if part.nu:
            expected = "nu = 0: the creep of several bodies is local"
            raise ParameterError(f"bodies[{name!r}].creep", part, expected)
    return MixedCreep(parts=parts, fractions=_fractions(bodies)) if parts else None


def _defined(variable: Variable) -> str:
    """What a variable is, in words."""
    exponent = getattr(variable, "exponent", None)
    return (
        type(variable).__name__ if exponent is None else f"{type(variable).__name__} with J**({exponent:.3g})"
    )


def _fractions(bodies: Sequence[Body]) -> Fractions:
    return Fractions(tuple(body.name for body in bodies))


def _read(parts: Sequence[tuple[str, FlowRule | Viscosity]]) -> frozenset[str]:
    """What any of the bodies' laws reads beside the variables."""
    return frozenset[str]().union(*(part.reads for _, part in parts))


def _with_own_names(body: Body) -> Body:
    """The body with parameters that its moduli became by themselves under names with its own."""
    laws = {
        name: renamed(getattr(body, name), f"{body.name}_") for name in ("material", "viscosity", "creep")
    }
    return replace(body, **{name: law for name, law in laws.items() if law is not getattr(body, name)})
