"""Whom to blame: what ngvisco raises while a case is built, as faults of the case's keys."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import Any

from ngvisco.case.faults import (
    CaseError,
    Locator,
    given,
    has_key,
    in_case,
    names_in,
    refused,
    shown,
    tables_of,
)
from ngvisco.case.schema import CaseSections
from ngvisco.case.section import Section, owner_of, parameters
from ngvisco.errors import InitialDataError, MeshError, NgviscoError, ParameterError, UnknownNameError
from ngvisco.parallel.petsc import PETScError
from ngvisco.run.ranks import abort_alone


@dataclass(frozen=True)
class Blame:
    """Finds the keys of a case that errors speak of."""

    sections: CaseSections
    source: str
    locator: Locator

    def error(self, path: tuple[str, ...], message: str) -> CaseError:
        """The error of one fault, at a key path."""
        return CaseError(self.source, [self.locator.fault(path, in_case(message))])

    @contextmanager
    def located(self, *path: str) -> Iterator[None]:
        """Turn ngvisco's errors into faults of a section (or of the one that the error names)."""
        try:
            yield
        except (CaseError, PETScError):  # what the installation lacks is no fault of a section
            raise
        except ParameterError as error:
            key = key_of(error.field, path, self.sections, error.value)
            raise self.error(key, refused(self._written(key, error.value), error)) from error
        except UnknownNameError as error:
            where = (*_SECTION_OF_NAME.get(error.kind, path), error.name)
            key = (*path, "names") if error.kind == "subdomain" else where
            key = key_of(error.kind, path, self.sections) if "." in error.kind else key
            raise self.error(key, str(error)) from error
        except InitialDataError as error:
            material: Any = self.sections.material
            if error.field == "stored energy" and self._starts_at_rest and material is not None:
                names = ", ".join(parameters(material))
                message = f"its energy at rest is not finite: expected other values of {names}"
                raise self.error(("material",), message) from error
            key = self._initial_key(error.field, path)
            there = shown(self._written(key, error.field))
            start = f"{there}: at the start {error.value}; expected {error.expected}"
            raise self.error(key, str(error) if key[0] == "initial" else start) from error
        except MeshError as error:
            of_file = self.sections.domain.geometry == "file"  # type: ignore[attr-defined]
            raise self.error(("domain", "path") if of_file else ("domain",), str(error)) from error
        except NgviscoError as error:
            raise self.error(path, str(error)) from error
        except Exception as error:  # NGSolve and Netgen raise bare exceptions for what they refuse
            abort_alone(error)
            raise self.error(path, f"{type(error).__name__}: {error}") from error

    @property
    def _starts_at_rest(self) -> bool:
        initial: Any = self.sections.initial
        return initial.F is None and not initial.values

    def _initial_key(self, field: str, path: tuple[str, ...]) -> tuple[str, ...]:
        """The key to blame for start values: of a law's modulus, of one variable, of the state."""
        if re.fullmatch(r"[\w\['\].]+\.\w+", field):
            return key_of(field, path, self.sections)
        values: Any = self.sections.initial.values  # type: ignore[attr-defined]
        named = (("values", name) for name in values if re.search(rf"\b{re.escape(name)}(_0)?\b", field))
        known = ((key,) for word, key in _INITIAL_KEYS.items() if word in field)
        return ("initial", *next(chain(named, known), ()))

    def _written(self, key: tuple[str, ...], value: object) -> object:
        """What the file has under a key, or what was made of it."""
        there = given(self.sections, key)
        is_whole = there is None or (isinstance(there, list) and any(isinstance(p, Section) for p in there))
        return value if is_whole else there


def key_of(field: str, path: tuple[str, ...], sections: Any, value: object = None) -> tuple[str, ...]:
    """The key of a parameter that is named as in ``Gravity.g``, ``walls['top'].f`` or
    ``bodies['disc'].NeoHookean.K_e``.

    ``path`` is that of the section from which the object with the parameter was made; where several tables
    may be meant it is the one that has the ``value``.
    """
    owner, *rest = names_in(field)
    if owner in ("loads", "bodies"):
        names = [str(part.name) for part in getattr(sections, owner)]
        if not rest or rest[0] not in names:
            return path
        path, rest = (owner, str(names.index(rest[0]))), rest[1:]
        if len(rest) < 2:
            return (*path, *rest)
        owner, *rest = rest
    if owner == "Model":
        return (rest[0],) if rest[:1] in (["bodies"], ["loads"]) else ("rheology", *rest)
    if owner in _KEYS:
        return (*_KEYS[owner], *(() if owner in ("until", "stops") else rest))
    tables = [
        (*place, *rest)
        for place, part in tables_of(sections)
        if owner in (type(part).__name__, owner_of(type(part)).__name__)
    ]
    found = [key for key in tables if not rest or has_key(sections, key[: len(key) - len(rest) + 1])]
    near = [key for key in found if key[: len(path)] == path] or found
    exact = [key for key in near if value is not None and given(sections, key) == value]
    own = (*path, *rest)
    tables = [key[: len(key) - len(rest)] for key in tables]  # of what no key of theirs says
    return (exact or near or tables or [own if has_key(sections, own[: len(path) + 1]) else path])[0]


_KEYS: dict[str, tuple[str, ...]] = {
    "walls": ("walls",),
    "Simulation": ("time",),
    "until": ("time", "until"),
    "stops": ("time", "until"),
    "passive": ("output", "passive"),
}
"""Keys of what the parts of a simulation name in their errors, and what no table makes."""


_SECTION_OF_NAME = {
    "material variable": ("initial", "values"),
    "passive field": ("output", "passive"),
    "boundary": ("walls",),
    "wall": ("domain", "refine"),
}
_INITIAL_KEYS = {"rho_0": "density", "F_0": "F", "v_0": "velocity", "material variables": "values"}
