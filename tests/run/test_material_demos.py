"""The demos of materials and creep, and the documented material of one's own."""

import inspect
import textwrap
from pathlib import Path

import numpy as np
import pytest
from support import demo as load

import ngvisco as nv

DEMOS = Path(__file__).resolve().parents[2] / "demos"


def readme(name):
    return (DEMOS / name / "README.md").read_text().splitlines()


def check(ledger, order=1):
    """``order`` of the time scheme: of second order its dissipation is of either sign, and tiny."""
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert np.abs(ledger.column("mass_drift")).max() <= 1e-12
    assert ledger.column("rho_min").min() > 0
    assert ledger.column("J_min").min() > 0
    if order == 1:
        assert ledger.column("bregman").min() >= 0
    else:
        numerical = (ledger.column("bregman") + ledger.column("inertial")).sum()
        assert abs(numerical) <= 1e-4 * ledger.column("kinetic").max()


def test_acoustic_wave_has_the_speed_of_sound():
    """1.0017 m/s against 1, by the time between two minima of the kinetic energy."""
    demo = load("barotropic")
    run = demo.simulation()
    ledger = run.run(2.0)
    assert demo.sound_speed(ledger) == pytest.approx(1.0, rel=2e-3)
    check(ledger, run.scheme.order)


@pytest.mark.parametrize("name", ["mooney_rivlin", "creep_finite"])
def test_demo_keeps_energy_mass_and_positivity(name):
    demo = load(name)
    run = demo.simulation(maxh=0.5)
    check(run.run(5 * run.dt), run.scheme.order)


@pytest.mark.long
@pytest.mark.parametrize("name", ["mooney_rivlin", "barotropic", "creep_finite"])
def test_whole_demo_writes_what_its_readme_shows(name, tmp_path):
    run = load(name).main(str(tmp_path))
    assert run.ledger.column("step")[-1] >= 50
    check(run.ledger, run.scheme.order)
    pictures = {line.split("(")[1].rstrip(")") for line in readme(name) if line.startswith("![")}
    assert {"energies.png", "fields.png"} <= pictures
    for file in ("ledger.csv", "run.h5", "vtk/fields.pvd", *pictures):
        assert (tmp_path / file).stat().st_size > 0


def test_documented_material_of_ones_own_runs():
    """The example in CustomMaterial's docstring: 15 lines at most."""
    text = inspect.getdoc(nv.CustomMaterial)
    code = textwrap.dedent(text.split("Example::\n", 1)[1].split("\nParameters\n", 1)[0])
    lines = [line for line in code.splitlines() if line.strip()]
    assert 5 <= len(lines) <= 15
    names = {}
    exec(code, names)
    check(names["ledger"])
    assert names["ledger"].column("kinetic")[-1] > 0
