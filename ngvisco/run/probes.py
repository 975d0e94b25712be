"""Observers that measure fields at points and along lines, forces on walls, and integrals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.errors import Declared, ParameterError, Quantity, planar, require_collection, require_some_names
from ngvisco.expressions import ExpressionError, parse
from ngvisco.forms.mesh.locating import Located, as_points
from ngvisco.forms.reactions import WallReactions
from ngvisco.run.fields import component_fields, components
from ngvisco.run.files import AnyPath
from ngvisco.run.series import FIRST, Every, Series

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation


class Probes(Series):
    """Fields at points that are fixed in space, over time.

    The parameters ``path`` and ``every`` are those of ``Series``.
    The columns are ``step``, ``time`` (s), and ``NAME.FIELD`` in the fields' SI units; a vector or tensor
    gives all its components.
    A run raises ParameterError for a point outside the domain, UnknownNameError for an unknown field.

    Parameters
    ----------
    points : mapping of names to points, or a sequence of points (named ``p1``, ``p2``, ...)
        Coordinates in m; their number is the mesh's dimension.
    fields : sequence of str, optional
        Names of fields or of their components; default those of a VTK series.
    """

    def __init__(
        self,
        points: Mapping[str, Sequence[float]] | Sequence[Sequence[float]],
        fields: Annotated[Sequence[str] | None, Quantity(example=["velocity", "F_12"])] = None,
        path: AnyPath | None = None,
        every: Every = 1,
    ) -> None:
        super().__init__(path, every)
        if not isinstance(points, Mapping):
            some = require_collection("Probes.points", points, "points, or a mapping of names to points")
            points = {f"p{i + 1}": point for i, point in enumerate(some)}
        if not points:
            raise ParameterError("Probes.points", points, "at least one point")
        self.points, self.fields = dict(points), _chosen("Probes", fields)

    def prepare(self, simulation: Simulation) -> list[str]:
        mesh, named = simulation.mesh, {f"Probes.points[{name!r}]": p for name, p in self.points.items()}
        at = np.array([_one_point(name, point, mesh.dim) for name, point in named.items()])
        self._at = Located(mesh, at, list(named))
        self._values, columns = _stacked(self, simulation)
        return [f"{name}.{column}" for name in self.points for column in columns]

    def _sample(self, simulation: Simulation) -> Any:
        return [self._at.values(self._values).ravel()]


POINTS = Declared("from 2 to 100000", (int,))
"""Number of points along a line."""


class LineSamples(Series):
    """Fields along a line, over time; each point has a row for each time.

    Raises ParameterError if a parameter is out of its range.

    The parameters ``path`` and ``every`` are those of ``Series``.
    The columns are ``step``, ``time`` (s), ``s`` (distance from the start, m), ``x``, ``y``, in 3D ``z`` (m),
    and the fields in SI units.

    Parameters
    ----------
    start : sequence of numbers, m
        One end of the line, a coordinate for each dimension.
    end : sequence of numbers, m
        The other end of the line.
    points : int
        Number of points, equally spaced, the ends included.
    fields : sequence of str, optional
        Names of fields or of their components; default those of a VTK series.
    """

    def __init__(
        self,
        start: Annotated[Sequence[float], Quantity("m", example=[0.0, 0.5])],
        end: Annotated[Sequence[float], Quantity("m", example=[1.0, 0.5])],
        points: Annotated[int, Quantity("1", POINTS.range)] = 101,
        fields: Annotated[Sequence[str] | None, Quantity(example=["velocity", "F_12"])] = None,
        path: AnyPath | None = None,
        every: Every = 1,
    ) -> None:
        super().__init__(path, every)
        self.points = POINTS.taken("LineSamples.points", points)
        self.ends, self.fields = (start, end), _chosen("LineSamples", fields)

    def prepare(self, simulation: Simulation) -> list[str]:
        mesh = simulation.mesh
        a = _one_point("LineSamples.start", self.ends[0], mesh.dim)
        b = _one_point("LineSamples.end", self.ends[1], mesh.dim)
        length = float(np.linalg.norm(b - a))
        if length == 0:
            raise ParameterError("LineSamples.end", b.tolist(), "a point that differs from start")
        share = np.linspace(0, 1, self.points)[:, None]
        where = (1 - share) * a + share * b
        self._at = Located(mesh, where, ["LineSamples.start", *["LineSamples.end"] * (self.points - 1)])
        self._place = np.hstack([share * length, where])
        self._values, columns = _stacked(self, simulation)
        return ["s", *"xyz"[: mesh.dim], *columns]

    def _said(self, column: str, row: list[float]) -> str:
        return f"{column!r} at s = {row[2]:.4g} m"

    def _sample(self, simulation: Simulation) -> Any:
        return np.hstack([self._place, self._at.values(self._values)])


class WallForces(Series):
    """Force and torque that the body exerts on walls, over time.

    Raises ParameterError if a parameter is out of its range.

    The parameters ``path`` and ``every`` are those of ``Series``.  The columns are ``WALL.force_1`` ... (N)
    and ``WALL.torque`` (2D) or ``WALL.torque_1`` ... (N m), per metre of thickness in plane strain; for a
    body of revolution ``WALL.force_2``, N over 2 pi.  Forces are the reactions of the solved equations, by
    the elastic, viscous and hyperviscous stress (``ngvisco.forms.reactions``).  A row has means over the
    stages of the step that ends at the row's time, with the scheme's weights; hence the start has no row.
    Backward Euler gives the forces at the step's end, the midpoint rule at its middle.

    Parameters
    ----------
    walls : sequence of str, optional
        Names of walls; default all walls.
    about : sequence of numbers, optional
        Reference point of torques, m; default the origin.
    """

    initial = False

    def __init__(
        self,
        walls: Annotated[Sequence[str] | None, Quantity(example=["left"])] = None,
        about: Annotated[Sequence[float] | None, Quantity("m", example=[0.5, 0.5])] = None,
        path: AnyPath | None = None,
        every: Every = 1,
    ) -> None:
        super().__init__(path, every)
        self.walls = None if walls is None else require_some_names("WallForces.walls", walls)
        self.about = about

    def prepare(self, simulation: Simulation) -> list[str]:
        dim = simulation.mesh.dim
        about = _one_point("WallForces.about", [0.0] * dim if self.about is None else self.about, dim)
        self.reactions = WallReactions(simulation.rothe_step, self.walls, about.tolist())
        self._integrator = simulation.integrator
        self.begin()
        return [f"{name}.{part}" for name in self.reactions.names for part in self.reactions.motions]

    def start(self, simulation: Simulation) -> None:
        super().start(simulation)
        simulation.integrator.carried.append(self)

    def finish(self, simulation: Simulation) -> None:
        super().finish(simulation)
        carried = simulation.integrator.carried
        carried[:] = [field for field in carried if field is not self]

    # the integrator calls these methods, which average the forces over the stages of a step; the forces of a
    # stage are computed while the stage is the present state

    def begin(self) -> None:
        self._mean = np.zeros((len(self.reactions.names), len(self.reactions.motions)))

    def stage(self, weights: np.ndarray, share: float) -> None:
        self._mean += share * np.array(list(self.reactions().values()))

    def end(self, weights: np.ndarray) -> None:
        if self._integrator.impulse is not None:
            self._mean += self.reactions.of_rows(self._integrator.impulse)

    def _sample(self, simulation: Simulation) -> Any:
        return [self._mean.ravel()]


class Integrals(Series):
    """Integrals over the domain, over time.

    The parameters ``path`` and ``every`` are those of ``Series``.  Integrals have the quadrature of the forms
    and the ledger: the integral of ``"density"`` is the ledger's mass.  In plane strain integrals are per
    metre of thickness.  A run raises ParameterError for an integral that is not finite at its start, and
    NotANumberError for one that is not finite later.

    Parameters
    ----------
    integrands : mapping of names to coefficient functions or expressions
        An expression is a text as in case files, in ``x``, ``y``, ``z``, ``t`` and the components of the
        run's fields: ``"density*velocity_1"``, ``"max(J - 1, 0)"``, ``"von_mises*(1 if x < 0.5 else 0)"``.
    """

    def __init__(
        self,
        integrands: Mapping[str, CoefficientFunction | str],
        path: AnyPath | None = None,
        every: Every = 1,
    ) -> None:
        super().__init__(path, every)
        if not isinstance(integrands, Mapping) or not integrands:
            expected = "a mapping of names to integrands, with at least one name"
            raise ParameterError("Integrals.integrands", integrands, expected)
        for name, value in integrands.items():
            if not (isinstance(value, str) or (isinstance(value, CoefficientFunction) and value.dim == 1)):
                raise ParameterError(f"Integrals.integrands[{name!r}]", value, "a text or a scalar function")
        self.integrands = dict(integrands)

    def prepare(self, simulation: Simulation) -> list[str]:
        fields = components(simulation.fields)
        if taken := [name for name in self.integrands if name in FIRST]:
            expected = f"another name than {taken[0]!r}, since the table itself has a column of this name"
            raise ParameterError("Integrals.integrands", taken[0], expected)

        def integrand(name: str, value: Any) -> CoefficientFunction:
            key = f"Integrals.integrands[{name!r}]"
            try:
                made = parse(value, tuple(fields)).coefficient(fields) if isinstance(value, str) else value
            except ExpressionError as error:
                error.key = key
                raise
            return planar(key, made, simulation.mesh.dim)

        self._integrand = CF(tuple(integrand(name, value) for name, value in self.integrands.items()))
        for name, value in zip(self.integrands, self._totals(simulation), strict=True):
            if not np.isfinite(value):
                expected = (
                    f"an integrand with a finite integral; at t = {simulation.t:g} s the integral is {value}"
                )
                raise ParameterError(f"Integrals.integrands[{name!r}]", self.integrands[name], expected)
        return list(self.integrands)

    def _totals(self, simulation: Simulation) -> np.ndarray:
        total = simulation.rothe_step.quadrature.integrate_cells(self._integrand)
        return np.asarray(total, dtype=float).reshape(-1)

    def _sample(self, simulation: Simulation) -> Any:
        return [self._totals(simulation)]


def _one_point(name: str, value: Any, dim: int) -> np.ndarray:
    if len(points := as_points(name, value, dim)) != 1:
        raise ParameterError(name, value, "one point")
    return points[0]


def _chosen(owner: str, fields: Sequence[str] | None) -> list[str] | None:
    """Names of fields, at least one; None stands for the usual fields."""
    return None if fields is None else require_some_names(f"{owner}.fields", fields)


def _stacked(series: Probes | LineSamples, simulation: Simulation) -> tuple[CoefficientFunction, list[str]]:
    chosen = component_fields(simulation.fields, series.fields, f"{type(series).__name__}.fields")
    return CF(tuple(chosen.values())), list(chosen)
