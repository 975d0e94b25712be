"""Studies run by the command: their files, finished runs that are not repeated, and refused studies."""

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from support import A_BODY, A_SWIRL, NO_VTK, TWO_STEPS

from ngvisco.case.build import load_case
from ngvisco.case.directory import RunDirectory
from ngvisco.cli.main import main
from ngvisco.sweep import Outcome, Study, Variation
from ngvisco.sweep.processes import _check_workers, connected
from ngvisco.sweep.variations import SweepError

pytest.importorskip("distributed")
ROOT = Path(__file__).resolve().parents[2]

CASE = A_BODY.replace("0.6", "0.7") + A_SWIRL + TWO_STEPS + NO_VTK


@pytest.fixture
def case_file(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    return path


@pytest.fixture(autouse=True)
def processes_find_the_package(monkeypatch):
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    )


def table(directory):
    with (directory / "sweep.csv").open() as file:
        return {row["run"]: row for row in csv.DictReader(file)}


def sweep(case_file, directory, *words):
    return main(["sweep", str(case_file), "-o", str(directory), *words])


# no step meets the tolerance 1e-12, and shorter steps are not allowed
FAILING = "time.adaptive.tolerance=1,1e-12"
ADAPTIVE = [f"--set=time.adaptive.{name}=0.02" for name in ("dt_min", "dt_max")]


@pytest.mark.long
@pytest.mark.ci
def test_failures_are_listed_and_finished_runs_are_not_run_again(case_file, tmp_path, capsys):
    out = tmp_path / "study"
    words = ["--vary", "material.G_e=1", "--vary", FAILING, *ADAPTIVE]
    assert sweep(case_file, out, *words) == 1
    said = capsys.readouterr()
    good, bad = (f"material.G_e=1,time.adaptive.tolerance={value}" for value in ("1", "1e-12"))
    rows = table(out)
    assert rows[good]["state"] == "finished" and float(rows[good]["time"]) == 0.04
    assert abs(float(rows[good]["largest_closure"])) < 1e-10 and rows[good]["material.G_e"] == "1"
    assert rows[bad]["state"] == "failed" and "dt_min" in rows[bad]["message"]
    assert f"ngvisco: {bad}: failed" in said.err and f"{good}: finished" in said.out
    assert (out / bad / "failed.txt").exists()

    stamp = (out / good / "run.h5").stat().st_mtime_ns
    assert (
        sweep(case_file, out, "--vary", "material.G_e=1,2", "--vary", "time.adaptive.tolerance=1", *ADAPTIVE)
        == 0
    )
    assert "1 of them finished before" in capsys.readouterr().out
    assert (out / good / "run.h5").stat().st_mtime_ns == stamp
    states = {name: row["state"] for name, row in table(out).items()}
    assert states.pop(bad) == "failed" and list(states.values()) == ["finished"] * 2
    # another case under the same name
    case_file.write_text(CASE.replace("K_e = 10", "K_e = 20"))
    assert (
        sweep(case_file, out, "--vary", "material.G_e=1", "--vary", "time.adaptive.tolerance=1", *ADAPTIVE)
        == 2
    )
    assert "results of another case" in capsys.readouterr().err
    assert (out / good / "run.h5").stat().st_mtime_ns == stamp


def test_the_table_keeps_rows_of_runs_that_another_command_made(case_file, tmp_path):
    """Rows stay if the second command varies the same keys, and if it varies others. Rows of runs without a
    case file are removed."""
    directory = tmp_path / "study"
    for key, values in (("material.G_e", ("1", "2")), ("time.dt", ("0.01",))):
        study = Study(case_file, [Variation(key, values)], directory)
        for number, outcome in enumerate(study.outcomes):
            outcome.state, outcome.last = "finished", {"step": 2.0, "time": 0.25 + number}
        study._prepare(range(len(study.outcomes)))
    (directory / "cases" / "material.G_e=2.toml").unlink()
    study = Study(case_file, [Variation("material.G_e", ("5",))], directory)
    study._prepare([0])
    rows = table(directory)
    assert list(rows) == ["material.G_e=1", "time.dt=0.01", "material.G_e=5"]
    assert rows["material.G_e=1"]["time"] == "0.25" and rows["material.G_e=1"]["state"] == "finished"
    assert [row["time.dt"] for row in rows.values()] == ["", "0.01", ""]
    assert rows["material.G_e=5"]["state"] == "not started"
    (directory / "sweep.csv").write_text("something else\n")
    with pytest.raises(SweepError, match=r"sweep\.csv: expected the table of an earlier study"):
        Study(case_file, [Variation("material.G_e", ("5",))], directory)


def begun(command, ledger, **options):
    """A process of a run that has made some steps, as the ledger shows."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)
    for _ in range(1200):
        if ledger.exists() and len(ledger.read_text().splitlines()) > 4:
            return process
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    raise AssertionError("waited in vain")


@pytest.mark.long
@pytest.mark.ci
def test_a_stopped_study_goes_on_where_it_was(case_file, tmp_path):
    out, words = tmp_path / "study", ["--vary", "material.G_e=1,2", "--set", "time.until=40"]
    command = [sys.executable, "-m", "ngvisco", "sweep", str(case_file), "-o", str(out), "--workers", "1"]
    process = begun([*command, *words], out / "material.G_e=1" / "ledger.csv")
    process.send_signal(signal.SIGTERM)
    said, error = process.communicate(timeout=60)
    assert process.returncode == 143, error
    assert "the same command goes on" in said
    first, second = table(out).values()
    assert first["state"] == "stopped" and second["state"] == "not started"
    study = Study(case_file, [Variation.parse(words[1])], out, settings=[words[3]])
    assert study.unfinished == [0, 1] and study.outcomes[0].last["step"] == int(first["step"]) > 2


@pytest.mark.long
@pytest.mark.ci
def test_a_run_of_a_study_ends_when_its_standard_input_closes(case_file, tmp_path):
    out = tmp_path / "run"
    words = ["run", str(case_file), "-o", str(out), "--set", "time.until=40", "--quiet", "--ends-with-stdin"]
    command = [sys.executable, "-m", "ngvisco", *words]
    process = begun(command, out / "ledger.csv", stdin=subprocess.PIPE)
    process.communicate(timeout=60)
    assert process.returncode == 143 and "stopped on request" in (out / "log.txt").read_text()
    # this run reaches its end although its input is open
    words[words.index("time.until=40")] = "time.until=0.02"
    process = subprocess.Popen(
        [*command[:3], *words, "--force"], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.wait(timeout=60) == 0, process.stderr.read()
    process.communicate()


@pytest.mark.long
def test_a_study_that_is_killed_leaves_no_run_behind(case_file, tmp_path):
    words = [str(case_file), "-o", str(tmp_path), "--vary", "material.G_e=1", "--set", "time.until=40"]
    place = tmp_path / "material.G_e=1"
    process = begun([sys.executable, "-m", "ngvisco", "sweep", *words], place / "ledger.csv")
    process.kill()
    process.communicate(timeout=60)
    for _ in range(600):
        if "stopped on request" in (place / "log.txt").read_text():
            return
        time.sleep(0.05)
    raise AssertionError((place / "log.txt").read_text())


def test_a_run_that_ended_early_is_listed_as_stopped(case_file, tmp_path):
    """The run was made by ``ngvisco run``, or by a study with an earlier end time."""
    out, words = tmp_path / "study", ["--vary", "material.G_e=1"]
    place = out / "material.G_e=1"
    assert main(["run", str(case_file), "-o", str(place), "--set", "material.G_e=1"]) == 0
    outcome = Outcome("run", {})
    outcome.read(RunDirectory(place), load_case(case_file, ["time.until=1"]))
    assert outcome.state == "stopped" and outcome.last["time"] == 0.04 and not outcome.is_finished
    study = Study(case_file, [Variation.parse(words[1])], out)
    assert study.outcomes[0].state == "finished"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "nothing to vary"),
        (["--vary", "material.G_e=1,-2"], "material.G_e (set on the command line)"),
        (["--vary", "material.G_e=1,1.0"], "the same case"),
        (["--vary", "material.G_e=1", "--set", "material.G_e=2"], "the key is in both"),
        (["--vary", "domain.maxh=0.5,1e-9"], "domain"),
        (["--vary", "initial.density=1,'x - 2'"], "initial.density"),
        (["--vary", "material.G_e=1", "--scheduler", "nowhere"], "--scheduler nowhere"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_written(case_file, tmp_path, capsys, words, message):
    assert sweep(case_file, tmp_path / "study", *words) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


def test_the_command_names_a_missing_extra(case_file, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert sweep(case_file, tmp_path / "study", "--vary", "material.G_e=1") == 2
    assert 'pip install "ngvisco[sweep]"' in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize("address", ["nowhere", "tcp://nowhere", "tls://nowhere:", "nowhere:port"])
def test_an_address_without_a_port_is_refused_before_a_client_is_made(monkeypatch, address):
    """Python would raise another error when it deletes a client that has not connected."""
    made = []
    monkeypatch.setattr("distributed.Client", lambda *words, **options: made.append(words))
    with pytest.raises(SweepError, match="tcp://host:8786"), connected(address, 1):
        pass
    assert not made


def test_a_worker_whose_version_is_unknown_is_refused():
    client = SimpleNamespace(run=lambda version: {"tcp://there:1": None})
    with pytest.raises(SweepError, match="tcp://there:1 has a version of a clone that is not installed"):
        _check_workers(client, "tcp://there:0")


@pytest.mark.long
@pytest.mark.ci
def test_a_study_runs_on_a_given_scheduler(case_file, tmp_path):
    from distributed import LocalCluster

    options = {"processes": False, "n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(protocol="tcp://", **options) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tcp://")
        assert sweep(case_file, tmp_path / "study", "--vary", "material.G_e=1", "--scheduler", address) == 0
    assert [row["state"] for row in table(tmp_path / "study").values()] == ["finished"]
