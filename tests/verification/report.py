"""One report of all results: Markdown, with its pictures beside it."""

import platform
from collections.abc import Sequence
from pathlib import Path

from ngvisco.run.files import write_atomically
from tests.verification.case import Case, Result, number
from tests.verification.labels import label_table
from tests.verification.pictures import draw
from tests.verification.registry import all_cases

_WORDS = {"holds": "holds", "fails": "DOES NOT HOLD", "error": "ERROR"}

Entries = Sequence[tuple[Case, Result]]


def write_report(directory: Path, cases: Sequence[Case], results: Sequence[Result], version: str) -> Path:
    """Write ``report.md`` and ``pictures/`` into the directory; returns the report's path."""
    for result in results:
        for i, plot in enumerate(result.outcome.plots if result.outcome else ()):
            write_atomically(directory / _picture(result.name, i), draw(plot))
    path = directory / "report.md"
    write_atomically(path, markdown(list(zip(cases, results, strict=True)), version).encode())
    return path


def headline(results: Sequence[Result]) -> str:
    """How many cases hold, fail and could not be run."""
    count = {status: sum(r.status == status for r in results) for status in _WORDS}
    return (
        f"{len(results)} cases: {count['holds']} hold, {count['fails']} do not, {count['error']} ended in "
        f"an error; {sum(r.seconds for r in results) / 60:.0f} minutes of computing"
    )


def machine(version: str) -> str:
    """Versions that the results belong to."""
    from importlib.metadata import version as version_of

    return (
        f"ngvisco {version}, NGSolve {version_of('ngsolve')}, Python {platform.python_version()}, "
        f"{platform.machine()}"
    )


def measured_rows(case: Case, result: Result) -> list[tuple[str, str, str, str, str]]:
    """Quantity, bound, measured value, verdict and reason, one row for each bound."""
    values = {} if result.outcome is None else result.outcome.values
    rows = []
    for bound in case.bounds:
        has = bound.quantity in values
        verdict = ("✗" if bound.quantity in result.failed else "✓") if has else "not measured"
        measured = number(values[bound.quantity]) if has else "–"
        sign = "≤" if bound.relation == "<=" else "≥"
        rows.append((bound.quantity, f"{sign} {number(bound.limit)}", measured, verdict, bound.reason))
    return rows


MEASURED_HEAD = ("measured quantity", "bound stated before", "measured", "", "why this bound")


def markdown(entries: Entries, version: str) -> str:
    """The report as Markdown."""
    results = [result for _, result in entries]
    lines = ["# Verification of ngvisco", "", headline(results) + ".", "", machine(version), ""]
    overview = [
        (_WORDS[r.status], f"[{c.name}](#{c.name})", c.statement, f"{r.seconds:.0f} s") for c, r in entries
    ]
    lines += [*_markdown_table(("", "case", "claim", "time"), overview), ""]
    theme = ""
    for case, result in entries:
        if case.theme != theme:
            theme = case.theme
            lines += [f"## {theme}", ""]
        lines += [f"### {case.name}", "", f"**{_WORDS[result.status]}.** {case.statement}", ""]
        lines += [f"*Label:* {case.label}", "", f"*Setting:* {case.setting}", ""]
        lines += [*_markdown_table(MEASURED_HEAD, measured_rows(case, result)), ""]
        if result.error:
            lines += ["```", result.error.strip(), "```", ""]
        if result.status != "holds" and case.explanation:
            lines += [f"*Why it does not hold:* {case.explanation}", ""]
        if result.outcome is None:
            continue
        for remark in result.outcome.remarks:
            lines += [remark, ""]
        for table in result.outcome.tables:
            lines += [f"*{table.title}*", "", *_markdown_table(table.columns, table.rows), ""]
        for i, plot in enumerate(result.outcome.plots):
            lines += [f"![{plot.title}]({_picture(case.name, i)})", ""]
    # all cases: what a label is measured by does not depend on which ones a report has
    table = label_table(all_cases())
    lines += [f"## {LABELS}", "", f"{table.title}.", "", *_markdown_table(table.columns, table.rows), ""]
    return "\n".join(lines)


LABELS = "The labels of the paper"


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[str | float]]) -> list[str]:
    cells = [[number(cell).replace("|", "\\|") for cell in row] for row in (head, *rows)]
    return [f"| {' | '.join(row)} |" for row in (cells[0], ["---"] * len(head), *cells[1:])]


def _picture(name: str, index: int) -> str:
    return f"pictures/{name}{f'-{index + 1}' if index else ''}.png"
