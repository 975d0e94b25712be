"""Snapshots, the states of a run in its checkpoints: copied, read from a file, checked to fit the run."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib.metadata
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from ngsolve import Mesh

from ngvisco.errors import CheckpointError, require_path
from ngvisco.forms.mesh.mesh_arrays import coordinates, vertices
from ngvisco.physics.bodies import AMOUNT, Amount, Body
from ngvisco.physics.material import Material
from ngvisco.physics.pointwise import sampled_energies
from ngvisco.run.files import AnyPath
from ngvisco.run.ledger import Balance
from ngvisco.run.state import KeptPart, RunState

_WHOLE = ("step", "newton_iterations", "rejections", "limited_cells", "passive_unsolved")
"""Ledger columns that hold whole numbers."""
CHECKSUM, CLOSURES = "checksum", "closed"
FORMAT = 5
"""The version of the format of a run's file."""
PARTS = ("", "solver", "stepping", "passive")


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """One checkpoint: numbers and arrays by their names in its group, as ``/time`` and ``solver/tau``."""

    numbers: dict[str, float]
    arrays: dict[str, np.ndarray]

    @property
    def checksum(self) -> str:
        """SHA-256 of all numbers and arrays."""
        return digest_of(self.numbers, self.arrays)

    @property
    def balance(self) -> Balance:
        return Balance(
            **{field.name: self.numbers[f"/{field.name}"] for field in dataclasses.fields(Balance)}
        )

    def part(self, name: str) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays of the checkpoint's group, ``""``, or of an inner group, by name there."""
        numbers = {k.removeprefix(f"{name}/"): v for k, v in self.numbers.items() if k.startswith(f"{name}/")}
        arrays = {k.removeprefix(f"{name}/"): v for k, v in self.arrays.items() if k.startswith(f"{name}/")}
        return numbers, arrays


@dataclasses.dataclass(frozen=True)
class ChosenMesh:
    """A mesh chosen during a run: a .vol file's content, and the number of the state that chose it."""

    image: bytes
    step: int


def load(path: Path, group: h5py.Group) -> Snapshot:
    snapshot = Snapshot({}, {})
    for name in PARTS:
        part = group[name] if name else group
        snapshot.numbers.update({f"{name}/{k}": float(v) for k, v in part.attrs.items() if k != CHECKSUM})
        arrays = {f"{name}/{k}": np.array(v) for k, v in part.items() if isinstance(v, h5py.Dataset)}
        snapshot.arrays.update(arrays)
    _verify(path, group, snapshot.checksum)
    return snapshot


def digest_of(numbers: Mapping[str, float], arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name, value in sorted(numbers.items()):
        digest.update(f"{name}={float(value).hex()};".encode())
    for name, array in sorted(arrays.items()):
        digest.update(f"{name}:{array.dtype.str}{array.shape};".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _verify(path: Path, group: h5py.Group, checksum: str) -> None:
    """Raise CheckpointError unless the group has the checksum ``checksum``."""
    stored = group.attrs.get(CHECKSUM)
    if stored != checksum:
        flaw = "has no checksum" if stored is None else "is damaged, since its checksum differs"
        raise CheckpointError(f"{path}: {group.name.lstrip('/')} {flaw}; go on from another copy of the file")


_DAMAGES = (OSError, KeyError, RuntimeError, ValueError, TypeError)
"""Exceptions of h5py, by the kind of damage."""


@contextlib.contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """A run's file, opened; raises CheckpointError for a missing or damaged file."""
    if not path.exists():
        raise CheckpointError(f"{path}: this file does not exist")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except CheckpointError:
        raise
    except _DAMAGES as error:
        raise CheckpointError(f"{path}: this is not a readable run file ({error})") from error


def mesh_of_checkpoints(path: AnyPath) -> ChosenMesh | None:
    """The mesh of a run's checkpoints; None if the mesh is the run's first one.

    Raises CheckpointError if the file cannot be read.
    """
    with opened(require_path("mesh_of_checkpoints.path", path)) as file:
        if "mesh" not in file:
            return None
        return ChosenMesh(file["mesh"][()].tobytes(), int(file["mesh"].attrs["step"]))


def snapshot(simulation: RunState, solving: Mapping[str, KeptPart]) -> Snapshot:
    """Copy of the data for a restart, on the first rank, in the numbering of one process; collective.

    ``solving`` has the parts of solver and stepper, see ``Interruption.parts``.
    """
    balance = simulation.ledger.balance
    assert balance is not None
    numbers = {"time": simulation.t, "step": simulation.number}
    numbers |= {name: getattr(simulation, name) for name in ("velocity_scale", "wave_speed")}
    state = {"state": simulation.rothe_step.state.vec.FV().NumPy().copy()}
    of_run = numbers | dataclasses.asdict(balance), state
    parts: dict[str, KeptPart] = {"": of_run, **solving, "passive": ({}, simulation.passive.arrays())}
    arrays = {
        f"{part}/{name}": np.asarray(array)
        for part, (_, data) in parts.items()
        for name, array in data.items()
    }
    return Snapshot(
        {f"{part}/{name}": number for part, (data, _) in parts.items() for name, number in data.items()},
        {name: simulation.numbering.whole(array, name) for name, array in arrays.items()},
    )


def take_up(
    simulation: RunState,
    path: AnyPath,
    step: int | None = None,
    attributes: Mapping[str, str] | None = None,
    may_differ: Collection[str] = (),
) -> tuple[Snapshot, list[dict[str, float]], list[tuple[int, float]]]:
    """Load a checkpoint's state and passive fields; return the checkpoint, the ledger's rows, and the rows'
    limits.

    Collective.  ``may_differ`` names parts of a run's identity that may differ between the run and the file.
    If there are such parts, the returned rows have the file's columns, otherwise the run's.  Raises
    CheckpointError as ``Simulation.restore``.
    """
    path = require_path("restore.path", path)
    ledger, ranks, numbering = simulation.ledger, simulation.ranks, simulation.numbering
    read: list[Snapshot] = []

    def read_all() -> tuple[Any, ...]:
        must_match = {name: value for name, value in identity(simulation).items() if name not in may_differ}
        snapshot = _read_checkpoint(path, must_match | dict(attributes or {}), step)
        size, expected = snapshot.arrays["/state"].size, simulation.unknowns
        if size != expected:
            raise CheckpointError(
                f"{path}: the state in this file has {size} coefficients, but the state of the run has "
                f"{expected}"
            )
        read.append(snapshot)
        number, columns = int(snapshot.numbers["/step"]), read_ledger(path)
        names = list(columns) if may_differ else [*ledger.columns, *ledger.foreign(columns)]
        rows = [row for row in _rows(path, columns, names) if row["step"] <= number]
        if [row["step"] for row in rows] != list(range(number + 1)):
            message = f"{path}: the ledger in this file lacks rows of some of the steps 0 to {number}"
            raise CheckpointError(message)
        with opened(path) as file:  # files of older versions have no limits; then this run's limits hold
            limits = [(int(first), float(limit)) for first, limit in file["ledger"].attrs.get(CLOSURES, ())]
        return snapshot.numbers, list(snapshot.arrays), names, rows, limits

    numbers, arrays, names, rows, limits = ranks.on_first(read_all)
    whole = read[0].arrays if read else {}
    arrays_of_rank = {name: numbering.own(whole.get(name), name) for name in arrays if numbering.knows(name)}
    snapshot = Snapshot(numbers, arrays_of_rank)
    simulation.passive.load(snapshot.part("passive")[1])
    simulation.rothe_step.state.vec.FV().NumPy()[:] = snapshot.arrays["/state"]
    ledger.keep(names)
    return snapshot, rows, limits


def _read_checkpoint(path: Path, expected: dict[str, Any], step: int | None) -> Snapshot:
    """A checkpoint, by default the last one, from a file that must have the expected attributes."""
    with opened(path) as file:
        for name, value in expected.items():
            stored = file.attrs.get(name)
            if name != "ngvisco" and stored != value:
                stored = stored.item() if isinstance(stored, np.generic) else stored
                message = f"the checkpoint has {name} = {stored!r}, but this run has {name} = {value!r}"
                raise CheckpointError(f"{path}: {message}")
        names = sorted(file["checkpoints"])
        if not names:
            raise CheckpointError(f"{path}: the file has no checkpoint; start the run anew")
        name = names[-1] if step is None else f"{step:08d}"
        if name not in names:
            steps = ", ".join(str(int(n)) for n in names)
            error = CheckpointError(f"{path}: there is no checkpoint of step {step}, only of {steps}")
            error.key = "step"
            raise error
        try:
            return load(path, file["checkpoints"][name])
        except CheckpointError as error:
            others = [int(other) for other in names if _is_whole(path, file["checkpoints"][other])]
            if not others:
                raise
            text = (
                f"{error}, or in Python from the whole checkpoint of step {others[-1]}, by restore(path, "
                f"step={others[-1]})"
            )
            raise CheckpointError(text) from error


def _is_whole(path: Path, group: h5py.Group) -> bool:
    """Whether a checkpoint is as it was written."""
    try:
        load(path, group)
    except (CheckpointError, *_DAMAGES):
        return False
    return True


def read_ledger(path: AnyPath) -> dict[str, np.ndarray]:
    """The ledger of a run's HDF5 file, an array for each column.

    Raises CheckpointError if the file cannot be read, or its ledger has changed since it was written.
    """
    path = require_path("read_ledger.path", path)
    with opened(path) as file:
        columns = {name: np.array(data) for name, data in file["ledger"].items()}
        _verify(path, file["ledger"], digest_of({}, columns))
        return columns


def _rows(path: Path, ledger: Mapping[str, np.ndarray], columns: Sequence[str]) -> list[dict[str, float]]:
    """Rows of a ledger with the given columns; raises CheckpointError for a missing or too short column."""
    if missing := [name for name in columns if name not in ledger]:
        raise CheckpointError(f"{path}: the ledger in this file has no column {', '.join(missing)}")
    if len({ledger[name].shape for name in columns}) != 1 or ledger[columns[0]].ndim != 1:
        raise CheckpointError(f"{path}: the columns of the ledger in this file have different lengths")
    numbers = [ledger[name].astype(int if name in _WHOLE else float).tolist() for name in columns]
    return [dict(zip(columns, row, strict=True)) for row in zip(*numbers, strict=True)]


def identity(simulation: RunState) -> dict[str, Any]:
    """Data of a run that a checkpoint must share, on the first rank: format, mesh, spaces, material.

    A material is identified by its parameters and by energies at some states, since different functions may
    have one name.
    """
    layout, mesh = simulation.numbering.layout, simulation.numbering.mesh
    assert layout is not None and mesh is not None
    spaces = ", ".join(f"{name} {layout.blocks[name].ndof}" for name in layout.names)
    material = simulation.model.material
    # amounts say which bodies the state contains
    amounts = [v for v in material.variables if isinstance(v, Amount)]
    return {
        "format": FORMAT,
        "ngvisco": version() or "0+unknown",
        "mesh": _mesh_hash(mesh),
        # the material is compared before the spaces, which follow from it
        "material": _material_signature(material),
        "spaces": spaces + (", about an axis" if layout.symmetry.is_axisymmetric else ""),
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
    """Class and numbers of a material and of its bodies; functions are given by their names."""
    values = [
        f"{field.name}={_signature_of(getattr(material, field.name))}"
        for field in (dataclasses.fields(material) if dataclasses.is_dataclass(material) else ())
        if field.repr  # fields without repr, such as a body's place, describe only the start
    ]
    return f"{type(material).__name__}({', '.join(values)})"


def _signature_of(value: object) -> str:
    if isinstance(value, (Material, Body)):
        return _material_signature(value)
    if isinstance(value, tuple):
        return f"({', '.join(_signature_of(element) for element in value)}{',' * (len(value) == 1)})"
    return getattr(value, "__qualname__", None) or repr(value)


def _scheme_signature(simulation: RunState) -> str:
    integrator = simulation.integrator
    scheme = integrator.scheme
    text = f"{scheme.name}, A = {scheme.A}, b = {scheme.b}, loads averaged"
    if integrator.startup:
        text += f", startup = {integrator.startup}"
    return text + (", relaxed" if integrator.relaxed else "")


def version(package: str = "ngvisco") -> str | None:
    """The version of an installed package; None for a package that is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
