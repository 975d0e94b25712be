"""All cases by name, theme by theme in the report's order."""

from collections.abc import Sequence

from ngvisco.errors import UnknownNameError
from tests.verification.case import Case, VerificationError


def all_cases() -> tuple[Case, ...]:
    """Every case, in the order of the report.  Raises VerificationError if two cases share a name."""
    from tests.verification.cases import CASES as found

    names = [case.name for case in found]
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise VerificationError(f"two cases are called {', '.join(double)}")
    return found


def select(cases: Sequence[Case], names: Sequence[str] = (), reduced: bool = False) -> tuple[Case, ...]:
    """The cases asked for: all of them, the reduced set, or those with the given names or name beginnings.

    Raises UnknownNameError for a name that no case has, with the nearest one.
    """
    for name in names:
        if not any(_matches(case, name) for case in cases):
            raise UnknownNameError("verification case", name, [case.name for case in cases])
    chosen = [case for case in cases if not names or any(_matches(case, name) for name in names)]
    return tuple(case for case in chosen if case.reduced or not reduced)


def _matches(case: Case, name: str) -> bool:
    """``limit-tau`` stands for ``limit-tau-linearised`` and ``limit-tau-finite``."""
    return case.name == name or case.name.startswith(f"{name}-")
