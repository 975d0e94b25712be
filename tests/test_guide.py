"""The guide's recipes: their changes are made to a copy of the sources, and their programs run there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from documents import ROOT
from support import by_ci

GUIDE = ROOT / "ngvisco" / "GUIDE.md"
BLOCK = re.compile(r"<!-- (\w+): (new file|change|run) ?([\w./]*) -->\n+```\w+\n(.*?)```", re.DOTALL)
RECIPES = {name: None for name, *_ in BLOCK.findall(GUIDE.read_text())}


def blocks(name: str) -> list[list[str]]:
    """Blocks of a recipe: action, file and text."""
    return [
        (what, file, text) for recipe, what, file, text in BLOCK.findall(GUIDE.read_text()) if recipe == name
    ]


def apply(change: str, source: str) -> str:
    """The source after the hunks of a difference; each hunk fits one place, and a hunk of additions alone is
    appended."""
    for hunk in change.split("@@\n"):
        lines = hunk.splitlines()
        before = "\n".join(line[1:] for line in lines if line[:1] in (" ", "-"))
        after = "\n".join(line[1:] for line in lines if line[:1] in (" ", "+"))
        if not before:
            source = f"{source.rstrip()}\n{after}\n"
            continue
        places = source.count(f"\n{before}\n")
        assert places == 1, f"fits {places} places of the source:\n{before}"
        source = source.replace(f"\n{before}\n", f"\n{after}\n")
    return source


def copied(folder: Path) -> Path:
    """The sources that a program imports."""
    for name in ("ngvisco", "geometries", "tests/verification"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("pictures"))
    for name in ("materials.py", "flow_rules.py", "physics/test_material_laws.py"):
        (folder / "tests" / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / "tests" / name, folder / "tests" / name)
    return folder


@pytest.mark.parametrize(
    "recipes",
    [by_ci(list(RECIPES)), *(pytest.param([name], marks=pytest.mark.long) for name in RECIPES)],
    ids="+".join,
)
def test_recipes_work_as_they_are_written(recipes, tmp_path):
    """The recipes are followed one after the other in one copy of the sources; each one alone is `long`."""
    clone = copied(tmp_path)
    programs = []
    for what, file, text in (block for recipe in recipes for block in blocks(recipe)):
        path = clone / file
        if what == "run":
            programs.append(text)
        elif what == "new file":
            assert not path.exists(), f"{file} is there already"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        else:
            path.write_text(apply(text, path.read_text()))
    assert len(programs) >= len(recipes), "a recipe without a program shows nothing"
    environment = os.environ | {"PYTHONPATH": str(clone), "NGS_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    here = f"import ngvisco; assert ngvisco.__file__.startswith({str(clone)!r})\n"
    each = "".join(f"exec({program!r}, {{'__name__': '__main__'}})\n" for program in programs)
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", here + each],
        cwd=clone,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stderr


def test_the_code_of_recipes_has_the_project_s_style(tmp_path):
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for recipe in RECIPES:
        for i, (what, _, text) in enumerate(blocks(recipe)):
            # a text that begins with "title" is a case file
            if what != "change" and not text.startswith("title"):
                (tmp_path / f"{recipe}_{i}.py").write_text(text)
    for command in (("check", "--ignore=RUF001,RUF002,RUF003,SIM115,E402"), ("format", "--diff")):
        result = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "."], cwd=tmp_path, capture_output=True, text=True
        )
        assert result.returncode == 0, result.stdout + result.stderr
