"""Corners in which the velocities of walls determine div v: no pressure can hold it there.

Where all edges of a cell at a vertex lie on walls that prescribe v, they give grad v of that cell at the
vertex, for any order of v.  Under a lid of speed U that meets a wall at rest div v = +-U/h there, and as v
itself is zero the matter stays: J and rho change by exp(+-U t/h).  A cell that is divided at its midpoint
has an edge into the interior at every vertex, and div v is free (``ngvisco.geometries.split_corner_cells``).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from ngsolve import CF, ET, H1, VOL, FESpace, GridFunction, HCurl, IntegrationRule, x, y, z

from ngvisco.errors import InputWarning
from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.mesh import cell_numbers
from ngvisco.physics.model import as_vector
from ngvisco.physics.tensors import tr
from ngvisco.physics.time import time
from ngvisco.physics.walls import NoSlip, PrescribedTangential

_VERTICES = {
    ET.TRIG: IntegrationRule([(0, 0), (1, 0), (0, 1)], [0.0] * 3),
    ET.QUAD: IntegrationRule([(0, 0), (1, 0), (1, 1), (0, 1)], [0.0] * 4),
    ET.TET: IntegrationRule([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [0.0] * 4),
}


def warn_of_corners(step: Step, times: Sequence[float]) -> None:
    """Say where the walls' velocities alone change a volume e-fold from the first to the last time, s.

    Collective.
    """
    ranks, cells = Communicator.of(step.mesh), _corner_cells(step)
    duration, count = times[-1] - times[0], int(ranks.total(len(cells)))
    if not count or not duration > 0:
        return
    present = time.Get()
    try:
        rates = []
        for t in times:
            time.Set(t)
            rates.append(_divergences(step, cells))
    finally:
        time.Set(present)
    numbers = cell_numbers(step.mesh)[[cell for cell, _ in cells]]
    own = zip(numbers, rates[0][0], np.transpose([values for _, values in rates]), strict=True)
    every = sorted((one for of in ranks.gathered(list(own)) for one in of), key=lambda one: int(one[0]))
    places, at_vertices = [place for _, place, _ in every], np.array([values for _, _, values in every]).T
    strains = at_vertices.mean(axis=0) * duration
    worst = int(np.argmax(np.abs(strains)))
    if abs(strains[worst]) > 1:
        at = ", ".join(f"{coordinate:.4g}" for coordinate in places[worst])
        rate = at_vertices[np.argmax(np.abs(at_vertices[:, worst])), worst]
        warnings.warn(
            f"walls: their velocities alone determine div v = {rate:.3g} 1/s at ({at}) m, the corner of a "
            f"cell whose edges there lie on walls; no pressure can hold its volume ({count} such "
            "cells): mesh with split_corners = true, or divide them by geometries.split_corner_cells(mesh)",
            InputWarning,
            stacklevel=4,
        )


def _corner_cells(step: Step) -> list[tuple[int, int]]:
    """Cells and their vertices on moving walls at which all their edges lie on walls that prescribe v."""
    mesh, conditions = step.mesh, step.walls.conditions
    moving = [name for name, wall in conditions.items() if isinstance(wall, PrescribedTangential)]
    if not moving:
        return []
    held = moving + [name for name, wall in conditions.items() if isinstance(wall, NoSlip)]
    of_held = {edge.nr for facet in step.walls.region(held).Elements() for edge in facet.edges}
    edges = _on_all_ranks(of_held, HCurl(mesh, order=0))
    of_moving = {v.nr for facet in step.walls.region(moving).Elements() for v in facet.vertices}
    found = set()
    for number in _on_all_ranks(of_moving, H1(mesh, order=1)):
        vertex = mesh.vertices[number]
        around = {edge.nr for edge in vertex.edges}
        for cell in vertex.elements:
            if edges.issuperset(around.intersection(edge.nr for edge in mesh[cell].edges)):
                found.add((cell.nr, number))
    return sorted(found)


def _on_all_ranks(numbers: set[int], space: FESpace) -> set[int]:
    """Those of a space's unknowns that are in the set of some rank; collective."""
    has = np.zeros(space.ndof)
    has[list(numbers)] = 1.0
    return set(np.flatnonzero(Exchange.of(space, Communicator.of(space.mesh)).sum(has)).tolist())


def _divergences(step: Step, cells: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """The places of these vertices, m, and div v there in these cells, 1/s, at the present time."""
    mesh, walls = step.mesh, step.moving_walls
    v = GridFunction(step.layout.blocks["v"])
    values = v.vec.FV().NumPy()
    for name, (velocity, mask) in walls.moving.items():
        values[mask] = walls.interpolate(name, as_vector(velocity, mesh.dim, name))[mask]
    if not cells:  # of this rank
        return np.zeros((0, mesh.dim)), np.zeros(0)
    points = mesh.MapToAllElements(_VERTICES, VOL)
    points = points[np.isin(points["nr"], [cell for cell, _ in cells])]
    found = np.asarray(tr(Fields(step.layout, {"v": v}).grad_v)(points)).ravel()
    at = np.asarray(CF((x, y, z)[: mesh.dim])(points))
    places = np.array([mesh.vertices[vertex].point for _, vertex in cells])
    wanted = []
    for (cell, _), place in zip(cells, places, strict=True):
        own = np.flatnonzero(points["nr"] == cell)
        wanted.append(own[np.argmin(np.linalg.norm(at[own] - place, axis=1))])
    return places, found[wanted]
