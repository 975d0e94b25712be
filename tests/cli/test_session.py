"""A new user's session, word for word as its page has it; ``test_package`` installs."""

import re
import shlex

import pytest
from command import ROOT, command

MARKED = re.compile(r"<!-- session begins -->(.*?)<!-- session ends -->", re.S)
README, PAGE = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "ngvisco/cli/SESSION.md"))


def session():
    """The blocks of code, (language, text), between the page's markers."""
    (marked,) = MARKED.findall(PAGE)
    return re.findall(r"```(sh|python)\n(.*?)```", marked, re.S)


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """The demos, and the results of swirl, which an earlier command of the README leaves."""
    assert "demos/swirl/swirl.py" in README
    (tmp_path / "results/swirl").mkdir(parents=True)
    for name in ("ledger.csv", "run.h5"):
        (tmp_path / "results/swirl" / name).write_text("of demos/swirl/swirl.py")
    (tmp_path / "demos").symlink_to(ROOT / "demos")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shell(text):
    """Run the block's commands, each of which must succeed, and return their output."""
    install, *commands = (shlex.split(line, comments=True) for line in text.splitlines())
    assert install == ["pip", "install", ".[plots]"]
    for name, *words in commands:
        assert name == "ngvisco"
        code, out, err = command(*words)
        assert code == 0, err
        yield out


@pytest.mark.long
@pytest.mark.ci
def test_the_session_of_the_page_runs_word_for_word(clone, capsys):
    printed = ""
    for language, text in session():  # the blocks are run from top to bottom
        if language == "sh":
            printed += "".join(shell(text))
        else:
            exec(compile(text, "SESSION.md", "exec"), {})
    printed += capsys.readouterr().out
    assert "valid" in printed and "t = 0.2 s after 10 steps" in printed and "finished" in printed
    assert re.search(r"kinetic energy 0\.2\d\d J at first, \d\.\d+ J at t = 0\.20 s", printed)
    mass, recorded = re.search(r"mass (\S+) = (\S+)", printed).groups()
    assert float(mass) == pytest.approx(float(recorded), rel=1e-12)
    assert re.search(r"slowest at t = 0\.\d\d s", printed)
    for name in ("energies.png", "history.png", "fields.png", "scene.html", "vtk/fields.pvd"):
        assert (clone / "results/first" / name).stat().st_size > 0
    assert (clone / "results/mine.png").exists() and (clone / "results/mine.h5").exists()
