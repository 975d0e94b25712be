"""Writing files so that nothing is lost: whole or not at all, with the file's name in every error; locks."""

import contextlib
import csv
import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TextIO


def write_atomically(path: Path, content: bytes) -> None:
    """Write beside and rename; on an error the old file is as it was and nothing lies beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".part")
    with _named(path):
        try:
            with draft.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise


def append(path: Path, text: str) -> None:
    """Add text to the end of a file."""
    with _named(path), path.open("a", newline="", encoding="utf-8") as file:
        file.write(text)


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Rows as lines of a CSV file."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    return text.getvalue()


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """Put the file's name into errors of writing, which Python raises without one."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def locks(file: TextIO) -> bool:
    """Lock a file for as long as the process lives; False if another process holds it."""
    lock: Callable[..., Any]
    if sys.platform == "win32":
        import msvcrt

        lock, arguments = msvcrt.locking, (msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        lock, arguments = fcntl.flock, (fcntl.LOCK_EX | fcntl.LOCK_NB,)
    try:
        lock(file.fileno(), *arguments)
    except OSError:
        return False
    return True
