"""Adaptive steps: rejected, halved, grown again, exact at output times, reproduced by a restart."""

import numpy as np
import pytest
from ngsolve import sin
from support import Rejections, swirling
from support import state as values

import ngvisco as nv
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
    assert {*stops, 0.2} <= set(times)  # equal to the last bit
    assert [time for time, _ in series.written] == [0.0, *stops, 0.2]
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert np.allclose(np.diff(times), ledger.column("dt")[1:], rtol=1e-12)
    assert ledger.column("dt").max() <= 0.04


def test_a_failed_step_is_halved_recorded_and_grown_again(monkeypatch):
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04, patience=2)
    run = simulation(stepping, dt=0.04, observers=[watch := Rejections()])
    refuse(run, monkeypatch, lambda t, tau: t < 0.02 and tau > 0.011)
    ledger = run.run(0.16)
    assert [(r.time, r.tau) for r in watch.seen] == [(0.0, 0.04), (0.0, 0.02)]
    assert "refused 0.04" in watch.seen[0].reason
    assert list(ledger.column("rejections")[:3]) == [0, 2, 0]
    assert list(ledger.column("dt")[1:4]) == [0.01, 0.01, 0.02]
    assert ledger.column("dt").max() == 0.04  # grown back


@pytest.mark.parametrize("why", ["too long", "its error"])
def test_a_rejected_step_leaves_no_trace(why, monkeypatch):
    """The state after a rejection is that of a run that took the short step at once."""
    tolerance = 1e-3 if why == "its error" else None
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04, patience=9, tolerance=tolerance)
    run, short = simulation(stepping, dt=0.04), simulation(stepping, dt=0.02)
    run.observers.append(watch := Rejections())
    if why == "its error":
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


def test_a_first_step_outside_the_bounds_raises():
    with pytest.raises(nv.ParameterError, match=r"TimeSteps\.dt = 0\.02"):
        simulation(nv.AdaptiveSteps(dt_min=0.03, dt_max=0.1))
