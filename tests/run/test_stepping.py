"""Adaptive steps: rejected, halved, grown again, exact at output times, reproduced by a restart."""

import math

import numpy as np
import pytest
from ngsolve import GridFunction, InnerProduct, Integrate, cos, pi, sin, x, y
from support import StopAt
from support import state as values

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.timestepping.error import ErrorEstimate

LONG = (pytest.mark.long, pytest.mark.ci)


def simulation(stepping=None, observers=(), dt=0.02, scale=1.0, scheme="backward-euler"):
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-4),
        loads=[nv.Gravity((0.0, sin(3 * nv.time)))],
    )
    velocity = (scale * sin(pi * x) * cos(pi * y), -scale * cos(pi * x) * sin(pi * y))
    initial = nv.Initial(velocity=velocity)
    return nv.Simulation(
        box((1, 1), maxh=0.5),
        model,
        time=nv.TimeSteps(dt=dt, scheme=scheme, adaptive=stepping),
        initial=initial,
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


def test_checkpoints_do_not_change_a_run(tmp_path):
    plain, watched = simulation(), simulation(observers=[nv.Checkpoints(tmp_path / "run.h5", every=2)])
    plain.run(0.1)
    watched.run(0.1)
    assert np.array_equal(values(plain), values(watched))


@pytest.mark.long
@pytest.mark.ci
def test_an_adaptive_run_that_was_stopped_is_resumed_bit_for_bit(tmp_path):
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.08, tolerance=3e-3, patience=2)
    whole = simulation(stepping)
    whole.run(0.3, stops=[0.155])
    assert len(set(np.round(whole.ledger.column("dt")[1:], 12))) > 2  # lengths do change
    assert whole.ledger.column("rejections").sum() > 0
    assert np.abs(whole.ledger.column("closure_relative")).max() <= 1e-10
    run = simulation(stepping, observers=[nv.Checkpoints(tmp_path / "run.h5", every=100), StopAt(6)])
    run.run(0.3, stops=[0.155])
    rest = simulation(stepping)
    rest.restore(tmp_path / "run.h5")
    ledger = rest.run(0.3, stops=[0.155])
    assert np.array_equal(values(whole), values(rest))
    for name in ("time", "dt", "closure", "rejections", "newton_iterations"):
        assert list(ledger.column(name)) == list(whole.ledger.column(name))


def test_output_times_are_met_exactly_and_the_ledger_closes(tmp_path):
    stops = [0.03, 0.1, 1 / 7]
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04, patience=1)
    series = nv.VTKSeries(tmp_path, every=None, fields=["density"], times=stops)
    run = simulation(stepping, [series], dt=0.013)
    ledger = run.run(0.2, stops=stops)
    times = ledger.column("time")
    assert {*stops, 0.2} <= set(times)  # equal to the last bit
    assert [time for time, _ in series.written] == [0.0, *stops, 0.2]
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert np.allclose(np.diff(times), ledger.column("dt")[1:], rtol=1e-12)
    assert ledger.column("dt").max() <= 0.04


def test_a_failed_step_is_halved_recorded_and_grown_again(monkeypatch):
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04, patience=2)
    seen = []
    run = simulation(stepping, dt=0.04)
    run.observers.append(Watcher(seen))
    refuse(run, monkeypatch, lambda t, tau: t < 0.02 and tau > 0.011)
    ledger = run.run(0.16)
    assert [(r.time, r.tau) for r in seen] == [(0.0, 0.04), (0.0, 0.02)]
    assert "refused 0.04" in seen[0].reason
    assert list(ledger.column("rejections")[:3]) == [0, 2, 0]
    assert list(ledger.column("dt")[1:4]) == [0.01, 0.01, 0.02]
    assert ledger.column("dt").max() == 0.04  # grown back


class Watcher(StopAt):
    def __init__(self, seen):
        super().__init__(math.inf)
        self.seen = seen

    def rejected(self, simulation, rejection):
        self.seen.append(rejection)


def test_lost_positivity_rejects_the_step(monkeypatch):
    run = simulation(nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.02), dt=0.02)
    run.observers.append(Watcher(seen := []))
    sound = run.solver.defect
    tau = run.rothe_step.context.tau
    monkeypatch.setattr(
        run.solver, "defect", lambda: "J is not positive (minimum -1)" if tau.Get() > 0.015 else sound()
    )
    run.run(0.02)
    assert "J is not positive" in seen[0].reason
    assert run.ledger.column("dt")[1] == 0.01


def test_a_rejected_step_leaves_no_trace(monkeypatch):
    """The state after a rejection is that of a run that took the short step at once."""
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04, patience=9)
    run, short = simulation(stepping, dt=0.04), simulation(stepping, dt=0.02)
    sound = run.solver.defect
    tau = run.rothe_step.context.tau
    monkeypatch.setattr(run.solver, "defect", lambda: "too long" if tau.Get() > 0.03 else sound())
    run.run(0.08)
    short.run(0.08)
    assert run.ledger.column("rejections")[1] == 1
    assert np.array_equal(values(run), values(short))


def test_a_step_rejected_for_its_error_leaves_no_trace(monkeypatch):
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04, patience=9, tolerance=1e-3)
    run, short = simulation(stepping, dt=0.04), simulation(stepping, dt=0.02)
    monkeypatch.setattr(
        ErrorEstimate, "__call__", lambda self, t, _: 1.0 if t - self._times[-1] > 0.03 else None
    )
    run.run(0.08)
    short.run(0.08)
    assert list(run.ledger.column("rejections")) == [0, 1, 0, 0, 0]
    assert np.array_equal(values(run), values(short))


def test_below_the_minimum_the_run_ends_with_what_was_tried(tmp_path, monkeypatch):
    stepping = nv.AdaptiveSteps(dt_min=0.004, dt_max=0.02)
    files = [nv.LedgerCSV(tmp_path / "ledger.csv"), nv.Checkpoints(tmp_path / "run.h5", every=100)]
    run = simulation(stepping, files)
    refuse(run, monkeypatch, lambda t, tau: t > 0.03)
    tried = r"dt_min = 0.004 s from t = 0.04 s .*0.02 s: refused 0.02; 0.01 s: refused 0.01; 0.005 s: refused"
    with pytest.raises(nv.StepError, match=tried):
        run.run(0.2)
    assert len((tmp_path / "ledger.csv").read_text().splitlines()) == 4  # header and rows 0 to 2
    again = simulation(stepping)
    again.restore(tmp_path / "run.h5")
    assert (again.number, again.t) == (2, run.t)
    assert np.array_equal(values(again), values(run))


@pytest.mark.parametrize(
    "scheme", ["midpoint", pytest.param("backward-euler", marks=LONG), pytest.param("sdirk2", marks=LONG)]
)
def test_the_estimate_is_the_local_error(scheme):
    """Against twelve short steps over the same interval; and it falls like tau to the order plus one."""
    estimates = []
    for tau in (0.008, 0.004):
        stepping = nv.AdaptiveSteps(dt_min=tau, dt_max=tau, tolerance=1.0)
        run = simulation(stepping, dt=tau, scale=0.2, scheme=scheme)
        run.run(0.024)
        start = values(run)
        estimates.append(run.advance()["error_estimate"])
        fine = simulation(dt=tau / 12, scale=0.2, scheme=scheme)
        fine.set_time(run.t - tau, round((run.t - tau) / (tau / 12)))
        fine.rothe_step.state.vec.FV().NumPy()[:] = start
        fine.run(fine.t + tau)
        # the error constant is that of linear problems
        assert estimates[-1] == pytest.approx(_difference(run, values(fine)), rel=0.5)
    assert estimates[0] / estimates[1] == pytest.approx(2 ** (run.scheme.order + 1), rel=0.35)


def _difference(run, other):
    """The module's norm of (state - other), by integrals of its own."""
    layout, step = run.rothe_step.layout, run.rothe_step
    difference = GridFunction(layout.space)
    difference.vec.FV().NumPy()[:] = values(run) - other
    e, u = layout.fields(difference.components), step.now

    def size(f):
        return math.sqrt(Integrate(InnerProduct(f, f), run.mesh, order=8))

    floors = (run.velocity_scale, 0.0, 1.0)  # the domain's area is 1
    pairs = ((e.v, u.v), (e.rho, u.rho), (e.z, u.z))
    return max(size(d) / (size(f) + floor) for (d, f), floor in zip(pairs, floors, strict=True))


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"dt_min": 0.0, "dt_max": 1.0}, "dt_min"),
        ({"dt_min": 0.1, "dt_max": 0.01}, "dt_max"),
        ({"dt_min": 0.1, "dt_max": 1.0, "tolerance": -1.0}, "tolerance"),
        ({"dt_min": 0.1, "dt_max": 1.0, "patience": 0}, "patience"),
    ],
)
def test_wrong_bounds_raise(options, field):
    with pytest.raises(nv.ParameterError, match=f"AdaptiveSteps.{field}"):
        nv.AdaptiveSteps(**options)


def test_a_first_step_outside_the_bounds_raises():
    with pytest.raises(nv.ParameterError, match=r"TimeSteps\.dt = 0\.02"):
        simulation(nv.AdaptiveSteps(dt_min=0.03, dt_max=0.1))
