"""Observers of a run: progress as lines or in a notebook, the ledger as CSV, the VTK series."""

from __future__ import annotations

import contextlib
import math
import statistics
import sys
import time as clock
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, TextIO

from ngvisco.errors import (
    Declared,
    ParameterError,
    Quantity,
    as_numbers,
    require_file,
    require_known,
    require_numbers,
    require_path,
    require_some_names,
)
from ngvisco.forms.distance import NUMERICAL
from ngvisco.run.fields import CONTINUOUS, usual, with_outlines
from ngvisco.run.files import AnyPath, append, csv_text, write_atomically
from ngvisco.run.notebook import NotebookError
from ngvisco.run.vtu import StateFiles, shown_by, write_vtu

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation
    from ngvisco.run.stepping import Rejection


DEAR = 10.0
"""A progress line gives a step's seconds if the step took more than this number of medians of earlier
steps."""
_STEPS_BEFORE, _NOTICED = 5, 0.1
"""Least number of steps for a median, and least number of seconds that a progress line gives."""


class Progress:
    """Prints a line for a step: time, energy, closure, Newton iterations, and remaining time.

    The line also gives the seconds of a step that took ten times the median of earlier steps.
    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    until : float
        End time of the run, s, for the estimate of the remaining time.
    every : int
        Number of steps from one line to the next; the last step has a line too.
    stream : text stream, optional
        Stream of the lines; default ``sys.stdout``.
    """

    on_first_rank = True

    def __init__(self, until: float, every: int = 1, stream: TextIO | None = None) -> None:
        require_numbers("Progress", ">= 1", int, every=every)
        require_numbers("Progress", "> 0", float, until=until)
        if not (stream is None or hasattr(stream, "write")):
            raise ParameterError("Progress.stream", stream, "an open text file, or None")
        self.until, self.every, self.stream = float(until), int(every), stream
        self._last = ""

    def _set_out(self, simulation: Simulation) -> None:
        self._began, self._from = clock.perf_counter(), simulation.t
        self._lap, self._costs, self._dear = self._began, list[float](), ""

    def _timed(self) -> None:
        """Record the seconds since the end of the last step; the step's line has them if they are many."""
        now = clock.perf_counter()
        cost, self._lap = now - self._lap, now
        usual = statistics.median(self._costs) if len(self._costs) >= _STEPS_BEFORE else math.inf
        self._costs.append(cost)
        if cost > DEAR * usual and cost > _NOTICED:
            self._dear = f"took {cost:.3g} s, {cost / usual:.0f} times the median  "

    def _left(self, simulation: Simulation) -> str:
        """The remaining time in words; "" before the first step."""
        left, covered = max(self.until - simulation.t, 0.0), simulation.t - self._from
        spent = clock.perf_counter() - self._began
        return f"{spent * left / covered:.0f} s left" if covered > 0 else ""

    def _is_at_end(self, simulation: Simulation) -> bool:
        return simulation.t >= self.until * (1 - 1e-9)

    def start(self, simulation: Simulation) -> None:
        self._set_out(simulation)
        self._total, steps = "", "adaptive steps"
        if not simulation.is_adaptive:
            # earlier steps may have had other lengths
            count = simulation.stepper.step_of(self.until, simulation.number)[0]
            done = simulation.step_number
            steps = f"{count - done if done else count} steps of {simulation.dt:g} s"
            self._total = f"/{count}"
        line = f"{simulation.cells} cells, {simulation.unknowns} unknowns, {steps}, {simulation.scheme}"
        # a run whose mesh follows a field starts anew on each mesh, and would print its first line again
        if line != self._last:
            self._print(line)
        self._last = line

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        self._timed()
        if not (simulation.is_due(self.every) or self._is_at_end(simulation)):
            return
        dear, self._dear = self._dear, ""
        self._print(
            f"step {simulation.step_number:5d}{self._total}  t {row['time']:.4g} s  "
            f"kinetic {row['kinetic']:.4e}  stored {row['stored']:.6e} J  "
            f"closure {row['closure_relative']:+.0e}  Newton {row['newton_iterations']:2.0f}  "
            f"{limited_in_words(row)}{dear}{self._left(simulation)}"
        )

    def rejected(self, simulation: Simulation, rejection: Rejection) -> None:
        """Print a line for a rejected step."""
        self._print(
            f"step {simulation.step_under_way:5d}{self._total}  t {rejection.time:.4g} s  rejected "
            f"dt {rejection.tau:.4g} s: {rejection.reason}"
        )

    def finish(self, simulation: Simulation) -> None:
        is_at_end = self._is_at_end(simulation)
        if not (is_at_end or simulation.stop_requested):  # the run continues, for instance on another mesh
            return
        word = "finished" if is_at_end else "stopped"
        self._print(f"{word} at t = {simulation.t:g} s after {steps_in_words(simulation)}")
        if (advice := dissipation_advice(simulation)) is not None:
            self._print(advice)

    def _print(self, line: str) -> None:
        # a closed pipe, or a terminal that cannot show a letter, does not end a run
        with contextlib.suppress(OSError, ValueError):
            print(line, file=self.stream or sys.stdout, flush=True)


class NotebookProgress(Progress):
    """Redraws progress below a notebook's cell: a bar, the time, the energies, the closure.

    Raises NotebookError when IPython is missing.

    Parameters
    ----------
    until : float
        End time of the run, s.
    seconds : float
        Least time between two drawings, s.
    """

    def __init__(self, until: float, seconds: float = 0.5) -> None:
        super().__init__(until)
        self.seconds = seconds
        try:
            import IPython.display as display
        except ImportError as error:
            raise NotebookError("IPython is missing; run pip install ipython") from error
        self._display: Any = display

    def start(self, simulation: Simulation) -> None:
        self._set_out(simulation)
        self._drawn = clock.perf_counter() - self.seconds
        self._handle = self._display.display(self._page(simulation), display_id=True)

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        if clock.perf_counter() - self._drawn >= self.seconds:
            self._drawn = clock.perf_counter()
            self.finish(simulation)

    def rejected(self, simulation: Simulation, rejection: Rejection) -> None:
        """Ignore rejected steps: they are not drawn."""

    def finish(self, simulation: Simulation) -> None:
        if self._handle is not None:  # there is no handle outside of a notebook
            self._handle.update(self._page(simulation))

    def _page(self, simulation: Simulation) -> Any:
        share, left = min(1.0, simulation.t / self.until), self._left(simulation) or "starting"
        bar = (
            '<div style="width:420px;border:1px solid #888;height:10px">'
            f'<div style="width:{100 * share:.1f}%;background:#31688e;height:10px"></div></div>'
        )
        line = f"<div>step {simulation.step_number}, {left}</div>"
        return self._display.HTML(bar + line + simulation.ledger._repr_html_())


def steps_in_words(simulation: Simulation) -> str:
    """The number of steps in words, with the number of their parts if some steps were halved."""
    steps, rows = simulation.step_number, simulation.number
    return f"{steps} step{'s' * (steps != 1)}" + (f" in {rows} parts" if steps != rows else "")


def limited_in_words(row: dict[str, float]) -> str:
    """The number of cells that the limiter changed, in words; empty for none."""
    cells = row["limited_cells"]
    return f"limited {cells:.0f} cell{'s' if cells > 1 else ''}  " if cells else ""


class LedgerCSV:
    """Writes the ledger as CSV: a header, then a row a step, flushed at every step.

    A resumed run first rewrites the file with the rows up to its checkpoint, which removes later rows.
    Raises ParameterError if a parameter is out of its range.
    """

    on_first_rank = True

    def __init__(self, path: AnyPath) -> None:
        self.path = require_file("LedgerCSV.path", path)

    def start(self, simulation: Simulation) -> None:
        columns = simulation.ledger.columns
        rows = ([row[name] for name in columns] for row in simulation.ledger.rows)
        write_atomically(self.path, csv_text([columns, *rows]).encode())

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        append(self.path, csv_text([[row[name] for name in simulation.ledger.columns]]))

    def finish(self, simulation: Simulation) -> None:
        """Do nothing, because all rows have been written."""


SUBDIVISION = Declared("from 0 to 4", (int,))
"""Number of bisections of a cell in a file."""


class VTKSeries:
    """Writes a series of .vtu files and the .pvd that ParaView opens.

    By default the files have velocity, density, the material's variables, Cauchy stress, pressure and von
    Mises stress, with labelled components; vectors are padded to three components.  Fractions of bodies, by
    which movies and scenes outline bodies, are always written.  Each cell has its own points, because fields
    may jump between cells; in a series of ``velocity`` alone cells share points.  A resumed run drops the
    state that the interrupted run wrote out of turn when it stopped.  The first and the last state have files
    too; with ``every=None`` all other files are at ``times``.  Raises ParameterError if a parameter is out of
    its range.

    Parameters
    ----------
    directory : path
        Directory of the files, made if missing.
    every : int
        A file every so many steps.
    fields : sequence of str, optional
        Names of fields; default all but creep_rate, mandel_stress, viscous_stress, hyperstress_1 (to 3),
        principal_stresses, principal_stretches.
    subdivision : int
        Bisections of cells in the files; each piece has linear fields.
    times : sequence of float
        Further times at which to write, s; pass them as ``stops`` to ``Simulation.run`` too.
    """

    def __init__(
        self,
        directory: AnyPath,
        every: Annotated[int | None, Quantity("1", ">= 1")] = 1,
        fields: Annotated[Sequence[str] | None, Quantity(example=["velocity", "density"])] = None,
        subdivision: Annotated[int, Quantity("1", SUBDIVISION.range)] = 0,
        times: Sequence[float] = (),
    ) -> None:
        if every is not None:
            require_numbers("VTKSeries", ">= 1", int, every=every)
        self.directory, self.every = require_path("VTKSeries.directory", directory), every
        if self.directory.exists() and not self.directory.is_dir():
            expected = "a directory, but this path is a file"
            raise ParameterError("VTKSeries.directory", str(directory), expected)
        self.times = as_numbers("VTKSeries.times", times, "a sequence of finite numbers, in s")
        self.names = None if fields is None else require_some_names("VTKSeries.fields", fields)
        self.subdivision = SUBDIVISION.taken("VTKSeries.subdivision", subdivision)
        self.files = StateFiles(self.directory, "fields")

    def prepare(self, simulation: Simulation) -> None:
        """Raise UnknownNameError for the name of a field that the simulation does not have."""
        require_known("field", self.names or (), simulation.fields, "VTKSeries.fields")

    def start(self, simulation: Simulation) -> None:
        self.prepare(simulation)
        available = simulation.fields
        names = with_outlines(self.names or list(usual(available)), available)
        self._fields = {name: available[name] for name in names}
        self.files.begin(simulation.t * (1 - 1e-12) if simulation.number else None, simulation.ranks)
        if simulation.number == 0 or self._is_due(simulation):
            self._write(simulation)

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        if self._is_due(simulation):
            self._write(simulation)

    def _is_due(self, simulation: Simulation) -> bool:
        on_time = any(abs(simulation.t - time) <= 1e-9 * time for time in self.times)
        return on_time or (self.every is not None and simulation.is_due(self.every))

    def finish(self, simulation: Simulation) -> None:
        if not self.files.written or self.files.written[-1][0] != simulation.t:
            self._write(simulation)

    def _write(self, simulation: Simulation) -> None:
        path = self.files.path(simulation.number)
        write_vtu(path, simulation.mesh, self._fields, self.subdivision, {*self._fields} <= CONTINUOUS)
        self.files.add(simulation.t, shown_by(path, simulation.ranks).name, simulation.ranks)


NEGLIGIBLE = 1e-3
"""Share of the energy available for motion, below which the scheme's dissipation is negligible."""


def dissipation_advice(simulation: Simulation) -> str | None:
    """A sentence of advice if the scheme's own dissipation exceeds the model's, else None.

    There is no advice if the scheme's dissipation is negligible beside the energy available for motion: the
    largest kinetic energy, or the largest change of the stored energy since the start if this is larger, plus
    the work of loads and walls.
    """
    ledger, scheme = simulation.ledger, simulation.scheme
    if len(ledger.rows) < 2:
        return None

    def total(kind: str) -> float:
        return float(ledger.exchanged(*(entry.name for entry in ledger.entries if entry.kind == kind))[-1])

    # this dissipation does not include the energy lost in a transfer to another mesh
    numerical = float(ledger.exchanged(*NUMERICAL)[-1])
    physical, stored = total("dissipation"), ledger.column("stored")
    moved = max(ledger.column("kinetic").max(), abs(stored - stored[0]).max()) + abs(total("power"))
    # in a body at rest the dissipation is rounding of the stored energy
    if numerical <= max(physical, NEGLIGIBLE * moved, len(stored) * math.ulp(abs(stored).max())):
        return None
    remedy = "take a smaller dt"
    if scheme.order == 1:
        remedy = (
            "take scheme = 'midpoint' (second order, one solve a step), or 'sdirk2' if stiff parts have to "
            "be damped, or a much smaller dt"
        )
    sentence = (
        f"the time scheme {scheme.name} dissipated {numerical:.3g} J, but the model only {physical:.3g} J"
    )
    return f"{sentence}; {remedy}"
