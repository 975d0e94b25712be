"""Sections of a case file, made from dataclasses and functions: the machinery of the schema.

Each section is a strict pydantic model whose fields are the parameters of a dataclass or function;
parameters that are functions of space and time are numbers, expressions or arrays of them.  What a
dataclass refuses is a fault of its section, with the parameter's name.
"""

import collections.abc
import dataclasses
import functools
import inspect
import operator
import os
import types
from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from ngsolve import CoefficientFunction
from numpy.typing import ArrayLike
from pydantic import BaseModel, BeforeValidator, Field, create_model, model_validator

from ngvisco.case.energies import parse_law
from ngvisco.case.laws import EnergyText
from ngvisco.case.table import Section
from ngvisco.case.values import (
    FIELDS,
    LawValue,
    ModulusValue,
    NumberValues,
    RowsValue,
    ScalarValue,
    TensorValue,
    VectorValue,
)
from ngvisco.errors import UnknownNameError
from ngvisco.expressions import parse
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.heat import Conductivity, WallHeat
from ngvisco.physics.material import Material as MaterialObject
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.rheology import Viscosity
from ngvisco.run.stepping import AdaptiveSteps

TAGS = ("geometry", "kind")
"""Keys whose value chooses a section."""
_LAWS: tuple[type, ...] = (MaterialObject, FlowRule, Viscosity)


def _annotation(hint: Any) -> Any:
    """The schema's type for a parameter's type hint; None if a case file cannot give it."""
    if hint in (float, int, bool, str, EnergyText):
        return hint
    if hint == ArrayLike:
        return NumberValues
    if hint == Modulus:
        return ModulusValue
    if hint == Modulus | None:
        return ModulusValue | None
    if hint == Conductivity:
        return LawValue
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if _mentions_function(hint):
            is_vector = any(get_origin(part) is collections.abc.Sequence for part in arguments)
            field = VectorValue if is_vector else ScalarValue if float in arguments else RowsValue
            return field | None if type(None) in arguments else field
        of_python = (collections.abc.Callable, os.PathLike)  # no case file has these
        given = [part for part in arguments if get_origin(part) not in of_python]
        if len(given) < len(arguments):
            return _annotation(functools.reduce(operator.or_, given))
        parts = [part for part in arguments if part is not type(None)]
        inner = [_annotation(part) for part in parts]
        if any(get_origin(part) is Literal for part in parts):
            inner = [part for part in inner if part is not None]  # a text stands for what it names
        if None in inner:
            return None
        return functools.reduce(operator.or_, [*inner, None] if len(parts) < len(arguments) else inner)
    if origin is Literal:
        return hint
    if hint in (AdaptiveSteps, WallHeat):
        return section(hint)
    if origin is collections.abc.Mapping and arguments[0] is str and _mentions_function(arguments[1]):
        return dict[str, TensorValue]
    if origin is collections.abc.Mapping and arguments == (str, float):
        return dict[str, float]
    if origin in (collections.abc.Sequence, list, tuple) and not _mentions_function(hint):
        inner_hint = _annotation(arguments[0])
        return None if inner_hint is None else list[inner_hint]  # type: ignore[valid-type]
    return None


def _law(hint: Any, wrapped: Mapping[Any, Any] | None) -> Any:
    """The schema's type of a law, of one or None, or of several; None for another parameter."""
    for law, choice in ({law: Section for law in _LAWS} if wrapped is None else wrapped).items():
        found = {law: choice, law | None: choice | None, tuple[law, ...]: list[choice]}  # type: ignore[valid-type]
        if hint in found:
            return found[hint]
    return None


def _mentions_function(hint: Any) -> bool:
    if hint is CoefficientFunction:
        return True
    return any(_mentions_function(part) for part in get_args(hint) if not isinstance(part, list))


def section(
    target: Callable[..., Any],
    tag: tuple[str, str] | None = None,
    wrapped: Mapping[Any, Any] | None = None,
    is_default: bool = False,
    base: type[Section] = Section,
    is_whole: bool = True,
    without: Collection[str] = (),
) -> type[Section]:
    """The section that holds a dataclass's (or function's) parameters.

    Parameters
    ----------
    target : class or function
    tag : (key, name), optional
        A key whose value chooses this section, e.g. ``("kind", "NeoHookean")``.
    wrapped : mapping
        The schema's types of parameters that are laws, by their class; default any section.
    is_default : bool
        Whether the section is this one where the tag's key is left out.
    base : class
        With the keys that it has besides.
    is_whole : bool
        Whether the object can be made of the section alone, and is, to check it.
    without : collection of str
        Parameters that it has no keys for.
    """
    # of a dataclass its fields', each with the names that its own class's module knows
    hints = get_type_hints(target)
    fields: dict[str, Any] = {}
    if tag is not None:
        fields[tag[0]] = (Literal[tag[1]], tag[1] if is_default else ...)
    for name, parameter in inspect.signature(target).parameters.items():
        hint = hints.get(name)
        annotation = _law(hint, wrapped) or _annotation(hint)
        required = parameter.default is inspect.Parameter.empty
        if annotation is None or name in without:
            if required:
                raise TypeError(f"{target.__qualname__}.{name}: a case file cannot give a {hints.get(name)}")
            continue
        fields[name] = (annotation, ... if required else _default(annotation, parameter.default))
    if is_whole and _is_plain(target, fields, hints.get("return")):
        base = _checked_section(base)
    model = create_model(tag[1] if tag else target.__name__, __base__=base, **fields)
    _TARGETS[model] = target
    _ANNOTATIONS[model] = {name: annotation for name, (annotation, _) in fields.items()}
    return model


_ANNOTATIONS: dict[type[BaseModel], dict[str, Any]] = {}
"""As they were given: pydantic takes those apart that say which functions a key takes."""
_TARGETS: dict[type[BaseModel], Callable[..., Any]] = {}


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """The sections that a schema's type holds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return list(dict.fromkeys(found for part in get_args(annotation) for found in models_in(part)))


def place_in(annotation: Any) -> tuple[str, ...]:
    """What stands between a table's name and its keys: nothing, a name, or an index."""
    origin = get_origin(annotation)
    return ("NAME",) if origin is dict else ("N",) if origin is list else ()


def annotation_of(model: type[BaseModel], name: str) -> Any:
    """The schema's type of a key."""
    return _ANNOTATIONS.get(model, {}).get(name, model.model_fields[name].annotation)


def owner_of(model: type[BaseModel]) -> Any:
    """The class or function whose parameters a section holds; itself where there is none."""
    return next((_TARGETS[part] for part in model.__mro__ if part in _TARGETS), model)


def names_of(part: Section) -> set[str]:
    """What errors call the object that a section describes: the table's kind, the class behind it."""
    return {type(part).__name__, owner_of(type(part)).__name__}


def field_names(part: Section) -> set[str]:
    """The parameters of a section that are functions of space and time."""
    found = _ANNOTATIONS.get(type(part), {}).items()
    return {name for name, annotation in found if _has_field_value(annotation)}


def _default(annotation: Any, default: Any) -> Any:
    """A parameter's default as a case file would have it."""
    if annotation == dict[str, TensorValue]:
        return {}
    return list(default) if isinstance(default, tuple) else default


def _is_plain(target: Callable[..., Any], fields: dict[str, Any], returned: Any) -> bool:
    """Whether the object can be made, and so checked, from the file's values alone.

    Functions make materials; those of geometries make meshes, which takes long, and paths are relative.
    """
    has_fields = any(_has_field_value(annotation) for annotation, _ in fields.values())
    is_material = isinstance(returned, type) and issubclass(returned, MaterialObject)
    return not has_fields and "path" not in fields and (dataclasses.is_dataclass(target) or is_material)


def _has_field_value(annotation: Any) -> bool:
    return annotation in FIELDS or any(_has_field_value(part) for part in get_args(annotation))


def _checked_section(base: type[Section]) -> type[Section]:
    class Checked(base):  # type: ignore[valid-type, misc]
        @model_validator(mode="after")
        def _admitted(self) -> Any:
            try:
                made(self)
            except UnknownNameError as error:  # a KeyError, which pydantic would let through
                raise ValueError(str(error)) from error
            return self

    return Checked


def parameters(part: Section) -> dict[str, Any]:
    """The parameters that a section holds, by name, without its other keys; None is left to the default.

    A section within it becomes the object that it describes, but for one of functions of space and time; a
    modulus' text a function of the place, a law's one of the temperature.
    """
    values: dict[str, Any] = {}
    for name in inspect.signature(owner_of(type(part))).parameters.keys() & type(part).model_fields:
        value = getattr(part, name)
        if isinstance(value, Section) and not field_names(value):
            value = made(value)
        elif isinstance(value, list) and value and isinstance(value[0], Section):
            value = [made(each) for each in value]
        elif isinstance(value, str) and name in moduli(type(part)):
            value = parse(value).coefficient()
        elif isinstance(value, str) and annotation_of(type(part), name) == LawValue:
            value = parse_law(value)
        if value is not None:
            values[name] = value
    return {name: values[name] for name in type(part).model_fields if name in values}


def made(part: Section) -> Any:
    """What a section without functions of time describes."""
    return part.completed(owner_of(type(part))(**parameters(part)))


def moduli(model: type[BaseModel]) -> set[str]:
    """The keys of a section that take a function of the initial place."""
    found = _ANNOTATIONS.get(model, {}).items()
    return {name for name, annotation in found if annotation in (ModulusValue, ModulusValue | None)}


def tagged(key: str, table: Mapping[str, Any], base: type[Section] = Section) -> Any:
    """One of the sections of a table, by ``key``, with the keys of ``base`` besides."""
    return _choice(key, tuple(section(table[name], (key, name), base=base) for name in table))


def laws(
    law: type,
    table: Mapping[str, Any],
    wrappers: Mapping[str, Any],
    has_default: bool = True,
    base: type[Section] = Section,
    without: Mapping[str, Collection[str]] = MappingProxyType({}),
) -> Any:
    """One of the laws of a class, by ``kind``, or a wrapper of those before it; with ``base``'s keys, and
    ``without`` these of some kinds.

    Where ``has_default`` it is the first one of the table where no kind is said.
    """
    first = next(iter(table)) if has_default else None

    def with_kind(value: Any) -> Any:
        return {"kind": first, **value} if isinstance(value, dict) else value

    def choice() -> Any:
        found = _choice("kind", models)
        return found if first is None else Annotated[found, BeforeValidator(with_kind)]

    models = tuple(
        section(
            target, ("kind", name), {}, is_default=name == first, base=base, without=without.get(name, ())
        )
        for name, target in table.items()
    )
    for name, target in wrappers.items():
        models = (*models, section(target, ("kind", name), {law: choice()}, base=base))
    return choice()


def _choice(key: str, models: tuple[type[Section], ...]) -> Any:
    if len(models) == 1:
        return models[0]
    return Annotated[Union[models], Field(discriminator=key)]  # noqa: UP007 (made at run time)
