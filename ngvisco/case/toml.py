"""TOML: line numbers of keys, overrides by key path, and a writer for resolved cases."""

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

_KEY = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_PATH = rf"{_KEY}(?:\s*\.\s*{_KEY})*"
_HEADER = re.compile(rf"^\s*\[(\[)?\s*({_PATH})\s*\]")
_ASSIGNMENT = re.compile(rf"^\s*({_PATH})\s*=")
_INLINE = re.compile(rf"[{{,]\s*({_KEY})\s*=")


def key_lines(text: str) -> dict[tuple[str, ...], int]:
    """Line numbers of tables and keys by path; members of arrays of tables have their index in the path."""
    lines: dict[tuple[str, ...], int] = {}
    counts: dict[tuple[str, ...], int] = {}
    table: tuple[str, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        header, assignment = _HEADER.match(line), _ASSIGNMENT.match(line)
        if header:
            table = _split(header[2])
            if header[1]:
                table = (*_indexed(table[:-1], counts), table[-1])
                counts[table] = counts.get(table, -1) + 1
                lines.setdefault(table, number)
                table = (*table, str(counts[table]))
            else:
                table = _indexed(table, counts)
            lines.setdefault(table, number)
        elif assignment:
            path = (*table, *_split(assignment[1]))
            lines.setdefault(path, number)
            for inline in _INLINE.finditer(line):
                lines.setdefault((*path, *_split(inline[1])), number)
    return lines


def _indexed(table: tuple[str, ...], counts: dict[tuple[str, ...], int]) -> tuple[str, ...]:
    """The table's path with indices of arrays: [loads.x] after [[loads]] belongs to the last load."""
    path: tuple[str, ...] = ()
    for part in table:
        path = (*path, part)
        if path in counts:
            path = (*path, str(counts[path]))
    return path


def _split(path: str) -> tuple[str, ...]:
    return tuple(part.strip("\"'") for part in re.findall(_KEY, path))


def line_of(lines: Mapping[tuple[str, ...], int], path: tuple[str, ...]) -> int | None:
    """The line of a key, or of the nearest table around it."""
    for length in range(len(path), 0, -1):
        if path[:length] in lines:
            return lines[path[:length]]
    return None


def parse_override(setting: str) -> tuple[tuple[str, ...], Any]:
    """Key path and value of ``key.path=value``; ``a[0]`` means ``a.0``.  A value that is not TOML is a text.

    Raises ValueError if there is no ``=`` or no key.
    """
    name, equals, value = setting.partition("=")
    path = tuple(part.strip() for part in re.sub(r"\[(\d+)\]", r".\1", name).split("."))
    if not equals or not all(path):
        raise ValueError(f"{setting!r}: expected key.path=value")
    try:
        return path, tomllib.loads(f"value = {value.strip()}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        if re.fullmatch(r"[+-]?(\d+\.|\.\d+)(e[+-]?\d+)?", value.strip(), re.ASCII | re.IGNORECASE):
            return path, float(value)  # TOML wants digits on both sides of a point
        return path, value.strip()


def override(data: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    """Set a value in nested tables, and make missing tables; a path enters an array by an index.

    Raises ValueError if the path leads through a value that is no table, or to an index that does not exist.
    """
    node: Any = data
    for depth, part in enumerate(path):
        where = ".".join(path[: depth + 1])
        key: Any = part
        if isinstance(node, list):
            if not (part.isascii() and part.isdigit() and int(part) < len(node)):
                raise ValueError(f"{where}: expected an index below {len(node)}")
            key = int(part)
        elif not isinstance(node, dict):
            raise ValueError(f"{where}: {'.'.join(path[:depth])} is not a table")
        if depth == len(path) - 1:
            node[key] = value
        else:
            node = node[key] if isinstance(node, list) else node.setdefault(key, {})


def write(data: dict[str, Any]) -> str:
    """The TOML text of nested tables of numbers, texts, booleans and arrays; keys with None are left out."""
    lines: list[str] = []
    _write_table(data, (), lines)
    return "\n".join(lines).lstrip("\n") + "\n"


def _write_table(table: dict[str, Any], path: tuple[str, ...], lines: list[str]) -> None:
    inner = {key: value for key, value in table.items() if isinstance(value, dict)}
    arrays = {
        key: value
        for key, value in table.items()
        if isinstance(value, list) and value and all(isinstance(part, dict) for part in value)
    }
    for key, value in table.items():
        if value is not None and key not in inner and key not in arrays:
            lines.append(f"{_key(key)} = {value_text(value)}")
    for key, value in inner.items():
        lines += ["", f"[{'.'.join(map(_key, (*path, key)))}]"]
        _write_table(value, (*path, key), lines)
    for key, members in arrays.items():
        for member in members:
            lines += ["", f"[[{'.'.join(map(_key, (*path, key)))}]]"]
            _write_table(member, (*path, key), lines)


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _text(key)


def value_text(value: Any) -> str:
    """The TOML text of a value; a table is written in one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(value_text(v) for v in value)}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{_key(k)} = {value_text(v)}' for k, v in value.items() if v is not None)} }}"
    return _text(str(value))


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
