"""Runs cases one after the other, or some at once; an error in a case is the case's result and ends no other
case.

A report's directory keeps results case by case, so that an interrupted report can go on.

| file               | holds                                                                 |
|--------------------|-----------------------------------------------------------------------|
| verification.json  | the mark of a report's directory, and the names of its cases          |
| cases/NAME.json    | the result of a case, written when it is complete                     |
| report.md          | the report, written last                                              |
| pictures/NAME.png  | the report's pictures                                                 |

Every file is written under another name, and then renamed.
"""

import json
import time as clock
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from ngvisco.forms.context import time
from ngvisco.run.files import write_atomically
from ngvisco.run.ledger import Ledger
from tests.verification.bounds import CLOSURE, DRIFT, VerificationError
from tests.verification.case import Case, Result, collected, judge, number

MARKER = "verification.json"
_KIND = "ngvisco verification report"


class ReportDirectory:
    """A report's directory: a new one, or with ``resume`` the directory of an earlier report.

    Raises VerificationError for other contents at the path, for an earlier report without ``resume``, and for
    ``resume`` without an earlier report.
    """

    def __init__(self, path: Path, cases: Sequence[Case], *, resume: bool = False) -> None:
        self.path = path
        is_report, occupied = _is_report(path / MARKER), path.is_dir() and any(path.iterdir())
        refused = {
            "a file; choose another directory": path.is_file(),
            "holds something else than a report; choose another directory": occupied and not is_report,
            "holds an earlier report; go on with it by --resume, or choose another": is_report and not resume,
            "no report to go on with": resume and not is_report,
        }
        if said := [why for why, is_so in refused.items() if is_so]:
            raise VerificationError(f"{path}: {said[0]}")
        # the earlier report's page and pictures are outdated
        (path / "report.md").unlink(missing_ok=True)
        content = {"kind": _KIND, "cases": [case.name for case in cases]}
        write_atomically(path / MARKER, json.dumps(content, indent=1).encode())

    def save(self, result: Result) -> None:
        """Write a case's result to its file."""
        write_atomically(self.path / "cases" / f"{result.name}.json", result.to_json().encode())

    def saved(self, case: Case, version: str) -> Result | None:
        """The kept result of the same case by the same version; None if there is none.

        An error is no result, so that the case is run again.
        """
        try:
            result = Result.from_json((self.path / "cases" / f"{case.name}.json").read_text())
        except (OSError, ValueError, KeyError, TypeError):
            return None
        same = result.fingerprint == case.fingerprint and result.version == version
        return result if same and result.status != "error" else None


def _is_report(marker: Path) -> bool:
    try:
        return bool(json.loads(marker.read_text()).get("kind") == _KIND)
    except (OSError, ValueError, AttributeError):
        return False


@contextmanager
def watched() -> Iterator[dict[str, float]]:
    """Context that gives the largest relative |closure| and drift of mass in all steps made within it."""
    record, seen = Ledger.record, dict[str, float]()
    columns = {CLOSURE.quantity: "closure_relative", DRIFT.quantity: "mass_drift"}

    def noted(ledger: Ledger, *step: Any) -> dict[str, float]:
        row = record(ledger, *step)
        for quantity, column in columns.items():  # NumPy's maximum with NaN is NaN
            seen[quantity] = float(np.maximum(seen.get(quantity, 0.0), abs(row[column])))
        return row

    with patch.object(Ledger, "record", noted):
        yield seen


def run_case(case: Case, version: str) -> Result:
    """Run and judge one case; an exception becomes a result with status ``error``.

    Closure and drift are the largest in all runs of the case, unless the case gives values itself.
    """
    began = clock.process_time()  # other work on the machine does not count
    time.Set(0.0)  # earlier cases have changed the time of loads
    try:
        with watched() as seen:
            outcome = collected(case.run())
        asked = {quantity: seen[quantity] for b in case.bounds if (quantity := b.quantity) in seen}
        outcome = replace(outcome, values={**asked, **outcome.values})
        return judge(case, outcome, clock.process_time() - began, version)
    except Exception:
        seconds, text = clock.process_time() - began, traceback.format_exc(limit=-6)
        of: dict[str, Any] = {"name": case.name, "fingerprint": case.fingerprint, "version": version}
        return Result(**of, status="error", seconds=seconds, error=text)


def run_cases(cases: Sequence[Case], version: str, directory: ReportDirectory, jobs: int = 1) -> list[Result]:
    """Run the cases whose results the directory lacks, ``jobs`` at a time, and print a line for each.

    Every new result is written at once, so that an interruption loses nothing.
    """
    results: dict[str, Result] = {}

    def say(case: Case, what: str) -> None:
        print(f"[{cases.index(case) + 1:{len(str(len(cases)))}d}/{len(cases)}] {case.name}{what}", flush=True)

    for case in cases:
        if (earlier := directory.saved(case, version)) is not None:
            results[case.name] = earlier
            say(case, f": {describe(case, earlier)}; measured earlier")
    new = [case for case in cases if case.name not in results]
    began = clock.perf_counter()
    completed = _completed(new, version, jobs, lambda case: say(case, " ..."))
    for fresh, (case, result) in enumerate(completed, 1):
        directory.save(result)
        results[case.name] = result
        left = (clock.perf_counter() - began) / fresh * (len(new) - fresh)
        say(case, f": {describe(case, result)}; about {left:.0f} s left")
    return [results[case.name] for case in cases]


def _completed(
    cases: Sequence[Case], version: str, jobs: int, starts: Callable[[Case], None]
) -> Iterator[tuple[Case, Result]]:
    """Yield cases with their results, in the order of completion."""
    if jobs == 1:
        for case in cases:
            starts(case)
            yield case, run_case(case, version)
        return
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), max_tasks_per_child=1)
    try:
        waiting = {pool.submit(_run_named, case.name, version): case for case in cases}
        for done in as_completed(waiting):
            yield waiting[done], Result.from_json(done.result())
    finally:
        pool.shutdown(cancel_futures=True)


def _run_named(name: str, version: str) -> str:
    """The result of the package's case ``name``, as JSON."""
    from tests.verification.cases import all_cases

    return run_case(next(case for case in all_cases() if case.name == name), version).to_json()


def describe(case: Case, result: Result) -> str:
    """A line with status, failed bounds with their values, and processor time."""
    if result.status == "error":
        return f"ERROR {result.error.strip().splitlines()[-1]} ({result.seconds:.0f} s)"
    if result.status == "holds":
        return f"holds ({result.seconds:.0f} s)"
    faults = [
        f"{b.quantity} {number(result.outcome.values[b.quantity])}, not {b.said(number)}"
        for b in case.bounds
        if b.quantity in result.failed
    ]
    return f"FAILS {'; '.join(faults)} ({result.seconds:.0f} s)"
