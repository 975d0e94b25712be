"""``ngvisco gradient`` and ``ngvisco fit``."""

import csv

import pytest
from command import CASE, command

PROBE = """
[[output.probes]]
name = "p"
point = [0.3, 0.6]
fields = ["velocity"]
"""


@pytest.fixture
def case(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(CASE + PROBE)
    return tmp_path / "case.toml"


def test_a_gradient_is_printed_and_written(case, tmp_path):
    asked = (
        "--of",
        "kinetic at 0.08",
        "--of",
        "p.velocity_1 until 0.06",
        "--by",
        "material.G_e,rheology.viscosity.G_v",
    )
    code, out, err = command("gradient", case, *asked, "-o", tmp_path / "out")
    assert code == 0 and "d/d material.G_e" in out, err
    with (tmp_path / "out/gradient.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["number", "value", "material.G_e", "rheology.viscosity.G_v"]
    assert [row[0] for row in rows[1:]] == ["kinetic at 0.08", "p.velocity_1 until 0.06"]
    code, _, err = command("gradient", case, *asked, "-o", tmp_path / "out")
    assert code == 2 and "--force" in err
    assert not (tmp_path / "samples").exists()  # nothing else is written


@pytest.mark.long
@pytest.mark.ci
def test_a_fit_finds_the_case_s_numbers(case, tmp_path):
    """Data of the case itself, as its run writes them: step, time and columns."""
    code, _, err = command("run", case, "-o", tmp_path / "run", "--quiet")
    assert code == 0, err
    data = tmp_path / "run/samples/p.csv"
    options = ("--by", "material.G_e", "--bounds", "material.G_e=1,20", "--sigma", "1e-4", "--quiet")
    code, out, err = command("fit", case, data, "--set", "material.G_e=6", *options, "-o", tmp_path / "fit")
    assert code == 0 and "ngvisco run" in out, err
    with (tmp_path / "fit/fit.csv").open() as file:
        _, row = csv.reader(file)
    assert float(row[2]) == pytest.approx(5.0, rel=1e-4) and (tmp_path / "fit/fit.png").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--sigma", "x"], "COLUMN=NUMBER"),
        (["--bounds", "material.G_e=1"], "KEY=LOW,HIGH"),
        (["--set", "time.until=0.04"], "after the end of the run"),
    ],
)
def test_wrong_input_of_a_fit(case, tmp_path, words, said):
    (tmp_path / "data.csv").write_text("time [ms],kinetic [mJ]\n20,1\n80,1\n")
    code, _, err = command("fit", case, tmp_path / "data.csv", "--by", "material.G_e", *words)
    assert code == 2 and said in err
