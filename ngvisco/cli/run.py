"""The commands ``ngvisco run``, ``resume`` and ``sweep``, with progress on the terminal and signals."""

import argparse
import math
import os
import shutil
import signal
import sys
import threading
from pathlib import Path

from ngsolve import SetNumThreads

from ngvisco import case as cases
from ngvisco.case.units import SI, Converter, UnitError
from ngvisco.cli import streams
from ngvisco.cli.streams import DONE, FAILED, NOT_CLOSED, Stopping, stopped
from ngvisco.errors import ParameterError
from ngvisco.run.observers import Progress, dissipation_advice, limited_in_words, steps_in_words
from ngvisco.run.simulation import Observer, Simulation
from ngvisco.run.stepping import Rejection
from ngvisco.sweep import Outcome, Study, Variation


class StopOnSignal(Stopping, Observer):
    """Ends a run on a signal, between two iterations of a step."""

    def __init__(self) -> None:
        super().__init__(lambda: None)

    def start(self, simulation: Simulation) -> None:
        self.stop = simulation.request_stop
        self.__enter__()

    def finish(self, simulation: Simulation) -> None:
        self.__exit__()


class ProgressBar(Progress):
    """Redraws one line with time, step, energy, closure and remaining time."""

    def start(self, simulation: Simulation) -> None:
        self._set_out(simulation)
        self._draw(simulation, simulation.ledger.rows[-1])

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        self._timed()
        if self._dear:
            streams.write(f"\r\x1b[Kstep {simulation.step_number} {self._dear.strip()}\n")
            self._dear = ""
        self._draw(simulation, row)

    def rejected(self, simulation: Simulation, rejection: Rejection) -> None:
        """Print a line about the rejected step above the bar."""
        streams.write(
            f"\r\x1b[Krejected dt {rejection.tau:.4g} s at t {rejection.time:.4g} s: {rejection.reason}\n"
        )

    def finish(self, simulation: Simulation) -> None:
        if simulation.stop_requested or simulation.t >= self.until * (1 - 1e-9):
            advice = dissipation_advice(simulation)
            streams.write("\n" if advice is None else f"\n{advice}\n")

    def _draw(self, simulation: Simulation, row: dict[str, float]) -> None:
        done, left = simulation.t / self.until, self._left(simulation)
        energy = row["kinetic"] + row["stored"]
        text = (
            f" t {simulation.t:.4g}/{self.until:.4g} s  step {simulation.step_number}  "
            f"energy {energy:.6e} J  "
            f"closure {row['closure_relative']:+.0e}  {limited_in_words(row)}{left or 'starting'}"
        )
        width = max(4, shutil.get_terminal_size().columns - len(text) - 3)
        filled = min(width, round(width * done))
        bar = f"[{'#' * filled}{'.' * (width - filled)}]"
        streams.write(f"\r\x1b[K{bar}{text}")


def run(options: argparse.Namespace) -> int:
    """Run a case, and print how it ended."""
    _end_with_stdin(options)
    SetNumThreads(options.threads)
    case = cases.load_case(options.case, options.settings)
    directory = Path(options.output or Path("results") / Path(options.case).stem)
    stop = StopOnSignal()
    observers = [*_terminal(options, case.until), stop]
    result = cases.run(case, directory, force=options.force, observers=observers, source=options.source)
    return _close(directory, result, stop)


def resume(options: argparse.Namespace) -> int:
    """Continue a run from its last checkpoint."""
    _end_with_stdin(options)
    SetNumThreads(options.threads)
    directory, stop = Path(options.directory), StopOnSignal()
    end = None if options.until is None else _end_time(options.until)
    observers = [*_terminal(options, end or 1.0), stop]  # the resumed run sets their end
    try:
        result = cases.resume(directory, end, observers=observers, settings=options.settings)
    except cases.CaseError as error:
        if end is not None and any(fault.key.startswith("time.until") for fault in error.faults):
            error.add_note(
                "--until does not change the case's time.until; set it too, by --set time.until=..."
            )
        raise
    return _close(directory, result, stop)


def _end_time(text: str) -> float:
    """Convert the argument of ``--until`` to s; raises ParameterError."""
    try:
        until = Converter(None).number(text, SI["time"])
    except UnitError as error:
        expected = f"a time > 0 in s, or with a unit, as in '140 kyr' ({error})"
        raise ParameterError("--until", text, expected) from None
    if not 0 < until < math.inf:
        raise ParameterError("--until", text, "a finite time > 0, in s or with a unit, as in '140 kyr'")
    return until


def _end_with_stdin(options: argparse.Namespace) -> None:
    """Stop as on SIGTERM when standard input closes: the process that started this one has then ended."""
    if not options.ends_with_stdin:
        return

    def wait() -> None:
        # not sys.stdin: a thread waiting for it would hold its lock when Python ends
        while os.read(0, 1024):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, daemon=True).start()


def _terminal(options: argparse.Namespace, until: float) -> list[Observer]:
    shown = ProgressBar if sys.stdout.isatty() else Progress
    return [] if options.quiet else [shown(until)]


def _close(directory: Path, result: Simulation, stop: StopOnSignal) -> int:
    if message := result.ledger.unclosed:
        streams.complain(message)
    received = int(result.ranks.most(stop.received))  # the signal may have reached one rank only
    if received:
        after = f" after step {result.step_number}, t = {result.t:g} s; a checkpoint is written"
        return stopped(received, f"{after}\ngo on with: ngvisco resume {directory}")
    closure = abs(result.ledger.column("closure_relative")).max()
    streams.write(
        f"finished: t = {result.t:g} s after {steps_in_words(result)}; largest |closure| {closure:.1e}\n"
        "(closure: the residual of a step's energy balance over the energy; rounding is 1e-14)\n"
        f"results in {directory}\n"
    )
    return NOT_CLOSED if message else DONE


def sweep(options: argparse.Namespace) -> int:
    """Run a study, and print a line for each finished run."""
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
    return _close_study(study, outcomes, signals.received)


def _line(outcome: Outcome) -> str:
    reached = f", t = {outcome.last['time']:.4g} s" if outcome.last else ""
    closure = f", largest |closure| {outcome.last['largest_closure']:.1e}" if outcome.is_finished else ""
    reason = f": {outcome.message}" if outcome.message else ""
    return f"{outcome.name}: {outcome.state}{reached}{closure}{reason}"


def _close_study(study: Study, outcomes: list[Outcome], received: int) -> int:
    missing = [outcome for outcome in outcomes if not outcome.is_finished]
    streams.write(f"finished: {len(outcomes) - len(missing)} of {len(outcomes)} runs; table {study.table}\n")
    if received:
        return stopped(received, ", with checkpoints; the same command goes on")
    for outcome in missing:
        streams.complain(_line(outcome))
    if missing:
        return FAILED
    open_ledgers = [outcome for outcome in outcomes if outcome.state == "not closed"]
    for outcome in open_ledgers:
        streams.complain(f"{outcome.name}: the ledger does not close")
    return NOT_CLOSED if open_ledgers else DONE
