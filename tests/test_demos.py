"""Every demo runs as its README says, and keeps what the paper proves at each of its steps."""

import inspect
import textwrap
from pathlib import Path

import numpy as np
import pytest
from ngsolve import Integrate
from support import by_ci
from support import demo as load

import ngvisco as nv
import ngvisco.case
from tests.verification.cases.shear import TABLE

DEMOS = Path(__file__).resolve().parents[1] / "demos"
LONG, CI = pytest.mark.long, (pytest.mark.long, pytest.mark.ci)


def balanced(run, drift=1e-12):
    """A run's ledger, whose energy and mass are balanced."""
    ledger = getattr(run, "ledger", run)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert np.abs(ledger.column("mass_drift")).max() <= drift
    return ledger


def check(run, order):
    """Check a demo's run. With a time scheme of ``order`` 2 the scheme's dissipation has either sign and is
    tiny."""
    ledger = balanced(run)
    assert ledger.column("rho_min").min() > 0 and ledger.column("J_min").min() > 0
    if order == 1:
        assert ledger.column("bregman").min() >= 0
    else:
        numerical = (ledger.column("bregman") + ledger.column("inertial")).sum()
        assert abs(numerical) <= 1e-4 * ledger.column("kinetic").max()


def pictures(demo):
    """Names that the demo's README shows."""
    lines = (demo / "README.md").read_text().splitlines()
    return {line.split("(")[1].rstrip(")") for line in lines if line.startswith("![")}


def written(folder, *files):
    assert all((folder / file).stat().st_size > 0 for file in files)


CLEAN = pytest.mark.filterwarnings("error::ngvisco.run.ledger.DefectWarning")
"""Demos whose runs must not warn, since users run them first."""


@pytest.mark.parametrize(
    ("name", "steps", "options"),
    [
        pytest.param("swirl", 5, {"until": 0.1, "maxh": 0.4}, marks=[*CI, CLEAN]),
        pytest.param("swirl", 50, {}, marks=[LONG, CLEAN]),
        by_ci("swirl3d", 2, {"until": 0.04, "maxh": 0.7}),
        pytest.param("swirl3d", 50, {}, marks=LONG),
        pytest.param("creep", 50, {}, marks=CI),
    ],
)
def test_demo_keeps_energy_mass_and_positivity(name, steps, options, tmp_path):
    run = load(name).main(str(tmp_path), **options)
    ledger = balanced(run)
    assert ledger.column("step")[-1] >= steps
    assert ledger.column("rho_min").min() > 0
    if not np.isnan(ledger.column("J_min")[0]):  # the linearised model has no J
        assert ledger.column("J_min").min() > 0
    for column in ("dissipation_hyper", "dissipation_stokes_shear"):
        assert ledger.column(column).min() >= 0
    if run.scheme.order == 1:  # with second order both remainders have either sign
        assert min(ledger.column("bregman").min(), ledger.column("inertial").min()) >= 0
    written(tmp_path, "ledger.csv", "run.h5", "energies.png", "fields.png", "vtk/fields.pvd")
    if name == "swirl":  # the demo's picture compares the losses: that of backward Euler is 0.145 J
        written(tmp_path, "schemes.png")
        assert abs((ledger.column("inertial") + ledger.column("bregman")).sum()) <= 1e-5


@pytest.mark.long
@pytest.mark.ci
def test_swirl_recoils_elastically():
    """The kinetic energy falls below 4 % of its initial value, and returns to more than three quarters."""
    run = load("swirl").simulation(maxh=0.35)
    kinetic = run.run(0.3).column("kinetic")
    low = int(np.argmin(kinetic[:10]))
    assert kinetic[low] < 0.04 * kinetic[0]
    assert 0.75 * kinetic[0] < kinetic[low:].max() < kinetic[0]


@pytest.mark.long
def test_the_creep_test_demo_recovers_its_parameters_within_two_deviations(tmp_path):
    """The fit takes four runs with two derivatives each; the demo's README has their cost in runs."""
    demo = load("creep_test")
    found = demo.main(str(tmp_path))
    assert (abs(found.values - list(demo.TRUE.values())) < 2 * found.deviations).all()
    assert found.runs <= 4 and 0.2 < found.reduced < 2
    written(tmp_path, "fit.png")


@pytest.mark.long
def test_the_soft_spot_demo_finds_the_spot_below_the_stations(tmp_path):
    demo = load("soft_spot")
    stiffness = 3 * np.exp(demo.main(str(tmp_path))).reshape(demo.ROWS, demo.COLUMNS)
    assert stiffness[-1].argmin() == 6  # column 6 reaches from 2.4 m to 2.8 m
    assert stiffness[-1, 6] < 2.3 and stiffness[-1, :3].min() > 2.6
    written(tmp_path, "soft_spot.png")


@pytest.mark.long
@pytest.mark.ci
def test_integrals_of_the_sensitivity_demo_s_densities_are_derivatives_of_the_energy(tmp_path):
    demo = load("swirl_sensitivity")
    found = demo.main(str(tmp_path), until=0.04, maxh=0.6)
    number = "kinetic at 0.04"
    whole = Integrate(found.density(number, "density"), found.simulation.mesh)
    assert whole == pytest.approx(found[number, "initial.density"], rel=1e-8)
    of_number = nv.gradient(demo.simulation(0.6), 0.04, of=[number], by=["material.G_e"])
    stiffness = Integrate(found.density(number, "stiffness"), found.simulation.mesh)
    assert stiffness == pytest.approx(of_number[number, "material.G_e"], rel=1e-6)
    written(tmp_path, "sensitivity.png")


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.filterwarnings("ignore::ngvisco.run.ledger.DefectWarning")
def test_the_cavity_demo_continues_while_the_lid_tears_the_body(tmp_path):
    """The limiter acts under a lid with full speed up to the corners, and not under a smooth lid."""
    demo = load("cavity")
    run = demo.main(str(tmp_path), until=0.36, maxh=0.25)
    assert balanced(run, drift=1e-11).column("limited_cells").max() > 0
    written(tmp_path, "ledger.csv", "full.png", "smooth.png", "limiter.png", "vtk/fields.pvd")
    assert demo.simulation("smooth", 0.25).run(0.36).column("limited_cells").max() == 0


MAXH = {
    **dict.fromkeys(["cavity", "swirl"], 0.35),
    **dict.fromkeys(["couette", "shell"], 0.7),
    **dict.fromkeys(["creep", "creep_finite", "heat", "mooney_rivlin"], 0.6),
    **{"barotropic": 0.25, "cylinder": 2.0, "shear": 1.0, "swirl3d": 0.9, "wave": 0.4},
}
"""Cell sizes of coarse meshes for short tests; 0.5 m for demos that are not listed."""
CELLS = {"soft_spot": [4, 2], "collision": [7, 4], "slab": [3, 4], "soft_disc": [3, 4]}
"""Numbers of rows of cells of coarse boxes for short tests."""
SCRIPTS = {"shear": lambda demo: demo.simulation(), "wave": lambda demo: demo.amplitudes(0.02, 2)[0]}
"""The run that the case file describes, for demos whose mesh has no choice of size."""
DEAR = (
    *("cavity", "collision", "couette", "cylinder", "heat", "mooney_rivlin", "shell", "slab"),
    *("soft_disc", "swirl", "swirl3d"),
    *("creep", "creep_finite", "glacier", "notch", "plume", "wave"),
)
"""Demos each of which takes more than half a second of processor time."""


@pytest.mark.parametrize(
    "name",
    [by_ci(p.name) if p.name in DEAR else p.name for p in sorted(DEMOS.iterdir()) if p.is_dir()],
)
def test_case_file_gives_the_numbers_of_its_script(name, tmp_path):
    """The case goes through the run directory, whose mesh file keeps coordinates to rounding and curvature
    to 1e-9."""
    size = {"cells": CELLS[name]} if name in CELLS else {"maxh": MAXH.get(name, 0.5)}
    script = SCRIPTS.get(name, lambda demo: demo.simulation(**size))(load(name))
    until = 2 * script.dt
    settings = [f"time.until={until!r}", *(f"domain.{key}={value}" for key, value in size.items())]
    run = nv.case.run(nv.load_case(DEMOS / name / f"{name}.toml", settings), tmp_path)
    theirs = script.ledger if script.number else script.run(until)
    ours = run.ledger
    assert run.dt == script.dt and run.number == script.number
    assert run.t == pytest.approx(until)  # the run takes two steps, or more if a hard first step is halved
    assert ours.columns == theirs.columns
    for column in ours.columns:
        # these columns measure rounding
        if not column.startswith(("closure", "mass_drift", "newton")) and "defect" not in column:
            a, b = ours.column(column), theirs.column(column)
            assert a == pytest.approx(
                b, rel=1e-7, abs=1e-7 * np.abs(np.nan_to_num(b)).max() + 1e-13, nan_ok=True
            ), column


@pytest.mark.long
@pytest.mark.ci
def test_a_beam_on_an_elastic_foundation_settles_to_the_deflection_of_beam_theory(tmp_path):
    demo = load("foundation")
    run = demo.main(str(tmp_path))
    at = np.linspace(0, demo.LENGTH, 9)
    w = run.fields["displacement_bottom"](run.mesh(at, 0 * at))[:, 1]
    assert w == pytest.approx(demo.theory(at), rel=0.01)
    balanced(run)
    written(tmp_path, "foundation.png")


@pytest.mark.long
@pytest.mark.ci
def test_soft_disc_keeps_its_mass_and_is_carried_by_the_flow(tmp_path):
    demo = load("soft_disc")
    run = demo.main(str(tmp_path), until=0.15, cells=(4, 5))
    balanced(run)
    rows = np.genfromtxt(tmp_path / "bodies.csv", delimiter=",", names=True)
    assert rows["disc_mass"] == pytest.approx(rows["disc_mass"][0], rel=1e-12)
    assert rows["disc_mass"][0] == pytest.approx(0.04 * np.pi, rel=1e-3)
    # the volume changes a little, since K_e is only 20 Pa
    assert rows["disc_volume"] == pytest.approx(0.04 * np.pi, rel=0.01)
    # the disc lies below the vortex and moves against the lid's direction
    assert rows["disc_x"][-1] < rows["disc_x"][0]
    written(tmp_path, "disc.png", "energies.png", "fields.png", "run.h5")


def test_a_quarter_of_the_vortex_has_a_quarter_of_the_energies():
    """The case file is in the folder of the soft disc. Energies of the whole vortex are four times those of
    the quarter."""
    case = nv.load_case(DEMOS / "soft_disc" / "vortex.toml", ["domain.maxh=0.25"])
    run = case.simulation(case.mesh())
    ledger = run.run(2 * run.dt)
    assert 4 * ledger.column("kinetic")[0] == pytest.approx((0.1 * np.pi) ** 2 / 4, rel=0.02)
    assert ledger.column("stored")[-1] > ledger.column("stored")[0]
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10


def test_gel_rings_down_by_its_loss_factor():
    """The run has longer steps and two periods; without its Maxwell branch the layer would not be damped."""
    demo = load("gel")
    run, top = demo.simulation(dt=0.4), [1.0]
    while run.t < 24.0 - 1e-9:
        run.advance()
        top.append(run.fields["velocity"](run.mesh(0.1, 1.0))[0] / demo.A)
    s, theory = demo.exact(1.7, 0.4 * np.arange(len(top)))
    assert np.abs(top - theory).max() <= 0.02 < 0.5 < 1 - np.abs(theory[-25:]).max()
    at = demo.modulus(1j * s.imag, 1.7)
    # the formula holds for small damping
    assert -2 * s.real / s.imag == pytest.approx(at.imag / at.real, rel=0.1)
    assert balanced(run).column("dissipation_creep_mode_1")[1:].min() >= 0


@pytest.mark.long
@pytest.mark.ci
def test_the_glacier_flows_as_its_closed_form_says():
    """The cells have a size of 0.2 m. As a control, the velocity of a linear law (n = 1), halved so that it
    is the same at the top, does not agree."""
    demo, at = load("glacier"), np.linspace(0, 1, 21)
    run = demo.simulation(maxh=0.2, dt=0.4)
    ledger = run.run(12.0)
    v = run.fields["velocity"](run.mesh(0.2 + 0 * at, at))[:, 0]
    assert np.abs(v - demo.exact(3, at)).max() <= 0.03 < 0.2 < np.abs(v - 0.5 * demo.exact(1, at)).max()
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10


@pytest.mark.long
@pytest.mark.ci
def test_crack_runs_from_the_notch(tmp_path):
    run = load("notch").main(str(tmp_path), until=0.1, maxh=0.3)
    assert balanced(run).column("dissipation_damage")[1:].min() > 0
    written(tmp_path, "ledger.csv", "run.h5", "energies.png", "fields.png")


def test_demos_are_short_and_explained():
    for demo in (path for path in DEMOS.iterdir() if path.is_dir()):
        assert len((demo / f"{demo.name}.py").read_text().splitlines()) <= 100
        assert "What is seen" in (demo / "README.md").read_text(), demo
        assert all((demo / one).read_bytes().startswith(b"\x89PNG") for one in pictures(demo)), demo


# --- walls, periodic cells and curved domains meet their closed forms ------------------------------


def test_the_shear_demo_follows_the_published_table():
    """The table has six decimals, which are 0.1 % of its smallest entry."""
    demo = load("shear")
    assert list(demo.TIMES) == list(TABLE)
    assert np.abs(demo.exact(np.array(demo.TIMES)) - list(TABLE.values())).max() < 1e-6


@pytest.mark.long
@pytest.mark.ci
def test_the_shear_demo_agrees_with_the_whole_table_to_a_thousandth(tmp_path):
    """The midpoint rule takes 800 steps; the backward Euler scheme is off by a quarter in tau_11."""
    results = load("shear").main(str(tmp_path))
    for scheme, bounds in (("midpoint", (1e-6, 2.5e-4)), ("backward-euler", (1.5e-3, 0.3))):
        run, errors = results[scheme]
        assert errors.shape == (7, 2) and run.number == 800
        assert np.all(errors.max(axis=0) < bounds), scheme
        balanced(run)
    assert np.all(results["backward-euler"][1].max(axis=0) > 1e3 * results["midpoint"][1].max(axis=0))
    written(tmp_path, "stress.png")


@pytest.mark.parametrize(
    ("scheme", "mu"),
    [
        ("backward-euler", 0.0),
        *(by_ci(*case) for case in (("midpoint", 0.02), ("midpoint", 0.0), ("backward-euler", 0.02))),
    ],
)
def test_wave_has_the_speed_and_decay_of_the_dispersion_relation(mu, scheme):
    """Amplitudes are compared with exp(s dt), without the factor of the scheme, (1 + s dt/2)/(1 - s dt/2) or
    1/(1 - s dt)."""
    demo = load("wave")
    run, amplitudes = demo.amplitudes(mu, 16, scheme)
    exact, z = demo.dispersion(mu), np.exp(demo.DT * demo.exponent(amplitudes))
    s = (2 * (z - 1) / (z + 1) if scheme == "midpoint" else 1 - 1 / z) / demo.DT
    assert abs(s.imag / exact.imag) == pytest.approx(1, abs=3e-4)
    assert s.real == pytest.approx(exact.real, rel=2e-3)
    balanced(run)


@pytest.mark.long
def test_the_couette_demo_is_right_within_half_a_per_cent(tmp_path):
    _, error = load("couette").main(str(tmp_path))
    assert error < 0.005


@pytest.mark.long
@pytest.mark.ci
def test_heavy_body_sinks_in_the_shell():
    demo = load("shell")
    run = demo.simulation(maxh=0.6)
    before = demo.depth(run)
    run.run(0.6)
    assert demo.depth(run) < before - 0.005
    balanced(run)


@pytest.mark.long
def test_the_shell_demo_runs_as_its_readme_says(tmp_path):
    run, before, after = load("shell").main(str(tmp_path))
    assert after < before - 0.1
    balanced(run)


# --- materials and creep, and the documented material of one's own ----------------------------------


def test_acoustic_wave_has_the_speed_of_sound():
    """The time between two minima of the kinetic energy gives 1.0017 m/s, and the exact speed is 1 m/s."""
    demo = load("barotropic")
    run = demo.simulation()
    assert demo.sound_speed(run.run(2.0)) == pytest.approx(1.0, rel=2e-3)
    check(run, run.scheme.order)


@pytest.mark.parametrize("name", [by_ci("mooney_rivlin"), "creep_finite"])
def test_five_steps_of_a_demo_keep_energy_mass_and_positivity(name):
    run = load(name).simulation(maxh=0.5)
    run.run(5 * run.dt)
    check(run, run.scheme.order)


@pytest.mark.long
@pytest.mark.parametrize("name", ["mooney_rivlin", "barotropic", "creep_finite"])
def test_whole_demo_writes_what_its_readme_shows(name, tmp_path):
    run = load(name).main(str(tmp_path))
    assert run.ledger.column("step")[-1] >= 50
    check(run, run.scheme.order)
    assert {"energies.png", "fields.png"} <= pictures(DEMOS / name)
    written(tmp_path, "ledger.csv", "run.h5", "vtk/fields.pvd", *pictures(DEMOS / name))


def test_the_custom_material_of_the_documentation_runs():
    """The example in CustomMaterial's docstring has at most 15 lines."""
    text = inspect.getdoc(nv.CustomMaterial)
    code = textwrap.dedent(text.split("Example::\n", 1)[1].split("\nParameters\n", 1)[0])
    lines = [line for line in code.splitlines() if line.strip()]
    assert 5 <= len(lines) <= 15
    names = {}
    exec(code, names)
    check(names["ledger"], 1)
    assert names["ledger"].column("kinetic")[-1] > 0
