"""Steps of one length that are not solved are taken in halves."""

import io

import numpy as np
import pytest
from support import Rejections, assert_goes_on, state, swirling

import ngvisco as nv
from ngvisco.run.stepping import FixedStepper
from ngvisco.solver.problem import Solution, Status
from ngvisco.solver.split.solver import Split

DT = 0.04


def simulation(**options):
    laws = {
        "viscosity": nv.StokesViscosity(K_v=0.05, G_v=0.05),
        "hyperviscosity": nv.HyperViscosity(mu=1e-5, p=4),
    }
    return swirling(dt=DT, **{"solver": "split", "passive": ("reference_map",)} | laws | options)


def fails_above(monkeypatch, length, calls=None):
    """Let the split solver fail for steps above a length, s."""
    solve = Split.solve

    def limited(split, problem, guess):
        if calls is not None:
            calls.append(problem.interval.tau)
        if problem.interval.tau > length * (1 + 1e-9):
            return Solution(Status.STALLED, (), "stalled")
        return solve(split, problem, guess)

    monkeypatch.setattr(Split, "solve", limited)


def test_a_step_that_is_not_solved_is_taken_in_quarters_and_the_run_goes_on(monkeypatch):
    fails_above(monkeypatch, DT / 4)
    watch = Rejections()
    run = simulation(observers=[watch])
    ledger = run.run(3 * DT)
    # the second step begins with halves, as the first one ended with quarters; each then fails once
    assert ledger.column("dt")[1:] == pytest.approx([DT / 4] * 12)
    assert ledger.column("time")[[4, 8, 12]].tolist() == [DT, 2 * DT, 3 * DT]
    assert [r.tau for r in watch.seen] == pytest.approx([DT, DT / 2, DT / 2, DT / 2])
    assert ledger.column("rejections").sum() == 4
    assert "stalled; taken in parts of 0.01 s" in watch.seen[1].reason
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-12


def test_what_is_written_every_so_many_steps_counts_whole_steps(monkeypatch, tmp_path):
    """Only the second step is taken in quarters; a run that goes on keeps what was written before."""

    def fails_in_the_second(split, problem, guess):
        begin, tau = problem.interval.begin, problem.interval.tau
        if 0.99 * DT < begin < 1.99 * DT and tau > 1.01 * DT / 4:
            return Solution(Status.STALLED, (), "stalled")
        return solve(split, problem, guess)

    solve = Split.solve
    monkeypatch.setattr(Split, "solve", fails_in_the_second)
    lines = io.StringIO()
    probes = nv.Probes({"a": (0.4, 0.3)}, ["velocity"], tmp_path / "probes.csv", every=2)
    vtk = nv.VTKSeries(tmp_path / "vtk", every=3)
    checkpoints = nv.Checkpoints(tmp_path / "run.h5", every=2, keep=9)
    observers = [nv.Progress(6 * DT, every=2, stream=lines), probes, vtk, checkpoints]
    run = simulation(observers=observers)
    run.run(6 * DT)
    assert run.ledger.column("dt")[1:] / DT == pytest.approx([1, *[0.25] * 4, 0.5, 0.5, 1, 1, 1])
    assert run.number == 10 and run.step_number == 6
    whole = [0, 2 * DT, 4 * DT, 6 * DT]
    assert probes.column("time").tolist() == pytest.approx(whole)
    assert [time for time, _ in vtk.written] == pytest.approx([0, 3 * DT, 6 * DT])
    text = lines.getvalue()
    assert "step     2/6  t 0.08 s" in text and "step     2/6  t 0.04 s  rejected" in text
    assert "after 6 steps in 10 parts" in text and "step     3/6" not in text
    for row, step, end in ((8, 4, 4.0), (4, 2, 1.75)):
        probes = nv.Probes({"a": (0.4, 0.3)}, ["velocity"], tmp_path / "probes.csv", every=2)
        again = simulation(observers=[probes])
        again.restore(tmp_path / "run.h5", step=row)
        assert again.step_number == step and again.t == pytest.approx(end * DT)
        again.run(6 * DT)
        assert probes.column("time").tolist() == pytest.approx(whole)


def test_parts_are_the_steps_of_a_run_with_that_length(monkeypatch):
    """Passive fields and all: the same states, to the solver's tolerance."""
    whole = simulation()
    fails_above(monkeypatch, DT / 2)
    halved, plain = simulation(), simulation()
    plain.stepper = FixedStepper(DT / 2)
    for run in (halved, plain):
        run.run(2 * DT)
    assert halved.number == plain.number == 4 and whole.number == 0
    assert np.abs(state(halved) - state(plain)).max() <= 1e-8 * np.abs(state(plain)).max()
    for name, array in halved.passive.arrays().items():
        assert np.abs(array - plain.passive.arrays()[name]).max() <= 1e-8


def test_halvings_are_an_option(monkeypatch):
    fails_above(monkeypatch, DT / 2)
    run = simulation(halvings=0)
    with pytest.raises(nv.StepError, match="stalled"):
        run.advance()


def test_restart_within_a_step_is_bitwise_identical(tmp_path, monkeypatch):
    fails_above(monkeypatch, DT / 4)
    whole = assert_goes_on(simulation, tmp_path / "run.h5", 2 * DT, 3)  # three quarters of the first step
    assert whole.ledger.column("time")[3] == pytest.approx(0.75 * DT) and whole.t == 2 * DT


def test_a_part_that_is_not_solved_ends_the_run_there(monkeypatch):
    calls, watch = [], Rejections()
    fails_above(monkeypatch, 0.0, calls)
    run = simulation(observers=[watch])
    before = state(run)
    with pytest.raises(nv.StepError, match="stalled"):
        run.advance()
    assert (state(run) == before).all() and run.number == 0
    assert min(calls) == pytest.approx(DT / 8)
    assert [r.tau for r in watch.seen] == pytest.approx([DT, DT / 2, DT / 4])
