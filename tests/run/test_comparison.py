"""Pictures of several runs: each quantity that all runs have has its own axis."""

import numpy as np
import pytest
from support import A_BODY, A_FALL, NO_VTK, TWO_STEPS

import ngvisco as nv
from ngvisco.cli.main import main
from ngvisco.run import plots
from ngvisco.run.pictures import LABELS, PAGE
from ngvisco.run.plots import plot_comparison

PROBE = '[[output.probes]]\nname = "p"\npoint = [0.5, 0.5]\n'
CASE = A_BODY.replace("0.6", "0.7") + A_FALL + TWO_STEPS + NO_VTK + PROBE


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    place = tmp_path_factory.mktemp("runs")
    (place / "case.toml").write_text(CASE)
    for name in ("a", "b"):
        settings = ["material.G_e=1"] if name == "b" else []
        nv.case.run(nv.load_case(place / "case.toml", settings), place / name)
    return place


@pytest.fixture
def drawn(monkeypatch):
    """The pictures that are saved, by name."""
    found, save = {}, plots.save

    def noted(fig, path):
        found[path.stem] = fig
        save(fig, path)

    monkeypatch.setattr(plots, "save", noted)
    return found


def test_runs_are_compared_in_one_picture_per_quantity(runs, tmp_path, drawn):
    written = plot_comparison({name: runs / name for name in "ab"}, tmp_path)
    assert [path.name for path in written] == ["comparison-energies.png", "comparison-probes.png"]
    assert all(path.stat().st_size > 0 for path in written)
    ledgers = [nv.read_ledger(runs / name / "run.h5") for name in "ab"]
    axes = {axis.get_title(): axis for axis in drawn["comparison-energies"].axes}
    lines = axes["kinetic energy, J"].lines
    for line, ledger in zip(lines, ledgers, strict=True):
        assert np.array_equal(line.get_ydata(), ledger["kinetic"])
    work = axes["work of loads and walls, J"].lines[1].get_ydata()
    assert work[-1] == pytest.approx((ledgers[1]["dt"] * ledgers[1]["power_gravity"]).sum(), rel=1e-14)
    titles = {axis.get_title() for axis in drawn["comparison-probes"].axes}
    assert {"p.density, kg/m³", "p.velocity 1, m/s", "p.pressure, Pa"} <= titles
    for fig in drawn.values():
        texts = [
            text
            for axis in fig.axes
            for text in (axis.title, *axis.get_xticklabels(), *axis.get_yticklabels())
        ]
        assert fig.get_figwidth() == PAGE and min(text.get_fontsize() for text in texts) >= LABELS


def test_a_comparison_has_the_chosen_fields_of_probes(runs, tmp_path, drawn):
    plot_comparison({name: runs / name for name in "ab"}, tmp_path, ["velocity_2"])
    assert [axis.get_title() for axis in drawn["comparison-probes"].axes][:1] == ["p.velocity 2, m/s"]
    with pytest.raises(
        nv.UnknownNameError, match="unknown field of the probes 'desity'; did you mean 'density'"
    ):
        plot_comparison({name: runs / name for name in "ab"}, tmp_path, ["desity"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--movie"], "--movie = '': expected no such option for several runs"),
        (["--step", "1"], "--step = 1: expected no such option for several runs"),
        (["--section", "x"], "--section = 'x'"),
    ],
)
def test_options_for_a_single_run_are_refused_for_several_runs(runs, capsys, words, message):
    assert main(["plot", str(runs / "a"), str(runs / "b"), *words]) == 2
    assert message in capsys.readouterr().err


def test_a_comparison_with_a_directory_without_a_run_is_refused(runs, tmp_path, capsys):
    assert main(["plot", str(runs / "a"), str(tmp_path), "-o", str(tmp_path)]) == 3
    assert "not a run directory with results" in capsys.readouterr().err


def test_plot_of_a_study_compares_its_runs(runs, capsys):
    """The picture contains the runs of the study that made a step, and names them."""
    (runs / "sweep.csv").write_text(
        "run,material.G_e,state,message\na,5,finished,\nb,1,finished,\nc,2,failed,no\n"
    )
    try:
        assert main(["plot", str(runs), "--format", "svg"]) == 0
        said = capsys.readouterr().out.splitlines()
        assert said == [str(runs / f"comparison-{name}.svg") for name in ("energies", "probes")]
    finally:
        (runs / "sweep.csv").unlink()
