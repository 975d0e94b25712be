"""The reference of case files, made from the schema: every key with type, unit, default, meaning, example.

A path such as ``walls.NAME.velocity`` has NAME for a name that the user gives and N for the index of an array
of tables; keys that only some kinds of a section have are listed with these kinds.
"""

import difflib
import inspect
import json
import re
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel

from ngvisco.case import catalogue, toml
from ngvisco.case.laws import EnergyText
from ngvisco.case.schema import CaseSections
from ngvisco.case.section import _TARGETS, TAGS, annotation_of, models_in, owner_of, place_in
from ngvisco.case.values import (
    LawValue,
    ModulusValue,
    NumberValues,
    RegionText,
    RowsValue,
    ScalarValue,
    TensorValue,
    VectorValue,
)
from ngvisco.errors import ParameterError, Quantity
from ngvisco.run import fields as output
from ngvisco.run import passive


@dataclass(frozen=True)
class Entry:
    """One key as a user sees it.

    Attributes
    ----------
    path : tuple of str
    kinds : tuple of str
        Values of the section's ``kind`` (or ``geometry``) that have this key; empty for all.
    type, unit, meaning : str
    required : bool
    default : value or None
    example : value or None
    """

    path: tuple[str, ...]
    kinds: tuple[str, ...]
    type: str
    unit: str
    required: bool
    default: Any
    meaning: str
    example: Any

    @property
    def name(self) -> str:
        """The path with dots."""
        return ".".join(self.path)

    @property
    def default_text(self) -> str:
        """The default as TOML has it, in words where there is none."""
        if self.required:
            return "required"
        return "none" if self.default is None else toml.value_text(self.default)

    @property
    def is_table(self) -> bool:
        """Whether it is a table of keys, not a key itself."""
        return self.example is None

    @property
    def example_text(self) -> str:
        """A line of a case file."""
        return f"{self.path[-1]} = {toml.value_text(self.example)}"


def entries() -> list[Entry]:
    """Every key of a case file, in the order of the schema; kinds that agree on a key share its entry."""
    grouped: dict[tuple[Any, ...], Entry] = {}
    for entry in _walk(CaseSections, (), ()):
        words = (entry.type, entry.unit, entry.meaning)
        same = (entry.path, *words, entry.required, repr(entry.default), repr(entry.example))
        known = grouped.get(same)
        grouped[same] = entry if known is None else replace(known, kinds=(*known.kinds, *entry.kinds))
    return list(grouped.values())


_SAME_KEYS = {
    ("material", "material"): ("material",),
    ("bodies", "N", "material"): ("material",),
    ("bodies", "N", "viscosity"): ("rheology", "viscosity"),
    ("bodies", "N", "creep"): ("rheology", "creep"),
    ("bodies", "N", "heat"): ("rheology", "heat"),
    ("rheology", "viscosity", "viscosity"): ("rheology", "viscosity"),
    ("rheology", "creep", "rule"): ("rheology", "creep"),
    ("rheology", "creep", "rules", "N"): ("rheology", "creep"),
}
"""Tables that have the keys of another one, which are listed there."""


def _walk(model: type[BaseModel], path: tuple[str, ...], kinds: tuple[str, ...]) -> Iterator[Entry]:
    fields = sorted(model.model_fields.items(), key=lambda field: bool(models_in(field[1].annotation)))
    for name, field in fields:  # tables come last, as in a file
        here, inner = (*path, name), models_in(field.annotation)
        if name in TAGS:
            continue
        said, default = quantity(model, name), None if inner or field.is_required() else field.default
        example = (
            said.example if default in (None, "", [], {}, False) and said.example is not None else default
        )
        yield Entry(
            here,
            kinds,
            ", ".join(filter(None, (type_text(annotation_of(model, name)), said.range))),
            said.unit,
            field.is_required(),
            default,
            meaning(model, name),
            None if inner else example,
        )
        below = (*here, *place_in(field.annotation))
        if inner and below not in _SAME_KEYS:
            yield from _walk_kinds(inner, below, name)


def _walk_kinds(models: list[type[BaseModel]], path: tuple[str, ...], name: str) -> Iterator[Entry]:
    tag = next((tag for tag in TAGS if tag in models[0].model_fields), None)
    if tag is not None:
        names = tuple(kind_of(model, tag) for model in models)
        required = all(model.model_fields[tag].is_required() for model in models)
        default = None if required else names[0]
        kinds = f"one of {', '.join(names)}"
        yield Entry((*path, tag), (), kinds, "", required, default, "Which one", names[0])
    for model in models:
        yield from _walk(model, path, () if tag is None else (kind_of(model, tag),))


def quantity(model: type[BaseModel], name: str) -> Quantity:
    """Unit, range and example of a key."""
    return {**quantities(model), **quantities(owner_of(model))}[name]


def meaning(model: type[BaseModel], name: str) -> str:
    """What a key means; a table that its section does not describe is what it holds."""
    said = {**meanings(model), **meanings(owner_of(model))}.get(name)
    return said or summary(owner_of(models_in(model.model_fields[name].annotation)[0]))


def kind_of(model: type[BaseModel], tag: str) -> str:
    """The value of ``kind`` or ``geometry`` that chooses a section."""
    return str(get_args(model.model_fields[tag].annotation)[0])


def type_text(annotation: Any) -> str:
    """A schema's type in words."""
    plain = {
        float: "number",
        int: "whole number",
        bool: "true or false",
        str: "text",
        EnergyText: "expression of the variables",
        ModulusValue: "number or expression",
        LawValue: "number, expression of theta, or three rows of three numbers",
        ScalarValue: "number or expression",
        VectorValue: "array of numbers or expressions",
        RowsValue: "three rows of three numbers or expressions",
        TensorValue: "number, expression, or three rows of three of them",
    }
    if annotation in plain:
        return plain[annotation]
    if annotation == NumberValues or annotation == list[Any]:
        return "array of numbers"
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return f"one of {', '.join(json.dumps(value) for value in arguments)}"
    if origin in (Union, types.UnionType):
        parts = dict.fromkeys(type_text(part) for part in arguments if part is not type(None))
        return " or ".join(parts)
    if origin is Annotated and get_args(RegionText)[1] in arguments:
        return "condition"
    if origin is Annotated:
        return type_text(arguments[0])
    if models_in(annotation):
        return {dict: "tables by name", list: "array of tables"}.get(origin, "table")
    if origin is list:
        inner = type_text(arguments[0])
        return f"array of arrays{inner[5:]}" if inner.startswith("array") else f"array of {inner}s"
    if origin is dict:
        return f"table of {type_text(arguments[1])}s" if arguments[1] is float else "table by name"
    return type_text(arguments[0])


def explain(path: str) -> str:
    """What a key, a section with its keys, a kind or a field of the output means, or where a word is said.

    Raises ParameterError with the nearest known paths.

    Parameters
    ----------
    path : str
        As in messages and in ``--set``: ``time.dt``, ``walls.top.velocity``, ``loads.0.g``, ``material``, or
        a kind: ``NeoHookean``, ``material.NeoHookean``; in any case of letters, where that is one of them.
    """
    every = entries()
    wanted = tuple(part for part in path.strip().strip(".").split(".") if part)
    for place, same in _SAME_KEYS.items():
        if len(wanted) > len(place) and matches(place, wanted[: len(place)]):
            wanted = (*same, *wanted[len(place) :])
    kinds = {kind: entry.path[:-1] for entry in every for kind in entry.kinds}
    fields = [f"output: the field {name} is {what}" for name, what in _fields(wanted[-1] if wanted else "")]
    names = [*{entry.path[-1] for entry in every}, *kinds]
    if wanted and not fields and wanted[-1] not in names:
        found = [name for name in sorted(names) if name.lower() == wanted[-1].lower()]
        wanted = (*wanted[:-1], *(found or wanted[-1:])[:1])
    if wanted and wanted[-1] in kinds:
        kind, section = wanted[-1], kinds[wanted[-1]]
        tag = [replace(e, example=kind) for e in every if e.path[:-1] == section and e.path[-1] in TAGS]
        own = [*tag, *(e for e in every if e.path[:-1] == section and kind in e.kinds)]
        return "\n\n".join([_said_of(kind), *cards(own)])
    exact = [entry for entry in every if matches(entry.path, wanted)]
    # a name alone is that of a key in all tables that have it
    exact = exact or [entry for entry in every if entry.path[-1:] == wanted]
    below = [e for e in every if len(e.path) > len(wanted) and matches(e.path[: len(wanted)], wanted)]
    if wanted and below:
        title = [f"[{path}]  {entry.type}: {entry.meaning}" for entry in exact]
        return "\n".join([*title, *(line(entry) for entry in below)])
    said = [*cards(exact), *fields] or _mentions(every, kinds, wanted)
    if not said:
        last = {entry.path[-1]: entry.name for entry in every}
        close = [last[name] for name in difflib.get_close_matches(wanted[-1], last, n=2)] if wanted else []
        names = [*dict.fromkeys(entry.name for entry in every), *kinds]
        close += difflib.get_close_matches(path, names, n=3, cutoff=0.4)
        close = list(dict.fromkeys(close))[:3]
        hint = f"such as {', '.join(close)}; " if close else ""
        raise ParameterError("KEY", path, f"a key of a case file, {hint}ngvisco list --keys has them all")
    return "\n\n".join(said)


def _said_of(kind: str) -> str:
    """A kind, and what it is."""
    doc = next((summary(made) for model, made in _TARGETS.items() if model.__name__ == kind), "")
    return f"{kind}: {doc}" if doc else kind


def _fields(name: str) -> list[tuple[str, str]]:
    """Fields of the output of this name, and what their modules say of them."""
    tables = f"{output.__doc__}{passive.__doc__}"
    rows = re.findall(r"^\| (\w+) +\| (.*\S) +\| [^|]*\|$", tables, re.M)
    return [(name, what) for named, what in rows if named == re.sub(r"_\d$", "_i", name)]


def _mentions(
    every: Sequence[Entry], kinds: Mapping[str, tuple[str, ...]], wanted: tuple[str, ...]
) -> list[str]:
    """Kinds and keys of which a word is said; none where it is said of half of them."""
    word = re.compile(rf"\b{re.escape(wanted[0])}" if len(wanted) == 1 else r"\Z\b", re.IGNORECASE)
    docs = {model.__name__: inspect.getdoc(made) or "" for model, made in _TARGETS.items()}
    said = [_said_of(kind) for kind in kinds if word.search(re.split(r"\n\w+\n--", docs.get(kind, ""))[0])]
    said += [line(entry).strip() for entry in every if word.search(f"{entry.type} {entry.meaning}")]
    return said if len(said) < _MANY else []


_MANY = 40


def listing() -> str:
    """Every key in a line of its own, table by table."""
    return "\n".join(line(entry) for entry in entries())


def matches(path: tuple[str, ...], wanted: tuple[str, ...]) -> bool:
    """Whether a user's path is this one: NAME stands for any name, N for an index."""
    return len(path) == len(wanted) and all(
        a == b or a == "NAME" or (a == "N" and b.isdigit()) for a, b in zip(path, wanted, strict=True)
    )


def line(entry: Entry) -> str:
    """A key in one line; of a table its name and what it is."""
    if entry.is_table:
        return f"[{entry.name}]  {entry.meaning}"
    unit = f", {entry.unit}" if entry.unit not in ("", "1") else ""
    kinds = f" [{', '.join(entry.kinds)}]" if entry.kinds else ""
    return f"  {entry.name}{kinds}: {entry.type}{unit}; {entry.default_text}; {entry.meaning}"


def cards(every: Sequence[Entry]) -> list[str]:
    """Keys with all that is known of them, on lines of their own; kinds that differ by words share a card."""
    groups: dict[tuple[str, ...], list[Entry]] = {}
    for entry in every:
        groups.setdefault((entry.name, entry.type, entry.unit, entry.default_text), []).append(entry)
    return [_card(group) for group in groups.values()]


def _card(group: list[Entry]) -> str:
    entry, is_one = group[0], len(group) == 1
    rows = [("type", entry.type)]
    if entry.unit:
        rows.append(("unit", "none (a pure number)" if entry.unit == "1" else entry.unit))
    rows.append(("default", entry.default_text))
    rows += [("meaning", e.meaning if is_one else f"{e.meaning} ({', '.join(e.kinds)})") for e in group]
    if entry.example is not None:
        rows.append(("example", entry.example_text))
    if is_one and entry.kinds:
        rows.append(("of", ", ".join(entry.kinds)))
    return "\n".join([entry.name, *(f"  {name:8s} {text}" for name, text in rows)])


def markdown() -> str:
    """The whole reference as a page."""
    every = entries()
    parts = [_HEAD]
    for section in dict.fromkeys(entry.path[0] for entry in every):
        own = [entry for entry in every if entry.path[0] == section]
        title = f"`{section}`" if len(own) == 1 else f"`[{section}]`"
        parts += [f"## {title}", "", *(f"{own[0].meaning}.\n" for _ in own[:1] if own[0].is_table)]
        parts += ["| key | type | unit | default | meaning | example |", "|---|---|---|---|---|---|"]
        parts += [_row(entry) for entry in own[own[0].is_table :]]
        parts.append("")
    return "\n".join(parts)


def _row(entry: Entry) -> str:
    of = f"<br>*{', '.join(entry.kinds)}*" if entry.kinds else ""
    example = "" if entry.example is None else f"`{entry.example_text}`"
    default = entry.default_text if entry.required or entry.default is None else f"`{entry.default_text}`"
    cells = (f"`{entry.name}`{of}", entry.type, entry.unit, default, entry.meaning, example)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


_HEAD = """\
# Keys of a case file

Written by `ngvisco list --markdown`; `ngvisco explain KEY` says the same of one key, and `ngvisco new NAME`
prints a case to start from. NAME stands for a name of one's own (a wall's, a variable's), N for the index of
an array of tables. A key with kinds in italics belongs to these only. An expression is a text of `x`, `y`,
`z` (m), `t` (s), `pi`, numbers, `+ - * / **`, `sin cos tan asin acos atan atan2 exp log sqrt abs sinh cosh
tanh min max` and `a if x < 1 else b`. A text with a number and its unit, `"5 km"`, may stand for any number
that has a unit; `[units]` chooses those of plain numbers.

An expression of the variables, as `energy` is, reads the names in `variables` and `parameters`, `pi`, the
identity `I` and entries `F[0, 1]`, with `tr det norm2 dot cof inv trans sym dev sph` of tensors (`norm2(A)`
is A : A) and `exp log sqrt abs sinh cosh tanh min max` of scalars.
"""


def json_schema() -> dict[str, Any]:
    """The schema as JSON Schema (draft 2020-12), with meanings, units and examples, for editors."""
    schema = CaseSections.model_json_schema()
    models: dict[str, type[BaseModel]] = {}
    _collect(CaseSections, models)
    for name, model in models.items():
        node = schema if model is CaseSections else schema["$defs"][name]
        node["title"] = name
        for field_name, prop in list(node["properties"].items()):
            if field_name not in TAGS:
                if quantity(model, field_name).unit not in ("", "1", "any"):
                    node["properties"][field_name] = prop = _with_quantities(prop)
                prop.update(_annotations(model, field_name))
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "ngvisco case file"}


def _collect(model: type[BaseModel], into: dict[str, type[BaseModel]]) -> None:
    if into.setdefault(model.__name__, model) is not model:
        raise TypeError(f"two sections of a case file are called {model.__name__}")
    for field in model.model_fields.values():
        for inner in models_in(field.annotation):
            if inner.__name__ not in into:
                _collect(inner, into)


def _annotations(model: type[BaseModel], name: str) -> dict[str, Any]:
    said = quantity(model, name)
    words = ", ".join(filter(None, (meaning(model, name), said.range)))
    unit = f" [{said.unit}]" if said.unit not in ("", "1") else ""
    examples = {} if said.example is None else {"examples": [said.example]}
    return {"description": f"{words}{unit}", "title": name, **examples}


def _with_quantities(node: Any) -> Any:
    """A property's schema in which numbers may be texts with a unit."""
    if isinstance(node, dict):
        if node.get("type") == "number":
            quantity = {"type": "string", "pattern": r"^\s*[+-]?[0-9.]+([eE][+-]?[0-9]+)?\s*[A-Za-z]"}
            return {"anyOf": [node, quantity]}
        return {name: _with_quantities(part) for name, part in node.items()}
    return [_with_quantities(part) for part in node] if isinstance(node, list) else node


_SAME = re.compile(r"As for (\w+)")


@cache
def quantities(owner: Any) -> Mapping[str, Quantity]:
    """What the annotations of a class or function say of its parameters; the unit is "1" of other numbers."""
    found = {}
    for name, hint in get_type_hints(owner, include_extras=True).items():
        said = [part for part in getattr(hint, "__metadata__", ()) if isinstance(part, Quantity)]
        is_number = re.search(r"\b(int|float)\b", str(getattr(hint, "__origin__", hint)))
        found[name] = said[0] if said else Quantity("1" if is_number else "")
    return found


@cache
def meanings(owner: Any) -> Mapping[str, str]:
    """What the docstring of a class or function says of its parameters, without the final stop."""
    from docstring_parser import DocstringStyle, parse  # no run needs it

    found = {}
    for each in reversed(inspect.getmro(owner) if inspect.isclass(owner) else (owner,)):
        for part in parse(each.__doc__ or "", DocstringStyle.NUMPYDOC).params:
            text = " ".join((part.description or "").replace("``", "").split()).removesuffix(".")
            same = _SAME.fullmatch(text)
            if part.args[0] != "param":
                continue
            for name in part.arg_name.split(", "):
                found[name] = meanings(_named(same[1]))[name] if same else text
    return found


def summary(owner: Any) -> str:
    """The first line of a docstring, without the final stop."""
    return (inspect.getdoc(owner) or "").split("\n")[0].replace("``", "").removesuffix(".")


def _named(name: str) -> Any:
    return next(made for table in catalogue.TABLES for made in table.values() if made.__name__ == name)
