"""One report of all results: HTML with its pictures inside, and Markdown with them beside."""

from __future__ import annotations

import base64
import html
import platform
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from string import Template

from ngvisco.run.files import write_atomically
from tests.verification.case import Case, Result, number
from tests.verification.labels import label_table
from tests.verification.pictures import can_draw, draw

NO_PICTURES = 'matplotlib is missing, so there are no pictures: pip install "ngvisco[plots]", and --resume'
_WORDS = {"holds": "holds", "fails": "DOES NOT HOLD", "error": "ERROR"}
_MARKS = {"holds": "✓", "fails": "✗", "error": "!"}

Entries = Sequence[tuple[Case, Result]]
Images = Mapping[str, Sequence[bytes]]


def write_report(directory: Path, cases: Sequence[Case], results: Sequence[Result], version: str) -> Path:
    """Write ``report.html``, ``report.md`` and ``pictures/`` into the directory; returns the HTML's path."""
    entries = list(zip(cases, results, strict=True))
    images: dict[str, list[bytes]] = {}
    if can_draw():
        for _, result in entries:
            if result.outcome is not None:
                images[result.name] = [draw(plot) for plot in result.outcome.plots]
    for name, drawn in images.items():
        for i, image in enumerate(drawn):
            write_atomically(directory / _picture(name, i), image)
    write_atomically(directory / "report.md", markdown(entries, images, version).encode())
    path = directory / "report.html"
    write_atomically(path, as_html(entries, images, version).encode())
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


def markdown(entries: Entries, images: Images, version: str) -> str:
    """The report as Markdown."""
    results = [result for _, result in entries]
    lines = ["# Verification of ngvisco", "", headline(results) + ".", "", machine(version), ""]
    if not images:
        lines += [NO_PICTURES, ""]
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
        for i, _ in enumerate(images.get(case.name, ())):
            lines += [f"![{result.outcome.plots[i].title}]({_picture(case.name, i)})", ""]
    table = label_table(_package_cases())
    lines += [f"## {LABELS}", "", f"{table.title}.", "", *_markdown_table(table.columns, table.rows), ""]
    return "\n".join(lines)


LABELS = "The labels of the paper"


def _package_cases() -> Sequence[Case]:
    """All cases: what a label is measured by does not depend on which ones a report has."""
    from tests.verification.registry import all_cases

    return all_cases()


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[str | float]]) -> list[str]:
    cells = [[number(cell).replace("|", "\\|") for cell in row] for row in (head, *rows)]
    return [f"| {' | '.join(row)} |" for row in (cells[0], ["---"] * len(head), *cells[1:])]


def as_html(entries: Entries, images: Images, version: str) -> str:
    """The report as one HTML file without links to anything outside it."""
    text = resources.files(__package__).joinpath("report.html").read_text(encoding="utf-8")
    results = [result for _, result in entries]
    overview = [
        f'<tr class="{r.status}"><td>{_MARKS[r.status]}</td><td><a href="#{c.name}">{c.name}</a></td>'
        f"<td>{_escape(c.statement)}</td><td>{r.seconds:.0f} s</td></tr>"
        for c, r in entries
    ]
    sections, theme = [], ""
    for case, result in entries:
        if case.theme != theme:
            theme = case.theme
            sections.append(f"<h2>{_escape(theme)}</h2>")
        sections.append(_section(case, result, images.get(case.name, ())))
    table = label_table(_package_cases())
    sections.append(f"<h2>{LABELS}</h2><p>{_escape(table.title)}.</p>")
    sections.append(_html_table(table.columns, table.rows))
    return Template(text).substitute(
        headline=_escape(headline(results)),
        machine=_escape(machine(version)),
        warning="" if images else f'<p class="error">{_escape(NO_PICTURES)}</p>',
        overview="\n".join(overview),
        sections="\n".join(sections),
    )


def _section(case: Case, result: Result, images: Sequence[bytes]) -> str:
    parts = [
        f'<section id="{case.name}" class="{result.status}">',
        f"<h3>{case.name} <em>{_WORDS[result.status]}</em></h3>",
        f"<p>{_escape(case.statement)}</p>",
        f'<p class="setting"><b>Label:</b> {_escape(case.label)}<br>',
        f"<b>Setting:</b> {_escape(case.setting)}</p>",
        _html_table(MEASURED_HEAD, measured_rows(case, result)),
    ]
    if result.error:
        parts.append(f"<pre>{_escape(result.error.strip())}</pre>")
    if result.status != "holds" and case.explanation:
        parts.append(f'<p class="why"><b>Why it does not hold:</b> {_escape(case.explanation)}</p>')
    if result.outcome is not None:
        parts += [f"<p>{_escape(remark)}</p>" for remark in result.outcome.remarks]
        for plot, image in zip(result.outcome.plots, images, strict=False):
            data = base64.b64encode(image).decode()
            parts.append(f'<img alt="{_escape(plot.title)}" src="data:image/png;base64,{data}">')
        for table in result.outcome.tables:
            body = _html_table(table.columns, table.rows)
            parts.append(f"<details open><summary>{_escape(table.title)}</summary>{body}</details>")
    return "\n".join([*parts, "</section>"])


def _html_table(head: Sequence[str], rows: Sequence[Sequence[str | float]]) -> str:
    def line(cells: Sequence[str | float], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{_escape(number(cell))}</{tag}>" for cell in cells) + "</tr>"

    return f"<table>{line(head, 'th')}{''.join(line(row, 'td') for row in rows)}</table>"


def _escape(text: str) -> str:
    return html.escape(text)


def _picture(name: str, index: int) -> str:
    return f"pictures/{name}{f'-{index + 1}' if index else ''}.png"
