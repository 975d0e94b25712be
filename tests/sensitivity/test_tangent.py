"""Tangents of runs against central differences of whole runs."""

import numpy as np
import pytest
from differentiated import AT, OF, UNTIL, differences, run
from support import by_ci

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.sensitivity.parameters import Named
from ngvisco.sensitivity.tangent import Neighbours
from tests.verification.cases.sensitivities import measure

FORCE = {"push": "bottom.force_2 at 0.06"}


@pytest.mark.parametrize(
    ("scheme", "name"),
    [
        by_ci("backward-euler", "material.G_e"),
        by_ci("midpoint", "material.G_e"),
        by_ci("midpoint", "creep.G_m"),
        ("sdirk2", "loads.gravity.g.1"),
        by_ci("midpoint", "initial.density"),
    ],
)
def test_central_differences_converge_to_the_tangent(scheme, name):
    found = nv.gradient(run(scheme=scheme), UNTIL, of=OF | FORCE, by=[name]).jacobian[:, 0]
    errors = [abs(differences(name, h, OF | FORCE, scheme=scheme) / found - 1).max() for h in (1e-3, 1e-4)]
    assert errors[1] < 1e-6 and errors[1] < 0.02 * errors[0] + 2e-7


def test_values_equal_those_of_the_run():
    simulation = run()
    found = nv.gradient(simulation, UNTIL, of=OF | FORCE, by=["creep.G_m"])
    table = dict(zip(found.of, found.values, strict=True))
    ledger = simulation.ledger
    assert table["motion"] == pytest.approx(ledger.column("kinetic")[-1], rel=1e-12)
    assert table["creep"] == pytest.approx(ledger.column("dissipation_creep")[-1], rel=1e-12)
    lost = (ledger.column("dissipation_creep") * ledger.column("dt")).sum()
    assert table["loss"] == pytest.approx(lost, rel=1e-12)
    probes, forces, shares = simulation.observers
    assert table["stress"] == pytest.approx(probes.column("p.cauchy_stress_12")[-1], rel=1e-9)
    assert table["speed"] == pytest.approx(probes.column("p.velocity_1")[2:].mean(), rel=1e-9)
    assert table["share"] == pytest.approx(shares.column("share")[-1], rel=1e-9)
    assert table["push"] == pytest.approx(forces.column("bottom.force_2")[-1], rel=1e-9)


def test_a_gradient_does_not_change_its_run():
    """A gradient changes nothing in the simulation."""
    alone, observed = run(), run()
    alone.run(UNTIL)
    nv.gradient(observed, UNTIL, of=["kinetic at 0.06"], by=["creep.G_m"])
    states = [one.rothe_step.state.vec.FV().NumPy() for one in (alone, observed)]
    assert np.array_equal(*states)


@pytest.mark.long
@pytest.mark.ci
def test_differences_of_second_order_agree_with_those_of_fourth_order():
    fine, coarse = (nv.gradient(run(), UNTIL, of=OF, by=["creep.G_m"], order=order) for order in (4, 2))
    assert 0 < abs(coarse.jacobian / fine.jacobian - 1).max() < 1e-7
    with pytest.raises(nv.ParameterError, match="4 or 2"):
        nv.gradient(run(), UNTIL, of=OF, by=["creep.G_m"], order=3)


@pytest.mark.long
@pytest.mark.ci
def test_a_tangent_without_the_old_state_is_wrong(monkeypatch):
    """A negative control: the tangent ignores the state from which a step starts."""
    found = nv.gradient(run(), UNTIL, of=["stored at 0.06"], by=["creep.G_m"]).jacobian
    monkeypatch.setattr(Neighbours, "moved", lambda self, state, along: [state for _ in self.steps])
    cut = nv.gradient(run(), UNTIL, of=["stored at 0.06"], by=["creep.G_m"]).jacobian
    assert abs(cut / found - 1).max() > 0.1


@pytest.mark.long
@pytest.mark.ci
def test_derivatives_by_the_velocity_of_a_wall_equal_differences():
    mesh, walls = box((1, 1), maxh=0.5), {"bottom": nv.NoSlip()}

    def at(speed):
        return run(mesh=mesh, walls=walls | {"top": nv.PrescribedTangential((speed, 0.0))})

    of = ["kinetic at 0.06", "power_wall_top at 0.06", "bottom.force_1 at 0.06"]
    found = nv.gradient(at(0.3), UNTIL, of=of, by=["walls.top.velocity.0"]).jacobian[:, 0]
    up, down = (measure(at(speed), UNTIL, of) for speed in (0.301, 0.299))
    difference = (up - down) / 0.002
    assert abs(difference / found - 1).max() < 1e-5


def test_parameters_are_named_by_their_paths():
    simulation = run()
    for name, value in AT.items():
        assert Named.of(name, simulation).value == value
    assert Named.of("rheology.creep.G_m", simulation).value == 2.0
    assert Named.of("model.loads.0.g.1", simulation).value == -1.0


@pytest.mark.parametrize(
    ("of", "by", "said"),
    [
        (["kinetic"], ["creep.G_m"], "COLUMN at TIME"),
        (["kinetic at x"], ["creep.G_m"], "COLUMN at TIME"),
        (["kinetic at 0.08"], ["creep.G_m"], "at 0.08': expected .* from t = 0 s to its end t = 0.06 s"),
        (["cinetic at 0.06"], ["creep.G_m"], "did you mean 'kinetic'"),
        ([], ["creep.G_m"], "at least one number"),
        (["kinetic at 0.06"], [], "at least one parameter"),
        (["kinetic at 0.06"], ["creep.G_q"], "unknown part in 'creep.G_q': 'G_q'"),
        (["kinetic at 0.06"], ["creap.G_m"], "unknown part of a run 'creap'"),
        (["kinetic at 0.06"], ["initial.velocity.0"], "the name of one number"),
        (["kinetic at 0.06"], ["creep.nu"], "a value at a distance of at least 0.0002 from the ends"),
    ],
)
def test_derivatives_that_do_not_exist_are_refused(of, by, said):
    with pytest.raises(nv.NgviscoError, match=said):
        nv.gradient(run(), UNTIL, of=of, by=by)


def test_a_gradient_does_not_change_the_state_of_a_run_that_has_begun():
    simulation = run()
    simulation.run(0.02)
    with pytest.raises(nv.ParameterError, match="no start values"):
        nv.gradient(simulation, UNTIL, of=["kinetic at 0.06"], by=["initial.density"])
    found = nv.gradient(simulation, UNTIL, of=["kinetic at 0.02", "kinetic at 0.06"], by=["creep.G_m"])
    assert found.jacobian[0, 0] == 0 != found.jacobian[1, 0]
    with pytest.raises(nv.ParameterError, match=r"from t = 0\.06 s to its end t = 0\.08 s"):
        measure(simulation, 0.08, ["kinetic at 0.02"])


def test_relaxed_steps_are_refused():
    adaptive = nv.AdaptiveSteps(dt_min=1e-3, dt_max=0.1)
    with pytest.raises(nv.ParameterError, match="relaxed step"):
        simulation = run(adaptive=adaptive, relaxation=True)
        nv.gradient(simulation, UNTIL, of=["kinetic at 0.06"], by=["creep.G_m"])
