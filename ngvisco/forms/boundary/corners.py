"""Corners in which the velocities of walls determine div v: no pressure can hold it there.

Where all edges of a cell at a vertex lie on walls that prescribe v, they give grad v of that cell at the
vertex, for any order of v.  Under a lid of speed U that meets a wall at rest div v = +-U/h there, and as v
itself is zero the matter stays: J and rho change by exp(+-U t/h).  A cell that is divided at its midpoint
has an edge into the interior at every vertex, and div v is free (``ngvisco.geometries.split_corner_cells``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from ngsolve import CF, ET, H1, VOL, GridFunction, HCurl, IntegrationRule, x, y, z

from ngvisco.errors import InputWarning
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.mesh_arrays import VERTICES, mask_of
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import cell_numbers
from ngvisco.physics.loads import as_vector
from ngvisco.physics.signals import time
from ngvisco.physics.tensors import tr
from ngvisco.physics.walls import HELD, MOVING

_RULES = {et: IntegrationRule(VERTICES[et], [0.0] * len(VERTICES[et])) for et in (ET.TRIG, ET.QUAD, ET.TET)}


def warn_of_corners(step: Step, times: Sequence[float]) -> None:
    """Say where the walls' velocities alone change a volume e-fold from the first to the last time, s.

    Collective; all ranks say the same.
    """
    cells, ranks = _corner_cells(step), Communicator.of(step.mesh)
    duration = times[-1] - times[0]
    if not ranks.any(bool(cells)) or not duration > 0:
        return
    present = time.Get()
    try:
        rates = []
        for t in times:
            time.Set(t)
            rates.append(_divergences(step, cells))
    finally:
        time.Set(present)
    number = cell_numbers(step.mesh)
    mine = [
        (int(number[cell]), vertex, tuple(place), values)
        for (cell, vertex), place, values in zip(
            cells, rates[0][0], np.array([values for _, values in rates]).T, strict=True
        )
    ]
    # as on one process: ranks number their vertices in the order of the whole mesh
    every = sorted((one for of_rank in ranks.gathered(mine) for one in of_rank), key=lambda one: one[:2])
    places, at_vertices = [one[2] for one in every], np.array([one[3] for one in every]).T
    strains = at_vertices.mean(axis=0) * duration
    worst = int(np.argmax(np.abs(strains)))
    if abs(strains[worst]) > 1:
        at = ", ".join(f"{coordinate:.4g}" for coordinate in places[worst])
        rate = at_vertices[np.argmax(np.abs(at_vertices[:, worst])), worst]
        ranks.warn(
            f"walls: their velocities alone determine div v = {rate:.3g} 1/s at ({at}) m, the corner of a "
            f"cell whose edges there lie on walls; no pressure can hold its volume ({len(every)} such "
            "cells): mesh with split_corners = true, or divide them by geometries.split_corner_cells(mesh)",
            InputWarning,
            stacklevel=4,
        )


def _corner_cells(step: Step) -> list[tuple[int, int]]:
    """Cells and their vertices on moving walls at which all their edges lie on walls that prescribe v."""
    mesh, conditions = step.mesh, step.walls.conditions
    moving = [name for name, wall in conditions.items() if isinstance(wall, MOVING)]
    if not moving:
        return []
    held = [name for name, wall in conditions.items() if isinstance(wall, HELD)]
    # an edge or a vertex may lie on walls by facets of other ranks alone, which these spaces know
    on_walls = ~mask_of(HCurl(mesh, order=0, dirichlet=step.walls.region(held)).FreeDofs())
    moved = ~mask_of(H1(mesh, order=1, dirichlet=step.walls.region(moving)).FreeDofs())
    found = set()
    for vertex in (mesh.vertices[int(number)] for number in np.flatnonzero(moved)):
        around = {edge.nr for edge in vertex.edges}
        for cell in vertex.elements:
            if on_walls[list(around.intersection(edge.nr for edge in mesh[cell].edges))].all():
                found.add((cell.nr, vertex.nr))
    return sorted(found)


def _divergences(step: Step, cells: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """The places of these vertices, m, and div v there in these cells, 1/s, at the present time."""
    mesh, walls = step.mesh, step.moving_walls
    v = GridFunction(step.layout.blocks["v"])
    values = v.vec.FV().NumPy()
    for name, (velocity, mask) in walls.moving.items():
        values[mask] = walls.interpolate(name, as_vector(velocity, mesh.dim, name))[mask]
    points = mesh.MapToAllElements(_RULES, VOL)
    points = points[np.isin(points["nr"], [cell for cell, _ in cells])]
    found = np.asarray(tr(Fields(step.layout, {"v": v}).grad_v)(points)).ravel()
    at = np.asarray(CF((x, y, z)[: mesh.dim])(points))
    places = np.array([mesh.vertices[vertex].point for _, vertex in cells])
    wanted = []
    for (cell, _), place in zip(cells, places, strict=True):
        own = np.flatnonzero(points["nr"] == cell)
        wanted.append(own[np.argmin(np.linalg.norm(at[own] - place, axis=1))])
    return places, found[wanted]
