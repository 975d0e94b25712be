"""The report of all results, in Markdown with pictures beside it, and the kept report.

In the kept report, new results replace the rows of their cases, and each row has its commit, because a whole
report takes longer than a change can wait.  The kept report leaves out cases that no longer exist, and lists
cases that are missing.
"""

import io
import platform
import re
import subprocess
from collections.abc import Iterable, Sequence
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

import numpy as np

from ngvisco.run.files import write_atomically
from ngvisco.run.pictures import figure
from tests.verification.bounds import VerificationError
from tests.verification.case import Case, Plot, Result, number
from tests.verification.cases import all_cases
from tests.verification.labels import label_table

_WORDS = {"holds": "holds", "fails": "DOES NOT HOLD", "error": "ERROR"}
LABELS = "The labels of the paper"


def write_report(directory: Path, cases: Sequence[Case], results: Sequence[Result], version: str) -> Path:
    """Write ``report.md`` and ``pictures/`` into the directory; returns the report's path."""
    for result in results:
        for i, plot in enumerate(result.outcome.plots):
            write_atomically(directory / _picture(result.name, i), draw(plot))
    path = directory / "report.md"
    write_atomically(path, markdown(list(zip(cases, results, strict=True)), version).encode())
    return path


def headline(results: Sequence[Result]) -> str:
    """The numbers of cases that hold, fail and could not be run, in words."""
    count = {status: sum(r.status == status for r in results) for status in _WORDS}
    return (
        f"{len(results)} cases: {count['holds']} hold, {count['fails']} do not, {count['error']} ended in "
        f"an error; {sum(r.seconds for r in results) / 60:.0f} minutes of computing"
    )


def markdown(entries: Sequence[tuple[Case, Result]], version: str) -> str:
    """The report as Markdown."""
    machine = f"NGSolve {version_of('ngsolve')}, Python {platform.python_version()}, {platform.machine()}"
    lines = ["# Verification of ngvisco", "", headline([result for _, result in entries]) + "."]
    lines += ["", f"ngvisco {version}, {machine}", ""]
    overview = [
        (_WORDS[r.status], f"[{c.name}](#{c.name})", c.statement, f"{r.seconds:.0f} s") for c, r in entries
    ]
    lines += _markdown_table(("", "case", "claim", "time"), overview)
    theme = ""
    for case, result in entries:
        if case.theme != theme:
            theme = case.theme
            lines += [f"## {theme}", ""]
        lines += [f"### {case.name}", "", f"**{_WORDS[result.status]}.** {case.statement}", ""]
        lines += [f"*Label:* {case.label}", "", f"*Setting:* {case.setting}", ""]
        head = ("measured quantity", "bound stated before", "measured", "", "why this bound")
        lines += _markdown_table(head, _measured_rows(case, result))
        if result.error:
            lines += ["```", result.error.strip(), "```", ""]
        if result.status != "holds" and case.explanation:
            lines += [f"*Why it does not hold:* {case.explanation}", ""]
        for remark in result.outcome.remarks:
            lines += [remark, ""]
        for table in result.outcome.tables:
            lines += [f"*{table.title}*", "", *_markdown_table(table.columns, table.rows)]
        for i, plot in enumerate(result.outcome.plots):
            lines += [f"![{plot.title}]({_picture(case.name, i)})", ""]
    # all cases are used: the measurement of a label does not depend on the cases in the report
    table = label_table(all_cases())
    lines += [f"## {LABELS}", "", f"{table.title}.", "", *_markdown_table(table.columns, table.rows)]
    return "\n".join(lines)


def _measured_rows(case: Case, result: Result) -> Iterable[tuple[str, ...]]:
    """Quantity, bound, measured value, verdict and reason, one row for each bound."""
    for bound in case.bounds:
        value = result.outcome.values.get(bound.quantity)
        verdict = "not measured" if value is None else "✗" if bound.quantity in result.failed else "✓"
        limit = bound.said(number).replace("<=", "≤").replace(">=", "≥")
        yield bound.quantity, limit, "–" if value is None else number(value), verdict, bound.reason


def _markdown_table(head: Sequence[str], rows: Iterable[Iterable[Any]]) -> list[str]:
    cells = [[number(cell).replace("|", "\\|") for cell in row] for row in (head, *rows)]
    return [*(f"| {' | '.join(row)} |" for row in (cells[0], ["---"] * len(head), *cells[1:])), ""]


def _picture(name: str, index: int) -> str:
    return f"pictures/{name}{f'-{index + 1}' if index else ''}.png"


def draw(plot: Plot) -> bytes:
    """The picture as PNG; raises PlotError without matplotlib."""
    fig, ((axis,),) = figure(1, 1, (6.4, 4.2))
    for curve in plot.curves:
        x, y = (np.array(values, dtype=float) for values in (curve.x, curve.y))
        if "y" in plot.log:
            y[y <= 0] = np.nan
        axis.plot(x, y, curve.style, label=curve.label, ms=4, lw=1.3)
    scales = {f"{name}scale": "log" for name in plot.log}
    axis.set(title=plot.title, xlabel=plot.xlabel, ylabel=plot.ylabel, **scales)
    axis.grid(alpha=0.3)
    if len(plot.curves) > 6:  # a legend inside would hide half of the curves
        axis.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    else:
        axis.legend(fontsize="small")
    from PIL import Image  # matplotlib needs Pillow

    drawn, small = io.BytesIO(), io.BytesIO()
    fig.savefig(drawn, dpi=90, format="png")
    # a palette of 64 colours makes files a third as large, and a report has a hundred pictures
    Image.open(drawn).convert("RGB").quantize(64).save(small, format="png", optimize=True)
    return small.getvalue()


# --- the kept report ------------------------------------------------------------------------------------

FIRST = "e85ab32"
"""The commit of rows that name none: the commit of the last whole report, or an earlier one."""
_ROW = re.compile(r"^\| ([^|]*) \| \[([\w-]+)\]\(.*\| (\d+) s \|(?: ([^|]*) \|)?$")


def commit() -> str:
    """The commit that is checked out, with a mark if files differ from it."""
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def parsed(text: str) -> tuple[dict[str, re.Match[str]], dict[str, str]]:
    """Each case's row in the overview of a report's Markdown, and each case's section below."""
    rows: dict[str, re.Match[str]] = {}
    sections: dict[str, str] = {}
    name = ""
    for line in text.splitlines():
        if found := _ROW.match(line):
            rows[found[2]] = found
        if line.startswith(("## ", "### ")):
            name = line.partition("### ")[2]
        if name:
            sections[name] = f"{sections.get(name, '')}{line}\n"
    return rows, sections


def merged(kept: str, new: str, cases: Sequence[Case], of: str) -> str:
    """A kept report with the cases of a new report at the commit ``of``, in the order of ``cases``."""
    (old_rows, old_sections), (rows, sections) = parsed(kept), parsed(new)
    overview, body, theme, minutes, statuses = [], [], "", 0.0, []
    for case in cases:
        row = rows.get(case.name) or old_rows.get(case.name)
        if row is None:
            continue
        known = of if case.name in rows else row[4] or FIRST
        line = row[0] if row[4] is None else row[0][: row.start(4) - row.start(0) - 1].rstrip()
        overview.append(f"{line} {known} |")
        minutes += int(row[3]) / 60
        statuses.append(row[1])
        if case.theme != theme:
            theme = case.theme
            body += [f"## {theme}", ""]
        body.append((sections if case.name in rows else old_sections)[case.name].rstrip("\n") + "\n")
    hold = statuses.count("holds")
    missing = [case.name for case in cases if case.name not in rows and case.name not in old_rows]
    lines = [
        *("# Verification of ngvisco", ""),
        f"{len(statuses)} cases: {hold} hold, {len(statuses) - hold} do not; {minutes:.0f} minutes.",
        *("", "The last column is the commit that a case was run at."),
        *("", f"Missing: {', '.join(missing) or 'none'}.", ""),
        *("|  | case | claim | time | commit |", "| --- | --- | --- | --- | --- |", *overview, ""),
    ]
    return "\n".join([*lines, *body, f"## {LABELS}{new.partition(f'## {LABELS}')[2]}"])


def put_into(directory: Path, source: Path, cases: Sequence[Case]) -> Path:
    """Merge the report in ``source``, with pictures, into the report in ``directory``, and return its path.

    Raises VerificationError if a report is missing, or a case of the new report ended in an error.
    """
    of = commit()  # the commit is read before new pictures change files
    path, report = directory / "report.md", source / "report.md"
    if absent := [str(one) for one in (path, report) if not one.is_file()]:
        raise VerificationError(f"{absent[0]}: no report")
    kept, new = (one.read_text(encoding="utf-8") for one in (path, report))
    rows, _ = parsed(new)
    if broken := [name for name, row in rows.items() if row[1] == "ERROR"]:
        raise VerificationError(f"ended in an error, which is no result to keep: {', '.join(broken)}")
    for picture in sorted((source / "pictures").glob("*.png")):
        write_atomically(directory / "pictures" / picture.name, picture.read_bytes())
    write_atomically(path, merged(kept, new, cases, of).encode())
    return path
