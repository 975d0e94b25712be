"""Gradients that go on after an interruption."""

from pathlib import Path

import numpy as np
import pytest
from differentiated import AT, UNTIL, run
from ngsolve import CF, Parameter, sin, x
from support import by_ci

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.sensitivity import gradient as gradients
from ngvisco.sensitivity.adjoint import Adjoint
from ngvisco.sensitivity.restart import signature
from ngvisco.sensitivity.trajectory import Trajectory

OF = {"motion": "kinetic at 0.06", "loss": "dissipation_creep until 0.06", "push": "bottom.force_2 at 0.05"}
BY = ["material.G_e", "initial.density"]


def found(simulation, folder, method="tangent", **options):
    """The gradient of the tests; differences of second order need half as many neighbouring runs as those of
    fourth order."""
    given = {"of": OF, "by": BY, "method": method, "order": 2, "restart": folder}
    return nv.gradient(simulation, UNTIL, **given | options)


def same(one, other):
    return np.array_equal(one.values, other.values) and np.array_equal(one.jacobian, other.jacobian)


class StopsAt:
    """Requests a stop after a number of steps."""

    def __init__(self, step):
        self.at = step

    def start(self, simulation):
        self.step(simulation, {})

    def step(self, simulation, row):
        if simulation.number == self.at:
            simulation.request_stop()

    def finish(self, simulation):
        pass


@pytest.mark.parametrize(
    ("method", "scheme"),
    [
        ("adjoint", "midpoint"),
        by_ci("tangent", "backward-euler"),
        by_ci("tangent", "sdirk2"),
        by_ci("adjoint", "sdirk2"),
    ],
)
def test_a_resumed_gradient_equals_the_uninterrupted_one(tmp_path, method, scheme):
    """The gradient is stopped in the run, then in the derivatives, and is complete after two more calls."""
    whole = found(run(scheme=scheme), None, method)
    stopped, second = run(scheme=scheme), run(scheme=scheme)
    stopped.observers.append(StopsAt(1))
    with pytest.raises(nv.StopRequested, match="a repeated call goes on from"):
        found(stopped, tmp_path, method)
    steps = []

    def stop(number, total):
        steps.append(number)
        second.request_stop()

    with pytest.raises(nv.StopRequested):
        found(second, tmp_path, method, progress=stop)
    assert steps == [1] and second.number == 3
    steps.clear()
    third = found(run(scheme=scheme), tmp_path, method, progress=lambda number, total: steps.append(number))
    assert steps == [2, 3]
    assert same(third, whole)
    assert same(found(run(scheme=scheme), tmp_path, method, progress=lambda *_: pytest.fail()), whole)
    if method == "adjoint":
        assert np.array_equal(third._of_start, whole._of_start)


@pytest.mark.long
@pytest.mark.ci
def test_a_stop_within_a_step_keeps_the_steps_before_it(tmp_path, monkeypatch):
    """The request comes in the second step's first stage; no part of this step is kept."""
    stopped, stage = run(), Trajectory.stage

    def stop(self, weights, share):
        stage(self, weights, share)
        if self.simulation.number == 1:
            self.simulation.request_stop()

    monkeypatch.setattr(Trajectory, "stage", stop)
    with pytest.raises(nv.StopRequested):
        found(stopped, tmp_path, by=BY[:1])
    monkeypatch.undo()
    assert {path.name for path in tmp_path.iterdir()} >= {"case.h5", "run.h5", "step-00000001.h5"}
    assert not list(tmp_path.glob("*.part"))
    assert same(found(run(), tmp_path, by=BY[:1]), found(run(), None, by=BY[:1]))


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("place", ["restart", None])
def test_a_gradient_stopped_before_its_first_step_is_kept(tmp_path, monkeypatch, place):
    """The request comes while the derivatives are prepared, and the run does not begin."""
    simulation, prepare = run(), gradients.Neighbours

    def stop(*arguments):
        simulation.request_stop()
        return prepare(*arguments)

    monkeypatch.setattr(gradients, "Neighbours", stop)
    with pytest.raises(nv.StopRequested):
        found(simulation, place and tmp_path / place, by=BY[:1])
    assert simulation.number == 0


def test_an_adjoint_stops_between_two_stages_on_request(tmp_path, monkeypatch):
    simulation, stages, one = run(scheme="sdirk2"), [], Adjoint._stage

    def counted(self, *arguments):
        one(self, *arguments)
        stages.append(arguments[2])
        simulation.request_stop()

    monkeypatch.setattr(Adjoint, "_stage", counted)
    with pytest.raises(nv.StopRequested):
        found(simulation, tmp_path, "adjoint", by=BY[:1])
    assert stages == [2]  # the adjoint of a step begins with its last stage


def test_a_gradient_stopped_without_a_folder_raises_an_error():
    stopped = run()
    stopped.observers.append(StopsAt(2))
    with pytest.raises(nv.StopRequested, match=r"stopped, as requested$"):
        found(stopped, None, by=BY[:1])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of a gradient that was stopped at its start."""
    first, place = run(), tmp_path_factory.mktemp("restart")
    first.observers.append(StopsAt(0))
    with pytest.raises(nv.StopRequested):
        found(first, place)
    return place


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"values": AT | {"material.G_e": 6.0}}, "another model"),
        ({"scheme": "sdirk2"}, "another time"),
        ({"initial": nv.Initial(density=1.0)}, "another initial"),
        ({"walls": {"top": nv.NavierFriction(0.2)}}, "another walls"),
        ({"solver": "split"}, "another newton"),
        ({"mesh": structured_box((1, 1), (2, 3))}, "mesh; repeat"),
        ({"observers": [nv.WallForces(["bottom"], about=(0.1, 0.2))]}, "another tables"),
    ],
)
def test_the_folder_of_another_run_is_refused(folder, change, said):
    with pytest.raises(nv.CheckpointError, match=said):
        found(run(**change), folder)


def test_functions_of_a_kept_gradient_are_compared_by_values():
    """Functions are compared by values, because the text of an NGSolve expression has six digits, and that of
    a parameter no value."""
    sampler, (p, q) = run().sampler, (Parameter(3.0), Parameter(4.0))
    for one, other in ((CF(1.0), CF(1.0000001)), (p * x, q * x), (sin(nv.time) * x, sin(1.1 * nv.time) * x)):
        assert signature(one, sampler) == signature(one, sampler) != signature(other, sampler)
    assert signature(Path("a.stl"), sampler) != signature(Path("b.stl"), sampler)


@pytest.mark.long
@pytest.mark.ci
def test_a_damaged_folder_and_a_folder_of_other_derivatives_are_refused(tmp_path):
    first = run()
    first.observers.append(StopsAt(2))
    with pytest.raises(nv.StopRequested):
        found(first, tmp_path)
    for options, said in (
        ({"of": ["kinetic at 0.06"]}, "another of"),
        ({"by": BY[:1]}, "another by"),
        ({"method": "adjoint"}, "another method"),
        ({"order": 4}, "another order"),
    ):
        with pytest.raises(nv.CheckpointError, match=said):
            found(run(), tmp_path, **options)
    part = tmp_path / "step-00000002.h5"
    part.write_bytes(part.read_bytes()[:-200])
    with pytest.raises(nv.CheckpointError, match=r"step-00000002\.h5"):
        found(run(), tmp_path)
    part.unlink()
    with pytest.raises(nv.CheckpointError, match="this file does not exist"):
        found(run(), tmp_path)


def test_the_size_of_a_gradient_s_folder_is_proportional_to_the_number_of_steps(tmp_path):
    sizes = []
    for steps in (2, 4):
        folder = tmp_path / str(steps)
        nv.gradient(run(), 0.02 * steps, of=["kinetic at 0.04"], by=BY[:1], restart=folder)
        sizes.append(sum(path.stat().st_size for path in folder.glob("*-*.h5")))
    assert sizes[1] == pytest.approx(2 * sizes[0], rel=0.02)
