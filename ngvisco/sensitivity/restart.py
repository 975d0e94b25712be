"""The folder from which an interrupted gradient goes on: steps of the run, and the state of its derivatives.

Each part is an HDF5 file with a checksum, written whole or not at all.  The files of a step are written once,
so that the folder grows with the number of steps; the file of the derivatives' state is replaced.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from ngsolve import CoefficientFunction, GridFunction

from ngvisco.errors import CheckpointError, require_path
from ngvisco.forms.context import time
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.run.files import AnyPath, write_atomically
from ngvisco.run.simulation import Simulation
from ngvisco.run.snapshot import CHECKSUM, digest_of, identity, opened
from ngvisco.sensitivity.columns import arguments_of, tables_of

_CASE = "case"
"""Part of the folder that identifies its run and its derivatives."""
_MOMENTS = (0.0, 0.37, 1.0)
"""Times, s, at which functions of time are evaluated."""
_SAME = 1e-9
"""Relative difference of start states below which they are equal: threads change the order of sums."""

Kept = tuple[dict[str, float], dict[str, np.ndarray]]
"""Numbers and arrays of a part, by name."""


@dataclass(frozen=True)
class Restart:
    """A folder of parts, each with numbers and arrays."""

    folder: Path

    @classmethod
    def at(cls, folder: AnyPath, simulation: Simulation, request: Mapping[str, Any]) -> Restart:
        """The folder for a run from its present state and for a ``request``.  A missing folder is made.

        The run's mesh and energies are identified as those of a checkpoint, its tables by their arguments.
        Raises CheckpointError if the folder belongs to another run or request; the
        message says which part differs.
        """
        restart = cls(require_path("restart", folder))
        parts = {"model": simulation.model, **simulation.arguments, **request, "step": simulation.number}
        parts["tables"] = [arguments_of(table) for table in tables_of(simulation)]
        parts |= {name: identity(simulation)[name] for name in ("ngvisco", "mesh", "energies")}
        described = {name: signature(part, simulation.sampler) for name, part in parts.items()}
        digests = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in described.items()}
        start = simulation.rothe_step.state.vec.FV().NumPy()
        place = restart.path(_CASE)
        if not place.exists():
            restart.keep(_CASE, {}, {"start": start}, digests)
            return restart
        with opened(place) as file:
            kept = {name: file.attrs.get(name) for name in digests}
        differing = [name for name, value in digests.items() if kept[name] != value]
        there = restart.require(_CASE)[1]["start"]
        if not differing and (
            there.shape != start.shape or abs(there - start).max() > _SAME * abs(there).max(initial=0)
        ):
            differing = ["start"]
        if differing:
            differ = f"another {', '.join(differing)}"
            raise CheckpointError(
                f"{restart.folder}: the folder belongs to a gradient or fit with {differ}; repeat that "
                "call, or take a new folder"
            )
        return restart

    def path(self, name: str) -> Path:
        """Path of a part's file."""
        return self.folder / f"{name}.h5"

    def keep(
        self,
        name: str,
        numbers: Mapping[str, float],
        arrays: Mapping[str, np.ndarray],
        attributes: Mapping[str, str] | None = None,
    ) -> None:
        """Write a part; after an error the part is as before."""
        image = io.BytesIO()
        with h5py.File(image, "w") as file:
            for key, number in numbers.items():
                file.attrs[key] = float(number)
            file.attrs.update({**(attributes or {}), CHECKSUM: digest_of(numbers, arrays)})
            for key, array in arrays.items():
                file.create_dataset(key, data=array)
        write_atomically(self.path(name), image.getvalue())

    def read(self, name: str) -> Kept | None:
        """The numbers and arrays of a part; None if the part does not exist.  Raises CheckpointError for a
        damaged file."""
        return self.require(name) if self.path(name).exists() else None

    def require(self, name: str) -> Kept:
        """The numbers and arrays of a part; raises CheckpointError if the part is missing or damaged."""
        with opened(self.path(name)) as file:
            texts = {k: v for k, v in file.attrs.items() if isinstance(v, str)}
            numbers = {k: float(v) for k, v in file.attrs.items() if k not in texts}
            arrays = {key: np.array(data) for key, data in file.items()}
            if texts.get(CHECKSUM) != digest_of(numbers, arrays):
                raise CheckpointError(
                    f"{self.path(name)}: the file is damaged, since its checksum differs; take a new folder"
                )
        return numbers, arrays


def signature(value: object, sampler: Sampler) -> str:
    """A text that identifies numbers, options, and functions of place and time.

    Functions of place and time are described by their values at a mesh's points at three times; functions
    without such values by their expressions, and functions in Python by their names.
    """

    def described(part: object) -> str:
        return signature(part, sampler)

    if isinstance(value, GridFunction):
        return f"{value.space.type}{digest_of({}, {'': value.vec.FV().NumPy()})}"
    if isinstance(value, CoefficientFunction):
        return _described_by_values(value, sampler)
    if isinstance(value, np.ndarray):
        return digest_of({}, {"": value})
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {described(part)}' for key, part in value.items())}}}"
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        return f"[{', '.join(map(described, value))}]"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = (f"{f.name}={described(getattr(value, f.name))}" for f in dataclasses.fields(value))
        return f"{type(value).__qualname__}({', '.join(parts)})"
    if isinstance(value, (str, bytes, int, float, complex, type(None), np.generic, os.PathLike)):
        return repr(value)
    return str(getattr(value, "__qualname__", type(value).__qualname__))


def _described_by_values(function: CoefficientFunction, sampler: Sampler) -> str:
    """A function's expression, and a digest of its values."""
    before, values = time.Get(), {}
    try:
        for moment in _MOMENTS:
            time.Set(moment)
            values[f"{moment}"] = sampler.values(function)
    except Exception:  # NGSolve raises many kinds where a function has no values in cells
        return str(function)
    finally:
        time.Set(before)
    return f"{function}{digest_of({}, values)}"
