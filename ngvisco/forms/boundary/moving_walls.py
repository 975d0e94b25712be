"""Walls whose velocity is prescribed: constrained coefficients of v, and the power of their reaction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from ngsolve import (
    BND,
    BaseMatrix,
    BaseVector,
    BilinearForm,
    BitArray,
    CoefficientFunction,
    GridFunction,
    Integrate,
    LinearForm,
    Region,
    ds,
    specialcf,
)

from ngvisco.errors import ParameterError
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.spaces import Layout
from ngvisco.forms.time_means import TimeMean
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Interpolation
from ngvisco.physics.loads import as_vector
from ngvisco.physics.signals import may_read_time
from ngvisco.physics.tensors import inner
from ngvisco.physics.walls import MOVING, Inflow

OPEN = 1e-3  # |V.n|^2/|V|^2 that the geometry's approximation may leave of a tangential velocity


class MovingWalls:
    """The constrained coefficients of v: zero, or a prescribed wall velocity.

    Of a Rothe step that is its mean over the time that loads are averaged over: the wall is displaced by what
    it moves in the step, whatever it does within.

    The rows of R(u; .) at these coefficients are not zero but the wall's reaction; tested by v they
    give its power, which is what is missing in R(u; v) = 0 for the energy identity.
    """

    def __init__(self, walls: Walls, layout: Layout, state: GridFunction) -> None:
        self.walls, self.layout, self.state = walls, layout, state
        mesh = walls.mesh
        self._values = GridFunction(layout.blocks["v"])
        self._set = Interpolation(layout.blocks["v"])
        self._inverses: dict[str, BaseMatrix] = {}
        self.fixed = self.constrained(layout, walls.dirichlet)
        self.zero = self.constrained(layout, walls.homogeneous)
        self.moving: dict[str, tuple[CoefficientFunction, np.ndarray]] = {}
        taken = self.zero.copy()
        for name, wall in walls.conditions.items():
            if isinstance(wall, MOVING):
                mask = self.constrained(layout, (walls.region([name]),) * mesh.dim) & ~taken
                taken |= mask
                velocity = as_vector(wall.velocity, mesh.dim, f"walls[{name!r}].velocity")
                self.moving[name] = (velocity, mask)
        self._means = {
            name: self._mean(name) for name, (velocity, _) in self.moving.items() if may_read_time(velocity)
        }
        self._found: dict[str, np.ndarray] = {}
        self._averaged: tuple[float, float] | None = None

    def _mean(self, name: str) -> TimeMean:
        velocity, mask = self.moving[name]

        def make() -> np.ndarray:
            return self.interpolate(name, velocity)[mask]

        def put(values: np.ndarray) -> None:
            self._found[name] = values

        return TimeMean(velocity, self.walls.mesh, make, put, self.walls.region([name]))

    @staticmethod
    def constrained(layout: Layout, regions: Sequence[Region | None]) -> np.ndarray:
        """Coefficients of v_i on the i-th of these boundaries, as a mask."""
        free = mask_of(layout.velocity_space(regions).FreeDofs())
        unconstrained = mask_of(layout.velocity_space((None,) * layout.mesh.dim).FreeDofs())
        return unconstrained & ~free

    def set_values(self) -> None:
        """Write the constrained coefficients of v of the Rothe step into the state."""
        context = self.layout.context
        window = context.loads_from.Get(), context.loads_over.Get()
        if window != self._averaged:
            for name, mean in self._means.items():
                context.require_mean(f"the velocity of the wall {name!r}", mean.update(*window))
            self._averaged = window
        self._write(self.velocities() | self._found)

    def set_present_values(self) -> None:
        """Write those of the present ``ngvisco.time`` into the state."""
        self._write(self.velocities())

    def _write(self, velocities: dict[str, np.ndarray]) -> None:
        v = self._view()
        v[self.zero] = 0.0
        for name, (_, mask) in self.moving.items():
            v[mask] = velocities[name]

    def velocities(self) -> dict[str, np.ndarray]:
        """Coefficients on every moving wall at the present ``ngvisco.time``, m/s."""
        return {name: self.interpolate(name, v)[mask] for name, (v, mask) in self.moving.items()}

    def interpolate(self, name: str, velocity: CoefficientFunction) -> np.ndarray:
        """Coefficients on the wall of a velocity; of its tangential part where nothing crosses the wall.

        Raises
        ------
        ParameterError
            If the velocity has a normal part there.
        """
        if not isinstance(self.walls.conditions[name], Inflow):
            velocity = self._tangential(name, velocity)
        self._values.vec[:] = 0.0
        if self.layout.periodic:
            self._project(name, velocity)
        else:
            self._set(self._values, velocity, self.walls.region([name]))
        return self._values.vec.FV().NumPy()

    def _tangential(self, name: str, velocity: CoefficientFunction) -> CoefficientFunction:
        mesh = self.walls.mesh
        region = self.walls.region([name])
        n = specialcf.normal(mesh.dim)
        normal = velocity * n
        size = Integrate(velocity * velocity, mesh, BND, definedon=region)
        through = Integrate(normal * normal, mesh, BND, definedon=region)
        if not through <= OPEN * size:
            raise ParameterError(
                f"walls[{name!r}].velocity",
                f"normal part {through**0.5:.3g} of {size**0.5:.3g} in L2",
                "a tangential velocity: nothing crosses such a wall; an inlet is nv.Inflow(velocity=...)",
            )
        return velocity - normal * n

    def _project(self, name: str, velocity: CoefficientFunction) -> None:
        """The L2 projection on the wall: ``Set`` counts a vertex twice in a facet that meets its image."""
        space, region = self._values.space, self.walls.region([name])
        trial, test = space.TnT()
        if name not in self._inverses:
            mass = BilinearForm(space, check_unused=False)
            mass += inner(trial, test) * ds(definedon=region)
            on_wall = self.constrained(self.layout, (region,) * self.walls.mesh.dim)
            active = BitArray(list(map(bool, on_wall)))
            self._inverses[name] = mass.Assemble().mat.Inverse(active, inverse="umfpack")
        load = LinearForm(space)
        load += inner(velocity, test) * ds(definedon=region)
        self._values.vec.data = self._inverses[name] * load.Assemble().vec

    def reaction_power(self, residual: BaseVector, name: str) -> float:
        """Power of the reaction on a moving wall, W, from the residual of the solved step."""
        mask = self.moving[name][1]
        where = self.layout.ranges["v"]
        return Communicator.of(self.walls.mesh).dot(residual.FV().NumPy()[where][mask], self._view()[mask])

    def _view(self) -> np.ndarray:
        return self.state.vec.FV().NumPy()[self.layout.ranges["v"]]
