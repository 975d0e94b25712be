"""phi'(z) at the points of a rule, and its derivative. Both come from arrays, from symbolic forms, or from a
material's response."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from ngsolve import GridFunction

from ngvisco.forms.mesh.points import CellPoints
from ngvisco.forms.system import Step
from ngvisco.physics.arrays import slope_along
from ngvisco.physics.pointwise import ArrayResponse, curved_components, slope_at
from ngvisco.physics.response import Response
from ngvisco.reduced.point_fields import TOGETHER, derivative_of, repeated_along


class PointwiseSlope:
    """Computes the components of phi'(z) at the points of a rule."""

    def __init__(self, step: Step, points: CellPoints) -> None:
        material = step.model.material
        states = step.layout.states
        self.components, self.points, self._step = states.size, points, step
        self.lagged = np.zeros((states.size, 1), dtype=bool)
        """Mask of the components of lagged variables."""
        for name in material.lagged:
            self.lagged[states.slices[name]] = True
        names = () if self.lagged.any() else material.summed  # with lagged variables phi'' is not symmetric
        every = np.arange(states.size)
        groups = [np.concatenate([every[states.slices[v]] for v in group]) for group in names if group]
        self._shared = np.setdiff1d(every, np.concatenate([*groups, every[:0]]))
        """Components that are in no group of ``Material.summed``."""
        self._own = {int(m): group for group in groups for m in group}
        self.owner = np.full(states.size, -1)
        """Number of the group of each component; -1 for components that are in no group."""
        for number, group in enumerate(groups):
            self.owner[group] = number
        curved = every if self.lagged.any() else curved_components(material, step.mesh.dim)
        self._linear = np.setdiff1d(every, curved)
        """Components in which phi is jointly linear."""
        by_groups = itertools.zip_longest(*(np.intersect1d(group, curved) for group in groups))
        self._together = [[int(m) for m in columns if m is not None] for columns in by_groups]
        """Groups of components; one derivative gives the columns of phi'' of all components in a group."""
        self._together += [[int(m)] for m in np.intersect1d(self._shared, curved)]
        self._frozen: tuple[np.ndarray, np.ndarray] | None = None
        self._lagged_values: GridFunction | None = None
        self._kept: tuple[np.ndarray, np.ndarray, Response] | None = None
        self.response = step.tabulated_rates.response
        self._has_own_response = material.response(step.mesh.dim) is not None
        self.arrays = self.curving = None
        """Two functions of arrays: the slope, and the slope of the part of the energy that is curved in the
        components ``_read``. Both are None unless the energy is an array law."""
        self._read = every
        if isinstance(self.response, ArrayResponse):
            self.arrays, self.curving = self.response.slope, self.response.slope_of_part
            self._read = every if self.lagged.any() else self.response.read

    @property
    def is_local(self) -> bool:
        """Whether phi' at a point depends on z at this point alone. Threads may then share the points."""
        return self.arrays is not None and not self.lagged.any()

    def __call__(self, z_values: np.ndarray) -> np.ndarray:
        """phi'(z), (n, points), for z (n, points) at the points, real or with a tiny imaginary part."""
        if not self.lagged.any():
            return self._whole(z_values)
        if self._has_own_response:
            response = self._answer(np.ascontiguousarray(z_values.real))
            slope = np.ascontiguousarray(response.slope.T)
            is_real = not np.iscomplexobj(z_values)
            return slope if is_real else slope + 1j * _applied(response, z_values.imag)
        return np.where(self.lagged, self._whole(z_values), self._whole(self._seen(z_values)))

    def derivative(self, z_values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The map dz -> phi''(z) dz at the points, both (n, points), for z (n, points)."""
        if self.lagged.any() and self._has_own_response:
            return partial(_applied, self._answer(z_values))
        derivative = self._whole_derivative(z_values)
        if not self.lagged.any():
            return derivative
        of_others = self._whole_derivative(self._seen(z_values))
        return lambda dz: np.where(self.lagged, derivative(dz), of_others(np.where(self.lagged, 0.0, dz)))

    def hessian(self, z_values: np.ndarray) -> np.ndarray:
        """phi''(z), (n, n, points), for real z.

        phi'' is symmetric, and zero between branches.  One derivative therefore gives a column of each
        branch.  Columns of components in which phi is linear follow from the other columns.
        """
        n = self.components
        if self.lagged.any() and self._has_own_response:
            return np.ascontiguousarray(self._answer(z_values).hessian.transpose(1, 2, 0))
        result = np.zeros((z_values.shape[1], n, n)).transpose(1, 2, 0)  # contiguous at each point
        directions = np.zeros((n, len(self._together)))
        for k, columns in enumerate(self._together):
            directions[columns, k] = 1.0
        for k, change in enumerate(self._along(z_values, directions)):
            for m in (columns := self._together[k]):
                rows = self._read if len(columns) == 1 else self._own[m]
                result[rows, m] = change if len(columns) == 1 else change[rows]
        for columns in self._together:
            for m in columns if len(columns) > 1 else ():
                result[self._shared, m] = result[m, self._shared]
        linear = np.intersect1d(self._linear, self._read)
        result[:, linear] = result[linear].swapaxes(0, 1)
        return result

    def _along(self, z_values: np.ndarray, directions: np.ndarray) -> Iterator[np.ndarray]:
        """Yield phi''(z) d for each column d of ``directions``, (n, k). Only the components ``_read`` are
        yielded; the other components vanish.

        The points are repeated for several directions at once, because a law of many operations takes
        hardly longer for several directions than for one.
        """
        count, points = directions.shape[1], z_values.shape[1]
        if self.curving is None or self.lagged.any():
            along = self.derivative(z_values)
            yield from (along(np.broadcast_to(d[:, None], z_values.shape)) for d in directions.T)
            return
        for start in range(0, count, size := max(1, TOGETHER // max(1, points))):
            group = directions.T[start : start + size, self._read, None]
            slopes = self.curving(repeated_along(z_values[self._read], group))
            yield from derivative_of(slopes, len(group)).swapaxes(0, 1)

    def _answer(self, z_values: np.ndarray) -> Response:
        """The material's own response with lagged variables; it is kept until z or the lagged values
        change."""
        z, seen, kept = z_values.T, self._seen(z_values).T, self._kept
        if kept is None or not (np.array_equal(kept[0], z) and np.array_equal(kept[1], seen)):
            kept = self._kept = z.copy(), seen.copy(), self.response(z, seen)
        return kept[2]

    def _seen(self, z_values: np.ndarray) -> np.ndarray:
        """z with the old values of lagged variables, for the conjugates of variables that do not lag."""
        lagged = self._step.lagged
        assert lagged is not None
        values = lagged.vec.FV().NumPy()
        if self._frozen is None or not np.array_equal(self._frozen[0], values):
            if self._lagged_values is None:  # made once, because all ranks have to make it together
                self._lagged_values = self.points.function(self.components)
            self._lagged_values.Interpolate(lagged)
            self._frozen = values.copy(), self.points.read(self._lagged_values, self.components).copy()
        return np.where(self.lagged, self._frozen[1], z_values)

    def _whole(self, z_values: np.ndarray) -> np.ndarray:
        """phi'(z) of all variables at ``z_values``; lagged variables are not replaced by their old values."""
        if np.iscomplexobj(z_values):
            z, dz = np.ascontiguousarray(z_values.real), np.ascontiguousarray(z_values.imag)
            return self._whole(z) + 1j * self._whole_derivative(z)(dz)
        return slope_at(self.response, z_values)

    def _whole_derivative(self, z_values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        if (arrays := self.arrays) is not None:
            return lambda dz: slope_along(arrays, z_values, dz)
        return partial(_applied, self.response(z_values.T))


def _applied(response: Response, dz: np.ndarray) -> np.ndarray:
    """phi''(z) dz, (n, points), by a response at the points."""
    return np.einsum("pnm,mp->np", response.hessian, dz)
