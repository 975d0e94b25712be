"""States as one HTML file: mesh, fields and viewer in it, nothing from the network.

2D meshes are drawn whole, 3D ones by their boundary and by a movable plane that cuts them open; every cell
has its own values, so that jumps between cells show.  With several states there is a slider of time.  The
viewer (viewer.html) draws with a depth buffer of its own on a canvas: it needs neither WebGL nor a graphics
card.
"""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ngsolve import (
    BND,
    CF,
    ET,
    VOL,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    IntegrationRule,
    Mesh,
    x,
    y,
    z,
)

from ngvisco.errors import ParameterError
from ngvisco.run.fields import USUAL, field_unit, outlined
from ngvisco.run.files import write_atomically
from ngvisco.run.vtu import read_frame, read_series_files

_VIEWER = Path(__file__).with_name("viewer.html")


@dataclass(frozen=True)
class Drawing:
    """What a page shows: triangles, in 3D the tetrahedra behind them, and values at all their corners.

    Attributes
    ----------
    dim : int
    triangles : array (3 count, 3)
        Corners of the drawn triangles, m.
    cells : array (4 count, 3)
        Corners of the tetrahedra that a plane cuts; empty in 2D.
    times : sequence of float
        Of the states, s.
    fields : mapping of names to (values at ``triangles``, values at ``cells``), each (states, corners)
    """

    dim: int
    triangles: np.ndarray
    cells: np.ndarray
    times: Sequence[float]
    fields: Mapping[str, tuple[np.ndarray, np.ndarray]]
    outlines: Sequence[tuple[np.ndarray, np.ndarray]] = ()
    """Fractions of bodies as a field is, drawn as lines where they are one half."""


def write_scene(
    mesh: Mesh,
    fields: Mapping[str, CoefficientFunction],
    path: str | os.PathLike[str],
    title: str = "ngvisco",
    subdivisions: int = 3,
    outlines: Sequence[CoefficientFunction] = (),
) -> None:
    """Write the view of scalar fields at the present time.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    fields : mapping of names to scalar coefficient functions, not empty
    path : path of the HTML file
    title : str
    subdivisions : int
        Every triangle is drawn as subdivisions^2 ones, in which fields are linear.
    outlines : sequence of scalar coefficient functions
        Volume fractions of bodies: drawn as lines where they are one half.
    """
    if not fields:
        raise ParameterError("write_scene.fields", list(fields), "at least one field")
    for name, value in fields.items():
        if value.dim != 1:
            raise ParameterError(f"write_scene field {name!r}", value.dim, "a scalar")
    together = CF((*fields.values(), *outlines))
    points, values = _triangles(mesh, together, subdivisions)
    corners, inside = _tetrahedra(mesh, together)
    every = [(values[None, :, i], inside[None, :, i]) for i in range(values.shape[1])]
    named = dict(zip(fields, every, strict=False))
    write_page(Drawing(mesh.dim, points, corners, [0.0], named, every[len(fields) :]), path, title)


def write_scene_of_series(
    series: str | os.PathLike[str],
    path: str | os.PathLike[str],
    fields: Sequence[str] | None = None,
    title: str = "ngvisco",
    most: int = 60,
) -> None:
    """Write the view of a run's VTK series, with a slider of time.

    Parameters
    ----------
    series : path
        Directory of the series, e.g. ``results/swirl/vtk``.
    path : path of the HTML file
    fields : sequence of str, optional
        Of a vector its modulus or ``NAME_i``, of a tensor ``NAME_ij``; default density, J, velocity, pressure
        and von Mises stress, as far as the series has them.
    title : str
    most : int
        States that the page holds, evenly chosen from the series' ones.

    Raises
    ------
    CheckpointError
        If there is no series, or a file of it cannot be read.
    UnknownNameError
        For a field that the series does not have.
    """
    files = read_series_files(series)
    chosen = sorted({round(i) for i in np.linspace(0, len(files) - 1, min(most, len(files)))})
    times, frames = [files[i][0] for i in chosen], [read_frame(files[i][1]) for i in chosen]
    first = frames[0]
    names = [name for name in USUAL if name in first.fields] if fields is None else list(fields)
    if not names:
        raise ParameterError("write_scene_of_series.fields", fields, "at least one field of the series")
    faces = (first.cells if first.dim == 2 else first.boundary()).ravel()
    corners = first.cells.ravel() if first.dim == 3 else faces[:0]
    lines = outlined(first.fields)
    values = {name: np.array([frame.scalar(name) for frame in frames]) for name in (*names, *lines)}
    placed = {name: (table[:, faces], table[:, corners]) for name, table in values.items()}
    named = {name: placed[name] for name in names}
    of_bodies = [placed[name] for name in lines]
    drawing = Drawing(first.dim, first.points[faces], first.points[corners], times, named, of_bodies)
    write_page(drawing, path, title)


def write_page(drawing: Drawing, path: str | os.PathLike[str], title: str) -> None:
    """Write a drawing with the viewer into one file."""
    data = {
        "title": title,
        "dim": drawing.dim,
        "triangles": len(drawing.triangles) // 3,
        "points": _packed(drawing.triangles),
        "cells": _packed(drawing.cells),
        "times": [float(time) for time in drawing.times],
        "fields": [
            {"name": name, "unit": field_unit(name), "values": _packed(values), "inside": _packed(inside)}
            for name, (values, inside) in drawing.fields.items()
        ],
        "outlines": [
            {"values": _packed(values), "inside": _packed(inside)} for values, inside in drawing.outlines
        ],
    }
    # "</" would end the script element wherever it stands
    text = json.dumps(data).replace("</", "<\\/")
    page = _VIEWER.read_text(encoding="utf-8")
    page = page.replace("__TITLE__", html.escape(title)).replace("__DATA__", text)
    write_atomically(Path(path), page.encode())


def _tetrahedra(mesh: Mesh, value: CoefficientFunction) -> tuple[np.ndarray, np.ndarray]:
    """Corners of all tetrahedra, (4 count, 3), and the values there; none in 2D."""
    if mesh.dim == 2:
        return np.empty((0, 3)), np.empty((0, value.dim))
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    mapped = mesh.MapToAllElements({ET.TET: IntegrationRule(corners, [0.0] * 4)}, VOL)
    table = np.asarray(CF((x, y, z, value))(mapped)).reshape(-1, 3 + value.dim)
    return table[:, :3], table[:, 3:]


def _triangles(mesh: Mesh, value: CoefficientFunction, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of all small triangles, (3 count, 3), and the values there, (3 count, fields)."""
    flat = mesh.dim == 2
    rules: dict[Any, IntegrationRule] = {}
    local: dict[Any, list[tuple[int, int, int]]] = {}
    for et, points, small in ((ET.TRIG, *_lattice(n, False)), (ET.QUAD, *_lattice(n, True))):
        rules[et], local[et] = IntegrationRule(points, [0.0] * len(points)), small
    kind = VOL if flat else BND
    mapped = mesh.MapToAllElements(rules, kind)
    wanted = CF((x, y, z, value)) if flat else CF((x, y, z, BoundaryFromVolumeCF(value)))
    table = np.asarray(wanted(mapped)).reshape(-1, 3 + value.dim)
    corners, start = [], 0
    for element in mesh.Elements(kind):
        corners.append(start + np.array(local[element.type]).ravel())
        start += len(rules[element.type].points)
    chosen = table[np.concatenate(corners)]
    return chosen[:, :3], chosen[:, 3:]


def _lattice(n: int, square: bool) -> tuple[list[tuple[float, float]], list[tuple[int, int, int]]]:
    """Points of a subdivided reference triangle (or square), and its small triangles."""
    places = [(i, j) for j in range(n + 1) for i in range(n + 1 if square else n + 1 - j)]
    index = {place: number for number, place in enumerate(places)}
    small = []
    for i, j in places:
        if (i + 1, j) in index and (i, j + 1) in index:
            small.append((index[i, j], index[i + 1, j], index[i, j + 1]))
        if (i + 1, j + 1) in index:
            small.append((index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]))
    return [(i / n, j / n) for i, j in places], small


def _packed(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype="<f4").tobytes()).decode()
