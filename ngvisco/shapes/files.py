"""Shapes from files: closed surfaces of triangles (STL), and dark parts of a picture (PNG)."""

import importlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ngvisco.errors import ParameterError, Quantity, as_place, require_fields, require_path
from ngvisco.shapes.places import Places
from ngvisco.shapes.shape import Shape, require_dim

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_SAME = 1e-6  # fraction of the surface's size below which corners coincide, because files round them
_RAYS = np.array([[1, 2, 3], [5, -7, 3], [27, 12, -17]]) / np.sqrt([[14], [83], [1162]])
"""Orthogonal directions off all axes and diagonals, so that rays seldom meet edges of usual surfaces."""


@dataclass(frozen=True)
class ClosedSurface(Shape):
    """The inside of a closed surface of triangles, from an STL file (text or binary).

    The surface may have several parts with any orientation.  A part within another part, of the opposite
    orientation, is a cavity.  In a closed surface every edge belongs to two triangles, which run along the
    edge in opposite senses.  Raises ParameterError if the file is missing or no STL file, if it has no
    triangles or a repeated triangle, or if its surface does not close.

    Parameters
    ----------
    path : path
        STL file with a closed surface; in a case file the path is relative to the case file.
    scale : float
        Length of the STL file's unit, which the file does not contain.
    """

    path: Annotated[str | os.PathLike[str], Quantity(example="part.stl")]
    scale: Annotated[float, Quantity("m", "> 0", 1e-3)] = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", str(require_path("ClosedSurface.path", self.path)))
        require_fields(self)
        self.triangles  # read and checked  # noqa: B018

    @cached_property
    def triangles(self) -> np.ndarray:
        """Corners of the triangles, (triangles, 3, 3), m, counter-clockwise seen from outside."""
        corners = _read(Path(self.path)) * self.scale
        if not len(corners):
            raise _no_surface(self.path, "an STL file with triangles, but this file has none")
        if not np.isfinite(corners).all():
            raise _no_surface(self.path, "a file of triangles with finite coordinates")
        size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
        part = _connected_parts(self.path, corners, size)
        a, b, c = corners.transpose(1, 0, 2) - corners.mean(axis=(0, 1))
        volumes = np.bincount(part, weights=np.sum(a * np.cross(b, c), axis=1) / 6)
        if not (abs(volumes) > 1e-12 * size**3).any():
            raise _no_surface(self.path, "a file of a surface that encloses a volume")
        return np.where(_inward(corners, part, volumes)[part][:, None, None], corners[:, ::-1], corners)

    def level(self, at: Places) -> np.ndarray:
        if at.mesh.dim != 3:
            raise _no_surface(
                self.path,
                "no closed surface in a mesh of two dimensions, since a surface bounds no part of a plane",
            )
        # ``crossings`` is 1 in the surface's inside, and larger where parts overlap
        inside = crossings(self.triangles, at.coordinates) > 0
        size = at.spacing.copy()
        near = at.of_cut_pieces(inside)
        size[near] = np.minimum(size[near], _distances(self.triangles, at.coordinates[near]))
        return np.where(inside, size, -size)


def _no_surface(path: str | os.PathLike[str], expected: str) -> ParameterError:
    """The error of a file without a closed surface."""
    return ParameterError("ClosedSurface.path", str(path), expected)


def _read(path: Path) -> np.ndarray:
    """Corners of the triangles, (triangles, 3, 3), in the file's unit."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise _no_surface(path, f"a readable file ({error.strerror})") from error
    count = int.from_bytes(raw[80:84], "little")
    if len(raw) >= 84 and len(raw) == 84 + count * _RECORD.itemsize:
        return np.frombuffer(raw, _RECORD, count, 84)["corners"].astype(float)
    text = raw.decode("ascii", errors="replace")
    if not text.lstrip().startswith("solid") or "endsolid" not in text:
        raise _no_surface(path, "a whole STL file, text or binary")
    number = r"([+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)"
    vertices = re.findall(rf"vertex\s+{number}\s+{number}\s+{number}", text)
    if len(vertices) % 3 or len(vertices) != len(re.findall(r"\bvertex\b", text)):
        raise _no_surface(path, "a file of triangles, each with three corners of three numbers")
    try:
        return np.array(vertices, dtype=float).reshape(-1, 3, 3)
    except ValueError as error:
        raise _no_surface(path, f"a file with numbers as coordinates ({error})") from error


def _connected_parts(path: str | os.PathLike[str], corners: np.ndarray, size: float) -> np.ndarray:
    """Number of each triangle's part of the surface; parts have no edge in common.

    Raises ParameterError unless the triangles run along each edge equally often in both senses.
    """
    if size == 0:
        raise _no_surface(path, "a file of a surface that encloses a volume, but all corners are one point")
    places = np.round(corners.reshape(-1, 3) / (_SAME * size)).astype(np.int64)
    _, numbers = np.unique(places, axis=0, return_inverse=True)
    triangles = numbers.reshape(-1, 3)
    if twice := len(triangles) - len(np.unique(np.sort(triangles, axis=1), axis=0)):
        raise _no_surface(
            path,
            f"a file with each triangle once, but {twice} of the {len(triangles)} triangles are repeated",
        )
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)  # excludes triangles collapsed to a line
    edges = np.concatenate([triangles[whole][:, [i, (i + 1) % 3]] for i in range(3)])
    _, where = np.unique(edges.min(axis=1) * (numbers.max() + 1) + edges.max(axis=1), return_inverse=True)
    where = where.reshape(-1)
    sense = np.bincount(where, weights=np.sign(edges[:, 1] - edges[:, 0]))
    open_edges = int(np.count_nonzero(sense))
    if open_edges:
        raise _no_surface(
            path,
            f"a file of a closed surface, but at {open_edges} of {len(sense)} edges the surface is open, or "
            "neighbouring triangles have opposite orientations",
        )
    owner = np.tile(np.flatnonzero(whole), 3)
    count = len(triangles) + len(sense)  # nodes of the graph: triangles and edges
    graph = coo_matrix((np.ones(len(owner)), (owner, len(triangles) + where)), shape=(count, count))
    part = connected_components(graph, directed=False)[1][: len(triangles)]
    return np.unique(part, return_inverse=True)[1].reshape(-1)


def _inward(corners: np.ndarray, part: np.ndarray, volumes: np.ndarray) -> np.ndarray:
    """Whether each part has to be reversed; a part within others follows the outermost part around it."""
    pieces = [corners[part == number] for number in range(len(volumes))]
    low = np.array([piece.min(axis=(0, 1)) for piece in pieces])
    high = np.array([piece.max(axis=(0, 1)) for piece in pieces])
    around = np.arange(len(pieces))  # the outermost part that contains each part, or the part itself
    largest_first = np.argsort(-abs(volumes), kind="stable")
    for number, piece in enumerate(pieces):
        within = ((low <= low[number]) & (high >= high[number])).all(axis=1)
        for larger in largest_first[within[largest_first]]:
            if abs(volumes[larger]) <= abs(volumes[number]):
                break
            if crossings(pieces[larger], piece.mean(axis=1)).all():
                around[number] = larger
                break
    return volumes[around] < 0


def crossings(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How often a ray from each point leaves a closed surface, less how often it enters: 1 inside, 0 outside.

    Parameters
    ----------
    triangles : array (triangles, 3, 3)
        Corners, m, counter-clockwise seen from outside.
    points : array (points, 3)
    """
    height, heights = points @ _RAYS[0], triangles @ _RAYS[0]
    beside = np.flatnonzero((height >= heights.min()) & (height <= heights.max()))
    result = np.zeros(len(points))
    for members, sense, above in _met(triangles, points[beside], _RAYS[0]):
        result[beside[members]] = np.sum(np.where(above > 0, sense, 0.0), axis=1)
    return result


def _distances(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances of points to a surface along three orthogonal lines, the smallest of the three, m.

    Near a plane face the result is at most sqrt(3) times the distance; the result is inf if no line meets the
    surface.
    """
    result = np.full(len(points), np.inf)
    for ray in _RAYS:
        for members, _, above in _met(triangles, points, ray):
            result[members] = np.minimum(result[members], np.nanmin(np.abs(above), axis=1, initial=np.inf))
    return result


def _met(
    triangles: np.ndarray, points: np.ndarray, ray: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Intersections of triangles with the lines through points along ``ray``.

    Yields, for groups of n points, three arrays: the numbers of the points, (n,); the sense of each triangle
    near their lines, (triangles,), 1 if the ray leaves the surface at the triangle and -1 if it enters; and
    the heights of intersections above the points, (n, triangles), m, NaN without an intersection.
    """
    # points and triangles are sorted into squares of the plane normal to the lines, so that a line is
    # compared with few triangles
    across = np.cross(ray, (1.0, 0.0, 0.0)) / np.linalg.norm(ray[1:])
    plane = np.array([across, np.cross(ray, across)])  # a right-handed frame with the ray
    flat, along = triangles @ plane.T, triangles @ ray
    at, height = points @ plane.T, points @ ray
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    count = int(np.clip(np.sqrt(len(triangles)), 1, 256))

    def square(where: np.ndarray) -> np.ndarray:
        return np.clip((count * (where - low) / (high - low)).astype(int), 0, count - 1)

    first, last = square(flat.min(axis=1)), square(flat.max(axis=1))
    todo = np.flatnonzero(((at >= low) & (at <= high)).all(axis=1))
    if not len(todo):
        return
    numbers = square(at[todo]) @ np.array([count, 1])
    order = np.argsort(numbers, kind="stable")
    squares, starts = np.unique(numbers[order], return_index=True)
    for number, members in zip(squares, np.split(todo[order], starts[1:]), strict=True):
        i, j = divmod(int(number), count)
        meets = (first[:, 0] <= i) & (last[:, 0] >= i) & (first[:, 1] <= j) & (last[:, 1] >= j)
        if meets.any():
            sense, heights = _heights(flat[meets], along[meets], at[members])
            yield members, sense, heights - height[members, None]


def _heights(flat: np.ndarray, along: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sense of triangles, (triangles,), and heights of intersections along the lines, (points, triangles)."""
    a, b, c = flat.transpose(1, 0, 2)[:, None]
    p = at[:, None]

    def area(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        return (v[..., 0] - u[..., 0]) * (w[..., 1] - u[..., 1]) - (v[..., 1] - u[..., 1]) * (
            w[..., 0] - u[..., 0]
        )

    whole = area(a, b, c)
    parts = np.stack([area(p, b, c), area(a, p, c), area(a, b, p)])
    sense = np.sign(whole)
    hit = (parts * sense > 0).all(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        met = np.einsum("ipt,ti->pt", parts, along) / whole
    return sense[0], np.where(hit, met, np.nan)


_LUMA = np.array([0.299, 0.587, 0.114])  # weights of red, green, blue in grey


@dataclass(frozen=True)
class Image(Shape):
    """The dark parts of a picture in the plane; matplotlib (extra ``plots``) reads the picture.

    Raises ParameterError if the file is missing or no PNG, or if matplotlib is missing.

    Parameters
    ----------
    path : path
        PNG file, grey or in colours; a path in a case file is relative to the case file.  Transparent pixels
        count as white.
    low : pair of numbers
        Lower left corner of the picture; the shape is empty outside the picture.
    high : pair of numbers
        Upper right corner of the picture.
    threshold : float
        Grey, from 0 (black) to 1 (white), below which a point belongs to the shape; grey is interpolated
        between the middles of pixels.
    dark : bool
        Whether the shape is the part that is darker than the threshold; if false, it is the brighter part.
    """

    path: Annotated[str | os.PathLike[str], Quantity(example="part.png")]
    low: Annotated[tuple[float, float], Quantity("m", example=[0.0, 0.0])]
    high: Annotated[tuple[float, float], Quantity("m", example=[1.0, 1.0])]
    threshold: Annotated[float, Quantity("1", "in (0, 1)")] = 0.5
    dark: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", str(require_path("Image.path", self.path)))
        low, high = as_place("Image.low", self.low), as_place("Image.high", self.high)
        if len(low) != 2 or len(high) != 2 or not (low[0] < high[0] and low[1] < high[1]):
            raise ParameterError("Image.high", self.high, f"two coordinates above those of low = {low}")
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        require_fields(self)
        self.grey  # read and checked  # noqa: B018

    @cached_property
    def grey(self) -> np.ndarray:
        """Grey of the pixels, 0 (black) to 1 (white), (columns from the left, rows from below)."""
        try:
            image = importlib.import_module("matplotlib.image")
        except ImportError as error:
            expected = 'an installed matplotlib, which reads images; run pip install "ngvisco[plots]"'
            raise ParameterError("Image.path", self.path, expected) from error
        if Path(self.path).suffix.lower() != ".png":
            raise ParameterError("Image.path", self.path, "a PNG file, with a name that ends in .png")
        try:
            pixels = np.asarray(image.imread(self.path), dtype=float)
        except (OSError, SyntaxError, ValueError) as error:
            raise ParameterError("Image.path", self.path, f"a readable PNG file ({error})") from error
        if pixels.ndim == 3:
            alpha = pixels[..., -1] if pixels.shape[2] in (2, 4) else 1.0
            colour = pixels[..., :3] @ _LUMA if pixels.shape[2] >= 3 else pixels[..., 0]
            pixels = alpha * colour + (1 - alpha)
        return pixels[::-1].T

    def level(self, at: Places) -> np.ndarray:
        require_dim("Image.low", self.low, at.mesh)
        low, size, count = np.array(self.low), np.subtract(self.high, self.low), np.array(self.grey.shape)
        darkness = (self.threshold - self.grey) * (1 if self.dark else -1)
        from scipy.interpolate import RegularGridInterpolator  # a fifth of the package's import time

        # values belong to the middles of pixels; padding extends the outer pixels to the picture's edges
        padded = np.pad(darkness, 1, mode="edge")
        axes = [np.arange(-0.5, n + 1) for n in count]
        pixels = (at.coordinates - low) / size * count
        inside = ((pixels >= 0) & (pixels <= count)).all(axis=1)
        result = np.full(len(pixels), -1.0)
        result[inside] = RegularGridInterpolator(axes, padded)(pixels[inside])
        return result
