"""Exit codes, signals that ask a run to stop, and output that survives a closed, full or unsuited stream."""

import contextlib
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

DONE = 0
FAILED = 1  # a step could not be solved
BAD_INPUT = 2  # the case or an option is at fault, or there are results already
BAD_FILE = 3  # a file could not be read or written
NOT_CLOSED = 4  # the run reached its end, but its energy ledger does not close
INTERRUPTED = 130  # 128 + n: stopped by signal n, with a checkpoint


def make_safe() -> None:
    """Make standard output and error accept every text, and reopen them if the shell closed them."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # the shell started the command with >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (for the process)
        elif hasattr(stream, "reconfigure"):
            with contextlib.suppress(ValueError):
                stream.reconfigure(errors="backslashreplace")


_silent = False


def be_silent() -> None:
    """Drop all later output and messages, because the first rank prints them."""
    global _silent
    _silent = True


def write(text: str, stream: Any = None) -> None:
    """Write a text to a stream, by default standard output, and flush; if this fails, drop the text."""
    if _silent:
        return
    stream = stream or sys.stdout
    try:
        stream.write(text)
        stream.flush()
    except (OSError, ValueError):
        give_up(stream)


def complain(message: str) -> None:
    """Print a message to standard error, with the command's name before each line."""
    write("".join(f"ngvisco: {line}\n" for line in message.splitlines()), sys.stderr)


def give_up(stream: Any) -> None:
    """Redirect a stream to the null device, because Python would fail on unwritten text when it ends."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def stopped(received: int, words: str) -> int:
    """Say that signal number ``received`` stopped the command; return the exit code."""
    write(f"{signal.Signals(received).name}: stopped{words}\n")
    return 128 + received


class Stopping:
    """A context in which the first SIGINT or SIGTERM calls ``stop``; a second one ends the process as usual.

    ``received`` is the number of the signal, 0 without one."""

    def __init__(self, stop: Callable[[], None]) -> None:
        self.stop, self.received = stop, 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Stopping":
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before.setdefault(number, signal.signal(number, self._handle))
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.received = number
        self.stop()
        self.__exit__()
