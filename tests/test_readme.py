"""The front page fits a page and runs as it is printed, and the rooms' pages have the tables of the code."""

import re

from documents import ROOT, marked_blocks, tracked
from materials import table
from support import small_run

import ngvisco as nv
from ngvisco.case.catalogue import WALLS

README = ROOT / "README.md"
LEDGER = ROOT / "ngvisco" / "run" / "LEDGER.md"
OUTPUT = ROOT / "ngvisco" / "run" / "OUTPUT.md"


def ran(program):
    names = {}
    exec(compile(program, "README.md", "exec"), names)
    return names


def script():
    (block,) = marked_blocks(README)["run"]
    return block


def test_the_front_page_fits_on_one_page():
    lines = README.read_text().splitlines()
    assert len(lines) <= 80 and max(map(len, lines)) <= 130


def test_the_readme_s_script_runs_and_its_ledger_closes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert len([line for line in script().splitlines() if line]) <= 22
    names = ran(script())
    assert abs(names["run"].ledger.column("closure_relative")).max() <= 1e-10
    assert "0" in capsys.readouterr().out


def test_the_printed_program_reads_the_run_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = ran(script())["run"]
    (reader,) = marked_blocks(OUTPUT)["reader"]
    names = ran(reader)
    assert names["unit"] == "J" and len(names["closure"]) == 6
    assert len(names["coefficients"]) == run.rothe_step.layout.space.ndof


def test_commands_install_and_run_in_one_line_each():
    """A newcomer types these commands first. One command installs the extra for pictures, the other the extra
    for tests."""
    commands = [line.strip() for line in README.read_text().splitlines() if line.startswith("    python3")]
    environment = "python3 -m venv .venv && .venv/bin/pip install"
    assert commands == [
        f'{environment} ".[plots]" && .venv/bin/python demos/swirl/swirl.py',
        f'{environment} -e ".[tests]" && .venv/bin/python -m pytest -n 2',
    ]


def test_page_of_errors_has_every_class():
    cells = re.findall(r"^\| (.*?) \|", (ROOT / "ngvisco/ERRORS.md").read_text(), re.MULTILINE)
    named = {name for cell in cells for name in re.findall(r"`(\w+(?:Error|Warning))`", cell)}
    sources = "\n".join(path.read_text() for path in tracked("ngvisco/*.py"))
    defined = re.findall(r"^class (\w+(?:Error|Warning))\(", sources, re.MULTILINE)
    assert named == set(defined) - {"NgviscoError", "NgviscoWarning"} | {"ValueError"}


def test_every_ledger_column_is_explained():
    columns = small_run(1, 1.0, material=nv.NeoHookean(K_e=1.0, G_e=1.0, epsilon=1.0)).ledger.columns
    assert all(f"`{column}`" in LEDGER.read_text() for column in columns)


def test_table_of_materials_is_the_generated_one():
    assert table().strip() in (ROOT / "ngvisco/physics/materials/MATERIALS.md").read_text()


def test_table_of_walls_has_every_wall():
    page = (ROOT / "ngvisco" / "physics" / "README.md").read_text()
    assert set(re.findall(r"^\| `(\w+)\(", page, re.MULTILINE)) == set(WALLS)


def test_table_of_schemes_has_every_scheme():
    page = (ROOT / "ngvisco" / "timestepping" / "README.md").read_text()
    assert set(nv.SCHEMES) <= set(re.findall(r'^\| `"([\w-]+)"`', page, re.MULTILINE))


def test_table_of_demos_has_every_demo():
    page = (ROOT / "demos" / "README.md").read_text()
    there = {path.parent.name for path in (ROOT / "demos").glob("*/README.md")}
    assert set(re.findall(r"^\| \[\w+\]\((\w+)/README\.md\)", page, re.MULTILINE)) == there
