"""Outlines, moments, tractions and gaps of bodies against closed forms; sharpness; files of contours."""

import csv
import math
import re
import warnings

import numpy as np
import pytest
from ngsolve import CF, Id, IfPos, x, y, z
from scipy.special import ellipe

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.run.frames import read_pvd
from ngvisco.run.outlines import Cut, Moments, distance
from ngvisco.run.waves import moduli
from ngvisco.shapes.fractions import subdivision

A, B, ANGLE = 0.3, 0.18, 0.4
SOLID = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)


def inside_ellipse(X, Y, a=A, b=B, angle=ANGLE):
    """A function > 0 in an ellipse about (1/2, 1/2)."""
    c, s = math.cos(angle), math.sin(angle)
    along, across = (X - 0.5) * c + (Y - 0.5) * s, (Y - 0.5) * c - (X - 0.5) * s
    return 1 - (along / a) ** 2 - (across / b) ** 2


def lattice(count=40):
    """Triangles in the unit square, (triangles, 3), and their points, (points, 2)."""
    points, triangles = subdivision(2, count)
    points, number = np.unique(np.concatenate([points, 1 - points]).round(9), axis=0, return_inverse=True)
    return points, number.reshape(-1)[np.concatenate([triangles, triangles + len(number) // 2])]


def cut(level, velocity=None):
    """The part of the unit square in which a function of x and y is >= 0."""
    points, triangles = lattice()
    X, Y = points.T
    v = np.zeros_like(points) if velocity is None else (points - 0.5) @ np.transpose(velocity)
    return Cut.of(np.hstack([points, v])[triangles], triangles, level(X, Y)[triangles], 0.0)


def run_with(*bodies, maxh=0.1, m=1, dim=2, **options):
    rest = nv.Body(name="rest", material=SOLID, density=1.0)
    named = [nv.Body(name=name, where=where, material=SOLID, density=1.0) for name, where in bodies]
    mesh = box((1.0,) * dim, maxh=maxh)
    discretisation = nv.Discretisation(k=min(2, m + 1), m=m)
    model = nv.Model(bodies=[*named, rest])
    return nv.Simulation(mesh, model, dt=0.01, discretisation=discretisation, **options)


def measured(run, *measures):
    table = nv.Bodies(measures=measures)
    table.start(run)
    return lambda column: table.column(column)[0]


def test_an_ellipse_has_its_area_axes_angle_and_perimeter():
    """Outlines consist of chords of length h = 1/40, so that sizes are too small by up to h^2/(8 r^2), and
    never too large."""
    found = cut(inside_ellipse)
    moments = Moments.of(found.inside)
    L, breadth, angle = moments.ellipse()
    for value, exact in (
        (moments.area, math.pi * A * B),
        (L, 2 * A),
        (breadth, 2 * B),
        (found.length, 4 * A * ellipe(1 - (B / A) ** 2)),
    ):
        assert 0.992 < value / exact < 1
    assert moments.centre == pytest.approx([0.5, 0.5], abs=1e-9) and angle == pytest.approx(ANGLE, abs=1e-3)


def test_a_square_has_its_area_perimeter_and_no_deformation():
    """The sides of the square are lines of lattice points."""
    found = cut(lambda X, Y: 0.2 - np.maximum(abs(X - 0.5), abs(Y - 0.5)))
    L, breadth, _ = Moments.of(found.inside).ellipse()
    assert Moments.of(found.inside).area == pytest.approx(0.16, rel=1e-9)
    assert found.length == pytest.approx(1.6, rel=1e-9)
    assert pytest.approx(breadth) == L and pytest.approx(0.8 / math.sqrt(3), rel=1e-9) == L


def test_outlines_have_the_body_on_the_left_and_are_closed_or_end_at_the_boundary():
    (round_,) = cut(inside_ellipse).lines()
    assert round_[0] == pytest.approx(round_[-1])
    x, y = round_[:, :2].T
    area = 0.5 * (x[:-1] * y[1:] - x[1:] * y[:-1]).sum()
    assert area == pytest.approx(Moments.of(cut(inside_ellipse).inside).area, rel=1e-9)
    ring = cut(lambda X, Y: 0.1 - abs(np.hypot(X - 0.5, Y - 0.5) - 0.3))
    assert len(list(ring.lines())) == 2
    (straight,) = cut(lambda X, Y: X - 0.33).lines()
    assert len(straight) > 40 and straight[:, 0] == pytest.approx(0.33)
    assert sorted(straight[[0, -1], 1]) == pytest.approx([0, 1])
    assert Moments.of(cut(lambda X, Y: X - 2).inside) is None


def test_the_turning_rate_is_that_of_rigid_rotation_and_of_tank_treading():
    """The motions are a rigid rotation, an elliptic one that leaves an ellipse in place, and a stretching
    that turns nothing."""
    turn, c, s = np.array([[0, -0.7], [0.7, 0]]), math.cos(ANGLE), math.sin(ANGLE)
    R = np.array([[c, -s], [s, c]])
    assert Moments.of(cut(inside_ellipse, turn).inside).turning() == pytest.approx(0.7, rel=1e-9)
    treading = R @ (turn * [[1, A / B], [B / A, 1]]) @ R.T
    assert Moments.of(cut(inside_ellipse, treading).inside).turning() == pytest.approx(0.7, rel=1e-4)
    stretching = R @ np.diag([0.3, -0.3]) @ R.T
    assert Moments.of(cut(inside_ellipse, stretching).inside).turning() == pytest.approx(0, abs=1e-4)


HERE = np.zeros((1, 2))  # the displacement of an outline in a domain without periods


def test_two_outlines_have_the_distance_of_their_closest_points():
    left = cut(lambda X, Y: 0.15 - np.hypot(X - 0.2, Y - 0.4))
    right = cut(lambda X, Y: 0.2 - np.hypot(X - 0.75, Y - 0.5))
    exact = math.hypot(0.55, 0.1) - 0.35
    assert exact < distance(left.ends, right.ends, HERE) < exact + 0.002
    assert distance(left.ends, right.ends[:0], HERE) == math.inf


@pytest.mark.parametrize("m", [0, 1, 2])
def test_outline_columns_of_a_body_have_the_measures_of_its_shape(m):
    """The body is 3.6 cells broad. Its area is that of a polygon with corners half a cell apart."""
    start = nv.Initial(velocity=(-0.7 * (y - 0.5), 0.7 * (x - 0.5)))
    found = measured(
        run_with(("e", inside_ellipse(x, y)), m=m, initial=start), "deformation", "outline", "turning"
    )
    assert found("e_volume") == pytest.approx(math.pi * A * B, rel=2e-3)
    assert 0.97 < found("e_inside") / (math.pi * A * B) < 1.005
    assert 0.99 < found("e_perimeter") / (4 * A * ellipe(1 - (B / A) ** 2)) < 1.01
    assert found("e_L") == pytest.approx(2 * A, rel=0.03) and found("e_B") == pytest.approx(2 * B, rel=0.02)
    assert found("e_D") == pytest.approx((A - B) / (A + B), abs=0.015)
    assert found("e_angle") == pytest.approx(ANGLE, abs=0.015)
    assert found("e_turning") == pytest.approx(0.7, rel=1e-6)
    assert 0.5 < found("e_smeared") < 1.0  # the column is the interface's width in cells


def test_stress_and_traction_are_those_of_a_known_pressure():
    """For T = K s q I the force on a body is K s int grad q, and the torque K s int (x d_y q - y d_x q)."""
    longitudinal, shear = moduli(SOLID, 2)
    K, s, area = longitudinal - 4 / 3 * shear, 1e-4, math.pi * A * B
    for q, force, torque in (
        (x - 0.5, (area, 0.0), 0.0),
        (1 + (x - 0.5) * (y - 0.5), (0.0, 0.0), area * (A**2 - B**2) / 4),
    ):
        start = nv.Initial(F=(1 + s * q / 3) * Id(3))
        body = ("e", inside_ellipse(x, y, angle=0.0))
        found = measured(run_with(body, maxh=0.07, initial=start), "stress", "traction")
        assert found("e_force_x") == pytest.approx(K * s * force[0], abs=0.03 * K * s * area)
        assert found("e_force_y") == pytest.approx(K * s * force[1], abs=0.03 * K * s * area)
        assert found("e_torque") == pytest.approx(K * s * torque, abs=0.05 * K * s * area * A**2 / 4)
        mean = 1.0 if torque else 0.0
        for component in ("stress_11", "stress_22", "stress_33"):
            assert found(f"e_{component}") == pytest.approx(K * s * mean, abs=5e-3 * K * s)
        assert found("e_stress_12") == pytest.approx(0, abs=1e-6 * K * s)


def test_stress_traction_and_width_are_measured_in_three_dimensions():
    longitudinal, shear = moduli(SOLID, 3)
    K, s, volume = longitudinal - 4 / 3 * shear, 1e-4, 4 / 3 * math.pi * 0.35**3
    start = nv.Initial(F=(1 + s * (x - 0.5) / 3) * Id(3))
    run = run_with(("e", nv.Ball((0.5, 0.5, 0.5), 0.35)), maxh=0.3, dim=3, initial=start)
    found = measured(run, "stress", "traction")
    assert found("e_force_x") == pytest.approx(K * s * volume, rel=0.15)  # the body is about two cells wide
    assert found("e_torque_z") == pytest.approx(0, abs=0.05 * K * s * volume * 0.35)
    assert 0.4 < found("e_smeared") < 1.2
    with pytest.raises(nv.ParameterError, match=r"Bodies.measures.*'deformation'.*3D"):
        measured(run, "deformation")
    with pytest.raises(nv.ParameterError, match=r"Contours.*3D"):
        nv.Contours().start(run)


@pytest.mark.long
@pytest.mark.ci
def test_a_gap_is_measured_between_two_bodies_that_have_a_region():
    run = run_with(("one", nv.Ball((0.25, 0.5), 0.15)), ("two", nv.Ball((0.7, 0.5), 0.2)), maxh=0.07)
    # the tolerance is a tenth of a cell
    assert measured(run, "gap")("gap_one_two") == pytest.approx(0.1, abs=0.007)
    with pytest.raises(nv.ParameterError, match=r"'gap'.*two bodies"):
        measured(run_with(("one", nv.Ball((0.25, 0.5), 0.15))), "gap")
    with pytest.raises(nv.ParameterError, match=r"Bodies.measures.*'width'.*deformation"):
        nv.Bodies(measures=["width"])


def test_a_body_that_dissolves_is_warned_of_once():
    start = nv.Initial(velocity=CF((0.0, 0.0)))
    table = nv.Bodies()
    blurred = run_with(("e", nv.Ball((0.5, 0.5), 0.3)), maxh=0.2, m=1, initial=start)
    table.start(blurred)
    assert table.column("e_smeared")[0] < 1
    step = blurred.rothe_step
    z = step.state.vec.FV().NumPy()[step.layout.ranges["z"]].reshape(step.layout.states.size, step.mesh.ne, 3)
    amounts = z[[step.layout.states.slices[name].start for name in ("n_e", "n_rest")]]
    shares = np.full((2, step.mesh.ne), 0.5)  # all cells but one have half of each body
    shares[:, 0] = 1, 0
    amounts[:, :, 0], amounts[:, :, 1:] = shares, 0
    z[[step.layout.states.slices[name].start for name in ("n_e", "n_rest")]] = amounts
    with pytest.warns(nv.SmearedWarning, match=r"body 'e' is .* cells wide") as said:
        table._sample(blurred)
        table._sample(blurred)
    assert len(said) == 1  # no warning names the remaining body, which has the same interface


@pytest.mark.parametrize("slit", [0.1, 0.27, 0.4])
def test_a_body_whose_outline_touches_itself_is_warned_of_once(slit):
    """A block has a slit of half a cell, of 1.35 cells or of two cells, which does not divide the block."""
    in_slit = IfPos((slit / 2) ** 2 - (x - 0.5) ** 2, y - 0.4, -1.0)
    where = IfPos(in_slit, -1.0, 0.16 - (y - 0.5) ** 2)
    run = run_with(("e", where), maxh=0.2, m=1, initial=nv.Initial(velocity=CF((0.0, 0.0))))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        run.self_contact(0.0, 0.0)
        run.self_contact(0.0, 1.0)
    said = [str(one.message) for one in said if one.category is nv.SelfContactWarning]
    assert len(said) == (slit < 0.3)
    assert all(re.search(r"body 'e' face each other at a distance of [01]\.\d", text) for text in said)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("slit", [0.1, 0.45])
def test_a_body_whose_surface_touches_itself_in_three_dimensions_is_warned_of(slit):
    """The part of the cube below z = 0.7 has a slit of 0.6 or of 2.7 cells."""
    mesh, elastic = structured_box((1, 1, 1), (6, 6, 6)), nv.ReferentialNeoHookean(K_e=10.0, G_e=2.0)
    in_slit = IfPos((slit / 2) ** 2 - (x - 0.5) ** 2, y - 0.4, -1.0)
    where = IfPos(in_slit, -1.0, 0.7 - z)
    bodies = [nv.Body(name="c", where=where, material=elastic, density=1.0)]
    bodies.append(nv.Body(name="rest", material=elastic, density=1.0))
    run = nv.Simulation(mesh, nv.Model(bodies=bodies), dt=0.01, discretisation=nv.Discretisation(k=1, m=0))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        run.self_contact(0.0, 0.0)
    said = [str(one.message) for one in said if one.category is nv.SelfContactWarning]
    assert len(said) == (slit < 0.2)
    assert all(re.search(r"body 'c' face each other at a distance of [01]\.\d", text) for text in said)


@pytest.mark.long
@pytest.mark.ci
def test_a_convex_body_and_a_body_at_walls_do_not_touch_themselves():
    elastic = nv.ReferentialNeoHookean(K_e=10.0, G_e=2.0)
    for mesh, where in (
        (structured_box((1, 1, 1), (5, 5, 5)), nv.Ball((0.45, 0.52, 0.5), 0.3)),
        (structured_box((1, 1, 1), (5, 5, 5)), nv.Block((0.0, 0.07, 0.0), (0.9, 0.93, 1.0))),
        (structured_box((1, 1), (8, 8)), nv.Block((0.0, 0.0), (0.95, 0.9))),
    ):
        bodies = [nv.Body(name="e", where=where, material=elastic, density=1.0)]
        bodies.append(nv.Body(name="rest", material=elastic, density=1.0))
        run = nv.Simulation(
            mesh, nv.Model(bodies=bodies), dt=0.01, discretisation=nv.Discretisation(k=1, m=0)
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error", nv.SelfContactWarning)
            run.self_contact(0.0, 0.0)


def test_contours_are_rows_and_lines_for_paraview(tmp_path):
    places = ("one", nv.Ball((0.3, 0.5), 0.2)), ("two", nv.Ball((0.75, 0.5), 0.15))
    run = run_with(*places)
    run.observers.append(nv.Contours(tmp_path / "contours", every=2))
    run.run(0.03)
    with (tmp_path / "contours" / "contours.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == ["step", "time", "body", "line", "x", "y"]
    rows = np.array(rows, dtype=float)
    assert sorted(set(rows[:, 0])) == [0, 2, 3] and set(rows[:, 2]) == {1, 2} and set(rows[:, 3]) == {1}
    for number, (centre, radius) in ((1, (0.3, 0.2)), (2, (0.75, 0.15))):
        line = rows[(rows[:, 2] == number) & (rows[:, 0] == 3)]
        assert line[0, 4:] == pytest.approx(line[-1, 4:])
        # the tolerance is a fifth of a cell
        assert np.hypot(line[:, 4] - centre, line[:, 5] - 0.5) == pytest.approx(radius, abs=0.02)
    series = read_pvd(tmp_path / "contours" / "contours.pvd")
    assert [time for time, _ in series] == pytest.approx([0, 0.02, 0.03])
    content = (tmp_path / "contours" / series[-1][1]).read_bytes()
    assert b'Name="body"' in content and content.count(b"NumberOfCells") == 1
    with pytest.raises(nv.UnknownNameError, match="tow"):
        nv.Contours(bodies=["tow"]).start(run)
