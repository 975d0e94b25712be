"""A report's directory: results case by case, so that an interrupted report can be gone on with.

| file               | holds                                                                 |
|--------------------|-----------------------------------------------------------------------|
| verification.json  | that this is a report's directory, and of which cases                 |
| cases/NAME.json    | the result of a case, written when it is complete                     |
| report.md          | the report, written last                                              |
| pictures/NAME.png  | its pictures                                                          |

Every file is written beside its name and renamed.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from ngvisco.run.files import write_atomically
from tests.verification.case import Case, Result, VerificationError

MARKER = "verification.json"
_KIND = "ngvisco verification report"


class ReportDirectory:
    """Opens a new directory, or an earlier report's with ``resume``.

    Raises VerificationError if there is something else at the path, or a report and ``resume`` is not asked
    for, or the other way round.
    """

    def __init__(self, path: Path, cases: Sequence[Case], *, resume: bool = False) -> None:
        self.path = path
        if path.exists() and not path.is_dir():
            raise VerificationError(f"{path}: a file; choose another directory")
        is_report = _is_report(path / MARKER)
        occupied = path.is_dir() and any(path.iterdir())
        if occupied and not is_report:
            raise VerificationError(f"{path}: holds something else than a report; choose another directory")
        if is_report and not resume:
            raise VerificationError(
                f"{path}: holds an earlier report; go on with it by --resume, or choose another directory"
            )
        if resume and not is_report:
            raise VerificationError(f"{path}: no report to go on with")
        # what an earlier report said is not what this one will say
        (path / "report.md").unlink(missing_ok=True)
        content = {"kind": _KIND, "cases": [case.name for case in cases]}
        write_atomically(path / MARKER, json.dumps(content, indent=1).encode())

    def save(self, result: Result) -> None:
        """Keep a case's result."""
        write_atomically(self.path / "cases" / f"{result.name}.json", result.to_json().encode())

    def saved(self, case: Case, version: str) -> Result | None:
        """The kept result of the same case, measured by the same version, if there is one.

        An error is no result: the case is run again.
        """
        try:
            result = Result.from_json((self.path / "cases" / f"{case.name}.json").read_text())
        except (OSError, ValueError, KeyError, TypeError):
            return None
        same = result.fingerprint == case.fingerprint and result.version == version
        return result if same and result.status != "error" else None


def _is_report(marker: Path) -> bool:
    try:
        return json.loads(marker.read_text()).get("kind") == _KIND
    except (OSError, ValueError, AttributeError):
        return False
