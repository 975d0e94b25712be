"""The tables of [output]: what the run directory gets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator

from ngvisco.case.section import Section
from ngvisco.errors import ParameterError, Quantity


def _check_once(names: list[str]) -> list[str]:
    if len(set(names)) < len(names):
        raise ValueError("expected each name once")
    return names


def _check_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,60}", name):
        raise ValueError("expected at most 60 letters, digits, _ and -")
    return name


Names = Annotated[list[str], Field(min_length=1), AfterValidator(_check_once)]
"""Some of what there is; all of it where the key is left out."""
Components = Annotated[Names | None, Quantity(example=["velocity", "F_12"])]
Count = Annotated[int, Field(ge=1)]
_COMPONENTS = "Fields or components of them; without this key as for output.vtk.fields"


class VTK(Section):
    """The VTK series."""

    enabled: bool = Field(default=True, description="Whether the VTK series is written")
    every: Count = Field(default=10, description="A file every so many steps")
    interval: Annotated[float | None, Quantity("s", "> 0", 0.1)] = Field(
        default=None,
        gt=0,
        allow_inf_nan=False,
        description="A file at every multiple of this time instead of every so many steps",
    )
    fields: Annotated[Names | None, Quantity(example=["velocity", "density"])] = Field(
        default=None,
        description="Which fields; without this key all but creep_rate, mandel_stress, viscous_stress, "
        "hyperstress_1 (to 3), principal_stresses, principal_stretches",
    )
    subdivision: int = Field(
        default=0, ge=0, le=4, description="Bisections of cells, 0 to 4: fields are linear in the pieces"
    )


class Checkpoint(Section):
    """Checkpoints in run.h5."""

    every: Count = Field(default=10, description="A checkpoint every so many steps, and at the end")
    keep: Count = Field(default=2, description="How many checkpoints run.h5 holds")


class Table(Section):
    """A table over time."""

    every: Count = Field(default=1, description="A row every so many steps, and at the end")


class NamedTable(Table):
    """One of several tables."""

    name: Annotated[str, AfterValidator(_check_name), Quantity(example="middle")] = Field(
        description="Letters, digits, _ and -; the file is samples/NAME.csv"
    )


class Probe(NamedTable):
    """Fields at a point over time."""

    point: Annotated[list[float], Quantity("m", example=[0.5, 0.5])] = Field(
        description="Where, a coordinate for each dimension"
    )
    fields: Components = Field(default=None, description=_COMPONENTS)


class Line(NamedTable):
    """Fields along a line over time."""

    start: Annotated[list[float], Quantity("m", example=[0.0, 0.5])] = Field(
        description="One end, a coordinate for each dimension"
    )
    end: Annotated[list[float], Quantity("m", example=[1.0, 0.5])] = Field(description="The other end")
    points: int = Field(
        default=101, ge=2, le=100_000, description="How many points, equally spaced, the ends among them"
    )
    fields: Components = Field(default=None, description=_COMPONENTS)
    every: Count = Field(default=10, description="A row every so many steps, and at the end")


class Forces(Table):
    """Forces and torques on walls over time."""

    walls: Annotated[Names | None, Quantity(example=["left"])] = Field(
        default=None, description="Names of walls; all without this key"
    )
    about: Annotated[list[float] | None, Quantity("m", example=[0.5, 0.5])] = Field(
        default=None, description="The point that torques refer to; the origin without this key"
    )


class DomainIntegral(NamedTable):
    """The integral of an expression of the fields over the domain, over time."""

    of: Annotated[str, Quantity(example="density*velocity_1")] = Field(
        description="An expression of x, y, z, t and fields' components"
    )


class Output(Section):
    """What is written into the run directory."""

    vtk: VTK = Field(default=VTK(), description="The VTK series, for ParaView")
    checkpoint: Checkpoint = Field(default=Checkpoint(), description="Checkpoints in run.h5")
    probes: list[Probe] = Field(
        default=[], description="Fields at points over time, each a file samples/NAME.csv"
    )
    lines: list[Line] = Field(
        default=[], description="Fields along lines over time, each a file samples/NAME.csv"
    )
    forces: Forces | None = Field(
        default=None, description="Forces and torques on walls over time, in samples/forces.csv"
    )
    integrals: list[DomainIntegral] = Field(
        default=[], description="Integrals over the domain over time, each a file samples/NAME.csv"
    )
    bodies: Table | None = Field(
        default=None, description="Mass, centroid, energies, ... of each body over time, in bodies.csv"
    )
    log_every: Count = Field(default=1, description="A line in log.txt every so many steps")
    passive: Annotated[list[str], AfterValidator(_check_once), Quantity(example=["reference_map"])] = Field(
        default=[], description="Further fields to carry along: F_tot, reference_map, creep_strain"
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
