"""The commands ``ngvisco gradient`` and ``ngvisco fit``: derivatives with respect to numbers of a case, and
fits to data."""

import argparse
import shlex
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from ngsolve import SetNumThreads

from ngvisco import case as cases
from ngvisco.case.build import Case, samples
from ngvisco.case.section import given
from ngvisco.case.units import factor, key_and_unit_of
from ngvisco.cli import streams
from ngvisco.cli.streams import DONE, Stopping, stopped
from ngvisco.errors import CheckpointError, ParameterError, StopRequested, UnknownNameError, listed, nearest
from ngvisco.run.files import csv_text, write_atomically
from ngvisco.run.simulation import Simulation
from ngvisco.sensitivity.data import number_in
from ngvisco.sensitivity.fit import Fit
from ngvisco.sensitivity.fit import fit as fitted
from ngvisco.sensitivity.gradient import gradient as differentiated
from ngvisco.sensitivity.parameters import PART, Named

RESTART = "restart"
"""Folder in the output from which an interrupted command goes on; a finished command removes the folder."""
Computed = TypeVar("Computed")


def gradient(options: argparse.Namespace) -> int:
    """Differentiate results of a case with respect to some of its numbers, and write the derivatives."""
    case, simulation = _simulation(options)
    out = _directory(options, "gradient.csv", "gradient")

    def tell(number: int, total: int) -> None:
        if not options.quiet and (number == total or number % max(total // 10, 1) == 0):
            streams.write(f"differentiated {number} of {total} steps\n")

    given = {"of": options.of, "by": options.by, "method": options.method, "progress": tell}
    result, code = _stoppable(differentiated, simulation, case.until, **given, restart=out / RESTART)
    if result is None:
        return code
    numbers = np.column_stack([result.values, result.jacobian])
    _write(out / "gradient.csv", ["number", "value", *result.by], result.of, numbers)
    shutil.rmtree(out / RESTART)
    streams.write(f"{result}\nAll numbers are in SI units.\n")
    if result.limited:
        limited = f"the limiter changed the state of a cell {result.limited} time{'s' * (result.limited > 1)}"
        streams.write(f"{limited}; the derivatives treat these changes as constant\n")
    streams.write(f"{out / 'gradient.csv'}\n")
    return code


def fit(options: argparse.Namespace) -> int:
    """Fit some of a case's numbers to data, and write report, table and picture."""
    case, simulation = _simulation(options)
    out = _directory(options, "fit.txt", "fit")
    result, code = _stoppable(
        fitted,
        simulation,
        options.data,
        by=options.by,
        sigma=_sigma(options.sigma),
        bounds=dict(_bounds(text, case) for text in options.bounds),
        until=case.until,
        factor=factor,
        progress=None if options.quiet else lambda line: streams.write(line + "\n"),
        restart=out / RESTART,
    )
    if result is None:
        return code
    report = f"{result}\nAll numbers are in SI units. {_best_run(options, case, result)}\n"
    (out / "fit.txt").write_text(report)
    numbers = np.column_stack([result.start, result.values, result.deviations, result.covariance])
    head = ["parameter", "start", "value", "deviation", *(f"covariance {name}" for name in result.by)]
    _write(out / "fit.csv", head, result.by, numbers)
    result.plot(out / f"fit.{options.format}")
    shutil.rmtree(out / RESTART)
    streams.write(
        report + "".join(f"{out / name}\n" for name in ("fit.txt", "fit.csv", f"fit.{options.format}"))
    )
    return code


def _stoppable(
    compute: Callable[..., Computed], simulation: Simulation, *arguments: Any, **options: Any
) -> tuple[Computed | None, int]:
    """The result of ``compute`` for a simulation, or None if a signal stopped it, and the exit code."""
    with Stopping(simulation.request_stop) as signals:
        try:
            return compute(simulation, *arguments, **options), DONE
        except CheckpointError as error:
            raise CheckpointError(f"{error}; with --force the command begins anew") from error
        except StopRequested:
            return None, stopped(signals.received, "; a repeated command goes on")


def _simulation(options: argparse.Namespace) -> tuple[Case, Simulation]:
    """The case, and its simulation at the start with tables that are not written to files."""
    SetNumThreads(options.threads)
    case = cases.load_case(options.case, options.settings)
    if case.refinement is not None:
        expected = "no such table, since a run with a changing mesh has no derivatives"
        raise ParameterError("domain.adapt", case.refinement, expected)
    tables = list(samples(case.sections, Path()).values())
    for table in tables:
        table.path = None
    simulation = case.simulation(case.mesh(), tables)
    case.check_end(simulation)
    _require_keys(options.by, case, simulation)
    return case, simulation


def _require_keys(names: list[str], case: Case, simulation: Simulation) -> None:
    """Raise an error unless each name belongs to a number of the run.

    The error is a ParameterError, or an UnknownNameError for a name that is no key of the case.
    """
    for name in names:
        try:
            Named.of(name, simulation)
        except UnknownNameError as error:
            if error.kind == PART:
                keys = sorted(key_and_unit_of(part, case.sections)[0] for part in error.known)
                hint = nearest(name, keys)
                raise ParameterError("by", name, f"the key of a number in {listed(keys)}", hint) from None
            if given(case.sections, tuple(name.split("."))) is None:
                raise
            instead = f"; the run has no parameter {error.name!r}, but has {listed(error.known)}"
            expected = f"the key of a number that is a parameter of the run{instead if error.known else ''}"
            raise ParameterError("by", name, expected) from None


def _directory(options: argparse.Namespace, name: str, kind: str) -> Path:
    out = Path(options.output or Path("results") / f"{Path(options.case).stem}-{kind}")
    if (out / name).exists() and not options.force:
        raise ParameterError("-o", str(out), f"a directory without {name}, or the option --force")
    if options.force:
        shutil.rmtree(out / RESTART, ignore_errors=True)
    return out


def _sigma(text: str | None) -> float | dict[str, float] | None:
    """Convert the argument of ``--sigma``, as in ``--sigma 0.1`` or ``--sigma
    kinetic=0.1,tip.velocity_1=0.02``."""
    if text is None or (number := number_in(text)) is not None:
        return None if text is None else number
    deviations = {}
    for part in text.split(","):
        name, equals, value = part.rpartition("=")
        if not equals or (number := number_in(value)) is None:
            raise ParameterError("--sigma", text, "a number, or items COLUMN=NUMBER separated by commas")
        deviations[name.strip()] = number
    return deviations


def _best_run(options: argparse.Namespace, case: Case, result: Fit) -> str:
    """The command that runs the case with the fitted values, each with its unit. If the case cannot take a
    value, the text says why: some numbers of a run, such as those of the branches of a Prony series, have no
    key in the case."""
    settings = list(options.settings)
    values = [f"{value:.10g}" for value in result.values]
    keys = [key_and_unit_of(name, case.sections)[0] for name in result.by]
    fitted = {key: float(value) for key, value in zip(keys, values, strict=True)}
    for name, value in zip(result.by, values, strict=True):
        key, unit = key_and_unit_of(name, case.sections, fitted)
        settings.append(f"{key}={value} {unit}".rstrip())
    try:
        cases.load_case(options.case, settings)
    except cases.CaseError as error:
        return f"The case cannot take these values: {error}"
    words = ["ngvisco", "run", options.case, *(word for text in settings for word in ("--set", text))]
    return f"The case with these values:\n{shlex.join(map(str, words))}"


def _bounds(text: str, case: Case) -> tuple[str, tuple[float, float]]:
    """The name and the bounds, in SI units, of a parameter; ``text`` has numbers in the case's units."""
    name, _, value = text.partition("=")
    _, unit = key_and_unit_of(name.strip(), case.sections)
    try:
        low, high = (case.units.number(part.strip(), unit or "1") for part in value.split(","))
    except ValueError as error:  # a wrong unit, and a wrong number of values
        expected = "KEY=LOW,HIGH: two numbers in the case's units, or with units as in KEY=10 kPa,1 MPa"
        raise ParameterError("--bounds", text, f"{expected} ({error})") from None
    return name.strip(), (low, high)


def _write(path: Path, head: Sequence[str], names: Sequence[str], numbers: np.ndarray) -> None:
    """Write a CSV file with a row of ``numbers`` for each name."""
    rows = [[name, *row] for name, row in zip(names, numbers.tolist(), strict=True)]
    write_atomically(path, csv_text([head, *rows]).encode())
