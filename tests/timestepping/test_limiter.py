"""Steps that end out of bounds at points: the limiter restores the bounds, or the run ends on request."""

import contextlib
from functools import partial

import numpy as np
import pytest
from ngsolve import CF, pi, sin, x
from support import assert_balanced, assert_goes_on, by_ci

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.physics.variables import Distortion, Jacobian
from tests.verification.setups import lid_driven

SCHEMES = ["backward-euler", "midpoint", "sdirk2"]
MARKS = dict.fromkeys([("midpoint", "split"), ("sdirk2", "coupled")], (pytest.mark.long, pytest.mark.ci))
WITH_BOTH_SOLVERS = [
    pytest.param(scheme, solver, marks=MARKS.get((scheme, solver), pytest.mark.long))
    for scheme in SCHEMES
    for solver in ("split", "coupled")
]
OTHERS = ("backward-euler", "sdirk2")
DT = 0.05
LIMITED = {"backward-euler": 7, "midpoint": 8, "sdirk2": 8}
"""Steps after which cells at the corners of the lid have been limited."""


def cavity(material=None, scheme="backward-euler", lid=(1.0, 0.0), mesh=None, **options):
    """A body under a lid of full speed up to the corners: 34 triangles."""
    return lid_driven(
        mesh or box((1, 1), 0.25), material, lid=lid, dt=DT, scheme=scheme, drift=1.0, **options
    )


@pytest.mark.parametrize(("scheme", "solver"), WITH_BOTH_SOLVERS)
def test_a_limited_run_keeps_its_ledger_closed_and_is_resumed_from_a_checkpoint(scheme, solver, tmp_path):
    """From a checkpoint of a limited state the run continues bit for bit."""
    make, last = partial(cavity, scheme=scheme, solver=solver), LIMITED[scheme] - 1
    ledger = assert_goes_on(make, tmp_path / "run.h5", LIMITED[scheme] * DT, last).ledger
    limited = ledger.column("limited_cells")
    assert limited[last] > 0 and limited[:4].max() == 0
    assert abs(ledger.column("limiter")[limited > 0]).min() > 1e-6 * ledger.column("stored")[-1]
    assert (ledger.column("limiter")[limited == 0] == 0).all()
    assert_balanced(ledger, drift=1e-11)


@pytest.mark.parametrize(
    "scheme", [by_ci("backward-euler"), pytest.param("midpoint", marks=pytest.mark.long)]
)
def test_without_a_limiter_the_run_ends_and_says_where(scheme):
    words = r"det F is not positive \(the least value is -\S+, in cell \d+ at \(0, 0.75\) m, on .*'left'\)"
    steps = nv.AdaptiveSteps(dt_min=0.9 * DT, dt_max=DT)  # the run cannot go on with smaller steps
    with pytest.raises(nv.StepError, match=words):
        cavity(scheme=scheme, limiter=False, adaptive=steps, solver="split").run(LIMITED[scheme] * DT)


def coarse():
    """Six triangles."""
    return box((1, 1), 0.5)


def thin_out(run):
    """Let steps end with a density that is negative at a point of a cell at the lid."""
    step, limit = run.rothe_step, run.bounds.limit
    heights = [np.mean([run.mesh[v].point[-1] for v in cell.vertices]) for cell in run.mesh.Elements()]
    dofs = np.array(step.layout.blocks["rho"].GetDofNrs(list(run.mesh.Elements())[np.argmax(heights)]))
    state, rho = step.state.vec.FV().NumPy(), step.layout.ranges["rho"]

    def thinned(tau):
        state[rho][dofs[1:]] += 0.9
        return limit(tau)

    run.bounds.is_exceeded, run.bounds.limit = lambda: True, thinned


@pytest.mark.parametrize("scheme", ["midpoint", *(pytest.param(s, marks=pytest.mark.long) for s in OTHERS)])
def test_the_velocity_after_limiting_follows_from_the_limited_density_and_momentum(scheme):
    """The test compares the equations of all unknowns of v that no wall prescribes."""
    run = cavity(scheme=scheme, mesh=coarse())
    run.run(2 * DT)
    thin_out(run)
    run.advance()
    impulse = run.integrator.velocity()
    free = run.integrator.velocity.free
    momentum = np.linalg.norm(run.integrator.velocity._load.vec.FV().NumPy())
    assert run.ledger.rows[-1]["limited_cells"] == 1
    assert np.abs(impulse[free]).max() <= 1e-13 * momentum
    assert np.abs(impulse[~free]).max() > 1e-6 * momentum
    assert_balanced(run.ledger, drift=1e-11)


@pytest.mark.parametrize("scheme", [by_ci("backward-euler"), "midpoint"])
def test_energy_that_the_limiter_takes_at_walls_has_its_own_column(scheme):
    """The lid's power is that of the same step without a limiter, whose density is not limited."""
    runs = [cavity(scheme=scheme, mesh=coarse()) for _ in range(2)]
    for run in runs:
        run.run(2 * DT)
    thin_out(runs[1])
    plain, limited = (run.advance() for run in runs)
    assert plain["limiter_walls"] == 0 and limited["limited_cells"] == 1
    assert limited["limiter_walls"] != 0 and abs(limited["closure_relative"]) <= 1e-10
    expected = pytest.approx(plain["power_wall_top"], rel=1e-9, abs=1e-9 * abs(limited["limiter_walls"]) / DT)
    assert limited["power_wall_top"] == expected


@pytest.mark.long
@pytest.mark.ci
def test_relaxed_steps_are_limited():
    steps = nv.AdaptiveSteps(dt_min=1e-3, dt_max=DT)
    ledger = cavity(scheme="midpoint", relaxation=True, adaptive=steps).run(LIMITED["midpoint"] * DT)
    assert ledger.column("limited_cells").max() > 0
    assert_balanced(ledger, drift=1e-11)
    numerical = ledger.column("inertial") + ledger.column("bregman")
    as_it_is = ledger.column("limited_cells") == 0
    assert np.abs(numerical[as_it_is]).max() <= 1e-11 * ledger.column("stored").max()


CONTINUED_SOLID = nv.Yosida(
    material=nv.NeoHookean(K_e=2.0, G_e=0.05, epsilon=0.1, elastic_state="F"), eps=0.1
)
CONTINUED = {
    "Yosida approximation": CONTINUED_SOLID,
    "J_min": nv.NeoHookean(K_e=2.0, G_e=0.05, epsilon=0.01, J_min=0.3, elastic_state="B"),
}


@pytest.mark.parametrize("name", ["J_min", by_ci("Yosida approximation")])
def test_a_run_with_a_continued_energy_passes_J_of_zero(name):
    """The paper's discrete scheme, too, admits any (F, J)."""
    run = cavity(CONTINUED[name])
    run.run(DT)
    step = run.rothe_step
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    one = run.bounds._means.one
    J = parts["z"].components[-1].vec.FV().NumPy()
    dofs = np.array(step.layout.blocks["rho"].GetDofNrs(list(run.mesh.Elements())[7]))
    J[dofs] -= 1.2 * one[dofs]  # J becomes negative in one cell
    run.ledger.balance = None
    run.ledger.start(run.t)
    ledger = run.run(3 * DT)
    assert ledger.column("J_min")[-1] < 0 and ledger.column("limited_cells").max() == 0
    assert np.abs(ledger.column("closure_relative")[-2:]).max() <= 1e-10


def squeezed(material, speed, dt):
    """A strip of twelve triangles whose matter runs to its middle and leaves a void on both sides."""
    mesh = structured_box((1, 1 / 6), (6, 1), periodic="y")
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01))
    initial = nv.Initial(velocity=(speed * sin(2 * pi * x), 0.0))
    return nv.Simulation(mesh, model, dt=dt, initial=initial)


@pytest.mark.long
# cells are as long as a sixth of the box, so that the warning is expected
@pytest.mark.filterwarnings("ignore::ngvisco.run.signs.DissipationWarning")
def test_J_of_a_squeezed_fluid_passes_zero_only_if_the_energy_is_continued():
    """With J_min, J passes zero. Without J_min, the limiter keeps J of the same fluid above zero, or the run
    ends."""
    ledger = squeezed(nv.BarotropicFluid(B=0.1, gamma=1.4, J_min=0.3), 2.5, 0.05).run(6 * 0.05)
    J = ledger.column("J_min")
    assert J[0] == pytest.approx(1.0) and J[1] > 0.3 and J[2:5].min() < -0.1 and J[-1] > 0.1
    assert_balanced(ledger, drift=1e-11)
    bounded = squeezed(nv.BarotropicFluid(B=0.1, gamma=1.4), 2.0, 0.05)
    with contextlib.suppress(nv.StepError):
        bounded.run(6 * 0.05)
    assert bounded.ledger.column("J_min").min() > 0


def test_a_variable_without_effect_on_the_energy_never_ends_a_run():
    """The energy of a fluid does not depend on F, which has a negative determinant here. A solid with such an
    F cannot start."""
    fluid = nv.CustomMaterial(
        transported=(Distortion(), Jacobian()), stored_energy=lambda F, J: 10 * (J - 1) * (J - 1)
    )
    run = cavity(fluid, limiter=False, mesh=coarse())
    step = run.rothe_step
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    parts["z"].components[0].Set(CF(-1.0))
    run.run(2 * DT)
    assert_balanced(run.ledger, drift=1e-11)
