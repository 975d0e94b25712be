"""The HDF5 file of a run: ledger and checkpoints, always complete under its name.

Layout::

    /                               attributes: format, ngvisco, mesh, spaces, material, bodies, energies (Pa,
                                    at fixed states, by which an energy is known again), scheme and any that
                                    the caller adds (``case``, the hash of a case file's physics)
    /ledger/<column>                one value a step, attribute ``unit``; the group's ``closed``: the first
                                    steps of the run's parts, and up to which |closure_relative| each closes
    /<table>/<column>               of the observers that have a ``group``, as ``bodies``, one value a row
    /checkpoints/<step>/state       all coefficients of the step's space; attributes time (s), step,
                                    energy (J), mass (kg), initial_mass (kg), velocity_scale (m/s)
    /checkpoints/<step>/solver      where the Jacobian was factorised (attributes tau, end, loads_from,
                                    loads_over, loads_tilt, last_tau; data sets state, state_old), and the
                                    last two solutions, which start values are extrapolated from; empty for
                                    none
    /checkpoints/<step>/stepping    what the choice of the next step depends on: of fixed steps where they are
                                    counted from (attributes start, level), of adaptive ones the next length
                                    (dt), streak, last_error, and the states known_* of the error estimate
    /checkpoints/<step>/passive     coefficients of the run's passive fields, if any

The ledger and each checkpoint have the attribute ``checksum``, the SHA-256 of all their numbers: a file in
which a bit has changed is refused.

The file is made in memory, written beside and renamed, so that a kill or a full disk at any moment
leaves the last one readable.  A restart factorises the Jacobian where the run had done so, and goes
on bit for bit as that run (on one machine, over as many ranks), at whatever step it was interrupted;
``ngvisco/parallel/NOTES.md`` says where ranks leave a difference of rounding.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib.metadata
import io
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from ngsolve import Mesh

from ngvisco.errors import CheckpointError, require_count, require_file, require_path
from ngvisco.forms.mesh.mesh_arrays import coordinates, vertices
from ngvisco.physics.bodies import AMOUNT, Amount, Body
from ngvisco.physics.material import Material
from ngvisco.physics.pointwise import sampled_energies
from ngvisco.run.files import AnyPath, write_atomically
from ngvisco.run.ledger import Balance, Ledger, unit
from ngvisco.run.series import Series

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

UNITS = (
    "time, tau, dt, end, loads_from, loads_over, *_time, known_*: s; energy: J; mass: kg; "
    "velocity_scale: m/s (per metre in plane strain)"
)
"""Units of the checkpoints' attributes, as the file names them; units of the ledger stand at its columns."""
_WHOLE = ("step", "newton_iterations", "rejections", "limited_cells", "passive_unsolved")
"""Ledger columns of whole numbers."""
_CHECKSUM, _CLOSED = "checksum", "closed"
FORMAT = 5
"""The version of the format of a run's file."""
_PARTS = ("", "solver", "stepping", "passive")


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """One checkpoint: numbers and arrays under their names in its group, as ``/time`` and ``solver/tau``."""

    numbers: dict[str, float]
    arrays: dict[str, np.ndarray]

    @property
    def checksum(self) -> str:
        """SHA-256 of all of it."""
        return _digest(self.numbers, self.arrays)

    @property
    def balance(self) -> Balance:
        return Balance(
            **{field.name: self.numbers[f"/{field.name}"] for field in dataclasses.fields(Balance)}
        )

    def part(self, name: str) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """The numbers and arrays of its own group, ``""``, or of one within it, by their names there."""
        numbers = {k.removeprefix(f"{name}/"): v for k, v in self.numbers.items() if k.startswith(f"{name}/")}
        arrays = {k.removeprefix(f"{name}/"): v for k, v in self.arrays.items() if k.startswith(f"{name}/")}
        return numbers, arrays


@dataclasses.dataclass(frozen=True)
class ChosenMesh:
    """A mesh that a run came to: a .vol file's content, and the number of the state that chose it."""

    image: bytes
    step: int


class Checkpoints:
    """Writes the run's HDF5 file every so many steps and at the end.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    path : path
        E.g. ``results/run.h5``.
    every : int
        Steps between checkpoints.
    keep : int
        How many checkpoints the file holds, the latest ones.
    attributes : mapping, optional
        Further attributes of the file, e.g. the hash of a case.
    """

    def __init__(
        self, path: AnyPath, every: int = 10, keep: int = 2, attributes: Mapping[str, str] | None = None
    ) -> None:
        require_count("Checkpoints", every=every, keep=keep)
        self.path = require_file("Checkpoints.path", path)
        self.every, self.keep = int(every), int(keep)
        self.attributes = dict(attributes or {})
        self.chosen: ChosenMesh | None = None
        """The mesh of the present state where that is not the run's first one."""
        self._kept: dict[int, Snapshot] = {}

    def start(self, simulation: Simulation) -> None:
        self._kept = {}
        if simulation.ranks.is_first and simulation.number > 0 and self.path.exists():
            with _opened(self.path) as file:
                earlier = {int(name): _load(self.path, of) for name, of in file["checkpoints"].items()}
            since = 0 if self.chosen is None else self.chosen.step  # states before are of another mesh
            self._kept = {n: kept for n, kept in earlier.items() if since <= n < simulation.number}
        self._write(simulation)

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        if simulation.number % self.every == 0:  # parts of a halved step count: its time is not to be lost
            self._write(simulation)

    def finish(self, simulation: Simulation) -> None:
        if simulation.number not in self._kept:
            self._write(simulation)

    def _write(self, simulation: Simulation) -> None:
        kept = {**self._kept, simulation.number: snapshot(simulation)}
        kept = {number: kept[number] for number in sorted(kept)[-self.keep :]}
        if simulation.ranks.is_first:
            write_atomically(self.path, self._image(simulation, kept))
        self._kept = kept  # not before it is written: else the end of the run would not try again

    def _image(self, simulation: Simulation, kept: Mapping[int, Snapshot]) -> bytes:
        image = io.BytesIO()
        with h5py.File(image, "w") as file:
            file.attrs.update(_identity(simulation) | self.attributes | {"units": UNITS})
            if self.chosen is not None:
                content = np.frombuffer(self.chosen.image, dtype=np.uint8)
                mesh = file.create_dataset("mesh", data=content, compression="gzip")
                mesh.attrs["step"] = self.chosen.step
            group = file.create_group("ledger")
            _store_table(group, simulation.ledger, unit)
            group.attrs[_CLOSED] = simulation.ledger.limits
            group.attrs[_CHECKSUM] = _digest({}, {name: np.array(data) for name, data in group.items()})
            for observer in simulation.observers:
                if isinstance(observer, Series) and observer.group is not None and observer.group not in file:
                    _store_table(file.create_group(observer.group), observer, observer.unit)
            for number, one in kept.items():
                _store(file.create_group(f"checkpoints/{number:08d}"), one)
        return image.getvalue()


def _store_table(group: h5py.Group, table: Series | Ledger, unit: Callable[[str], str]) -> None:
    for column in table.columns:
        data = group.create_dataset(column, data=table.column(column))
        data.attrs["unit"] = unit(column)


def _store(group: h5py.Group, one: Snapshot) -> None:
    group.attrs[_CHECKSUM] = one.checksum
    for name in _PARTS:
        part, (numbers, arrays) = group.require_group(name) if name else group, one.part(name)
        part.attrs.update(numbers)
        for key, array in arrays.items():
            part.create_dataset(key, data=array)


def _load(path: Path, group: h5py.Group) -> Snapshot:
    one = Snapshot({}, {})
    for name in _PARTS:
        part = group[name] if name else group
        one.numbers.update({f"{name}/{k}": float(v) for k, v in part.attrs.items() if k != _CHECKSUM})
        arrays = {f"{name}/{k}": np.array(v) for k, v in part.items() if isinstance(v, h5py.Dataset)}
        one.arrays.update(arrays)
    _verify(path, group, one.checksum)
    return one


def _digest(numbers: Mapping[str, float], arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name, value in sorted(numbers.items()):
        digest.update(f"{name}={float(value).hex()};".encode())
    for name, array in sorted(arrays.items()):
        digest.update(f"{name}:{array.dtype.str}{array.shape};".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _verify(path: Path, group: h5py.Group, checksum: str) -> None:
    """Raise CheckpointError unless the group's checksum is this one."""
    found = group.attrs.get(_CHECKSUM)
    if found != checksum:
        what = "has no checksum" if found is None else "is damaged (its checksum differs)"
        raise CheckpointError(f"{path}: {group.name.lstrip('/')} {what}; go on from another copy of the file")


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """A run's file; raises CheckpointError where there is none, or it is damaged."""
    if not path.exists():
        raise CheckpointError(f"{path}: no such file")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except CheckpointError:
        raise
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as error:  # h5py's, by what is damaged
        raise CheckpointError(f"{path}: not a readable run file ({error})") from error


def mesh_of_checkpoints(path: AnyPath) -> ChosenMesh | None:
    """The mesh of a run's states where it is not the run's first one.

    Raises CheckpointError if the file cannot be read.
    """
    with _opened(require_path("mesh_of_checkpoints.path", path)) as file:
        if "mesh" not in file:
            return None
        return ChosenMesh(file["mesh"][()].tobytes(), int(file["mesh"].attrs["step"]))


def snapshot(simulation: Simulation) -> Snapshot:
    """A copy of all that a restart needs, in the numbering of one process; on the first rank, collective."""
    balance = simulation.ledger.balance
    assert balance is not None
    numbers = {"time": simulation.t, "step": simulation.number, "velocity_scale": simulation.velocity_scale}
    parts: dict[str, tuple[dict[str, float], dict[str, np.ndarray]]] = {
        "": (
            numbers | dataclasses.asdict(balance),
            {"state": simulation.rothe_step.state.vec.FV().NumPy().copy()},
        ),
        **simulation.interruption.parts(),
        "passive": ({}, simulation.passive.arrays()),
    }
    arrays = {f"{part}/{name}": array for part, (_, own) in parts.items() for name, array in own.items()}
    return Snapshot(
        {f"{part}/{name}": number for part, (own, _) in parts.items() for name, number in own.items()},
        {name: simulation.numbering.whole(array, name) for name, array in arrays.items()},
    )


def take_up(
    simulation: Simulation,
    path: AnyPath,
    step: int | None = None,
    attributes: Mapping[str, str] | None = None,
    may_differ: Collection[str] = (),
) -> tuple[Snapshot, list[dict[str, float]], list[tuple[int, float]]]:
    """Give a simulation the state and passive fields of a checkpoint; that, the ledger's rows, their limits.

    Collective.  ``may_differ`` names parts of what a run is known by; where there are some, the rows have the
    file's columns, and the run's otherwise.  Raises CheckpointError as
    ``Simulation.restore``.
    """
    path = require_path("restore.path", path)
    ledger, ranks, numbering = simulation.ledger, simulation.ranks, simulation.numbering
    read: list[Snapshot] = []

    def read_all() -> tuple[Any, ...]:
        own = {name: value for name, value in _identity(simulation).items() if name not in may_differ}
        one = _read_checkpoint(path, own | dict(attributes or {}), step)
        size, expected = one.arrays["/state"].size, simulation.unknowns
        if size != expected:
            raise CheckpointError(f"{path}: the state has {size} coefficients, not {expected}")
        read.append(one)
        number, found = int(one.numbers["/step"]), read_ledger(path)
        names = list(found) if may_differ else [*ledger.columns, *ledger.foreign(found)]
        rows = [row for row in _rows(path, found, names) if row["step"] <= number]
        if [row["step"] for row in rows] != list(range(number + 1)):
            raise CheckpointError(f"{path}: its ledger has not the rows of steps 0 to {number}")
        with _opened(path) as file:  # one of before has no limits: they are this run's
            limits = [(int(first), float(limit)) for first, limit in file["ledger"].attrs.get(_CLOSED, ())]
        return one.numbers, list(one.arrays), names, rows, limits

    numbers, arrays, names, rows, limits = ranks.on_first(read_all)
    whole = read[0].arrays if read else {}
    own = {name: numbering.own(whole.get(name), name) for name in arrays if numbering.knows(name)}
    one = Snapshot(numbers, own)
    simulation.passive.load(one.part("passive")[1])
    simulation.rothe_step.state.vec.FV().NumPy()[:] = one.arrays["/state"]
    ledger.keep(names)
    return one, rows, limits


def _read_checkpoint(path: Path, expected: dict[str, Any], step: int | None) -> Snapshot:
    """One checkpoint, by default the last, of a file that has the expected attributes."""
    with _opened(path) as file:
        for name, value in expected.items():
            found = file.attrs.get(name)
            if name != "ngvisco" and found != value:
                found = found.item() if isinstance(found, np.generic) else found
                verb = "are" if name in ("bodies", "energies") else "is"
                message = f"its {name} {verb} {found!r}, this run's {verb} {value!r}"
                raise CheckpointError(f"{path}: {message}")
        names = sorted(file["checkpoints"])
        if not names:
            raise CheckpointError(f"{path}: it holds no checkpoint: start the run anew")
        name = names[-1] if step is None else f"{step:08d}"
        if name not in names:
            steps = ", ".join(str(int(n)) for n in names)
            raise CheckpointError(f"{path}: no checkpoint of step {step} (there are {steps})")
        return _load(path, file["checkpoints"][name])


def read_ledger(path: AnyPath) -> dict[str, np.ndarray]:
    """The ledger of a run's HDF5 file, an array a column.

    Raises CheckpointError if the file cannot be read, or its ledger is not as it was written.
    """
    path = require_path("read_ledger.path", path)
    with _opened(path) as file:
        columns = {name: np.array(data) for name, data in file["ledger"].items()}
        _verify(path, file["ledger"], _digest({}, columns))
        return columns


def _rows(path: Path, found: Mapping[str, np.ndarray], columns: Sequence[str]) -> list[dict[str, float]]:
    """A ledger as rows of the given columns; CheckpointError for one that is missing or too short."""
    if missing := [name for name in columns if name not in found]:
        raise CheckpointError(f"{path}: its ledger has no column {', '.join(missing)}")
    if len({found[name].shape for name in columns}) != 1 or found[columns[0]].ndim != 1:
        raise CheckpointError(f"{path}: the columns of its ledger have different lengths")
    numbers = [found[name].astype(int if name in _WHOLE else float).tolist() for name in columns]
    return [dict(zip(columns, row, strict=True)) for row in zip(*numbers, strict=True)]


def _identity(simulation: Simulation) -> dict[str, Any]:
    """The data that must be equal for a checkpoint to fit, on the first rank: format, mesh, spaces and
    material.

    A material is its parameters and energies at some states: functions of one name are different energies.
    """
    layout, mesh = simulation.numbering.layout, simulation.numbering.mesh
    assert layout is not None and mesh is not None
    spaces = ", ".join(f"{name} {layout.blocks[name].ndof}" for name in layout.names)
    material = simulation.model.material
    # what the amounts in the state are amounts of
    amounts = [v for v in material.variables if isinstance(v, Amount)]
    return {
        "format": FORMAT,
        "ngvisco": version() or "0+unknown",
        "mesh": _mesh_hash(mesh),
        "spaces": spaces + (", about an axis" if layout.symmetry.is_axisymmetric else ""),
        "material": _material_signature(material),
        "bodies": ", ".join(f"{v.name.removeprefix(AMOUNT)} of {v.density!r} kg/m^3" for v in amounts),
        "scheme": _scheme_signature(simulation),
        "energies": sampled_energies(material, simulation.mesh.dim),
    }


def _mesh_hash(mesh: Mesh) -> str:
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(coordinates(mesh)).tobytes())
    digest.update(vertices(mesh).tobytes())
    digest.update("|".join(mesh.GetBoundaries()).encode())
    digest.update(str(mesh.GetCurveOrder()).encode())
    return digest.hexdigest()


def _material_signature(material: object) -> str:
    """Class and numbers of a material, and of the bodies that it is of; functions by their names."""
    values = [
        f"{field.name}={_signature_of(getattr(material, field.name))}"
        for field in (dataclasses.fields(material) if dataclasses.is_dataclass(material) else ())
        if field.repr  # the place of a body is that of the start alone
    ]
    return f"{type(material).__name__}({', '.join(values)})"


def _signature_of(value: object) -> str:
    if isinstance(value, (Material, Body)):
        return _material_signature(value)
    if isinstance(value, tuple):
        return f"({', '.join(_signature_of(one) for one in value)}{',' * (len(value) == 1)})"
    return getattr(value, "__qualname__", None) or repr(value)


def _scheme_signature(simulation: Simulation) -> str:
    integrator = simulation.integrator
    scheme = integrator.scheme
    text = f"{scheme.name}, A = {scheme.A}, b = {scheme.b}, loads averaged"
    if integrator.startup:
        text += f", startup = {integrator.startup}"
    return text + (", relaxed" if integrator.relaxed else "")


def version(package: str = "ngvisco") -> str | None:
    """The version of an installed package; None for one that is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
