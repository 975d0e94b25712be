"""Coefficients of a distributed space as those of the whole mesh on one process, and back.

A checkpoint has the numbering of one process, so that any number of ranks reads it.  A rank's cell is found
in the whole mesh by its vertices, these by their coordinates, which NGSolve hands out to the bit; the
unknowns of a cell have the same order in both.  The orientation of edges and faces is the same too: ranks
number their vertices in the order of the whole mesh.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from ngsolve import VOL, FESpace, Mesh

from ngvisco.errors import ParameterError
from ngvisco.forms.mesh_arrays import coordinates
from ngvisco.forms.spaces import Layout
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import Part

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

_EVOLVED = ("v", "rho", "z")


class Numbering:
    """Which unknown of the whole mesh each unknown of a rank is.

    Attributes
    ----------
    mesh, layout : Mesh and Layout, or None
        Of the whole mesh, None but on the first rank.

    Raises
    ------
    ParameterError
        For a mesh that was distributed otherwise than by ``Simulation``: the whole is not known.
    """

    def __init__(self, simulation: Simulation) -> None:
        step, self.ranks = simulation.rothe_step, simulation.ranks
        self.mesh: Mesh | None = step.mesh
        self.layout: Layout | None = step.layout
        if not self.ranks.is_distributed:
            return
        self.mesh = step.mesh.whole if isinstance(step.mesh, Part) else None
        if not self.ranks.any(self.mesh is not None):
            expected = "a mesh that Simulation distributes itself, of which it knows the whole"
            raise ParameterError("Checkpoints", "a distributed mesh", expected)
        self.layout = None if self.mesh is None else step.layout.on(self.mesh)
        own = _numbers(step.mesh, step.layout.space, self.mesh, self.layout, self.ranks)
        of_evolved = own[_evolved(step.layout)]
        self._states = self.ranks.mpi.gather(own)
        self._evolved = self.ranks.mpi.gather(of_evolved)
        if self.layout is not None:  # positions among the evolved unknowns alone
            position = np.zeros(self.layout.space.ndof, dtype=np.int64)
            chosen = _evolved(self.layout)
            position[chosen] = np.arange(len(chosen))
            self._evolved = [position[numbers] for numbers in self._evolved]

    def whole(self, values: np.ndarray, evolved: bool = False) -> np.ndarray:
        """The whole state of all ranks' coefficients on the first rank, an empty array on others.

        With ``evolved`` both have the unknowns v, rho and z only, in this order.
        """
        if not self.ranks.is_distributed:
            return values
        parts = self.ranks.mpi.gather(values)
        if parts is None or self.layout is None:
            return np.zeros(0)
        result = np.zeros(len(_evolved(self.layout)) if evolved else self.layout.space.ndof)
        for numbers, part in zip(self._evolved if evolved else self._states, parts, strict=True):
            result[numbers] = part
        return result

    def own(self, values: np.ndarray | None, evolved: bool = False) -> np.ndarray:
        """A rank's coefficients of the whole state that the first one has, None on others."""
        if not self.ranks.is_distributed:
            assert values is not None
            return values
        numbers = self._evolved if evolved else self._states
        parts = None if values is None else [values[own] for own in numbers]
        found: np.ndarray = self.ranks.mpi.scatter(parts)
        return found


def _evolved(layout: Layout) -> np.ndarray:
    """The unknowns v, rho and z of a layout."""
    return np.concatenate([np.arange(layout.ranges[n].start, layout.ranges[n].stop) for n in _EVOLVED])


def _numbers(
    part: Mesh, space: FESpace, whole: Mesh | None, layout: Layout | None, ranks: Communicator
) -> np.ndarray:
    """Numbers in the whole space of a rank's unknowns; collective."""
    known = None if whole is None else {point.tobytes(): i for i, point in enumerate(coordinates(whole))}
    places = [point.tobytes() for point in coordinates(part)] if part.nv else []
    asked = ranks.mpi.gather(places)
    vertices = ranks.mpi.scatter(
        None if known is None else [[known[place] for place in each] for each in asked]
    )
    cells = [
        (tuple(vertices[v.nr] for v in cell.vertices), _dofs(space, cell)) for cell in part.Elements(VOL)
    ]
    wanted = ranks.mpi.gather([key for key, _ in cells])
    answers = None
    if whole is not None and layout is not None:
        of_cell = {
            tuple(v.nr for v in cell.vertices): _dofs(layout.space, cell) for cell in whole.Elements(VOL)
        }
        answers = [
            np.concatenate([np.zeros(0, dtype=int), *(of_cell[key] for key in each)]) for each in wanted
        ]
    found = ranks.mpi.scatter(answers)
    numbers = np.zeros(space.ndof, dtype=np.int64)
    numbers[np.concatenate([np.zeros(0, dtype=int), *(dofs for _, dofs in cells)])] = found
    return numbers


def _dofs(space: FESpace, cell: object) -> np.ndarray:
    dofs = np.array(space.GetDofNrs(cell), dtype=np.int64)
    return dofs[dofs >= 0]
