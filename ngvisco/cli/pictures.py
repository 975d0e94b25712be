"""``ngvisco plot`` and ``ngvisco scene``: what a run looks like."""

import argparse
import sys
from pathlib import Path

from ngsolve import CoefficientFunction, SetNumThreads

from ngvisco import case as cases
from ngvisco.case.directory import RunDirectory
from ngvisco.case.runs import Results
from ngvisco.errors import ParameterError
from ngvisco.run.comparison import plot_comparison
from ngvisco.run.fields import scalar_fields, title_of
from ngvisco.run.movie import write_movie
from ngvisco.run.outlines import outlined
from ngvisco.run.plots import Section, plot_energies, plot_fields, plot_history, require_space, titled
from ngvisco.run.scene import write_scene, write_scene_of_series
from ngvisco.run.vtu import read_pvd
from ngvisco.sweep.study import read_table


def plot(options: argparse.Namespace) -> int:
    """Energies, history and fields as pictures into the run directory, an animation, or a comparison."""
    runs = _runs(options)
    if len(runs) > 1:
        return _compare(options, runs)
    ((_, options.directory),) = runs.items()
    out = Path(options.directory)
    section = None if options.section is None else Section.parse(options.section)
    if options.movie is not None:
        place, names = RunDirectory(out), _names(options)
        path = Path(options.movie) if options.movie else out / "movie.gif"
        title = place.case().sections.title
        write_movie(place.vtk, path, names, section=section, frames_per_second=options.fps, title=title)
        _say_without_outlines(place)
        print(path)
        return 0
    results, chosen = _load(options)
    require_space(section, results.mesh.dim)  # before anything is drawn
    ledger = results.simulation.ledger
    written = [out / f"{name}.{options.format}" for name in ("energies", "history", "fields")]
    plot_energies(ledger, written[0])
    plot_history(ledger, written[1])
    fields = [(title_of(name), value) for name, value in chosen.items()]
    title = titled(results.case.sections.title, results.time)
    lines = _outlines(results)
    plot_fields(results.mesh, fields, written[2], section=section, title=title, outlines=lines)
    for path in written:
        print(path)
    return 0


def _runs(options: argparse.Namespace) -> dict[str, Path]:
    """Run directories by label: those that are named, or those of a study."""
    places = [Path(text) for text in options.directory]
    if len(places) == 1 and (places[0] / "sweep.csv").exists():
        names = [outcome.name for outcome in read_table(places[0] / "sweep.csv")]
        done = {name: places[0] / name for name in names if (places[0] / name / "run.h5").exists()}
        if not done:
            raise ParameterError("plot", str(places[0]), "a study with runs that made a step")
        return done
    return {str(place): place for place in places}


def _compare(options: argparse.Namespace, runs: dict[str, Path]) -> int:
    for name in ("movie", "section", "step"):
        if (value := getattr(options, name)) is not None:
            raise ParameterError(f"plot --{name}", value, "one run directory; several are compared over time")
    study = len(options.directory) == 1
    out = Path(options.output or (options.directory[0] if study else "."))
    for path in plot_comparison(runs, out, _names(options), options.format):
        print(path)
    return 0


def scene(options: argparse.Namespace) -> int:
    """The states of the VTK series, or one checkpoint, as one HTML file in the run directory."""
    place = RunDirectory(options.directory)
    path, names, title = place.path / "scene.html", _names(options), place.case().sections.title or "ngvisco"
    if options.step is None and read_pvd(place.vtk / "fields.pvd"):
        write_scene_of_series(place.vtk, path, names, title)
        _say_without_outlines(place)
    else:
        results, chosen = _load(options)
        title = titled(title, results.time)
        write_scene(results.mesh, chosen, path, title, outlines=_outlines(results))
    print(path)
    return 0


def _load(options: argparse.Namespace) -> tuple[Results, dict[str, CoefficientFunction]]:
    SetNumThreads(1)
    results = cases.load(options.directory, options.step)
    return results, scalar_fields(results.fields, _names(options))


def _outlines(results: Results) -> list[CoefficientFunction]:
    fields = results.fields
    return [fields[name] for name in outlined(list(fields))]


def _say_without_outlines(place: RunDirectory) -> None:
    """Say why the pictures of a series have no outlines of bodies, where its fields leave them out."""
    sections = place.case().sections
    written, bodies = sections.output.vtk.fields, [body.name for body in sections.bodies]
    if len(bodies) > 1 and written is not None and not outlined(written):
        wanted = ", ".join([*(f"{name}_fraction" for name in bodies), "body"])
        print(f"no outlines of bodies: output.vtk.fields leaves out {wanted}", file=sys.stderr)


def _names(options: argparse.Namespace) -> list[str] | None:
    return None if options.fields is None else [name.strip() for name in options.fields.split(",")]
