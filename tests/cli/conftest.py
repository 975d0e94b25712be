import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # tests import the module ``command`` from this folder

import command as cli


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """The directory of an uninterrupted run of the small case, 4 steps; tests must not change it."""
    place = tmp_path_factory.mktemp("finished")
    (place / "case.toml").write_text(cli.CASE)
    code, _, err = cli.command("run", place / "case.toml", "-o", place / "run", "--quiet")
    assert code == 0, err
    return place / "run"


@pytest.fixture
def case_file(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(cli.CASE)
    return path
