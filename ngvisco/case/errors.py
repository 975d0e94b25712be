"""The error of a case file: every fault found, each with its place, value and remedy."""

from collections.abc import Sequence
from dataclasses import dataclass

from ngvisco.errors import NgviscoError


@dataclass(frozen=True)
class Fault:
    """One fault: the key's path in the file, what is wrong, and the line if it is known."""

    key: str
    message: str
    line: int | None = None


class CaseError(NgviscoError, ValueError):
    """A case file that cannot be run as it is; ``faults`` lists all that was found."""

    def __init__(self, source: str, faults: Sequence[Fault]) -> None:
        self.source, self.faults = source, tuple(faults)
        super().__init__("\n".join(self._line(fault) for fault in self.faults))

    def _line(self, fault: Fault) -> str:
        place = f"{self.source}:{fault.line}" if fault.line else self.source
        return f"{place}: {fault.key}: {fault.message}" if fault.key else f"{place}: {fault.message}"


class Wrong(str):
    """Stands for a value whose unit is wrong, which no key takes, and says why."""
