"""The table of the paper's labels is complete and true of the package, and its tests exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import ngvisco
from tests.verification import labels as module
from tests.verification.bounds import Bound, VerificationError
from tests.verification.case import Case
from tests.verification.cases import all_cases
from tests.verification.labels import cases_by_label, label_modules, label_table, labels, labels_in

TESTS = Path(__file__).resolve().parents[1]


def case(label, reason=""):
    bounds = (Bound("x", "in", (0.0, 1.0), reason),)
    return Case(name="a-case", statement="S", label=label, setting="S", bounds=bounds, run=list)


def test_every_label_of_the_paper_is_in_the_table_once():
    assert len(labels()) == 215
    assert list(labels())[:2] == ["sec-linearized", "ZJ"] and list(labels())[-1] == "rem-neo-Hookean-ref"


@cache
def functions(file):
    path = TESTS / file
    tree = ast.parse(path.read_text(encoding="utf-8")) if path.is_file() else ast.parse("")
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_test_of_the_table_exists():
    tests = [(label.name, *test.split("::")) for label in labels().values() for test in label.tests]
    assert tests and not [test for test in tests if test[2] not in functions(test[1])]


def test_the_readme_states_how_many_labels_are_measured_by_themselves():
    """A part measured only with its whole does not count as measured."""
    own, whole, none = map(
        int, re.findall(r"(\d+) (?:with a case|measured with|not)", label_table(all_cases()).title)
    )
    said = " ".join((Path(module.__file__).parent / "README.md").read_text(encoding="utf-8").split())
    assert f"{own} labels have a case or a test of their own" in said
    assert f"{whole} labels are parts of the discrete scheme" in said
    assert f"all {len(all_cases())} cases" in said
    assert f"{none} labels are not measured" in said and own + whole + none == 215


def test_each_label_is_measured_or_has_a_reason_why_not():
    table = label_table(all_cases())
    silent = [row[0] for row in table.rows if row[3] == "not measured"]
    assert not silent
    assert {row[3].split(":")[0].split(" ")[0] for row in table.rows} == {"cases", "tests", "with", "not"}


def test_every_label_that_the_package_or_a_case_names_is_a_label_of_the_paper():
    """Sources name labels after "paper: "; cases name labels, and other references, between commas."""
    package = Path(ngvisco.__file__).parent
    unknown = set()
    for path in package.rglob("*.py"):
        for text in path.read_text(encoding="utf-8").split("(paper: ")[1:]:
            said = " ".join(text.partition(")")[0].split()).replace("- ", "-")
            if ")" in text and not labels_in(f" {said} ") and len(said.split()) < 3:
                unknown.add(f"{path.name}: {said}")
    # these texts in brackets are no labels
    assert {entry.partition(": ")[2] for entry in unknown} <= {"Section 2", "Section 3", "g^k_{delta tau}"}
    for one in all_cases():
        for part in one.label.partition(";")[0].split(", "):
            if part.startswith(("Euler-", "ED-", "DT-", "rem-", "exa-")):
                assert part in labels(), (one.name, part)


def test_a_part_of_a_label_does_not_count_as_the_label():
    text = "Euler-small-est3+ and Euler-small-est1: Euler-small-viscoelastodyn+0disc. (ZJ), 1/J-continuity-eq"
    assert labels_in(text) == [
        "Euler-small-est3+",
        "Euler-small-est1",
        "Euler-small-viscoelastodyn+0disc",
        "ZJ",
        "1/J-continuity-eq",
    ]
    assert labels_in("Euler-small-estimates, ZJs, xZJ, rem-f-ne-0x") == []


def test_each_label_lists_the_modules_that_name_it():
    found = label_modules()
    assert "physics/variables" in found["DT-det-extended"]
    assert "physics/rheology" in found["Euler-small-ass-D"]
    modules = ("physics/materials/hyperelastic", "physics/variables")
    assert found["exa-Mooney–Rivlin-ref"] == modules
    # an English word is no label
    assert "run/ledger" not in found["cut-off"] and "physics/regularisation" in found["cut-off"]


def test_each_label_lists_the_cases_that_name_it_also_in_a_bound():
    one = case("rem-f-ne-0; an exact solution", "Euler-small-est7: bounded")
    assert cases_by_label([one]) == {"rem-f-ne-0": ["a-case"], "Euler-small-est7": ["a-case"]}
    measured = {row[0]: row[3] for row in label_table([one]).rows}
    assert measured["Euler-small-est7"] == "cases: a-case"
    assert measured["def-ED-Ch4-momentum"] == "not measured, as def-ED-Ch4"
    assert measured["Euler-larger-polyconvex-Mandel"] == "with Euler-larger-polyconvex-stress"


@pytest.mark.parametrize("line", ["a | b | c", "a | nowhere | c | d", "ZJ | | x |\nZJ | | x |"])
def test_an_invalid_line_of_the_table_of_labels_is_refused(line, monkeypatch, tmp_path):
    (tmp_path / "labels.txt").write_text(line)
    monkeypatch.setattr(module.resources, "files", lambda package: tmp_path)
    with pytest.raises(VerificationError, match=r"labels.txt"):
        module.labels.__wrapped__()
