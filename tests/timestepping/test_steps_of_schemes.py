"""Steps of the schemes: restarts, start-up, relaxation, stiff parts, refusals, adaptive lengths, advice."""

import math
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from ngsolve import CF, IfPos, exp, pi, sin, x, y
from support import SWIRL, assert_goes_on, by_ci, small_run, state, swirling

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.run.ledger import NUMERICAL
from ngvisco.run.observers import dissipation_advice
from ngvisco.run.scales import fastest_wave
from ngvisco.timestepping.error import ErrorEstimate


def simulation(dt=0.02, scheme="midpoint", **options):
    settings = {
        "viscosity": nv.StokesViscosity(K_v=0.01, G_v=0.01),
        "hyperviscosity": nv.HyperViscosity(mu=1e-4),
        "loads": [nv.Gravity((0.0, sin(3 * nv.time)))],
    }
    return swirling(dt=dt, scheme=scheme, **(settings | options))


# --- restarts ------------------------------------------------------------------------------------------

SOLID = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0)
HEATED = {
    "material": nv.Thermal(material=nv.LinearElastic(K_e=10.0, G_e=5.0), c=1.0, theta_R=1.0, expansion=0.1),
    "heat": nv.Heat(conductivity=0.05, numerical_heating=True),
    "scheme": "backward-euler",
}
YIELDING = {"material": SOLID, "creep": nv.Perzyna(sigma_Y=0.05, G_m=0.1), "scheme": "backward-euler"}
DAMAGED = nv.Damaged(material=nv.ReferentialNeoHookean(K_e=20.0, G_e=5.0), G_c=0.1, length=0.6)
SEED = 0.3 * exp(-20 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))
NEO_HOOKEAN = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F")
RESTARTED = {
    "sdirk2, passive": {"scheme": "sdirk2", "passive": ("F_tot", "reference_map"), "solver": "split"},
    "creep, passive": {
        "creep": nv.Creep(G_m=2.0),
        "passive": ("F_tot", "reference_map", "creep_strain"),
        "scheme": "backward-euler",
    },
    # these rules are linearised at stresses of iterates
    "yield, coupled": YIELDING | {"solver": "coupled"},
}
OF_CI = {
    "moving wall": {
        "solver": "split",
        "walls": {"top": nv.PrescribedTangential((10 * nv.time * sin(pi * x), 0))},
    },
    "relaxed": {
        "adaptive": nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.02),
        "relaxation": True,
        "solver": "coupled",
    },
    # the derivative of a heated step reads the old momentum
    "heat, coupled": HEATED | {"solver": "coupled"},
    "heat, split": HEATED | {"solver": "split"},
    "yield, split": YIELDING | {"solver": "split"},
    # the checkpoint contains no values of the regularised energy at points
    "Yosida": {"material": nv.Yosida(material=NEO_HOOKEAN, eps=0.02), "creep": nv.Creep(G_m=2.0)},
    "damage": {
        "material": DAMAGED,
        "initial": nv.Initial(velocity=SWIRL, values={"damage": SEED}),
        "solver": "split",
    },
    "backward-euler, adaptive": {
        "scheme": "backward-euler",
        "adaptive": nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.08, tolerance=3e-3, patience=2),
        "solver": "split",
    },
    "theta after a start-up": {"scheme": "theta", "theta": 0.6, "startup": 1, "solver": "coupled"},
}


@pytest.mark.parametrize(
    "options",
    [
        *(pytest.param(options, id=name) for name, options in RESTARTED.items()),
        *(by_ci(options, id=name) for name, options in OF_CI.items()),
    ],
)
def test_a_run_is_resumed_from_any_checkpoint_bit_for_bit(options, tmp_path):
    make = partial(simulation, **options)
    # the checkpoints are after one and after two solved steps
    whole = assert_goes_on(make, tmp_path / "run.h5", 0.06, 1, 2)
    assert whole.number >= 3


def test_a_checkpoint_of_another_scheme_is_refused(tmp_path):
    run = simulation(observers=[nv.Checkpoints(tmp_path / "run.h5")])
    run.run(0.02)
    with pytest.raises(
        nv.CheckpointError, match=r"the checkpoint has scheme = 'midpoint.*this run has scheme = 'sdirk2"
    ):
        simulation(scheme="sdirk2").restore(tmp_path / "run.h5")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({"dt": 0.02}, {"dt": 0.01}),
        ({"dt": 0.005, "adaptive": nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.1)}, {"dt": 0.02}),
        ({"dt": 0.02}, {"dt": 0.01, "adaptive": nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.01)}),
    ],
    ids=["another length", "adaptive to fixed", "fixed to adaptive"],
)
def test_times_continue_after_a_restart_with_other_step_lengths(before, after, tmp_path):
    simulation(**before, observers=[nv.Checkpoints(tmp_path / "run.h5")]).run(0.04)
    rest = simulation(**after)
    rest.restore(tmp_path / "run.h5")
    ledger = rest.run(0.06)
    assert rest.t == pytest.approx(0.06, abs=1e-15)
    assert np.allclose(np.diff(ledger.column("time")), ledger.column("dt")[1:], rtol=0, atol=1e-15)


@pytest.mark.parametrize("where", [by_ci("solution"), by_ci("row"), "estimate"])
def test_an_interrupt_leaves_the_state_before_the_step(where, monkeypatch, tmp_path):
    """Every state has its row of the ledger, and a run can continue from every checkpoint."""
    options = {"adaptive": nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.02, tolerance=0.1), "passive": ("F_tot",)}
    run = simulation(**options, observers=[nv.Checkpoints(tmp_path / "run.h5", every=1)])
    run.run(0.04)
    before, carried, t = state(run), run.passive.arrays(), run.t
    owner, name = {
        "solution": (run.solver, "defect"),
        "row": (run.ledger, "_measured"),
        "estimate": (run.stepper._estimate, "_values"),
    }[where]

    def interrupted(*args):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(owner, name, interrupted)
        run.run(0.08)
    assert np.array_equal(state(run), before)
    assert all(np.array_equal(carried[key], now) for key, now in run.passive.arrays().items())
    assert nv.time.Get() == run.t == t and run.number == len(run.ledger.rows) - 1
    rest = simulation(**options)
    rest.restore(tmp_path / "run.h5")
    for one in (run, rest):
        assert np.abs(one.run(0.08).column("closure_relative")).max() < 1e-12


def test_a_negative_density_at_the_end_of_a_step_is_refused(monkeypatch):
    """The end of a midpoint step is extrapolated, and has to be positive like a stage."""
    run = simulation(halvings=0)
    sound, stage_end = run.bounds.defect, 0.5 * run.dt

    def late(is_solved=True):
        return "rho is not positive" if nv.time.Get() > stage_end else sound(is_solved)

    monkeypatch.setattr(run.bounds, "defect", late)
    before = state(run)
    with pytest.raises(nv.StepError, match="rho is not positive at the end of the step"):
        run.advance()
    assert np.array_equal(state(run), before)


# --- stiff parts ---------------------------------------------------------------------------------------


def shear_modes(scheme, startup=0):
    """The kinetic energy of a short shear wave after ten steps that are a thousand times as long as its decay
    time."""
    rough = IfPos(sin(40 * x) * sin(37 * y), 1.0, -1.0)
    run = simulation(
        dt=1.0,
        scheme=scheme,
        solver="coupled",
        startup=startup,
        viscosity=nv.StokesViscosity(K_v=100.0, G_v=100.0),
        hyperviscosity=None,
        initial=nv.Initial(velocity=(1e-3 * rough, 1e-3 * rough)),
        loads=[],
    )
    return run.run(10.0).column("kinetic")


@pytest.mark.long
@pytest.mark.ci
def test_sdirk2_damps_stiff_viscous_modes_and_midpoint_does_not():
    midpoint, sdirk2, euler, started = (
        shear_modes(*how) for how in (("midpoint",), ("sdirk2",), ("backward-euler",), ("midpoint", 2))
    )
    assert midpoint[-1] > 0.5 * midpoint[0]  # the mode is multiplied by nearly -1 in a step
    assert sdirk2[-1] < 1e-6 * sdirk2[0]
    assert euler[-1] < 1e-6 * euler[0]
    assert started[-1] < 1e-6 * started[0]


def test_sdirk2_damps_stiff_creep_and_midpoint_reverses_the_stretch():
    """A stretch relaxes with a Maxwell time of dt/1000: the midpoint rule reverses it in each step."""
    stretch = nv.Initial(values={"E": CF((1e-3, 0, 0, 0, -1e-3, 0, 0, 0, 0), dims=(3, 3))})
    options = {"material": nv.LinearElastic(K_e=10.0, G_e=5.0), "creep": nv.Creep(G_m=2e-4), "loads": []}
    left = {"midpoint": [], "sdirk2": []}
    for scheme, values in left.items():
        run = simulation(scheme=scheme, initial=stretch, **options)
        for _ in range(4):
            run.advance()
            values.append(run.fields["E"](run.mesh(0.3, 0.4))[0] / 1e-3)
    assert np.sign(left["midpoint"]).tolist() == [-1, 1, -1, 1]
    assert abs(left["midpoint"][-1]) > 0.9
    assert abs(left["sdirk2"][0]) < 1e-2 and abs(left["sdirk2"][-1]) < 1e-6


# --- relaxation ----------------------------------------------------------------------------------------


def test_a_relaxed_run_has_no_numerical_dissipation():
    """The sum of kinetic and stored energy has no numerical dissipation at any step, also where an output
    time is met exactly."""
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.02)
    run = simulation(adaptive=stepping, relaxation=True, solver="coupled")
    ledger = run.run(0.1, stops=[0.07])
    remainder = sum(ledger.column(name) for name in NUMERICAL)
    energy = ledger.column("kinetic")[0]
    # the remainder is a difference of stored energies of 15 J; the bound is five rounding errors of 15 J
    assert np.abs(remainder).max() <= 1e-15 * ledger.column("stored")[0]
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-12
    assert {0.07, 0.1} <= set(ledger.column("time"))
    lengths = ledger.column("dt")[1:3]
    # the lengths differ little from the requested one
    assert np.abs(lengths - 0.02).min() > 0 and np.abs(lengths - 0.02).max() <= 1e-4
    plain = simulation(solver="coupled").run(0.1)
    assert np.abs(sum(plain.column(name) for name in NUMERICAL)).max() > 1e-9 * energy


@pytest.mark.parametrize(("dt", "speed"), [(1e-4, 1.0), by_ci(0.02, 1e-4), by_ci(0.02, 1e-6), (0.02, 0.0)])
def test_a_relaxed_run_reaches_its_end_also_in_short_steps_and_slow_motions(dt, speed):
    """In a short step, or a slow motion, the remainder is as small as the rounding of the energies, and its
    zero is as uncertain."""
    slow = nv.Initial(velocity=(speed * SWIRL[0], speed * SWIRL[1]))
    stepping = nv.AdaptiveSteps(dt_min=dt / 8, dt_max=dt)
    ledger = simulation(dt, adaptive=stepping, relaxation=True, initial=slow, loads=[]).run(5 * dt)
    assert ledger.column("rejections").sum() == 0
    assert ledger.column("time")[-1] == 5 * dt
    assert np.allclose(np.diff(ledger.column("time")), ledger.column("dt")[1:], rtol=1e-12, atol=0)
    remainder = sum(ledger.column(name) for name in NUMERICAL)
    assert np.abs(remainder).max() <= 1e-15 * ledger.column("stored")[0]


@pytest.mark.long
@pytest.mark.ci
def test_a_relaxed_run_is_of_second_order():
    ends = []
    for n in (8, 16, 32):
        dt = 0.08 / n
        stepping = nv.AdaptiveSteps(dt_min=dt / 9, dt_max=dt)
        run = simulation(dt, adaptive=stepping, relaxation=True, solver="coupled")
        run.run(0.08)
        ends.append(state(run)[run.rothe_step.layout.ranges["v"]])
    first, second = (np.linalg.norm(a - b) for a, b in pairwise(ends))
    assert math.log2(first / second) >= 1.85


# --- refusals ------------------------------------------------------------------------------------------


# --- adaptive lengths ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "scheme",
    [
        "midpoint",
        *(pytest.param(s, marks=[pytest.mark.long, pytest.mark.ci]) for s in ("backward-euler", "sdirk2")),
    ],
)
def test_the_controller_keeps_the_error_at_its_tolerance(scheme):
    """Estimates are below the tolerance, and near it once lengths have settled; few steps are rejected."""
    tolerance = 2e-3
    stepping = nv.AdaptiveSteps(dt_min=1e-6, dt_max=1.0, tolerance=tolerance)
    viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.1)
    run = simulation(0.002, scheme, adaptive=stepping, viscosity=viscosity, solver="coupled")
    ledger = run.run(0.5)
    errors = ledger.column("error_estimate")
    known = errors[~np.isnan(errors)]
    assert known.max() <= tolerance
    assert np.median(known[len(known) // 3 :]) >= 0.25 * tolerance
    assert ledger.column("rejections").sum() <= 0.2 * len(errors)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10


def test_adaptive_steps_do_not_depend_on_the_size_of_a_small_strain():
    """The stress of a Maxwell body at a held strain is exp(-t), with lengths of steps that do not depend on
    the strain. Errors that count relative to F, and not to the strain, let the steps grow without bound."""
    material, creep = nv.LinearElastic(K_e=10.0, G_e=1.0), nv.Creep(G_m=2.0)
    times = []
    for strain in (1e-3, 1e-5):
        stress = nv.Probes({"p": (0.3, 0.4)}, ["cauchy_stress"])
        run = small_run(
            1.0,
            material=material,
            creep=creep,
            time=nv.TimeSteps(dt=0.01, adaptive=nv.AdaptiveSteps(dt_min=1e-4, dt_max=2.0, tolerance=1e-3)),
            walls=dict.fromkeys(("left", "right", "top", "bottom"), nv.NoSlip()),
            initial=nv.Initial(density=1.0, F=CF((1, strain, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))),
            observers=[stress],
        )
        run.run(until=4.0)
        times.append(stress.column("time"))
        error = stress.column("p.cauchy_stress_12") / strain - np.exp(-times[-1])
        assert 0.003 < abs(error).max() < 0.02
    assert len(times[0]) == pytest.approx(len(times[1]), abs=2)


def test_the_speed_of_waves_is_that_of_the_start_after_a_restart_and_that_of_the_state_after_a_transfer(
    tmp_path,
):
    """The scale of strains must not depend on where a run was stopped, nor on start values without use."""
    steps = nv.TimeSteps(dt=0.02, adaptive=nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.05, tolerance=1e-2))
    make = partial(swirling, time=steps, density=4.0, material=SOLID)
    run = make(observers=[nv.Checkpoints(tmp_path / "run.h5")])
    run.run(0.1)
    resumed, target = make(), swirling(time=steps, material=SOLID)
    resumed.restore(tmp_path / "run.h5")
    assert resumed.wave_speed == run.wave_speed == make().wave_speed
    assert abs(fastest_wave(run.rothe_step, run.sampler) / run.wave_speed - 1) > 1e-3
    assert target.wave_speed == pytest.approx(2 * run.wave_speed, rel=1e-9)
    nv.transfer(run, target)
    assert target.wave_speed == pytest.approx(fastest_wave(run.rothe_step, run.sampler), rel=1e-6)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("scheme", ["backward-euler", "midpoint"])
def test_strains_that_stay_zero_do_not_shorten_the_steps_of_a_slow_flow(scheme):
    """In slow shear of a mantle J stays 1 to rounding, and rounding has no relative error."""
    run = nv.Simulation(
        structured_box((1e5, 1e5), (2, 2), periodic="x"),
        nv.Model(material=nv.ReferentialNeoHookean(K_e=1e11, G_e=5e10), creep=nv.Creep(G_m=1e21)),
        time=nv.TimeSteps(
            dt=1e9, scheme=scheme, adaptive=nv.AdaptiveSteps(dt_min=1e6, dt_max=1e11, tolerance=1e-3)
        ),
        walls={"top": nv.PrescribedTangential((1e-9, 0.0)), "bottom": nv.NoSlip()},
        initial=nv.Initial(density=3000.0, velocity=(1e-14 * y, 0.0)),
    )
    ledger = run.run(2e11)
    assert 5 < run.number < 100 and not np.isnan(ledger.column("error_estimate")[-1])
    # the viscosity 5e20 Pa s times the shear rate 1e-14 1/s, after 40 relaxation times
    assert run.fields["cauchy_stress"](run.mesh(3e4, 4e4))[1] == pytest.approx(5e6, rel=1e-4)


# --- advice --------------------------------------------------------------------------------------------


def test_a_run_damped_by_its_scheme_advises_another_scheme(capsys):
    euler = simulation(scheme="backward-euler", observers=[nv.Progress(0.1)])
    euler.run(0.1)
    said = [line for line in capsys.readouterr().out.splitlines() if "dissipated" in line]
    assert len(said) == 1 and "backward-euler" in said[0] and "scheme = 'midpoint'" in said[0]
    assert dissipation_advice(euler) == said[0]
    midpoint = simulation(observers=[nv.Progress(0.1)])
    midpoint.run(0.1)
    assert "dissipated" not in capsys.readouterr().out


def test_rounding_of_a_body_at_rest_advises_no_other_scheme():
    for modulus in (10.0, 1e9):
        material = nv.ReferentialNeoHookean(K_e=modulus, G_e=modulus)
        run = small_run(0.5, 0.05, material=material)
        run.run(0.1)
        assert run.ledger.exchanged(*NUMERICAL)[-1] > 0
        assert dissipation_advice(run) is None


def test_energy_lost_in_a_transfer_is_not_attributed_to_the_scheme():
    run = simulation()
    run.ledger.add_once("transfer", 1.0)
    run.ledger.start(0.0)
    run.ledger.balance = replace(run.ledger.balance, energy=run.ledger.balance.energy + 1.0)
    run.run(0.02)
    assert run.ledger.column("transfer")[-1] == 1.0
    assert dissipation_advice(run) is None


def test_relaxed_steps_end_at_their_times_beside_an_accelerating_wall():
    """The factor omega is only as exact as the solution of the Rothe step. In an earlier version steps were
    halved without end."""
    stepping = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.04)
    lid = nv.PrescribedTangential((sin(20 * nv.time) * x * (1 - x), 0))
    run = small_run(
        0.4,
        loads=[nv.Gravity((0.0, -1.0))],
        time=nv.TimeSteps(dt=0.02, scheme="midpoint", relaxation=True, adaptive=stepping),
        walls={"top": lid},
    )
    ledger = run.run(until=0.2)
    assert run.t == 0.2 and run.number < 15 and not ledger.column("rejections").any()
    assert ledger.column("dt").sum() == pytest.approx(0.2, rel=1e-9)
    assert abs(ledger.column("closure_relative")).max() < 1e-11


@pytest.mark.parametrize("scheme", ["backward-euler", "midpoint", "sdirk2"])
def test_the_estimate_is_the_local_error_of_the_scheme(scheme):
    """For a density 1 + t^(p+1) and unequal steps, the error of the last step is C tau^(p+1) (p+1)!."""
    run = simulation(scheme=scheme)
    chosen, step = run.scheme, run.rothe_step
    p, where = chosen.order, step.layout.ranges["rho"]
    estimate, unit = ErrorEstimate(run, 0.0, p), state(run)[where]
    *known, last = (0.0, 0.1, 0.15, 0.3)[-p - 2 :]
    for t in known:
        step.state.vec.FV().NumPy()[where] = unit * (1 + t ** (p + 1))
        estimate.keep(t)
    missed = chosen.error_constant * (last - known[-1]) ** (p + 1) * math.factorial(p + 1)
    value = 1 + last ** (p + 1) + missed
    step.state.vec.FV().NumPy()[where] = unit * value
    assert estimate(last, chosen) == pytest.approx(abs(missed) / value, rel=1e-10)
