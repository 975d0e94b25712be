"""Measurements in case files: a run writes them into its directory, and wrong ones are refused under their
key."""

import numpy as np
import pytest
from support import A_BODY, A_FALL, TWO_STEPS

import ngvisco as nv
from ngvisco.case.build import parse_case

CASE = f"""\
{A_BODY}{A_FALL}{TWO_STEPS}[output]
passive = ["reference_map"]
[[output.probes]]
name = "tip"
point = [1, 0.5]
fields = ["velocity", "pressure"]
[[output.lines]]
name = "middle"
start = [0, 0.5]
end = [1, 0.5]
points = 3
fields = ["density"]
[output.forces]
walls = ["bottom"]
[[output.integrals]]
name = "momentum"
of = "density*velocity_2"
"""


def case(text, tmp_path, *settings):
    return parse_case(text, "case.toml", tmp_path, settings)


def test_tables_of_a_case_are_written_and_count_among_the_results_of_the_run(tmp_path):
    run = nv.case.run(case(CASE, tmp_path), tmp_path / "out")
    samples = tmp_path / "out" / "samples"
    read = {
        path.stem: np.genfromtxt(path, delimiter=",", names=True, deletechars="")
        for path in samples.iterdir()
    }
    assert set(read) == {"tip", "middle", "forces", "momentum"}
    assert read["tip"]["tip.velocity_1"].tolist() == pytest.approx([0, 0, 0], abs=1e-14)
    assert read["middle"]["x"][-3:].tolist() == [0, 0.5, 1] and len(read["forces"]) == 2
    assert read["momentum"]["momentum"][1] == pytest.approx(-0.016, rel=0.1)
    assert run.t == 0.04
    place = nv.case.RunDirectory(tmp_path / "out")
    assert {path.name for path in place.results} >= {"tip.csv", "forces.csv"}
    nv.case.run(case(CASE, tmp_path, "output.probes=[]"), tmp_path / "out", force=True)
    assert not (samples / "tip.csv").exists() and (samples / "middle.csv").exists()


def test_measurements_do_not_change_the_hash_of_a_case(tmp_path):
    assert case(CASE, tmp_path).hash == case(CASE, tmp_path, "output.probes=[]").hash


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("output.probes.0.point=[2, 2]", r"output.probes.0.point .*expected a point of the domain"),
        ("output.probes.0.point=[1]", r"output.probes.0.point .*points of 2 finite coordinates"),
        ("output.probes.0.fields=['veloctiy']", "output.probes.0.fields .*did you mean 'velocity'"),
        ("output.probes.0.name='a/b'", "output.probes.0.name .*'a/b': expected 1 to 60 characters"),
        ("output.integrals.0.name='tip'", "output.integrals.0.name .*a name that no other table has"),
        ("output.lines.0.name='forces'", "output.lines.0.name .*both tables would write forces.csv"),
        ("output.lines.0.end=[0, 0.5]", "output.lines.0.end .*a point that differs from start"),
        ("output.lines.0.end=[3, 0.5]", "output.lines.0.end .*a point of the domain"),
        ("output.lines.0.points=1", "output.lines.0.points .*1: "),
        ("output.forces.walls=['botom']", "output.forces.walls .*did you mean 'bottom'"),
        ("output.forces.about=[0]", "output.forces.about .*points of 2"),
        ("output.integrals.0.of='densty'", "output.integrals.0.of .*did you mean 'density'"),
        ("output.integrals.0.of='__import__(1)'", "output.integrals.0.of .*unknown function"),
    ],
)
def test_faults_of_outputs_are_reported_under_their_keys(setting, message, tmp_path):
    with pytest.raises(nv.CaseError, match=message):
        loaded = case(CASE, tmp_path, setting)
        loaded.simulation(loaded.mesh())
