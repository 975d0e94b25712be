"""Runs cases, one after the other or some at once; the error of one is its result, not the end of others."""

import sys
import time as clock
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
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
    jobs: int = 1,
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
    jobs : int
        How many cases of the registry run at once, each in a process of its own; 1 (default) in this one.
    """
    out = stream or sys.stdout
    heads = {
        case.name: f"[{i:{len(str(len(cases)))}d}/{len(cases)}] {case.name}"
        for i, case in enumerate(cases, 1)
    }
    results = {case.name: result for case in cases if (result := known(case)) is not None}
    for case in cases:
        if case.name in results:
            print(
                f"{heads[case.name]}: {describe(case, results[case.name])}; measured earlier",
                file=out,
                flush=True,
            )
    new = [case for case in cases if case.name not in results]
    began = clock.perf_counter()

    def starts(case: Case) -> None:
        print(f"{heads[case.name]} ...", file=out, flush=True)

    for fresh, (case, result) in enumerate(_completed(new, version, jobs, starts), 1):
        keep(result)
        results[case.name] = result
        left = (clock.perf_counter() - began) / fresh * (len(new) - fresh)
        print(f"{heads[case.name]}: {describe(case, result)}; about {left:.0f} s left", file=out, flush=True)
    return [results[case.name] for case in cases]


def _completed(
    cases: Sequence[Case], version: str, jobs: int, starts: Callable[[Case], None]
) -> Iterator[tuple[Case, Result]]:
    """Cases with their results, as they come."""
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
    """The result of a case of the registry, as JSON."""
    from tests.verification.registry import all_cases

    return run_case(next(case for case in all_cases() if case.name == name), version).to_json()


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
