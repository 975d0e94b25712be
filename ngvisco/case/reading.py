"""Reading of a case file: overrides, numbers from files, SI units, and validation as sections."""

import tomllib
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ngvisco.case import toml
from ngvisco.case.faults import CaseError, Fault, Locator, faults_of
from ngvisco.case.schema import CaseSections
from ngvisco.case.section import nodes
from ngvisco.case.units import SI, Converter, has_unit
from ngvisco.errors import InputWarning

MAX_FILE_SIZE = 1_000_000


def text_of(path: Path) -> str:
    """The text of a case file; raises CaseError."""
    locator = Locator({}, source=str(path))
    if path.exists() and not (path.is_file() or path.is_dir()):  # reading from a pipe would wait for a writer
        raise locator.error((), "this is a pipe or a device; expected a file")
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_FILE_SIZE + 1)
    except OSError as error:
        raise locator.error((), f"the file cannot be read: {error.strerror}") from error
    if len(raw) > MAX_FILE_SIZE:
        raise locator.error((), f"the file is longer than {MAX_FILE_SIZE} bytes")
    try:
        return raw.decode("utf-8-sig")  # some editors begin a file with a mark of the byte order
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise CaseError(str(path), [Fault("", "the file is not text in UTF-8", line)]) from error


def sections_of(text: str, source: str, directory: Path, settings: Sequence[str]) -> Locator:
    """The locator with the sections of a case file's text; raises CaseError with every fault."""
    locator, overridden = Locator({}, source=source), []
    try:
        data = tomllib.loads(text)
    except ValueError as error:  # Python also refuses a number of thousands of digits
        raise locator.error((), f"the file is not TOML: {error}") from error
    except RecursionError as error:
        raise locator.error((), "the file is not TOML: the tables are nested too deeply") from error
    for setting in settings:
        try:
            path, value = toml.parse_override(setting)
            toml.override(data, path, value)
        except ValueError as error:
            raise locator.error((), f"the command line's {error}") from error
        overridden.append(path)
    locator = Locator(toml.key_lines(text), overridden, source, data)
    try:
        converter = Converter(data.get("units"), directory)
        locator.converted = converter.converted
        if converter.faults:
            raise CaseError(source, [locator.fault(*fault) for fault in converter.faults])
        if converter.scales:  # the schema refuses the remaining keys
            kept = {name: u for name, u in data["units"].items() if name not in SI or not isinstance(u, str)}
            data = data | {"units": kept}
        locator.sections = CaseSections.model_validate(data, context=converter)
    except ValidationError as error:
        raise CaseError(source, faults_of(error, CaseSections, locator)) from error
    except RecursionError as error:
        raise locator.error((), "the tables are nested too deeply") from error
    units = [name for name in ("length", "time") if name in converter.scales]
    if units and "velocity" not in converter.scales and (keys := list(plain_velocities(locator.data))):
        units_in = " and ".join(f"{name} in {locator.data['units'][name]}" for name in units)
        message = (
            f"[units] has {units_in}, but velocities without a unit are in m/s; to change this, set "
            f"units.velocity. There are such velocities in {', '.join(keys)}"
        )
        warnings.warn(message, InputWarning, stacklevel=3)
    return locator


def plain_velocities(data: Any) -> Iterator[str]:
    """Yield keys of a case whose values are nonzero velocities without a unit."""
    for path, value in nodes(data):
        if path[-1:] in (("velocity",), ("velocity_scale",)) and path[0] != "units":
            parts = value if isinstance(value, list) else [value]
            if any(part != 0 and not has_unit(part) for part in parts):
                yield ".".join(path)
