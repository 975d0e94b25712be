"""Runs that continue with other parameters, or start from another run; the directory records how."""

import json
import re
import shutil

import numpy as np
import pytest
from support import A_BODY, A_FALL, A_SWIRL, NO_VTK, TWO_STEPS, refuse_steps

import ngvisco as nv
from ngvisco.case import runs
from ngvisco.case.build import parse_case
from ngvisco.run.simulation import Observer

CASE = A_BODY + A_FALL + A_SWIRL + TWO_STEPS + NO_VTK


def case(place, *settings):
    return parse_case(CASE, "case.toml", place, settings)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    place = tmp_path_factory.mktemp("done") / "run"
    nv.case.run(case(place), place)
    return place


@pytest.fixture
def run(done, tmp_path):
    return shutil.copytree(done, tmp_path / "run")


def contents(place):
    return {p.name: p.read_bytes() for p in place.rglob("*") if p.is_file() and p.name != "lock"}


def test_the_directory_of_a_changed_run_holds_both_cases_and_the_change(run):
    before = (run / "case.toml").read_text()
    settings = ["time.dt=0.01", "loads=[]", "material.G_e=6", "time.until=0.06"]
    simulation = nv.case.resume(run, settings=settings)
    assert simulation.t == pytest.approx(0.06) and simulation.number == 4
    ledger = nv.read_ledger(run / "run.h5")
    assert ledger["dt"].tolist() == [0, 0.02, 0.02, 0.01, 0.01]
    assert ledger["power_gravity"][2] != 0 and not ledger["power_gravity"][3:].any()
    assert ledger["transfer"][3] < -2 and ledger["transfer"][4] == 0
    assert abs(ledger["closure_relative"]).max() < 1e-12
    assert (run / "case.until-step-2.toml").read_text() == before
    (change,) = json.loads((run / "versions.json").read_text())["changes"]
    assert change["step"] == 2 and change["settings"] == settings
    log = (run / "log.txt").read_text()
    assert "changed: time.dt=0.01" in log and "2 steps of 0.01 s" in log and "step     4/4  t 0.06 s" in log
    # resume and load now use the changed case
    assert nv.case.resume(run, 0.08).number == 6
    assert nv.load(run).case.sections.material.G_e == 6


def test_the_end_of_a_run_with_another_step_is_counted_from_each_checkpoint_at_which_the_step_changed(run):
    """No end is a multiple of 0.03 after t = 0 and after the checkpoint at t = 0.04."""
    nv.case.resume(run, settings=["time.dt=0.03", "time.until=0.07"])
    with pytest.raises(
        nv.CaseError, match=r"time\.until.*: 0\.12: expected a multiple of dt = 0\.03 after t = 0\.04"
    ):
        nv.case.resume(run, settings=["time.until=0.12"])
    assert nv.case.resume(run, 0.1).number == 4
    with pytest.raises(
        nv.CaseError, match=r"time\.until.*0\.14: expected a multiple of dt = 0\.025 after t = 0\.1"
    ):
        nv.case.resume(run, 0.125, settings=["time.dt=0.025", "time.until=0.14"])
    nv.case.resume(run, 0.125, settings=["time.dt=0.025", "time.until=0.15"])
    simulation = nv.case.resume(run)  # the case in the directory can be resumed without an end
    assert simulation.t == pytest.approx(0.15) and nv.load(run).time == simulation.t
    assert np.diff(nv.read_ledger(run / "run.h5")["time"]) == pytest.approx(
        [0.02] * 2 + [0.03] * 2 + [0.025] * 2
    )


def test_a_run_goes_on_after_a_second_change_that_the_disk_has_refused(run, monkeypatch):
    """The first change has no checkpoint yet; the second one is in versions.json, but not in case.toml."""
    write = runs.write_atomically

    def stops(place, case, simulation, *others):
        raise KeyboardInterrupt

    def is_full(path, content):
        if path.name == "case.toml":
            raise OSError("no space left")
        write(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(runs, "_go", stops)
        with pytest.raises(KeyboardInterrupt):
            nv.case.resume(run, settings=["material.G_e=6", "time.until=0.06"])
        patch.setattr(runs, "write_atomically", is_full)
        with pytest.raises(OSError, match="no space left"):
            nv.case.resume(run, settings=["material.G_e=7"])
    assert nv.case.resume(run).t == pytest.approx(0.06)
    assert nv.load(run).case.sections.material.G_e == 6


def test_a_change_of_other_keys_within_a_halved_step_keeps_the_ends_of_the_steps(tmp_path, monkeypatch):
    """The checkpoint of a run that was stopped within a step lies at no multiple of dt."""

    class Stops(Observer):
        def step(self, simulation, row):
            simulation.stop_requested = simulation.number == 1

    place = tmp_path / "run"
    with monkeypatch.context() as patch:
        refuse_steps(patch, lambda interval: interval.tau > 0.015)
        nv.case.run(case(tmp_path), place, observers=[Stops()])
    assert nv.load(place).time == pytest.approx(0.01)
    simulation = nv.case.resume(place, settings=["material.G_e=6"])
    assert simulation.t == pytest.approx(0.04) and simulation.step_number == 2


def test_files_of_a_resumed_run_are_written_at_multiples_of_the_interval_that_its_steps_meet(tmp_path):
    """The times begin at the checkpoint if the resumed steps, counted back, do not meet t = 0."""
    place, interval = tmp_path / "run", ["output.vtk.enabled=true", "output.vtk.interval=0.06"]
    nv.case.run(case(tmp_path, *interval), place)
    nv.case.resume(place, settings=["time.dt=0.01", "time.until=0.07"])
    assert times_of_files(place) == pytest.approx([0, 0.06, 0.07])
    nv.case.resume(place, settings=["time.dt=0.03", "time.until=0.16"])
    assert times_of_files(place) == pytest.approx([0, 0.06, 0.07, 0.13, 0.16])
    nv.case.resume(place, 0.19)
    assert times_of_files(place) == pytest.approx([0, 0.06, 0.07, 0.13, 0.19])


def times_of_files(place):
    listed = (place / "vtk" / "fields.pvd").read_text()
    return [float(time) for time in re.findall(r'timestep="([^"]*)"', listed)]


def test_an_end_time_is_moved_to_the_nearest_end_of_a_step(run):
    """The end may be off by a thousandth of dt, because a time in other units is known to some digits
    only."""
    assert nv.case.resume(run, 0.06 + 1e-5).t == pytest.approx(0.06, rel=1e-15)
    log = (run / "log.txt").read_text()
    assert (
        "the run ends at 0.06 s, the end of a step nearest to 0.06001 s" in log
        and "finished at t = 0.06 s" in log
    )
    with pytest.raises(nv.ParameterError, match=r"until = 0.08003: expected a multiple of dt"):
        nv.case.resume(run, 0.08 + 3e-5)


def test_an_interrupted_change_is_completed_by_the_next_resume(run, monkeypatch):
    """The run was killed after it wrote the new case.toml, and before the first checkpoint of the changed
    run."""
    from ngvisco.case import runs

    with monkeypatch.context() as patch:
        patch.setattr(runs, "_go", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            nv.case.resume(run, settings=["material.G_e=6"])
    assert nv.case.resume(run, 0.06).model.material.G_e == 6
    assert nv.read_ledger(run / "run.h5")["transfer"][-1] < -2


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        (
            "domain.maxh=0.3",
            r"domain.maxh \(set on the command line\): this key cannot change when a run goes on",
        ),
        ("discretisation.k=3", "discretisation.k .*cannot change"),
        ("material.kind=LinearElastic", r"material.kind \(set on the command line\): this key cannot change"),
        ("material.kind=unknown", "material.kind .*cannot change"),
        ("domain.geometry=disc", "domain.geometry .*cannot change"),
        ("initial.density=2", "initial.density .*cannot change"),
        ("material.thermal={c=1.0, theta_R=300.0}", "material.thermal .*cannot change"),
        ("output.passive=['F_tot']", "output.passive .*--from"),
        ("time.dt=-1", "time.dt .*-1.0: expected"),
        ("time.until=0.05", r"time.until .*: 0\.05: expected a multiple of dt = 0\.02$"),
        ("material.Ge=1", "did you mean 'G_e'"),
        ("rheology.hyperviscosity.mu=1e-3", "the checkpoint has spaces = "),
        ("output.probes=[{name='a', point=[3, 3]}]", "output.probes.0.point"),
        ("time.until=0.02", "time.until .*expected a time after t = 0.04 s"),
    ],
)
def test_a_change_of_a_fixed_key_is_refused_and_nothing_is_written(run, setting, message):
    before = contents(run)
    with pytest.raises((nv.CaseError, nv.CheckpointError, nv.RunDirectoryError), match=message):
        nv.case.resume(run, settings=[setting])
    assert contents(run) == before


def test_a_new_run_starts_from_an_earlier_one(run, tmp_path):
    new = tmp_path / "new"
    simulation = nv.case.run(case(tmp_path, "domain.maxh=0.4", "time.until=0.08"), new, source=run)
    assert simulation.number == 2 and simulation.t == pytest.approx(0.08)
    ledger, old = nv.read_ledger(new / "run.h5"), nv.read_ledger(run / "run.h5")
    assert ledger["time"][0] == 0.04 and ledger["mass"] == pytest.approx(old["mass"][-1], rel=1e-13)
    energy = [book["kinetic"] + book["stored"] for book in (old, ledger)]
    assert ledger["transfer"][0] == pytest.approx(energy[0][-1] - energy[1][0], abs=1e-12)
    assert "the transfer scaled the density" in (new / "log.txt").read_text()
    assert json.loads((new / "versions.json").read_text())["from"]["step"] == 2
    shutil.rmtree(run)  # the new run does not need the files of the earlier run
    assert nv.case.resume(new, 0.1).number == 3
    assert np.isfinite(nv.load(new).ledger["kinetic"]).all()


@pytest.mark.parametrize(
    ("settings", "source", "message"),
    [
        ([], "nowhere", "this directory does not exist"),
        (["domain.size=[2, 1]", "time.until=0.06"], "run", "volume"),
        (["material.kind='LinearElastic'"], "run", "epsilon"),
        (["material.elastic_state='B'", "time.until=0.06"], "run", "take the material and the elastic_state"),
        (["time.until=0.02"], "run", "time.until.*after t = 0.04 s, which the run has already reached"),
        ([], "run", "time.until.*after t = 0.04 s, which the run has already reached"),
        (["time.dt=0.03", "time.until=0.06"], "run", "a multiple of dt = 0.03 after t = 0.04"),
        (["time.until=0.05"], "nowhere", "this directory does not exist"),
    ],
)
def test_a_new_run_whose_earlier_run_does_not_fit_is_refused_and_writes_nothing(
    run, tmp_path, settings, source, message
):
    with pytest.raises(nv.NgviscoError, match=message):
        nv.case.run(case(tmp_path, *settings), tmp_path / "new", source=tmp_path / source)
    assert not contents(tmp_path / "new") if (tmp_path / "new").exists() else True


def test_the_end_of_a_run_from_another_is_counted_from_its_start(run, tmp_path):
    """Also if the run is stopped before its first state is written, and resumed with another step."""
    new, settings = tmp_path / "new", ["time.dt=0.03", "time.until=0.1"]
    assert nv.case.run(case(tmp_path, *settings), new, source=run).number == 2
    assert nv.case.resume(new, 0.13).number == 3
    for path in (new / "run.h5", new / "ledger.csv"):
        path.unlink()
    assert nv.case.resume(new, settings=["time.dt=0.015", "time.until=0.085"]).number == 3


def test_force_removes_nothing_if_the_earlier_run_has_passed_the_end(run):
    before = contents(run)
    with pytest.raises(nv.CaseError, match=r"time\.until: .*already reached"):
        nv.case.run(case(run), run, source=run, force=True)
    assert contents(run) == before
