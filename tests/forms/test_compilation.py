"""Integrands as programs, and as machine code where that is asked for."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from ngsolve import CF, IfPos, Integrate, Mesh, sin, unit_square, x, y

from ngvisco.errors import ParameterError
from ngvisco.forms.mesh.quadrature import SCRIPT, VARIABLE, compiled


def test_interpreted_by_default(monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("PATH", "/nowhere")  # nothing is compiled
    mesh = Mesh(unit_square.GenerateMesh(maxh=0.5))
    assert Integrate(compiled(x * y), mesh) == pytest.approx(0.25)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.skipif(
    not (shutil.which("c++") and shutil.which(SCRIPT, path=str(Path(sys.executable).parent))),
    reason="no compiler",
)
def test_machine_code_has_the_same_values(monkeypatch):
    monkeypatch.setenv(VARIABLE, "1")
    mesh = Mesh(unit_square.GenerateMesh(maxh=0.5))
    f = CF((sin(3 * x) * y, IfPos(x - y, x, -y)))
    machine, given = (np.array(Integrate(g, mesh, order=6)) for g in (compiled(f), f))
    assert machine == pytest.approx(given, rel=1e-14)


def test_another_word_is_refused(monkeypatch):
    monkeypatch.setenv(VARIABLE, "yes")
    with pytest.raises(ParameterError, match="NGVISCO_COMPILE = 'yes'"):
        compiled(x)


def test_without_a_compiler_it_is_refused(monkeypatch, tmp_path):
    monkeypatch.setenv(VARIABLE, "1")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ParameterError, match=r"c\+\+"):
        compiled(x)
