"""Reports of a step that cannot be taken: place, fault, cause and remedy."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import annulus, box, structured_box
from ngvisco.run.failure import FailureReport, showing, write_failure
from ngvisco.solver.problem import Attempt, NewtonIteration, Solution, Status
from tests.verification.setups import lid_driven

ROUNDING = r"rounding of the equations.*a larger solver\.tolerance or density"

DT = 0.05


def cavity(limiter=True, **options):
    steps = nv.AdaptiveSteps(dt_min=0.9 * DT, dt_max=DT)
    time = nv.TimeSteps(dt=DT, adaptive=steps, limiter=limiter)
    return lid_driven(box((1, 1), 0.25), time=time, **options)


@pytest.fixture(scope="module")
def failed():
    """A run whose step was refused, and its error; not to be changed."""
    run = cavity(limiter=False, solver="split")
    with pytest.raises(nv.StepError) as caught:
        run.run(0.45)
    return run, caught.value


def test_a_refused_solution_is_reported_with_place_quantity_history_and_advice(failed):
    run, error = failed
    report = error.report
    assert report.violation.quantity == "det F" and report.violation.wall == "left"
    assert run.mesh(*report.violation.point).nr == report.violation.cell or report.violation.distance == 0
    assert report.number == run.number + 1 and report.time == run.t and report.tau == DT
    assert report.history and report.state.shape == (len(run.rothe_step.state.vec),)
    text = str(report)
    for words in ("det F is not positive", "'left'", "iterations", 'elastic_state = "B"'):
        assert words in text
    above, below = text.split("\n" + 80 * "-" + "\n")
    what, change, reached = above.splitlines()
    assert "det F is not positive" in what and f"in cell {report.violation.cell} at (" in what
    assert "time.limiter = true" in change and f"t = {run.t:.6g} s" in reached
    assert "limiter = True" not in text and "AdaptiveSteps" not in text
    assert len(below.splitlines()) <= 20 and max(map(len, text.splitlines())) < 400


@pytest.mark.parametrize("stiffness", [0.0, 1e10])
def test_rounding_is_reported_where_only_inertia_holds_a_stiff_body(stiffness):
    """Steps are long compared with the passage of waves. In one of the runs weak springs hold the body."""
    pressures = {"left": 1e6 * nv.time, "right": 1e6 * nv.time, "top": 0.0, "bottom": 0.0}
    springs = (stiffness, stiffness)
    run = nv.Simulation(
        structured_box((0.1, 0.1), (2, 2)),
        nv.Model(material=nv.ReferentialNeoHookean(K_e=1e12, G_e=4e10)),
        time=nv.TimeSteps(dt=0.05, halvings=0),
        initial=nv.Initial(density=1e3),
        walls={name: nv.Open(pressure=p, stiffness=springs) for name, p in pressures.items()},
        solver="coupled",
    )
    if stiffness:
        assert run.run(0.05).rows[-1]["time"] == 0.05
        return
    with pytest.raises(nv.StepError, match="the increment is rounding of the equations") as caught:
        run.run(0.05)
    assert "change     springs (walls.NAME.stiffness)" in str(caught.value.report)


def relaxing(heat_capacity, theta_R=293.0):
    """A strip with heat and hardly any inertia, sheared in the first step and then held."""
    solid = nv.LinearElastic(K_e=10.0, G_e=1.0)
    heated = nv.Thermal(material=solid, c=heat_capacity, theta_R=theta_R, expansion=1e-4)
    return nv.Simulation(
        structured_box((0.5, 1.0), (2, 2), periodic="x"),
        nv.Model(material=heated, creep=nv.Creep(G_m=2.0)),
        dt=0.01,
        scheme="sdirk2",
        initial=nv.Initial(density=1e-8, temperature=295.0),
        walls={
            "bottom": nv.NoSlip(),
            "top": nv.PrescribedTangential((0.1 * nv.pulse(0.0, 0.01), 0.0)),
        },
        solver="coupled",
    )


def test_a_strip_with_heat_and_hardly_any_inertia_relaxes_in_spite_of_rounding():
    """While the velocity goes to zero, rounding of the heat moves the strip by more than the tolerance, but
    by less than 1e-10 of a cell in a step."""
    run = relaxing(1e3)
    run.run(0.1)
    exact = 0.1 * (1 - np.exp(-0.01)) * np.exp(-0.09)  # Pa, with the relaxation time G_m/(2 G_e) = 1 s
    stress = run.fields["cauchy_stress"](run.mesh(0.1, 0.3))
    assert stress[1] == pytest.approx(exact, rel=2e-3)
    assert max(run.ledger.column("closure_relative")) < 1e-13


def test_rounding_of_large_entropies_is_named_with_its_remedies():
    """A large heat capacity causes rounding of the entropy. With the start's temperature as reference
    temperature there is none."""
    with pytest.raises(nv.StepError, match=ROUNDING) as caught:
        relaxing(1e7).run(0.1)
    text = str(caught.value.report)
    assert "solver.tolerance" in text and "thermal.theta_R near the temperature at the start" in text
    assert relaxing(1e7, theta_R=295.0).run(0.03).rows[-1]["time"] == pytest.approx(0.03)


def ring(**options):
    """A light ring that only inertia holds, pressed from inside, with steps longer than a wave's passage."""
    return nv.Simulation(
        annulus(1.0, 2.0, 0.8),
        nv.Model(material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0)),
        dt=0.5,
        halvings=0,
        initial=nv.Initial(density=options.pop("density", 1e-3)),
        walls={"inner": nv.Open(pressure=0.1), "outer": nv.Open()},
        newton=nv.NewtonOptions(method="split", **options),
    )


def test_rounding_that_moves_a_light_ring_is_measured_by_the_split_solver_and_its_remedies_help():
    with pytest.raises(nv.StepError, match=ROUNDING):
        ring().run(2.0)
    for run in (ring(tolerance=1e-8), ring(density=0.1)):
        run.run(2.0)
        assert abs(run.ledger.column("closure_relative")).max() < 1e-12


def test_attempts_from_the_same_start_are_reported_in_one_line():
    """The report of a step with many attempts fits on one screen."""
    stalled = Solution(Status.STALLED, (NewtonIteration(3.0, 1.0, 1.0, True),) * 9, "as it was said")
    solved = Solution(Status.CONVERGED, (NewtonIteration(1e-12, 0.1, 1.0, True),))
    attempts = [Attempt("from the last state", one) for one in [stalled, solved] * 15]
    report = FailureReport(
        0.1, 0.05, 3, "no", None, None, 0.2, 1, (0.5, 0.5), "top", tuple(attempts), ("a", "b")
    )
    (line,) = [line for line in str(report).splitlines() if line.startswith("tried")]
    assert "from the last state: 150 iterations in 30 attempts, 15 of them solved" in line


def test_a_step_without_a_solution_is_reported_with_the_place_of_fastest_flow(monkeypatch):
    run = cavity()
    run.run(2 * DT)

    def unsolved(*_):
        raise nv.StepError("did not converge")

    monkeypatch.setattr(run.solver, "solve", unsolved)
    with pytest.raises(nv.StepError) as caught:
        run.advance()
    report = caught.value.report
    assert report.violation is None and report.state is None
    assert report.courant == pytest.approx(run.ledger.rows[-1]["cfl"]) and report.wall == "top"
    assert "did not converge" in str(report) and "shorter steps" in str(report)


def test_the_refused_solution_is_written_for_inspection(failed, tmp_path):
    run, error = failed
    before = run.rothe_step.state.vec.FV().NumPy().copy()
    write_failure(tmp_path / "failed.txt", tmp_path / "failed.vtu", run, error.report)
    assert (run.rothe_step.state.vec.FV().NumPy() == before).all()
    assert "the solution that was refused" in (tmp_path / "failed.txt").read_text()
    content = (tmp_path / "failed.vtu").read_bytes()
    assert b"out_of_bounds" in content and b'Name="F"' in content
    with showing(run, error.report.state):
        cells = run.bounds.cells_outside()
        assert error.report.violation.cell in cells
        assert run.bounds.violation(everywhere=True).value == error.report.violation.value
    assert np.isfinite(error.report.state).all() and not run.bounds.is_exceeded()


@pytest.mark.parametrize(("floor", "is_named"), [(1e-9, True), (1e-3, False)])
def test_a_flow_rule_without_a_smooth_potential_at_rest_is_named(floor, is_named, monkeypatch):
    creep = nv.Perzyna(sigma_Y=0.5, G_m=0.1, nu=1e-3, rate_floor=floor)
    model = nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), creep=creep)
    initial = nv.Initial(velocity=(sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y)))
    run = nv.Simulation(box((1, 1), 0.6), model, dt=0.02, initial=initial)

    def unsolved(*_):
        raise nv.StepError("did not converge")

    monkeypatch.setattr(run.solver, "solve", unsolved)
    with pytest.raises(nv.StepError) as caught:
        run.advance()
    assert ("rheology.creep.rate_floor from 1e-09/s" in caught.value.report.advice[0]) is is_named


def test_a_step_from_rest_names_no_fastest_place(monkeypatch):
    model = nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), creep=nv.Perzyna(sigma_Y=0.5, G_m=1e-6))
    run = nv.Simulation(box((1, 1), 0.6), model, dt=0.02, solver="coupled")
    # v is as small as rounding errors
    run.rothe_step.state.vec.FV().NumPy()[run.rothe_step.layout.ranges["v"]] = 1e-18
    solve = run.solver.newton.solve
    monkeypatch.setattr(
        run.solver.newton, "solve", lambda *given: replace(solve(*given), status=Status.STALLED, reason="no")
    )
    with pytest.raises(nv.StepError) as caught:
        run.advance()
    what, *below = str(caught.value.report).splitlines()
    assert what.endswith("no solution was found; the body was at rest")
    assert "flow       at rest" in below
