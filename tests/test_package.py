"""The package as a user gets it: one version, geometries from a clone and from a wheel."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import ngvisco

ROOT = Path(__file__).resolve().parents[1]


def test_there_is_one_version_string():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert ngvisco.__version__ in (declared, "0+unknown")
    for source in (ROOT / "ngvisco").rglob("*.py"):
        assert f'"{declared}"' not in source.read_text()


def test_public_names_exist():
    assert all(hasattr(ngvisco, name) for name in ngvisco.__all__)


def test_geometries_import_from_a_clone(tmp_path):
    code = "import ngvisco.geometries as g; print(g.box((1, 1), maxh=1).ne > 0, g.__file__)"
    # isolated from an installed copy: only the clone and NGSolve's site-packages are on the path
    result = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r}); {code}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.startswith("True")


def test_wheel_holds_geometries_and_nothing_else_of_the_top_level(tmp_path):
    source = tmp_path / "source"  # building leaves files beside the sources
    for name in ("ngvisco", "geometries", "demos"):
        shutil.copytree(ROOT / name, source / name)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "-w", str(tmp_path), str(source)], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert "ngvisco/demos/swirl/swirl.toml" in names  # of which `ngvisco new swirl` makes a template
    assert "ngvisco/geometries/boxes.py" in names and "ngvisco/forms/system.py" in names
    assert {name.split("/")[0] for name in names} == {"ngvisco", f"{wheel.stem.rsplit('-', 3)[0]}.dist-info"}
    sources = {str(p.relative_to(ROOT)) for p in (ROOT / "ngvisco").rglob("*.py")}
    pages = {str(p.relative_to(ROOT)) for p in (ROOT / "ngvisco").rglob("*.md")}
    assert sources | pages | {"ngvisco/geometries/README.md"} <= set(names)
    assert not any(name.endswith(".png") for name in names)  # the kept reports are with the tests


def test_top_level_is_the_agreed_one():
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout.split()
    agreed = {"pyproject.toml", "ngvisco", "geometries", "tests", "demos", "README.md", "LICENSE"}
    assert {p.split("/")[0] for p in tracked if not p.startswith(".")} <= agreed
