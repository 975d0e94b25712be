"""Outlines of bodies by carried distances: distances at the start, lines in cells, runs, and refused runs."""

import numpy as np
import pytest
from ngsolve import Integrate, sqrt, x, y

import ngvisco as nv
from ngvisco.forms.cut_simplices import level, share_above
from ngvisco.forms.level_lines import LevelLines
from ngvisco.geometries import box, structured_box
from ngvisco.physics.variables import Jacobian
from ngvisco.shapes.distance import signed_distance
from ngvisco.shapes.shape import as_shape

FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 5 * (J - 1) * (J - 1) / J)
LINEAR = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)
OUTLINED = nv.Discretisation(sharp=True, outlines=True)


def run(discretisation=OUTLINED, mesh=None, **arguments):
    """A disc in a lid-driven cavity."""
    laws = {"viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1), "density": 1.0}
    bodies = [
        nv.Body(name="fluid", material=FLUID, **laws),
        nv.Body(name="disc", where=nv.Ball((0.5, 0.6), 0.25), material=LINEAR, **laws),
    ]
    walls = {"top": nv.PrescribedTangential((1.0, 0.0)), ("left", "right", "bottom"): nv.NoSlip()}
    mesh = mesh or structured_box((1, 1), (5, 5), split_corners=True)
    arguments = {"scheme": "midpoint", "dt": 0.05} | arguments
    return nv.Simulation(
        mesh, nv.Model(bodies=bodies), walls=walls, discretisation=discretisation, **arguments
    )


def test_the_distance_from_a_circle_and_a_square_is_right():
    """The errors are those of the projection of a distance to P_2, at most a tenth of a cell at kinks."""
    mesh = box((1, 1), 0.1)
    ball = signed_distance(mesh, nv.Ball((0.5, 0.5), 0.3), 2)
    exact = 0.3 - sqrt((x - 0.5) ** 2 + (y - 0.5) ** 2)
    assert Integrate((ball - exact) ** 2, mesh) ** 0.5 < 5e-4
    block = signed_distance(mesh, as_shape("where", nv.Block((0.25, 0.25), (0.75, 0.75))), 2)
    for place, distance in (((0.5, 0.3), 0.05), ((0.1, 0.5), -0.15), ((0.15, 0.15), -0.1 * 2**0.5)):
        assert block(mesh(*place)) == pytest.approx(distance, abs=2e-3)


def test_distance_has_one_sign_without_an_outline():
    mesh = box((1, 1), 0.5)
    assert signed_distance(mesh, as_shape("where", 1 + x), 2)(mesh(0.4, 0.4)) == pytest.approx(2**0.5)


def test_level_lines_of_a_linear_distance_are_planes(rng):
    """Levels, projected indicators and shares of strips agree with the exact formulas for half-spaces."""
    mesh = box((1, 1), 0.4)
    cells, theta = np.arange(mesh.ne), rng.uniform(0.05, 0.95, mesh.ne)
    corners = np.array([[mesh[vertex].point for vertex in cell.vertices] for cell in mesh.Elements()])
    phi = 0.3 * x - y
    heights = corners @ [0.3, -1.0]
    heights = heights - level(heights, theta)[:, None]
    lines = LevelLines(mesh, phi, cells, theta)
    projected = lines.projected()
    assert projected.sum(axis=1) == pytest.approx(3 * theta, abs=1e-5)
    exact = np.stack([share_above(np.column_stack([heights, heights[:, c]])) for c in range(3)], axis=1)
    assert np.sort(projected, axis=1) == pytest.approx(np.sort(exact, axis=1), abs=1e-5)
    whole = np.repeat(np.eye(3)[None], len(cells), axis=0)
    strip = lines.shares(whole[:, [1, 2]], whole[:, [0, 0]])  # the strip is the whole cell
    assert strip == pytest.approx(theta, abs=1e-5)


def test_a_strip_thinner_than_a_cell_has_two_sides():
    """Half of a cell is inside |y - 1/2| < w, although all its corners are outside; no single plane cuts a
    cell like this."""
    mesh = structured_box((1, 1), (1, 1))
    phi = -((y - 0.5) ** 2)
    lines = LevelLines(mesh, phi, np.arange(mesh.ne), np.full(mesh.ne, 0.5))
    assert share_above(lines._values).mean(axis=1) == pytest.approx(0.5, abs=1e-6)
    outside = [
        phi(mesh(*mesh[vertex].point)) < lines._level[0] for vertex in next(iter(mesh.Elements())).vertices
    ]
    assert all(outside)


@pytest.mark.parametrize("scheme", ["midpoint", "backward-euler"])
def test_masses_and_the_balance_of_energy_are_kept(scheme):
    table = nv.Bodies()
    ledger = run(scheme=scheme, observers=[table]).run(0.2)
    masses = table.column("disc_mass")
    assert np.abs(masses / masses[0] - 1).max() < 1e-12
    assert np.abs(ledger.column("closure_relative")).max() < 1e-10


def test_a_restart_continues_the_outlines(tmp_path):
    path = tmp_path / "run.h5"
    through, first, second = run(), run(observers=[nv.Checkpoints(path, every=1)]), run()
    through.run(0.2)
    first.run(0.1)
    second.restore(path)
    second.run(0.2)
    assert second.passive.arrays()["distance_disc"] == pytest.approx(
        through.passive.arrays()["distance_disc"], abs=1e-12
    )
    for of in (first, second):
        assert of.passive.names == ()
    assert second.rothe_step.state.vec.FV().NumPy() == pytest.approx(
        through.rothe_step.state.vec.FV().NumPy(), abs=1e-13
    )


def test_an_undone_step_restores_the_distances():
    one = run()
    one.run(0.1)
    before = one.passive.arrays()["distance_disc"]
    one.integrator.carried[1].begin()
    one.integrator.carried[1].stage(np.ones(1), 1.0)
    one.integrator.carried[1].carry(0.05)
    assert np.array_equal(one.passive.arrays()["distance_disc"], before)
    one.integrator.carried[1].end(np.ones(1))
    assert np.abs(one.passive.arrays()["distance_disc"] - before).max() > 1e-4


def test_outlines_are_refused_for_models_that_cannot_have_them():
    with pytest.raises(nv.ParameterError, match=r"Discretisation.outlines.*unless interfaces are"):
        nv.Discretisation(outlines=True)
    with pytest.raises(nv.ParameterError, match=r"Discretisation.outlines carries have no derivative"):
        nv.gradient(run(), 0.05, of=["kinetic at 0.05"], by=["bodies.disc.material.G_e"])
    with pytest.raises(nv.ParameterError, match="passive fields that the source carries too"):
        nv.transfer(run(nv.Discretisation(sharp=True)), run())
    parts = [
        nv.Body(name="fluid", material=FLUID, density=1.0),
        nv.Body(name="ball", where=nv.Ball((0.5,) * 3, 0.3), material=LINEAR, density=1.0),
    ]
    with pytest.raises(nv.ParameterError, match=r"Discretisation.outlines = True.*three dimensions"):
        nv.Simulation(box((1, 1, 1), 0.5), nv.Model(bodies=parts), dt=0.1, discretisation=OUTLINED)
