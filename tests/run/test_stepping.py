"""Lengths of steps: given, adaptive or halved; rejected steps, growing steps, and steps after a restart."""

import io

import numpy as np
import pytest
from ngsolve import sin
from support import Rejections, assert_goes_on, by_ci, state, swirling
from support import state as values

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.frames import read_frame
from ngvisco.solver.newton import Newton
from ngvisco.solver.options import SplitOptions
from ngvisco.solver.problem import Solution, Status
from ngvisco.solver.split.solver import Split
from ngvisco.timestepping.error import ErrorEstimate


def simulation(stepping=None, observers=(), dt=0.02):
    return swirling(
        dt=dt,
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-4),
        loads=[nv.Gravity((0.0, sin(3 * nv.time)))],
        adaptive=stepping,
        observers=observers,
    )


def refuse(run, monkeypatch, is_refused):
    """Let the solver fail at the steps (t, tau) for which ``is_refused`` holds."""
    solve = run.solver.solve

    def refusing(interval):
        if is_refused(interval.begin, interval.tau):
            raise nv.StepError(f"refused {interval.tau:g}")
        return solve(interval)

    monkeypatch.setattr(run.solver, "solve", refusing)


def test_output_times_are_met_exactly_and_the_ledger_closes(tmp_path):
    stops = [0.03, 0.1, 1 / 7]
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04, patience=1)
    series = nv.VTKSeries(tmp_path, every=None, fields=["density"], times=stops)
    run = simulation(stepping, [series], dt=0.013)
    ledger = run.run(0.2, stops=stops)
    times = ledger.column("time")
    assert {*stops, 0.2} <= set(times)  # the times are equal to the last bit
    assert [time for time, _ in series.files.written] == [0.0, *stops, 0.2]
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert np.allclose(np.diff(times), ledger.column("dt")[1:], rtol=1e-12)
    assert ledger.column("dt").max() <= 0.04


def test_a_failed_step_is_halved_and_recorded_and_later_steps_grow(monkeypatch):
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04, patience=2)
    run = simulation(stepping, dt=0.04, observers=[watch := Rejections()])
    refuse(run, monkeypatch, lambda t, tau: t < 0.02 and tau > 0.011)
    ledger = run.run(0.16)
    assert [(r.time, r.tau) for r in watch.seen] == [(0.0, 0.04), (0.0, 0.02)]
    assert "refused 0.04" in watch.seen[0].reason
    assert list(ledger.column("rejections")[:3]) == [0, 2, 0]
    assert list(ledger.column("dt")[1:4]) == [0.01, 0.01, 0.02]
    assert ledger.column("dt").max() == 0.04  # the steps have grown to their first length


@pytest.mark.parametrize("why", ["too long", by_ci("the error constant")])
def test_a_rejected_step_leaves_no_trace(why, monkeypatch):
    """After a rejected step, the state equals that of a run that took the shorter step at once."""
    tolerance = 1e-3 if why == "the error constant" else None
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04, patience=9, tolerance=tolerance)
    run, short = simulation(stepping, dt=0.04), simulation(stepping, dt=0.02)
    run.observers.append(watch := Rejections())
    if why == "the error constant":
        error = lambda self, t, _: 1.0 if t - self._times[-1] > 0.03 else None  # noqa: E731
        monkeypatch.setattr(ErrorEstimate, "__call__", error)
    else:
        sound, tau = run.solver.defect, run.rothe_step.context.tau
        monkeypatch.setattr(run.solver, "defect", lambda: why if tau.Get() > 0.03 else sound())
    run.run(0.08)
    short.run(0.08)
    assert run.ledger.column("rejections").sum() == 1
    assert (why if tolerance is None else "error") in watch.seen[0].reason
    assert np.array_equal(values(run), values(short))


def test_a_run_that_needs_a_step_below_the_minimum_ends_with_its_attempts(tmp_path, monkeypatch):
    stepping = nv.AdaptiveSteps(dt_min=0.004, dt_max=0.02)
    files = [nv.LedgerCSV(tmp_path / "ledger.csv"), nv.Checkpoints(tmp_path / "run.h5", every=100)]
    run = simulation(stepping, files)
    refuse(run, monkeypatch, lambda t, tau: t > 0.03)
    tried = r"dt_min = 0.004 s from t = 0.04 s .*0.02 s \(refused 0.02\); 0.01 s \(refused 0.01\); 0.005 s"
    with pytest.raises(nv.StepError, match=tried):
        run.run(0.2)
    # the file has a header and rows 0 to 2
    assert len((tmp_path / "ledger.csv").read_text().splitlines()) == 4
    again = simulation(stepping)
    again.restore(tmp_path / "run.h5")
    assert (again.number, again.t) == (2, run.t)
    assert np.array_equal(values(again), values(run))


MODEL = nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=1.0))
ADAPTIVE = nv.AdaptiveSteps(dt_min=0.01, dt_max=0.2)


def elastic(**options):
    return nv.Simulation(box((1, 1), 1.0), MODEL, **options)


def test_time_steps_and_separate_arguments_are_equivalent():
    steps = nv.TimeSteps(
        dt=0.1, scheme="midpoint", startup=2, limiter=False, velocity_scale=3.0, adaptive=ADAPTIVE
    )
    new = elastic(time=steps)
    short = elastic(dt=0.1, scheme="midpoint", startup=2, adaptive=ADAPTIVE, limiter=False, velocity_scale=3)
    for run in (new, short):
        assert (run.dt, run.velocity_scale, run.is_adaptive, run.scheme.name) == (0.1, 3.0, True, "midpoint")
        assert run.integrator.startup == 2 and run.bounds.limits is False


def test_an_unknown_argument_is_refused_with_the_nearest_name():
    with pytest.raises(TypeError, match=r"Simulation\(\): .* argument 'shceme'; did you mean 'scheme'"):
        elastic(dt=0.1, shceme="midpoint")


DT = 0.04


def halving(**options):
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
    run = halving(observers=[watch])
    ledger = run.run(3 * DT)
    # the first step ends with quarters, so that the second one begins with halves, each of which fails once
    assert ledger.column("dt")[1:] == pytest.approx([DT / 4] * 12)
    assert ledger.column("time")[[4, 8, 12]].tolist() == [DT, 2 * DT, 3 * DT]
    assert [r.tau for r in watch.seen] == pytest.approx([DT, DT / 2, DT / 2, DT / 2])
    assert ledger.column("rejections").sum() == 4
    assert "stalled; the step is taken in parts of 0.01 s" in watch.seen[1].reason
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-12


@pytest.mark.long
@pytest.mark.ci
def test_output_intervals_count_whole_steps(monkeypatch, tmp_path):
    """Only the second step is divided into quarters; a resumed run keeps what was written before."""

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
    run = halving(observers=observers)
    run.run(6 * DT)
    assert run.ledger.column("dt")[1:] / DT == pytest.approx([1, *[0.25] * 4, 0.5, 0.5, 1, 1, 1])
    assert run.number == 10 and run.step_number == 6
    whole = [0, 2 * DT, 4 * DT, 6 * DT]
    assert probes.column("time").tolist() == pytest.approx(whole)
    assert [time for time, _ in vtk.files.written] == pytest.approx([0, 3 * DT, 6 * DT])
    text = lines.getvalue()
    assert "step     2/6  t 0.08 s" in text and "step     2/6  t 0.04 s  rejected" in text
    assert "after 6 steps in 10 parts" in text and "step     3/6" not in text
    for row, step, end in ((8, 4, 4.0), (4, 2, 1.75)):
        probes = nv.Probes({"a": (0.4, 0.3)}, ["velocity"], tmp_path / "probes.csv", every=2)
        again = halving(observers=[probes])
        again.restore(tmp_path / "run.h5", step=row)
        assert again.step_number == step and again.t == pytest.approx(end * DT)
        again.run(6 * DT)
        assert probes.column("time").tolist() == pytest.approx(whole)


def test_the_number_of_halvings_is_an_option(monkeypatch):
    fails_above(monkeypatch, DT / 2)
    run = halving(halvings=0)
    with pytest.raises(nv.StepError, match="stalled"):
        run.advance()


@pytest.mark.parametrize("halvings", [0, 1])
def test_auto_uses_the_other_solver_if_no_part_of_a_step_is_solved(halvings, monkeypatch):
    """The coupled solver takes two steps; then the split solver is asked again, fails again, and is asked
    again after four more steps."""
    calls = []
    fails_above(monkeypatch, 0.0, calls)
    monkeypatch.setattr("ngvisco.solver.turns.WAIT", 2)
    newton = nv.NewtonOptions(split=SplitOptions(chosen_from=(1, 1)))
    watch = Rejections()
    run = halving(solver="auto", newton=newton, halvings=halvings, observers=[watch])
    ledger = run.run(5 * DT)
    assert ledger.column("dt")[1:] == pytest.approx([DT] * 5)
    attempts = 2 * (halvings + 1)  # the first step and the third step are tried with all halvings
    assert len(watch.seen) == attempts and run.solver.method == "coupled"
    assert (
        "the coupled solver tries this step and, on success, takes the next 2 steps"
        in watch.seen[halvings].reason
    )
    assert "takes the next 4 steps" in watch.seen[-1].reason
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-12


def test_adaptive_steps_turn_to_the_other_solver_after_failures(monkeypatch):
    fails_above(monkeypatch, 0.0)
    newton = nv.NewtonOptions(split=SplitOptions(chosen_from=(1, 1)))
    steps = nv.AdaptiveSteps(dt_min=DT / 2, dt_max=DT)
    run = halving(solver="auto", newton=newton, adaptive=steps)
    assert run.run(2 * DT).column("rejections").tolist() == [0, 2, 0]


def test_the_message_of_a_step_that_neither_solver_solves_names_both_solvers(monkeypatch):
    fails_above(monkeypatch, 0.0)
    monkeypatch.setattr(Newton, "solve", lambda *given: Solution(Status.STALLED, (), "no"))
    newton = nv.NewtonOptions(split=SplitOptions(chosen_from=(1, 1)))
    for solver, said in (
        ("auto", "no; the split solver has not solved the step either"),
        ("split", "the coupled solver cannot take the step instead, since solver.method is 'split'"),
    ):
        run = halving(solver=solver, newton=newton, halvings=0)
        with pytest.raises(nv.StepError, match=said):
            run.advance()


def test_a_restart_continues_with_the_solver_in_use(tmp_path, monkeypatch):
    fails_above(monkeypatch, 0.0)
    newton = nv.NewtonOptions(split=SplitOptions(chosen_from=(1, 1)))

    def made(**options):
        return halving(solver="auto", newton=newton, halvings=0, **options)

    assert_goes_on(made, tmp_path / "run.h5", 4 * DT, 2)


@pytest.mark.parametrize("solver", [by_ci("split"), "coupled"])
def test_a_run_stopped_within_a_step_is_resumed_bitwise(solver, tmp_path):
    """The stop comes in the third iteration of the second step; the written state is the end of the first
    step."""
    whole = halving(solver=solver)
    whole.run(3 * DT)
    files = [nv.Checkpoints(tmp_path / "run.h5", every=100)]
    run, polls = halving(solver=solver, observers=files), []

    def asked():
        polls.append(run.number)
        if polls.count(1) == 3:
            run.request_stop()
        return wanted()

    wanted, run.solver.interrupted = run.solver.interrupted, asked
    run.run(3 * DT)
    assert (run.number, run.t, polls.count(1)) == (1, DT, 3) and run.stop_requested
    again = halving(solver=solver)
    again.restore(tmp_path / "run.h5")
    for one in (again, run):  # the stopped run itself can go on, too
        one.run(3 * DT)
        assert (one.number, state(one).tobytes()) == (3, state(whole).tobytes())


def test_a_run_that_is_asked_to_stop_while_it_writes_begins_no_further_step(tmp_path):
    """The request to stop comes while an observer writes. The file is completed, and the other observers
    write too."""

    class Asked(nv.VTKSeries):
        def step(self, simulation, row):
            simulation.request_stop()
            super().step(simulation, row)

    series = Asked(tmp_path, every=1)
    run = halving(observers=[series, nv.Checkpoints(tmp_path / "run.h5", every=100)])
    run.run(3 * DT)
    assert (run.number, run.t) == (1, DT) and [time for time, _ in series.files.written] == [0.0, DT]
    assert len(read_frame(tmp_path / series.files.written[-1][1]).cells) == run.mesh.ne
    again = halving()
    again.restore(tmp_path / "run.h5")
    assert again.number == 1


def test_restart_within_a_step_is_bitwise_identical(tmp_path, monkeypatch):
    fails_above(monkeypatch, DT / 4)
    # the checkpoint is at three quarters of the first step
    whole = assert_goes_on(halving, tmp_path / "run.h5", 2 * DT, 3)
    assert whole.ledger.column("time")[3] == pytest.approx(0.75 * DT) and whole.t == 2 * DT


def test_a_run_ends_before_a_part_of_a_step_that_is_not_solved(monkeypatch):
    calls, watch = [], Rejections()
    fails_above(monkeypatch, 0.0, calls)
    run = halving(observers=[watch])
    before = state(run)
    with pytest.raises(nv.StepError, match="stalled"):
        run.advance()
    assert (state(run) == before).all() and run.number == 0
    assert min(calls) == pytest.approx(DT / 8)
    assert [r.tau for r in watch.seen] == pytest.approx([DT, DT / 2, DT / 4])


@pytest.mark.parametrize("name", ["dt", "startup", "adaptive", "model", "walls", "solver"])
def test_an_argument_of_a_run_cannot_be_assigned_later(name):
    run = simulation()
    said = rf"Simulation\.{name} = 0\.1: .* Simulation\.on, .* nv\.transfer"
    with pytest.raises(nv.ParameterError, match=said):
        setattr(run, name, 0.1)
    run.observers, run.note = [], "an attribute of the user"
    assert run.dt == 0.02 and run.advance()["dt"] == 0.02


def test_a_run_is_made_again_with_another_step_length_and_the_same_scheme():
    run = swirling(dt=0.02, scheme="midpoint")
    again = run.on(run.mesh, dt=0.01)
    assert (again.dt, again.arguments["time"].scheme) == (0.01, "midpoint") and run.dt == 0.02
