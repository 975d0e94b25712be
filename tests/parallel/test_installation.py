"""Report of ``ngvisco info --parallel`` on an installation."""

import re
import sys

import pytest
from launch import PYTHON, ROOT, launched, needs_petsc, run
from support import A_BODY, A_SWIRL, NO_VTK, TWO_STEPS

from ngvisco.cli.main import main


@needs_petsc
@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("ranks", [1, 2])
def test_info_takes_a_step_if_all_packages_are_installed(ranks):
    """Without mpirun the command starts three ranks; under mpirun it takes a step on the given ranks."""
    found = run("-m", "ngvisco", "info", "--parallel", ranks=ranks)
    assert found.returncode == 0, found.stderr
    said = dict(line.split(maxsplit=1) for line in found.stdout.splitlines())
    assert {"MPI", "PETSc", "mumps", "gamg"} <= set(said)
    assert "1152 cells on" in said["mumps"]
    assert found.stdout.count("PETSc ") == 1  # only the first rank prints


@needs_petsc
@pytest.mark.long
@pytest.mark.ci
def test_the_command_of_the_page_distributes_a_run(tmp_path):
    """The printed command runs, also on a machine with fewer slots than ranks."""
    (printed,) = re.findall(r"`mpirun ([^`]*)`", (ROOT / "ngvisco/parallel/RANKS.md").read_text())
    (tmp_path / "case.toml").write_text(A_BODY + A_SWIRL + TWO_STEPS + NO_VTK)
    program, case = [PYTHON, "-m", "ngvisco"], [str(tmp_path / "case.toml")]
    instead = {".venv-mpi/bin/ngvisco": program, "case.toml": case}
    words = [word for one in printed.split() for word in instead.get(one, [one])]
    assert words[0] == "--oversubscribe" and words[-2:] == ["run", *case]
    found = launched([*words, "-o", str(tmp_path / "out")])
    assert found.returncode == 0, found.stderr
    log = (tmp_path / "out" / "log.txt").read_text()
    assert "3 ranks, 2 of them with cells" in log and "finished" in log


def test_a_missing_package_is_named(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "petsc4py", None)
    assert main(["info", "--parallel"]) == 1
    said = capsys.readouterr().out
    assert "petsc4py is missing" in said and "not tried" in said


def test_info_describes_a_directory_or_the_installation(capsys, tmp_path):
    expected = {
        (): "a run directory, or --parallel",
        (str(tmp_path), "--parallel"): "no directory together with --parallel",
    }
    for words, message in expected.items():
        assert main(["info", *words]) == 2
        assert message in capsys.readouterr().err
