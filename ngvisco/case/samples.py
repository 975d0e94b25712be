"""What a case measures while it runs: the tables of ``[output]`` as observers."""

from pathlib import Path

from ngvisco.case.schema import CaseSections
from ngvisco.run.bodies import Bodies
from ngvisco.run.probes import Integrals, LineSamples, Probes, WallForces
from ngvisco.run.series import Series


def samples(case: CaseSections, run: Path) -> dict[tuple[str, ...], Series]:
    """Probes, lines, forces, integrals and bodies by the key that describes them, writing into a run's
    directory."""
    output, directory, found = case.output, run / "samples", dict[tuple[str, ...], Series]()
    if case.bodies:
        every = 1 if output.bodies is None else output.bodies.every
        found["output", "bodies"] = Bodies(run / "bodies.csv", every)
    for i, p in enumerate(output.probes):
        path = directory / f"{p.name}.csv"
        found["output", "probes", str(i)] = Probes({p.name: p.point}, p.fields, path, p.every)
    for i, line in enumerate(output.lines):
        path = directory / f"{line.name}.csv"
        found["output", "lines", str(i)] = LineSamples(
            line.start, line.end, line.points, line.fields, path, line.every
        )
    if output.forces is not None:
        f, path = output.forces, directory / "forces.csv"
        found["output", "forces"] = WallForces(f.walls, f.about, path, f.every)
    for i, integral in enumerate(output.integrals):
        path = directory / f"{integral.name}.csv"
        found["output", "integrals", str(i)] = Integrals({integral.name: integral.of}, path, integral.every)
    return found
