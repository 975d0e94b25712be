"""What is known at a point of a Rothe step: old fields, step length, upwinding, loads."""

from __future__ import annotations

from typing import TypeVar

from ngsolve import (
    EDGE,
    FACE,
    L2,
    CoefficientFunction,
    FacetFESpace,
    GridFunction,
    Mesh,
    Parameter,
    TaskManager,
    specialcf,
)

from ngvisco.forms.energy import StoredEnergy
from ngvisco.forms.facets import boundary_facets, facets_with_two_sides
from ngvisco.forms.fields import Fields
from ngvisco.forms.rates import Rates
from ngvisco.forms.upwinding import Upwinding
from ngvisco.physics.model import Model
from ngvisco.physics.time import time

__all__ = ["Context", "cell_size", "inner_facets", "time"]

Value = TypeVar("Value")


class Context:
    """Parameters and known fields of a Rothe step: (rho, m, z)_old to (rho, m, z) by one length tau.

    m is the momentum functional <m, w> = int rho v . w.  The old values are those of a state, or what a
    time scheme combines of several (``ngvisco.timestepping``).
    """

    def __init__(
        self,
        mesh: Mesh,
        model: Model,
        old: Fields,
        wind: CoefficientFunction,
        energy: StoredEnergy | None = None,
        momentum_old: CoefficientFunction | None = None,
    ) -> None:
        """``wind`` is the velocity v* of the upwinding, m/s.

        ``energy`` may be None where the material's energy has an expression.

        ``momentum_old`` are the values of m_old at the points of the forms' rule, kg/(m^2 s); None for
        rho_old v_old.
        """
        self.mesh, self.old = mesh, old
        self.energy = energy or StoredEnergy(model.material, mesh.dim)
        self.rates = Rates(model, mesh.dim)
        self._momentum_old = momentum_old
        self.tau = Parameter(1.0)
        """Length of the Rothe step, s."""
        self.loads_from, self.loads_over = Parameter(0.0), Parameter(1.0)
        """Start and length of the interval over which loads are averaged, s."""
        self.eta = Parameter(1e-6)
        """Width of the smoothed sign of v* . n, m/s."""
        self.curvature = Parameter(1e-6)
        """Curvature of v below which the interior penalty stops following hess v, 1/(m s)."""
        self.normal = specialcf.normal(mesh.dim)
        self.inner = inner_facets(mesh)
        self.h = cell_size(mesh)
        self.upwinding = Upwinding(wind * self.normal, self.inner, self.eta)
        """On a cell's boundary only."""

    @property
    def momentum_old(self) -> CoefficientFunction:
        """m_old, kg/(m^2 s), at the points of the forms' rule."""
        return self.old.rho * self.old.v if self._momentum_old is None else self._momentum_old

    def set_step(self, tau: float, end: float, loads_from: float, loads_over: float) -> None:
        """A Rothe step of length ``tau`` (s) whose unknowns belong to the time ``end`` (s).

        Loads are averaged over ``loads_over`` (s, 0 for a value at one time) from ``loads_from`` (s) on.
        """
        self.tau.Set(tau)
        self.loads_from.Set(loads_from)
        self.loads_over.Set(loads_over)
        time.Set(end)

    def rate(self, difference: Value) -> Value:
        """difference/tau, of coefficient functions, numbers, arrays or matrices: the only place with 1/tau.

        A number gives a coefficient function, which follows the step's length.
        """
        follows = isinstance(difference, (CoefficientFunction, int, float))
        return difference / (self.tau if follows else self.tau.Get())

    def given(self, value: CoefficientFunction) -> CoefficientFunction:
        """A function of place and time that a term reads, at the end of the step: ``value`` itself.

        It takes arrays to the same function at their points, which they do not combine with otherwise.
        """
        return value

    def average(self, value: CoefficientFunction) -> CoefficientFunction:
        """The mean over ``loads_over`` by two Gauss points in time (exact for cubic functions of time;
        paper: g^k_{delta tau}).
        """
        spread = 0.5 / 3**0.5
        early, late = (
            value.Replace({time: self.loads_from + s * self.loads_over}) for s in (0.5 - spread, 0.5 + spread)
        )
        return 0.5 * (early + late)


def periodic_facets(mesh: Mesh) -> set[int]:
    """Numbers of the boundary facets that the mesh identifies with another one."""
    kind = EDGE if mesh.dim == 2 else FACE
    return {nr for pair, _ in mesh.GetPeriodicNodePairs(kind) for nr in pair}


def inner_facets(mesh: Mesh) -> GridFunction:
    """1 on facets between two cells, also identified ones and interfaces, 0 on walls.

    Nothing is carried through a wall.
    """
    indicator = GridFunction(FacetFESpace(mesh, order=0))
    wall = boundary_facets(mesh) & ~facets_with_two_sides(mesh)
    wall[list(periodic_facets(mesh))] = False
    indicator.vec.FV().NumPy()[:] = ~wall
    return indicator


def cell_size(mesh: Mesh) -> GridFunction:
    """Cellwise h = |K|^{1/d} times a shape constant: the length in penalties and CFL numbers."""
    size = GridFunction(L2(mesh, order=0))
    with TaskManager():
        size.Set(specialcf.mesh_size)
    return size
