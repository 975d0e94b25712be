"""The commands ``ngvisco plot`` and ``ngvisco scene``, which draw a run."""

import argparse
from pathlib import Path

from ngsolve import CoefficientFunction, SetNumThreads

from ngvisco import case as cases
from ngvisco.case.directory import RunDirectory
from ngvisco.case.runs import Results
from ngvisco.errors import ParameterError
from ngvisco.run.fields import scalar_fields, title_of
from ngvisco.run.frames import outlined, read_pvd
from ngvisco.run.pictures import CrossSection, plot_fields, require_space, titled, write_movie
from ngvisco.run.plots import plot_comparison, plot_energies, plot_history
from ngvisco.run.scene import write_scene, write_scene_of_series
from ngvisco.sweep.study import read_table


def plot(options: argparse.Namespace) -> int:
    """Draw energies, history and fields of a run into its directory, or an animation, or a comparison of
    runs."""
    runs = _runs(options)
    if len(runs) > 1:
        return _compare(options, runs)
    (run,) = runs.values()
    out = Path(options.output or run)
    section = None if options.section is None else CrossSection.parse(options.section)
    if options.movie is not None:
        if options.step is not None:
            expected = "no such option together with --movie, since --movie draws all states"
            raise ParameterError("--step", options.step, expected)
        place = RunDirectory(run)
        path, title = Path(options.movie or out / "movie.gif"), place.case().sections.title
        fps = 10.0 if options.fps is None else options.fps
        write_movie(place.vtk, path, options.fields, section=section, frames_per_second=fps, title=title)
        print(path)
        return 0
    if options.fps is not None:
        expected = "--fps only together with --movie, since a picture has no frames"
        raise ParameterError("--fps", options.fps, expected)
    results, chosen, lines = _load(run, options)
    require_space(section, results.mesh.dim)  # raise before anything is drawn
    energies, history, states = (
        out / f"{name}.{options.format}" for name in ("energies", "history", "fields")
    )
    plot_energies(results.simulation.ledger, energies)
    plot_history(results.simulation.ledger, history)
    fields = [(title_of(name), value) for name, value in chosen.items()]
    title = titled(results.case.sections.title, results.time)
    plot_fields(results.mesh, fields, states, section=section, title=title, outlines=lines)
    print(energies, history, states, sep="\n")
    return 0


def _runs(options: argparse.Namespace) -> dict[str, Path]:
    """The named run directories, or all run directories of a study, by label."""
    places = [Path(text) for text in options.directory]
    if len(places) == 1 and (places[0] / "sweep.csv").exists():
        names = [outcome.name for outcome in read_table(places[0] / "sweep.csv")]
        done = {name: places[0] / name for name in names if (places[0] / name / "run.h5").exists()}
        if not done:
            raise ParameterError("DIR", str(places[0]), "a sweep in which at least one run has made a step")
        return done
    return {str(place): place for place in places}


def _compare(options: argparse.Namespace, runs: dict[str, Path]) -> int:
    for name in ("movie", "fps", "section", "step"):
        if (value := getattr(options, name)) is not None:
            expected = "no such option for several runs, since several runs are compared over time"
            raise ParameterError(f"--{name}", value, expected)
    out = Path(options.output or (options.directory[0] if len(options.directory) == 1 else "."))
    for path in plot_comparison(runs, out, options.fields, options.format):
        print(path)
    return 0


def scene(options: argparse.Namespace) -> int:
    """Write an HTML file into the run directory, with all states of the VTK series or with one checkpoint."""
    place = RunDirectory(options.directory)
    path, title = place.path / "scene.html", place.case().sections.title or "ngvisco"
    if options.step is None and read_pvd(place.vtk / "fields.pvd"):
        write_scene_of_series(place.vtk, path, options.fields, title)
    else:
        results, chosen, lines = _load(place.path, options)
        write_scene(results.mesh, chosen, path, titled(title, results.time), outlines=lines)
    print(path)
    return 0


def _load(
    directory: Path, options: argparse.Namespace
) -> tuple[Results, dict[str, CoefficientFunction], list[CoefficientFunction]]:
    """The state of a run, the fields to draw, and the fields whose jumps outline bodies."""
    SetNumThreads(1)
    results = cases.load(directory, options.step)
    fields = results.fields
    return results, scalar_fields(fields, options.fields), [fields[name] for name in outlined(list(fields))]
