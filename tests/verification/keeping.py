"""The kept report: what was run again takes the place of the same cases' rows, each with its commit.

The whole report takes longer than a change does.  Cases that are gone are left out of it, those that it does
not have are said to be missing.
"""

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

from ngvisco.run.files import write_atomically
from tests.verification.case import Case, VerificationError
from tests.verification.report import LABELS

FIRST = "e85ab32"
"""The commit of rows that name none: of the last whole report, or before it."""
_ROW = re.compile(r"^\| ([^|]*) \| \[([\w-]+)\]\(.*\| (\d+) s \|(?: ([^|]*) \|)?$")


def commit() -> str:
    """The commit that is checked out, marked where files differ from it."""
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def parsed(text: str) -> tuple[dict[str, re.Match[str]], dict[str, str]]:
    """Of a report's Markdown: every case's row of the overview, and what is said of it below."""
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
    """A kept report with the cases of a new one, which is of the commit ``of``, in the order of ``cases``."""
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
    """Merge the report in ``source`` and its pictures into that in ``directory``; returns the latter's path.

    Raises VerificationError if one of the reports is missing, or a case of the new one ended in an error.
    """
    of = commit()  # before pictures make it differ
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
