"""Annotated case files: a demo's case with every key explained and every optional key shown."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from ngvisco.case import toml
from ngvisco.case.reference import KeyEntry, entries, matches
from ngvisco.case.section import TAGS
from ngvisco.errors import require_known

_COLUMN = 46
"""The column at which comments begin."""
_TABLE = re.compile(r"^\[\[?([A-Za-z_][\w.-]*)\]", re.M)
_KIND = re.compile(rf'^(?:{"|".join(TAGS)})\s*=\s*"(.*?)"', re.M)
_HEAD = """\
# A case for ngvisco, to be changed: the demo {}.  Run it by: ngvisco run FILE
# `ngvisco explain KEY` explains a key.  Values are in SI units.
# Editors complete keys by a schema: run `ngvisco list --schema > case.schema.json` and write
# `#:schema ./case.schema.json` into the first line."""


def demos() -> dict[str, Path]:
    """Case files of the demos by name, in the package or in the clone that contains it."""
    package = Path(__file__).resolve().parents[1]
    for place in (package / "demos", package.parent / "demos"):
        if place.is_dir():
            return {path.stem: path for path in sorted(place.glob("*/*.toml"))}
    return {}


def template(name: str) -> str:
    """An annotated case file that runs like the demo ``name``.

    Each key has its unit and meaning beside it; optional keys and tables follow as comments, with their
    default, or else an example, as value.  Raises UnknownNameError if there is no such demo.
    """
    files = demos()
    require_known("demo", [name], files)
    text, every = files[name].read_text(encoding="utf-8"), entries()
    lines = _HEAD.format(name).split("\n")
    for block in re.split(r"^(?=\[)", text, flags=re.M):
        lines += _annotated(block, every)
    named = [tuple(path.split(".")) for path in _TABLE.findall(text)]
    for path in dict.fromkeys(e.path[:-1] for e in every if len(e.path) > 1 and e.example is not None):
        if not any(matches(_shape(path), real) for real in named) and "material" not in path:
            lines += _absent(path, [e for e in every if e.path[:-1] == path and e.example is not None])
    return "\n".join(lines).rstrip() + "\n"


def _annotated(block: str, every: Sequence[KeyEntry]) -> Iterator[str]:
    """Yield the lines of a table with their keys' meanings, and the table's other keys as comments."""
    header, kind = _TABLE.match(block), _KIND.search(block)
    path = tuple(header[1].split(".")) if header else ()
    keys = [entry for entry in every if matches(_shape(entry.path)[:-1], path)]
    chosen = kind[1] if kind else next((entry.default for entry in keys if entry.path[-1] in TAGS), None)
    remaining = {entry.path[-1]: entry for entry in keys if not entry.kinds or chosen in entry.kinds}
    for line in block.rstrip().split("\n"):
        entry = remaining.pop(line.split("=")[0].strip(), None) if re.match(r"\w+\s*=", line) else None
        if entry is None:
            yield line
        elif line.count("[") == line.count("]"):  # the value ends in this line
            yield _beside(line, _note(entry))
        else:
            yield f"# {_note(entry)}"
            yield line
    for entry in remaining.values() if header else ():
        if entry.example is not None and not entry.required:
            yield _commented(entry)
    yield ""


def _absent(path: tuple[str, ...], keys: Sequence[KeyEntry]) -> Iterator[str]:
    """Yield a table that the demo lacks, as comments with examples."""
    kind = next((entry.example for entry in keys if entry.path[-1] == "kind"), None)
    title = ".".join(_shape(path))
    yield ""
    yield f"# [[{title}]]" if path[-1] == "N" else f"# [{title}]"
    for entry in keys:
        if not entry.kinds or kind in entry.kinds:
            yield _commented(entry)


def _shape(path: tuple[str, ...]) -> tuple[str, ...]:
    """A key's path without indices."""
    return tuple(part for part in path if part != "N")


def _note(entry: KeyEntry) -> str:
    unit = f"{entry.unit}: " if entry.unit not in ("", "1") else ""
    return f"{unit}{entry.type if entry.path[-1] in TAGS else entry.meaning}"


def _beside(line: str, note: str) -> str:
    """The line with a note between its code and its own comment."""
    code, mark, comment = line.partition(" # ")
    return f"{code.rstrip():{_COLUMN}s} # {note}" + (f"; here {comment}" if mark else "")


def _commented(entry: KeyEntry) -> str:
    """A key as a comment, with its default, or with the example if the default is empty."""
    value = entry.example if entry.default in (None, [], {}) else entry.default
    return _beside(f"# {entry.path[-1]} = {toml.value_text(value)}", _note(entry))
