"""The faults of a case file, which are errors of pydantic and ngvisco in the user's words.

``faults_of`` collects the faults of the file itself; a ``Locator`` locates errors while a case is built.
"""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import ValidationError

from ngvisco.case.schema import CaseSections
from ngvisco.case.section import TAGS, Section, given, models_in, owner_of, places, reached, shown
from ngvisco.case.toml import line_of, value_text
from ngvisco.case.values import Wrong
from ngvisco.errors import InitialDataError, MeshError, NgviscoError, ParameterError, nearest
from ngvisco.parallel.petsc import PETScError
from ngvisco.run.ranks import abort_alone
from ngvisco.words import FUNCTION, Mention, Words, words_of


@dataclass(frozen=True)
class Fault:
    """One fault: the key's path in the file, a message, and the line if it is known."""

    key: str
    message: str
    line: int | None = None


class CaseError(NgviscoError, ValueError):
    """The error of a case file that cannot be run; ``faults`` lists all faults found."""

    def __init__(self, source: str, faults: Sequence[Fault]) -> None:
        self.source, self.faults = source, tuple(faults)
        super().__init__("\n".join(self._line(fault) for fault in self.faults))

    def _line(self, fault: Fault) -> str:
        place = f"{self.source}:{fault.line}" if fault.line else self.source
        return f"{place}: {fault.key}: {fault.message}" if fault.key else f"{place}: {fault.message}"


_WORDS = {
    "float_type": "expected a number",
    "int_type": "expected a whole number",
    "int_from_float": "expected a whole number",
    "bool_type": "expected true or false",
    "string_type": "expected a text in quotes",
    "list_type": "expected an array, as in [1, 1]",
    "dict_type": "expected a table",
    "model_type": "expected a table",
    "model_attributes_type": "expected a table",
    "too_short": "expected at least one name; without this key, the default names are taken",
    "literal_error": "expected {expected}",
    "string_pattern_mismatch": "expected 1 to 60 characters, each a letter, a digit, '_' or '-'",
}
"""Messages that replace those of pydantic, by the type of its error."""


@dataclass
class Locator:
    """Finds the keys of a case to which errors refer, and the lines of these keys in the file.

    Attributes
    ----------
    lines : dict of int, by key path
    overridden : sequence of key paths
        Keys that were set on the command line.
    source : str
        Name of the file.
    data : dict
        The data as the user wrote them.
    converted : list of (last key, written value)
        Values that were converted to SI units.
    sections : CaseSections
        The validated case.
    """

    lines: Mapping[tuple[str, ...], int]
    overridden: Sequence[tuple[str, ...]] = ()
    source: str = ""
    data: Any = None
    converted: Sequence[tuple[str, Any]] = ()
    sections: Any = None

    def written(self, path: tuple[str, ...], value: object) -> object:
        """The value of a key as the file has it, if ``value`` is an object, or if the file has a text that
        was not converted to SI units; otherwise ``value``."""
        text = given(self.data, path)
        is_plain = isinstance(value, (int, float, str, list))
        is_its_text = isinstance(text, str) and (path[-1], text) not in self.converted
        return text if text is not None and (is_its_text or not is_plain) else value

    def fault(self, path: tuple[str, ...], message: object) -> Fault:
        """The fault at a key path, with its line if the file contains the key."""
        key, words = ".".join(path), in_case(message)
        above = (path[:length] for length in range(len(path), 0, -1))
        written = ((key[-1], given(self.data, key)) for key in above)
        if converted := next((key for key in written if key in self.converted), None):
            words = f"{words} (these numbers are in SI units; the case has {shown(converted[1])})"
        is_within = any(path[: len(o)] == o for o in self.overridden)
        is_made = path not in self.lines and any(o[: len(path)] == path for o in self.overridden)
        if path and (is_within or is_made):
            return Fault(f"{key} (set on the command line)", words)
        return Fault(key, words, line_of(self.lines, path))

    def error(self, path: tuple[str, ...], message: object) -> CaseError:
        """A ``CaseError`` with one fault, at the key ``path``."""
        return CaseError(self.source, [self.fault(path, message)])

    @contextmanager
    def located(self, *path: str) -> Iterator[None]:
        """Context that turns errors into faults of a section, or of the key that the error names."""
        try:
            yield
        except (CaseError, PETScError):  # a missing PETSc is no fault of a section
            raise
        except NgviscoError as error:
            raise self.error(*self._blamed(error, path)) from error
        except Exception as error:  # NGSolve and Netgen raise bare exceptions
            abort_alone(error)
            raise self.error(path, f"{type(error).__name__}: {error}") from error

    def _blamed(self, error: NgviscoError, path: tuple[str, ...]) -> tuple[tuple[str, ...], object]:
        """The key at fault and the message."""
        value = getattr(error, "value", None)
        if isinstance(error, MeshError):
            return ("domain", "path") if self.sections.domain.geometry == "file" else ("domain",), error
        key = key_of(error.key, path, self.sections, value) if error.key else path
        if isinstance(error, ParameterError):
            return key, refused(self._shown(key, value), error)
        if isinstance(error, InitialDataError) and key[:1] != ("initial",):
            there = shown(self._shown(key, error.field))
            return key, f"{there}: at the start {error.value}; expected {error.expected}"
        return key, error

    def _shown(self, key: tuple[str, ...], value: object) -> object:
        """The value of a key as the user wrote it; ``value`` itself if the key is missing, contains tables,
        or has ``value`` as a member."""
        there = given(self.sections, key)
        members = there if isinstance(there, list) else []
        is_member = isinstance(value, str) and value in members
        if there is None or is_member or any(isinstance(part, Section) for part in members):
            return value
        return self.written(key, there)


def faults_of(error: ValidationError, model: type[Section], locator: Locator) -> list[Fault]:
    """One fault for each of pydantic's errors, in the order of the file."""
    faults = []
    for entry in error.errors():
        path, here, keys, inner = _resolve(model, entry["loc"])
        raised = (entry.get("ctx") or {}).get("error")
        if entry["type"] == "union_tag_invalid":
            path = (*path, entry["ctx"]["discriminator"].strip("'"))
        if isinstance(raised, ParameterError):
            # NeoHookean.G_e is the key G_e in [material]
            names = names_in(raised.field)
            path += tuple(names[next((i for i, name in enumerate(names) if name in inner), len(names)) :])
            message = refused(locator.written(path, raised.value), raised)
        else:
            message = _message(entry, raised, path, here, keys)
        faults.append(locator.fault(path, message))
    return sorted(faults, key=lambda fault: (fault.line is None, fault.line or 0))


def names_in(field: str) -> list[str]:
    """The names and indices in a name like ``walls['top'].f`` or ``Composite.rules[0].nu``."""
    return re.sub(r"\[[\"']?(.*?)[\"']?\]", r".\1", field).split(".")


def _message(fault: Any, raised: object, path: tuple[str, ...], here: str, keys: list[str]) -> str:
    kind, value, context = fault["type"], fault["input"], fault.get("ctx") or {}
    if isinstance(value, Wrong):
        return str(value)
    if raised is not None:
        return f"{shown(value)}: {raised}"
    if kind == "extra_forbidden":
        return f"unknown key{nearest(path[-1], keys)} (known in {here}: {', '.join(keys)})"
    if kind == "missing":
        return f"is missing (keys of {here}: {', '.join(keys)})"
    if kind == "union_tag_invalid":
        tag, tags = str(context["tag"]), [t.strip("'") for t in context["expected_tags"].split(", ")]
        return f"{shown(tag)}: expected one of {', '.join(tags)}{nearest(tag, tags)}"
    if kind == "union_tag_not_found":
        discriminator = context["discriminator"].strip("'")
        written = difflib.get_close_matches(discriminator, [str(key) for key in value], n=1, cutoff=0.5)
        hint = f"; the key {written[0]!r} is unknown: did you mean {discriminator!r}?" if written else ""
        return f"the key {discriminator!r} is missing{hint}"
    if kind == "list_type" and isinstance(value, dict):
        return f"{shown(value)}: expected an array of tables, [[{'.'.join(path)}]]"
    words = _WORDS[kind].format(**context) if kind in _WORDS else fault["msg"].lower()
    return f"{shown(value)}: {words}"


def refused(value: object, error: ParameterError) -> str:
    """The message of a refused value: the found value or "is missing", and the expected value."""
    return f"{'is missing' if value is None else shown(value)}: expected {in_case(error.expected)}"


def in_case(message: object) -> str:
    """The text of an error, a warning or a message, with a case file's keys in place of Python's names."""
    text = words_of(message)
    return "".join(map(_in_case, text.parts)) if isinstance(text, Words) else text


def _in_case(part: object) -> str:
    if not isinstance(part, Mention):
        return part if isinstance(part, str) else "nothing" if part is None else value_text(part)
    if part == FUNCTION:
        return "expression"
    if part.arguments is None:
        first, *names = _aliased(names_in(part.name))
        return ".".join([_places().get(first, (first, None))[0], *names])
    path, kind = _places()[part.name]
    settings: dict[str, object] = {} if kind is None else {"kind": kind}
    settings |= {key: value for key, value in part.arguments.items() if value is not ...}
    return ", ".join(f"{path}.{key} = {value_text(value)}" for key, value in settings.items()) or path


@cache
def _places() -> dict[str, tuple[str, str | None]]:
    """Table and kind of each class or function of the schema, by its name."""
    by_name: dict[str, tuple[str, str | None]] = {}
    by_target: dict[str, tuple[str, str | None]] = {}
    for model, path in places(CaseSections).items():  # the shortest path comes first
        place = ".".join(path), model.__name__ if set(TAGS) & set(model.model_fields) else None
        by_name.setdefault(model.__name__, place)
        by_target.setdefault(owner_of(model).__name__, place)
    return by_target | by_name


_FORMS = ("str", "list[str]")
"""Pydantic's names of the forms of a value that may be a text or an array of texts; tags in <> name other
forms."""


def _resolve(
    model: type[Section], location: tuple[Any, ...]
) -> tuple[tuple[str, ...], str, list[str], list[str]]:
    """Key path without unions' tags, the table that holds the key, the table's keys, and keys in the key."""
    path: list[str] = []
    models, here, keys = [model], "the case", list(model.model_fields)
    for part in location:
        fields = {name: field for each_model in models for name, field in each_model.model_fields.items()}
        chosen = [each_model for each_model in models if each_model.__name__ == part]
        if chosen not in ([], models) and part not in fields:
            models = chosen
        elif not str(part).startswith("<") and part not in _FORMS:  # the form of a value is no key
            here, keys = ".".join(path) or "the case", list(fields)
            if part in fields:
                models = models_in(fields[part].annotation)
            path.append(str(part))
    return tuple(path), here, keys, [name for each_model in models for name in each_model.model_fields]


def key_of(field: str, path: tuple[str, ...], sections: Any, value: object = None) -> tuple[str, ...]:
    """The key of a parameter named like ``Gravity.g``, ``walls['top'].f`` or
    ``bodies['disc'].NeoHookean.K_e``.

    ``path`` is the section of the object with the parameter.  Several matching keys are told apart by the
    parameter's ``value``.
    """
    names = _aliased(names_in(field))
    keys = reached(sections, (), names) or reached(given(sections, path), path, names[1:]) or [path]
    deepest = max(map(len, keys))
    keys = [key for key in keys if len(key) == deepest]
    near = [key for key in keys if key[: len(path)] == path] or keys
    exact = [key for key in near if value is not None and given(sections, key) == value]
    return (exact or near)[0]


_ALIASES = {
    "Integrals.integrands": ("Integrals", "of"),
    "Model": ("rheology",),
    "Model.bodies": ("bodies",),
    "Model.loads": ("loads",),
    "Model.material": ("material",),
    "Probes.points": ("Probes", "point"),
    "Simulation": ("time",),
    "Simulation.symmetry": ("domain", "symmetry"),
    "until": ("time", "until"),
    "stops": ("time", "until"),
    "passive": ("output", "passive"),
}
"""Keys of parameters whose class has no table."""


def _aliased(names: list[str]) -> list[str]:
    """The names in a parameter's name; a key of ``_ALIASES`` replaces the names at the front."""
    length = next((length for length in (2, 1) if ".".join(names[:length]) in _ALIASES), 0)
    return [*_ALIASES.get(".".join(names[:length]), ()), *names[length:]]
