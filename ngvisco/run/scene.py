"""States as one HTML file with mesh, fields and viewer, which loads nothing from the network.

A 2D mesh is drawn whole. A 3D mesh is drawn by its boundary and by a movable plane that cuts it open.  Every
cell has its own values, so that jumps between cells show.  Several states have a slider of time.  The viewer
(viewer.html) draws with a depth buffer of its own on a canvas: it needs neither WebGL nor a graphics card.
"""

import base64
import html
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngvisco.errors import ParameterError
from ngvisco.run.fields import USUAL, field_unit
from ngvisco.run.files import AnyPath, write_atomically
from ngvisco.run.frames import Frame, frame_of, read_frame, read_series_files

_VIEWER = Path(__file__).with_name("viewer.html")
_PIECES = {2: 3, 3: 1}
"""Number of parts of a cell's side, by dimension; fields are linear in a part.  In 3D cells are not divided,
since the page holds all tetrahedra."""


def write_scene(
    mesh: Mesh,
    fields: Mapping[str, CoefficientFunction],
    path: AnyPath,
    title: str = "ngvisco",
    outlines: Sequence[CoefficientFunction] = (),
) -> None:
    """Write a page that shows scalar fields, by name, at the present time.

    ``outlines`` are volume fractions of bodies; the lines where they are one half are drawn.
    """
    if not fields:
        raise ParameterError("write_scene.fields", list(fields), "at least one field")
    frame = frame_of(mesh, fields, outlines, pieces=_PIECES[mesh.dim])
    _write_page([(0.0, frame)], list(fields), path, title)


def write_scene_of_series(
    series: AnyPath,
    path: AnyPath,
    fields: Sequence[str] | None = None,
    title: str = "ngvisco",
    most: int = 60,
) -> None:
    """Write a page that shows a run's VTK series, e.g. in ``results/swirl/vtk``, with a slider of time.

    ``fields`` are names of scalars, of components (``NAME_i`` and ``NAME_ij``), or of vectors, whose modulus
    is shown.  The default is density, J, velocity, pressure and von Mises stress, if the series has them. The
    page holds at most ``most`` states, evenly chosen.  Raises CheckpointError if there is no series, or a
    file cannot be read; UnknownNameError for a field that the series does not have.
    """
    files = read_series_files(series)
    chosen = sorted({round(i) for i in np.linspace(0, len(files) - 1, min(most, len(files)))})
    states = [(files[i][0], read_frame(files[i][1])) for i in chosen]
    names = [name for name in USUAL if name in states[0][1].fields] if fields is None else list(fields)
    if not names:
        raise ParameterError("write_scene_of_series.fields", fields, "at least one field of the series")
    _write_page(states, names, path, title)


def _write_page(
    states: Sequence[tuple[float, Frame]], names: Sequence[str], path: AnyPath, title: str
) -> None:
    """Write states, each with its time (s), and the viewer into one file.

    In 3D faces are drawn; the file holds the tetrahedra too, for the plane that cuts them.
    """
    frames = [frame for _, frame in states]
    meshes, mesh, drawn = [frames[0]], list[int](), [_corners(frames[0])]
    for frame in frames:
        last = meshes[-1]
        if not (np.array_equal(frame.points, last.points) and np.array_equal(frame.cells, last.cells)):
            meshes.append(frame)
            drawn.append(_corners(frame))
        mesh.append(len(meshes) - 1)

    def packed(values: Sequence[np.ndarray]) -> dict[str, str]:
        parts = {"values": 0, "inside": 1}
        pairs = list(zip(values, (drawn[i] for i in mesh), strict=True))
        return {name: _packed(np.concatenate([v[at[k]] for v, at in pairs])) for name, k in parts.items()}

    data = {
        "title": title,
        "dim": frames[0].dim,
        "meshes": [
            {"points": _packed(frame.points[faces]), "cells": _packed(frame.points[corners])}
            for frame, (faces, corners) in zip(meshes, drawn, strict=True)
        ],
        "mesh": mesh,
        "times": [float(time) for time, _ in states],
        "fields": [
            {"name": name, "unit": field_unit(name)} | packed([frame.scalar(name) for frame in frames])
            for name in names
        ],
        "outlines": [packed(of_body) for of_body in zip(*(f.fractions() for f in frames), strict=True)],
    }
    # "</" in a text would end the script element
    text = json.dumps(data).replace("</", "<\\/")
    page = _VIEWER.read_text(encoding="utf-8")
    page = page.replace("__TITLE__", html.escape(title)).replace("__DATA__", text)
    write_atomically(Path(path), page.encode())


def _corners(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the points of the triangles that are drawn, and of the tetrahedra that are cut."""
    faces = frame.cells if frame.dim == 2 else frame.boundary()
    return faces.ravel(), frame.cells.ravel() if frame.dim == 3 else faces.ravel()[:0]


def _packed(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype="<f4").tobytes()).decode()
