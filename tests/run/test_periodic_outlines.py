"""Outlines and centroids do not depend on the place of a body in a periodic domain."""

from functools import reduce
from itertools import product
from operator import or_

import numpy as np
import pytest
from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.sensitivity.body_slopes import BodySlopes
from ngvisco.sensitivity.variations import Variations
from tests.support import by_ci

MEASURES = ["deformation", "outline", "turning", "traction", "gap"]
SHAPES = ("long_L", "long_B", "long_angle", "long_perimeter", "long_inside", "long_turning", "gap_long_round")
CENTROIDS = ("long_x", "long_y", "round_x", "round_y")
TORQUES = ("long_torque", "round_torque")
CELLS = 12


def ellipse(centre, length, breadth, periodic):
    """An ellipse inclined by 0.6 rad, with its images over periodic boundaries that meet the unit square."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    along, across = length / 2 * np.cos(angles), breadth / 2 * np.sin(angles)
    turn = np.array([[np.cos(0.6), -np.sin(0.6)], [np.sin(0.6), np.cos(0.6)]])
    points = np.stack([along, across], axis=1) @ turn.T + centre
    moves = product(*((-1, 0, 1) if axis in periodic else (0,) for axis in "xy"))
    images = [points + move for move in moves]
    inside = [image for image in images if (image.max(axis=0) > 0).all() and (image.min(axis=0) < 1).all()]
    return reduce(or_, (nv.Polygon(image.tolist()) for image in inside))


def table_of(centre, periodic="xy"):
    """A run with an inclined ellipse and a small disc to its right, turned by a periodic flow; the run and
    the table are returned."""
    solid = {"material": nv.ReferentialNeoHookean(K_e=1.0, G_e=1.0), "density": 1.0}
    solid["viscosity"] = nv.StokesViscosity(K_v=0.1, G_v=0.1)
    away = (centre[0] + 0.42, centre[1])
    bodies = [
        nv.Body(name="long", where=ellipse(centre, 0.5, 0.3, periodic), **solid),
        nv.Body(name="round", where=ellipse(away, 0.15, 0.15, periodic), order=1, **solid),
        nv.Body(name="rest", **solid),
    ]
    X, Y = 2 * pi * (x - centre[0]), 2 * pi * (y - centre[1])
    table = nv.Bodies(None, measures=MEASURES)
    run = nv.Simulation(
        structured_box((1.0, 1.0), (CELLS, CELLS), periodic=periodic),
        nv.Model(bodies=bodies),
        dt=0.01,
        initial=nv.Initial(velocity=(-cos(X) * sin(Y), sin(X) * cos(Y)) if periodic == "xy" else None),
        observers=[table],
    )
    return run, table


def measured(*args, slopes_of=()):
    """Measures of bodies at the start of a run, and the norms of some derivatives of the measures by the
    state."""
    run, table = table_of(*args)
    names = table.prepare(run)
    (row,) = table._sample(run)
    slopes = BodySlopes(table, Variations(run.rothe_step))
    return dict(zip(names, row, strict=True)), [np.linalg.norm(slopes.of(name)()) for name in slopes_of]


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("moved", [by_ci((6, 0)), (5, 7)])
def test_an_ellipse_over_the_boundary_has_the_measures_of_one_in_the_middle(moved):
    """A shift by a cell maps the mesh to itself, so that the measures agree to rounding."""
    moved_centre, names = tuple(0.5 + np.array(moved) / CELLS), (*SHAPES, "long_x", "round_y")
    inside, slopes = measured((0.5, 0.5), slopes_of=names)
    over, of_over = measured(moved_centre, slopes_of=names)
    for name in (*SHAPES, *TORQUES):
        assert over[name] == pytest.approx(inside[name], rel=1e-8), name
    for number, name in enumerate(CENTROIDS):
        periods = over[name] - inside[name] - moved[number % 2] / CELLS
        assert periods == pytest.approx(round(periods), abs=1e-9) and 0 <= over[name] <= 1
    assert of_over == pytest.approx(slopes, rel=1e-8)


@pytest.mark.long
@pytest.mark.ci
def test_an_ellipse_is_not_joined_across_the_walls_of_a_channel():
    """Only identified boundaries are crossed: half of the ellipse is outside the wall."""
    over, _ = measured((1.0, 0.5), "x")
    assert over["long_L"] == pytest.approx(0.5, rel=0.04)
    assert measured((0.5, 1.0), "x")[0]["long_inside"] == pytest.approx(over["long_inside"] / 2, rel=0.02)


def row_of(where, mesh, measures=()):
    """The table of a body in a mesh at rest."""
    solid = {"material": nv.ReferentialNeoHookean(K_e=1.0, G_e=1.0), "density": 1.0}
    table = nv.Bodies(None, measures=measures)
    bodies = [nv.Body(name="body", where=where, **solid), nv.Body(name="rest", **solid)]
    run = nv.Simulation(mesh, nv.Model(bodies=bodies), dt=0.01, observers=[table])
    names = table.prepare(run)
    return dict(zip(names, table._sample(run)[0], strict=True))


def test_a_layer_around_a_channel_stays_in_its_place():
    """The layer meets its own periodic image on both sides. Its deformation is that of its rectangle in the
    domain."""
    layer = nv.Block((-1.0, 0.25), (2.0, 0.5))
    row = row_of(layer, structured_box((1.0, 1.0), (8, 8), periodic="x"), ["deformation", "outline"])
    # axes of 4/sqrt(12) times the sides; the outline of the layer, two cells thick, consists of two lines
    assert row["body_L"] == pytest.approx(4 / 12**0.5, rel=1e-9)
    assert row["body_perimeter"] == pytest.approx(2.0, rel=1e-9)
    assert row["body_x"] == pytest.approx(0.5, rel=1e-9)


def test_a_layer_is_joined_across_the_periodic_boundaries_that_it_crosses():
    """In x the layer meets its own periodic image. In y its halves at the bottom and at the top are
    joined."""
    layer = nv.Block((-1.0, -1.0), (2.0, 0.125)) | nv.Block((-1.0, 0.75), (2.0, 2.0))
    row = row_of(layer, structured_box((1.0, 1.0), (8, 8), periodic="xy"), ["deformation"])
    assert (row["body_x"], row["body_y"]) == pytest.approx((0.5, 0.9375), rel=1e-9)
    assert row["body_B"] == pytest.approx(4 / 12**0.5 * 0.375, rel=1e-9)


@pytest.mark.long
@pytest.mark.ci
def test_a_block_across_two_periodic_boundaries_has_one_centroid():
    """The block is cut into four parts by the boundaries of a box."""
    moves = product((-1, 0), (0,), (-1, 0))
    low, high = (0.625, 0.375, 0.75), (1.25, 0.625, 1.5)
    blocks = [nv.Block(tuple(np.add(low, move)), tuple(np.add(high, move))) for move in moves]
    row = row_of(reduce(or_, blocks), structured_box((1.0, 1.0, 1.0), (8, 8, 4), periodic="xz"))
    assert [row[f"body_{axis}"] for axis in "xyz"] == pytest.approx([0.9375, 0.5, 0.125], rel=1e-9)
