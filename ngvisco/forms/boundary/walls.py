"""Walls: v.n = 0 with a free tangential part (paper: Euler-small-BC-hyper), or a prescribed velocity.

On a wall parallel to the axes the space constrains one component of v exactly.  Other conditions (a
multiplier for an oblique or curved wall, friction, traction) add a form to the system. This form is a
``Term`` that ``wall_terms`` returns, and the step sums it like every other term.  Wall terms are integrals
over cell boundaries with a facetwise indicator of the wall, so that they have the quadrature of all facet
terms.  On curved geometries the mesh must be curved (``mesh.Curve(order)``): v.n = 0 on polygons that
approach a curved wall locks v (Babuska).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np
from ngsolve import (
    BND,
    H1,
    BaseMatrix,
    BaseVector,
    BilinearForm,
    BitArray,
    CoefficientFunction,
    Compress,
    FacetFESpace,
    FESpace,
    GridFunction,
    Integrate,
    LinearForm,
    Mesh,
    Region,
    ds,
    specialcf,
)

from ngvisco.errors import ParameterError
from ngvisco.forms.boundary.boundaries import (
    axis_parallel_walls,
    bend,
    check_boundary_names,
    interior_boundaries,
    periodic_boundaries,
    require_curved_cells,
    walls_of,
)
from ngvisco.forms.context import StepLayout
from ngvisco.forms.given_values import as_shape
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.spaces import Layout
from ngvisco.forms.time_means import TimeMean
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange, Interpolation
from ngvisco.physics.loads import as_vector
from ngvisco.physics.signals import may_read_time
from ngvisco.physics.tensors import inner
from ngvisco.physics.walls import NoSlip, Passage, PrescribedNormal, Slip, Traction, Wall
from ngvisco.words import call

OPEN = 1e-3  # |V.n|^2/|V|^2 that an approximate geometry may leave in a tangential velocity


Conditions: TypeAlias = "Mapping[str | tuple[str, ...], Wall] | Sequence[tuple[str | tuple[str, ...], Wall]]"


class Walls:
    """The conditions on the boundaries of a mesh, and the constraints that they put on the spaces.

    ``conditions`` maps boundary names (or tuples of names) to Wall objects, or is a sequence of such pairs.
    Unnamed boundaries slip.  Boundaries that the mesh identifies, and interfaces between cells, are no walls,
    even if they share the name of a wall.

    Raises UnknownNameError for a name that the mesh lacks; ParameterError if a boundary has two conditions,
    is periodic or an interface, or the condition is no Wall; MeshError for straight facets on a curved wall.
    """

    def __init__(self, mesh: Mesh, conditions: Conditions | None = None) -> None:
        self.mesh = mesh
        self._regions: dict[tuple[str, ...], Region] = {}
        self.periodic = periodic_boundaries(mesh)
        given = _by_name(conditions or {})
        check_boundary_names(mesh, given)
        interfaces = interior_boundaries(mesh)
        for name, wall in given.items():
            if name in self.periodic or name in interfaces:
                reason = "the boundary is periodic"
                if name in interfaces:
                    reason = "the boundary lies between cells and is not a wall"
                raise ParameterError(f"walls[{name!r}]", wall, f"no condition, since {reason}")
        names = sorted(set(mesh.GetBoundaries()) - self.periodic - interfaces)
        self.conditions: dict[str, Wall] = {name: given.get(name, Slip()) for name in names}
        self.axis, self.oblique = axis_parallel_walls(mesh)
        self.crossed = self._having(Passage)
        """Walls that matter crosses."""
        closed = [name for name in self.conditions if name not in self.crossed]
        self.pistons = self._having(PrescribedNormal)
        """Walls that matter crosses with a prescribed v.n."""
        by_components = [*closed, *self.pistons]
        self.axis = [[name for name in group if name in by_components] for group in self.axis]
        self.held = [name for name, wall in self.conditions.items() if wall.is_held]
        """Walls on which v is prescribed in full."""
        self.multiplied = [n for n in self.oblique if n in by_components and n not in self.held]
        """Oblique or curved walls, on which a multiplier holds v.n."""
        declared = [name for name, wall in self.conditions.items() if wall.straight]
        curved = [name for name in self.multiplied if name not in declared]
        require_curved_cells(mesh, {name: self.region([name]) for name in curved})
        for name in declared:
            if not bend(mesh, self.region([name])):
                expected = ", since the wall is not bent by small angles between straight facets"
                raise ParameterError(f"walls[{name!r}].straight", True, False, expected)
        for name, wall in self.conditions.items():
            if wall.moves:
                velocity_of(wall, mesh.dim, f"walls[{name!r}]")
            if isinstance(wall, Traction):
                as_vector(wall.f, mesh.dim, f"walls[{name!r}].f")

    def _having(self, *kinds: type[Wall]) -> list[str]:
        return [name for name, wall in self.conditions.items() if isinstance(wall, kinds)]

    @property
    def dirichlet(self) -> tuple[Region, ...]:
        """Regions on which v_i is prescribed, one for each i."""
        return tuple(self.region([*names, *self.held]) for names in self.axis)

    @property
    def homogeneous(self) -> tuple[Region, ...]:
        """Regions on which v_i = 0: ``dirichlet`` without walls that prescribe another velocity."""
        still = self._having(NoSlip)
        slipping = ([name for name in names if name not in self.pistons] for names in self.axis)
        return tuple(self.region([*names, *still]) for names in slipping)

    def region(self, names: Sequence[str]) -> Region:
        """Region of the walls with ``names``, without interfaces of the same names."""
        key = tuple(names)
        if key not in self._regions:
            self._regions[key] = walls_of(self.mesh, names)
        return self._regions[key]

    def multiplier_space(self, mesh: Mesh, k: int) -> FESpace:
        """Space of the multiplier of v.n = 0 for velocities in P_k: P_{k-2}, and in 2D P_2 for k = 3.

        ``mesh`` is the step's mesh or the undistributed one.  The traces v.n allow at most P_{k-1}.  In 3D
        P_{k-1} has more unknowns than there are normal traces.  In 2D, on a closed curve, P_{k-1} has as
        many unknowns as there are traces. For even k this is too many: the trace with one Legendre polynomial
        of degree k on every edge is orthogonal to P_{k-1}.  A chain of n edges with prescribed v at its ends
        has n k - 1 traces, so that the first and the last edge have one unknown less.
        """
        fine = mesh.dim == 2 and k == 3
        order = k - 1 if fine else k - 2
        space, multiplied = FacetFESpace(mesh, order=order), walls_of(mesh, self.multiplied)
        active = space.GetDofs(multiplied)
        unmultiplied = [name for name in self.conditions if name not in self.multiplied]
        if fine and unmultiplied:
            ends = _vertices(walls_of(mesh, unmultiplied))
            for element in multiplied.Elements():
                if ends[[v.nr for v in element.vertices]].any():
                    active[max(space.GetDofNrs(element))] = False
        return Compress(space, active)


def velocity_of(wall: Wall, dim: int, owner: str) -> CoefficientFunction:
    """The velocity that a wall prescribes, m/s, or the normal part of this velocity. Raises ParameterError
    for an invalid velocity."""
    field, velocity = f"{owner}.velocity", vars(wall)["velocity"]
    if wall.is_held:
        return as_vector(velocity, dim, field)
    return as_shape(field, velocity, ()) * specialcf.normal(dim)


def _vertices(region: Region) -> np.ndarray:
    """Mask of the vertices on a boundary, (vertices,); the facets may be on other ranks; collective."""
    mesh = region.mesh
    mask = np.zeros(mesh.nv)
    mask[[v.nr for element in region.Elements() for v in element.vertices]] = 1.0
    return Exchange.of(H1(mesh, order=1), Communicator.of(mesh)).sum(mask) > 0


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


class MovingWalls:
    """The constrained coefficients of v: zero, or a prescribed wall velocity.

    A Rothe step uses the mean of the wall's velocity over the interval in which loads are averaged. The
    wall's displacement over the step is then exact for any motion.  The rows of R(u; .) at these coefficients
    are the wall's reaction. Tested by v, they give the reaction's power, which is a part of the energy
    identity.
    """

    def __init__(self, walls: Walls, layout: StepLayout, state: GridFunction) -> None:
        self.walls, self.layout = walls, layout
        self._v = state.vec.FV().NumPy()[layout.ranges["v"]]
        self._values = GridFunction(layout.blocks["v"])
        self._set = Interpolation(layout.blocks["v"])
        self._inverses: dict[str, BaseMatrix] = {}
        self.zero = self.constrained(layout, walls.homogeneous)
        self.moving: dict[str, tuple[CoefficientFunction, np.ndarray]] = {}
        """For each moving wall: its velocity, and the mask of its coefficients of v."""
        self._means: dict[str, tuple[np.ndarray, TimeMean]] = {}
        prescribed, dim = self.zero.copy(), walls.mesh.dim
        for name, wall in walls.conditions.items():
            if wall.moves and name not in walls.multiplied:
                region = walls.region([name])
                is_piston = name in walls.pistons
                regions = [region if not is_piston or name in names else None for names in walls.axis]
                mask = self.constrained(layout, regions) & ~prescribed
                prescribed |= mask
                velocity = velocity_of(wall, dim, f"walls[{name!r}]")
                self.moving[name] = velocity, mask
                if may_read_time(velocity):
                    mean, make = np.zeros(np.count_nonzero(mask)), partial(self._on_wall, name)
                    self._means[name] = mean, TimeMean(velocity, walls.mesh, make, mean, region)
        self._averaged: tuple[float, float, float] | None = None

    @staticmethod
    def constrained(layout: Layout, regions: Sequence[Region | None]) -> np.ndarray:
        """Mask of the coefficients of v_i on the i-th of the regions."""
        free = mask_of(layout.velocity_space(regions).FreeDofs())
        return mask_of(layout.velocity_space((None,) * layout.mesh.dim).FreeDofs()) & ~free

    def set_values(self) -> None:
        """Write the Rothe step's constrained coefficients of v into the state."""
        context = self.layout.context
        window = context.loads_window
        if window != self._averaged:
            for name, (_, mean) in self._means.items():
                context.require_mean(f"the velocity of the wall {name!r}", mean.update(*window))
            self._averaged = window
        self._write({name: mean for name, (mean, _) in self._means.items()})

    def set_present_values(self) -> None:
        """Write the constrained coefficients of v at the present ``ngvisco.time`` into the state."""
        self._write({})

    def _write(self, means: dict[str, np.ndarray]) -> None:
        self._v[self.zero] = 0.0
        for name, (_, mask) in self.moving.items():
            self._v[mask] = means[name] if name in means else self._on_wall(name)

    def _on_wall(self, name: str) -> np.ndarray:
        velocity, mask = self.moving[name]
        return self.interpolate(name, velocity)[mask]

    def velocities(self) -> dict[str, np.ndarray]:
        """Coefficients of v on every moving wall at the present ``ngvisco.time``, m/s."""
        return {name: self._on_wall(name) for name in self.moving}

    def interpolate(self, name: str, velocity: CoefficientFunction) -> np.ndarray:
        """Coefficients of a velocity on a wall, or of the velocity's tangential part if nothing crosses the
        wall.

        Raises ParameterError for a normal part of the velocity on a wall that nothing crosses.
        """
        mesh, region = self.walls.mesh, self.walls.region([name])
        if name not in self.walls.crossed:
            n = specialcf.normal(mesh.dim)
            normal = velocity * n
            size = Integrate(velocity * velocity, mesh, BND, definedon=region)
            normal_part = Integrate(normal * normal, mesh, BND, definedon=region)
            if not normal_part <= OPEN * size:
                parts = f"{normal_part**0.5:.3g} of {size**0.5:.3g}"
                sizes = f"a velocity with a normal part ({parts} in the L2 norm)"
                expected = "a tangential velocity, since nothing crosses this wall; for an inlet take "
                inlet = call("Inflow", velocity=...)
                raise ParameterError(f"walls[{name!r}].velocity", sizes, expected, inlet)
            velocity = velocity - normal * n
        self._values.vec[:] = 0.0
        if self.layout.periodic:
            self._project(name, velocity)
        else:
            self._set(self._values, velocity, region)
        return self._values.vec.FV().NumPy()

    def _project(self, name: str, velocity: CoefficientFunction) -> None:
        """Project in L2 on the wall. NGSolve's ``Set`` is wrong on a facet that contains a vertex and the
        periodic image of this vertex."""
        space, region = self._values.space, self.walls.region([name])
        trial, test = space.TnT()
        if name not in self._inverses:
            mass = BilinearForm(space, check_unused=False)
            mass += inner(trial, test) * ds(definedon=region)
            active = BitArray(list(map(bool, self.constrained(self.layout, (region,) * self.walls.mesh.dim))))
            self._inverses[name] = mass.Assemble().mat.Inverse(active, inverse="umfpack")
        load = LinearForm(space)
        load += inner(velocity, test) * ds(definedon=region)
        self._values.vec.data = self._inverses[name] * load.Assemble().vec

    def reaction_power(self, residual: BaseVector, name: str) -> float:
        """Power of the reaction on a moving wall, W, from the residual of the solved step."""
        mask, rows = self.moving[name][1], residual.FV().NumPy()[self.layout.ranges["v"]]
        return Communicator.of(self.walls.mesh).dot(rows[mask], self._v[mask])
