"""Run directories in one process: they are resumed on every kind of domain, read back, or refused."""

from pathlib import Path

import numpy as np
import pytest
from support import by_ci
from support import state as values

import ngvisco as nv
from ngvisco.case import resume, run

DEMOS = Path(__file__).resolve().parents[2] / "demos"


@pytest.mark.parametrize(
    "name",
    [by_ci("couette"), "wave", *(pytest.param(n, marks=pytest.mark.long) for n in ("creep_finite", "shell"))],
)
def test_resumed_run_is_bitwise_identical_on_every_kind_of_domain(name, tmp_path):
    """The runs have curved cells, moving walls, creep with its own equation, passive fields, and a periodic
    cell."""
    settings = [f"domain.maxh={0.4 if name == 'wave' else 0.7}", "output.checkpoint.every=1000"]

    def case(steps):
        loaded = nv.load_case(DEMOS / name / f"{name}.toml", settings)
        return nv.load_case(loaded.source, [*settings, f"time.until={steps * loaded.sections.time.dt!r}"])

    whole = run(case(4), tmp_path / "whole")
    run(case(2), tmp_path / "parts")
    rest = resume(tmp_path / "parts", case(4).until)
    assert np.array_equal(values(whole), values(rest))
    for field, array in whole.passive.arrays().items():
        assert np.array_equal(array, rest.passive.arrays()[field])
    whole_ledger, rest_ledger = ((tmp_path / part / "ledger.csv").read_bytes() for part in ("whole", "parts"))
    assert whole_ledger == rest_ledger
    loaded = nv.load(tmp_path / "parts")
    assert np.array_equal(values(loaded.simulation), values(rest)) and loaded.time == rest.t


def test_a_directory_without_a_run_is_refused(tmp_path):
    for act in (resume, nv.load):
        with pytest.raises(nv.RunDirectoryError, match="not a run directory"):
            act(tmp_path)
    assert not list(tmp_path.iterdir())
    file = tmp_path / "run.h5"
    file.touch()
    with pytest.raises(nv.RunDirectoryError, match=r"run\.h5: this is a file, not a run directory"):
        nv.load(file)


def test_a_run_whose_first_step_has_no_solution_leaves_only_a_report(tmp_path, monkeypatch):
    """The corrected case can then run in the same directory."""
    loaded = nv.load_case(DEMOS / "couette" / "couette.toml", ["domain.maxh=0.7"])
    case = nv.load_case(loaded.source, ["domain.maxh=0.7", f"time.until={loaded.sections.time.dt!r}"])

    def unsolved(*_):
        raise nv.StepError("did not converge")

    with monkeypatch.context() as broken:
        broken.setattr("ngvisco.solver.rothe.RotheSolver.solve", unsolved)
        with pytest.raises(nv.StepError):
            run(case, tmp_path / "run")
    assert {path.name for path in (tmp_path / "run").rglob("*")} == {"failed.txt", "failed.vtu"}
    run(case, tmp_path / "run")
    assert (tmp_path / "run" / "run.h5").exists() and not (tmp_path / "run" / "failed.txt").exists()
