"""Runs cases one after the other; the error of one is its result, not the end of the others."""

from __future__ import annotations

import sys
import time as clock
import traceback
from collections.abc import Callable, Sequence
from typing import TextIO

from ngvisco.forms.context import time
from tests.verification.case import Case, Result, judge, number

Keep = Callable[[Result], None]
Known = Callable[[Case], Result | None]


def run_case(case: Case, version: str) -> Result:
    """Run and judge one case; an exception becomes a result with status ``error``."""
    began = clock.process_time()  # what else the machine does is no part of it
    time.Set(0.0)  # the runs of earlier cases have moved it
    try:
        outcome = case.run()
        return judge(case, outcome, clock.process_time() - began, version)
    except Exception:
        return Result(
            name=case.name,
            fingerprint=case.fingerprint,
            version=version,
            status="error",
            seconds=clock.process_time() - began,
            error=traceback.format_exc(limit=-6),
        )


def run_cases(
    cases: Sequence[Case],
    version: str,
    keep: Keep = lambda result: None,
    known: Known = lambda case: None,
    stream: TextIO | None = None,
) -> list[Result]:
    """Run the cases that are not known yet, with a line for each before and after it.

    Parameters
    ----------
    cases : sequence of Case
    version : str
        Written into the results.
    keep : callable
        Gets every new result at once, so that nothing is lost by an interruption.
    known : callable
        The earlier result of a case, or None.
    stream : text stream, optional
        Default ``sys.stdout``.
    """
    out = stream or sys.stdout
    results: list[Result] = []
    began, spent, fresh = clock.perf_counter(), 0.0, 0
    for i, case in enumerate(cases, 1):
        head = f"[{i:{len(str(len(cases)))}d}/{len(cases)}] {case.name}"
        result = known(case)
        if result is None:
            print(f"{head} ...", file=out, flush=True)
            result = run_case(case, version)
            keep(result)
            spent, fresh = clock.perf_counter() - began, fresh + 1
            left = spent / fresh * (len(cases) - i)
            print(f"{head}: {describe(case, result)}; about {left:.0f} s left", file=out, flush=True)
        else:
            print(f"{head}: {describe(case, result)}; measured earlier", file=out, flush=True)
        results.append(result)
    return results


def describe(case: Case, result: Result) -> str:
    """A line: status, what failed by how much, and the time it took."""
    if result.status == "error" or result.outcome is None:
        return f"ERROR {result.error.strip().splitlines()[-1]} ({result.seconds:.0f} s)"
    if result.status == "holds":
        return f"holds ({result.seconds:.0f} s)"
    faults = [
        f"{b.quantity} {number(result.outcome.values[b.quantity])}, not {b.relation} {number(b.limit)}"
        for b in case.bounds
        if b.quantity in result.failed
    ]
    return f"FAILS {'; '.join(faults)} ({result.seconds:.0f} s)"
