"""The split solver's residual, its derivative and what is factorised are those of one process, over ranks."""

from pathlib import Path

import numpy as np
import pytest
from launch import needs_petsc, run

HERE = Path(__file__).parent
pytestmark = needs_petsc
CASES = (
    *("creep and walls with slip", "a creep rate field", "k = 3", "no hyperviscosity", "3D"),
    *("a cut-off", "delta", "delta in 3D", "delta and what does not diffuse"),
)


def found(folder, ranks, names):
    path = folder / f"{ranks}.npz"
    result = run(HERE / "rows.py", path, *names, ranks=ranks)
    assert result.returncode == 0, result.stderr[-2000:]
    return np.load(path)


def assert_same_rows(folder, ranks, names):
    """To 1e-12 of the largest of an unknown's rows."""
    one, several = found(folder, 1, names), found(folder, ranks, names)
    assert {name.split(":")[0] for name in one.files} == set(names) and one.files == several.files
    for name in one.files:
        expected = one[name]
        assert abs(several[name] - expected).max() <= 1e-12 * abs(expected).max(), name


def test_rows_are_those_of_one_process(tmp_path):
    """Of a material, and of bodies that are in equilibrium of pressure."""
    assert_same_rows(tmp_path, 3, (CASES[0], "bodies"))


@pytest.mark.long
@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.ci), 4])
def test_rows_of_all_cases_are_those_of_one_process(ranks, tmp_path):
    assert_same_rows(tmp_path, ranks, CASES)
