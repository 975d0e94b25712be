"""Fields from values at points: functions of Python, arrays on grids, fields on another mesh.

The values at the quadrature points of every cell are projected in L2, cell by cell.  Jumps may lie between
cells, and polynomials of the field's order are reproduced exactly.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from ngsolve import L2, CoefficientFunction, GridFunction, LinearForm, Mesh, VectorValued, x, y, z
from ngsolve.comp import IntegrationRuleSpace, IntegrationRuleSpaceSurface

from ngvisco.errors import ParameterError, as_numbers, require_collection, require_type
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.projections import inverse_mass


class QuadraturePoints:
    """The quadrature points of a mesh, and functions with given values at these points."""

    def __init__(self, quadrature: Quadrature, on: CoefficientFunction | None = None) -> None:
        """Take the points in the cells. If a function ``on`` is given, take the points on walls at which it
        is not 0."""
        self.quadrature, self.mesh = quadrature, quadrature.mesh
        if on is None:
            self._space = IntegrationRuleSpace(self.mesh, order=quadrature.volume_degree // 2)
            self._integral: Callable[[CoefficientFunction], Any] = quadrature.cells
        else:
            self._space = IntegrationRuleSpaceSurface(self.mesh, order=quadrature.facet_degree // 2)
            self._integral = quadrature.walls
        self._here = np.ones(self._space.ndof, dtype=bool)
        self._here = self._loaded(CoefficientFunction(1.0) if on is None else on) != 0
        self.weights = self._loaded(CoefficientFunction(1.0))

    def _loaded(self, value: CoefficientFunction) -> np.ndarray:
        load = LinearForm(self._space)
        load += self._integral(value * self._space.TestFunction())
        return load.Assemble().vec.FV().NumPy()[self._here]

    def values(self, f: CoefficientFunction) -> np.ndarray:
        """Values of a scalar function at the points, (points,)."""
        return self._loaded(f) / self.weights

    @property
    def cells(self) -> np.ndarray:
        """Numbers of the cells of the points, (points,)."""
        number = GridFunction(L2(self.mesh, order=0))
        number.vec.FV().NumPy()[:] = np.arange(self.mesh.ne)
        return np.rint(self.values(number)).astype(int)

    @property
    def coordinates(self) -> np.ndarray:
        """Coordinates of the points, (points, dim), m."""
        return np.array([self.values(c) for c in (x, y, z)[: self.mesh.dim]]).T

    def function(self, values: np.ndarray) -> GridFunction:
        """A function with ``values``, (points,), for integrals by this quadrature."""
        result = GridFunction(self._space)
        result.vec.FV().NumPy()[self._here] = values
        return result

    def project(self, values: np.ndarray, space: L2, into: GridFunction) -> None:
        """Project ``values``, (points,), in L2, cell by cell, on a discontinuous scalar space."""
        load = LinearForm(space)
        load += self.quadrature.cells(self.function(values) * space.TestFunction())
        into.vec.data = inverse_mass(space, self.quadrature) * load.Assemble().vec


def function_field(mesh: Mesh, function: Callable[..., object], order: int = 2) -> CoefficientFunction:
    """A function of Python as a coefficient function, by its cellwise L2 projection.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    function : callable
        Function of arrays x, y and in 3D z (m), each of shape (points,).  The function returns an array of
        this shape for a scalar, a sequence of such arrays for a vector, and a sequence of sequences for a
        matrix.
    order : int
        Order of the polynomials in the cells, 0 to 6; they may jump between cells.

    Returns
    -------
    CoefficientFunction
        Scalar, vector or matrix, e.g. for ``Initial``.

    Raises
    ------
    ParameterError
        If the function returns anything else, or values that are not finite.
    """
    require_type("function_field.mesh", mesh, Mesh)
    if not callable(function):
        raise ParameterError("function_field.function", function, "a function of the arrays x, y (and z)")
    if not isinstance(order, int) or isinstance(order, bool) or not 0 <= order <= 6:
        raise ParameterError("function_field.order", order, "an integer from 0 to 6")
    points = QuadraturePoints(Quadrature(mesh, 2 * order + 2, 2))
    where = points.coordinates
    values = _as_components(function(*where.T), len(where))
    space = L2(mesh, order=order)
    flat = values.reshape(-1, len(where))
    result = GridFunction(VectorValued(space, len(flat)) if values.ndim > 1 else space)
    for row, part in zip(flat, result.components if values.ndim > 1 else (result,), strict=True):
        points.project(row, space, part)
    return result.Reshape(values.shape[:-1]) if values.ndim > 2 else result


def _as_components(given: object, count: int) -> np.ndarray:
    expected = (
        f"a function that returns, for {count} points, an array of {count} finite numbers or a sequence of "
        "such arrays"
    )
    try:
        values = np.asarray(_broadcast(given, count), dtype=float)
    except (TypeError, ValueError) as error:
        raise ParameterError("function_field.function", given, expected) from error
    if values.ndim not in (1, 2, 3) or values.shape[-1] != count:
        raise ParameterError(
            "function_field.function", f"a function that returns an array of shape {values.shape}", expected
        )
    if not np.isfinite(values).all():
        raise ParameterError(
            "function_field.function", "a function that returns numbers that are not finite", expected
        )
    return values


def _broadcast(given: object, count: int) -> object:
    """Replace numbers by constant arrays."""
    if isinstance(given, (list, tuple)):
        return [_broadcast(part, count) for part in given]
    return np.full(count, given) if isinstance(given, (int, float, np.number)) else given


def grid_field(
    mesh: Mesh, axes: Sequence[Sequence[float]], values: object, order: int = 2, method: str = "linear"
) -> CoefficientFunction:
    """Values on a rectangular grid as a coefficient function.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    axes : sequence of arrays
        The grid's coordinates along x, y and in 3D z, m, increasing; the domain must lie within.
    values : array
        Of shape (len(x), len(y)[, len(z)], components...).
    order : int
        Order of the polynomials in the cells, as in ``function_field``.
    method : str
        Interpolation between grid points by scipy's RegularGridInterpolator: ``"linear"``, ``"nearest"``,
        ``"cubic"``, ...

    Raises
    ------
    ParameterError
        If shapes do not fit or the domain is not within the grid.
    """
    from scipy.interpolate import RegularGridInterpolator  # takes a fifth of the package's import time

    require_type("grid_field.mesh", mesh, Mesh)
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise ParameterError("grid_field.values", values, "an array of numbers")
    if len(require_collection("grid_field.axes", axes, f"{mesh.dim} axes")) != mesh.dim:
        raise ParameterError("grid_field.axes", f"{len(axes)} axes", f"{mesh.dim} axes")
    axes = [as_numbers("grid_field.axes", axis) for axis in axes]
    try:
        interpolate = RegularGridInterpolator(tuple(axes), array.astype(float), method=method)
    except (TypeError, ValueError) as error:
        expected = f"increasing axes, each with as many values as the array has along this axis ({error})"
        raise ParameterError("grid_field.values", f"shape {array.shape}", expected) from error

    def sampled(*where: np.ndarray) -> np.ndarray:
        for name, points, axis in zip("xyz", where, axes, strict=False):
            if points.min() < min(axis) or points.max() > max(axis):
                expected = (
                    f"a range that contains the range of the domain, [{points.min():.6g}, {points.max():.6g}]"
                )
                raise ParameterError(f"grid_field.axes, {name}", [min(axis), max(axis)], expected)
        return np.moveaxis(interpolate(np.array(where).T), 0, -1)

    return function_field(mesh, sampled, order)
