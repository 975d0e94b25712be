"""The schema of a case file, made from the dataclasses and functions of the catalogue.

Each section is a strict pydantic model whose fields are the parameters of a dataclass or function;
parameters that are functions of space and time are numbers, expressions or arrays of them.  What a
dataclass refuses is a fault of its section, with the parameter's name.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import functools
import inspect
import math
import operator
import re
import types
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from ngsolve import CoefficientFunction
from numpy.typing import ArrayLike
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    WithJsonSchema,
    create_model,
    model_validator,
)

from ngvisco.case import catalogue
from ngvisco.case.laws import EnergyText
from ngvisco.errors import ParameterError, UnknownNameError, as_number
from ngvisco.expressions import parse
from ngvisco.physics.material import Material as MaterialObject
from ngvisco.run.stepping import HALVINGS, MOST_HALVINGS
from ngvisco.timestepping.scheme import SCHEMES, scheme_of

_MAX_OUTPUT_TIMES = 100_000
_MAX_STEPS = 100_000_000
"""Steps above which a run has no end: ten of the smallest a second make a hundred days."""


class Section(BaseModel):
    """A table of a case file: unknown keys and wrong types are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


def _check_field(value: Any) -> Any:
    """A number, an expression, or an array (of arrays) of them; raises ValueError."""
    if isinstance(value, list):
        if not value:
            raise ValueError("expected a number, an expression or an array of them, not an empty array")
        for part in value:
            _check_field(part)
    elif isinstance(value, str):
        parse(value)
    elif isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError("expected a number, an expression in quotes, or an array of them")
    elif as_number(value) is None:
        raise ValueError("expected a finite number")
    return value


FieldValue = Annotated[
    Any, AfterValidator(_check_field), WithJsonSchema({"type": ["number", "string", "array"]})
]
"""A scalar, vector or tensor field as it stands in a case file."""


def _check_numbers(value: list[Any]) -> list[Any]:
    """Arrays of arrays of finite numbers; raises ValueError."""
    for part in value:
        if isinstance(part, list):
            _check_numbers(part)
        elif as_number(part) is None:
            raise ValueError(f"expected an array of finite numbers, or of such arrays, not of {part!r:.30}")
    return value


NumberValues = Annotated[list[Any], AfterValidator(_check_numbers)]
"""Numbers in arrays of arrays."""


def _annotation(hint: Any) -> Any:
    """The schema's type for a parameter's type hint; None if a case file cannot give it."""
    if hint in (float, int, bool, str, EnergyText):
        return hint
    if hint == ArrayLike:
        return NumberValues
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if _mentions_function(hint):
            return FieldValue | None if type(None) in arguments else FieldValue
        parts = [part for part in arguments if part is not type(None)]
        inner = [_annotation(part) for part in parts]
        if None in inner:
            return None
        return functools.reduce(operator.or_, [*inner, None] if len(parts) < len(arguments) else inner)
    if origin is Literal:
        return hint
    if hint is CoefficientFunction:
        return FieldValue
    if origin is collections.abc.Mapping and arguments[0] is str and _mentions_function(arguments[1]):
        return dict[str, FieldValue]
    if origin is collections.abc.Mapping and arguments == (str, float):
        return dict[str, float]
    if origin in (collections.abc.Sequence, list, tuple) and not _mentions_function(hint):
        inner_hint = _annotation(arguments[0])
        return None if inner_hint is None else list[inner_hint]  # type: ignore[valid-type]
    if _mentions_function(hint) and origin is not collections.abc.Callable:
        return FieldValue
    return None


def _mentions_function(hint: Any) -> bool:
    if hint is CoefficientFunction:
        return True
    return any(_mentions_function(part) for part in get_args(hint) if not isinstance(part, list))


def section(
    target: Callable[..., Any], tag: tuple[str, str] | None = None, wrapped: Any = Section
) -> type[Section]:
    """The section that holds a dataclass's (or function's) parameters.

    Parameters
    ----------
    target : class or function
    tag : (key, name), optional
        A key whose value chooses this section, e.g. ``("kind", "NeoHookean")``.
    wrapped : type
        The schema's type of a parameter that is a material.
    """
    # of a dataclass its fields', each with the names that its own class's module knows
    hints = get_type_hints(target)
    fields: dict[str, Any] = {}
    if tag is not None:
        fields[tag[0]] = (Literal[tag[1]], ...)
    for name, parameter in inspect.signature(target).parameters.items():
        hint = hints.get(name)
        annotation = wrapped if hint is MaterialObject else _annotation(hint)
        required = parameter.default is inspect.Parameter.empty
        if annotation is None:
            if required:
                raise TypeError(f"{target.__qualname__}.{name}: a case file cannot give a {hints.get(name)}")
            continue
        fields[name] = (annotation, ... if required else _default(annotation, parameter.default))
    base = _checked_section(target) if _is_plain(target, fields, hints.get("return")) else Section
    model = create_model(tag[1] if tag else target.__name__, __base__=base, **fields)
    _TARGETS[model] = target
    _FIELDS[model] = frozenset(
        name for name, (annotation, _) in fields.items() if _has_field_value(annotation)
    )
    return model


_FIELDS: dict[type[Section], frozenset[str]] = {}
_TARGETS: dict[type[Section], Callable[..., Any]] = {}


def field_names(part: Section) -> frozenset[str]:
    """The parameters of a section that are functions of space and time."""
    return _FIELDS[type(part)]


def _default(annotation: Any, default: Any) -> Any:
    """A parameter's default as a case file would have it."""
    if annotation == dict[str, FieldValue]:
        return {}
    return list(default) if isinstance(default, tuple) else default


def _is_plain(target: Callable[..., Any], fields: dict[str, Any], returned: Any) -> bool:
    """Whether the object can be made, and so checked, from the file's values alone.

    Functions make materials; those of geometries make meshes, which takes long.
    """
    has_fields = any(_has_field_value(annotation) for annotation, _ in fields.values())
    is_material = isinstance(returned, type) and issubclass(returned, MaterialObject)
    return not has_fields and (dataclasses.is_dataclass(target) or is_material)


def _has_field_value(annotation: Any) -> bool:
    return annotation == FieldValue or any(_has_field_value(part) for part in get_args(annotation))


def _checked_section(target: Callable[..., Any]) -> type[Section]:
    class Checked(Section):
        @model_validator(mode="after")
        def _admitted(self) -> Any:
            try:
                target(**parameters(self))
            except UnknownNameError as error:  # a KeyError, which pydantic would let through
                raise ValueError(str(error)) from error
            return self

    return Checked


def parameters(part: Section) -> dict[str, Any]:
    """The parameters that a section holds, by name, without its tag; None is left to the default.

    A section within it becomes the object that it describes.
    """
    tags = {"kind", "geometry"} & set(type(part).model_fields)
    values = {name: getattr(part, name) for name in type(part).model_fields if name not in tags}
    return {
        name: _TARGETS[type(value)](**parameters(value)) if isinstance(value, Section) else value
        for name, value in values.items()
        if value is not None
    }


def _tagged(key: str, table: dict[str, Any]) -> Any:
    return _choice(key, tuple(section(target, (key, name)) for name, target in table.items()))


def _choice(key: str, models: tuple[type[Section], ...]) -> Any:
    if len(models) == 1:
        return models[0]
    return Annotated[Union[models], Field(discriminator=key)]  # noqa: UP007 (made at run time)


def _materials() -> Any:
    """The materials, and the wrappers of those before them."""
    models = tuple(section(target, ("kind", name)) for name, target in catalogue.MATERIALS.items())
    for name, target in catalogue.WRAPPERS.items():
        models = (*models, section(target, ("kind", name), _choice("kind", models)))
    return _choice("kind", models)


Domain = _tagged("geometry", catalogue.GEOMETRIES)
Material = _materials()
Load = _tagged("kind", catalogue.LOADS)
Wall = _tagged("kind", catalogue.WALLS)
Rheology: Any = create_model(
    "Rheology",
    __base__=Section,
    **{name: (section(target) | None, None) for name, target in catalogue.MECHANISMS.items()},  # type: ignore
)
Adaptive, Discretisation, Initial, Solver = (
    section(catalogue.SECTIONS[name]) for name in ("adaptive", "discretisation", "initial", "solver")
)


class Time(Section):
    """Step length, end, scheme, and what belongs to them."""

    dt: float
    until: float
    scheme: Literal[tuple(SCHEMES)] = "backward-euler"  # type: ignore[valid-type]
    theta: float | None = None
    startup: int = Field(default=0, ge=0)
    relaxation: bool = False
    limiter: bool = True
    halvings: int = Field(default=HALVINGS, ge=0, le=MOST_HALVINGS)
    velocity_scale: float | None = None
    adaptive: Adaptive | None = None  # type: ignore[valid-type]

    @model_validator(mode="after")
    def _positive(self) -> Time:
        for name in ("dt", "until", "velocity_scale"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ParameterError(f"Time.{name}", value, "a finite number > 0")
        try:
            scheme_of(self.scheme, self.theta)
        except ParameterError as error:
            raise ParameterError("Time.theta", error.value, error.expected) from error
        if self.relaxation and (self.scheme != "midpoint" or self.adaptive is None):
            expected = "false, or the scheme 'midpoint' with [time.adaptive]"
            raise ParameterError("Time.relaxation", self.relaxation, expected)
        if self.until / self.dt > _MAX_STEPS:
            least = self.until / _MAX_STEPS
            steps = f"{self.until / self.dt:.0e} steps until = {self.until:g}"
            expected = f"at least {least:.2g}: this one makes {steps}"
            raise ParameterError("Time.dt", self.dt, expected)
        if self.adaptive is None:
            number = round(self.until / self.dt)
            if not math.isclose(number * self.dt, self.until, rel_tol=1e-9):
                raise ParameterError("Time.until", self.until, f"a multiple of dt = {self.dt:g}")
        elif not self.adaptive.dt_min <= self.dt <= self.adaptive.dt_max:
            raise ParameterError("Time.dt", self.dt, "between adaptive.dt_min and adaptive.dt_max")
        return self


class VTK(Section):
    """The VTK series: every so many steps, or at multiples of ``interval`` (s)."""

    enabled: bool = True
    every: int = Field(default=10, ge=1)
    interval: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    fields: list[str] | None = None
    subdivision: int = Field(default=0, ge=0, le=4)


class Checkpoint(Section):
    """Checkpoints in run.h5: every so many steps, the last ``keep`` of them."""

    every: int = Field(default=10, ge=1)
    keep: int = Field(default=2, ge=1)


def _check_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,60}", name):
        raise ValueError("expected at most 60 letters, digits, _ and -")
    return name


Name = Annotated[str, AfterValidator(_check_name)]
"""A name that becomes that of a file and of its columns."""


class Probe(Section):
    """Fields at a point over time."""

    name: Name
    point: list[float]
    fields: list[str] | None = None
    every: int = Field(default=1, ge=1)


class Line(Section):
    """Fields along a line over time."""

    name: Name
    start: list[float]
    end: list[float]
    points: int = Field(default=101, ge=2, le=100_000)
    fields: list[str] | None = None
    every: int = Field(default=10, ge=1)


class Forces(Section):
    """Forces and torques on walls over time."""

    walls: list[str] | None = None
    about: list[float] | None = None
    every: int = Field(default=1, ge=1)


class DomainIntegral(Section):
    """The integral of an expression of the fields over the domain, over time."""

    name: Name
    of: str
    every: int = Field(default=1, ge=1)


class Output(Section):
    """What is written into the run directory."""

    vtk: VTK = VTK()
    checkpoint: Checkpoint = Checkpoint()
    probes: list[Probe] = []
    lines: list[Line] = []
    forces: Forces | None = None
    integrals: list[DomainIntegral] = []
    log_every: int = Field(default=1, ge=1)
    passive: list[str] = []

    @model_validator(mode="after")
    def _distinct(self) -> Output:
        taken = {"forces"} if self.forces is not None else set()
        tables: dict[str, Sequence[Any]] = {
            "probes": self.probes,
            "lines": self.lines,
            "integrals": self.integrals,
        }
        for key, members in tables.items():
            for i, name in enumerate(member.name for member in members):
                if name in taken:
                    expected = f"a name that no other of the tables has: both would write {name}.csv"
                    raise ParameterError(f"Output.{key}.{i}.name", name, expected)
                taken.add(name)
        return self


class Units(Section):
    """The units of plain numbers; they are converted before the case is validated
    (``ngvisco.case.units``)."""

    length: str = "m"
    time: str = "s"
    velocity: str = "m/s"
    acceleration: str = "m/s^2"
    density: str = "kg/m^3"
    pressure: str = "Pa"
    viscosity: str = "Pa s"


class CaseSections(Section):
    """A whole case file."""

    title: str = ""
    units: Units = Units()
    domain: Domain  # type: ignore[valid-type]
    material: Material  # type: ignore[valid-type]
    time: Time
    walls: dict[str, Wall] = {}  # type: ignore[valid-type]
    rheology: Rheology = Rheology()
    loads: list[Load] = []  # type: ignore[valid-type]
    initial: Initial = Initial()  # type: ignore[valid-type]
    discretisation: Discretisation = Discretisation()  # type: ignore[valid-type]
    solver: Solver = Solver()  # type: ignore[valid-type]
    output: Output = Output()

    @model_validator(mode="after")
    def _consistent(self) -> CaseSections:
        rheology: Any = self.rheology
        if rheology.viscosity is not None and rheology.linear_viscosity is not None:
            expected = "no table [rheology.viscosity] beside it: D is the whole of the viscosity"
            raise ParameterError("rheology.linear_viscosity", "D", expected)
        interval = self.output.vtk.interval
        if interval is not None and self.time.until / interval > _MAX_OUTPUT_TIMES:
            raise ParameterError("output.vtk.interval", interval, f"at most {_MAX_OUTPUT_TIMES} output times")
        if interval is not None and self.time.adaptive is None:
            number = round(interval / self.time.dt)
            if number < 1 or not math.isclose(number * self.time.dt, interval, rel_tol=1e-9):
                expected = f"a multiple of time.dt = {self.time.dt:g}"
                raise ParameterError("output.vtk.interval", interval, expected)
        return self
