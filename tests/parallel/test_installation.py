"""Report of ``ngvisco info --parallel`` on an installation."""

import sys

import pytest
from launch import needs_petsc, run

from ngvisco.cli.main import main


@needs_petsc
@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_step_is_taken_where_all_is_there(ranks):
    """Alone it starts three ranks of its own, under mpirun it takes a step on those."""
    found = run("-m", "ngvisco", "info", "--parallel", ranks=ranks)
    assert found.returncode == 0, found.stderr
    said = dict(line.split(maxsplit=1) for line in found.stdout.splitlines())
    assert {"MPI", "PETSc", "mumps", "gamg"} <= set(said)
    assert "1152 cells on" in said["mumps"]
    assert found.stdout.count("PETSc ") == 1  # the first rank speaks


def test_what_is_missing_is_said(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "petsc4py", None)
    assert main(["info", "--parallel"]) == 1
    said = capsys.readouterr().out
    assert "petsc4py is missing" in said and "not tried" in said


def test_info_is_of_a_directory_or_of_the_installation(capsys, tmp_path):
    for words in ([], [str(tmp_path), "--parallel"]):
        assert main(["info", *words]) == 2
        assert "a run directory" in capsys.readouterr().err
