"""Runs over ranks: coefficients in the numbering of one process, and errors of one rank that are raised on
all ranks.

A checkpoint has the numbering of one process, so that any number of ranks reads it.  A rank knows its cells'
numbers in the whole mesh (``MeshPart.cells``); a cell's unknowns have the same order on the rank and in the
whole mesh.  Edges and faces also have the same orientation, because ranks number their vertices in the order
of the whole mesh.
"""

from __future__ import annotations

import contextlib
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np
from ngsolve import VOL, ElementId, FESpace, Mesh

from ngvisco.errors import NgviscoError, ParameterError
from ngvisco.forms.driving_stress import STRESS
from ngvisco.forms.spaces import Layout
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import OF_ALL_RANKS, Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.mesh import MeshPart
from ngvisco.run.passive import PassiveFields

_FAILED, _INTERRUPTED = 1, 130


class _Renumbering:
    """Maps a rank's unknowns to the unknowns of a space on the whole mesh; collective.

    ``whole`` is the space on the whole mesh on the first rank, None on other ranks.  ``chosen`` lists the
    unknowns to be numbered, in their order; default all.  ``dofs``, (unknowns,), holds the rank's numbers; an
    unknown without a cell, such as the image of an identified unknown, has the number -1.
    """

    def __init__(
        self, dofs: np.ndarray, whole: FESpace | None, ranks: Communicator, chosen: np.ndarray | None = None
    ) -> None:
        self._count, self._ranks = 0 if whole is None else whole.ndof, ranks
        self._parts = ranks.mpi.gather(dofs)
        if whole is not None and chosen is not None:
            self._count, place = len(chosen), np.full(whole.ndof + 1, -1)
            place[chosen] = np.arange(len(chosen))
            self._parts = [place[numbers] for numbers in self._parts]

    def whole(self, values: np.ndarray) -> np.ndarray:
        parts = self._ranks.mpi.gather(values)
        if parts is None:
            return np.zeros(0)
        # the last entry receives the values of unknowns with the number -1
        result = np.zeros(self._count + 1)
        for numbers, part in zip(self._parts, parts, strict=True):
            result[numbers] = part
        return result[:-1]

    def own(self, values: np.ndarray | None) -> np.ndarray:
        parts = None if values is None else [np.append(values, 0.0)[numbers] for numbers in self._parts]
        return self._ranks.mpi.scatter(parts)


class Numbering:
    """Maps a rank's unknowns to the unknowns of the whole mesh; on one process the identity.

    Raises ParameterError for a mesh that ``Simulation`` did not distribute, because the whole mesh is not
    known.  Arrays have the names of a checkpoint.  Arrays of ``stepping`` hold the unknowns that evolve, in
    the order of ``Layout.evolving``; arrays of ``passive`` and stresses of flow rules have spaces of their
    own; all other arrays hold all unknowns.

    Attributes
    ----------
    mesh, layout : Mesh and Layout, or None
        The whole mesh and its layout; None but on the first rank.
    """

    def __init__(self, step: Step, passive: PassiveFields, ranks: Communicator) -> None:
        self.mesh: Mesh | None = step.mesh
        self.layout: Layout | None = step.layout
        self._numbers: dict[str, _Renumbering] | None = None
        if not ranks.is_distributed:
            return
        part = step.mesh
        if not isinstance(part, MeshPart):
            expected = "an undistributed mesh, since Simulation distributes the mesh over the ranks"
            raise ParameterError("Simulation.mesh", "a distributed mesh", expected)
        self.mesh = mesh = part.whole
        self.layout = None if mesh is None else step.layout.on(mesh)
        whole = None if self.layout is None else self.layout.space
        numbers = numbers_in(part, step.layout.space, whole)
        evolved = None if self.layout is None else _evolved(self.layout)
        of_steps = _Renumbering(numbers[_evolved(step.layout)], whole, ranks, evolved)
        self._numbers = {"": _Renumbering(numbers, whole, ranks), "stepping": of_steps}
        spaces: dict[str, tuple[FESpace, FESpace | None]] = {}
        for name, stress in step.stresses.functions.items():
            size = len(stress.components)
            rules = None if mesh is None else replace(step.quadrature, mesh=mesh)
            collocated = None if rules is None else rules.vectors(size, collocated=True).space
            spaces[f"solver/{name}"] = stress.space, collocated
        for name, field in passive.parts.items():
            spaces[f"passive/{name}"] = field.space, None if mesh is None else passive.space(name, mesh)
        for name, (space, of_whole) in spaces.items():
            self._numbers[name] = _Renumbering(numbers_in(part, space, of_whole), of_whole, ranks)

    def whole(self, values: np.ndarray, name: str) -> np.ndarray:
        """A checkpoint's array on the first rank, numbered as on one process; empty on other ranks."""
        return values if self._numbers is None else self._numbers[_key(name)].whole(values)

    def own(self, values: np.ndarray | None, name: str) -> np.ndarray:
        """A rank's part of a checkpoint's array ``values``, which the first rank has; None on other ranks."""
        if self._numbers is not None:
            return self._numbers[_key(name)].own(values)
        assert values is not None
        return values

    def knows(self, name: str) -> bool:
        """Whether this simulation has the array ``name``; its passive fields and flow rules may differ."""
        return self._numbers is None or _key(name) in self._numbers


def _key(name: str) -> str:
    part, _, array_name = name.rpartition("/")
    if part == "passive" or (part == "solver" and array_name.startswith(STRESS)):
        return name
    return "stepping" if part == "stepping" else ""


def _evolved(layout: Layout) -> np.ndarray:
    ranges = (layout.ranges[name] for name in layout.evolving)
    return np.concatenate([np.arange(where.start, where.stop) for where in ranges])


def numbers_in(part: MeshPart, space: FESpace, whole: FESpace | None) -> np.ndarray:
    """Numbers of a rank's unknowns in ``whole``, a space on the whole mesh, on the first rank; collective."""
    cells_of_ranks = part.ranks.mpi.gather(part.cells)
    answers = None
    if whole is not None:
        answers = [_of_cells(whole, cells) for cells in cells_of_ranks]
    numbers, here = np.zeros((2, space.ndof))
    of_cells = _of_cells(space, range(part.ne))
    numbers[of_cells], here[of_cells] = part.ranks.mpi.scatter(answers), 1.0
    exchange = Exchange.of(space, part.ranks)  # a periodic space has unknowns of other ranks' cells
    numbers, count = exchange.sum(numbers), exchange.sum(here)
    return np.where(count > 0, numbers / np.maximum(count, 1), -1).astype(np.int64)


def _of_cells(space: FESpace, cells: Iterable[int]) -> np.ndarray:
    dofs_of_cells = (np.array(space.GetDofNrs(ElementId(VOL, int(cell))), dtype=np.int64) for cell in cells)
    return np.concatenate([np.zeros(0, dtype=np.int64), *(dofs[dofs >= 0] for dofs in dofs_of_cells)])


def tell(ranks: Communicator, observer: object, method: Callable[..., None], *arguments: object) -> None:
    """Call an observer's method; all ranks raise an error of one rank."""
    with ranks.together(BaseException):
        if ranks.is_first or not getattr(observer, "on_first_rank", False):
            method(*arguments)


@contextlib.contextmanager
def ending_all_ranks() -> Iterator[None]:
    """Context for work in which ranks wait for each other: an error of one rank alone ends all ranks."""
    try:
        yield
    except BaseException as error:
        abort_alone(error)
        raise


def abort_alone(error: BaseException, ranks: Communicator | None = None) -> None:
    """End all ranks if ``error`` arose on one rank alone, since the other ranks wait for it.

    An error of ngvisco ends no rank, because all ranks raise it together.
    """
    if isinstance(error, NgviscoError) or OF_ALL_RANKS in vars(error):
        return
    ranks = ranks or Communicator.world()
    if ranks.is_distributed:
        traceback.print_exception(error)
        sys.stderr.flush()
        ranks.abort(_INTERRUPTED if isinstance(error, KeyboardInterrupt) else _FAILED)
