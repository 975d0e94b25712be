"""The data of a Rothe step at a point: old fields, step length, upwinding, loads."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Protocol, TypeVar

from ngsolve import (
    CF,
    L2,
    CoefficientFunction,
    GridFunction,
    Mesh,
    Parameter,
    Region,
    TaskManager,
    VectorL2,
    specialcf,
    x,
    y,
    z,
)

from ngvisco.errors import InputWarning
from ngvisco.forms.energy import StoredEnergy
from ngvisco.forms.mesh.mesh_arrays import inner_facets
from ngvisco.forms.rates import Rates
from ngvisco.forms.spaces import Layout
from ngvisco.forms.time_means import TOLERANCE, TimeMean, mean_in_cells, mean_on_walls
from ngvisco.forms.unknown_values import UnknownValues
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.bodies import Interface
from ngvisco.physics.model import Model
from ngvisco.physics.signals import may_read_time, time

__all__ = ["Context", "cell_size", "inner_facets", "time"]

Difference = TypeVar("Difference")


class Crossing(Protocol):
    """A wall that matter crosses, as seen by ``Context``; ``boundary.wall_terms.Carried`` is one."""

    indicator: CoefficientFunction
    region: Region
    given: Any
    """Given state of the inflow, with a method ``mapped``."""
    means: Any
    """Means of the given state over the step."""

    def continues(self, name: str) -> bool:
        """Whether the wall gives no value of ``name``, ``"rho"`` or ``"z"``, so that the inner value is
        used."""
        ...


class Context:
    """Parameters and known fields of a Rothe step from (rho, m, z)_old to (rho, m, z), of one length tau.

    m is the momentum functional <m, w> = int rho v . w.  The old values are a state, or a time scheme's
    combination of several states (``ngvisco.timestepping``).
    """

    def __init__(
        self,
        mesh: Mesh,
        model: Model,
        old: UnknownValues,
        energy: StoredEnergy | None = None,
        momentum_old: CoefficientFunction | None = None,
        degree: int = 8,
        passages: Sequence[Crossing] = (),
    ) -> None:
        """Make the context; ``energy`` may be None if the material's energy has an expression.

        ``momentum_old`` has the values of m_old, kg/(m^2 s), at the points of the forms' rule, which has the
        degree ``degree``; with None m_old is rho_old v_old.  ``passages`` are the walls that matter
        crosses.
        """
        self.mesh, self.old = mesh, old
        self.energy = energy or StoredEnergy(model.material, mesh.dim)
        self.rates = Rates(model, mesh.dim, old.layout.symmetry.is_axisymmetric)
        self.recovered_slopes: dict[Interface, CoefficientFunction] = {}
        """Slopes of the quantities that mark interfaces (``RecoveredSlope``), for fields that are constant in
        cells."""
        self.lagged: UnknownValues = old
        """Fields at the step's start; conjugates read the material's lagged variables in them."""
        self.terms: Sequence[Any] = ()
        """The terms of the step, ``ngvisco.forms.term.Term``."""
        self._momentum_old = momentum_old
        self.tau = Parameter(1.0)
        """Length of the Rothe step, s."""
        self._window = Parameter(0.0), Parameter(1.0), Parameter(0.0)
        self._degree = degree
        self._means: dict[tuple[CoefficientFunction, str, bool], tuple[GridFunction, TimeMean]] = {}
        self._averaged: tuple[float, float, float] | None = None
        self._has_warned = False
        self.curvature = Parameter(1e-6)
        """Size of hess v below which the interior penalty does not depend on hess v, 1/(m s)."""
        self.normal = specialcf.normal(mesh.dim)
        self.inner = inner_facets(mesh)
        self.h = cell_size(mesh)
        self.crossed, self.passages = self.inner, tuple(passages)
        """Indicator of facets that matter crosses: 1 between cells and on ``passages``, 0 on other walls."""
        self.reach: CoefficientFunction | None = None
        """Position relative to the middle of the cell, m; None without inflow, or for z in P_0."""
        if passages:
            self.crossed = self.inner + sum((passage.indicator for passage in passages), CF(0.0))
            if old.layout.unknowns["z"].order:
                self.reach = from_middle(mesh)
            for wall in passages:  # an average with a tilted weight may be negative for a positive density
                wall.means = wall.given.mapped(partial(self.average, walls=wall.region, is_even=True))

    @property
    def momentum_old(self) -> CoefficientFunction:
        """Old momentum m_old, kg/(m^2 s), at the points of the forms' rule."""
        return self.old.rho * self.old.v if self._momentum_old is None else self._momentum_old

    @momentum_old.setter
    def momentum_old(self, momentum: CoefficientFunction) -> None:
        self._momentum_old = momentum

    def set_step(
        self, tau: float, end: float, loads_from: float, loads_over: float, loads_tilt: float = 0.0
    ) -> None:
        """Set the length ``tau`` (s) of the Rothe step, and the time ``end`` (s) of its unknowns.

        Loads are averaged over ``loads_over`` (s, 0 for a value at one time) from ``loads_from`` (s) on, with
        the weight of ``ngvisco.forms.time_means.Rule``.
        """
        self.tau.Set(tau)
        self.set_loads(loads_from, loads_over, loads_tilt)
        time.Set(end)

    def set_loads(self, begin: float, over: float, tilt: float = 0.0) -> None:
        """Average loads over ``over`` (s, 0 for a value at one time) from ``begin`` (s) on.

        The average has the weight 1 + 12 ``tilt`` (s - 1/2), with s from 0 to 1 over the interval
        (``Rule.tilted``).
        """
        for parameter, value in zip(self._window, (begin, over, tilt), strict=True):
            parameter.Set(value)
        if self.loads_window == self._averaged:
            return
        for (_, on_wall, is_even), (_, mean) in self._means.items():
            error = mean.update(begin, over, 0.0 if is_even else tilt)
            self.require_mean("a traction" if on_wall else "a load", error)
        self._averaged = self.loads_window

    @property
    def loads_window(self) -> tuple[float, float, float]:
        """Start and length of the interval over which loads are averaged, s, and the tilt of the weight."""
        begin, over, tilt = (parameter.Get() for parameter in self._window)
        return begin, over, tilt

    def require_mean(self, name: str, error: float) -> None:
        """Warn once if the error of a mean over the step exceeds the tolerance."""
        if error <= TOLERANCE or self._has_warned:
            return
        self._has_warned = True
        Communicator.of(self.mesh).warn(
            f"the mean of {name} over the step from t = {self.loads_window[0]:g} s has an error of "
            f"{error:.0e} relative to the largest value, since the values change too often in the step, or "
            "change at other times in other places; take shorter steps",
            InputWarning,
            stacklevel=2,
        )

    def rate(self, difference: Difference) -> Difference:
        """Return difference/tau for a function, number, array or matrix; only this method divides by tau.

        For a number the result is a coefficient function, which follows the step's length.
        """
        follows = isinstance(difference, (CoefficientFunction, int, float))
        return difference / (self.tau if follows else self.tau.Get())

    def given(self, value: CoefficientFunction) -> CoefficientFunction:
        """Return a term's function of place and time at the end of the step: ``value``, unchanged.

        The context of arrays returns the function's values at their points instead.
        """
        return value

    def average(
        self, value: CoefficientFunction, walls: Region | None = None, is_even: bool = False
    ) -> CoefficientFunction:
        """The mean over ``loads_over`` to ``ngvisco.forms.time_means.TOLERANCE`` (paper: g^k_{delta tau}).

        Every ``set_loads`` updates the mean of a function of time; any other ``value`` is returned as it is.
        The mean holds in cells, or on the facets of ``walls``.  If ``is_even`` is True, all times of the step
        have equal weights in every stage of a scheme, so that the mean of positive values is positive.
        """
        if not may_read_time(value):
            return value
        key = value, "" if walls is None else str(walls.Mask()), is_even
        if key not in self._means:
            self._means[key] = self._mean(value, walls, is_even)
        return _shaped(self._means[key][0], value)

    def average_now(self, value: CoefficientFunction) -> CoefficientFunction:
        """The present mean in cells of a function that no form contains; later steps do not update it."""
        if (value, "", False) in self._means or not may_read_time(value):
            return self.average(value)
        return _shaped(self._mean(value, None)[0], value)

    def _mean(
        self, value: CoefficientFunction, walls: Region | None, is_even: bool = False
    ) -> tuple[GridFunction, TimeMean]:
        mean_of = mean_in_cells if walls is None else partial(mean_on_walls, walls=walls)
        mean = mean_of(value, self.mesh, self._degree)
        begin, over, tilt = self.loads_window
        mean[1].update(begin, over, 0.0 if is_even else tilt)
        return mean


class AskedContext:
    """A context that records the names of the attributes read from it."""

    def __init__(self, context: Context) -> None:
        self._context, self.names = context, set[str]()

    def __getattr__(self, name: str) -> Any:
        self.names.add(name)
        return getattr(self._context, name)


class StepLayout(Layout):
    """The layout of a step's unknowns, with the data of the step."""

    context: Context
    """The data, set by the layout's owner (``ngvisco.forms.system.Step``)."""


def _shaped(function: GridFunction, value: CoefficientFunction) -> CoefficientFunction:
    if not value.dims:
        return function.components[0] if function.components else function
    vector = function if function.dim == value.dim else CF(tuple(function.components))
    return vector.Reshape(tuple(value.dims))


def cell_size(mesh: Mesh) -> GridFunction:
    """Size of each cell, h = |K|^{1/d} times a shape constant, for penalties and CFL numbers."""
    size = GridFunction(L2(mesh, order=0))
    with TaskManager():
        size.Set(specialcf.mesh_size)
    return size


def from_middle(mesh: Mesh) -> CoefficientFunction:
    """Position x - x_K, m, relative to the middle x_K of the cell."""
    middle, place = GridFunction(VectorL2(mesh, order=0)), CF((x, y, z)[: mesh.dim])
    with TaskManager():
        middle.Set(place)
    return place - middle
