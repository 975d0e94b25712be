"""The README's command for the API pages, run as it is printed."""

import re
import shlex
import subprocess
import sys

import pytest
from documents import ROOT


def test_api_pages_are_made_by_the_printed_command(tmp_path):
    pytest.importorskip("pdoc")
    page = (ROOT / "ngvisco" / "README.md").read_text()
    (command,) = re.findall(r"<!-- api begins -->\n```sh\n(pdoc .*)\n```", page)
    words = shlex.split(command)[1:]
    words[words.index("-o") + 1] = str(tmp_path)
    rooms = {path.parent.name for path in (ROOT / "ngvisco").glob("*/__init__.py")}
    assert {f"ngvisco.{room}" for room in rooms} <= set(words)
    result = subprocess.run(
        [sys.executable, "-m", "pdoc", *words], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stderr
    assert "Traceback" not in result.stderr
    for name, words in {
        "ngvisco": ("Simulation", '<h6 id="parameters">Parameters</h6>'),
        "ngvisco/physics/variables": ("LeftCauchyGreen", "kinematic rates"),
        "ngvisco/geometries": ("annulus", "spherical_shell"),
    }.items():
        text = (tmp_path / f"{name}.html").read_text()
        assert all(word in text for word in words), name
