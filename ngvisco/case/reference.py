"""The reference of case files, from the schema: every key with type, unit, default, meaning and example.

In a path such as ``walls.NAME.velocity``, NAME stands for a name that the user gives and N for the index of
an array of tables.  Keys that only some kinds of a section have are listed with these kinds.
"""

import difflib
import inspect
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from ngvisco.case import toml
from ngvisco.case.catalogue import KINDS
from ngvisco.case.laws import EnergyText
from ngvisco.case.schema import CaseSections
from ngvisco.case.section import TAGS, Section, inner_tables, models_in, owner_of, place_in, places, quantity
from ngvisco.case.values import ValueKind
from ngvisco.errors import ParameterError
from ngvisco.run import fields as output
from ngvisco.run import passive


@dataclass(frozen=True)
class KeyEntry:
    """One key of the reference; ``kinds`` are the kinds of the section that have the key.

    ``kinds`` is empty if all kinds have the key.  A table of keys has no example.
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
        """The key's path, joined by dots."""
        return ".".join(self.path)

    @property
    def default_text(self) -> str:
        """The default in TOML; "required" or "none" without a default."""
        if self.required:
            return "required"
        return "none" if self.default is None else toml.value_text(self.default)

    @property
    def is_table(self) -> bool:
        """Whether the entry is a table of keys."""
        return self.example is None

    @property
    def example_text(self) -> str:
        """The example as a line of a case file."""
        return f"{self.path[-1]} = {toml.value_text(self.example)}"


@cache
def entries() -> tuple[KeyEntry, ...]:
    """Every key of a case file, in the order of the schema; kinds that agree on a key share its entry."""
    grouped: dict[tuple[Any, ...], KeyEntry] = {}
    for entry in _walk([CaseSections], ()):
        words = (entry.type, entry.unit, entry.meaning)
        same = (entry.path, *words, entry.required, repr(entry.default), repr(entry.example))
        first = grouped.get(same)
        grouped[same] = entry if first is None else replace(first, kinds=(*first.kinds, *entry.kinds))
    return tuple(grouped.values())


@cache
def _same_keys() -> dict[tuple[str, ...], tuple[str, ...]]:
    """Path of each table that has the keys of another table, with the path of that other table."""
    of_model = places(CaseSections)
    tables = [
        ((*path, *way), inner) for model, path in of_model.items() for way, inner in inner_tables(model)
    ]
    return {path: of_model[inner[0]] for path, inner in tables if of_model[inner[0]] != path}


def _listed(user_path: tuple[str, ...]) -> tuple[str, ...]:
    """The path under which the reference lists a key: tables with equal keys are listed once."""
    for place, same in _same_keys().items():
        if len(user_path) > len(place) and matches(place, user_path[: len(place)]):
            return _listed((*same, *user_path[len(place) :]))
    return user_path


def _walk(models: Sequence[type[Section]], path: tuple[str, ...]) -> Iterator[KeyEntry]:
    """Yield the keys of a table and of its inner tables; the table is a section of one of the ``models``."""
    tag = next((tag for tag in TAGS if tag in models[0].model_fields), None)
    if tag is not None:
        names = [model.__name__ for model in models]
        required = all(model.model_fields[tag].is_required() for model in models)
        kinds, default = f"one of {', '.join(names)}", None if required else names[0]
        said = "Kind, which determines the other keys of the table"
        yield KeyEntry((*path, tag), (), kinds, "", required, default, said, names[0])
    for model in models:
        keys = [(name, field) for name, field in model.model_fields.items() if name not in TAGS]
        # tables come after plain keys
        for name, field in sorted(keys, key=lambda key: bool(models_in(key[1].annotation))):
            inner, annotation = models_in(field.annotation), quantity(model, name)
            default = None if inner or field.is_required() else field.default
            is_empty = default in (None, "", [], {}, False) and annotation.example is not None
            yield KeyEntry(
                (*path, name),
                () if tag is None else (model.__name__,),
                ", ".join(filter(None, (type_text(field.rebuild_annotation()), annotation.range))),
                annotation.unit,
                field.is_required(),
                default,
                meaning(model, name),
                None if inner else annotation.example if is_empty else default,
            )
            below = (*path, name, *place_in(field.annotation))
            # a table may stand in two places; its keys are then listed once, under the other place
            if inner and below not in _same_keys():
                yield from _walk(inner, below)


def type_text(annotation: Any) -> str:
    """The words for a type of the schema."""
    plain = {
        float: "number",
        int: "whole number",
        bool: "true or false",
        str: "text",
        EnergyText: "expression of the variables",
        NoneType: "",
    }
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        kinds = [part.words for part in arguments if isinstance(part, ValueKind)]
        return kinds[0] if kinds else type_text(arguments[0])
    if annotation in plain:
        return plain[annotation]
    if origin is Literal:
        return f"one of {', '.join(json.dumps(value) for value in arguments)}"
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(filter(None, map(type_text, arguments))))
    if models_in(annotation):
        return {dict: "tables by name", list: "array of tables"}.get(origin, "table")
    inner = type_text(arguments[-1])
    if origin is dict:
        return f"table of {inner}s" if arguments[1] in (float, int) else "table by name"
    return f"array of arrays{inner[5:]}" if inner.startswith("array") else f"array of {inner}s"


def explain(path: str) -> str:
    """The explanation of a key, section, kind or output field; for another word the keys that mention it.

    Raises ParameterError, with the nearest known paths, for an unknown path.

    Parameters
    ----------
    path : str
        Path as in messages and in ``--set``, ``time.dt``, ``walls.top.velocity``, ``loads.0.g``,
        ``material``, or a kind, ``NeoHookean``, ``material.NeoHookean``; case is ignored.
    """
    every = entries()
    user_path = _listed(tuple(part for part in path.strip().strip(".").split(".") if part))
    kinds = {kind: entry.path[:-1] for entry in every for kind in entry.kinds}
    last = user_path[-1] if user_path else ""
    fields = [f"output: the field {name} is {description}" for name, description in _fields(last)]
    names = {entry.path[-1]: entry.name for entry in every} | dict.fromkeys(kinds, "")
    if not fields and last not in names:
        last = next((name for name in sorted(names) if name.lower() == last.lower()), last)
        user_path = (*user_path[:-1], last)
    if last in kinds:
        keys = [entry for entry in every if entry.path[:-1] == kinds[last]]
        tag = [replace(entry, example=last) for entry in keys if entry.path[-1] in TAGS]
        return "\n\n".join(
            [_said_of(last), *cards([*tag, *(entry for entry in keys if last in entry.kinds)])]
        )
    # a name without a table means all keys of this name
    exact = [e for e in every if matches(e.path, user_path)] or [e for e in every if e.path[-1:] == user_path]
    below = [
        e for e in every if len(e.path) > len(user_path) and matches(e.path[: len(user_path)], user_path)
    ]
    if user_path and below:
        title = [f"[{path}]  {entry.type}: {entry.meaning}" for entry in exact]
        return "\n".join([*title, *(line(entry) for entry in below)])
    if hits := [*cards(exact), *fields] or _mentions(every, list(kinds), user_path):
        return "\n\n".join(hits)
    paths = [*dict.fromkeys(entry.name for entry in every), *kinds]
    close = [names[name] or name for name in difflib.get_close_matches(last, names, n=2)]
    close = list(dict.fromkeys([*close, *difflib.get_close_matches(path, paths, n=3, cutoff=0.4)]))[:3]
    hint = f", such as {', '.join(close)}" if close else ""
    raise ParameterError("KEY", path, f"a key of a case file{hint}; ngvisco list --keys prints all keys")


def _said_of(kind: str) -> str:
    """A kind and its summary."""
    return f"{kind}: {summary(KINDS[kind])}"


def _fields(name: str) -> list[tuple[str, str]]:
    """Names and descriptions of the output's fields with this name, from their modules' docstrings."""
    rows = re.findall(r"^\| (\w+) +\| (.*\S) +\| [^|]*\|$", f"{output.__doc__}{passive.__doc__}", re.M)
    return [(name, description) for named, description in rows if named == re.sub(r"_\d$", "_i", name)]


def _mentions(every: Sequence[KeyEntry], kinds: Sequence[str], user_path: tuple[str, ...]) -> list[str]:
    """Kinds and keys whose descriptions contain a word; none if there are ``_MANY`` or more."""
    if len(user_path) != 1:
        return []
    word = re.compile(rf"\b{re.escape(user_path[0])}", re.IGNORECASE)
    docs = {kind: re.split(r"\n\w+\n--", inspect.getdoc(KINDS[kind]) or "")[0] for kind in kinds}
    matches = [_said_of(kind) for kind, doc in docs.items() if word.search(doc)]
    matches += [line(entry).strip() for entry in every if word.search(f"{entry.type} {entry.meaning}")]
    return matches if len(matches) < _MANY else []


_MANY = 40


def listing() -> str:
    """All keys, one to a line, table by table."""
    return "\n".join(line(entry) for entry in entries())


def matches(path: tuple[str, ...], user_path: tuple[str, ...]) -> bool:
    """Whether a user's path ``user_path`` fits ``path``, with NAME for any name and N for any index."""
    return len(path) == len(user_path) and all(
        a == b or a == "NAME" or (a == "N" and b.isdigit()) for a, b in zip(path, user_path, strict=True)
    )


def line(entry: KeyEntry) -> str:
    """The line of a key; for a table its name and meaning."""
    if entry.is_table:
        return f"[{entry.name}]  {entry.meaning}"
    unit = f", {entry.unit}" if entry.unit not in ("", "1") else ""
    kinds = f" [{', '.join(entry.kinds)}]" if entry.kinds else ""
    return f"  {entry.name}{kinds}: {entry.type}{unit}; {entry.default_text}; {entry.meaning}"


def cards(every: Sequence[KeyEntry]) -> Iterator[str]:
    """Yield cards with all properties of the keys; kinds that differ only in words share a card."""
    groups: dict[tuple[str, ...], list[KeyEntry]] = {}
    for entry in every:
        groups.setdefault((entry.name, entry.type, entry.unit, entry.default_text), []).append(entry)
    for (name, kind, unit, default), (entry, *similar) in groups.items():
        of_number = "none (a pure number)" if unit == "1" else unit
        rows = [("type", kind), ("unit", of_number), ("default", default)]
        if similar:
            rows += [("meaning", f"{e.meaning} ({', '.join(e.kinds)})") for e in (entry, *similar)]
        else:
            rows.append(("meaning", entry.meaning))
        rows.append(("example", "" if entry.example is None else entry.example_text))
        rows.append(("of", "" if similar else ", ".join(entry.kinds)))
        yield "\n".join([name, *(f"  {label:8s} {text}" for label, text in rows if text)])


def markdown() -> str:
    """The whole reference as a Markdown page."""
    every = entries()
    parts = [_HEAD]
    for section in dict.fromkeys(entry.path[0] for entry in every):
        keys = [entry for entry in every if entry.path[0] == section]
        title = f"`{section}`" if len(keys) == 1 else f"`[{section}]`"
        parts += [f"## {title}", "", *(f"{keys[0].meaning}.\n" for _ in keys[:1] if keys[0].is_table)]
        parts += ["| key | type | unit | default | meaning | example |", "|---|---|---|---|---|---|"]
        parts += [_row(entry) for entry in keys[keys[0].is_table :]]
        parts.append("")
    return "\n".join(parts)


def _row(entry: KeyEntry) -> str:
    kinds = f"<br>*{', '.join(entry.kinds)}*" if entry.kinds else ""
    example = "" if entry.example is None else f"`{entry.example_text}`"
    default = entry.default_text if entry.required or entry.default is None else f"`{entry.default_text}`"
    cells = (f"`{entry.name}`{kinds}", entry.type, entry.unit, default, entry.meaning, example)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


_HEAD = """\
# Keys of a case file

`ngvisco list --markdown` writes this page. `ngvisco explain KEY` explains one key, and `ngvisco new NAME`
prints a case to start from. In keys NAME stands for a name that you choose (of a wall or a variable), and N
for the index of an array of tables. If kinds in italics stand below a key, only these kinds have the key. An
expression is a text of `x`, `y`, `z` (m), `t` (s), `pi`, numbers, `+ - * / **`, `sin cos tan asin acos atan
atan2 exp log sqrt abs sinh cosh tanh min max` and `a if x < 1 else b`. A text with a number and its unit,
`"5 km"`, may replace any number that has a unit; `[units]` chooses the units of plain numbers.

An expression of the variables, such as `energy`, reads the names in `variables` and `parameters`, `pi`, the
identity `I` and entries `F[0, 1]`, with `tr det norm2 dot cof inv trans sym dev sph` of tensors (`norm2(A)`
is A : A) and `exp log sqrt abs sinh cosh tanh min max` of scalars.
"""


_BOUNDS = {">": "exclusiveMinimum", ">=": "minimum"}


class _Described(GenerateJsonSchema):
    """A schema generator that adds meanings, units and examples, and admits texts for numbers with a unit."""

    def model_schema(self, schema: core_schema.ModelSchema) -> dict[str, Any]:
        node, model = super().model_schema(schema), schema["cls"]
        for name in node["properties"].keys() - set(TAGS):
            annotation, key = quantity(model, name), node["properties"][name]
            has_unit = annotation.unit not in ("", "1")
            if has_unit and annotation.unit != "any":
                key = _with_quantities(key)
            words = ", ".join(filter(None, (meaning(model, name), annotation.range)))
            described = {"title": name, "description": f"{words} [{annotation.unit}]" if has_unit else words}
            examples = {} if annotation.example is None else {"examples": [annotation.example]}
            sign, _, least = annotation.range.partition(" ")
            bounds = {_BOUNDS[sign]: float(least)} if sign in _BOUNDS else {}
            node["properties"][name] = {**key, **described, **examples, **bounds}
        return node


def json_schema() -> dict[str, Any]:
    """The schema as JSON Schema (draft 2020-12), with meanings, units and examples, for editors."""
    schema = CaseSections.model_json_schema(schema_generator=_Described)
    return {"$schema": GenerateJsonSchema.schema_dialect, **schema, "title": "ngvisco case file"}


def _with_quantities(node: Any) -> Any:
    """The schema of a property whose numbers may also be texts with a unit."""
    if isinstance(node, dict):
        if node.get("type") == "number":
            quantity = {"type": "string", "pattern": r"^\s*[+-]?[0-9.]+([eE][+-]?[0-9]+)?\s*[A-Za-z]"}
            return {"anyOf": [node, quantity]}
        return {name: _with_quantities(part) for name, part in node.items()}
    return [_with_quantities(part) for part in node] if isinstance(node, list) else node


def meaning(model: type[Section], name: str) -> str:
    """The description of a key; it falls back to the description of the nested section."""
    field = model.model_fields[name]
    text = field.description or meanings(owner_of(model)).get(name)
    return text or summary(owner_of(models_in(field.annotation)[0]))


_SAME = re.compile(r"As for (\w+)")


@cache
def meanings(owner: Any) -> Mapping[str, str]:
    """Descriptions of parameters in the docstring of a class or function, by name, without the final stop."""
    from docstring_parser import DocstringStyle, parse  # runs do not need this package

    descriptions, targets = {}, {target.__name__: target for target in KINDS.values()}
    for described in reversed(inspect.getmro(owner) if inspect.isclass(owner) else (owner,)):
        for part in parse(described.__doc__ or "", DocstringStyle.NUMPYDOC).params:
            text = " ".join((part.description or "").replace("``", "").split()).removesuffix(".")
            same = _SAME.fullmatch(text)
            if part.args[0] != "param":
                continue
            for name in part.arg_name.split(", "):
                descriptions[name] = meanings(targets[same[1]])[name] if same else text
    return descriptions


def summary(owner: Any) -> str:
    """The first line of an object's docstring, without the final stop."""
    return (inspect.getdoc(owner) or "").split("\n")[0].replace("``", "").removesuffix(".")
