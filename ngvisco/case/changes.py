"""What a run may change when it goes on: the case it resumes with, and where that is written.

The directory's case.toml becomes the changed case; the one before is kept as ``case.until-step-N.toml``, and
versions.json lists the changes with their step, time and settings.  run.h5 still says by the hash of which
case it was written until its first checkpoint after the change, so that a change that was interrupted is
taken up.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py

from ngvisco.case.build import Case, parse_case
from ngvisco.case.faults import CaseError
from ngvisco.errors import CheckpointError
from ngvisco.run.checkpoint import read_ledger
from ngvisco.run.files import write_atomically
from ngvisco.run.transfer import resume_changed

if TYPE_CHECKING:
    from ngvisco.case.directory import RunDirectory
    from ngvisco.run.simulation import Simulation

CHANGEABLE = "title, time, loads, walls, numbers of material and rheology, solver, output but for passive"
"""What ``--set`` may change of a run that goes on."""

_INSTEAD = "start a new run with its fields: ngvisco run CASE -o NEW --from"

FIXED = (
    *("domain", "initial", "discretisation"),
    *("material.kind", "material.thermal", "bodies", "output.passive"),
)
"""What it may not, of bodies all but the numbers of their materials and mechanisms: another mesh or other
unknowns are a new run, which takes over the fields of this one."""


def changed(place: RunDirectory, case: Case, settings: Sequence[str]) -> Case:
    """The directory's case with settings; raises CaseError under the key of a setting that may not change."""
    new = parse_case(case.resolved, case.source, case.directory, settings)
    for key in FIXED:
        if _value(new, key) != _value(case, key):
            message = f"cannot change when a run goes on (what can: {CHANGEABLE}); {_INSTEAD} {place.path}"
            where = tuple(key.split("."))
            set_there = [path for path in new.locator.overridden if path[: len(where)] == where]
            raise CaseError(case.source, [new.locator.fault((set_there or [where])[0], message)])
    return new


def _value(case: Case, key: str) -> Any:
    node: Any = case.sections.model_dump()
    if key == "bodies":
        kept, mechanisms = ("name", "where", "density", "order"), ("viscosity", "creep")
        return [
            {name: body[name] for name in kept}
            | {"kind": body["material"]["kind"], "has heat": body["material"]["thermal"] is not None}
            | {name: body[name] is not None for name in mechanisms}
            for body in node["bodies"]
        ]
    for part in key.split("."):
        node = None if node is None else node[part]
    return node is not None if key == "material.thermal" else node


def check_change(place: RunDirectory, case: Case, simulation: Simulation) -> None:
    """Go on with the changed case's simulation without writing anything: raises what that raises."""
    if simulation.ranks.on_first(place.run_file.exists):
        before = simulation.ranks.on_first(lambda: pending_change(place, case))
        resume_changed(simulation, place.run_file, {"case": before or case.hash})


def write_change(place: RunDirectory, case: Case, new: Case, settings: Sequence[str]) -> None:
    """Put the changed case into the directory, and keep the one before."""
    step, time = _reached(place.run_file)
    record = place.read_versions()
    before = pending_change(place, case) or case.hash  # a change that no checkpoint has reached is replaced
    change = {"step": step, "time": time, "settings": list(settings), "from": before, "to": new.hash}
    record["changes"] = [*record.get("changes", []), change]
    write_atomically(place.path / f"case.until-step-{step}.toml", case.resolved.encode())
    write_atomically(place.versions_file, (json.dumps(record, indent=2) + "\n").encode())
    write_atomically(place.case_file, new.resolved.encode())


def pending_change(place: RunDirectory, case: Case) -> str | None:
    """Hash of the case that run.h5 was written with, where the last change has not reached it yet."""
    changes = place.read_versions().get("changes", [])
    if not changes or changes[-1]["to"] != case.hash or changes[-1]["from"] == case.hash:
        return None
    try:
        with h5py.File(place.run_file) as file:
            found = file.attrs.get("case")
    except OSError:  # whoever reads it next says why
        return None
    return str(found) if found == changes[-1]["from"] else None


def _reached(path: Path) -> tuple[int, float]:
    if not path.exists():
        return 0, 0.0
    ledger = read_ledger(path)
    if not len(ledger.get("time", ())):
        raise CheckpointError(f"{path}: its ledger is empty")
    return int(ledger["step"][-1]), float(ledger["time"][-1])
