"""The commands ``ngvisco check``, ``info``, ``list``, ``explain`` and ``new``, which print text."""

import argparse
import json
import math
import sys
import tempfile
import time as clock
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from ngsolve import SetNumThreads

from ngvisco import case as cases
from ngvisco.case import catalogue, reference, schema, template
from ngvisco.case.directory import RunDirectory
from ngvisco.case.section import TAGS, Section, models_in
from ngvisco.errors import ParameterError
from ngvisco.run.advice import Scales, scales
from ngvisco.run.fields import NAMES as FURTHER
from ngvisco.run.observers import VTKSeries
from ngvisco.run.passive import NAMES as PASSIVE
from ngvisco.run.refinement import stretches
from ngvisco.run.simulation import Observer, Simulation
from ngvisco.timestepping.scheme import SCHEMES

_STEPS, _SECONDS = 12, 30.0
"""Largest numbers of steps and of seconds of the measurement for the estimate of the time."""


def check(options: argparse.Namespace) -> int:
    """Validate a case, mesh it, and print its size, scales and cost; write no file."""
    began = clock.perf_counter()
    SetNumThreads(1)
    case = cases.load_case(options.case, options.settings)
    mesh = case.mesh()
    run = case.simulation(mesh)
    case.check_end(run)
    if (adapt := case.refinement) is not None:
        first, mesh = mesh, (run := next(stretches(run, adapt, case.until, mesh, None))[0]).mesh
    layout = run.rothe_step.layout
    condensed = sum(layout.space.FreeDofs(True))
    steps = round(case.until / run.dt)
    of_plane = "plane strain" if run.arguments["symmetry"] == "none" else "a body of revolution about x = 0"
    kind = of_plane if mesh.dim == 2 else "three dimensions"
    print(f"{options.case}: valid")
    walls = ", ".join(sorted(set(mesh.GetBoundaries())))
    print(f"mesh       {mesh.ne} cells, {mesh.nv} vertices, {kind}, walls {walls}")
    if adapt is not None:
        most = first.ne * 2 ** (mesh.dim * adapt.levels)
        print(
            f"adapt      every {adapt.every:g} s, by {adapt.field}; the mesh has from {first.ne} to about "
            f"{most} cells. All sizes and times below are for the mesh of the start"
        )
    if case.carried:
        print(f"carried    {case.carried}")
    print(f"unknowns   {layout.space.ndof}, of which {condensed} are solved for after condensation")
    adaptive = case.sections.time.adaptive
    if adaptive is None:
        print(f"time       {steps} step{'s' * (steps != 1)} of {run.dt:g} s to t = {case.until:g} s")
    else:
        least = max(1, math.ceil(case.until / adaptive.dt_max))
        steps = min(steps, least)
        print(
            f"time       adaptive steps to t = {case.until:g} s, the first {run.dt:g} s long; the least "
            f"number of steps is {least}, if all have the length dt_max = {adaptive.dt_max:g} s"
        )
    sys.stdout.flush()  # shown now, because a hard step takes minutes
    before = options.imports + clock.perf_counter() - began
    start = scales(run)
    try:
        first, later, count, writing = _measure(case, run, steps)
    finally:
        _say_scales(replace(scales(run), unborne=start.unborne))
    print(f"memory     {_peak():.0f} MB, measured")
    total = first + (steps - 1) * later
    estimate = f"{later:.2g} s a step, {_duration(total)} in all, after {_duration(before)} of set-up"
    if writing is not None:
        cost, files = writing
        if adaptive is None:
            estimate += f", and {_duration(cost * files)} for {files} file{'s' * (files > 1)} of fields"
        else:
            estimate += f", and {cost:.2g} s for each file of fields"
    if adaptive is not None:
        estimate += f", if all steps had the length dt_max; the present length is {run.stepper.dt:.3g} s"
    print(f"estimate   {estimate} (from {count} measured step{'s' * (count > 1)})")
    return 0


def _say_scales(sizes: Scales) -> None:
    """Print scales, dimensionless numbers and advice after the steps taken so far."""
    fast, slow = sizes.speeds
    speed = f"v {sizes.velocity:.3g} m/s so far" if sizes.velocity > 0 else "v unknown until matter moves"
    edges = f"L {sizes.length:.3g} m"
    if sizes.extent > sizes.length * (1 + 1e-6):
        edges = f"domain {sizes.length:.3g} to {sizes.extent:.3g} m"
    times = f", Maxwell time {sizes.maxwell:.3g} s" if np.isfinite(sizes.maxwell) else ""
    print(f"scales     {edges}, h {sizes.cell:.3g} m, {speed}, waves {fast:.3g} and {slow:.3g} m/s{times}")
    if sizes.is_slow:
        name, most = ("dt_max", sizes.longest) if sizes.longest > sizes.dt else ("dt", sizes.dt)
        print(
            f"           waves cross the domain in {sizes.passage:.2g} s, and {name} is "
            f"{most / sizes.passage:.1g} times as long, so that inertia has no effect on the motion"
        )
    for name, value in sizes.numbers.items():
        if not (sizes.is_slow and ("waves" in name or name.startswith("Reynolds"))):
            print(f"           {name:38s} {value:.3g}")
    for line in sizes.advice:
        print(f"advice     {line}")


def _measure(
    case: cases.Case, run: Simulation, steps: int
) -> tuple[float, float, int, tuple[float, int] | None]:
    """Take the first steps of a case, with its observers, in a directory that is removed.

    Returns the seconds of the first step, the median of the seconds of later steps, and the number of all
    measured steps.  The last value has the seconds of a file of the VTK series and the number of files; it is
    None without a series.  The median is taken, since one step may need ten times as many iterations as the
    others.
    """
    with tempfile.TemporaryDirectory() as place:
        observers, watch = case.observers(Path(place)), Stopwatch(min(_STEPS, steps), _SECONDS)
        series = [o for o in observers if isinstance(o, VTKSeries)]
        began = clock.perf_counter()
        for writer in series:
            writer.start(run)
        cost = clock.perf_counter() - began
        run.observers = [*(o for o in observers if o not in series), watch]
        run.run(case.until)
    spent = watch.seconds
    files = (cost, _files(series[0], case.until, run.dt)) if series else None
    return spent[0], float(np.median(spent[1:] or spent)), len(spent), files


def _files(series: VTKSeries, until: float, dt: float) -> int:
    """Number of files of the VTK series in a run with steps of one length."""
    steps, every, times = round(until / dt), series.every, series.times
    between = len(times) + (0 if every is None else steps // every)
    meets_end = until in times or (every is not None and steps % every == 0)
    return 1 + between + (not meets_end)


class Stopwatch(Observer):
    """Observer that measures the seconds of each step, and ends the run after some steps or seconds."""

    def __init__(self, steps: int, until: float) -> None:
        self._steps, self._until = steps, until
        self.seconds: list[float] = []

    def start(self, simulation: Simulation) -> None:
        self._lap = clock.perf_counter()

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        began, self._lap = self._lap, clock.perf_counter()
        self.seconds.append(self._lap - began)
        if len(self.seconds) >= self._steps or sum(self.seconds) >= self._until:
            simulation.request_stop()


def _peak() -> float:
    """The largest memory of this process so far, MB."""
    if sys.platform == "win32":
        return float("nan")
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def _duration(seconds: float) -> str:
    for size, unit in ((86400, "days"), (3600, "h"), (60, "min")):
        if seconds >= size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.2g} s"


def info(options: argparse.Namespace) -> int:
    """Print the content and the state of a run directory."""
    if options.directory is None:
        raise ParameterError("DIR", None, "a run directory, or --parallel")
    place = RunDirectory(options.directory)
    case = place.case()
    print(f"{place.path}: {case.sections.title or 'a run'}")
    record = place.read_versions() if place.versions_file.exists() else {}
    versions = ", ".join(
        f"{name} {record[name]}" for name in ("ngvisco", "ngsolve", "commit") if record.get(name)
    )
    print(f"versions   {versions or 'none recorded'}; started {record.get('started', 'never')}")
    if case.carried:
        print(f"carried    {case.carried}")
    print(f"scheme     {case.sections.time.scheme}, dt {case.sections.time.dt:g} s")
    if not place.run_file.exists():
        print(f"state      nothing computed; start with: ngvisco resume {place.path}")
        return 0
    ledger = place.ledger()
    end, step = ledger["time"][-1], int(ledger["step"][-1])
    relation = " s, beyond the case's" if end > case.until * (1 + 1e-9) else " of"
    state = f"resumable: ngvisco resume {place.path}" if end < case.until * (1 - 1e-9) else "finished"
    print(f"state      t = {end:g}{relation} {case.until:g} s, step {step}; {state}")
    print(f"energy     kinetic {ledger['kinetic'][-1]:.6e} J, stored {ledger['stored'][-1]:.6e} J")
    print(
        f"ledger     largest |closure| {np.abs(ledger['closure_relative']).max():.1e}, "
        f"largest |mass drift| {np.abs(ledger['mass_drift']).max():.1e}, "
        f"rejected steps {int(ledger['rejections'].sum())}"
    )
    if "momentum_size" in ledger:
        axes = [name for name in ("momentum_1", "momentum_2", "momentum_3") if name in ledger]
        now = ", ".join(f"{ledger[name][-1]:.4e}" for name in axes)
        defect = np.abs(ledger["momentum_defect_relative"]).max()
        print(f"momentum   ({now}) kg m/s, largest relative defect {defect:.1e}")
    for path in [*place.results, *place.failures]:
        print(f"  {path.stat().st_size:12d} bytes  {path.relative_to(place.path)}")
    return 0


def explain(options: argparse.Namespace) -> int:
    """Print the meaning of a key of a case file."""
    print(reference.explain(options.key))
    return 0


def new(options: argparse.Namespace) -> int:
    """Print an annotated case file, or the names of the demos."""
    if options.name is None:
        for name, path in template.demos().items():
            title = path.read_text(encoding="utf-8").split("\n")[0].partition("=")[2].strip().strip('"')
            print(f"{name:15s} {title}")
    else:
        print(template.template(options.name), end="")
    return 0


_FORMS: dict[str, Callable[[], str]] = {
    "keys": lambda: reference.listing() + "\n",
    "markdown": reference.markdown,
    "schema": lambda: json.dumps(reference.json_schema(), indent=1) + "\n",
}


def _by_kind(choice: object) -> dict[str, type[Section]]:
    """The sections of a union type by the names of their kinds."""
    return {model.__name__: model for model in models_in(choice)}


def listing(options: argparse.Namespace) -> int:
    """Print the kinds that a case file can name, or all keys."""
    if options.form is not None:
        print(_FORMS[options.form](), end="")
        return 0
    materials = _by_kind(schema.MaterialSection)
    of_another = {name: materials.pop(name) for name in catalogue.WRAPPERS}
    mechanisms = {name: schema.Rheology.model_fields[name].annotation for name in catalogue.MECHANISMS}
    groups = (
        ("geometries: [domain] geometry =", _by_kind(schema.Domain)),
        ("materials: [material] kind =", materials),
        ("materials that wrap another material, [material.material]: [material] kind =", of_another),
        ("mechanisms: [rheology.NAME]", {name: models_in(part)[0] for name, part in mechanisms.items()}),
        ("flow rules: [rheology.creep] kind =", _by_kind(schema.CreepSection)),
        ("viscosities: [rheology.viscosity] kind =", _by_kind(schema.ViscositySection)),
        ("loads: [[loads]] kind =", _by_kind(schema.LoadSection)),
        ("walls: [walls.NAME] kind =", _by_kind(schema.WallSection)),
    )
    for title, models in groups:
        print(title)
        for name, model in models.items():
            keys = [(key, field) for key, field in model.model_fields.items() if key not in TAGS]
            required = [key for key, field in keys if field.is_required()]
            shown = [*required, *(f"[{key}]" for key, field in keys if not field.is_required())]
            print(f"  {name}: {', '.join(shown)}" if shown else f"  {name}")
    print("time schemes: [time] scheme =")
    for name, make in SCHEMES.items():
        note = "; takes theta in [1/2, 1]" if name == "theta" else ""
        text = (make.__doc__ or "").splitlines()[0].rstrip(".")
        print(f"  {name}: {text}{note}")
    print("outputs: [output.vtk] fields =")
    print(
        "  velocity, density, cauchy_stress, pressure, von_mises, the material's variables (F, B, J, E, ...)"
    )
    print(f"  by name only: {', '.join(FURTHER)}")
    print("  also ledger.csv, run.h5, log.txt; ngvisco plot and ngvisco scene make PNG and HTML of them")
    print("passive: [output] passive =")
    print(f"  {', '.join(PASSIVE)}")
    sections = ", ".join(
        name for name in schema.CaseSections.model_fields if name not in ("domain", "material", "loads")
    )
    print(f"other sections: {sections}")
    return 0
