"""Sections of a case file, made from dataclasses and functions.

Each section is a strict pydantic model whose fields are the parameters of a dataclass or function, with the
unit, range and example of their annotations (``Quantity``).  An error of a dataclass becomes a fault of its
section, with the parameter's name.
"""

import dataclasses
import functools
import inspect
import operator
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from types import MappingProxyType, NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

from ngsolve import CoefficientFunction
from numpy.typing import ArrayLike
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    ValidationInfo,
    create_model,
    field_validator,
    model_validator,
)

from ngvisco.case.laws import EnergyText
from ngvisco.case.toml import value_text
from ngvisco.case.values import LAW, MODULUS, NUMBERS, PLAIN, ROWS, SCALAR, TENSOR, VECTOR, ValueKind
from ngvisco.errors import Declared, ParameterError, Quantity, UnknownNameError
from ngvisco.physics.diffusion import WallExchange
from ngvisco.physics.heat import Conductivity, WallHeat
from ngvisco.physics.material import Material as MaterialObject
from ngvisco.physics.parameters import Modulus
from ngvisco.run.adaptive import AdaptiveSteps

TAGS = ("geometry", "kind")
"""Keys whose value chooses a section."""
LEAST = 1e-60
"""The smallest magnitude of a number in a case file; products of five such numbers do not underflow."""


class Section(BaseModel):
    """A table of a case file, which refuses unknown keys and wrong types.

    If the validation has a context, the context first converts the table's data (``ngvisco.case.units``).
    """

    # a section that is built when it is declared builds its inner sections once more, which takes 110 MB at
    # import
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)
    target: ClassVar[Any] = None
    """The class or function whose parameters the section holds."""
    is_made_at_once: ClassVar[bool] = False
    """Whether validation makes the section's object; the section alone must suffice for this."""

    @model_validator(mode="before")
    @classmethod
    def _converted(cls, data: Any, info: ValidationInfo) -> Any:
        return info.context(cls, data) if info.context and isinstance(data, dict) else data

    @field_validator("*")
    @classmethod
    def _in_range(cls, value: Any, info: ValidationInfo) -> Any:
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return declaration(cls, name := str(info.field_name)).taken(name, value) if is_number else value

    @model_validator(mode="after")
    def _possible(self) -> Any:
        """The section, if its object can be made and its numbers are within bounds."""
        if self.is_made_at_once:
            try:
                self.built  # noqa: B018
            except UnknownNameError as error:  # a KeyError, which pydantic would let through
                raise ValueError(str(error)) from error
        for name in (name for name in type(self).model_fields if name in self.model_fields_set):
            value = getattr(self, name)
            if isinstance(value, float) and value and not LEAST <= abs(value) <= 1 / LEAST:
                zero = "0, or " * (declaration(type(self), name).number(0) is not None)
                expected = f"{zero}a finite number from {LEAST:g} to {1 / LEAST:g} in SI units"
                raise ParameterError(name, value, expected)
        return self

    @functools.cached_property
    def built(self) -> Any:
        """The object that the section describes."""
        return self.completed(type(self).target(**parameters(self)))

    def completed(self, made: Any) -> Any:
        """Complete the object by the keys that are no parameters of the target."""
        return made


def check_once(names: list[str]) -> list[str]:
    """The names; raises ValueError if a name occurs twice."""
    if len(set(names)) < len(names):
        raise ValueError("expected each name once")
    return names


_TYPES: dict[Any, Any] = {
    **{plain: plain for plain in (float, int, bool, str, EnergyText)},
    ArrayLike: Annotated[Any, NUMBERS],
    Modulus: Annotated[Any, MODULUS],
    Conductivity: Annotated[Any, LAW],
    float | CoefficientFunction: Annotated[Any, SCALAR],
    CoefficientFunction | Sequence[float | CoefficientFunction]: Annotated[Any, VECTOR],
    CoefficientFunction: Annotated[Any, ROWS],
    Mapping[str, CoefficientFunction]: dict[str, Annotated[Any, TENSOR]],
    Mapping[str, float]: dict[str, float],
    Mapping[str, int]: dict[str, int],
    # a selection by name; a key that is left out selects everything
    Sequence[str] | None: Annotated[list[str], Field(min_length=1), AfterValidator(check_once)] | None,
}
"""The schema's types by the type hints of parameters."""


def _annotation(hint: Any, types: Mapping[Any, Any]) -> Any:
    """The schema's type for a parameter's type hint; None if a case file cannot give the parameter."""
    if hint in types:
        return types[hint]
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Literal:
        return hint
    if origin in (Union, UnionType):
        if NoneType in arguments:
            hints = functools.reduce(operator.or_, (part for part in arguments if part is not NoneType))
            inner = _annotation(hints, types)
            return None if inner is None else inner | None
        # parts that have no value in a case file, such as a path or a class, are left out
        parts = [inner for inner in (_annotation(part, types) for part in arguments) if inner is not None]
        return functools.reduce(operator.or_, parts) if parts else None
    if origin in (Sequence, list, tuple):
        inner = _annotation(arguments[0], types)
        return None if inner is None else list[inner]  # type: ignore[valid-type]
    return None


def section(
    target: Callable[..., Any],
    tag: tuple[str, str] | None = None,
    types: Mapping[Any, Any] = MappingProxyType({}),
    is_default: bool = False,
    base: type[Section] = Section,
    is_whole: bool = True,
    without: Collection[str] = (),
    defaults: Mapping[str, Any] = MappingProxyType({}),
) -> type[Section]:
    """The section that holds the parameters of a class or function.

    ``tag`` is a key and the value that chooses this section, such as ``("kind", "NeoHookean")``; the key may
    be left out if ``is_default`` is True.  ``types`` gives the schema's types for parameters that are
    laws.  ``base`` adds further keys, ``without`` names parameters that are no keys, and ``defaults``
    replaces defaults of the target.  If ``is_whole`` is False, the section alone does not suffice to make the
    object.
    """
    types = {**_TYPES, **types}
    # get_type_hints resolves the fields' hints by the names in the module of each class
    is_class = inspect.isclass(target)
    hinted = target.__init__ if is_class and not dataclasses.is_dataclass(target) else target
    hints, annotated = get_type_hints(hinted), get_type_hints(hinted, include_extras=True)
    fields: dict[str, Any] = {}
    if tag is not None:
        fields[tag[0]] = (Literal[tag[1]], tag[1] if is_default else ...)
    for name, parameter in inspect.signature(target).parameters.items():
        if name in without:
            continue
        hint, default = hints.get(name), defaults.get(name, parameter.default)
        if (annotation := _annotation(hint, types)) is None:
            if default is inspect.Parameter.empty:
                raise TypeError(f"{target.__qualname__}.{name}: a case file cannot give a {hint}")
            continue
        if default is inspect.Parameter.empty:
            default = ...
        elif get_origin(annotation) is dict:
            default = {}
        elif isinstance(default, tuple):
            default = list(default)
        for part in getattr(annotated.get(name), "__metadata__", ()):
            annotation = Annotated[annotation, part]
        fields[name] = (annotation, default)
    model = create_model(tag[1] if tag else target.__name__, __base__=base, **fields)
    model.target = staticmethod(target)
    # an object of a class is made while the case is checked. Of the functions, only those that make materials
    # are called, because meshes take long, and files are read later
    returned = hints.get("return")
    is_material = isinstance(returned, type) and issubclass(returned, MaterialObject)
    model.is_made_at_once = is_whole and "path" not in fields and (is_class or is_material)
    return model


def models_in(annotation: Any) -> list[type[Section]]:
    """The sections in a type of the schema."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return [annotation]
    return list(dict.fromkeys(model for part in get_args(annotation) for model in models_in(part)))


def place_in(annotation: Any) -> tuple[str, ...]:
    """The part of a path between a table's name and its keys: empty, NAME, or N for an index."""
    origin = get_origin(annotation)
    return ("NAME",) if origin is dict else ("N",) if origin is list else ()


def inner_tables(model: type[Section]) -> Iterator[tuple[tuple[str, ...], list[type[Section]]]]:
    """Yield path and sections of each table within a section's table."""
    for name, field in model.model_fields.items():
        if inner := models_in(field.annotation):
            yield (name, *place_in(field.annotation)), inner


def places(top: type[Section]) -> dict[type[Section], tuple[str, ...]]:
    """The shortest path of each section's table in a case whose keys are those of ``top``."""
    paths: dict[type[Section], tuple[str, ...]] = {}
    waiting: list[tuple[type[Section], tuple[str, ...]]] = [(top, ())]
    while waiting:
        model, path = waiting.pop(min(range(len(waiting)), key=lambda i: len(waiting[i][1])))
        if model not in paths:
            paths[model] = path
            waiting += [(part, (*path, *way)) for way, parts in inner_tables(model) for part in parts]
    return paths


def members(node: Any) -> dict[str, Any]:
    """The values in a section, a table or an array, by key or index; empty for any other value."""
    if isinstance(node, Section):
        return {name: getattr(node, name) for name in type(node).model_fields}
    if isinstance(node, list):
        return {str(index): value for index, value in enumerate(node)}
    return node if isinstance(node, dict) else {}


def nodes(node: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield key path and value of a node and of everything within: sections, tables, arrays and values."""
    yield path, node
    for name, value in members(node).items():
        yield from nodes(value, (*path, name))


def sections_in(node: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Section]]:
    """Yield key path and section of every table within a node."""
    return ((key, part) for key, part in nodes(node, path) if isinstance(part, Section))


def given(sections: Any, key: tuple[str, ...]) -> Any:
    """The value of a key in a case; None if the case does not have the key."""
    return functools.reduce(lambda value, part: members(value).get(part), key, sections)


def reached(node: Any, path: tuple[str, ...], names: Sequence[str]) -> list[tuple[str, ...]]:
    """The keys to which names lead from ``node``; a name is a key, a member or the class of a table.

    The search ends at the first name that is not found. If this is the first of ``names``, there is no key.
    """
    if not names:
        return []
    name = names[0]
    found = [
        ((*path, key), part)
        for key, part in members(node).items()
        if name == key or (isinstance(node, list) and name == getattr(part, "name", None))
    ][:1]
    if not found:
        tables = sections_in(node, path)
        found = [(p, t) for p, t in tables if name in (type(t).__name__, owner_of(type(t)).__name__)]
    return [key for p, part in found for key in reached(part, p, names[1:]) or [p]]


def owner_of(model: type[Section]) -> Any:
    """The class or function whose parameters a section holds; without one, the section itself."""
    return model.target or model


def quantity(model: type[Section], name: str) -> Quantity:
    """Unit, range and example of a key; without an annotation a number has the unit "1"."""
    field = model.model_fields[name]
    quantities = [part for part in field.metadata if isinstance(part, Quantity)]
    is_number = {int, float} & set(_parts(field.annotation))
    return quantities[0] if quantities else Quantity("1" if is_number else "")


@functools.cache
def declaration(model: type[Section], name: str) -> Declared:
    """Type and range of a key's numbers."""
    is_whole = int in _parts(model.model_fields[name].annotation)
    return Declared(quantity(model, name).range, (int if is_whole else float,))


def _parts(annotation: Any) -> Iterator[Any]:
    """Yield a type of the schema and all its parts."""
    yield annotation
    for part in get_args(annotation):
        yield from _parts(part)


def shown(value: object) -> str:
    """The text of a value for messages; a table is in TOML."""
    if isinstance(value, Section):
        value = value.model_dump(exclude_none=True)
    text = value_text(value) if isinstance(value, (dict, bool)) else repr(value)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


_SHOWN = 60


@functools.cache
def values_of(model: type[Section]) -> dict[str, ValueKind]:
    """Keys of a section whose values are neither numbers nor texts, with the kind of each value."""
    fields = model.model_fields.items()
    parts = ((name, part) for name, field in fields for part in _parts(field.rebuild_annotation()))
    return {name: part for name, part in parts if isinstance(part, ValueKind)}


def parameters(part: Section) -> dict[str, Any]:
    """The parameters of a section's target by name; other keys and values of None are left out.

    Objects replace the sections that describe them, and functions replace texts of laws.
    """
    kinds, arguments = values_of(type(part)), inspect.signature(type(part).target).parameters
    values = {name: getattr(part, name) for name in type(part).model_fields if name in arguments}
    given = {name: value for name, value in values.items() if value is not None}
    return {name: kinds.get(name, PLAIN).made(built(value)) for name, value in given.items()}


def built(value: Any) -> Any:
    """A value with objects in place of sections, also in arrays and tables."""
    if isinstance(value, dict):
        return {name: built(part) for name, part in value.items()}
    if isinstance(value, list):
        return [built(part) for part in value]
    return value.built if isinstance(value, Section) else value


_TYPES |= {described: section(described) for described in (AdaptiveSteps, WallHeat)}
_TYPES[Mapping[str, WallExchange]] = dict[str, section(WallExchange)]  # type: ignore[misc]


def choice(
    table: Mapping[str, Any],
    key: str = "kind",
    *,
    base: type[Section] = Section,
    has_default: bool = False,
    law: type = object,
    wrappers: Mapping[str, Any] = MappingProxyType({}),
    of: Callable[[Any], Mapping[Any, Any]] = lambda held: {},
    without: Mapping[str, Collection[str]] = MappingProxyType({}),
) -> Any:
    """The type of a value that is a section of one of several kinds; the value of ``key`` names the kind.

    ``table`` has the class or function of each kind.  Every section also has the keys of ``base``.  If
    ``has_default`` is True, the first kind needs no ``key``.  ``wrappers`` are kinds with a parameter of the
    type ``law``; this parameter may be of any kind before the wrapper.  ``of`` gives the types of further
    parameters that hold such laws.  ``without`` names parameters that are no keys, by kind.
    """
    first = next(iter(table)) if has_default else None

    def with_key(value: Any) -> Any:
        return {key: first, **value} if isinstance(value, dict) else value

    def union() -> Any:
        whole: Any = Annotated[functools.reduce(operator.or_, models), Discriminator(key)]
        return whole if first is None else Annotated[whole, BeforeValidator(with_key)]

    models: list[type[Section]] = []
    for name, target in {**table, **wrappers}.items():
        held = union() if name in wrappers else None
        types = {} if held is None else {law: held, **of(held)}
        models.append(section(target, (key, name), types, name == first, base, without=without.get(name, ())))
    return union()
