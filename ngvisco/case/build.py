"""The build of a simulation from a case file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ngsolve import Mesh

from ngvisco.case import toml
from ngvisco.case.faults import CaseError, Fault, Locator
from ngvisco.case.reading import sections_of, text_of
from ngvisco.case.schema import CaseSections
from ngvisco.case.section import built, nodes, parameters
from ngvisco.case.units import Converter
from ngvisco.case.values import shape_of
from ngvisco.errors import require_path
from ngvisco.forms.context import time
from ngvisco.physics.bodies import Body
from ngvisco.physics.material import ElasticState, Material, part_of
from ngvisco.physics.materials.network import Network
from ngvisco.physics.model import Model, open_state
from ngvisco.physics.walls import Wall
from ngvisco.run.body_tables import Bodies
from ngvisco.run.checkpoint import Checkpoints
from ngvisco.run.contours import Contours
from ngvisco.run.files import AnyPath
from ngvisco.run.observers import LedgerCSV, VTKSeries
from ngvisco.run.probes import Integrals, LineSamples, Probes, WallForces
from ngvisco.run.refinement import Refinement
from ngvisco.run.series import Series
from ngvisco.run.simulation import Observer, Simulation
from ngvisco.shapes.fractions import volumes


def load_case(path: AnyPath, settings: Sequence[str] = ()) -> Case:
    """Read and validate a case file.

    Raises CaseError with every fault found: line, key path, value, allowed values and the nearest match.

    Parameters
    ----------
    path : path of a TOML file
    settings : sequence of str
        Overrides ``key.path=value``, as by ``--set`` on the command line.
    """
    source = require_path("load_case.path", path)
    return parse_case(text_of(source), str(source), source.parent, settings)


def parse_case(text: str, source: str, directory: Path, settings: Sequence[str] = ()) -> Case:
    """The case of a text, validated as by ``load_case``; relative paths in the text start at
    ``directory``."""
    locator = sections_of(text, source, directory, settings)
    return Case(locator.sections, source, directory, locator)


@dataclass(frozen=True)
class Case:
    """A validated case, which makes the mesh, the simulation and the observers that it describes."""

    sections: CaseSections
    source: str
    directory: Path
    locator: Locator

    @cached_property
    def units(self) -> Converter:
        """The converter from the units of ``[units]`` to SI units."""
        return Converter(self.locator.data.get("units"), self.directory)

    @property
    def until(self) -> float:
        """End time, s."""
        return self.sections.time.until

    @property
    def refinement(self) -> Refinement | None:
        """The refinement by which the mesh follows a field; None for a fixed mesh."""
        adapt = self.sections.domain.adapt  # type: ignore[attr-defined]
        return None if adapt is None else adapt.built

    def output_times(self, until: float, origin: float = 0.0) -> tuple[float, ...]:
        """Multiples of ``output.vtk.interval`` after ``origin`` up to ``until``, and ``origin`` itself if it
        is not 0; empty without an interval."""
        interval = self.sections.output.vtk.interval
        if interval is None or not self.sections.output.vtk.enabled:
            return ()
        count = int((until - origin) / interval + 1e-9)
        return tuple(origin + i * interval for i in range(origin == 0, count + 1))

    @property
    def resolved(self) -> str:
        """The case as TOML with every default written out and the mesh file's path made absolute.

        Paths of other files are the paths of their copies in the run directory (``files``).
        """
        data = self._settled()
        for table in _tables_of_files(data):
            table["path"] = _copy_of(Path(table["path"]))
        return toml.write(data)

    @property
    def hash(self) -> str:
        """SHA-256 of the parts on which the solution depends, without title, units, end time and output.

        Of the domain, it contains only refinement and symmetry; ``versions.json`` has a hash of the mesh.
        """
        data = self._settled()
        for table in _tables_of_files(data):
            table["path"] = _digest_of(Path(table["path"]))
        for name in ("title", "units", "output", "domain"):  # versions.json has the mesh's hash
            del data[name]
        if self.refinement is not None:
            data["adapt"] = str(self.refinement)
        if (symmetry := self.sections.domain.symmetry) != "none":  # type: ignore[attr-defined]
            data["symmetry"] = symmetry
        del data["time"]["until"]
        return hashlib.sha256(toml.write(data).encode()).hexdigest()

    @property
    def files(self) -> dict[str, Path]:
        """Files of bodies' shapes and Python materials, by the names of their copies in a run directory."""
        tables = _tables_of_files(self.sections.model_dump())
        return {_copy_of(file): file for file in (Path(table["path"]) for table in tables)}

    def _settled(self) -> dict[str, Any]:
        """The case's data, in which the defaults that depend on the model are filled in.

        These defaults are the material's elastic state, F or B, and the initial density of a material without
        a referential density.
        """
        data = self.sections.model_dump()
        if self.sections.material is None:
            return data
        material = self.sections.material.built
        if data["initial"]["density"] is None and material.referential_density is None:
            data["initial"]["density"] = 1.0
        state, _ = self._open_state(material)
        _settle_state(data["material"], material.with_elastic_state(state))
        return data

    def _open_state(self, material: Material) -> tuple[ElasticState, str]:
        sections: Any = self.sections
        creep = sections.rheology.creep
        return open_state(None if creep is None else creep.built, material, sections.discretisation.m)

    @property
    def carried(self) -> str:
        """Names of the material's variables, and the elastic state if the case does not choose it; empty for
        bodies."""
        if self.sections.material is None:
            return ""
        material = self.sections.material.built
        state, reason = self._open_state(material)
        by_F, by_B = material.with_elastic_state("F").variables, material.with_elastic_state("B").variables
        names = ", ".join(v.name for v in (by_B if state == "B" else by_F))
        return names if by_F == by_B else f"{names}, by the default elastic_state = {state!r}, since {reason}"

    def mesh(self) -> Mesh:
        """The mesh of the domain; raises CaseError."""
        domain: Any = self.sections.domain
        with self.locator.located("domain"):
            mesh: Mesh = type(domain).target(**parameters(domain))  # a new mesh, since runs refine their mesh
            return mesh

    def model(self, dim: int) -> Model:
        """Material, mechanisms and loads in ``dim`` dimensions; raises CaseError."""
        sections: Any = self.sections
        parts = _built(sections.rheology, type(sections.rheology).model_fields)
        parts["loads"] = tuple(load.built for load in sections.loads)
        if sections.bodies:
            bodies: list[Body] = []
            for i, body in enumerate(sections.bodies):
                with self.locator.located("bodies", str(i)):
                    bodies.append(body.built)
            parts["bodies"] = tuple(bodies)
        if sections.material is not None:
            with self.locator.located("material"):
                parts["material"] = sections.material.built
        with self.locator.located("bodies" if sections.bodies else "loads"):
            return Model(**parts).at_order(sections.discretisation.m)

    def simulation(self, mesh: Mesh, observers: Sequence[Observer] = ()) -> Simulation:
        """The simulation at its initial state; raises CaseError for data that the model refuses."""
        sections: Any = self.sections
        parts = _built(sections, ("initial", "discretisation", "solver", "time"))
        walls: dict[str | tuple[str, ...], Wall] = {name: wall.built for name, wall in sections.walls.items()}
        time.Set(0.0)
        model = self.model(mesh.dim)
        self._check_bodies(mesh)
        with self.locator.located("initial"):
            parts["newton"] = parts.pop("solver")
            passive = sections.output.passive
            parts["symmetry"] = sections.domain.symmetry
            run = Simulation(mesh, model, walls=walls, passive=passive, observers=observers, **parts)
            run.check_data(self.until)
        if self.refinement is not None:
            with self.locator.located("domain", "adapt"):
                self.refinement.check(run)
        files: dict[tuple[str, ...], Any] = dict(samples(sections, Path()))
        files["output", "vtk"] = VTKSeries(Path(), **parameters(sections.output.vtk))
        for path, series in files.items():
            with self.locator.located(*path):
                series.prepare(run)
        return run

    def check_end(self, run: Simulation) -> None:
        """Raise CaseError if the end time lies ahead of the state, and no step of the simulation ends at the
        end time."""
        with self.locator.located("time"):
            if self.until > run.t:
                run.stepper.check("until", self.until)

    def _check_bodies(self, mesh: Mesh) -> None:
        """Raise CaseError for a shape that does not fit the mesh."""
        for i, body in enumerate(self.sections.bodies):
            parts = body.where if isinstance(body.where, list) else [body.where]
            for j, part in enumerate(parts) if body.where is not None else ():
                number = [str(j)] if part is not body.where else []
                with self.locator.located("bodies", str(i), "where", *number):
                    volumes(mesh, [shape_of(built(part))])

    def observers(self, directory: AnyPath, times: Sequence[float] | None = None) -> list[Observer]:
        """The observers for ledger, VTK series, tables and, last, checkpoints in a run directory.

        ``times``, s, are the run's output times; the default is ``output_times`` from t = 0 to the end time.
        """
        out, vtk, checkpoint = Path(directory), self.sections.output.vtk, self.sections.output.checkpoint
        chosen: list[Observer] = [LedgerCSV(out / "ledger.csv")]
        if vtk.enabled:
            times = self.output_times(self.until) if times is None else times
            every = None if vtk.interval else vtk.every
            chosen.append(VTKSeries(out / "vtk", **parameters(vtk) | {"every": every}, times=times))
        chosen += samples(self.sections, out).values()
        chosen.append(Checkpoints(out / "run.h5", **parameters(checkpoint), attributes={"case": self.hash}))
        return chosen


def _built(table: Any, names: Iterable[str]) -> dict[str, Any]:
    """The objects that the sections ``names`` of a table describe; sections that the table lacks are left
    out."""
    return {name: part.built for name in names if (part := getattr(table, name)) is not None}


def _settle_state(values: dict[str, Any], material: Any) -> None:
    """Write the material's ``elastic_state`` into its table and nested tables that leave the state open."""
    network = part_of(material, Network)
    branches = {} if network is None else network.parts
    if values.get("elastic_state", "") is None:
        while not hasattr(material, "elastic_state"):  # heat and Prony series wrap a material
            material = next(iter(branches.values()), material).material
        values["elastic_state"] = material.elastic_state
    if values.get("material") is not None:  # a gas has no inner material
        _settle_state(values["material"], material)
    for name, branch in (values.get("branches") or {}).items():
        _settle_state(branch["material"], branches[name].material)


def _tables_of_files(data: Any) -> list[dict[str, Any]]:
    """The tables of a case's data that name the file of a shape or of a Python material.

    A run directory has copies of these files.
    """
    tables = (node for _, node in nodes(data) if isinstance(node, dict) and "path" in node)
    return [table for table in tables if "geometry" not in table]  # the mesh is stored as mesh.vol


def _digest_of(file: Path) -> str:
    """SHA-256 of a file's content; raises CaseError for a file that cannot be read."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError as error:
        raise CaseError(str(file), [Fault("", f"the file cannot be read: {error.strerror}")]) from error


def _copy_of(file: Path) -> str:
    """The name of a file's copy in a run directory."""
    folder = "laws" if file.suffix == ".py" else "shapes"
    return f"{folder}/{_digest_of(file)[:16]}{file.suffix.lower()}"


def samples(case: CaseSections, run: Path) -> dict[tuple[str, ...], Series]:
    """Series of probes, lines, forces, integrals, bodies and contours, by their key paths in the case."""
    output, series = case.output, dict[tuple[str, ...], Series]()

    def file(name: str) -> Path:
        return run / "samples" / f"{name}.csv"

    if case.bodies or output.bodies is not None:
        chosen: dict[str, Any] = {} if output.bodies is None else parameters(output.bodies)
        series["output", "bodies"] = Bodies(run / "bodies.csv", **chosen)
    if (c := output.contours) is not None:
        series["output", "contours"] = Contours(run / "contours", **parameters(c))
    for i, p in enumerate(output.probes):
        series["output", "probes", str(i)] = Probes({p.name: p.point}, **parameters(p), path=file(p.name))
    for i, e in enumerate(output.lines):
        series["output", "lines", str(i)] = LineSamples(**parameters(e), path=file(e.name))
    if (f := output.forces) is not None:
        series["output", "forces"] = WallForces(**parameters(f), path=file("forces"))
    for i, s in enumerate(output.integrals):
        series["output", "integrals", str(i)] = Integrals({s.name: s.of}, file(s.name), **parameters(s))
    return series
