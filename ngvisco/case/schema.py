"""The schema of a case file: its sections, made from the dataclasses and functions of the catalogue."""

# mypy: disable-error-code="valid-type, call-arg"
# sections are made at run time, and defaults are given by position

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, create_model, model_validator

from ngvisco.case import catalogue
from ngvisco.case.section import Section, check_once, choice, parameters, section
from ngvisco.case.values import REGION
from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.bodies import Body, StartPlace
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.heat import Heat
from ngvisco.physics.material import Material
from ngvisco.physics.materials import Branch, Thermal
from ngvisco.physics.rheology import Viscosity
from ngvisco.run.body_tables import Bodies
from ngvisco.run.checkpoint import Checkpoints
from ngvisco.run.contours import Contours
from ngvisco.run.observers import VTKSeries
from ngvisco.run.probes import Integrals, LineSamples, Probes, WallForces
from ngvisco.run.refinement import Refinement

_MAX_OUTPUT_TIMES = 100_000
_MAX_STEPS = 100_000_000
"""Largest number of steps; even the cheapest steps, ten a second, would take a hundred days."""

Adapt = section(Refinement)
HeatCapacity = section(Thermal, is_whole=False, without=("p_infinity",))


class Meshed(Section):
    """The keys that every geometry has beside its parameters."""

    symmetry: Literal["none", "axisymmetric"] = Field(
        "none",
        description="Plane strain in two dimensions, or a body of revolution about x = 0 in the half plane "
        "x >= 0, with integrals over the body divided by 2 pi",
    )
    adapt: Adapt | None = Field(
        None, description="Division of cells where a field is steep, chosen again as the field moves"
    )


class Heated(Section):
    """The keys that every material has beside its parameters."""

    thermal: HeatCapacity | None = Field(
        None,
        description="Heat of a material with a temperature; the other keys of its table describe the "
        "material without heat",
    )

    def completed(self, made: Material) -> Material:
        """The material, with heat if the table has ``thermal``."""
        if self.thermal is None:
            return made
        try:
            return Thermal(material=made, **parameters(self.thermal))
        except ParameterError as error:
            owner, *names = error.field.split(".")
            key = ".".join([owner, *(["thermal"] if owner == "Thermal" else []), *names])
            raise ParameterError(key, error.value, error.expected) from error


CreepSection = choice(
    catalogue.FLOW_RULES, has_default=True, law=FlowRule, wrappers=catalogue.FLOW_RULE_WRAPPERS
)


def _branches(material: Any) -> dict[Any, Any]:
    """The schema's type of a network's branches, for the type of their materials."""
    branch: Any = section(Branch, types={Material: material, FlowRule: CreepSection})
    return {Mapping[str, Branch]: dict[str, branch]}


Domain = choice(catalogue.GEOMETRIES, "geometry", base=Meshed)
MaterialSection = choice(
    catalogue.MATERIALS,
    base=Heated,
    law=Material,
    wrappers=catalogue.WRAPPERS,
    of=_branches,
    without={"Gas": ("expansion",)},
)
LoadSection, WallSection, ShapeSection = map(choice, (catalogue.LOADS, catalogue.WALLS, catalogue.SHAPES))
ViscositySection = choice(
    catalogue.VISCOSITIES, has_default=True, law=Viscosity, wrappers=catalogue.VISCOSITY_WRAPPERS
)
_MECHANISMS: dict[str, Any] = {"viscosity": ViscositySection}
_MECHANISMS |= {name: section(target) for name, target in catalogue.MECHANISMS.items()} | {
    "creep": CreepSection
}
HeatSection = _MECHANISMS["heat"]
Rheology: Any = create_model(
    "Rheology",
    __base__=Section,
    **{name: (part | None, None) for name, part in _MECHANISMS.items()},  # type: ignore
)
Discretisation, Initial, Solver, TimeSteps = (
    section(catalogue.SECTIONS[name]) for name in ("discretisation", "initial", "solver", "time")
)


def _require_length(name: str, length: float, until: float, most: int, reason: str) -> None:
    """Raise ParameterError for a length of time, s, that fits more than ``most`` times into ``until``."""
    if until / length > most:
        # larger by 6 %, so that the number rounded to two digits is still large enough
        least = 1.06 * until / most
        raise ParameterError(name, length, f"at least {least:.2g} s, {reason}")


class Time(TimeSteps):  # type: ignore[misc]
    """Step length and end time."""

    until: Annotated[float, Quantity("s", "> 0", 1.0)] = Field(
        description="End of the run; with steps of one length, a multiple of dt after the run's start, or "
        "after the checkpoint at which dt was changed"
    )

    def completed(self, made: Any) -> Any:
        """Return ``made``; raise ParameterError for too many steps."""
        # adaptive steps grow: dt is the length of the first step only, so that dt_max gives the least number
        # of steps
        name = "dt" if self.adaptive is None else "adaptive.dt_max"
        longest = self.dt if self.adaptive is None else self.adaptive.dt_max
        steps = f"since this length makes {self.until / longest:.0e} steps to time.until = {self.until:g} s"
        _require_length(f"Time.{name}", longest, self.until, _MAX_STEPS, steps)
        return made


BodyPlace = Annotated[
    Annotated[Any, REGION, Tag("<text>")]
    | Annotated[ShapeSection, Tag("<shape>")]
    | Annotated[list[ShapeSection], Tag("<shapes>")],
    Discriminator(lambda value: {str: "<text>", list: "<shapes>"}.get(type(value), "<shape>")),
]
"""A body's place: a condition on x, y, z, a shape, or a list of shapes for their union."""


BodySection: Any = section(
    Body,
    types={
        StartPlace: BodyPlace,
        Material: MaterialSection,
        Viscosity: ViscositySection,
        FlowRule: CreepSection,
        Heat: HeatSection,
    },
    is_whole=False,
)


class _Series(Section):
    """The keys of the VTK series that say when the series is written."""

    enabled: bool = Field(True, description="Whether the VTK series is written")
    interval: Annotated[float | None, Quantity("s", "> 0", 0.1)] = Field(
        None, description="A file at every multiple of this time instead of every so many steps"
    )


VTK: Any = section(
    VTKSeries, base=_Series, without=("directory", "times"), defaults={"every": 10}, is_whole=False
)
Checkpoint = section(Checkpoints, without=("path", "attributes"), is_whole=False)


class _Named(Section):
    """Keys that all named output tables have (probes, lines, integrals), of which a case may have several."""

    name: Annotated[str, Quantity(example="middle")] = Field(
        pattern="^[A-Za-z0-9_-]{1,60}$", description="Letters, digits, _ and -; the file is samples/NAME.csv"
    )


class _AtPoint(_Named):
    """The keys of a table of fields at a point."""

    point: Annotated[list[float], Quantity("m", example=[0.5, 0.5])] = Field(
        description="The point, a coordinate for each dimension"
    )


class _OfExpression(_Named):
    """The keys of a table that lists the integral of an expression of the fields over the domain."""

    of: Annotated[str, Quantity(example="density*velocity_1")] = Field(
        description="An expression of x, y, z, t and fields' components"
    )


Probe: Any = section(Probes, base=_AtPoint, without=("points", "path"), is_whole=False)
DomainIntegral: Any = section(Integrals, base=_OfExpression, without=("integrands", "path"), is_whole=False)
Line: Any = section(LineSamples, base=_Named, without=("path",), defaults={"every": 10})
Forces = section(WallForces, without=("path",))
BodyTable = section(Bodies, without=("path",))
Contour = section(Contours, without=("directory",), defaults={"every": 10})


class Output(Section):
    """The files that a run writes into its directory."""

    vtk: VTK = Field(VTK(), description="The VTK series, for ParaView")
    checkpoint: Checkpoint = Field(Checkpoint(), description="Checkpoints in run.h5")
    probes: list[Probe] = Field([], description="Fields at points over time, each a file samples/NAME.csv")
    lines: list[Line] = Field([], description="Fields along lines over time, each a file samples/NAME.csv")
    forces: Forces | None = Field(
        None, description="Forces and torques on walls over time, in samples/forces.csv"
    )
    integrals: list[DomainIntegral] = Field(
        [], description="Integrals over the domain over time, each a file samples/NAME.csv"
    )
    bodies: BodyTable | None = Field(
        None, description="Mass, centroid, energies, ... of each body over time, in bodies.csv"
    )
    contours: Contour | None = Field(
        None, description="Lines of fraction 1/2 over time, in contours/: contours.csv, and .vtu for ParaView"
    )
    log_every: Annotated[int, Quantity("1", ">= 1")] = Field(
        1, description="A line in log.txt every so many steps"
    )
    passive: Annotated[list[str], AfterValidator(check_once), Quantity(example=["reference_map"])] = Field(
        [], description="Further fields to carry along: F_tot, reference_map, creep_strain"
    )

    @model_validator(mode="after")
    def _distinct(self) -> Output:
        names = {"forces"} if self.forces is not None else set()
        for key in ("probes", "lines", "integrals"):
            for i, name in enumerate(table.name for table in getattr(self, key)):
                if name in names:
                    expected = f"a name that no other table has, since both tables would write {name}.csv"
                    raise ParameterError(f"Output.{key}.{i}.name", name, expected)
                names.add(name)
        return self


class Units(Section):
    """The units of plain numbers, which are converted before the case is validated."""

    length: str = Field("m", description="Unit of lengths, and of x, y, z in expressions")
    time: str = Field("s", description="Unit of times, and of t in expressions")
    velocity: str = Field("m/s", description="Unit of velocities")
    acceleration: str = Field("m/s^2", description="Unit of accelerations")
    density: str = Field("kg/m^3", description="Unit of densities")
    pressure: str = Field("Pa", description="Unit of stresses and elastic moduli")
    viscosity: str = Field("Pa s", description="Unit of viscosities and the creep modulus")


class CaseSections(Section):
    """All sections of a case file."""

    title: Annotated[str, Quantity(example="A block under gravity")] = Field(
        "", description="Title of the case, for logs and pictures"
    )
    units: Units = Field(Units(), description="Units of plain numbers; default SI")
    domain: Domain = Field(description="The domain and its mesh")
    material: MaterialSection | None = Field(
        None, description="The material: its variables and its stored energy"
    )
    bodies: list[BodySection] = Field(
        [], description="Bodies of different materials, each an element of the array, instead of [material]"
    )
    time: Time = Field(description="Step length and end time")
    walls: dict[str, WallSection] = Field(
        {}, description="Conditions on the walls, by the walls' names; default Slip"
    )
    rheology: Rheology = Field(Rheology(), description="Dissipative mechanisms, each a table of its own")
    loads: list[LoadSection] = Field([], description="Forces, each an element of the array")
    initial: Initial = Field(Initial(), description="The state at t = 0")
    discretisation: Discretisation = Field(Discretisation(), description="Orders in space")
    solver: Solver = Field(Solver(), description="Method and tolerances of a step's solver")
    output: Output = Field(Output(), description="Files of the run directory")

    @model_validator(mode="after")
    def _consistent(self) -> CaseSections:
        if self.material is None and not self.bodies:
            raise ParameterError("material", None, "a table [material], or bodies, [[bodies]]")
        if (interval := self.output.vtk.interval) is not None:
            key, reason = "output.vtk.interval", f"so that there are at most {_MAX_OUTPUT_TIMES} output times"
            _require_length(key, interval, self.time.until, _MAX_OUTPUT_TIMES, reason)
            self.time.built.stepper().check(key, interval)
        return self
