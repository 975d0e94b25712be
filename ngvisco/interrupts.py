"""Ctrl-C while the command ``ngvisco`` imports its packages: it ends the command without a traceback.

The package imports this module first, and this module imports only what Python has loaded at its start.  In
other programs an interrupt is an exception as usual.
"""

import os
import sys

_before = sys.excepthook


def _say(kind: type[BaseException], error: BaseException, trace: object) -> None:
    if kind is not KeyboardInterrupt:
        return _before(kind, error, trace)  # type: ignore[arg-type]
    print("ngvisco: the command was interrupted before it began", file=sys.stderr)


if os.path.basename(sys.argv[0]) == "ngvisco" or sys.orig_argv[1:3] == ["-m", "ngvisco"]:
    sys.excepthook = _say


def end() -> None:
    """Leave interrupts to the program, whose imports are done."""
    if sys.excepthook is _say:
        sys.excepthook = _before
