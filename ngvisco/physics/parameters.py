"""Parameters that travel with the matter, and moduli that are functions of them.

A parameter theta obeys dt theta + (v . grad) theta = 0.  A parameter is a variable of the material like the
strains, with a conjugate zeta = d phi/d theta.  Therefore the elastic force has the part that balances d
phi/dx, the Cauchy stress is right and the ledger closes.  An energy that reads the place x instead has a
force that nothing balances, and is refused (``ngvisco.physics.energy_checks``).

In a cell with a jump of the parameter, the carried number is a mean over both sides.  The mean of theta
itself (arithmetic) is wrong by far for a modulus that jumps by orders of magnitude: a share of 1e-5 with the
value 1e6 adds 10 to the value 1 of the rest.  ``Parameter.mean`` chooses the function of theta that is
carried.  If a modulus is a function of the place, its law chooses ``mean``. A creep modulus G_m belongs to a
dashpot in series with a spring, and is carried by its fluidity 1/G_m. Other moduli > 0 are carried by
their logarithm. Moduli that may be 0 are carried by their eighth root, with which a share of 1e-5 adds 4e-4.
Temperatures, densities and fluidities are carried themselves.

A parameter is not a strain. phi need not be convex in parameters, and the ledger's ``bregman`` may have
either sign where parameters are transported.  Quadratic regularisation, Yosida approximation and the
diffusion of the fields do not change a parameter.  In a run with a limiter (``ngvisco.forms.bounds``) a
parameter stays within the range of its start values.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import count
from operator import add, mul, neg, sub, truediv
from typing import Any, ClassVar, Literal, TypeAlias, TypeVar

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.errors import Declared, ParameterError, as_number, declared, require_fields
from ngvisco.physics.signals import reads_time
from ngvisco.physics.tensors import Tensor, exp, if_positive, log
from ngvisco.physics.variables import Values, Variable

T = TypeVar("T")

Mean: TypeAlias = Literal["arithmetic", "geometric", "harmonic", "root"]
"""Kind of a parameter's cell mean: the mean of theta, ln theta, 1/theta or theta^(1/8)."""

_SQUARINGS = 3
"""The number of squarings that undo the eighth root."""

_LEAST = 1e-100
"""Value that replaces the carried 1/theta where it is not positive, because its polynomial overshoots beside
a jump."""


class ParameterExpression(ABC):
    """A function of parameters' values: sums, products, quotients and powers of parameters and numbers."""

    __array_ufunc__ = None  # numpy's numbers leave the operation to this class

    @abstractmethod
    def at(self, z: Values) -> Tensor:
        """The expression's value at the parameters' values ``z``, coefficient functions or arrays."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters in the expression, each once."""

    @property
    def typical(self) -> float:
        """The expression's value at the parameters' typical values."""
        with_numbers: Any = {p.name: np.float64(p.carried(p.typical)) for p in self.parameters}
        return float(self.at(with_numbers))

    def __add__(self, other: object) -> ParameterExpression:
        return _Operation(add, (self, _operand(other)))

    def __sub__(self, other: object) -> ParameterExpression:
        return _Operation(sub, (self, _operand(other)))

    def __mul__(self, other: object) -> ParameterExpression:
        return _Operation(mul, (self, _operand(other)))

    def __truediv__(self, other: object) -> ParameterExpression:
        return _Operation(truediv, (self, _operand(other)))

    def __radd__(self, other: object) -> ParameterExpression:
        return _Operation(add, (_operand(other), self))

    def __rsub__(self, other: object) -> ParameterExpression:
        return _Operation(sub, (_operand(other), self))

    def __rmul__(self, other: object) -> ParameterExpression:
        return _Operation(mul, (_operand(other), self))

    def __rtruediv__(self, other: object) -> ParameterExpression:
        return _Operation(truediv, (_operand(other), self))

    def __neg__(self) -> ParameterExpression:
        return _Operation(neg, (self,))

    def __pow__(self, exponent: float) -> ParameterExpression:
        return _Operation(pow, (self, Declared("", (float,)).taken("exponent", exponent)))

    def __rpow__(self, base: object) -> ParameterExpression:
        raise ParameterError("exponent", self, f"a finite number as the exponent of {base!r}")


_SIGNS: dict[Callable[..., Any], str] = {add: "+", sub: "-", mul: "*", truediv: "/"}


@dataclass(frozen=True, eq=False, repr=False)
class _Operation(ParameterExpression):
    """A function of other expressions and numbers."""

    function: Callable[..., Any]
    operands: tuple[ParameterExpression | float, ...]

    def at(self, z: Values) -> Tensor:
        return self.function(*(value_at(operand, z) for operand in self.operands))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return parameters_in(self.operands)

    def __repr__(self) -> str:
        texts = [o.name if isinstance(o, Parameter) else repr(o) for o in self.operands]
        if self.function is pow:
            return f"{texts[0]}**{self.operands[1]:g}"
        return f"-{texts[0]}" if self.function is neg else f"({f' {_SIGNS[self.function]} '.join(texts)})"


@dataclass(frozen=True, eq=False, repr=False)
class _Modulus(ParameterExpression):
    """An expression in the place of a modulus, with the name and range of the modulus."""

    name: str
    """Name of the law and of its parameter, e.g. ``"NeoHookean.G_e"``."""
    expression: ParameterExpression
    is_positive: bool
    """Whether the modulus must be > 0; otherwise it must be >= 0."""
    is_own: bool = False
    """Whether the expression is a parameter that was made of a function of the place."""

    def at(self, z: Values) -> Tensor:
        return self.expression.at(z)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.expression.parameters

    def __repr__(self) -> str:
        return repr(self.expression)


@dataclass(frozen=True)
class Parameter(Variable, ParameterExpression):
    """A scalar theta that travels with the matter: dt theta + (v . grad) theta = 0.

    Any modulus of a law may be an expression of parameters, and a custom energy may be a function of them.
    Raises ParameterError if a parameter is out of its range.

    Example::

        import ngvisco as nv
        from ngsolve import x

        theta = nv.Parameter("theta", start=x)  # 0 at the left wall, 1 at the right one, and carried on
        material = nv.NeoHookean(K_e=20.0, G_e=1.0 + 4.0 * theta, epsilon=0.1)
        viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.1 * (1 - theta) + 0.01)
        model = nv.Model(material=material, viscosity=viscosity)
        print([variable.name for variable in model.material.variables])

    Parameters
    ----------
    name : str
        A Python identifier, different from the names of the material's variables.
    start : number or Tensor, optional
        Initial value, a function of the place; None if ``Initial.values`` gives it.
    typical : float
        A value at which energies are checked before a run is known; default ``start`` if this is a number,
        else 0.5, or 1 with the geometric or the harmonic mean.
    mean : str
        Quantity whose mean is taken in a cell where the parameter jumps. ``"arithmetic"``: the parameter
        itself. ``"geometric"``: its logarithm, neutral between layers in series and side by side.
        ``"harmonic"``: its inverse, for layers in series. ``"root"``: its eighth root, which gives nearly the
        geometric mean and admits 0.  The geometric and the harmonic mean need values > 0.
    """

    name: str
    kind: str = "scalar"
    start: float | Tensor | None = field(default=None, compare=False, repr=False)
    typical: float = math.nan
    mean: Mean = "arithmetic"
    is_strain = False
    own_scale = 0.0
    limits: ClassVar[tuple[float, float] | None] = None
    """Range within which the limiter keeps the parameter; None for the range of its start values."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind != "scalar":
            raise ParameterError("Parameter.kind", self.kind, "'scalar'")
        number = as_number(self.start)
        if not (self.start is None or number is not None or _is_scalar_function(self.start)):
            raise ParameterError("Parameter.start", self.start, "a finite number or a real scalar function")
        if number is None and self.start is not None and reads_time(self.start):
            expected = "a function of the initial place alone, but the given function reads the time"
            raise ParameterError("Parameter.start", self.start, expected)
        declared(Parameter)["mean"].taken("Parameter.mean", self.mean)
        positive = self.mean in ("geometric", "harmonic")
        if self.typical is math.nan:  # the default
            usual = 1.0 if positive else 0.5
            object.__setattr__(self, "typical", usual if number is None else number)
        elif as_number(self.typical) is None:
            raise ParameterError("Parameter.typical", self.typical, "a finite number")
        for name, value in (("start", number), ("typical", self.typical)):
            if positive and value is not None and not value > 0:
                raise ParameterError(f"Parameter.{name}", value, f"a number > 0, with mean = {self.mean!r}")

    def at(self, z: Values) -> Tensor:
        """The parameter from its carried number."""
        carried = z[self.name]
        if self.mean == "geometric":
            return exp(carried)
        if self.mean == "harmonic":  # an overshoot must not give a mobility of the wrong sign
            least = 0 * carried + _LEAST
            return 1 / (carried if isinstance(carried, float) else if_positive(carried, carried, least))
        if self.mean == "root":
            for _ in range(_SQUARINGS):
                carried = carried * carried
        return carried

    def carried(self, value: Any) -> Any:
        """The carried number of a value: theta, ln theta, 1/theta or theta^(1/8)."""
        if self.mean == "geometric":
            return log(value)
        if self.mean == "root":
            return value ** (0.5**_SQUARINGS)
        return value if self.mean == "arithmetic" else 1 / value

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (self,)

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        return 0 * z[self.name]

    def from_distortion(self, F: Tensor) -> Tensor:
        """The typical value, because no distortion determines a parameter."""
        return CF(float(self.carried(np.float64(self.typical))))


Modulus: TypeAlias = float | Tensor | ParameterExpression
"""A number; a function of the initial place, which is carried; or an expression of parameters."""


def value_at(modulus: Modulus, z: Values) -> Any:
    """The value of a modulus at the parameters' values ``z``; a modulus that is a number has this value."""
    return modulus.at(z) if isinstance(modulus, ParameterExpression) else modulus


def typical_value(modulus: Modulus) -> float:
    """A modulus at the typical values of its parameters."""
    return modulus.typical if isinstance(modulus, ParameterExpression) else float(modulus)


class Checked:
    """Base of dataclasses that raise ParameterError for a parameter of another type or out of its range.

    Moduli may also be expressions, or functions of the initial place. Other parameters may be functions of
    the actual place.
    """

    def __post_init__(self) -> None:
        for name, declaration in declared(type(self)).items():  # type: ignore[arg-type]
            value, full = getattr(self, name), f"{type(self).__name__}.{name}"
            if not declaration.is_number or (value is None and type(None) in declaration.kinds):
                continue
            if ParameterExpression in declaration.kinds:
                object.__setattr__(self, name, _as_modulus(full, value, declaration))
            elif CoefficientFunction in declaration.kinds and not _is_scalar_function(value):
                if (number := declaration.number(value)) is None:
                    expected = f"{declaration.expected}, or a scalar function of the place and the time"
                    raise ParameterError(full, value, expected)
                object.__setattr__(self, name, number)
        require_fields(self)


def _as_modulus(full: str, value: object, declaration: Declared) -> Modulus:
    """A modulus from a number in its range, an expression of parameters, or a function of the initial place,
    which becomes a parameter with the modulus' name."""
    is_positive = declaration.range == "> 0"
    if isinstance(value, _Modulus) or (number := declaration.number(value)) is not None:
        return value if isinstance(value, _Modulus) else number
    if isinstance(value, ParameterExpression):
        return _Modulus(full, value, is_positive)
    if as_number(value) is not None:
        raise ParameterError(full, value, declaration.expected)
    if not _is_scalar_function(value):
        expected = (
            f"{declaration.expected}, or a function of the initial place, or an expression of parameters"
        )
        raise ParameterError(full, value, expected)
    if reads_time(value):
        expected = "a function of the initial place without the time; only loads and walls may read the time"
        raise ParameterError(full, value, expected)
    mean: Any = declaration.mean or ("geometric" if is_positive else "root")
    parameter = Parameter(full.rpartition(".")[2], start=value, typical=1.0, mean=mean)
    return _Modulus(full, parameter, is_positive, is_own=True)


def parameters_in(values: Iterable[object]) -> tuple[Parameter, ...]:
    """The parameters that laws, materials and expressions read, each once.

    Raises ParameterError if two different parameters have one name.
    """
    read: list[Parameter] = []
    for value in values:
        for expression in (value,) if isinstance(value, Parameter) else expressions_in(value):
            read += expression.parameters
    return distinct(read)


def distinct(parameters: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """The parameters, each once.

    Raises ParameterError if two parameters of one name differ, for example in their start values.
    """
    by_name: dict[str, Parameter] = {}
    for parameter in parameters:
        namesake = by_name.setdefault(parameter.name, parameter)
        if namesake is not parameter and not (namesake == parameter and namesake.start is parameter.start):
            raise ParameterError("Parameter.name", parameter.name, "a name that no other parameter has")
    return tuple(by_name.values())


def expressions_in(value: object) -> Iterator[ParameterExpression]:
    """Yield the expressions among the parameters of a law or a material, and of the laws inside it."""
    if isinstance(value, Variable):
        return
    if isinstance(value, ParameterExpression):
        yield value
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from expressions_in(getattr(value, field.name))
    elif isinstance(value, (tuple, Mapping)):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from expressions_in(part)


def substituted(law: T, value_of: Callable[[ParameterExpression], Any]) -> T:
    """A law or a material with ``value_of(expression)`` in place of each expression. A law without
    expressions is returned itself.

    The law's checks do not run again, because values at points are not numbers.
    """

    def within(part: Any) -> Any:
        if isinstance(part, ParameterExpression):
            return value_of(part)
        if isinstance(part, tuple) and any(True for _ in expressions_in(part)):
            return tuple(within(element) for element in part)
        if isinstance(part, dict) and any(True for _ in expressions_in(part)):
            return type(part)((name, within(element)) for name, element in part.items())
        return substituted(part, value_of)

    if not dataclasses.is_dataclass(law) or isinstance(law, (type, Variable)):
        return law
    fields = {field.name: getattr(law, field.name) for field in dataclasses.fields(law)}
    replaced = {name: within(part) for name, part in fields.items()}
    changes = {name: part for name, part in replaced.items() if part is not fields[name]}
    if not changes:
        return law
    result = copy(law)
    for name, value in changes.items():
        object.__setattr__(result, name, value)
    return result


def renamed(law: T, prefix: str) -> T:
    """A law with ``prefix`` before the names of the parameters that were made of its moduli."""

    # a renamed parameter is not marked as the law's own, so that it does not get a second prefix
    return _with_own_names(law, lambda parameter: prefix + parameter.name, is_own=False)


def told_apart(laws: Iterable[T], taken: Iterable[str] = ()) -> list[T]:
    """The laws; parameters made of their moduli have distinct names, numbered if needed: A, A_2.

    Parameters of one name and the same start value count as one. Names in ``taken`` are not used.
    """
    by_name: dict[str, Parameter | None] = dict.fromkeys(taken)

    def with_number(parameter: Parameter) -> str:
        name, numbers = parameter.name, count(2)
        while (
            namesake := by_name.setdefault(name, parameter)
        ) is None or namesake.start is not parameter.start:
            name = f"{parameter.name}_{next(numbers)}"
        return name

    return [_with_own_names(law, with_number, is_own=True) for law in laws]


def _with_own_names(law: T, name_of: Callable[[Parameter], str], is_own: bool) -> T:
    """The law, with names by ``name_of`` for its own parameters. If ``is_own``, they stay the law's own."""

    def named(expression: ParameterExpression) -> ParameterExpression:
        if not (isinstance(expression, _Modulus) and expression.is_own):
            return expression
        (parameter,) = expression.parameters
        if (name := name_of(parameter)) == parameter.name:
            return expression
        return replace(expression, expression=replace(parameter, name=name), is_own=is_own)

    return substituted(law, named)


def moduli_in(value: object) -> Iterator[tuple[str, ParameterExpression, bool]]:
    """Yield the name, the expression, and whether the value must be > 0 (else >= 0), for each modulus with an
    expression."""
    for expression in expressions_in(value):
        if isinstance(expression, _Modulus):
            yield expression.name, expression.expression, expression.is_positive


def _is_scalar_function(value: object) -> bool:
    return isinstance(value, CoefficientFunction) and value.dim == 1 and not value.is_complex


def _operand(value: object) -> ParameterExpression | float:
    if isinstance(value, ParameterExpression):
        return value
    number = as_number(value)
    if number is None:
        value = "a function of the place" if isinstance(value, CoefficientFunction) else value
        expected = (
            "numbers and parameters; a function of the initial place (not the actual one) is written as "
            "nv.Parameter(name, start=...). A custom energy takes CustomMaterial.transported as arguments"
        )
        raise ParameterError("expression of parameters", value, expected)
    return number
