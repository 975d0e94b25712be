"""Materials from a Python file that a case file names, the only code that a case executes."""

import functools
import hashlib
import inspect
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Annotated

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.material import Material

KIND = "Python"
"""The kind, in the catalogue, of materials from Python files."""


def python_material(
    path: Annotated[str, Quantity(example="gel.py")],
    law: Annotated[str, Quantity(example="Gel")],
    parameters: Annotated[Mapping[str, float] | None, Quantity("any", example={"K": 10.0})] = None,
) -> Material:
    """A custom material, made by a class or function of a Python file, which the case executes.

    Raises ParameterError for a file that cannot be read or executed, a missing name, a result that is no
    material, and parameters that the class or function does not take or refuses.

    Parameters
    ----------
    path : str
        The Python file, relative to the case file; a run directory has a copy.
    law : str
        Name, in the file, of a class derived from ngvisco.Material or of a function that returns a material.
    parameters : mapping of names to numbers, optional
        Arguments of the class or function, in SI units.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        expected = f"a Python file that can be read, but {Path(path).name} cannot be read: {error.strerror}"
        raise ParameterError(f"{KIND}.path", path, expected) from error
    module, arguments = _module(path, content), dict(parameters or {})
    target = getattr(module, law, None)
    if not callable(target):
        named = vars(module).items()
        names = (n for n, v in named if callable(v) and getattr(v, "__module__", "") == module.__name__)
        file, known = Path(path).name, ", ".join(names) or "none"
        expected = f"the name of a class or function of {file} that makes a material; {file} has {known}"
        raise ParameterError(f"{KIND}.law", law, expected)
    try:
        inspect.signature(target).bind(**arguments)
    except TypeError as error:
        expected = f"arguments that fit {law}{inspect.signature(target)}; {error}"
        raise ParameterError(f"{KIND}.parameters", arguments, expected) from error
    try:
        material = target(**arguments)
    except ParameterError as error:
        key = error.field.rpartition(".")[2]
        field = f"{KIND}.parameters.{key}" if key in arguments else f"{KIND}.law"
        raise ParameterError(field, arguments.get(key, law), error.expected) from error
    if not isinstance(material, Material):
        expected = f"a class or function that makes an ngvisco.Material, not a {type(material).__name__}"
        raise ParameterError(f"{KIND}.law", law, expected)
    return material


@functools.cache
def _module(path: str, content: bytes) -> ModuleType:
    """The module of an executed file; equal contents are executed once, so that classes are identical."""
    module = ModuleType(f"case_{hashlib.sha256(content).hexdigest()[:16]}")
    module.__file__ = path
    sys.modules[module.__name__] = module  # dataclasses look up annotations' names here
    try:
        exec(compile(content, path, "exec"), module.__dict__)
    except Exception as error:  # a user's file may raise any error
        expected = (
            f"a Python file that runs without error, but this file raises {type(error).__name__}: {error}"
        )
        raise ParameterError(f"{KIND}.path", path, expected) from error
    return module
