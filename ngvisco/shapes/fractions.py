"""Fractions of each cell that shapes fill, as polynomials on the cells.

A cell cut by a surface is divided into sub-cells. In each sub-cell the level is interpolated linearly, and
the positive share of a simplex is computed exactly. The interpolation cuts off edges and convex parts by the
square of the sub-cells' size; shares in sub-cells of twice the size allow an extrapolation. The fraction is
the L2 projection of the shares. Where the fraction leaves [0, 1], it is scaled towards its mean (Zhang, Shu);
the scaling keeps the volume of the shares.

Several shapes lie over each other like sheets of paper, the last one on top.  The fractions of all shapes and
of the rest sum to one at every point.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Protocol

import numpy as np
from ngsolve import L2, VOL, CoefficientFunction, Det, GridFunction, Integrate, Mesh, specialcf

from ngvisco.errors import NgviscoError
from ngvisco.parallel.communicator import Communicator
from ngvisco.shapes.places import Places

_LOOKED_AT = 4  # number of pieces of a cell's edges; levels are tested at the pieces' ends
MISSED = (
    f"a place within the domain that is at least 1/{_LOOKED_AT} of a cell thick, since no cell has a part "
    "of this place; for a smaller place take a finer mesh (maxh, refine)"
)
"""Expectation in the error message for a shape that fills no cell."""
_PIECES = {2: 32, 3: 12}  # pieces of the edges of cut cells, even numbers
_INSET = 1e-9
"""Fraction of the distance to the cell's middle by which sample points are moved inwards, so that a cell
lies on one definite side of a surface along its side."""
_AT_ONCE = 200_000  # sub-cells that are computed together
_QUADRILATERALS = (11, 13, 14)  # Netgen's numbers of the element types


class HasLevel(Protocol):
    """A part of space, given by a level that is positive inside; see ``Shape``."""

    def level(self, at: Places) -> np.ndarray: ...


def fractions(mesh: Mesh, shapes: Sequence[HasLevel], order: int = 1) -> list[GridFunction]:
    """Fractions of every cell that shapes fill; later shapes cover earlier ones.

    A part of a shape thinner than a quarter of a cell may be missed.  Raises ParameterError or
    UnknownNameError for a shape that does not fit the mesh.

    Parameters
    ----------
    mesh : ngsolve.Mesh
        Mesh of triangles and quadrilaterals, or of tetrahedra.
    shapes : sequence of Shape
    order : int
        Order of the polynomials on the cells, 0, 1 or 2.

    Returns
    -------
    list of GridFunction
        Discontinuous P_order fractions of the shapes and, last, of the rest, which sum to one. Values are in
        [0, 1]. For order 2, values between the corners of sub-cells may leave [0, 1] by 1e-4.
    """
    powers = _powers(mesh.dim, order)
    coefficients = np.zeros((len(shapes) + 1, len(powers), mesh.ne))
    with Communicator.of(mesh).together(NgviscoError):
        for cells, is_quad in _groups(mesh):
            for some, shares in _shares(mesh, cells, is_quad, shapes):
                coefficients[..., some] = _projected(mesh, some, is_quad, shares, powers)
    return [_function(mesh, part, powers, order) for part in coefficients]


def volumes(mesh: Mesh, shapes: Sequence[HasLevel]) -> list[float]:
    """Volumes in the mesh, m^dim: of each shape's uncovered part, and last of the part outside all shapes."""
    cells = np.array(Integrate(CoefficientFunction(1.0), mesh, VOL, element_wise=True))
    volumes = np.array([cells @ part.vec.FV().NumPy() for part in fractions(mesh, shapes, 0)])
    return [float(volume) for volume in Communicator.of(mesh).totals(volumes)]


def _groups(mesh: Mesh) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield numbers of cells of one type, and whether they are quadrilaterals."""
    if mesh.dim == 3:
        yield np.arange(mesh.ne), False
        return
    quads = np.isin(mesh.ngmesh.Elements2D().NumPy()["type"], _QUADRILATERALS)
    for is_quad in (False, True):
        cells = np.flatnonzero(quads == is_quad)
        if len(cells):
            yield cells, is_quad


def _shares(
    mesh: Mesh, cells: np.ndarray, is_quad: bool, shapes: Sequence[HasLevel]
) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
    """Yield numbers of cells, and shares of small and large sub-cells, (shapes and rest, cells, sub-cells).

    A cell without a visible cut, in itself and in its neighbours, is one sub-cell.
    """
    corners, _ = subdivision(mesh.dim, _LOOKED_AT, is_quad)  # finds cuts by the signs of the levels
    levels = _levels(mesh, cells, corners, shapes)
    inside = levels > 0
    is_cut = (inside.any(axis=2) & ~inside.all(axis=2)).any(axis=0)
    elements = mesh.ngmesh.Elements2D() if mesh.dim == 2 else mesh.ngmesh.Elements3D()
    vertices = elements.NumPy()["nodes"][cells][:, :4]  # counted from 1; 0 pads
    near = np.zeros(vertices.max(initial=0) + 1, dtype=bool)
    near[vertices[is_cut]] = True
    near[0] = False
    is_cut = near[vertices].any(axis=1)
    whole = ~is_cut
    yield cells[whole], [_layered(inside[:, whole, :1].astype(float))]
    corners, pieces = subdivision(mesh.dim, _PIECES[mesh.dim], is_quad)
    large = _larger(mesh.dim, _PIECES[mesh.dim], is_quad)
    cut = cells[is_cut]
    for some in np.array_split(cut, max(1, len(cut) * len(pieces) // _AT_ONCE)):
        if len(some):
            levels = _levels(mesh, some, corners, shapes, np.concatenate([pieces, large]))
            yield some, [_layered(share_of_simplex(levels[..., numbers])) for numbers in (pieces, large)]


def _levels(
    mesh: Mesh,
    cells: np.ndarray,
    corners: np.ndarray,
    shapes: Sequence[HasLevel],
    pieces: np.ndarray | None = None,
) -> np.ndarray:
    """Levels of the shapes at the reference points ``corners`` of cells, (shapes, cells, corners)."""
    middle = corners.mean(axis=0)
    places = Places(mesh, cells, middle + (1 - _INSET) * (corners - middle), pieces)
    return np.array([shape.level(places) for shape in shapes]).reshape(len(shapes), len(cells), len(corners))


def _layered(shares: np.ndarray) -> np.ndarray:
    """Visible shares of shapes that cover each other, the last one on top, followed by the share of the
    rest."""
    seen, left = [], np.ones(shares.shape[1:])
    for share in shares[::-1]:
        seen.append(left * share)
        left = left * (1 - share)
    return np.array([*seen[::-1], left])


def share_of_simplex(levels: np.ndarray) -> np.ndarray:
    """Share of a simplex in which the linear function with given ``levels`` at its vertices is positive.

    If all levels have the same modulus, the levels give the side of each vertex but no distance; the result
    is then the share of positive vertices. ``levels`` are (..., 3) or (..., 4), shares (...).
    """
    values = np.sort(levels, axis=-1)
    count = np.sum(values > 0, axis=-1)
    last = values.shape[-1] - 1
    result = (count == last + 1).astype(float)
    is_single, all_but_one = count == 1, count == last
    # a corner of the simplex is cut off; its edges are cut at the zeros of the function
    top, low = values[is_single, -1:], values[all_but_one, :1]
    result[is_single] = np.prod(top / (top - values[is_single, :-1]), axis=-1)
    result[all_but_one] = 1 - np.prod(low / (low - values[all_but_one, 1:]), axis=-1)
    if last == 3:
        two = count == 2
        a, b, c, d = np.moveaxis(values[two], -1, 0)
        ca, cb, da, db = c / (c - a), c / (c - b), d / (d - a), d / (d - b)
        # the wedge between the edges cd and ab, as three tetrahedra
        result[two] = da * db + ca * cb * (1 - da) + da * cb * (1 - db)
    says_side_only = np.ptp(np.abs(values), axis=-1) == 0
    result[says_side_only] = count[says_side_only] / (last + 1)
    return result


@cache
def subdivision(dim: int, count: int, is_quad: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Kuhn's subdivision of the reference simplex (square) in count^dim (twice as many) equal simplices.

    Returns
    -------
    corners : array (corners, dim)
        Corners in coordinates of NGSolve's reference cell.
    pieces : array (pieces, dim + 1)
        Numbers of each simplex's corners.
    """
    ends = []
    for start in itertools.product(range(count), repeat=dim):
        for steps in itertools.permutations(range(dim)):
            path = np.array([start] * (dim + 1))
            for i, axis in enumerate(steps):
                path[i + 1 :, axis] += 1
            # the corners are in the simplex 1 >= a >= b >= c >= 0
            if is_quad or (np.diff(path, axis=1) <= 0).all():
                ends.append(path)
    corners, pieces = np.unique(np.array(ends).reshape(-1, dim), axis=0, return_inverse=True)
    if not is_quad:  # maps (a, b, c) to (a - b, b - c, c)
        corners = corners - np.pad(corners, ((0, 0), (0, 1)))[:, 1:]
    return corners / count, pieces.reshape(-1, dim + 1)


def _larger(dim: int, count: int, is_quad: bool) -> np.ndarray:
    """Sub-cells of twice the size, (pieces, dim + 1), with corners numbered as those of the small
    sub-cells."""
    small, (corners, pieces) = subdivision(dim, count, is_quad)[0], subdivision(dim, count // 2, is_quad)
    # corners are equal bit for bit, because count is even
    numbers = {tuple(corner): i for i, corner in enumerate(small)}
    return np.array([numbers[tuple(corner)] for corner in corners])[pieces]


def _powers(dim: int, order: int) -> list[tuple[int, ...]]:
    """Exponents of the monomials in reference coordinates up to degree ``order``; the constant first."""
    every = itertools.product(range(order + 1), repeat=dim)
    return sorted((e for e in every if sum(e) <= order), key=lambda e: (sum(e), e))


def _monomials(points: np.ndarray, powers: Sequence[tuple[int, ...]]) -> np.ndarray:
    """Values of the monomials at points, (..., monomials)."""
    return np.stack([np.prod(points ** np.array(e), axis=-1) for e in powers], axis=-1)


def _projected(
    mesh: Mesh,
    cells: np.ndarray,
    is_quad: bool,
    shares: Sequence[np.ndarray],
    powers: Sequence[tuple[int, ...]],
) -> np.ndarray:
    """Coefficients, (shapes and rest, monomials, cells), of the shares' projection limited to [0, 1]."""
    if len(shares) == 1:  # shares are constant in each cell
        result = np.zeros((len(shares[0]), len(powers), len(cells)))
        result[:, 0] = shares[0][..., 0]
        return result
    count = _PIECES[mesh.dim]
    fine = _projection(mesh, cells, is_quad, shares[0], powers, count)
    coarse = _projection(mesh, cells, is_quad, shares[1], powers, count // 2)
    # errors are of second order, and therefore four times smaller on the small sub-cells
    better = [a + (a - b) / 3 for a, b in zip(fine, coarse, strict=True)]
    is_share = ((better[1] >= 0) & (better[1] <= 1)).all(axis=0, keepdims=True)
    polynomials, means = (np.where(is_share, a, b) for a, b in zip(better, fine, strict=True))
    corners, _ = subdivision(mesh.dim, count, is_quad)
    return np.moveaxis(_limited(polynomials, means, _monomials(corners, powers)), 2, 1)


def _projection(
    mesh: Mesh,
    cells: np.ndarray,
    is_quad: bool,
    shares: np.ndarray,
    powers: Sequence[tuple[int, ...]],
    count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the shares' L2 projection, (shapes and rest, cells, monomials), and means, (..., 1)."""
    corners, pieces = subdivision(mesh.dim, count, is_quad)
    # a rule of degree two in each sub-cell: points between its middle and its corners
    rule = _RULES[mesh.dim]
    points = np.einsum("qv,pvd->pqd", rule, corners[pieces]).reshape(-1, mesh.dim)
    values = _monomials(points, powers).reshape(len(pieces), len(rule), -1)
    if mesh.GetCurveOrder() <= 1 and not is_quad:
        weighted = values.mean(axis=1)[None]  # a constant Jacobian cancels
        gram = np.einsum("pqi,pqj->ij", values, values)[None] / len(rule)
    else:
        J = Places(mesh, cells, points).values(Det(specialcf.JacobianMatrix(mesh.dim)))
        J = np.abs(J).reshape(len(cells), len(pieces), len(rule)) / len(rule)
        weighted = np.einsum("cpq,pqi->cpi", J, values)
        gram = np.einsum("cpq,pqi,pqj->cij", J, values, values, optimize=True)
    weighted = np.broadcast_to(weighted, (len(cells), *weighted.shape[1:]))
    load = np.einsum("scp,cpi->sci", shares, weighted)
    polynomials = np.linalg.solve(gram[None], load[..., None])[..., 0]
    return polynomials, load[..., :1] / weighted[..., 0].sum(axis=1)[None, :, None]


def _limited(polynomials: np.ndarray, means: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Polynomials scaled into [0, 1] towards their means, with one factor for all polynomials of a cell."""
    at = polynomials @ values.T - means
    room = np.where(at > 0, 1 - means, means)
    share = np.min(room / np.maximum(np.abs(at), 1e-300), axis=(0, 2))
    factor = np.clip(share, 0, 1)[None, :, None]
    result = factor * polynomials
    result[..., :1] += (1 - factor) * means
    return result


_RULES = {
    2: np.full((3, 3), 1 / 6) + np.eye(3) / 2,
    3: np.full((4, 4), (5 - 5**0.5) / 20) + np.eye(4) * 5**0.5 / 5,
}
"""Barycentric coordinates of quadrature rules of degree two with equal weights, by dimension."""


def _function(
    mesh: Mesh, coefficients: np.ndarray, powers: Sequence[tuple[int, ...]], order: int
) -> GridFunction:
    """Piecewise polynomial with given coefficients, (monomials, cells), as a grid function."""
    constants, value = L2(mesh, order=0), CoefficientFunction(0.0)
    place = specialcf.xref(mesh.dim)
    for exponents, numbers in zip(powers, coefficients, strict=True):
        term = GridFunction(constants)
        term.vec.FV().NumPy()[:] = numbers
        value = value + math.prod(
            (x for x, n in zip(place, exponents, strict=True) for _ in range(n)), start=term
        )
    result = GridFunction(L2(mesh, order=order))
    result.Set(value)
    return result
