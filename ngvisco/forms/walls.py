"""Walls: impenetrability v.n = 0 with a free tangential part (paper: Euler-small-BC-hyper).

On a wall parallel to the axes the condition is one component of v, constrained exactly in the space.
Anything that a wall adds to the system as a form (a multiplier for an oblique or curved wall, friction,
traction) is a ``Term`` that ``wall_terms`` returns; the step sums it like every other.  Wall terms are
integrals over cell boundaries with a facetwise indicator of the wall, so that they have the quadrature
of all facet terms.  On curved geometries the mesh must be curved (``mesh.Curve(order)``): v.n = 0 on
polygons that approach a curved wall locks v (Babuska).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from ngsolve import (
    BND,
    CF,
    BaseVector,
    CoefficientFunction,
    Compress,
    FacetFESpace,
    FESpace,
    GridFunction,
    Integrate,
    Mesh,
    specialcf,
)

from ngvisco.errors import MeshError, ParameterError, UnknownNameError
from ngvisco.forms.context import Context, Entry, Integrand, Term, periodic_facets
from ngvisco.forms.orientation import check_orientation
from ngvisco.forms.spaces import Fields, Layout
from ngvisco.physics.model import as_vector
from ngvisco.physics.walls import NavierFriction, NoSlip, PrescribedTangential, Slip, Traction, Wall

_PARALLEL = 1e-10
_OPEN = 1e-3  # |V.n|^2/|V|^2 that the geometry's approximation may leave of a tangential velocity


def check_mesh(mesh: Mesh) -> None:
    """Raise MeshError unless the mesh is 2D or 3D, has volume elements and none is inverted."""
    if mesh.dim not in (2, 3):
        raise MeshError(f"the mesh has dimension {mesh.dim}: expected 2 (plane strain) or 3")
    if mesh.ne == 0:
        raise MeshError("the mesh has no volume elements: mesh the interior, not only its surface")
    check_orientation(mesh)


def check_boundary_names(mesh: Mesh, names: Iterable[str]) -> None:
    """Raise UnknownNameError for a name that no boundary of the mesh has; NGSolve stays silent."""
    known = set(mesh.GetBoundaries())
    for name in names:
        if name not in known:
            raise UnknownNameError("boundary", name, known)


def axis_parallel_walls(mesh: Mesh) -> tuple[list[list[str]], list[str]]:
    """For each axis the boundaries normal to it, and the boundaries that are normal to none."""
    n = specialcf.normal(mesh.dim)
    walls: list[list[str]] = [[] for _ in range(mesh.dim)]
    others: list[str] = []
    for name in sorted(set(mesh.GetBoundaries())):
        region = mesh.Boundaries(_exactly(name))
        area = Integrate(CF(1.0), mesh, BND, definedon=region)
        tilt = [abs(Integrate(1 - n[i] * n[i], mesh, BND, definedon=region)) for i in range(mesh.dim)]
        axis = int(np.argmin(tilt))
        (walls[axis] if tilt[axis] <= _PARALLEL * area else others).append(name)
    return walls, others


def slip_constraints(mesh: Mesh) -> tuple[str, ...]:
    """Boundary pattern for v_i = 0, one for each i, that makes every wall impenetrable.

    Raises
    ------
    MeshError
        If a wall is not parallel to the axes.
    """
    walls, others = axis_parallel_walls(mesh)
    if others:
        raise MeshError(
            f"boundary {others[0]!r} is not normal to an axis: expected walls parallel to the axes"
        )
    return tuple("|".join(_exactly(name) for name in names) for names in walls)


Conditions: TypeAlias = "Mapping[str | tuple[str, ...], Wall] | Sequence[tuple[str | tuple[str, ...], Wall]]"


class Walls:
    """Which condition holds on which boundary of a mesh, and what the spaces must do for it.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    conditions : mapping of boundary names (or tuples of them) to Wall objects, or pairs of these
        Boundaries that are not named slip; boundaries that the mesh identifies are no walls.

    Raises
    ------
    UnknownNameError
        For a name that the mesh does not have.
    ParameterError
        If a boundary is given two conditions, is periodic, or the condition is no Wall.
    """

    def __init__(self, mesh: Mesh, conditions: Conditions | None = None) -> None:
        self.mesh = mesh
        self.periodic = periodic_boundaries(mesh)
        given = _by_name(conditions or {})
        check_boundary_names(mesh, given)
        for name in given:
            if name in self.periodic:
                raise ParameterError(
                    f"walls[{name!r}]", given[name], "no condition: it is a periodic boundary"
                )
        names = sorted(set(mesh.GetBoundaries()) - self.periodic)
        self.conditions: dict[str, Wall] = {name: given.get(name, Slip()) for name in names}
        self.axis, self.oblique = axis_parallel_walls(mesh)
        self.axis = [[name for name in group if name in self.conditions] for group in self.axis]
        fixed = self._having(NoSlip, PrescribedTangential)
        self.multiplied = [n for n in self.oblique if n in self.conditions and n not in fixed]
        """Oblique or curved walls, where v.n = 0 is held by a multiplier."""
        for name, wall in self.conditions.items():
            if isinstance(wall, PrescribedTangential):
                as_vector(wall.velocity, mesh.dim, f"walls[{name!r}].velocity")
            if isinstance(wall, Traction):
                as_vector(wall.f, mesh.dim, f"walls[{name!r}].f")

    def _having(self, *kinds: type[Wall]) -> list[str]:
        return [name for name, wall in self.conditions.items() if isinstance(wall, kinds)]

    @property
    def dirichlet(self) -> tuple[str, ...]:
        """Boundary pattern for a prescribed v_i, one for each i."""
        fixed = self._having(NoSlip, PrescribedTangential)
        return tuple(pattern([*names, *fixed]) for names in self.axis)

    @property
    def homogeneous(self) -> tuple[str, ...]:
        """Boundary pattern for v_i = 0: as ``dirichlet`` without what is prescribed and not zero."""
        return tuple(pattern([*names, *self._having(NoSlip)]) for names in self.axis)

    def multiplier_space(self, k: int) -> FESpace | None:
        """Space of the multiplier of v.n = 0 for velocities in P_k: P_{k-1} in 2D and P_{k-2} in 3D.

        On a facet chain of n edges that ends where v is constrained there are n k - 1 traces v.n, so
        in 2D the edges at such ends (a fillet that runs into a plane wall) have P_{k-2}.  In 3D P_{k-1}
        has more unknowns than there are normal traces.
        """
        if not self.multiplied:
            return None
        mesh = self.mesh
        order = k - 1 if mesh.dim == 2 else k - 2
        space = FacetFESpace(mesh, order=order)
        active = space.GetDofs(mesh.Boundaries(pattern(self.multiplied)))
        others = [name for name in self.conditions if name not in self.multiplied]
        if mesh.dim == 2 and others:
            ends = {v for e in mesh.Boundaries(pattern(others)).Elements() for v in e.vertices}
            for element in mesh.Boundaries(pattern(self.multiplied)).Elements():
                if ends.intersection(element.vertices):
                    active[max(space.GetDofNrs(element))] = False
        return Compress(space, active)


def periodic_boundaries(mesh: Mesh) -> set[str]:
    """Names of the boundaries that the mesh identifies with each other.

    Raises
    ------
    MeshError
        If only a part of a name's boundary is identified.
    """
    facets = periodic_facets(mesh)
    names: dict[str, set[bool]] = {}
    if facets:
        for element in mesh.Elements(BND):
            own = element.edges if mesh.dim == 2 else element.faces
            names.setdefault(element.mat, set()).add(own[0].nr in facets)
    for name, kinds in names.items():
        if len(kinds) == 2:
            raise MeshError(f"boundary {name!r} is periodic in a part only: give that part a name of its own")
    return {name for name, kinds in names.items() if True in kinds}


class Impenetrability:
    """Multiplier form of v.n = 0 on oblique and curved walls: int_Gamma lambda (w.n) + mu (v.n) = 0.

    lambda is the normal stress of the wall, Pa.  Its power int lambda (v.n) vanishes exactly, by the
    equation's own row mu = lambda, so that it has no entry in the ledger.  Nothing is carried through the
    wall whatever the pointwise residue of v.n (Context.normal_velocity).
    """

    def __init__(self, context: Context, walls: Walls) -> None:
        self.context = context
        self.indicator = facet_indicator(walls.mesh, walls.multiplied)

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        n = self.context.normal
        return [
            Integrand(facets=self.indicator * u.wall_stress * (w.v * n)),
            Integrand(facets=self.indicator * w.wall_stress * (u.v * n)),
        ]

    def entries(self, u: Fields) -> list[Entry]:
        return []


class TangentialStress:
    """-int_Gamma f_t . w_t + int_Gamma c v_t . w_t (paper: rem-f-ne-0) on one wall."""

    def __init__(self, context: Context, walls: Walls, name: str) -> None:
        self.context, self.name = context, name
        self.indicator = facet_indicator(walls.mesh, [name])
        wall = walls.conditions[name]
        self.f: CoefficientFunction | None = None
        self.friction: CoefficientFunction | None = None
        if isinstance(wall, Traction):
            f = as_vector(wall.f, walls.mesh.dim, "Traction.f")
            self.f = self._tangential(context.average(f))
            if wall.friction:
                self.friction = CF(wall.friction)
        elif isinstance(wall, NavierFriction):
            self.friction = CF(wall.coefficient)

    def _tangential(self, a: CoefficientFunction) -> CoefficientFunction:
        n = self.context.normal
        return a - (a * n) * n

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        parts = []
        if self.f is not None:
            parts.append(Integrand(facets=-self.indicator * (self.f * w.v)))
        if self.friction is not None:
            parts.append(Integrand(facets=self.indicator * self.friction * (self._tangential(u.v) * w.v)))
        return parts

    def entries(self, u: Fields) -> list[Entry]:
        entries = []
        if self.f is not None:
            power = Integrand(facets=self.indicator * (self.f * u.v))
            entries.append(Entry(f"power_traction_{self.name}", "power", power))
        if self.friction is not None:
            v_t = self._tangential(u.v)
            loss = Integrand(facets=self.indicator * self.friction * (v_t * v_t))
            entries.append(Entry(f"dissipation_friction_{self.name}", "dissipation", loss))
        return entries


class MovingWalls:
    """The constrained coefficients of v: zero, or a prescribed wall velocity at the end of the step.

    The rows of R(u; .) at these coefficients are not zero but the wall's reaction; tested by v they
    give its power, which is what is missing in R(u; v) = 0 for the energy identity.
    """

    def __init__(self, walls: Walls, layout: Layout, state: GridFunction) -> None:
        self.walls, self.layout, self.state = walls, layout, state
        mesh = walls.mesh
        self._values = GridFunction(layout.blocks["v"])
        self.fixed = self._constrained(layout, walls.dirichlet)
        self.zero = self._constrained(layout, walls.homogeneous)
        self.moving: dict[str, tuple[CoefficientFunction, np.ndarray]] = {}
        taken = self.zero.copy()
        for name, wall in walls.conditions.items():
            if isinstance(wall, PrescribedTangential):
                mask = self._constrained(layout, (pattern([name]),) * mesh.dim) & ~taken
                taken |= mask
                velocity = as_vector(wall.velocity, mesh.dim, "PrescribedTangential.velocity")
                self.moving[name] = (velocity, mask)

    @staticmethod
    def _constrained(layout: Layout, patterns: Sequence[str]) -> np.ndarray:
        """Coefficients of v that these boundary patterns hold, as a mask."""
        free = np.array(list(layout.velocity_space(patterns).FreeDofs()), dtype=bool)
        unconstrained = np.array(list(layout.velocity_space(("",) * layout.mesh.dim).FreeDofs()), dtype=bool)
        return unconstrained & ~free

    def set_values(self) -> None:
        """Write the constrained coefficients of v into the state, at the present ``ngvisco.time``."""
        v = self._view()
        v[self.zero] = 0.0
        for name, (velocity, mask) in self.moving.items():
            v[mask] = self.interpolate(name, velocity)[mask]

    def interpolate(self, name: str, velocity: CoefficientFunction) -> np.ndarray:
        """Coefficients on the wall of the tangential part of a velocity.

        Raises
        ------
        ParameterError
            If the velocity has a normal part, i.e. the wall would be open.
        """
        mesh = self.walls.mesh
        region = mesh.Boundaries(pattern([name]))
        n = specialcf.normal(mesh.dim)
        normal = velocity * n
        size = Integrate(velocity * velocity, mesh, BND, definedon=region)
        through = Integrate(normal * normal, mesh, BND, definedon=region)
        if not through <= _OPEN * size:
            raise ParameterError(
                f"walls[{name!r}].velocity",
                f"normal part {through**0.5:.3g} of {size**0.5:.3g} in L2",
                "a tangential velocity: every wall is impenetrable, inflow and outflow are not modelled",
            )
        self._values.vec[:] = 0.0
        self._values.Set(velocity - normal * n, definedon=region)
        return self._values.vec.FV().NumPy()

    def reaction_power(self, residual: BaseVector, name: str) -> float:
        """Power of the reaction on a moving wall, W, from the residual of the solved step."""
        mask = self.moving[name][1]
        where = self.layout.ranges["v"]
        return float(residual.FV().NumPy()[where][mask] @ self._view()[mask])

    def _view(self) -> np.ndarray:
        return self.state.vec.FV().NumPy()[self.layout.ranges["v"]]


def wall_terms(walls: Walls, context: Context) -> tuple[Term, ...]:
    """Terms by which walls enter the system; none where the space holds the condition."""
    terms: list[Term] = [Impenetrability(context, walls)] if walls.multiplied else []
    terms += [
        TangentialStress(context, walls, name)
        for name, wall in walls.conditions.items()
        if isinstance(wall, (Traction, NavierFriction))
    ]
    return tuple(terms)


def facet_indicator(mesh: Mesh, names: Iterable[str]) -> GridFunction:
    """1 on the facets of these boundaries, 0 on all others."""
    space = FacetFESpace(mesh, order=0)
    indicator = GridFunction(space)
    indicator.vec.FV().NumPy()[:] = list(space.GetDofs(mesh.Boundaries(pattern(names))))
    return indicator


def pattern(names: Iterable[str]) -> str:
    """A regular expression that matches these boundary names and no other."""
    return "|".join(_exactly(name) for name in names)


def _by_name(conditions: Conditions) -> dict[str, Wall]:
    pairs = conditions.items() if isinstance(conditions, Mapping) else conditions
    result: dict[str, Wall] = {}
    for key, wall in pairs:
        for name in (key,) if isinstance(key, str) else tuple(key):
            if not isinstance(wall, Wall):
                raise ParameterError(f"walls[{name!r}]", wall, "one Wall object, e.g. Slip() or NoSlip()")
            if name in result:
                raise ParameterError(f"walls[{name!r}]", (result[name], wall), "one condition, not two")
            result[name] = wall
    return result


def _exactly(name: str) -> str:
    """A regular expression that matches this boundary name and no other."""
    return "".join(c if c.isalnum() or c == "_" else "\\" + c for c in name)
