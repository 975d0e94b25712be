"""Fractions of shapes in cells: volumes, bounds, sums, and exactness where a surface is plane."""

import numpy as np
import pytest
from netgen.geom2d import unit_square
from ngsolve import ET, VOL, IfPos, Integrate, IntegrationRule, Mesh, pi, x, y

from ngvisco.geometries import box, disc
from ngvisco.shapes.fractions import fractions, volumes
from ngvisco.shapes.shape import Ball, Block, HalfSpace, Polygon, Union, Where


def sampled(mesh, function):
    rules = {et: IntegrationRule(et, 6) for et in (ET.TRIG, ET.QUAD, ET.TET)}
    return np.asarray(function(mesh.MapToAllElements(rules, VOL)))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_volume_of_a_plane_cut_is_exact(order):
    mesh = box((1, 1), maxh=0.3)
    part, rest = fractions(mesh, [HalfSpace((0.37, 0.5), (1, 0.3))], order)
    exact = 0.37  # the cut has its middle at (0.37, 0.5)
    assert Integrate(part, mesh) == pytest.approx(exact, rel=1e-8)
    assert Integrate(rest, mesh) == pytest.approx(1 - exact, rel=1e-8)


@pytest.mark.parametrize(("dim", "maxh", "bound"), [(2, 0.1, 1e-4), (3, 0.3, 2e-2)])
def test_the_volume_of_a_ball_converges_with_the_mesh(dim, maxh, bound):
    ball, exact = Ball((0.6, 0.5, 0.5)[:dim], 0.3), pi * 0.09 if dim == 2 else 4 / 3 * pi * 0.027
    errors = [abs(volumes(box((1,) * dim, maxh=h), [ball])[0] / exact - 1) for h in (2 * maxh, maxh)]
    assert errors[1] < bound
    assert errors[1] < errors[0] / 2


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize(
    "mesh", [disc(1, maxh=0.4), Mesh(unit_square.GenerateMesh(maxh=0.4, quad_dominated=True))]
)
def test_fractions_of_layers_sum_to_one_and_are_between_zero_and_one(mesh, order):
    """The cells are curved triangles and quadrilaterals, and the second shape lies over the first."""
    shapes = [Ball((0.2, 0.3), 0.35), HalfSpace((0, 0.3), (0.2, 1))]
    parts = fractions(mesh, shapes, order)
    values = np.array([sampled(mesh, part) for part in parts])
    assert abs(values.sum(axis=0) - 1).max() < 1e-12
    assert values.min() > -1e-4 and values.max() < 1 + 1e-4
    assert [Integrate(part, mesh) for part in parts] == pytest.approx(volumes(mesh, shapes), rel=1e-12)


def test_later_shapes_cover_earlier_shapes():
    mesh = box((1, 1), maxh=0.3)
    below, above, rest = volumes(mesh, [Block((0, 0), (1, 0.6)), Block((0, 0.4), (1, 1))])
    assert (below, above) == pytest.approx((0.4, 0.6), rel=2e-4)
    assert abs(rest) < 1e-8


def test_shapes_are_united_cut_and_complemented():
    mesh = box((1, 1), maxh=0.2)
    a, b = Block((0, 0), (0.6, 1)), Block((0.3, 0), (1, 1))
    for shape, exact in [(a | b, 1.0), (a & b, 0.3), (a - b, 0.3), (~a, 0.4), (Union((a, ~a)), 1.0)]:
        assert volumes(mesh, [shape])[0] == pytest.approx(exact, abs=1e-5)


def test_a_function_gives_the_shape_where_it_is_positive():
    mesh = box((1, 1), maxh=0.2)
    smooth = volumes(mesh, [Where(0.09 - (x - 0.5) ** 2 - (y - 0.5) ** 2)])[0]
    jumping = volumes(mesh, [Where(IfPos(0.09 - (x - 0.5) ** 2 - (y - 0.5) ** 2, 1, 0))])[0]
    assert smooth == pytest.approx(0.09 * pi, rel=1e-3)
    assert jumping == pytest.approx(0.09 * pi, rel=1e-2)


def test_a_polygon_that_is_not_convex_has_its_area_in_either_orientation():
    mesh = box((1, 1), maxh=0.1)
    points = ((0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.5, 0.3), (0.1, 0.9))

    area = 0.4  # the square has the area 0.64, and the missing triangle 0.8 x 0.6/2
    for given in (points, points[::-1]):
        assert volumes(mesh, [Polygon(given)])[0] == pytest.approx(area, rel=1e-3)


@pytest.mark.parametrize("length", [1e-200, 1e200, 5e-324, 1.7e308])
def test_half_space_takes_a_normal_of_any_length(length):
    normal = HalfSpace((0, 0), (length, length)).normal
    assert normal == pytest.approx((0.5**0.5, 0.5**0.5), rel=1e-14)
