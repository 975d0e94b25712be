"""How warnings are printed: those of ngvisco once each, without the place in its code that they come from.

Python prints a warning with the file and the source line of its caller, which for ngvisco's are inside the
package, and prints it again where a filter has changed in between.  All others are printed as before.
Filters, ``pytest.warns`` and ``warnings.catch_warnings(record=True)`` see every warning as ever.
"""

import sys
import warnings
from collections.abc import Callable
from typing import Any

from ngvisco.errors import NgviscoWarning


class Notices:
    """A ``warnings.showwarning`` that says each of ngvisco's warnings once.

    Parameters
    ----------
    say : callable
        Takes a warning's text and its category.
    others : callable
        The ``warnings.showwarning`` for what is not ngvisco's.
    """

    def __init__(
        self, say: Callable[[str, type[Warning]], None], others: Callable[..., None] | None = None
    ) -> None:
        self.say, self.others = say, others or warnings.showwarning
        self._said: set[tuple[type[Warning], str]] = set()

    def __call__(self, message: Warning | str, category: type[Warning], *where: Any, **options: Any) -> None:
        if not issubclass(category, NgviscoWarning):
            self.others(message, category, *where, **options)
        elif (category, str(message)) not in self._said:
            self._said.add((category, str(message)))
            self.say(str(message), category)


def _print(message: str, category: type[Warning]) -> None:
    if sys.stderr is not None:
        print(f"ngvisco: {category.__name__}: {message}", file=sys.stderr)


def print_own() -> None:
    """Let Python print ngvisco's warnings as ``ngvisco: InputWarning: ...``."""
    if not isinstance(warnings.showwarning, Notices):
        warnings.showwarning = Notices(_print)
