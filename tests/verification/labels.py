"""The paper's labels, with the modules that implement them and the cases or tests that measure them.

``labels.txt`` lists the labels, their meanings, and the tests.  Modules are found by labels in their
docstrings and comments, and cases by the labels that they name, so that no module or case is written down
twice.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import ngvisco
from tests.verification.bounds import VerificationError
from tests.verification.case import Case, Table

_NOT = "not: "
_WORDS = ("cut-off", "J-min")
"""Labels that are also common words: they count only after "paper"."""


@dataclass(frozen=True)
class Label:
    """A label of the paper.

    ``whole`` is the larger label of which the label is a part and with which it is measured, or "".  ``what``
    is the meaning of the label.  ``tests`` are its tests, as ``FILE::TEST`` below ``tests/``.  ``reason``
    says why nothing measures the label.
    """

    name: str
    whole: str
    what: str
    tests: tuple[str, ...]
    reason: str


@cache
def labels() -> dict[str, Label]:
    """All labels of the paper by name, in the paper's order.

    Raises VerificationError for a malformed line of ``labels.txt``.
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


def label_table(cases: Iterable[Case]) -> Table:
    """The report's table of labels, each with the package's modules and the cases that name it."""
    named, modules, count = cases_by_label(cases), label_modules(), dict.fromkeys(("own", "whole", "none"), 0)
    rows = []
    for name, label in labels().items():
        kind, measured = _measured(label, named)
        count[kind] += 1
        where = ", ".join(modules.get(name, ())) or (f"with {label.whole}" if label.whole else "–")
        rows.append((name, label.what, where, measured))
    title = (
        f"{len(rows)} labels of the paper: {count['own']} with a case or a test of their own, "
        f"{count['whole']} measured with the whole that they are parts of, {count['none']} not measured"
    )
    return Table(title, ("label", "what", "modules", "measured by"), rows)


def _measured(label: Label, cases: Mapping[str, Sequence[str]]) -> tuple[str, str]:
    """The way in which a label is measured, "own", "whole" or "none", and its description in words."""
    one = label
    while True:
        names, is_own = cases.get(one.name, ()), one is label
        if names or one.tests:
            parts = (("cases", names), ("tests", one.tests))
            said = "; ".join(f"{kind}: {', '.join(of)}" for kind, of in parts if of)
            return ("own", said) if is_own else ("whole", f"with {one.name}")
        if one.reason:
            return "none", f"not measured: {one.reason}" if is_own else f"not measured, as {one.name}"
        if not one.whole:
            return "none", "not measured"
        one = labels()[one.whole]


def labels_in(text: str, names: Sequence[str] | None = None) -> list[str]:
    """The labels in a text; a label that is only the beginning of another one does not count."""
    return [match[0] for match in _pattern().finditer(text) if names is None or match[0] in names]


@cache
def _pattern() -> re.Pattern[str]:
    known = "|".join(re.escape(name) for name in sorted(labels(), key=len, reverse=True))
    # a sign such as a hyphen or a full stop continues a label only before a letter
    return re.compile(rf"(?<![\w+*/–-])(?:{known})(?![\w+*]|[-/–.:=]\w)")


@cache
def label_modules() -> dict[str, tuple[str, ...]]:
    """The modules below ``ngvisco/`` that mention each label."""
    root = Path(ngvisco.__file__).parent
    found: dict[str, list[str]] = {}
    for path in sorted(root.rglob("*.py")):
        module = path.relative_to(root)
        if module.parts[0] in ("geometries", "demos"):
            continue
        text = re.sub(r"-\n\s+", "-", path.read_text(encoding="utf-8"))  # labels may break at a hyphen
        of_paper = "\n".join(re.findall(r"paper[^)]*", text))
        names = [name for name in labels_in(text) if name not in _WORDS] + labels_in(of_paper, _WORDS)
        for name in dict.fromkeys(names):
            found.setdefault(name, []).append(module.as_posix().removesuffix(".py"))
    return {name: tuple(modules) for name, modules in found.items()}


def cases_by_label(cases: Iterable[Case]) -> dict[str, list[str]]:
    """The names of the cases that mention each label, as the case's label or in the reason of a bound."""
    found: dict[str, list[str]] = {}
    for case in cases:
        said = " ; ".join([case.label, *(bound.reason for bound in case.bounds)])
        for name in dict.fromkeys(labels_in(said)):
            found.setdefault(name, []).append(case.name)
    return found
