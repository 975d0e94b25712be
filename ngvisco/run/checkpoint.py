"""The HDF5 file of a run: ledger and checkpoints, always complete under its name.

Layout::

    /                        attributes: format, ngvisco, mesh, spaces, material
    /ledger/<column>         one value a step, attribute ``unit``
    /checkpoints/<step>/state   all coefficients of the step's space; attributes time, step,
                                energy, mass, initial_mass, velocity_scale
    /checkpoints/<step>/passive/<field>   coefficients of the run's passive fields, if any

The file is written beside and renamed, so that a kill at any moment leaves the last one readable.
A run forgets its factorised Jacobian where it writes a checkpoint, because a resumed run has none: so
the two agree bit for bit (in serial, on one machine).
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from ngsolve import VOL, Mesh

from ngvisco.errors import CheckpointError, ParameterError
from ngvisco.run.ledger import Balance, unit

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

FORMAT = 1


class Checkpoints:
    """Writes the run's HDF5 file every so many steps and at the end.

    Parameters
    ----------
    path : path
        E.g. ``results/run.h5``.
    every : int
        Steps between checkpoints.
    keep : int
        How many checkpoints the file holds, the latest ones.
    """

    def __init__(self, path: str | os.PathLike[str], every: int = 10, keep: int = 2) -> None:
        for name, value in (("every", every), ("keep", keep)):
            if not (isinstance(value, int) and value >= 1):
                raise ParameterError(f"Checkpoints.{name}", value, "an integer >= 1")
        self.path, self.every, self.keep = Path(path), every, keep
        self._kept: dict[int, tuple[dict[str, float], dict[str, np.ndarray]]] = {}
        self._earlier: list[dict[str, float]] = []

    def start(self, simulation: Simulation) -> None:
        self._kept, self._earlier = {}, []
        if simulation.number > 0 and self.path.exists():
            self._earlier = [row for row in read_ledger_rows(self.path) if row["step"] <= simulation.number]
        self._write(simulation)

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        if simulation.number % self.every == 0:
            self._write(simulation)

    def finish(self, simulation: Simulation) -> None:
        if simulation.number not in self._kept:
            self._write(simulation)

    def _write(self, simulation: Simulation) -> None:
        simulation.solver.forget()
        self._kept[simulation.number] = snapshot(simulation)
        for number in sorted(self._kept)[: -self.keep]:
            del self._kept[number]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        draft = self.path.with_name(self.path.name + ".part")
        with h5py.File(draft, "w") as file:
            file.attrs.update(identity(simulation))
            group = file.create_group("ledger")
            seen = {row["step"] for row in simulation.ledger.rows}
            rows = [row for row in self._earlier if row["step"] not in seen] + simulation.ledger.rows
            for column in simulation.ledger.columns:
                data = group.create_dataset(column, data=[row[column] for row in rows])
                data.attrs["unit"] = unit(column)
            for number, (attributes, arrays) in self._kept.items():
                checkpoint = file.create_group(f"checkpoints/{number:08d}")
                checkpoint.attrs.update(attributes)
                for name, array in arrays.items():
                    checkpoint.create_dataset(name, data=array)
        draft.replace(self.path)


def snapshot(simulation: Simulation) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """What a restart needs: attributes and copies of all coefficients, by data set."""
    balance = simulation.ledger.balance
    assert balance is not None
    attributes = {
        "time": simulation.t,
        "step": simulation.number,
        "velocity_scale": simulation.velocity_scale,
        **dataclasses.asdict(balance),
    }
    arrays = {"state": simulation.rothe_step.state.vec.FV().NumPy().copy()}
    arrays |= {f"passive/{name}": array for name, array in simulation.passive.arrays().items()}
    return attributes, arrays


def restore(simulation: Simulation, path: str | os.PathLike[str], step: int | None = None) -> None:
    """Put a simulation into the state of a checkpoint, by default the last one of the file.

    Raises
    ------
    CheckpointError
        If the file is missing or damaged, has no such checkpoint, or belongs to another mesh,
        discretisation or material; the message says which.
    """
    attributes, arrays = _read_checkpoint(Path(path), identity(simulation), step)
    state = arrays["state"]
    vector = simulation.rothe_step.state.vec
    if state.shape != (len(vector),):
        raise CheckpointError(f"{path}: the state has {state.size} coefficients, not {len(vector)}")
    passive = {name.removeprefix("passive/"): array for name, array in arrays.items() if name != "state"}
    simulation.passive.load(passive)
    vector.FV().NumPy()[:] = state
    simulation.rothe_step.state_old.vec.data = vector
    simulation.set_time(attributes["time"], int(attributes["step"]))
    simulation.set_velocity_scale(attributes["velocity_scale"])
    simulation.solver.forget()
    balance = {f.name: attributes[f.name] for f in dataclasses.fields(Balance)}
    simulation.ledger.resume(Balance(**balance))


def _read_checkpoint(
    path: Path, expected: dict[str, Any], step: int | None
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    if not path.exists():
        raise CheckpointError(f"{path}: no such file")
    try:
        with h5py.File(path, "r") as file:
            for name, value in expected.items():
                found = file.attrs.get(name)
                if name != "ngvisco" and found != value:
                    raise CheckpointError(f"{path}: its {name} is {found!r}, this run's is {value!r}")
            names = sorted(file["checkpoints"])
            name = names[-1] if step is None else f"{step:08d}"
            if name not in names:
                steps = ", ".join(str(int(n)) for n in names)
                raise CheckpointError(f"{path}: no checkpoint of step {step} (there are {steps})")
            group = file["checkpoints"][name]
            arrays = {"state": np.array(group["state"])}
            for name, data in group.get("passive", {}).items():
                arrays[f"passive/{name}"] = np.array(data)
            return {k: float(v) for k, v in group.attrs.items()}, arrays
    except (OSError, KeyError) as error:
        raise CheckpointError(f"{path}: not a readable run file ({error})") from error


def read_ledger(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """The ledger of a run's HDF5 file, an array a column."""
    try:
        with h5py.File(path, "r") as file:
            return {name: np.array(data) for name, data in file["ledger"].items()}
    except (OSError, KeyError) as error:
        raise CheckpointError(f"{path}: not a readable run file ({error})") from error


def read_ledger_rows(path: Path) -> list[dict[str, float]]:
    """The same as rows."""
    columns = read_ledger(path)
    count = len(next(iter(columns.values()), ()))
    return [{name: float(data[i]) for name, data in columns.items()} for i in range(count)]


def identity(simulation: Simulation) -> dict[str, Any]:
    """What must be equal for a checkpoint to fit: format, mesh, spaces and material."""
    layout = simulation.rothe_step.layout
    spaces = ", ".join(f"{name} {layout.blocks[name].ndof}" for name in layout.names)
    return {
        "format": FORMAT,
        "ngvisco": _version(),
        "mesh": mesh_hash(simulation.mesh),
        "spaces": spaces,
        "material": material_signature(simulation.model.material),
    }


def mesh_hash(mesh: Mesh) -> str:
    """SHA-256 of coordinates, elements and boundary names."""
    digest = hashlib.sha256()
    digest.update(np.array([v.point for v in mesh.vertices]).tobytes())
    digest.update(np.array([v.nr for el in mesh.Elements(VOL) for v in el.vertices]).tobytes())
    digest.update("|".join(mesh.GetBoundaries()).encode())
    digest.update(str(mesh.GetCurveOrder()).encode())
    return digest.hexdigest()


def material_signature(material: object) -> str:
    """Class and numbers of a material; functions by their names."""
    values = []
    for field in dataclasses.fields(material) if dataclasses.is_dataclass(material) else ():
        value = getattr(material, field.name)
        values.append(f"{field.name}={getattr(value, '__qualname__', None) or value!r}")
    return f"{type(material).__name__}({', '.join(values)})"


def _version() -> str:
    try:
        return importlib.metadata.version("ngvisco")
    except importlib.metadata.PackageNotFoundError:
        return "0+unknown"
