"""Printing of warnings: each warning of ngvisco appears once, without its place in the code.

Python prints a warning with the file and the source line that raised the warning.  For a warning of ngvisco,
this file is a module of the package.  Python also repeats a warning if a filter has changed meanwhile.  Other
packages' warnings are printed as before.
Filters, ``pytest.warns`` and ``warnings.catch_warnings(record=True)`` see every warning as usual.
"""

import sys
import warnings
from collections.abc import Callable
from typing import Any

from ngvisco.errors import NgviscoWarning
from ngvisco.words import words_of


class Notices:
    """A ``warnings.showwarning`` that shows each of ngvisco's warnings once.

    Parameters
    ----------
    say : callable
        Function that shows a warning, given its text and category.
    fallback : callable, optional
        The ``warnings.showwarning`` for all other warnings; by default the present one.
    """

    def __init__(
        self, say: Callable[[str, type[Warning]], None], fallback: Callable[..., None] | None = None
    ) -> None:
        self.say, self.others = say, fallback or warnings.showwarning
        self._said: set[tuple[type[Warning], str]] = set()

    def __call__(self, message: Warning | str, category: type[Warning], *where: Any, **options: Any) -> None:
        if not issubclass(category, NgviscoWarning):
            self.others(message, category, *where, **options)
        elif (category, str(message)) not in self._said:
            self._said.add((category, str(message)))
            self.say(words_of(message), category)


def _print(message: str, category: type[Warning]) -> None:
    if sys.stderr is not None:
        print(f"ngvisco: {category.__name__}: {message}", file=sys.stderr)


def print_own() -> None:
    """Make Python print ngvisco's warnings as ``ngvisco: InputWarning: ...``."""
    if not isinstance(warnings.showwarning, Notices):
        warnings.showwarning = Notices(_print)
