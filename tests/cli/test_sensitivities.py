"""``ngvisco gradient`` and ``ngvisco fit``."""

import csv
import shlex
import signal
import subprocess
import sys

import pytest
from command import CASE, command, environment
from support import by_ci

from ngvisco.case.build import load_case

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


STOPPED = """
import sys
from ngvisco.cli.main import main
from ngvisco.run.simulation import Simulation
from ngvisco.sensitivity.adjoint import Adjoint
where, places = sys.argv[1], {"run": (Simulation, "advance"), "adjoint": (Adjoint, "_step")}
owner, name = places[where]
done, one = [], getattr(owner, name)
def waiting(self, *arguments):
    done.append(0)
    if len(done) == 2:
        print("waits", flush=True)
        while not (self if where == "run" else self.trajectory.simulation).stop_requested:
            pass
    return one(self, *arguments)
setattr(owner, name, waiting)
sys.exit(main(sys.argv[2:]))
"""
"""Runs the command; the second step of the run or of the adjoint waits until it is asked to stop."""


@pytest.mark.parametrize("where", [by_ci("run"), "adjoint"])
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_gradient_stopped_by_a_signal_is_completed_by_the_same_command(case, tmp_path, where):
    words = [
        "gradient",
        case,
        "--of",
        "kinetic at 0.08",
        "--by",
        "material.G_e",
        "--method",
        "adjoint",
        "--quiet",
    ]
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert command(*words, "-o", whole)[0] == 0
    call = [sys.executable, "-c", STOPPED, where, *map(str, words), "-o", str(out)]
    process = subprocess.Popen(call, env=environment(), stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "waits\n"
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 128 + signal.SIGTERM and "a repeated command goes on" in said
    assert [path.name for path in out.iterdir()] == ["restart"]
    code, _, err = command(*words, "-o", out)
    assert code == 0, err
    assert [path.name for path in out.iterdir()] == ["gradient.csv"]
    assert (out / "gradient.csv").read_text() == (whole / "gradient.csv").read_text()


@pytest.mark.long
@pytest.mark.ci
def test_a_fit_recovers_the_values_of_the_case(case, tmp_path):
    """The data are those of the case itself, as its run writes them, with step, time and columns."""
    code, _, err = command("run", case, "-o", tmp_path / "run", "--quiet")
    assert code == 0, err
    data = tmp_path / "run/samples/p.csv"
    options = ("--by", "material.G_e", "--bounds", "material.G_e=1,20", "--sigma", "1e-4", "--quiet")
    code, out, err = command("fit", case, data, "--set", "material.G_e=6", *options, "-o", tmp_path / "fit")
    assert code == 0 and "ngvisco run" in out, err
    with (tmp_path / "fit/fit.csv").open() as file:
        _, row = csv.reader(file)
    assert float(row[2]) == pytest.approx(5.0, rel=1e-4) and (tmp_path / "fit/fit.png").exists()


UNITS = """
[units]
pressure = "kPa"
"""


@pytest.mark.long
@pytest.mark.ci
def test_a_fit_reads_and_prints_the_case_s_units(case, tmp_path):
    """Bounds are read as ``--set`` reads numbers, and the printed command sets the fitted numbers."""
    text = case.read_text().replace("G_e = 5", "G_e = 0.005").replace("K_e = 10", "K_e = 0.01") + UNITS
    case.write_text(text)
    code, _, err = command("run", case, "-o", tmp_path / "run", "--quiet", "--set", "time.until=0.06")
    assert code == 0, err
    words = ("--by", "material.G_e", "--bounds", "material.G_e=0.001,20 Pa", "--sigma", "1e-4", "--quiet")
    settings = ("--set", "material.G_e=0.006", "--set", "time.until=0.06")
    data = tmp_path / "run/samples/p.csv"
    code, out, err = command("fit", case, data, *settings, *words, "-o", tmp_path / "fit")
    assert code == 0, err
    (printed,) = [line for line in out.splitlines() if line.startswith("ngvisco run")]
    again = [
        text
        for word, text in zip(*(shlex.split(printed)[i:] for i in (0, 1)), strict=False)
        if word == "--set"
    ]
    assert "time.until=0.06" in again and again[-1].endswith(" Pa")
    assert load_case(case, again).sections.material.G_e == pytest.approx(5.0, rel=1e-4)


def test_a_fit_prints_no_command_for_values_without_keys(case, tmp_path):
    """A Prony series' case has shares and times; its run has creep moduli of branches."""
    elastic = "{kind='LinearElastic',K_e=10.0,G_e=1.0}"
    series = f"material={{kind='Prony',of='G_0',prony=[[0.5,1.0]],material={elastic}}}"
    (tmp_path / "data.csv").write_text("time,dissipation_creep_mode_1\n0.02,0.002\n0.04,0.001\n")
    words = ("--by", "material.branches.mode_1.creep.G_m", "--set", series, "--set", "time.until=0.04")
    code, out, err = command("fit", case, tmp_path / "data.csv", *words, "--quiet", "-o", tmp_path / "fit")
    assert code == 0, err
    assert "The case cannot take these values" in out and "ngvisco run" not in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--bounds", "material.G_e=1 s,2 s"], "does not have the dimension of Pa"),
        (["--sigma", "x"], "COLUMN=NUMBER"),
        (["--bounds", "material.G_e=1"], "KEY=LOW,HIGH"),
        (
            ["--bounds", "material.G_e=7,9 Pa"],
            "--bounds = 'material.G_e=7,9 Pa': expected two numbers LOW, HIGH with",
        ),
        (
            ["--sigma", "stored=1"],
            "--sigma = 'stored=1': expected a standard deviation > 0 of the column kinetic",
        ),
        (["--set", "time.until=0.04"], "but the run ends at"),
        (
            ["--by", "time.dt"],
            "--by = 'time.dt': expected the key of a number in bodies, initial, loads, material",
        ),
    ],
)
def test_wrong_input_of_a_fit_is_refused_with_its_reason(case, tmp_path, words, said):
    (tmp_path / "data.csv").write_text("time [ms],kinetic [mJ]\n20,1\n80,1\n")
    code, _, err = command("fit", case, tmp_path / "data.csv", "--by", "material.G_e", *words)
    assert code == 2 and said in err


def test_bounds_of_a_fit_that_admit_refused_values_are_named(case, tmp_path):
    # no modulus > 0 gives such energies
    (tmp_path / "data.csv").write_text("time,stored\n0.02,-1\n0.06,-1\n")
    words = ("--by", "material.G_e", "--bounds", "material.G_e=-90,10", "--quiet", "-o", tmp_path / "fit")
    code, _, err = command("fit", case, tmp_path / "data.csv", *words)
    expected = (
        "--bounds = 'material.G_e=-90,10': expected bounds whose values the run admits (material.G_e = "
    )
    assert code == 2 and expected in err
