"""A run with the usual files and pictures in one call, for demos and short scripts."""

from collections.abc import Mapping

from ngvisco.errors import ParameterError, as_number, require_path, require_type
from ngvisco.expressions import parse
from ngvisco.run.body_tables import Bodies
from ngvisco.run.checkpoint import Checkpoints
from ngvisco.run.fields import components
from ngvisco.run.files import AnyPath
from ngvisco.run.frames import outlined
from ngvisco.run.ledger import Ledger
from ngvisco.run.observers import LedgerCSV, Progress, VTKSeries
from ngvisco.run.pictures import figure, plot_fields
from ngvisco.run.plots import plot_energies
from ngvisco.run.simulation import Observer, Simulation


def record(
    simulation: Simulation,
    directory: AnyPath,
    until: float,
    *,
    every: int = 5,
    checkpoints: int = 25,
    show: Mapping[str, str] | None = None,
) -> Ledger:
    """Run until ``until`` with progress on the terminal, and write files and pictures to ``directory``.

    The files are ``ledger.csv``, the VTK series ``vtk/fields.pvd``, ``run.h5`` with ledger and checkpoints,
    for a model with bodies ``bodies.csv``, and with the extra ``plots`` ``energies.png`` and ``fields.png``,
    the latter of the state at the end.  The simulation's own observers see the same run.  Raises
    ParameterError or ExpressionError for a bad argument or expression, and PlotError if matplotlib is
    missing, before anything is computed; StepError as ``Simulation.run``.

    Parameters
    ----------
    until : float
        End of the run, s.
    every : int
        Number of steps between states of the VTK series.
    checkpoints : int
        Number of steps between checkpoints.
    show : mapping of titles to expressions, optional
        Content of ``fields.png`` in names of ``simulation.fields`` and their components:
        ``{"speed, m/s": "sqrt(velocity_1**2 + velocity_2**2)"}``.  By default there is no such picture.
    """
    require_type("record.simulation", simulation, Simulation)
    out = require_path("record.directory", directory)
    if (end := as_number(until)) is None or end <= simulation.t:
        raise ParameterError("record.until", until, f"a finite number > {simulation.t:g}")
    names = tuple(components(simulation.fields))
    pictures = {title: parse(text, names) for title, text in (show or {}).items()}
    figure(1, 1, (1.0, 1.0))  # if matplotlib is missing, the run fails now, not at its end
    tables = Progress(end), LedgerCSV(out / "ledger.csv")
    states = VTKSeries(out / "vtk", every=every), Checkpoints(out / "run.h5", every=checkpoints)
    files: list[Observer] = [*tables, *states]
    if simulation.model.bodies and not any(isinstance(observer, Bodies) for observer in simulation.observers):
        files.insert(-1, Bodies(out / "bodies.csv"))
    before = list(simulation.observers)
    simulation.observers += files
    try:
        ledger = simulation.run(end)
    finally:
        simulation.observers[:] = before
    plot_energies(ledger, out / "energies.png")
    if pictures:
        scalars = components(simulation.fields)
        shown = [(title, picture.coefficient(scalars)) for title, picture in pictures.items()]
        fields = simulation.fields
        lines = [fields[name] for name in outlined(list(fields))]
        plot_fields(simulation.mesh, shown, out / "fields.png", outlines=lines)
    print(f"largest |closure| {abs(ledger.column('closure_relative')).max():.1e}; results in {out}")
    return ledger
