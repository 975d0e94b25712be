"""Signals that let what runs come to an end by itself."""

import signal
from collections.abc import Callable
from types import FrameType
from typing import Any

NUMBERS = (signal.SIGINT, signal.SIGTERM)


class Stopping:
    """Within: SIGINT and SIGTERM call ``stop`` and are noted; a second one ends the process as usual."""

    def __init__(self, stop: Callable[[], None]) -> None:
        self.stop, self.received = stop, 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Stopping":
        for number in NUMBERS:
            self._before.setdefault(number, signal.signal(number, self._handle))
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.received = number
        self.stop()
        self.__exit__()
