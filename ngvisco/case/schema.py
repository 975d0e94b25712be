"""The schema of a case file: its sections, made from the dataclasses and functions of the catalogue."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, Discriminator, Field, Tag, create_model, model_validator

from ngvisco.case import catalogue
from ngvisco.case.section import Section, laws, section, tagged
from ngvisco.case.values import RegionText
from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.material import Material as MaterialObject
from ngvisco.physics.rheology import Viscosity as ViscosityObject

_MAX_OUTPUT_TIMES = 100_000
_MAX_STEPS = 100_000_000
"""Steps above which a run has no end: ten of the smallest a second make a hundred days."""


def _check_once(names: list[str]) -> list[str]:
    if len(set(names)) < len(names):
        raise ValueError("expected each name once")
    return names


Names = Annotated[list[str], Field(min_length=1), AfterValidator(_check_once)]
"""Some of what there is; all of it where the key is left out."""

Domain = tagged("geometry", catalogue.GEOMETRIES)
Material = laws(MaterialObject, catalogue.MATERIALS, catalogue.WRAPPERS, has_default=False)
Load = tagged("kind", catalogue.LOADS)
Wall = tagged("kind", catalogue.WALLS)
Shape = tagged("kind", catalogue.SHAPES)
Creep = laws(FlowRule, catalogue.FLOW_RULES, catalogue.FLOW_RULE_WRAPPERS)
Viscosity = laws(ViscosityObject, catalogue.VISCOSITIES, catalogue.VISCOSITY_WRAPPERS)
_MECHANISMS: dict[str, Any] = {"viscosity": Viscosity}
_MECHANISMS |= {name: section(target) for name, target in catalogue.MECHANISMS.items()} | {"creep": Creep}
Heat = _MECHANISMS["heat"]
Rheology: Any = create_model(
    "Rheology",
    __base__=Section,
    **{name: (part | None, None) for name, part in _MECHANISMS.items()},  # type: ignore
)
Discretisation, Initial, Solver = (
    section(catalogue.SECTIONS[name]) for name in ("discretisation", "initial", "solver")
)


class Time(section(catalogue.SECTIONS["time"])):  # type: ignore[misc]
    """Step length and end.

    Parameters
    ----------
    until
        End of the run, a multiple of dt where steps have one length.
    """

    until: Annotated[float, Quantity("s", "> 0", 1.0)]

    @model_validator(mode="after")
    def _ends(self) -> Time:
        if not 0 < self.until < math.inf:
            raise ParameterError("Time.until", self.until, "a finite number > 0")
        if self.until / self.dt > _MAX_STEPS:
            least = self.until / _MAX_STEPS
            steps = f"{self.until / self.dt:.0e} steps until = {self.until:g}"
            expected = f"at least {least:.2g}: this one makes {steps}"
            raise ParameterError("Time.dt", self.dt, expected)
        number = round(self.until / self.dt)
        if self.adaptive is None and not math.isclose(number * self.dt, self.until, rel_tol=1e-9):
            raise ParameterError("Time.until", self.until, f"a multiple of dt = {self.dt:g}")
        return self


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


def _form_of_place(value: Any) -> str:
    return "<text>" if isinstance(value, str) else "<shapes>" if isinstance(value, list) else "<shape>"


Where = Annotated[
    Annotated[RegionText, Tag("<text>")]
    | Annotated[Shape, Tag("<shape>")]  # type: ignore[valid-type]
    | Annotated[list[Shape], Tag("<shapes>")],  # type: ignore[valid-type]
    Discriminator(_form_of_place),
]
"""A condition on x, y, z, a shape, or several of them, of which it is the union."""


class Body(Section):
    """A body of one material, and where it is at the start.

    Parameters
    ----------
    name
        Letters, digits and _; fields and columns of the body begin with it.
    where
        Where the body is at the start: a condition on x, y, z, a shape, or several of which it is the union;
        what the other bodies leave without this key, which one of them at most may lack.
    material
        Its material, with the keys of [material].
    viscosity
        Its viscosity, with the keys of [rheology.viscosity].
    creep
        Its creep, with the keys of [rheology.creep].
    heat
        Its conductivity and heat source, with the keys of [rheology.heat], to which they add by its fraction.
    density
        Its density where J = 1; that of its material where this has rho_R.
    order
        Of two bodies that overlap at the start the one of higher order is there.
    """

    name: Annotated[str, Quantity(example="disc")]
    where: Where | None = None
    material: Material  # type: ignore[valid-type]
    viscosity: Viscosity | None = None  # type: ignore[valid-type]
    creep: Creep | None = None  # type: ignore[valid-type]
    heat: Heat | None = None  # type: ignore[valid-type]
    density: Annotated[float | None, Quantity("kg/m^3", "> 0", 1000.0)] = None
    order: int = 0

    @model_validator(mode="after")
    def _admitted(self) -> Body:
        if not re.fullmatch(r"[A-Za-z]\w{0,59}", self.name, re.ASCII):
            raise ParameterError("Body.name", self.name, "a letter, and then letters, digits and _")
        if self.density is not None and not 0 < self.density < math.inf:
            raise ParameterError("Body.density", self.density, "a finite number > 0: a body has mass")
        if self.where == []:
            raise ParameterError("Body.where", [], "at least one shape")
        return self


class Units(Section):
    """The units of plain numbers; they are converted before the case is validated (``ngvisco.case.units``).

    Parameters
    ----------
    length
        Of lengths, and of x, y, z in expressions.
    time
        Of times, and of t in expressions.
    velocity
        Of velocities.
    acceleration
        Of accelerations.
    density
        Of densities.
    pressure
        Of stresses and elastic moduli.
    viscosity
        Of viscosities and the creep modulus.
    """

    length: str = "m"
    time: str = "s"
    velocity: str = "m/s"
    acceleration: str = "m/s^2"
    density: str = "kg/m^3"
    pressure: str = "Pa"
    viscosity: str = "Pa s"


class CaseSections(Section):
    """A whole case file.

    Parameters
    ----------
    title
        What the case is, for logs and pictures.
    units
        Units of plain numbers; SI where nothing is said.
    domain
        The domain and its mesh.
    material
        The material: its variables and its stored energy.
    bodies
        Bodies of different material, each an element of the array, in place of [material].
    time
        Step length and end.
    walls
        What holds on the walls, by name; Slip where nothing is said.
    rheology
        Dissipative mechanisms, each a table of its own.
    loads
        Forces, each an element of the array.
    initial
        The state at t = 0.
    discretisation
        Orders in space.
    solver
        Method and tolerances of a step's solver.
    output
        What the run directory gets.
    """

    title: Annotated[str, Quantity(example="A block under gravity")] = ""
    units: Units = Units()
    domain: Domain  # type: ignore[valid-type]
    material: Material | None = None  # type: ignore[valid-type]
    bodies: list[Body] = Field(default=[])
    time: Time
    walls: dict[str, Wall] = Field(default={})  # type: ignore[valid-type]
    rheology: Rheology = Rheology()
    loads: list[Load] = Field(default=[])  # type: ignore[valid-type]
    initial: Initial = Initial()  # type: ignore[valid-type]
    discretisation: Discretisation = Discretisation()  # type: ignore[valid-type]
    solver: Solver = Solver()  # type: ignore[valid-type]
    output: Output = Output()

    @model_validator(mode="after")
    def _consistent(self) -> CaseSections:
        if self.material is None and not self.bodies:
            raise ParameterError("material", None, "a table [material], or bodies, [[bodies]]")
        self._check_bodies()
        if self.output.bodies is not None and not self.bodies:
            expected = "no such table without [[bodies]], which it is of"
            raise ParameterError("output.bodies", self.output.bodies, expected)
        names = [str(load.name) for load in self.loads]  # type: ignore[attr-defined]
        for i, name in enumerate(names):
            if name in names[:i]:
                expected = f"a name that no other load has, which is that of its power, power_{name}"
                raise ParameterError(f"loads.{i}.name", name, expected)
        interval = self.output.vtk.interval
        if interval is not None and self.time.until / interval > _MAX_OUTPUT_TIMES:
            raise ParameterError("output.vtk.interval", interval, f"at most {_MAX_OUTPUT_TIMES} output times")
        if interval is not None and self.time.adaptive is None:
            number = round(interval / self.time.dt)
            if number < 1 or not math.isclose(number * self.time.dt, interval, rel_tol=1e-9):
                expected = f"a multiple of time.dt = {self.time.dt:g}"
                raise ParameterError("output.vtk.interval", interval, expected)
        return self

    def _check_bodies(self) -> None:
        if not self.bodies:
            return
        if self.material is not None:
            expected = "no table [material] beside [[bodies]]: each of them has a material of its own"
            raise ParameterError("material.kind", self.material.kind, expected)
        for name in ("viscosity", "creep"):
            if (part := getattr(self.rheology, name)) is not None:
                expected = f"no such table beside [[bodies]]: each has {name} of its own, [bodies.{name}]"
                raise ParameterError(f"rheology.{name}", part, expected)
        for i, body in enumerate(self.bodies):
            if any(other.name == body.name for other in self.bodies[:i]):
                raise ParameterError(f"bodies.{i}.name", body.name, "a name that no other body has")
        rest = [i for i, body in enumerate(self.bodies) if body.where is None]
        if len(rest) > 1:
            expected = f"a place: bodies.{rest[0]} has none, and is what the others leave"
            raise ParameterError(f"bodies.{rest[1]}.where", None, expected)
