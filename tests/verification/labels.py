"""The paper's labels: which module has what a label stands for, and which case or test measures it.

``labels.txt`` lists the labels, what they are, and the tests.  Modules are found by their docstrings and
comments, cases by the labels that they name, so that neither is written down twice.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import ngvisco
from tests.verification.case import Case, Table, VerificationError

_NOT = "not: "
_WORDS = ("cut-off", "J-min")
"""Labels that are words too: they count where "paper" stands before them."""


@dataclass(frozen=True)
class Label:
    """A label of the paper.

    Attributes
    ----------
    name : str
    whole : str
        The label that it is a part of, and is measured with; empty for none.
    what : str
    tests : tuple of str
        ``FILE::TEST`` below ``tests/``.
    reason : str
        Why nothing measures it, where nothing does.
    """

    name: str
    whole: str
    what: str
    tests: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class Row:
    """A label with the modules, below ``ngvisco/``, and the names of the cases that have it."""

    label: Label
    modules: tuple[str, ...]
    cases: tuple[str, ...]

    @property
    def is_measured(self) -> bool:
        """Whether a case or a test is its own."""
        return bool(self.cases or self.label.tests)


@cache
def labels() -> dict[str, Label]:
    """All labels of the paper by name, in its order.

    Raises VerificationError for a line of ``labels.txt`` that is none.
    """
    text = resources.files(__package__).joinpath("labels.txt").read_text(encoding="utf-8")
    found: dict[str, Label] = {}
    for line in text.splitlines():
        if line.startswith("#"):
            continue
        parts = [part.strip() for part in re.split(r" \|(?= |$)", line)]
        if len(parts) != 4 or parts[0] in found:
            raise VerificationError(f"labels.txt: {line!r}: expected a new label, its whole, words, tests")
        name, whole, what, measured = parts
        reason = measured.removeprefix(_NOT) if measured.startswith(_NOT) else ""
        tests = () if reason or not measured else tuple(measured.split(", "))
        found[name] = Label(name, whole, what, tests, reason)
    unknown = {label.whole for label in found.values() if label.whole} - set(found)
    if unknown:
        raise VerificationError(f"labels.txt: wholes that are no labels: {', '.join(sorted(unknown))}")
    return found


def rows(cases: Iterable[Case]) -> list[Row]:
    """Every label with the package's modules, and the cases that name it, be it in a bound's reason."""
    modules, named = label_modules(), _named(cases)
    return [Row(label, modules.get(name, ()), named.get(name, ())) for name, label in labels().items()]


def label_table(cases: Iterable[Case]) -> Table:
    """The table of the report."""
    by_name = {row.label.name: row for row in rows(cases)}
    count = {"own": 0, "whole": 0, "none": 0}
    lines = []
    for row in by_name.values():
        kind, measured = _measured(row, by_name)
        count[kind] += 1
        modules = ", ".join(row.modules)
        if not modules and row.label.whole:
            modules = f"with {row.label.whole}"
        lines.append((row.label.name, row.label.what, modules or "–", measured))
    title = (
        f"{len(lines)} labels of the paper: {count['own']} with a case or a test of their own, "
        f"{count['whole']} measured with the whole that they are parts of, {count['none']} not measured"
    )
    return Table(title, ("label", "what", "modules", "measured by"), lines)


def _measured(row: Row, by_name: Mapping[str, Row]) -> tuple[str, str]:
    """How a label is measured: by itself, with a whole, or not; and the words for it."""
    if row.is_measured:
        parts = (("cases", row.cases), ("tests", row.label.tests))
        return "own", "; ".join(f"{kind}: {', '.join(names)}" for kind, names in parts if names)
    if row.label.reason:
        return "none", f"not measured: {row.label.reason}"
    whole = row
    while whole.label.whole:
        whole = by_name[whole.label.whole]
        if whole.is_measured:
            return "whole", f"with {whole.label.name}"
        if whole.label.reason:
            return "none", f"not measured, as {whole.label.name}"
    return "none", "not measured"


def labels_in(text: str, names: Sequence[str] | None = None) -> list[str]:
    """The labels that a text has, whole: not those that are only the beginning of another one."""
    return [match[0] for match in _pattern().finditer(text) if names is None or match[0] in names]


@cache
def _pattern() -> re.Pattern[str]:
    known = "|".join(re.escape(name) for name in sorted(labels(), key=len, reverse=True))
    # a sign after which a letter follows continues a name; a full stop or a colon at an end does not
    return re.compile(rf"(?<![\w+*/–-])(?:{known})(?![\w+*]|[-/–.:=]\w)")


@cache
def label_modules() -> dict[str, tuple[str, ...]]:
    """The modules that mention each label, below ``ngvisco/``."""
    root = Path(ngvisco.__file__).parent
    found: dict[str, list[str]] = {}
    for path in sorted(root.rglob("*.py")):
        module = path.relative_to(root)
        if module.parts[0] in ("geometries", "demos"):
            continue
        text = re.sub(r"-\n\s+", "-", path.read_text(encoding="utf-8"))  # labels broken at a hyphen
        of_paper = "\n".join(re.findall(r"paper[^)]*", text))
        names = [name for name in labels_in(text) if name not in _WORDS] + labels_in(of_paper, _WORDS)
        for name in dict.fromkeys(names):
            found.setdefault(name, []).append(module.as_posix().removesuffix(".py"))
    return {name: tuple(modules) for name, modules in found.items()}


def _named(cases: Iterable[Case]) -> dict[str, tuple[str, ...]]:
    found: dict[str, list[str]] = {}
    for case in cases:
        said = " ; ".join([case.label, *(bound.reason for bound in case.bounds)])
        for name in dict.fromkeys(labels_in(said)):
            found.setdefault(name, []).append(case.name)
    return {name: tuple(names) for name, names in found.items()}
