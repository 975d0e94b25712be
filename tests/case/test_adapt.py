"""Cases with [domain.adapt], on meshes that follow a field."""

import re

import pytest
from support import by_ci, refuse_steps

import ngvisco as nv
from ngvisco.case.build import parse_case
from ngvisco.cli.main import main
from ngvisco.run.snapshot import mesh_of_checkpoints

PULSE = """
[domain]
geometry = "box"
size = [3.0, 0.5]
maxh = 0.5
[domain.adapt]
field = "pressure"
above = 0.05
every = 0.2
[material]
kind = "LinearElastic"
K_e = 4.0
G_e = 0.01
[time]
dt = 0.05
until = 0.8
scheme = "midpoint"
[initial]
velocity = ["2e-3*exp(-((x - 1)/0.2)**2)", 0.0]
[output.checkpoint]
every = 3
"""


def case(tmp_path, *settings):
    return parse_case(PULSE, "pulse.toml", tmp_path, settings)


@pytest.mark.parametrize("until", [0.2, by_ci(0.3)])
def test_a_run_that_ended_early_is_resumed_bit_for_bit(tmp_path, until):
    whole = nv.case.run(case(tmp_path), tmp_path / "whole")
    nv.case.run(case(tmp_path, f"time.until={until}"), tmp_path / "parts")
    parts = nv.case.resume(tmp_path / "parts", 0.8)
    assert parts.mesh.ne == whole.mesh.ne > case(tmp_path).mesh().ne
    for file in ("ledger.csv", "vtk/fields.pvd"):
        assert (tmp_path / "parts" / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()
    loaded = [nv.load(tmp_path / name) for name in ("whole", "parts")]
    states = [one.simulation.rothe_step.state.vec.FV().NumPy() for one in loaded]
    assert states[0].tobytes() == states[1].tobytes()
    assert mesh_of_checkpoints(tmp_path / "whole" / "run.h5").step > 0
    taken = whole.ledger.column("transfer").sum()
    assert taken > 0 and loaded[0].ledger["transfer"].sum() == pytest.approx(taken)
    log = (tmp_path / "whole" / "log.txt").read_text()
    meshes = re.findall(r"\d+ cells, \d+ unknowns", log)
    assert len(set(meshes)) > 2
    assert log.count("step ") == 16 and "reached" not in log


def test_after_a_change_of_the_step_the_mesh_is_chosen_at_times_that_steps_end(tmp_path):
    """Steps of 0.04 after t = 0.3 do not end at multiples of 0.2, but 0.2 after t = 0.3."""
    place, stops = tmp_path / "run", []
    nv.case.run(case(tmp_path, "time.until=0.3"), place)
    with pytest.MonkeyPatch.context() as patch:
        run = nv.Simulation.run
        patch.setattr(
            nv.Simulation, "run", lambda self, stop, times: (stops.append(stop), run(self, stop, times))
        )
        assert nv.case.resume(place, settings=["time.dt=0.04", "time.until=0.62"]).t == pytest.approx(0.62)
    assert stops == pytest.approx([0.5, 0.62])
    assert abs(nv.read_ledger(place / "run.h5")["closure_relative"]).max() < 1e-11


def test_check_reports_the_number_of_cells_at_the_start(tmp_path, capsys):
    (tmp_path / "pulse.toml").write_text(PULSE.replace('"pressure"', '"velocity"'))
    assert main(["check", str(tmp_path / "pulse.toml")]) == 0
    said = capsys.readouterr().out
    coarse, start = case(tmp_path).mesh().ne, int(re.search(r"mesh +(\d+) cells", said)[1])
    assert coarse < start < 4 * coarse
    assert f"every 0.2 s, by velocity; the mesh has from {coarse} to about {4 * coarse} cells" in said


def test_a_second_run_starts_from_the_last_state_on_an_adapted_mesh(tmp_path):
    nv.case.run(case(tmp_path, "time.until=0.3"), tmp_path / "first")
    later = nv.case.run(case(tmp_path, "time.until=0.6"), tmp_path / "later", source=tmp_path / "first")
    assert later.t == pytest.approx(0.6) and later.number == 6
    assert abs(later.ledger.column("closure_relative")).max() < 1e-11


def test_a_step_that_fails_on_a_later_mesh_leaves_the_earlier_steps_in_the_directory(tmp_path, monkeypatch):
    refuse_steps(monkeypatch, lambda interval: interval.end > 0.27)
    with pytest.raises(nv.StepError):
        nv.case.run(case(tmp_path), tmp_path / "out")
    kept = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"case.toml", "ledger.csv", "run.h5", "failed.txt"} <= kept
    assert nv.load(tmp_path / "out").time > 0.2  # the kept state is on the second mesh
