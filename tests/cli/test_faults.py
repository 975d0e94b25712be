"""Real faults in processes: each gives a clear message and the right exit code, and no result is lost."""

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest
from command import CASE, command, environment, rows, start, wait_for

import ngvisco as nv
from ngvisco.run.snapshot import FORMAT

DONE, FAILED, BAD_INPUT, BAD_FILE = 0, 1, 2, 3
LONG = ("--set", "time.until=200")
REST = (pytest.mark.long, pytest.mark.ci)
"""Further processes that differ little from those of the default suite."""


@pytest.fixture(scope="session")
def stopped(tmp_path_factory):
    """A directory whose run stopped after 2 of the 4 steps; not to be changed."""
    place = tmp_path_factory.mktemp("stopped")
    (place / "case.toml").write_text(CASE)
    words = ("--quiet", "--set", "time.until=0.04")
    code, _, err = command("run", place / "case.toml", "-o", place / "half", *words)
    assert code == DONE, err
    return place / "half"


@pytest.fixture
def half(tmp_path, stopped):
    """A copy of ``stopped``."""
    return shutil.copytree(stopped, tmp_path / "half")


def state(directory, step=None):
    with h5py.File(directory / "run.h5") as file:
        name = max(file["checkpoints"]) if step is None else f"{step:08d}"
        return np.array(file["checkpoints"][name]["state"])


def assert_same_run(a, b):
    assert np.array_equal(state(a), state(b))
    assert (a / "ledger.csv").read_bytes() == (b / "ledger.csv").read_bytes()
    first, second = nv.read_ledger(a / "run.h5"), nv.read_ledger(b / "run.h5")
    assert all(np.array_equal(first[name], second[name], equal_nan=True) for name in first)


def assert_goes_on(place, case_file, number):
    """Assert that a run resumed after step ``number`` for two steps equals the uninterrupted run."""
    whole, end = place.parent / "whole", round((number + 2) * 0.02, 10)
    assert command("resume", place, "--until", end, "--quiet")[0] == DONE
    assert command("run", case_file, "-o", whole, "--quiet", "--set", f"time.until={end}")[0] == DONE
    assert_same_run(place, whole)


def test_a_disk_that_fills_up_loses_no_result(half, finished):
    before = {name: (half / name).read_bytes() for name in ("run.h5", "case.toml", "mesh.vol")}
    size = (half / "run.h5").stat().st_size
    free, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size // 2, hard))
        code, _, err = command("resume", half, "--until", 0.08, "--quiet")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (free, hard))
    assert code == BAD_FILE and "run.h5" in err and "too large" in err
    assert {name: (half / name).read_bytes() for name in before} == before
    assert not list(half.rglob("*.part*"))
    assert command("resume", half, "--until", 0.08, "--quiet")[0] == DONE
    assert_same_run(half, finished)


def test_info_reports_a_run_that_has_passed_the_end_of_its_case_as_finished(half):
    assert command("resume", half, "--until", 0.06, "--quiet")[0] == DONE
    assert "t = 0.06 s, beyond the case's 0.04 s, step 3; finished" in command("info", half)[1]


def test_an_end_time_that_misses_the_end_of_a_step_by_rounding_is_moved_to_it(half, finished):
    code, out, err = command("resume", half, "--until", "80.0001 ms")
    assert code == DONE, err
    assert "2 steps of 0.02 s" in out and "step     3/4 " in out and "step     4/4 " in out
    assert (
        "the run ends at 0.08 s, the end of a step nearest to 0.0800001 s" in (half / "log.txt").read_text()
    )
    assert_same_run(half, finished)


def test_a_full_disk_is_named_in_the_message(half):
    (half / "log.txt").unlink()
    (half / "log.txt").symlink_to("/dev/full")
    code, _, err = command("resume", half, "--until", 0.08)
    assert code == BAD_FILE and "No space left on device" in err


@pytest.mark.parametrize("place", ["/proc/ngvisco-run", "/dev/null/run"])
def test_an_unwritable_directory_is_named_in_the_message(place, case_file):
    code, _, err = command("run", case_file, "-o", place)
    assert code == BAD_FILE and place.split("/run")[0] in err


def test_a_file_in_place_of_a_run_directory_is_refused(case_file):
    before = case_file.read_text()
    code, _, err = command("run", case_file, "-o", case_file)
    assert code == BAD_INPUT and "expected a directory" in err and case_file.read_text() == before


def test_existing_results_are_refused_unless_forced(half, case_file):
    before = {path: path.read_bytes() for path in half.rglob("*") if path.is_file() and path.name != "lock"}
    (half / "mine.txt").write_text("keep")
    code, _, err = command("run", case_file, "-o", half)
    assert code == BAD_INPUT and "--force" in err
    assert {path: path.read_bytes() for path in before} == before
    code, _, _ = command("run", case_file, "-o", half, "--force", "--quiet", "--set", "time.until=0.02")
    assert code == DONE and rows(half) == 2
    assert (half / "mine.txt").read_text() == "keep"


@pytest.mark.parametrize("cut", [0.2, 0.5, 0.9])
def test_a_mesh_file_cut_short_is_refused(cut, half, case_file):
    whole = (half / "mesh.vol").read_bytes()
    broken = case_file.parent / "broken.vol"
    broken.write_bytes(whole[: int(cut * len(whole))])
    text = CASE.replace(
        'geometry = "box"\nsize = [1, 1]\nmaxh = 0.6', 'geometry = "file"\npath = "broken.vol"'
    )
    case_file.write_text(text)
    code, _, err = command("check", case_file)
    # the file ends with Netgen's copy of the geometry: without this copy the mesh may still be complete
    assert (code == DONE and cut > 0.5) or (code == BAD_INPUT and "broken.vol" in err and "domain" in err)


def test_a_run_whose_mesh_was_cut_short_is_not_resumed(half):
    whole = (half / "mesh.vol").read_bytes()
    (half / "mesh.vol").write_bytes(whole[: int(0.9 * len(whole))])
    code, _, err = command("resume", half, "--until", 0.08)
    assert code == BAD_FILE and "mesh.vol" in err


def test_a_run_that_has_lost_its_checkpoints_is_not_begun_anew(half):
    (half / "run.h5").unlink()
    before = (half / "ledger.csv").read_bytes()
    code, _, err = command("resume", half, "--until", 0.08)
    assert code == BAD_INPUT and "run.h5: this file is missing" in err and "ngvisco run" in err
    assert (half / "ledger.csv").read_bytes() == before


def test_a_case_with_a_user_s_mesh_file_runs(half, case_file):
    shutil.copy(half / "mesh.vol", case_file.parent / "own.vol")
    text = CASE.replace('geometry = "box"\nsize = [1, 1]\nmaxh = 0.6', 'geometry = "file"\npath = "own.vol"')
    case_file.write_text(text)
    out = case_file.parent / "own"
    assert command("run", case_file, "-o", out, "--quiet", "--set", "time.until=0.04")[0] == DONE
    assert np.array_equal(state(out), state(half))


@pytest.mark.parametrize("damage", ["truncated", "empty", "version", "case", "mesh"])
def test_a_damaged_or_foreign_checkpoint_is_refused_with_the_reason(damage, half):
    path = half / "run.h5"
    if damage in ("truncated", "empty"):
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2 if damage == "truncated" else 0])
        reason = "not a readable run file"
    elif damage == "version":
        with h5py.File(path, "a") as file:
            file.attrs["format"] = 1
        reason = f"the checkpoint has format = 1, but this run has format = {FORMAT}"
    elif damage == "case":
        text = (half / "case.toml").read_text()
        (half / "case.toml").write_text(text.replace("G_v = 0.01", "G_v = 0.02"))
        reason = "the checkpoint has case = "
    else:
        with h5py.File(path, "a") as file:
            file.attrs["mesh"] = "another"
        reason = "the checkpoint has mesh = 'another'"
    before = path.read_bytes()
    code, _, err = command("resume", half, "--until", 0.08)
    assert code == BAD_FILE and reason in err
    assert path.read_bytes() == before


def test_a_damaged_checkpoint_is_named_with_the_earlier_one_that_can_be_resumed(half):
    path = half / "run.h5"
    with h5py.File(path, "a") as file:
        first, last = sorted(file["checkpoints"])
        file[f"checkpoints/{last}/state"][0] += 1.0
    code, _, err = command("resume", half, "--until", 0.08)
    assert code == BAD_FILE and f"checkpoints/{last} is damaged" in err
    assert f"restore(path, step={int(first)})" in err
    with h5py.File(path, "a") as file:
        file[f"checkpoints/{first}/state"][0] += 1.0
    code, _, err = command("resume", half, "--until", 0.08)
    assert code == BAD_FILE and "is damaged" in err and "restore" not in err


def test_a_run_file_that_lacks_parts_is_refused(half):
    for group in ("checkpoints", "ledger/kinetic"):
        path = half / "run.h5"
        whole = path.read_bytes()
        with h5py.File(path, "a") as file:
            del file[group]
            if group == "checkpoints":
                file.create_group(group)
        code, _, err = command("resume", half, "--until", 0.08)
        assert code == BAD_FILE and ("the file has no checkpoint" in err or "ledger is damaged" in err)
        path.write_bytes(whole)


@pytest.mark.parametrize(
    "shell",
    [pytest.param(to, marks=REST) for to in ("{} | head -n 1", "{} >&-", "{} > /dev/full", "{} >&- 2>&-")],
)
def test_a_closed_output_pipe_does_not_end_a_run(shell, tmp_path, case_file):
    run = f"{sys.executable} -m ngvisco run {case_file} -o {tmp_path / 'out'}"
    code = f"set -o pipefail; {shell.format(run)}; code=${{PIPESTATUS[0]}}; exit $code"
    result = subprocess.run(["bash", "-c", code], env=environment(), capture_output=True, text=True)
    assert result.returncode == DONE, result.stderr
    assert not result.stderr
    assert rows(tmp_path / "out") == 5


IN_TURN = """
import sys
from ngvisco.cli.main import main
case, out = sys.argv[1:]
words = ["run", case, "-o", out], ["info", out], ["scene", out], ["resume", out]
sys.exit(max(map(main, words)))
"""


@pytest.mark.long
@pytest.mark.ci
def test_texts_are_utf_8_whatever_the_locale(tmp_path, case_file):
    title = "Würfel, größer als 1 m: Δt → 0"
    case_file.write_text(CASE.replace("a small swirl", title), encoding="utf-8")
    latin = environment() | {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    out = tmp_path / "out"
    result = subprocess.run([sys.executable, "-c", IN_TURN, case_file, out], env=latin, capture_output=True)
    assert result.returncode == DONE, result.stderr
    for name in ("case.toml", "log.txt", "scene.html"):
        assert title in (out / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("package", ["ngsolve", "scipy"])
def test_an_interrupt_during_the_imports_leaves_no_traceback(tmp_path, package):
    """In programs other than the command, Python prints its traceback."""
    (tmp_path / f"{package}.py").write_text("raise KeyboardInterrupt")
    there = environment() | {"PYTHONPATH": str(tmp_path)}
    run = {"env": there, "capture_output": True, "text": True}
    by_command = subprocess.run([sys.executable, "-m", "ngvisco", "list"], **run)
    assert by_command.stderr == "ngvisco: the command was interrupted before it began\n"
    assert by_command.returncode == -signal.SIGINT
    assert "Traceback" in subprocess.run([sys.executable, "-c", "import ngvisco"], **run).stderr


def test_a_signal_ends_the_run_and_says_how_to_resume(tmp_path, case_file):
    """No other file is written while a run is at work; the only checkpoint was written for the signal."""
    place = tmp_path / "out"
    process = start("run", case_file, "-o", place, *LONG, "--set", "output.checkpoint.every=1000")
    try:
        wait_for(lambda: rows(place) > 2, process)
        for words in (("run", case_file, "-o", place, "--force"), ("resume", place)):
            code, _, err = command(*words)
            assert code == BAD_INPUT and f"process {process.pid} on " in err and "uses this directory" in err
        reached = rows(place)
        wait_for(lambda: rows(place) > reached, process)
        process.send_signal(signal.SIGINT)  # a stopped study is sent SIGTERM, see test_study
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 128 + signal.SIGINT and "Traceback" not in err
    assert "SIGINT: stopped after step" in out and f"ngvisco resume {place}" in out
    done = rows(place) - 1
    assert done < 1000 and "stopped on request" in (place / "log.txt").read_text()
    assert list(nv.read_ledger(place / "run.h5")["step"])[-1] == done
    assert_goes_on(place, case_file, done)


WITHIN = """
import sys, time
from pathlib import Path
from ngvisco.cli.main import main
from ngvisco.reduced.residual import ReducedResidual
from ngvisco.run.simulation import Simulation
from ngvisco.solver.newton import CondensedJacobian
solver, note, *words = sys.argv[1:]
owner, name = {"split": (ReducedResidual, "__call__"), "coupled": (CondensedJacobian, "solve")}[solver]
advance, request_stop, evaluate = Simulation.advance, Simulation.request_stop, getattr(owner, name)
calls, asked = {}, []

def advanced(run, *given):
    calls["step"], calls["number"] = run.number + 1, 0
    return advance(run, *given)

def evaluated(*given):
    calls["number"] += 1
    if (calls["step"], calls["number"]) == (2, 3):
        Path(note).write_text("within")
        while not asked:
            time.sleep(0.01)
    return evaluate(*given)

def requested(run):
    asked.append(calls["step"])
    request_stop(run)

Simulation.advance, Simulation.request_stop = advanced, requested
setattr(owner, name, evaluated)
code = main(words)
Path(note).write_text(str(calls))
sys.exit(code)
"""
"""Runs the command; the third evaluation in the second step waits until the run is asked to stop."""


@pytest.mark.parametrize("solver", ["split", pytest.param("coupled", marks=REST)])
def test_a_signal_within_an_iteration_ends_the_run_before_the_next_one(solver, tmp_path, case_file):
    """SIGTERM comes in the second step's third evaluation; at most two more evaluations follow, which
    complete the iteration."""
    case_file.write_text(CASE.replace("every = 1\n", f'every = 1000\n[solver]\nmethod = "{solver}"\n'))
    place, note = tmp_path / "out", tmp_path / "note.txt"
    words = [sys.executable, "-c", WITHIN, solver, note, "run", case_file, "-o", place, *LONG]
    process = subprocess.Popen(
        words, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        wait_for(note.exists, process)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 128 + signal.SIGTERM and "Traceback" not in err, err
    assert "SIGTERM: stopped after step 1" in out and f"ngvisco resume {place}" in out
    assert note.read_text() in [str({"step": 2, "number": number}) for number in (3, 4, 5)]
    assert rows(place) == 2 and list(nv.read_ledger(place / "run.h5")["step"]) == [0, 1]
    assert_goes_on(place, case_file, 1)


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("kills", "seed"),
    [pytest.param(5, 2, marks=pytest.mark.ci), (50, int(os.environ.get("NGVISCO_SEED", "1")))],
)
def test_a_run_killed_at_random_moments_is_resumed_bit_for_bit(tmp_path, case_file, kills, seed):
    place, chance = tmp_path / "killed", random.Random(seed)
    last = -1
    for _ in range(kills):
        begun = (place / "case.toml").exists()
        words = ("resume", place) if begun else ("run", case_file, "-o", place, *LONG)
        process = start(*words, "--quiet")
        # the signal comes in the first moments of the process, or during its steps
        if chance.random() < 0.4:
            time.sleep(chance.uniform(0.0, 2.0))
        else:
            before = _touched(place)
            wait_for(lambda before=before: _touched(place) != before, process)
            time.sleep(chance.uniform(0.0, 0.5))
        assert process.poll() is None, process.communicate()
        process.send_signal(signal.SIGKILL)
        process.communicate()
        if (place / "run.h5").exists():
            ledger = nv.read_ledger(place / "run.h5")  # the last good checkpoint is always readable
            assert ledger["step"][-1] >= last
            last = int(ledger["step"][-1])
            assert rows(place) >= last
    assert last >= 0
    assert_goes_on(place, case_file, last)


def _touched(place):
    path = place / "run.h5"
    return path.stat().st_mtime_ns if path.exists() else None


def test_a_step_without_solution_ends_with_its_reason(case_file, tmp_path):
    settings = ["time.adaptive.dt_min=0.02", "time.adaptive.dt_max=0.02", "time.adaptive.tolerance=1e-12"]
    words = [word for setting in settings for word in ("--set", setting)]
    code, _, err = command("run", case_file, "-o", tmp_path / "out", "--quiet", *words)
    assert code == FAILED and "no step of at least dt_min = 0.02 s" in err and "estimated error" in err
    assert rows(tmp_path / "out") == 2  # the first step is accepted, since it has no estimate of its error
    log = (tmp_path / "out" / "log.txt").read_text()
    assert "rejected dt 0.02 s" in log and "ended: no step of at least dt_min" in log
    report = tmp_path / "out" / "failed.txt"
    assert "step 2 over" in report.read_text() and str(report) in err
    assert (tmp_path / "out" / "failed.vtu").stat().st_size > 0
    assert command("resume", tmp_path / "out", "--until", "0.02", "--quiet")[0] == DONE
    assert not report.exists() and not (tmp_path / "out" / "failed.vtu").exists()
    assert len(state(tmp_path / "out", step=1)) > 0
