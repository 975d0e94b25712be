"""Names and docstrings of the sources: one class a name, and docstrings that say what they describe."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from documents import ROOT, tracked

PACKAGE = tracked("ngvisco/*.py")
OTHERS = ("geometries", "demos", "tests")
SOURCES = [*PACKAGE, *(path for folder in OTHERS for path in tracked(f"{folder}/*.py"))]
NO_SUBJECT = re.compile(r"(What|Of|That|Those|And|By|As|The same)\b")
"""Words that a docstring without a subject begins with."""


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each docstring of a module, a class, a function or an attribute."""
    nodes: list[ast.AST] = [tree_of(path)]
    while nodes:
        node = nodes.pop()
        value = node.value if isinstance(node, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield node.lineno, value.value.strip()
        for block in ("body", "orelse", "handlers", "finalbody", "cases"):
            parts = getattr(node, block, None)
            nodes += parts if isinstance(parts, list) else []


def test_docstrings_begin_with_a_subject_or_a_verb():
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for path in SOURCES
        for line, text in docstrings(path)
        if NO_SUBJECT.match(text)
    ]
    assert not found, "\n".join(found)


def test_a_module_is_short_enough_to_be_one_object():
    long = {
        str(path.relative_to(ROOT)): n for path in PACKAGE if (n := len(path.read_text().splitlines())) > 450
    }
    assert not long


def type_names(path: Path) -> Iterator[str]:
    """Names of the classes and of the modules' aliases of types; those of variables are in capitals."""
    for node in ast.walk(tree := tree_of(path)):
        if isinstance(node, ast.ClassDef):
            yield node.name
    for node in tree.body:
        targets = getattr(node, "targets", [getattr(node, "target", None)])
        if isinstance(node, ast.Assign | ast.AnnAssign):
            yield from (t.id for t in targets if isinstance(t, ast.Name) and re.match("_?[A-Z]+[a-z]", t.id))


def test_only_the_module_of_the_base_class_tests_the_class_of_a_term():
    """No module but the base of terms tests the class of a term."""
    asking = {
        f"{path.relative_to(ROOT)}:{number}"
        for path in PACKAGE
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if re.search(r"isinstance\((\w+\.)*term, ", line) and path.name != "term.py"
    }
    assert not asking


def test_a_name_belongs_to_one_class_or_alias():
    places: dict[str, list[str]] = {}
    for path in PACKAGE:
        for name in type_names(path):
            places.setdefault(name, []).append(str(path.relative_to(ROOT)))
    assert {name: paths for name, paths in places.items() if len(paths) > 1} == {}
