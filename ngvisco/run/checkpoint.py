"""The HDF5 file of a run, with ledger and checkpoints, which is replaced only by a complete file.

Layout::

    /                               attributes: format, ngvisco, mesh, spaces, material, bodies, energies (Pa,
                                    at fixed states, which identify an energy), scheme and the caller's
                                    attributes (``case``, the hash of a case file's physics)
    /ledger/<column>                one value a step, attribute ``unit``; the group's ``closed``: first step
                                    of each part of the run, and |closure_relative| up to which a part closes
    /<table>/<column>               one value a row, for observers with a ``group``, as ``bodies``
    /checkpoints/<step>/state       all coefficients of the step's space; attributes time (s), step,
                                    energy (J), mass (kg), initial_mass (kg), velocity_scale (m/s),
                                    wave_speed (m/s)
    /checkpoints/<step>/solver      the point where the Jacobian was factorised (attributes tau, end,
                                    loads_from, loads_over, loads_tilt, last_tau, factorised_by_split,
                                    directions_first, directions_beyond; data sets state, state_old), and
                                    the last two solutions, from which start values are extrapolated; empty
                                    without a factorisation.  States have zeros for unknowns that follow from
                                    the others
    /checkpoints/<step>/stepping    data for the choice of the next step: for fixed steps the origin of their
                                    count (attributes start, level), for adaptive ones the next length (dt),
                                    streak, last_error, and the states known_* of the error estimate
    /checkpoints/<step>/passive     coefficients of the run's passive fields, if any

The ledger and each checkpoint have the attribute ``checksum``, the SHA-256 of all their numbers: a file in
which a bit has changed is refused.

The file is made in memory, written under another name and renamed, so that the former file stays readable if
the run is killed or the disk is full.  A restarted run factorises the Jacobian at the point that the
checkpoint holds. Therefore its results equal those of an uninterrupted run bit for bit, on one machine and
with the same number of ranks, after an interruption at any step; ``ngvisco/parallel/NOTES.md`` says where
runs on ranks differ by rounding.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from types import NoneType
from typing import TYPE_CHECKING, Annotated

import h5py
import numpy as np

from ngvisco.errors import Declared, Quantity, require_file, require_numbers
from ngvisco.run.files import AnyPath, write_atomically
from ngvisco.run.ledger import Ledger, unit
from ngvisco.run.series import Every, Series
from ngvisco.run.snapshot import (
    CHECKSUM,
    CLOSURES,
    PARTS,
    ChosenMesh,
    Snapshot,
    digest_of,
    identity,
    load,
    opened,
    snapshot,
)

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

UNITS = (
    "time, tau, dt, end, loads_from, loads_over, *_time, known_*: s; energy: J; mass: kg; "
    "velocity_scale, wave_speed: m/s (per metre in plane strain)"
)
"""Units of the checkpoints' attributes, as the file lists them; units of the ledger stand at its columns."""


class Checkpoints:
    """Writes the run's HDF5 file every so many steps and at the end.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    path : path
        The file, e.g. ``results/run.h5``.
    every : int
        A checkpoint every so many steps, and at the end.
    keep : int
        Number of checkpoints that the file keeps.
    attributes : mapping, optional
        Further attributes of the file, e.g. the hash of a case.
    """

    def __init__(
        self,
        path: AnyPath,
        every: Every = 10,
        keep: Annotated[int, Quantity("1", ">= 1")] = 2,
        attributes: Mapping[str, str] | None = None,
    ) -> None:
        require_numbers("Checkpoints", ">= 1", int, every=every, keep=keep)
        self.path = require_file("Checkpoints.path", path)
        self.every, self.keep = int(every), int(keep)
        texts = Declared("", (Mapping[str, str], NoneType))
        self.attributes = dict(texts.taken("Checkpoints.attributes", attributes) or {})
        self.chosen: ChosenMesh | None = None
        """The mesh of the present state; None for the run's first mesh."""
        self._kept: dict[int, Snapshot] = {}

    def start(self, simulation: Simulation) -> None:
        self._kept = {}
        if simulation.ranks.is_first and simulation.number > 0 and self.path.exists():
            with opened(self.path) as file:
                earlier = {int(name): load(self.path, group) for name, group in file["checkpoints"].items()}
            # states before step ``since`` are on another mesh
            since = 0 if self.chosen is None else self.chosen.step
            self._kept = {n: kept for n, kept in earlier.items() if since <= n < simulation.number}
        self._write(simulation)

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        # a part of a halved step counts as a step, since a part takes as long to compute as a step
        if simulation.number % self.every == 0:
            self._write(simulation)

    def finish(self, simulation: Simulation) -> None:
        if simulation.number not in self._kept:
            self._write(simulation)

    def _write(self, simulation: Simulation) -> None:
        kept = {**self._kept, simulation.number: snapshot(simulation, simulation.interruption.parts())}
        kept = {number: kept[number] for number in sorted(kept)[-self.keep :]}
        if simulation.ranks.is_first:
            write_atomically(self.path, self._image(simulation, kept))
        self._kept = kept  # set after writing: if writing fails, the end of the run tries again

    def _image(self, simulation: Simulation, kept: Mapping[int, Snapshot]) -> bytes:
        image = io.BytesIO()
        with h5py.File(image, "w") as file:
            file.attrs.update(identity(simulation) | self.attributes | {"units": UNITS})
            if self.chosen is not None:
                content = np.frombuffer(self.chosen.image, dtype=np.uint8)
                file.create_dataset("mesh", data=content, compression="gzip").attrs["step"] = self.chosen.step
            group = file.create_group("ledger")
            _store_table(group, simulation.ledger, unit)
            group.attrs[CLOSURES] = simulation.ledger.limits
            group.attrs[CHECKSUM] = digest_of({}, {name: np.array(data) for name, data in group.items()})
            for observer in simulation.observers:
                if isinstance(observer, Series) and observer.group is not None and observer.group not in file:
                    _store_table(file.create_group(observer.group), observer, observer.unit)
            for number, snapshot in kept.items():
                _store(file.create_group(f"checkpoints/{number:08d}"), snapshot)
        return image.getvalue()


def _store_table(group: h5py.Group, table: Series | Ledger, unit: Callable[[str], str]) -> None:
    for column in table.columns:
        group.create_dataset(column, data=table.column(column)).attrs["unit"] = unit(column)


def _store(group: h5py.Group, snapshot: Snapshot) -> None:
    group.attrs[CHECKSUM] = snapshot.checksum
    for name in PARTS:
        part, (numbers, arrays) = group.require_group(name) if name else group, snapshot.part(name)
        part.attrs.update(numbers)
        for key, array in arrays.items():
            part.create_dataset(key, data=array)
