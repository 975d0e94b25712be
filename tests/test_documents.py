"""The project's Markdown: its links, cited names and versions exist."""

import re
import tomllib

import pytest
from documents import ROOT, tracked

MARKDOWN = [path for path in tracked("*.md") if "verification/kept" not in str(path)]
FORMULATION = ROOT / "ngvisco" / "FORMULATION.md"
CITATION = re.compile(r"FORMULATION\.md\)?,?\s+Sections?\s+(\d+)(?:\s+to\s+(\d+))?", re.IGNORECASE)


def name(path):
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", MARKDOWN, ids=name)
def test_links_in_pages_lead_to_files_and_headings(path):
    text = re.sub(r"```.*?```|`[^`\n]*`", "", path.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith("https://"):
            continue
        file, _, heading = target.partition("#")
        there = (path.parent / file).resolve() if file else path
        assert there.exists() and there.is_relative_to(ROOT), target
        assert not heading or heading in anchors(there.read_text()), target


def anchors(text):
    """The anchors of a page's headings, by which links name them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", MARKDOWN, ids=name)
def test_tables_have_equal_rows_and_a_blank_line_before(path):
    """A table has a blank line before it, and the same number of cells in every line, also within a list."""
    text = re.sub(r"```.*?```", "", path.read_text(), flags=re.DOTALL)
    before, cells = "", 0
    for line in map(str.strip, text.splitlines()):
        assert not re.search(r"[^|\s-].*\|-+\|", line), f"a table in one line: {line}"
        if line.startswith("|"):
            if not before.startswith("|"):
                assert not before, f"no blank line before {line}"
                cells = line.count("|") - line.count("\\|")
            assert line.count("|") - line.count("\\|") == cells, line
        before = line


@pytest.mark.parametrize("path", MARKDOWN, ids=name)
def test_files_that_a_page_names_exist(path):
    """Names in backticks are paths from the top of a clone, from the package or from the page's folder."""
    text = path.read_text()
    made = set(re.findall(r"<!-- \w+: new file (\S+) -->", text))  # by a recipe of the guide
    named = set(re.findall(r"`((?!results/)[\w.]+/[\w./]*\.(?:py|md|toml|html|run))`", text))
    folders = (ROOT, ROOT / "ngvisco", path.parent)
    missing = [n for n in named - made if "NAME" not in n and not any((f / n).is_file() for f in folders)]
    assert not missing, missing


def test_cited_sections_of_the_formulation_exist():
    sections = [int(n) for n in re.findall(r"^## (\d+)\. ", FORMULATION.read_text(), re.MULTILINE)]
    assert sections == list(range(1, len(sections) + 1))
    cited = {
        (name(path), int(number))
        for path in [*tracked("*.py"), *MARKDOWN]
        for pair in CITATION.findall(" ".join(path.read_text().split()))
        for number in pair
        if number
    }
    assert {number for _, number in cited} <= set(sections), cited
    assert len(cited) >= 5
    # Section n without the name of a file is a section of the paper
    inside = re.findall(r"Section (\d+)", FORMULATION.read_text())
    assert {int(number) for number in inside} <= set(sections)


def test_changelog_begins_with_the_version_of_the_package():
    text = (ROOT / "ngvisco" / "CHANGELOG.md").read_text()
    versions = re.findall(r"^## \[([^\]]+)\] - (\d{4}-\d\d-\d\d|not released yet)$", text, re.MULTILINE)
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert versions[0][0] == declared
    headings = re.findall(r"^## (?!Unreleased$)", text, re.MULTILINE)
    assert len(versions) == len(headings)
    kinds = set(re.findall(r"^### (.*)$", text, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
