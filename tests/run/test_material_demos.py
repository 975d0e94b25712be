"""The demos of materials and creep, and the documented material of one's own."""

import importlib.util
import inspect
import textwrap
from pathlib import Path

import numpy as np
import pytest

import ngvisco as nv

DEMOS = Path(__file__).resolve().parents[2] / "demos"


def load(name):
    spec = importlib.util.spec_from_file_location(f"demo_{name}", DEMOS / name / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def check(ledger):
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert np.abs(ledger.column("mass_drift")).max() <= 1e-12
    assert ledger.column("rho_min").min() > 0
    assert ledger.column("J_min").min() > 0
    assert ledger.column("bregman").min() >= 0


def test_acoustic_wave_has_the_speed_of_sound():
    """1.0008 m/s against 1, by the time between two minima of the kinetic energy."""
    demo = load("barotropic")
    ledger = demo.simulation().run(2.0)
    assert demo.sound_speed(ledger) == pytest.approx(1.0, rel=2e-3)
    check(ledger)


@pytest.mark.parametrize("name", ["mooney_rivlin", "creep_finite"])
def test_demo_keeps_energy_mass_and_positivity(name):
    demo = load(name)
    run = demo.simulation(maxh=0.5)
    check(run.run(5 * run.dt))


@pytest.mark.long
@pytest.mark.parametrize("name", ["mooney_rivlin", "barotropic", "creep_finite"])
def test_whole_demo_writes_what_its_readme_shows(name, tmp_path):
    ledger = load(name).main(str(tmp_path)).ledger
    assert ledger.column("step")[-1] >= 50
    check(ledger)
    for file in ("ledger.csv", "run.h5", "energies.png", "fields.png", "vtk/fields.pvd"):
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
