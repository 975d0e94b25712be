"""The package as a user gets it: one version, a wheel that installs and runs, pages of its API."""

import inspect
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import warnings
import zipfile
from importlib.util import find_spec

import pytest
from documents import ROOT

import ngvisco


def test_there_is_one_version_string():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert ngvisco.__version__ in (declared, "0+unknown")
    for source in (ROOT / "ngvisco").rglob("*.py"):
        assert f'"{declared}"' not in source.read_text()


def test_public_names_exist():
    assert all(hasattr(ngvisco, name) for name in ngvisco.__all__)


def test_public_docstrings_name_the_errors_that_are_raised():
    silent = []
    for name in ngvisco.__all__:
        public = getattr(ngvisco, name)
        if not inspect.isclass(public) and not inspect.isfunction(public):
            continue
        makers = [public]
        if inspect.isclass(public):
            own = [base for base in public.__mro__ if base.__module__.startswith("ngvisco")]
            makers = [vars(base)["__post_init__"] for base in own if "__post_init__" in vars(base)]
        sources = "".join(inspect.getsource(maker) for maker in makers)
        doc = inspect.getdoc(public) or ""
        if re.search(r"raise \w*Error|require_\w+\(", sources) and not re.search(r"Raises|raise|Error", doc):
            silent.append(name)
    assert not silent


@pytest.mark.long
@pytest.mark.ci
def test_an_installed_wheel_runs_and_adds_no_other_top_level_package(tmp_path):
    source = tmp_path / "source"  # building leaves files beside the sources
    for name in ("ngvisco", "geometries", "demos"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "-q", "--disable-pip-version-check"]
    build = [*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", str(tmp_path), str(source)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {"ngvisco", f"{wheel.stem.rsplit('-', 3)[0]}.dist-info"}
    sources = {str(p.relative_to(ROOT)) for p in (ROOT / "ngvisco").rglob("*.py")}
    pages = {str(p.relative_to(ROOT)) for p in (ROOT / "ngvisco").rglob("*.md")}
    assert sources | pages | {"ngvisco/geometries/README.md", "ngvisco/geometries/boxes.py"} <= set(names)
    assert not any(name.endswith(".png") for name in names)  # the kept reports are with the tests
    place = tmp_path / "installed"
    install = [*pip, "install", "--no-deps", "--no-index", "--target", str(place), str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    (tmp_path / "case.toml").symlink_to(place / "ngvisco/demos/swirl/swirl.toml")
    said = subprocess.run(
        [place / "bin" / "ngvisco", "check", "case.toml", "--set", "domain.maxh=0.7"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(place), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert said.returncode == 0 and "valid" in said.stdout, said.stderr


def api_command():
    """Command of the package's README that makes pages of the API."""
    page = (ROOT / "ngvisco" / "README.md").read_text()
    (command,) = re.findall(r"<!-- api begins -->\n```sh\npdoc (.*)\n```", page)
    return shlex.split(command)


PAGES = {
    "ngvisco.physics.variables": ("LeftCauchyGreen", "kinematic rates"),
    "ngvisco.geometries": ("annulus", '<h6 id="parameters">Parameters</h6>'),
}
"""Modules whose pages are made quickly, and words on these pages."""


@pytest.mark.parametrize("pages", [PAGES, pytest.param(None, marks=pytest.mark.long)], ids=["two", "all"])
def test_api_pages_are_made_by_the_printed_command(pages, tmp_path):
    pdoc = pytest.importorskip("pdoc.__main__")
    words = api_command()
    modules = [word for word in words if word.startswith("ngvisco")]
    options = words[: -len(modules)]
    assert all(find_spec(module) for module in modules)
    rooms = {path.parent.name for path in (ROOT / "ngvisco").glob("*/__init__.py")}
    assert {f"ngvisco.{room}" for room in rooms} <= set(modules)
    options[options.index("-o") + 1] = str(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("default")  # pdoc warns of types that it cannot link
        pdoc.cli([*options, *(pages or modules)])
    for name, has in PAGES.items():
        text = (tmp_path / f"{name.replace('.', '/')}.html").read_text()
        assert all(word in text for word in has), name


def test_top_level_of_the_repository_has_the_agreed_entries():
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout.split()
    agreed = {"pyproject.toml", "ngvisco", "geometries", "tests", "demos", "README.md", "LICENSE"}
    assert {p.split("/")[0] for p in tracked if not p.startswith(".")} <= agreed
