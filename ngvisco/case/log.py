"""The log of a run: progress and warnings with their dates."""

import contextlib
import time as clock
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ngvisco.run.files import append
from ngvisco.run.observers import Progress


class Log(Progress):
    """Progress lines with the date, appended to a run's log file."""

    def __init__(self, path: Path, until: float, every: int = 1) -> None:
        super().__init__(until, every)
        self.path = path

    def write(self, line: str) -> None:
        """Append a line."""
        stamp = clock.strftime("%Y-%m-%d %H:%M:%S")
        append(self.path, f"{stamp}  {line}\n")

    def _print(self, line: str) -> None:
        self.write(line)


@contextlib.contextmanager
def noting_warnings(note: Callable[[str], None]) -> Iterator[None]:
    """Within: warnings are given to ``note`` too, each as a line."""
    shown = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **options: Any) -> None:
        note(f"{category.__name__}: {message}")
        shown(message, category, *where, **options)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
