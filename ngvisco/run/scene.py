"""A state as one HTML file: mesh, fields and viewer in it, nothing from the network.

2D meshes are drawn whole, 3D ones by their boundary; every cell has its own values, so that jumps
between cells show.  The viewer (viewer.html) draws with a depth buffer of its own on a canvas: it
needs neither WebGL nor a graphics card.
"""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Mapping
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
from ngvisco.run.fields import field_unit
from ngvisco.run.files import write_atomically

_VIEWER = Path(__file__).with_name("viewer.html")


def write_scene(
    mesh: Mesh,
    fields: Mapping[str, CoefficientFunction],
    path: str | os.PathLike[str],
    title: str = "ngvisco",
    subdivisions: int = 3,
) -> None:
    """Write the view of scalar fields.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    fields : mapping of names to scalar coefficient functions, not empty
    path : path of the HTML file
    title : str
    subdivisions : int
        Every triangle is drawn as subdivisions^2 ones, in which fields are linear.
    """
    if not fields:
        raise ParameterError("write_scene.fields", list(fields), "at least one field")
    for name, value in fields.items():
        if value.dim != 1:
            raise ParameterError(f"write_scene field {name!r}", value.dim, "a scalar")
    points, values = _triangles(mesh, CF(tuple(fields.values())), subdivisions)
    data = {
        "title": title,
        "dim": mesh.dim,
        "triangles": len(points) // 3,
        "points": _packed(points),
        "fields": [
            {"name": name, "unit": field_unit(name), "values": _packed(values[:, i])}
            for i, name in enumerate(fields)
        ],
    }
    # "</" would end the script element wherever it stands
    text = json.dumps(data).replace("</", "<\\/")
    page = (
        _VIEWER.read_text(encoding="utf-8").replace("__TITLE__", html.escape(title)).replace("__DATA__", text)
    )
    write_atomically(Path(path), page.encode())


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
