"""Case files to start from: a demo's, with every key explained and every optional one shown."""

import re
from pathlib import Path

from ngvisco.case import toml
from ngvisco.case.build import parse_case
from ngvisco.case.reference import Entry, entries, matches
from ngvisco.errors import UnknownNameError

_COLUMN = 46
"""Where the comments begin."""
_TABLE = re.compile(r"^\s*\[\[?([A-Za-z_][\w.-]*)\]\]?\s*(?:#.*)?$")


def demos() -> dict[str, Path]:
    """Case files of the demos by name: those of the package, or of the clone that it stands in."""
    package = Path(__file__).resolve().parents[1]
    for place in (package / "demos", package.parent / "demos"):
        if place.is_dir():
            return {path.stem: path for path in sorted(place.glob("*/*.toml"))}
    return {}


def template(name: str) -> str:
    """An annotated case file that runs as the demo ``name`` does.

    Each key has its unit and meaning beside it; optional keys and tables follow as comments with their
    defaults, or with an example where there is none.  Raises UnknownNameError if there is no such demo.
    """
    known = demos()
    if name not in known:
        raise UnknownNameError("demo", name, known)
    text = known[name].read_text(encoding="utf-8")
    kinds = _kinds(text, name)
    blocks: list[str] = [
        f"# A case for ngvisco, to be changed: the demo {name}.  Run it by: ngvisco run FILE",
        "# What is said of a key is also what `ngvisco explain KEY` says; SI units.",
        "# Editors complete keys by a schema: run `ngvisco list --schema > case.schema.json` and write",
        "# `#:schema ./case.schema.json` into the first line.",
    ]
    every, done = entries(), set()
    path: tuple[str, ...] = ()
    given: set[str] = set()
    for text_line in [*text.splitlines(), "[end]"]:
        header, assignment = _TABLE.match(text_line), re.match(r"^([A-Za-z_]\w*)\s*=", text_line)
        if header:
            if path:
                while blocks and not blocks[-1].strip():
                    blocks.pop()
                blocks += [*_optional(every, path, given, kinds.get(path)), ""]
            path, given = tuple(header[1].split(".")), set()
            done.add(path[0])
            if path != ("end",):
                blocks.append(text_line)
        elif assignment:
            given.add(assignment[1])
            found = _entry(every, (*path, assignment[1]), kinds.get(path))
            whole = text_line.count("[") == text_line.count("]")  # it ends in its line
            if found is not None and not whole:
                blocks.append(f"# {_note(found)}")
            blocks.append(_beside(text_line, _note(found)) if found is not None and whole else text_line)
        else:
            blocks.append(text_line)
    blocks += _absent(every, path_names=set(_tables(text)))
    return "\n".join(blocks).rstrip() + "\n"


def _kinds(text: str, name: str) -> dict[tuple[str, ...], str]:
    """The kind (or geometry) of every table of a case."""
    data = parse_case(text, name, Path("."))
    found: dict[tuple[str, ...], str] = {}
    dumped = data.sections.model_dump()
    for path in _tables(text):
        node = dumped
        for part in path:
            node = node[part] if isinstance(node, dict) else node[-1][part]
        node = node[-1] if isinstance(node, list) else node
        kind = node.get("kind", node.get("geometry")) if isinstance(node, dict) else None
        if kind is not None:
            found[path] = kind
    return found


def _tables(text: str) -> list[tuple[str, ...]]:
    return [tuple(match[1].split(".")) for match in map(_TABLE.match, text.splitlines()) if match]


def _shape(path: tuple[str, ...]) -> tuple[str, ...]:
    """A key's path without indices."""
    return tuple(part for part in path if part != "N")


def _entry(every: list[Entry], real: tuple[str, ...], kind: str | None) -> Entry | None:
    fits = (e for e in every if matches(_shape(e.path), real) and (not e.kinds or kind in e.kinds))
    return next(fits, None)


def _note(entry: Entry) -> str:
    unit = f"{entry.unit}: " if entry.unit not in ("", "1") else ""
    choice = f"{entry.type}" if entry.path[-1] in ("kind", "geometry") else entry.meaning
    return f"{unit}{choice}"


def _beside(text_line: str, note: str) -> str:
    """A line with a note at its end, after the comment that it may have."""
    code, mark, comment = text_line.partition(" # ")
    return f"{code.rstrip():{_COLUMN}s} # {note}" + (f"; here {comment}" if mark else "")


def _optional(every: list[Entry], table: tuple[str, ...], given: set[str], kind: str | None) -> list[str]:
    """The table's other keys as comments."""
    own = [e for e in every if matches(_shape(e.path)[:-1], table)]
    fits = (e for e in own if e.path[-1] not in given and (not e.kinds or kind in e.kinds))
    return [_commented(e) for e in fits if e.example is not None and not e.required]


def _absent(every: list[Entry], path_names: set[tuple[str, ...]]) -> list[str]:
    """Tables that the demo has not, as comments with examples."""
    lines: list[str] = []
    for path in dict.fromkeys(e.path[:-1] for e in every if len(e.path) > 1 and e.example is not None):
        if any(matches(_shape(path), real) for real in path_names) or "material" in path:
            continue
        own = [e for e in every if e.path[:-1] == path and e.example is not None]
        kind = next((e.example for e in own if e.path[-1] == "kind"), None)
        title = ".".join(part for part in path if part != "N")
        lines += ["", f"# [[{title}]]" if path[-1:] == ("N",) else f"# [{title}]"]
        lines += [_commented(e) for e in own if not e.kinds or kind in e.kinds]
    return lines


def _commented(entry: Entry) -> str:
    """A key as a comment, with its default, or with the example where that is nothing."""
    value = entry.example if entry.default in (None, [], {}) else entry.default
    return _beside(f"# {entry.path[-1]} = {toml.value_text(value)}", _note(entry))
