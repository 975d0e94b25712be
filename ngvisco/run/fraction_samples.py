"""Volume fractions of bodies at points within cells, and the parts of the plane that bodies fill."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from ngsolve import CF, L2, CoefficientFunction, GridFunction, VectorValued, x, y, z

from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.mixture import Mixture
from ngvisco.run.frames import Lattice, places
from ngvisco.run.outlines import Cut, facing, level_surface
from ngvisco.run.periods import Periods, merged

HALF = 0.5
"""Volume fraction above which a point belongs to a body."""
_MIXED = (0.05, 0.95)
"""Fractions between which a point is in the interface."""
PIECES = 2
"""Number of parts into which an edge of a cell is cut: with one part areas are too small, with three parts
perimeters are too long."""


class FractionSamples:
    """Volume fractions of bodies at points within the cells of a mesh, over all ranks.

    Outlines have no gaps, since fractions are averaged at points where cells meet, also across periodic
    boundaries.

    Parameters
    ----------
    step : Step
    ranks : Communicator
    names : sequence of str
        Names of bodies.
    """

    def __init__(self, step: Step, ranks: Communicator, names: Sequence[str]) -> None:
        material = step.model.material
        assert isinstance(material, Mixture)
        theta, mesh = material.fractions.at(step.now.z_tensors), step.mesh
        self.names, self.dim, self._ranks = list(names), mesh.dim, ranks
        self._mesh = mesh
        self.lattice, self.periods = Lattice(mesh, PIECES), Periods.of(mesh, ranks)
        place, v = (x, y, z)[: mesh.dim], step.now.v
        values = (*place, *(v[i] for i in range(mesh.dim)), step.context.h, *(theta[n] for n in names))
        self._values = CF(values).Compile()
        self.positions: dict[str, CoefficientFunction] = {name: CF(place) for name in names}
        """Positions of points, m, for means over a body; the points of a body that crosses a periodic
        boundary are displaced by periods, so that the body is in one piece."""
        self._moves: dict[str, GridFunction] = {}
        if len(self.periods.vectors):
            cellwise = VectorValued(L2(mesh, order=0), mesh.dim)
            self._moves = {name: GridFunction(cellwise) for name in names}
            self.positions = {name: CF(place) + move for name, move in self._moves.items()}

    def read(self) -> None:
        """Sample the present state, and set the ``positions`` of bodies; ``places`` then numbers the places
        of the points, (points,).

        Identified points of periodic boundaries are at one place.
        """
        table, cells, own = self.lattice.values(self._values), self.lattice.cells, slice(None)
        if self._ranks.is_distributed:
            parts = self._ranks.gathered((table, cells))
            starts = np.cumsum([0, *(len(table) for table, _ in parts)])
            table = np.concatenate([table for table, _ in parts])
            before = sum(len(part) for _, part in parts[: self._ranks.mpi.rank])
            own = slice(before, before + len(cells))
            cells = np.concatenate([part + start for (_, part), start in zip(parts, starts, strict=False)])
        dim, count = self.dim, len(self.names)
        first, number = places(table[:, :dim])
        self._domain = table[first, :dim]
        self._images = self.periods.pairs(self._domain)
        self.places = merged(len(first), self._images)[number]
        sums = [np.bincount(self.places, theta) for theta in table[:, -count:].T]
        averaged = (np.array(sums) / np.bincount(self.places))[:, self.places]
        self._points, self._sizes = number[cells], table[cells[:, 0], 2 * dim]
        self._corners = table[cells][:, :, : 2 * dim + 1]
        self._averaged = dict(zip(self.names, averaged[:, cells], strict=True))
        self._are_inside = dict(zip(self.names, averaged[:, first] >= HALF, strict=True))
        self._own = dict(zip(self.names, table[:, -count:].T[:, cells], strict=True))
        self._cuts: dict[str, Cut] = {}
        self._offsets: dict[str, np.ndarray] = {}
        of_cell = self.lattice.of_points[self.lattice.cells[:, 0]]
        for name, move in self._moves.items():
            self._offsets[name] = offsets = self.periods.offsets(
                self._domain, self._points, self._are_inside[name], self._images
            )
            of_cells = move.vec.FV().NumPy().reshape(dim, self._mesh.ne)
            is_part = self._are_inside[name][self._points[own]].any(axis=1)
            for chosen in (~is_part, is_part):  # a body's sub-cells overwrite the others of their cell
                of_cells[:, of_cell[chosen]] = offsets[own][chosen].T

    def place(self) -> None:
        """Set the ``positions`` of bodies for the present state."""
        if self._moves:
            self.read()

    def cut(self, name: str) -> Cut:
        """The part of the domain where a body's fraction is at least 1/2.

        The columns of the result are x, y, v_1, v_2 and the size of the cell.
        """
        if name not in self._cuts:
            self._cuts[name] = Cut.of(self._corners, self._points, self._averaged[name], HALF)
        return self._cuts[name]

    def whole(self, name: str) -> Cut:
        """A body's cut with its parts put together across periodic boundaries."""
        if not len(self.periods.vectors):
            return self.cut(name)
        corners = self._corners.copy()
        corners[:, :, : self.dim] += self._offsets[name][:, None]
        return Cut.of(corners, self._points, self._averaged[name], HALF)

    def folded(self, points: np.ndarray) -> np.ndarray:
        """Images of ``points``, (points, dim), within the domain along each period."""
        return self.periods.folded(points, self._domain)

    def traced(self, name: str, is_whole: bool) -> tuple[Cut, np.ndarray, np.ndarray]:
        """A body's cut with columns x, y, v_1, v_2, the shares of a part's three corners, and the part's
        number; with ``is_whole`` its parts are put together across periodic boundaries.

        The other results are the places of the corners, (parts, 3, 2), and the averaged fractions at the
        corners, (parts, 3).
        """
        count = len(self._corners)
        shares = np.broadcast_to(np.eye(3), (count, 3, 3))
        number = np.broadcast_to(np.arange(count, dtype=float)[:, None, None], (count, 3, 1))
        moving = self._corners[:, :, :4].copy()
        if is_whole and len(self.periods.vectors):
            moving[:, :, :2] += self._offsets[name][:, None]
        theta = self._averaged[name]
        traced = Cut.of(np.concatenate([moving, shares, number], axis=2), self._points, theta, HALF)
        return traced, moving[:, :, :2], theta

    def facing(self, name: str) -> float | None:
        """Least distance, in cells, between parts of a body's surface that face each other; None if none do
        within 1.5 cells."""
        theta = self._averaged[name]
        above = theta >= HALF
        is_cut = above.any(axis=1) & ~above.all(axis=1)
        points, outwards = level_surface(self._corners[is_cut][:, :, : self.dim], theta[is_cut], HALF)
        return facing(points, outwards, self._sizes[is_cut], self.periods.images)

    def smeared(self, name: str) -> float:
        """The width of a body's interface in cells; NaN without an interface.

        The width is the volume where the fraction is between 0.05 and 0.95, over the volume of an interface
        one cell wide with the area int |grad theta| of the averaged fraction.
        """
        edges = np.swapaxes(self._corners[:, 1:, : self.dim] - self._corners[:, :1, : self.dim], 1, 2)
        volumes = np.abs(np.linalg.det(edges)) / (2 if self.dim == 2 else 6)
        theta = np.clip(self._averaged[name], 0, 1)
        slopes = np.linalg.solve(np.swapaxes(edges, 1, 2), (theta[:, 1:] - theta[:, :1])[:, :, None])
        of_one_cell = float((volumes * self._sizes * np.linalg.norm(slopes[:, :, 0], axis=1)).sum())
        middle = self._own[name].mean(axis=1)
        mixed = float(volumes[(middle > _MIXED[0]) & (middle < _MIXED[1])].sum())
        return mixed / of_one_cell if of_one_cell > 0 else np.nan
