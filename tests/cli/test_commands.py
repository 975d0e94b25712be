"""The commands, called in this process: their output, their files, and refused arguments."""

import json
import re
import shutil
import sys
import time
import tomllib
from types import SimpleNamespace

import h5py
import pytest
from ngsolve import GridFunction

import ngvisco as nv
from ngvisco.case.directory import RunDirectory
from ngvisco.cli.main import main, parser
from ngvisco.cli.run import ProgressBar
from ngvisco.run.stepping import Rejection


def ended(*words):
    """The exit code, also of argparse's own exits."""
    try:
        return main([str(word) for word in words])
    except SystemExit as end:
        return end.code


def test_a_run_directory_explains_its_files(finished):
    names = {path.name for path in finished.iterdir()}
    assert {"case.toml", "versions.json", "mesh.vol", "ledger.csv", "run.h5", "vtk", "log.txt"} <= names
    resolved = tomllib.loads((finished / "case.toml").read_text())
    assert resolved["discretisation"]["k"] == 2 and resolved["material"]["G_e"] == 5
    versions = json.loads((finished / "versions.json").read_text())
    assert versions["ngsolve"] and versions["numpy"] and len(versions["mesh_sha256"]) == 64
    log = (finished / "log.txt").read_text()
    assert re.search(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d  step +4/4 .*closure", log, re.M)


def test_load_returns_the_ledger_and_the_state_of_a_run(finished):
    results = nv.load(finished)
    assert results.ledger["step"].tolist() == [0, 1, 2, 3, 4] and results.time == 0.08
    assert isinstance(results.fields["velocity"], GridFunction)
    speed = results.simulation.sampler.extrema(results.fields["density"])
    assert speed[1] == results.ledger["rho_max"][-1]
    earlier = nv.load(finished, step=3)
    assert earlier.time == pytest.approx(0.06) and len(earlier.simulation.ledger.rows) == 4


def test_the_run_file_has_units_and_attributes(finished):
    with h5py.File(finished / "run.h5") as file:
        assert {"format", "ngvisco", "mesh", "spaces", "material", "case", "units"} <= set(file.attrs)
        assert file["ledger/kinetic"].attrs["unit"] == "J"
        assert sorted(file["checkpoints"]) == ["00000003", "00000004"]  # the last two are kept
        assert file["checkpoints/00000004"].attrs["time"] == 0.08


@pytest.mark.long
@pytest.mark.ci
def test_the_commands_plot_info_and_list_draw_and_describe_a_run(finished, capsys):
    assert ended("plot", finished, "--fields", "J,velocity,cauchy_stress_12") == 0
    for name in ("energies.png", "history.png", "fields.png"):
        assert (finished / name).read_bytes().startswith(b"\x89PNG")
    assert ended("plot", finished, "--format", "svg", "--fields", "pressure_from_rest") == 0
    text = (finished / "fields.svg").read_text()
    assert text.startswith("<?xml")
    assert ended("plot", finished, "--movie", "--fields", "J") == 0
    assert (finished / "movie.gif").read_bytes().startswith(b"GIF8")
    assert ended("plot", finished, "--movie", finished / "movie.avi") == 2
    assert ended("info", finished) == 0
    printed = capsys.readouterr().out
    assert "t = 0.08 of 0.08 s, step 4; finished" in printed and "largest |closure|" in printed
    assert ended("list") == 0
    printed = capsys.readouterr().out
    for word in ("NeoHookean: K_e, G_e, epsilon", "box: size, maxh", "Slip", "Gravity: g, [name]", "density"):
        assert word in printed


def test_a_new_case_is_explained_and_valid(capsys, tmp_path):
    assert ended("new") == 0
    assert "swirl " in capsys.readouterr().out
    assert ended("new", "swirl") == 0
    (tmp_path / "case.toml").write_text(capsys.readouterr().out)
    assert nv.load_case(tmp_path / "case.toml").until == 1
    assert ended("explain", "time.dt") == 0
    assert "Length of a step" in capsys.readouterr().out
    assert ended("list", "--keys") == 0
    assert "  time.dt: number, > 0, s; required; Length of a step" in capsys.readouterr().out
    assert ended("list", "--schema") == 0
    assert json.loads(capsys.readouterr().out)["title"] == "ngvisco case file"
    for words in (("new", "swril"), ("explain", "tim.dt"), ("list", "--keys", "--schema")):
        assert ended(*words) == 2
        assert "swirl" in (said := capsys.readouterr().err) or "time.dt" in said or "not allowed" in said


def test_check_prints_a_report_and_writes_no_file(case_file, capsys, monkeypatch):
    monkeypatch.chdir(case_file.parent)
    assert ended("check", case_file) == 0
    printed = capsys.readouterr().out
    for pattern in (
        r"\d+ cells",
        r"carried +F, J, by the default elastic_state = 'F', since there is no creep, and m >= 1",
        r"unknowns +\d+",
        r"4 steps of 0.02 s",
        r"scales +L 1 m, h 0\.\d+ m, v [\d.]+ m/s so far, waves 4.84 and 3.16 m/s",
        r"Reynolds, rho v L/G_v +\d+",
        r"advice +shear waves cross the domain in 0.32 s, 16 steps",
        r"memory +\d+ MB",
        r"s a step, .* in all, after \S+ s of set-up, and 0\.\d+ s for 2 files of fields \(from 4 measured",
    ):
        assert re.search(pattern, printed), pattern
    # rows of 4 steps: the start, every so many steps, and the end
    for every, files in ((2, 3), (3, 3), (4, 2)):
        assert ended("check", case_file, "--set", f"output.vtk.every={every}") == 0
        assert f" s for {files} files of fields" in capsys.readouterr().out
    assert list(case_file.parent.iterdir()) == [case_file]


def test_the_time_of_set_up_includes_the_imports(case_file, capsys, monkeypatch):
    """Imports take longer than all steps of a tiny run; main without arguments is a process of its own."""
    monkeypatch.setattr("ngvisco.cli.main.clock.process_time", lambda: 7200.0)
    monkeypatch.setattr("sys.argv", ["ngvisco", "check", str(case_file)])
    assert main() == 0
    assert "after 2.0 h of set-up" in capsys.readouterr().out


def test_check_estimates_the_number_of_adaptive_steps_by_the_longest_step(case_file, capsys):
    """The first step lasts a microsecond. An estimate by this length would be a million steps, or days for a
    run of seconds."""
    settings = ["time.dt=1e-6", "time.until=1", "time.adaptive.dt_min=1e-7", "time.adaptive.dt_max=0.05"]
    words = [word for setting in (*settings, "domain.size=[2,1]") for word in ("--set", setting)]
    assert ended("check", case_file, *words) == 0
    printed = capsys.readouterr().out
    for pattern in (
        r"adaptive steps to t = 1 s, the first 1e-06 s long; the least number of steps is 20, ",
        r"scales +domain 1 to 2 m",
        r"in all, after .* of set-up, and .* for each file of fields, "
        r"if all steps had the length dt_max; the present length is ",
    ):
        assert re.search(pattern, printed), pattern
    each, whole, unit = re.search(r"estimate +(\S+) s a step, (\S+) (s|min) in all", printed).groups()
    first_and_others = float(whole) * {"s": 1, "min": 60}[unit] / float(each)
    assert first_and_others > 15  # the run has twenty steps; its first step takes longer


@pytest.mark.filterwarnings("default::ngvisco.errors.InputWarning")
@pytest.mark.parametrize(("kind", "count"), [("NeoHookean", 1), ("ReferentialNeoHookean", 0)])
def test_check_names_the_stress_at_rest_that_open_walls_do_not_balance(kind, count, tmp_path, capsys):
    law = "K_e = 10\nG_e = 5" + "\nepsilon = 0.1" * count
    case = f"""[domain]
geometry = "box"
size = [1, 1]
maxh = 1.0
[material]
kind = "{kind}"
{law}
[walls.left]
kind = "Open"
[time]
dt = 0.02
until = 0.02
"""
    (tmp_path / "bar.toml").write_text(case)
    assert ended("check", tmp_path / "bar.toml") == 0
    said = capsys.readouterr().err
    assert said.count("at 'left' T(I) is 15.0005 Pa, the given stress 0 Pa, the difference 15 Pa") == count
    assert said.count("stress of the matter at rest") == count


@pytest.mark.long
def test_the_estimated_time_of_a_run_is_right_within_a_factor_of_1_5(case_file, capsys, tmp_path):
    settings = ("--set", "time.until=2", "--set", "domain.maxh=0.2", "--set", "output.vtk.enabled=false")
    assert ended("check", case_file, *settings) == 0
    each = float(re.search(r"estimate +(\S+) s a step", capsys.readouterr().out)[1])
    began = time.perf_counter()
    assert ended("run", case_file, "-o", tmp_path / "out", "--quiet", *settings) == 0
    taken = time.perf_counter() - began
    assert 1 / 1.5 < 100 * each / taken < 1.5, f"{100 * each:.1f} s said, {taken:.1f} s taken"


def test_version_and_help_are_printed(capsys):
    assert ended("--version") == 0
    assert capsys.readouterr().out == f"ngvisco {nv.__version__}\n"
    assert ended("--help") == 0
    printed = capsys.readouterr().out
    for word in ("run", "resume", "check", "info", "plot", "scene", "list", "explain", "new", "exit codes"):
        assert word in printed
    for name in ("run", "resume", "check", "info", "plot", "scene", "list", "explain", "new"):
        assert ended(name, "--help") == 0
    assert parser().prog == "ngvisco"


def test_progress_bar_shows_time_energy_closure_and_time_left(capsys, case_file, tmp_path, monkeypatch):

    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert ended("run", case_file, "-o", tmp_path / "out", "--set", "time.until=0.04") == 0
    bars = capsys.readouterr().out.split("\r")
    assert re.search(r"\[#+\.+\] t 0.02/0.04 s  step 1  energy \S+ J  closure \S+  \d+ s left", bars[-2])
    assert re.search(r"\[#+\] t 0.04/0.04 s  step 2", bars[-1])


def test_progress_bar_says_why_a_step_was_rejected_and_what_was_limited(capsys):
    ledger = SimpleNamespace(rows=[{}])
    simulation = SimpleNamespace(t=0.02, step_number=1, ledger=ledger)
    row = {"kinetic": 1.0, "stored": 2.0, "closure_relative": 1e-15, "limited_cells": 3.0}
    bar = ProgressBar(0.04)
    bar._set_out(simulation)
    bar.step(simulation, row)
    bar.rejected(simulation, Rejection(0.02, 0.02, "stalled; the step is taken in parts of 0.01 s"))
    out = capsys.readouterr().out
    assert "step 1  " in out and "limited 3 cells" in out
    assert "rejected dt 0.02 s at t 0.02 s: stalled; the step is taken in parts of 0.01 s\n" in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "required: COMMAND"),
        (("frobnicate",), "invalid choice"),
        (("run",), "required: CASE"),
        (("run", "missing.toml"), "missing.toml: the file cannot be read"),
        (("run", "CASE", "--set", "nonsense"), "expected key.path=value"),
        (("run", "CASE", "--set", "time.until=-1"), "time.until (set on the command line): -1.0"),
        *(
            (
                (*command, "--set", "time.until=0.085"),
                "time.until (set on the command line): 0.085: expected a mu",
            )
            for command in (
                ("check", "CASE"),
                ("run", "CASE"),
                ("sweep", "CASE", "--vary", "material.G_e=1,2"),
                ("gradient", "CASE", "--by", "material.G_e", "--of", "kinetic at 0"),
            )
        ),
        (("run", "CASE", "--threads", "0"), "expected a whole number >= 1"),
        (("run", "CASE", "--threads", "9" * 5000), "expected a whole number >= 1"),
        (("run", "CASE", "--threads", "100000"), "100000: expected at most"),
        (("resume", "EMPTY"), "not a run directory"),
        (
            ("resume", "RUN", "--until", "soon"),
            "'soon' is neither a number nor a number with a unit",
        ),
        (("resume", "RUN", "--until", "nan"), "--until = 'nan'"),
        (
            ("resume", "RUN", "--until", "0.04"),
            "ngvisco: --until = '0.04': expected a time after t = 0.08 s, which the run has already reached",
        ),
        (
            ("resume", "RUN", "--set", "time.until=0.04"),
            "time.until (set on the command line): 0.04: expected a time",
        ),
        (("resume", "RUN", "--until", "0.085"), "--until = '0.085': expected a multiple of dt"),
        (("resume", "RUN", "--until", "2 m"), "'m' does not have the dimension of s"),
        (("info", "EMPTY"), "not a run directory"),
        (("plot", "EMPTY"), "not a run directory"),
        (
            ("scene", "RUN", "--fields", "Jj"),
            "ngvisco: --fields = 'Jj': unknown field 'Jj'; did you mean 'J'?",
        ),
        (
            ("plot", "RUN", "--movie", "film.avi"),
            "ngvisco: --movie = 'film.avi': expected a name that ends in .gif",
        ),
        (
            ("plot", "RUN", "--movie", "--step", "4"),
            "ngvisco: --step = 4: expected no such option together with --movie",
        ),
        (("plot", "RUN", "--fps", "5"), "ngvisco: --fps = 5.0: expected --fps only together with --movie"),
        (("plot", "RUN", "-o", ""), "-o/--output: '': the name is empty; expected a directory"),
        (
            ("gradient", "CASE", "--by", "material.G_e", "--of", "kinetic at 9"),
            "--of = 'kinetic at 9': expected a time of",
        ),
        (
            ("gradient", "CASE", "--by", "material.G_e", "--of", "kin at 0"),
            "--of = 'kin at 0': unknown column 'kin'",
        ),
        (
            ("gradient", "CASE", "--by", "material.Ge", "--of", "kinetic at 0"),
            "--by = 'material.Ge': unknown part in",
        ),
        (
            ("gradient", "CASE", "--by", "domain.maxh", "--of", "kinetic at 0"),
            "--by = 'domain.maxh': expected the key of a number in bodies, initial, loads",
        ),
        (
            ("run", "CASE", "--from", "nowhere"),
            "ngvisco: --from = 'nowhere': nowhere: this directory does not exist",
        ),
        (("sweep", "CASE", "--vary", "time.dt=0.01,0.02", "-o", "RUN"), "this is a run directory"),
        (
            ("resume", "RUN", "--set", "time.dt=0.03", "--set", "time.until=0.1", "--until", "0.11"),
            "--until does not change the case's time.until",
        ),
        (("plot", "RUN", "--movie", "--fps", "0"), "ngvisco: --fps = 0.0: expected a number in (0, 1000]"),
        (("plot", "RUN", "--section", "z=0"), "ngvisco: --section = 'z=0': expected no section"),
    ],
)
def test_wrong_input_is_explained_with_exit_code_2(words, message, case_file, finished, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    known = {"CASE": case_file, "RUN": finished, "EMPTY": tmp_path / "empty"}
    words = [known.get(word, word) for word in words]
    if words[:1] == ["run"] and len(words) > 1:
        words += ["-o", tmp_path / "out"]
    assert ended(*words) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out" / "run.h5").exists()


def test_a_missing_checkpoint_is_explained_with_exit_code_3(finished, capsys):
    assert ended("plot", finished, "--step", 1) == 3
    message = f"--step = 1: {finished / 'run.h5'}: there is no checkpoint of step 1, only of 3, 4"
    assert message in capsys.readouterr().err


REFUSED = {
    "when it is read": "material.Ge=1",
    "with the mesh": "domain.maxh=1e-9",
    "at the start": "loads.0.g=[0, 'log(x - 2)']",
    "at a later time": "loads.0.g=[0, 'sqrt(0.05 - t)']",
    "as output": "output.vtk.fields=['Jj']",
}


@pytest.mark.parametrize("setting", REFUSED.values(), ids=REFUSED)
def test_a_refused_case_leaves_no_files_and_cites_the_users_file(setting, case_file, tmp_path, capsys):
    out = tmp_path / "results" / "out"
    assert ended("run", case_file, "-o", out, "--set", setting) == 2
    assert not out.exists() and sorted(tmp_path.iterdir()) == [case_file]
    said = capsys.readouterr().err
    assert said.startswith(f"ngvisco: {case_file}: ") or said.startswith(f"ngvisco: {case_file}:")
    assert "(set on the command line)" in said


def test_the_force_option_removes_nothing_if_the_case_is_refused(half, case_file):
    before = {path: path.read_bytes() for path in half.rglob("*") if path.is_file()}
    for setting in ("time.dt=-1", "walls.lef.kind=Slip", "loads.0.g=[0, 'sqrt(0.05 - t)']"):
        assert ended("run", case_file, "-o", half, "--force", "--set", setting) == 2
    assert {path: path.read_bytes() for path in half.rglob("*") if path.is_file()} == before


@pytest.fixture
def half(tmp_path, finished):
    return shutil.copytree(finished, tmp_path / "half")


def test_a_lock_file_exists_only_while_the_lock_is_held(tmp_path, case_file, half):
    (half / "run.h5").write_bytes(b"damaged")
    assert ended("resume", half) == 3
    assert ended("run", case_file, "-o", half) == 2
    assert not (half / "lock").exists()
    place = RunDirectory(tmp_path / "new")
    with place.locked():
        assert place.lock_file.read_text().startswith("process ")
        with pytest.raises(nv.RunDirectoryError, match=r"process .* uses this directory"), place.locked():
            pass
    assert not place.path.exists()


@pytest.mark.filterwarnings("default")
def test_a_ledger_that_does_not_close_is_reported(case_file, tmp_path, capsys, monkeypatch):
    from ngvisco.forms.terms.momentum import Loading

    monkeypatch.setattr(Loading, "entries", lambda self, u: [])
    assert ended("run", case_file, "-o", tmp_path / "out", "--quiet") == 4
    said = capsys.readouterr()
    # the command warns when it finds the fault, and again at the end
    assert said.err.count("THE LEDGER DOES NOT CLOSE") == 2
    assert "ngvisco: warning: THE LEDGER DOES NOT CLOSE in 1 step" in said.err
    log = (tmp_path / "out" / "log.txt").read_text(encoding="utf-8")
    assert "ClosureWarning: THE LEDGER" in log and "DOES NOT CLOSE in 4 steps" in log


def test_the_last_line_says_that_the_run_ended_and_explains_closure(case_file, tmp_path, capsys):
    assert ended("run", case_file, "-o", tmp_path / "out") == 0
    printed = capsys.readouterr().out
    assert "finished: t = 0.08 s after 4 steps; largest |closure|" in printed
    assert "finished at t = 0.08 s" in printed and "stopped" not in printed
    assert "the residual of a step's energy balance" in printed


@pytest.mark.filterwarnings("default")
def test_warnings_are_in_the_log(case_file, tmp_path, capsys):
    setting = "walls.top={kind='Traction', f=[0, 1]}"
    assert ended("run", case_file, "-o", tmp_path / "out", "--quiet", "--set", setting) == 0
    assert "ngvisco: warning: walls.top.f: 100% of the traction" in capsys.readouterr().err
    assert "InputWarning: walls.top.f: 100%" in (tmp_path / "out" / "log.txt").read_text()
