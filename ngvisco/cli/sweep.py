"""``ngvisco sweep``: a case with some of its keys varied."""

import argparse
import signal
import threading
from pathlib import Path

from ngsolve import SetNumThreads

from ngvisco.cli import streams
from ngvisco.cli.signals import Stopping
from ngvisco.cli.streams import DONE, FAILED, NOT_CLOSED
from ngvisco.sweep.study import Study
from ngvisco.sweep.table import Outcome
from ngvisco.sweep.variations import Variation


def sweep(options: argparse.Namespace) -> int:
    """Run a study; a line for each run that ends."""
    SetNumThreads(1)
    variations = [Variation.parse(text) for text in options.vary]
    directory = Path(options.output or Path("results") / f"{Path(options.case).stem}-sweep")
    study = Study(options.case, variations, directory, settings=options.settings, force=options.force)
    before = len(study.outcomes) - len(study.unfinished)
    ended = before

    def report(outcome: Outcome) -> None:
        nonlocal ended
        ended += 1
        if not options.quiet:
            streams.write(f"[{ended}/{len(study.outcomes)}] {_line(outcome)}\n")

    if not options.quiet:
        finished = f", {before} of them finished before" if before else ""
        streams.write(f"{len(study.outcomes)} runs{finished}\n")
    stop = threading.Event()
    with Stopping(stop.set) as signals:
        outcomes = study.run(
            workers=options.workers,
            threads=options.threads,
            scheduler=options.scheduler,
            report=report,
            stop=stop,
        )
    return _close(study, outcomes, signals.received)


def _line(outcome: Outcome) -> str:
    reached = f", t = {outcome.last['time']:.4g} s" if outcome.last else ""
    closure = f", largest |closure| {outcome.last['largest_closure']:.1e}" if outcome.is_finished else ""
    reason = f": {outcome.message}" if outcome.message else ""
    return f"{outcome.name}: {outcome.state}{reached}{closure}{reason}"


def _close(study: Study, outcomes: list[Outcome], received: int) -> int:
    missing = [outcome for outcome in outcomes if not outcome.is_finished]
    streams.write(f"finished: {len(outcomes) - len(missing)} of {len(outcomes)} runs; table {study.table}\n")
    if received:
        name = signal.Signals(received).name
        streams.write(f"{name}: stopped, with checkpoints; the same command goes on\n")
        return 128 + received
    for outcome in missing:
        streams.complain(_line(outcome))
    if missing:
        return FAILED
    open_ledgers = [outcome for outcome in outcomes if outcome.state == "not closed"]
    for outcome in open_ledgers:
        streams.complain(f"{outcome.name}: the ledger does not close")
    return NOT_CLOSED if open_ledgers else DONE
