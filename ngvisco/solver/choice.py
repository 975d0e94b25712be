"""Which of the two solvers solves a step."""

from __future__ import annotations

import numpy as np
from ngsolve import VERTEX, Mesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ngvisco.errors import ParameterError
from ngvisco.forms.mesh_arrays import is_simplicial, vertices
from ngvisco.forms.system import Step
from ngvisco.solver.split.claims import term_obstacle
from ngvisco.solver.split.sources import source_obstacle

SPLIT_FROM = {2: 60, 3: 10}
"""Cells, by dimension, from which the split solver is the faster one (tests/benchmarks)."""

COUPLED_UP_TO = {2: 20_000, 3: 1_000}
"""Cells up to which the coupled solver's factorisation fits a workstation."""


def chosen_method(step: Step, method: str) -> str:
    """``"coupled"`` or ``"split"``.

    Raises
    ------
    ParameterError
        If ``method`` is ``"split"`` for a step that the split solver cannot take.
    """
    obstacle = split_obstacle(step)
    if method == "split" and obstacle is not None:
        raise ParameterError("NewtonOptions.method", method, f"'coupled': {obstacle}")
    if method == "auto":
        large = step.mesh.ne >= SPLIT_FROM[step.mesh.dim]
        return "split" if large and obstacle is None else "coupled"
    return method


def split_obstacle(step: Step) -> str | None:
    """Why the split solver cannot take this step, or None."""
    if not is_simplicial(step.mesh):
        return "the split solver needs a mesh of triangles or tetrahedra only"
    if meets_itself(step.mesh):
        return "a cell of the periodic mesh meets its own image: two cells or more are needed"
    return source_obstacle(step) or term_obstacle(step)


def meets_itself(mesh: Mesh) -> bool:
    """Whether a cell has two vertices that the mesh identifies with each other."""
    pairs = np.array([pair for pair, _ in mesh.GetPeriodicNodePairs(VERTEX)])
    if not len(pairs):
        return False
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(mesh.nv, mesh.nv))
    _, label = connected_components(graph, directed=False)
    of_cells = np.sort(label[vertices(mesh)], axis=1)
    return bool((np.diff(of_cells, axis=1) == 0).any())


def is_affordable(mesh: Mesh) -> bool:
    """Whether the coupled solver can be asked where the split one fails."""
    return mesh.ne <= COUPLED_UP_TO[mesh.dim]
