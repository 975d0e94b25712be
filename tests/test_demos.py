"""Every demo runs as its README says, and keeps what the paper proves at each of its steps."""

from pathlib import Path

import numpy as np
import pytest
from support import demo as load

import ngvisco as nv
import ngvisco.case

DEMOS = Path(__file__).resolve().parents[1] / "demos"


CLEAN = pytest.mark.filterwarnings("error::ngvisco.run.ledger.DefectWarning")
"""The first thing that a user runs warns of nothing."""


@pytest.mark.parametrize(
    ("name", "steps", "options"),
    [
        pytest.param("swirl", 5, {"until": 0.1, "maxh": 0.4}, marks=CLEAN),
        pytest.param("swirl", 50, {}, marks=[pytest.mark.long, pytest.mark.ci, CLEAN]),
        ("swirl3d", 2, {"until": 0.04, "maxh": 0.7}),
        pytest.param("swirl3d", 50, {}, marks=pytest.mark.long),
        pytest.param("creep", 50, {}, marks=[pytest.mark.long, pytest.mark.ci]),
    ],
)
def test_demo_keeps_energy_mass_and_positivity(name, steps, options, tmp_path):
    run = load(name).main(str(tmp_path), **options)
    ledger = run.ledger
    assert ledger.column("step")[-1] >= steps
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert np.abs(ledger.column("mass_drift")).max() <= 1e-12
    assert ledger.column("rho_min").min() > 0
    if not np.isnan(ledger.column("J_min")[0]):  # the linearised model has no J
        assert ledger.column("J_min").min() > 0
    for column in ("dissipation_hyper", "dissipation_stokes_shear"):
        assert ledger.column(column).min() >= 0
    if run.scheme.order == 1:  # of second order they have either sign
        assert min(ledger.column("bregman").min(), ledger.column("inertial").min()) >= 0
    for file in ("ledger.csv", "run.h5", "energies.png", "fields.png", "vtk/fields.pvd"):
        assert (tmp_path / file).stat().st_size > 0
    if name == "swirl":  # what its picture compares: Euler's share of the loss is 0.145 J
        assert (tmp_path / "schemes.png").stat().st_size > 0
        assert abs((ledger.column("inertial") + ledger.column("bregman")).sum()) <= 1e-5


def test_swirl_recoils_elastically():
    """The kinetic energy falls below 4 % of its start and comes back to more than three quarters."""
    run = load("swirl").simulation(maxh=0.35)
    kinetic = run.run(0.3).column("kinetic")
    low = int(np.argmin(kinetic[:10]))
    assert kinetic[low] < 0.04 * kinetic[0]
    assert kinetic[low:].max() > 0.75 * kinetic[0]


def unloaded(name, dt):
    """The demo's body without gravity on a coarse mesh, in motion, by the paper's scheme."""
    demo = load(name)
    maxh = {"swirl3d": 0.6, "mooney_rivlin": 0.5, "creep_finite": 0.5}.get(name, 0.35)
    run = demo.simulation(maxh=maxh, dt=dt, gravity=0.0, scheme="backward-euler")
    if name == "creep_finite":  # it starts at rest: here it is released after two steps under its load
        loaded = demo.simulation(maxh=maxh)
        loaded.run(2 * loaded.dt)
        run.rothe_step.state.vec.data = loaded.rothe_step.state.vec
    return run


LONG = pytest.mark.long
BY_DEFAULT = {("swirl", 100): [], ("creep", 10): [], ("mooney_rivlin", 10): [LONG, pytest.mark.ci]}
"""Demos and factors of the step that are run by default and by CI."""


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        pytest.param(name, factor, marks=BY_DEFAULT.get((name, factor), LONG))
        for name in ("swirl", "swirl3d", "creep", "creep_finite", "mooney_rivlin", "barotropic")
        for factor in (1, 10, 100)
    ],
)
def test_energy_never_rises_without_load_for_any_step(name, factor):
    run = unloaded(name, factor * {"creep": 0.05, "creep_finite": 0.2}.get(name, 0.02))
    ledger = run.run(4 * run.dt)
    energy = ledger.column("kinetic") + ledger.column("stored")
    assert np.diff(energy).max() <= 1e-13 * energy[0]
    assert energy[-1] < energy[0] * (1 - 1e-9)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.filterwarnings("ignore::ngvisco.run.ledger.DefectWarning")
def test_cavity_goes_on_where_the_body_is_torn(tmp_path):
    """Under a lid of full speed cells are limited; under a smooth one none is."""
    demo = load("cavity")
    ledger = demo.main(str(tmp_path), until=0.36, maxh=0.25).ledger
    assert ledger.column("limited_cells").max() > 0
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert np.abs(ledger.column("mass_drift")).max() <= 1e-11
    for file in ("ledger.csv", "full.png", "smooth.png", "limiter.png", "vtk/fields.pvd"):
        assert (tmp_path / file).stat().st_size > 0
    assert demo.simulation("smooth", 0.25).run(0.36).column("limited_cells").max() == 0


SCRIPTS = {
    "barotropic": lambda demo: demo.simulation(),
    "cavity": lambda demo: demo.simulation(maxh=0.35),
    "collision": lambda demo: demo.simulation(cells=(7, 4)),
    "creep_finite": lambda demo: demo.simulation(maxh=0.6),
    "cylinder": lambda demo: demo.simulation(maxh=2.0),
    "foundation": lambda demo: demo.simulation(maxh=0.5),
    "glacier": lambda demo: demo.simulation(maxh=0.5),
    "heat": lambda demo: demo.simulation(maxh=0.6),
    "plume": lambda demo: demo.simulation(maxh=0.5),
    "mooney_rivlin": lambda demo: demo.simulation(maxh=0.6),
    "couette": lambda demo: demo.simulation(maxh=0.7),
    "creep": lambda demo: demo.simulation(maxh=0.6),
    "notch": lambda demo: demo.simulation(maxh=0.5),
    "shear": lambda demo: demo.simulation(),
    "shell": lambda demo: demo.simulation(maxh=0.7),
    "slab": lambda demo: demo.simulation(cells=(3, 4)),
    "soft_disc": lambda demo: demo.simulation(maxh=0.5),
    "swirl": lambda demo: demo.simulation(maxh=0.35),
    "swirl3d": lambda demo: demo.simulation(maxh=0.9),
    "wave": lambda demo: demo.amplitudes(0.02, 2)[0],
    "yield": lambda demo: demo.simulation(maxh=0.5),
}
MAXH = {
    "barotropic": 0.25,
    "cavity": 0.35,
    "couette": 0.7,
    "creep": 0.6,
    "creep_finite": 0.6,
    "cylinder": 2.0,
    "heat": 0.6,
    "plume": 0.5,
    "mooney_rivlin": 0.6,
    "shear": 1.0,
    "shell": 0.7,
    "soft_disc": 0.5,
    "swirl": 0.35,
    "swirl3d": 0.9,
    "wave": 0.4,
}
"""Of each demo's script the run that its case file describes, on a mesh that is soon computed."""
CELLS = {"collision": [7, 4], "slab": [3, 4]}
"""The same of boxes of rows of cells."""
DEAR = ("cavity", "collision", "cylinder", "shell", "slab", "soft_disc", "swirl3d")
"""More than a second of processor time each."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(p.name, marks=[LONG, pytest.mark.ci] if p.name in DEAR else [])
        for p in sorted(DEMOS.iterdir())
        if p.is_dir()
    ],
)
def test_case_file_gives_the_numbers_of_its_script(name, tmp_path):
    """Through the run directory, whose mesh file keeps coordinates to rounding and curvature to 1e-9."""
    script = SCRIPTS[name](load(name))
    until = 2 * script.dt
    size = f"cells={CELLS[name]}" if name in CELLS else f"maxh={MAXH.get(name, 0.5)}"
    settings = [f"time.until={until!r}", f"domain.{size}"]
    if name == "soft_disc":  # whose cells below the lid are half of the others
        settings.append(f"domain.refine.top={MAXH[name] / 2}")
    run = nv.case.run(nv.load_case(DEMOS / name / f"{name}.toml", settings), tmp_path)
    theirs = script.ledger if script.number else script.run(until)
    ours = run.ledger
    assert run.dt == script.dt and run.number == script.number
    assert run.t == pytest.approx(until)  # in two steps, or more where a hard start is taken in halves
    assert ours.columns == theirs.columns
    for column in ours.columns:
        if not column.startswith(("closure", "mass_drift", "newton")):  # rounding itself
            a, b = ours.column(column), theirs.column(column)
            assert a == pytest.approx(
                b, rel=1e-7, abs=1e-7 * np.abs(np.nan_to_num(b)).max() + 1e-13, nan_ok=True
            ), column


@pytest.mark.long
@pytest.mark.ci
def test_a_beam_on_ground_that_gives_comes_to_rest_as_beam_theory_says(tmp_path):
    demo = load("foundation")
    run = demo.main(str(tmp_path))
    at = np.linspace(0, demo.LENGTH, 9)
    w = run.fields["displacement_bottom"](run.mesh(at, 0 * at))[:, 1]
    assert w == pytest.approx(demo.theory(at), rel=0.01)
    assert np.abs(run.ledger.column("closure_relative")).max() <= 1e-10
    assert (tmp_path / "foundation.png").stat().st_size > 0


def test_soft_disc_keeps_its_mass_and_is_carried_by_the_flow(tmp_path):
    demo = load("soft_disc")
    run = demo.main(str(tmp_path), until=0.15, maxh=0.35)
    assert np.abs(run.ledger.column("closure_relative")).max() <= 1e-10
    rows = np.genfromtxt(tmp_path / "bodies.csv", delimiter=",", names=True)
    assert rows["disc_mass"] == pytest.approx(rows["disc_mass"][0], rel=1e-12)
    assert rows["disc_mass"][0] == pytest.approx(0.04 * np.pi, rel=1e-3)
    assert rows["disc_volume"] == pytest.approx(0.04 * np.pi, rel=0.01)  # K_e = 20 Pa
    assert rows["disc_x"][-1] < rows["disc_x"][0]  # below the vortex, against the lid
    for file in ("disc.png", "energies.png", "fields.png", "run.h5"):
        assert (tmp_path / file).stat().st_size > 0


def test_the_disc_in_a_vortex_is_a_quarter_of_the_problem():
    """The case file beside the soft disc: energies of the whole are four times those of the quarter."""
    case = nv.load_case(DEMOS / "soft_disc" / "vortex.toml", ["domain.maxh=0.25"])
    run = case.simulation(case.mesh())
    ledger = run.run(2 * run.dt)
    assert 4 * ledger.column("kinetic")[0] == pytest.approx((0.1 * np.pi) ** 2 / 4, rel=0.02)
    assert ledger.column("stored")[-1] > ledger.column("stored")[0]
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10


def test_glacier_flows_by_its_closed_form():
    """On cells of 0.2 m; half of the linear law's profile, which has the same velocity above, is not it."""
    demo, at = load("glacier"), np.linspace(0, 1, 21)
    run = demo.simulation(maxh=0.2, dt=0.4)
    ledger = run.run(12.0)
    v = run.fields["velocity"](run.mesh(0.2 + 0 * at, at))[:, 0]
    assert np.abs(v - demo.exact(3, at)).max() <= 0.03 < 0.2 < np.abs(v - 0.5 * demo.exact(1, at)).max()
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10


def test_crack_runs_from_the_notch(tmp_path):
    run = load("notch").main(str(tmp_path), until=0.1, maxh=0.3)
    ledger = run.ledger
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("dissipation_damage")[1:].min() > 0
    for file in ("ledger.csv", "run.h5", "energies.png", "fields.png"):
        assert (tmp_path / file).stat().st_size > 0


def test_demos_are_short_and_explained():
    for demo in (path for path in DEMOS.iterdir() if path.is_dir()):
        assert len((demo / f"{demo.name}.py").read_text().splitlines()) <= 60
        readme = (demo / "README.md").read_text()
        assert "What is seen" in readme, demo
        pictures = [line.split("(")[1].rstrip(")") for line in readme.splitlines() if line.startswith("![")]
        assert all((demo / picture).read_bytes().startswith(b"\x89PNG") for picture in pictures), demo
