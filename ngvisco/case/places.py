"""The places of a case's bodies: shapes from sections, and the files that some of them are in."""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from ngvisco.case.faults import CaseError, Fault
from ngvisco.case.section import Section, owner_of, parameters, values_of
from ngvisco.case.values import FieldValue, ModulusValue
from ngvisco.expressions import Expression, parse, parse_region
from ngvisco.shapes.shape import Shape, Union, Where


def united(shapes: Sequence[Shape]) -> Shape | None:
    """The shape of several; None of none."""
    return shapes[0] if len(shapes) == 1 else Union(shapes) if shapes else None


def parts_of(where: Any) -> list[tuple[tuple[str, ...], Any]]:
    """What ``where`` is the union of, with the rest of the key paths."""
    if isinstance(where, list):
        return [((str(i),), part) for i, part in enumerate(where)]
    return [] if where is None else [((), where)]


def shape_of(part: Any, directory: Path) -> Shape:
    """The shape of a condition or of a table."""
    if isinstance(part, str):
        return Where(parse_region(part).coefficient())
    values = parameters(part)
    if "path" in values:
        values["path"] = str((directory / values["path"]).resolve())
    shape: Shape = owner_of(type(part))(**values)
    return shape


def shapes_with_files(data: dict[str, Any], directory: Path) -> list[tuple[dict[str, Any], Path]]:
    """Of a dump of a case the shapes that have a file, and these."""
    found = []
    for body in data.get("bodies", []):
        where = body.get("where")
        for table in where if isinstance(where, list) else [where]:
            if isinstance(table, dict) and "path" in table:
                found.append((table, (directory / table["path"]).resolve()))
    return found


def digest_of(file: Path) -> str:
    """SHA-256 of a file's content; raises CaseError where there is none."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError as error:
        raise CaseError(str(file), [Fault("", f"cannot be read: {error.strerror}")]) from error


def copy_of(file: Path) -> str:
    """The name of a shape's file in a run directory, which has copies of them."""
    return f"shapes/{digest_of(file)[:16]}{file.suffix.lower()}"


def reads_z(
    part: Any, path: tuple[str, ...] = (), parsed: Callable[[str], Expression] | None = None
) -> tuple[tuple[str, ...], str] | None:
    """Key path and text of a function of the place, or of a body's place, that reads z; None where none does.

    ``parsed`` makes an expression of a text that is such a function; None where a text is none.
    """
    inner: Iterable[tuple[Any, Any, Any]] = ()
    if isinstance(part, str):
        return (path, part) if parsed is not None and "z" in parsed(part).names else None
    if isinstance(part, Section):
        values = values_of(type(part)).items()
        of_place: dict[str, Callable[[str], Expression]] = {"where": parse_region}
        of_place |= {name: parse for name, value in values if issubclass(value, (FieldValue, ModulusValue))}
        inner = ((name, getattr(part, name), of_place.get(name)) for name in type(part).model_fields)
    elif isinstance(part, (list, dict)):
        items = part.items() if isinstance(part, dict) else enumerate(part)
        inner = ((name, value, parsed) for name, value in items)
    found = (reads_z(value, (*path, str(name)), how) for name, value, how in inner)
    return next((one for one in found if one is not None), None)
