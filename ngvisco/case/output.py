"""The tables of [output]: what the run directory gets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator

from ngvisco.case.table import Section
from ngvisco.errors import ParameterError, Quantity


def _check_once(names: list[str]) -> list[str]:
    if len(set(names)) < len(names):
        raise ValueError("expected each name once")
    return names


Names = Annotated[list[str], Field(min_length=1), AfterValidator(_check_once)]
"""Some of what there is; all of it where the key is left out."""


class VTK(Section):
    """The VTK series.

    Parameters
    ----------
    enabled
        Whether the VTK series is written.
    every
        A file every so many steps.
    interval
        A file at every multiple of this time instead of every so many steps.
    fields
        Which fields; without this key all but creep_rate, mandel_stress, viscous_stress, hyperstress_1 (to
        3), principal_stresses, principal_stretches.
    subdivision
        Bisections of cells, 0 to 4: fields are linear in the pieces.
    """

    enabled: bool = True
    every: int = Field(default=10, ge=1)
    interval: Annotated[float | None, Quantity("s", "> 0", 0.1)] = Field(
        default=None, gt=0, allow_inf_nan=False
    )
    fields: Annotated[Names | None, Quantity(example=["velocity", "density"])] = None
    subdivision: int = Field(default=0, ge=0, le=4)


class Checkpoint(Section):
    """Checkpoints in run.h5.

    Parameters
    ----------
    every
        A checkpoint every so many steps, and at the end.
    keep
        How many checkpoints run.h5 holds.
    """

    every: int = Field(default=10, ge=1)
    keep: int = Field(default=2, ge=1)


def _check_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,60}", name):
        raise ValueError("expected at most 60 letters, digits, _ and -")
    return name


Name = Annotated[str, AfterValidator(_check_name)]
"""A name that becomes that of a file and of its columns."""


Components = Annotated[Names | None, Quantity(example=["velocity", "F_12"])]


class Table(Section):
    """A table over time.

    Parameters
    ----------
    every
        A row every so many steps, and at the end.
    """

    every: int = Field(default=1, ge=1)


class NamedTable(Table):
    """One of several tables.

    Parameters
    ----------
    name
        Letters, digits, _ and -; the file is samples/NAME.csv.
    """

    name: Annotated[Name, Quantity(example="middle")]


class Probe(NamedTable):
    """Fields at a point over time.

    Parameters
    ----------
    point
        Where, a coordinate for each dimension.
    fields
        Fields or components of them; without this key as for output.vtk.fields.
    """

    point: Annotated[list[float], Quantity("m", example=[0.5, 0.5])]
    fields: Components = None


class Line(NamedTable):
    """Fields along a line over time.

    Parameters
    ----------
    start
        One end, a coordinate for each dimension.
    end
        The other end.
    points
        How many points, equally spaced, the ends among them.
    fields
        Fields or components of them; without this key as for output.vtk.fields.
    """

    start: Annotated[list[float], Quantity("m", example=[0.0, 0.5])]
    end: Annotated[list[float], Quantity("m", example=[1.0, 0.5])]
    points: int = Field(default=101, ge=2, le=100_000)
    fields: Components = None
    every: int = Field(default=10, ge=1)


class Forces(Table):
    """Forces and torques on walls over time.

    Parameters
    ----------
    walls
        Names of walls; all without this key.
    about
        The point that torques refer to; the origin without this key.
    """

    walls: Annotated[Names | None, Quantity(example=["left"])] = None
    about: Annotated[list[float] | None, Quantity("m", example=[0.5, 0.5])] = None


class DomainIntegral(NamedTable):
    """The integral of an expression of the fields over the domain, over time.

    Parameters
    ----------
    of
        An expression of x, y, z, t and fields' components.
    """

    of: Annotated[str, Quantity(example="density*velocity_1")]


class Output(Section):
    """What is written into the run directory.

    Parameters
    ----------
    vtk
        The VTK series, for ParaView.
    checkpoint
        Checkpoints in run.h5.
    probes
        Fields at points over time, each a file samples/NAME.csv.
    lines
        Fields along lines over time, each a file samples/NAME.csv.
    forces
        Forces and torques on walls over time, in samples/forces.csv.
    integrals
        Integrals over the domain over time, each a file samples/NAME.csv.
    bodies
        Mass, centroid, energies, ... of each body over time, in bodies.csv.
    log_every
        A line in log.txt every so many steps.
    passive
        Further fields to carry along: F_tot, reference_map, creep_strain.
    """

    vtk: VTK = VTK()
    checkpoint: Checkpoint = Checkpoint()
    probes: list[Probe] = Field(default=[])
    lines: list[Line] = Field(default=[])
    forces: Forces | None = None
    integrals: list[DomainIntegral] = Field(default=[])
    bodies: Table | None = None
    log_every: int = Field(default=1, ge=1)
    passive: Annotated[list[str], AfterValidator(_check_once), Quantity(example=["reference_map"])] = Field(
        default=[]
    )

    @model_validator(mode="after")
    def _distinct(self) -> Output:
        taken = {"forces"} if self.forces is not None else set()
        tables: dict[str, Sequence[Any]] = {
            "probes": self.probes,
            "lines": self.lines,
            "integrals": self.integrals,
        }
        for key, members in tables.items():
            for i, name in enumerate(member.name for member in members):
                if name in taken:
                    expected = f"a name that no other of the tables has: both would write {name}.csv"
                    raise ParameterError(f"Output.{key}.{i}.name", name, expected)
                taken.add(name)
        return self
