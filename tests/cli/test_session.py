"""A new user's session, word for word as the README has it, in an installation of its own."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from command import ROOT

MARKED = re.compile(r"<!-- session begins -->(.*?)<!-- session ends -->", re.S)


def session():
    """The blocks of code, (language, text), between the README's markers."""
    found = MARKED.search((ROOT / "README.md").read_text())
    assert found, "no session between markers"
    return re.findall(r"```(sh|python)\n(.*?)```", found[1], re.S)


def before_the_session(clone):
    """What the README's earlier commands leave behind: the demo's results, and the script that is run."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "demos/swirl/swirl.py" in readme.split("<!-- session begins -->")[0]
    (clone / "results/swirl").mkdir(parents=True)
    for name in ("ledger.csv", "run.h5"):
        (clone / "results/swirl" / name).write_text("of demos/swirl/swirl.py")
    (script,) = re.findall(r"<!-- run: a test.*?```python\n(.*?)```", readme, re.S)
    return script


@pytest.mark.timeout(400)
def test_new_users_session(tmp_path):
    clone = tmp_path / "clone"
    for name in ("ngvisco", "geometries", "demos"):
        shutil.copytree(ROOT / name, clone / name)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, clone)
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "env"], check=True)
    scripts = tmp_path / "env" / "bin"
    # the dependencies are those of the tests' own environment; ngvisco itself is installed anew
    (site,) = (tmp_path / "env").glob("lib/python*/site-packages")
    outer = sysconfig.get_path("purelib")  # with what its own .pth files add
    (site / "outer.pth").write_text(f"import site; site.addsitedir({outer!r})\n")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {
        "PATH": f"{scripts}:{os.environ['PATH']}",
        "PIP_NO_DEPS": "1",
        "PIP_NO_BUILD_ISOLATION": "0",  # pip reads this as --no-build-isolation
        "PIP_NO_INDEX": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    printed = ""
    # from top to bottom, after the installation
    for language, text in [("python", before_the_session(clone)), *session()]:
        interpreter = ["bash", "-euo", "pipefail", "-c"] if language == "sh" else [scripts / "python", "-c"]
        result = subprocess.run(
            [*interpreter, text], cwd=clone, env=environment, capture_output=True, text=True, timeout=300
        )
        assert result.returncode == 0, result.stderr
        printed += result.stdout
    assert "valid" in printed and "t = 0.2 s after 10 steps" in printed and "finished" in printed
    assert re.search(r"kinetic energy 0\.2\d\d J at first, \d\.\d+ J at t = 0\.20 s", printed)
    mass, recorded = re.search(r"mass (\S+) = (\S+)", printed).groups()
    assert float(mass) == pytest.approx(float(recorded), rel=1e-12)
    assert re.search(r"slowest at t = 0\.\d\d s", printed)
    for name in ("energies.png", "history.png", "fields.png", "scene.html", "vtk/fields.pvd"):
        assert (clone / "results/first" / name).stat().st_size > 0
    assert (clone / "results/mine.png").exists() and (clone / "results/mine.h5").exists()
    assert Path(scripts / "ngvisco").exists()
