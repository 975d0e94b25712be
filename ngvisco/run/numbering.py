"""Coefficients of a distributed space as those of the whole mesh on one process, and back.

A checkpoint has the numbering of one process, so that any number of ranks reads it.  The number of a rank's
cell in the whole mesh is known (``Part.cells``); the unknowns of a cell have the same order in both.  The
orientation of edges and faces is the same too: ranks number their vertices in the order of the whole mesh.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from ngsolve import VOL, ElementId, FESpace, Mesh

from ngvisco.errors import ParameterError
from ngvisco.forms.driving_stress import STRESS
from ngvisco.forms.spaces import Layout
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.mesh import Part

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation


class Numbers:
    """Which unknown of a space on the whole mesh each unknown of a rank is.

    Parameters
    ----------
    own : array (unknowns,)
        Of this rank; -1 for unknowns of no cell, as images of identified ones.
    space : FESpace or None
        On the whole mesh; None but on the first rank.
    chosen : array of int, optional
        On the first rank: these unknowns of the space alone are counted, in this order.
    """

    def __init__(
        self, own: np.ndarray, space: FESpace | None, ranks: Communicator, chosen: np.ndarray | None = None
    ) -> None:
        self.count, self.ranks = 0 if space is None else space.ndof, ranks
        self._parts = ranks.mpi.gather(own)
        if space is not None and chosen is not None:
            self.count, place = len(chosen), np.full(space.ndof + 1, -1)
            place[chosen] = np.arange(len(chosen))
            self._parts = [place[numbers] for numbers in self._parts]

    def whole(self, values: np.ndarray) -> np.ndarray:
        """All ranks' coefficients as those of the whole on the first rank, an empty array on others."""
        parts = self.ranks.mpi.gather(values)
        if parts is None:
            return np.zeros(0)
        result = np.zeros(self.count + 1)  # one more, for -1
        for numbers, part in zip(self._parts, parts, strict=True):
            result[numbers] = part
        return result[:-1]

    def own(self, values: np.ndarray | None) -> np.ndarray:
        """A rank's coefficients of those of the whole, which the first one has, None on others."""
        parts = None if values is None else [np.append(values, 0.0)[numbers] for numbers in self._parts]
        found: np.ndarray = self.ranks.mpi.scatter(parts)
        return found


class Numbering:
    """Which unknown of the whole mesh each unknown of a rank is; on one process itself.

    Raises ParameterError for a mesh that was distributed otherwise than by ``Simulation``: the whole is not
    known.

    Attributes
    ----------
    mesh, layout : Mesh and Layout, or None
        Of the whole mesh, None but on the first rank.
    """

    def __init__(self, simulation: Simulation) -> None:
        step, self.ranks = simulation.rothe_step, simulation.ranks
        self.mesh: Mesh | None = step.mesh
        self.layout: Layout | None = step.layout
        if not self.ranks.is_distributed:
            return
        part = step.mesh
        if not isinstance(part, Part):
            expected = "a mesh that Simulation distributes itself, of which it knows the whole"
            raise ParameterError("Checkpoints", "a distributed mesh", expected)
        self.mesh = part.whole
        self.layout = None if self.mesh is None else step.layout.on(self.mesh)
        whole = None if self.layout is None else self.layout.space
        own = numbers_in(part, step.layout.space, whole)
        evolved = None if self.layout is None else _evolved(self.layout)
        self._numbers = {
            "": Numbers(own, whole, self.ranks),
            "stepping": Numbers(own[_evolved(step.layout)], whole, self.ranks, evolved),
        }
        for name, stress in step.stresses.functions.items():
            space = None
            if self.mesh is not None:
                of_whole = replace(step.quadrature, mesh=self.mesh)
                space = of_whole.vectors(len(stress.components), at_nodes=True).space
            self._add(f"solver/{name}", part, stress.space, space)
        for key, field in simulation.passive.parts.items():
            space = None if self.mesh is None else simulation.passive.space(key, self.mesh)
            self._add(f"passive/{key}", part, field.space, space)

    def _add(self, key: str, part: Part, space: FESpace, whole: FESpace | None) -> None:
        self._numbers[key] = Numbers(numbers_in(part, space, whole), whole, self.ranks)

    def whole(self, values: np.ndarray, part: str = "", name: str = "") -> np.ndarray:
        """An array of a checkpoint as one process has it, on the first rank, an empty one on others.

        ``part`` and ``name`` are the checkpoint's: those of ``stepping`` have the unknowns that evolve only,
        in the order of ``Layout.evolving``, those of ``passive`` are of that field, stresses of flow rules of
        theirs, others have all.
        """
        return self._of(part, name).whole(values) if self.ranks.is_distributed else values

    def own(self, values: np.ndarray | None, part: str = "", name: str = "") -> np.ndarray:
        """A rank's part of such an array that the first one has, None on others."""
        if self.ranks.is_distributed:
            return self._of(part, name).own(values)
        assert values is not None
        return values

    def knows(self, part: str, name: str) -> bool:
        """Whether such an array is of this simulation, whose passive fields and flow rules may be others."""
        return _key(part, name) in self._numbers

    def _of(self, part: str, name: str) -> Numbers:
        return self._numbers[_key(part, name)]


def _key(part: str, name: str) -> str:
    if part == "passive" or (part == "solver" and name.startswith(STRESS)):
        return f"{part}/{name}"
    return "stepping" if part == "stepping" else ""


def _evolved(layout: Layout) -> np.ndarray:
    """Numbers of the unknowns of a layout that evolve."""
    ranges = (layout.ranges[name] for name in layout.evolving)
    return np.concatenate([np.arange(where.start, where.stop) for where in ranges])


def numbers_in(part: Part, space: FESpace, whole: FESpace | None) -> np.ndarray:
    """Numbers in a space on the whole mesh, None but on the first rank, of a rank's unknowns; collective."""
    wanted = part.ranks.mpi.gather(part.cells)
    answers = None
    if whole is not None:
        answers = [_of_cells(whole, cells) for cells in wanted]
    numbers, here = np.zeros((2, space.ndof))
    of_cells = _of_cells(space, range(part.ne))
    numbers[of_cells], here[of_cells] = part.ranks.mpi.scatter(answers), 1.0
    exchange = Exchange.of(space, part.ranks)  # of periodic domains a rank has unknowns of others' cells
    numbers, count = exchange.sum(numbers), exchange.sum(here)
    return np.where(count > 0, numbers / np.maximum(count, 1), -1).astype(np.int64)


def _of_cells(space: FESpace, cells: Iterable[int]) -> np.ndarray:
    """The unknowns of cells, cell by cell."""
    each = (np.array(space.GetDofNrs(ElementId(VOL, int(cell))), dtype=np.int64) for cell in cells)
    return np.concatenate([np.zeros(0, dtype=np.int64), *(dofs[dofs >= 0] for dofs in each)])
