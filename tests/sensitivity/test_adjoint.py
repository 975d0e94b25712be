"""Adjoints of runs against tangents, and against differences by fields."""

from functools import partial

import numpy as np
import pytest
from differentiated import AT, OF, UNTIL, run, started
from ngsolve import Integrate, x, y
from support import by_ci

import ngvisco as nv
from ngvisco.geometries import disc, structured_box
from ngvisco.sensitivity.adjoint import Adjoint
from ngvisco.sensitivity.gradient import follower_of, numbers_of
from ngvisco.sensitivity.slopes import Slopes
from ngvisco.sensitivity.starts import Starts
from ngvisco.sensitivity.tangent import Neighbours, history, tangents
from ngvisco.sensitivity.trajectory import Trajectory
from tests.verification.cases.sensitivities import measure


@pytest.mark.parametrize("scheme", [by_ci("backward-euler"), by_ci("midpoint"), "sdirk2"])
def test_adjoint_and_tangent_agree(scheme):
    by = ["creep.G_m", "initial.density"]
    tangent, adjoint = (
        nv.gradient(run(scheme=scheme), UNTIL, of=OF, by=by, method=method)
        for method in ("tangent", "adjoint")
    )
    assert np.array_equal(tangent.values, adjoint.values)
    assert abs(adjoint.jacobian / tangent.jacobian - 1).max() < 1e-8


def directional(make, scheme, of, size=1.0, block=None, seed=0):
    """The derivative along a random change of the start, or of one block of it, by tangent and adjoint."""
    simulation = make(scheme=scheme)
    numbers = numbers_of(of, UNTIL, simulation)
    base, trajectory = follower_of(simulation, numbers.columns), Trajectory(simulation)
    slopes = Slopes(base)
    one = Neighbours(Still(), make(scheme=scheme), base.columns)
    trajectory.run(UNTIL)
    found, starts = history(trajectory, base), Starts(base)
    random = size * np.random.default_rng(seed).standard_normal(len(base.state))
    moved = starts.evolving & np.array(list(base.step.layout.space.FreeDofs()))
    if block is not None:
        others = np.ones(len(moved), dtype=bool)
        others[base.step.layout.ranges[block]] = False
        moved &= ~others
    one.of_start = np.where(moved, random, 0.0)
    by_tangent = numbers.parts(tangents(trajectory, base, [one], True))[:, 0]
    adjoint = Adjoint(trajectory, base, slopes, [], *numbers.weights(found, base.columns))
    adjoint.run(True)
    return by_tangent, adjoint.of_start @ one.of_start


class Still:
    """A parameter without effect. Tangents use differences, whose spacing limits the accuracy of the
    products: a smaller spacing has more rounding, a larger one a larger fifth derivative.
    """

    value, spacing, is_of_start = 1.0, 3e-3, False

    def varied(self, simulation, value):
        return simulation.on(simulation.mesh)


@pytest.mark.parametrize("solver", ["coupled", by_ci("split")])
@pytest.mark.parametrize("scheme", [by_ci("backward-euler"), by_ci("midpoint"), "sdirk2"])
def test_products_of_tangent_and_adjoint_are_equal(scheme, solver):
    """Both products are derivatives along a random change of the start values, so that neither contains a
    difference by a parameter."""
    numbers = {name: text for name, text in OF.items() if name != "stress"} | FORCES
    by_tangent, by_adjoint = directional(partial(run, solver=solver), scheme, numbers)
    assert abs(by_adjoint / by_tangent - 1).max() < 1e-10


@pytest.mark.long
@pytest.mark.ci
def test_an_adjoint_without_the_old_state_is_wrong(monkeypatch):
    """A negative control: the adjoint ignores the state from which a step starts."""
    monkeypatch.setattr(Starts, "transposed", lambda self, rows: 0 * rows)
    by_tangent, by_adjoint = directional(run, "midpoint", {"motion": OF["motion"]})
    assert abs(by_adjoint / by_tangent - 1).max() > 0.1


FORCES = {"push": "bottom.force_2 at 0.06", "turn": "bottom.torque until 0.05"}


def between(stiffness, **options):
    """A body between a wall that moves and one with springs, beside walls with friction."""
    walls = {
        "top": nv.PrescribedTangential((1.2 * x * (1 - x), 0.0)),
        "bottom": nv.Open(stiffness=(10.0, 1.0), density=1.0),
        **{side: nv.NavierFriction(0.2) for side in ("left", "right")},
    }
    return run(AT | {"material.G_e": stiffness}, walls=walls, **options)


def smooth(stiffness, **options):
    """A body whose energy has values at points only."""
    material = nv.Yosida(material=nv.NeoHookean(K_e=10, G_e=stiffness, epsilon=0.1), eps=0.01)
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1))
    return started(model, **options)


def curved(stiffness, **options):
    """A disc in a wall with friction and multipliers."""
    velocity = (-y * (1 - x * x - y * y) + 0.2 * y, x * (1 - x * x - y * y) + 0.1 * x * x)
    return run(
        AT | {"material.G_e": stiffness},
        mesh=disc(radius=1, maxh=1.5),
        walls={"wall": nv.NavierFriction(0.2)},
        initial=nv.Initial(density=1.0, velocity=velocity),
        **options,
    )


@pytest.mark.parametrize(
    ("make", "options", "columns"),
    [
        (between, {}, ("top.force_1", "bottom.force_2", "left.torque", "power_wall_top")),
        by_ci(between, {"solver": "split", "scheme": "sdirk2"}, ("top.force_1", "power_wall_top")),
        by_ci(smooth, {}, ("right.force_1", "top.torque")),
        by_ci(curved, {"scheme": "backward-euler"}, ("wall.force_1", "wall.torque")),
        by_ci(curved, {"scheme": "midpoint"}, ("wall.force_1", "wall.torque")),
    ],
)
def test_adjoint_and_tangent_agree_for_forces_and_powers_of_walls(make, options, columns):
    given = {"observers": [nv.WallForces()]} | options
    numbers = [f"{name} {when}" for name in columns for when in ("at 0.06", "until 0.05")]
    name, value, h = "material.G_e", 5.0, 5e-3
    tangent, adjoint = (
        nv.gradient(make(value, **given), UNTIL, of=numbers, by=[name], method=method).jacobian[:, 0]
        for method in ("tangent", "adjoint")
    )
    assert np.allclose(adjoint, tangent, rtol=1e-8, atol=1e-9 * abs(tangent).max())
    up, down = (measure(make(value + s * h, **given), UNTIL, numbers) for s in (1, -1))
    assert np.allclose(adjoint, (up - down) / (2 * h), rtol=1e-5, atol=1e-6 * abs(tangent).max())


def lid(velocity, **options):
    """A body under a wall that moves with a constant velocity between its corners."""
    mesh = structured_box((1, 1), (3, 1))
    return run(mesh=mesh, walls={"top": nv.PrescribedTangential((velocity, 0.0))}, **options)


@pytest.mark.parametrize("scheme", ["midpoint", by_ci("backward-euler"), by_ci("sdirk2")])
def test_the_power_of_a_moving_wall_has_a_derivative_by_its_velocity(scheme):
    """The power v . R depends on the velocity directly, and by the force that the velocity causes."""
    of = [
        f"{name} {when}" for name in ("power_wall_top", "top.force_1") for when in ("at 0.06", "until 0.05")
    ]
    name, value, h = "walls.top.velocity.0", 0.3, 1e-4
    given = {"observers": [nv.WallForces()], "scheme": scheme}
    tangent, adjoint = (
        nv.gradient(lid(value, **given), UNTIL, of=of, by=[name], method=method).jacobian[:, 0]
        for method in ("tangent", "adjoint")
    )
    assert np.allclose(adjoint, tangent, rtol=1e-8, atol=0)
    up, down = (measure(lid(value + s * h, **given), UNTIL, of) for s in (1, -1))
    assert np.allclose(adjoint, (up - down) / (2 * h), rtol=1e-6, atol=0)


def soft(change=0.0, scheme="midpoint", **options):
    """A block with a field of stiffness."""
    tilt = x - 2 * y  # the limiter would change start values that are no polynomials of their order
    theta = nv.Parameter("theta", start=2 + x + change * tilt)
    model = nv.Model(
        material=nv.NeoHookean(K_e=10, G_e=theta, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
    )
    return started(model, scheme=scheme, limiter=False, **options), tilt


def test_derivatives_by_a_field_are_a_density_over_the_domain():
    numbers = {name: OF[name] for name in ("motion", "stress", "share")}
    simulation, tilt = soft()
    found = nv.gradient(simulation, UNTIL, of=numbers, method="adjoint")
    density = [Integrate(found.density(name, "theta") * tilt, simulation.mesh) for name in numbers]
    up, down = (measure(soft(change)[0], UNTIL, numbers) for change in (1e-3, -1e-3))
    assert np.allclose(density, (up - down) / 2e-3, rtol=1e-5, atol=0)


def test_a_probe_of_a_carried_logarithm_has_the_slope_of_each_time():
    """The stiffness is the exponential of the carried field, so that its slope changes in time."""
    theta = nv.Parameter("theta", start=2 + x, mean="geometric")
    viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.1)
    model = nv.Model(material=nv.NeoHookean(K_e=10, G_e=theta, epsilon=0.1), viscosity=viscosity)
    tangent, adjoint = (
        nv.gradient(
            started(model, observers=[nv.Probes({"p": (0.3, 0.6)}, ["theta"])]),
            UNTIL,
            of=["p.theta until 0.06", "p.theta at 0.06"],
            by=["viscosity.G_v"],
            method=method,
        ).jacobian
        for method in ("tangent", "adjoint")
    )
    assert np.allclose(adjoint, tangent, rtol=1e-8, atol=0)


def test_densities_of_derivatives_by_the_density_sum_to_the_derivative_by_a_number():
    """If all densities change by the same factor, the integral of the density of derivatives is the
    derivative by that number."""
    simulation = run()
    found = nv.gradient(simulation, UNTIL, of=OF, by=["initial.density"], method="adjoint")
    whole = [Integrate(found.density(name, "density"), simulation.mesh) for name in OF]
    assert np.allclose(whole, found.jacobian[:, 0], rtol=1e-8, atol=0)


@pytest.mark.long
@pytest.mark.ci
def test_adjoint_and_tangent_agree_with_a_curved_wall():
    """The multipliers of the wall are unknowns of the system that gives the velocity from the momentum."""
    velocity = (-y * (1 - x * x - y * y) + 0.2 * y, x * (1 - x * x - y * y))
    given = dict(
        mesh=disc(radius=1, maxh=1.5),
        observers=[nv.Probes({"p": (0.3, 0.2)}, ["velocity"])],
        initial=nv.Initial(density=1.0, velocity=velocity),
    )
    numbers = {"motion": "kinetic at 0.06", "way": "p.velocity_1 until 0.06"}
    tangent, adjoint = (
        nv.gradient(
            run(**given), UNTIL, of=numbers, by=["material.G_e", "initial.density"], method=method
        ).jacobian
        for method in ("tangent", "adjoint")
    )
    assert abs(adjoint / tangent - 1).max() < 1e-8


@pytest.mark.long
@pytest.mark.ci
def test_a_misfit_is_half_the_sum_of_squares():
    data, sigma = {"kinetic at 0.04": 0.1, "p.velocity_1 at 0.06": 0.2}, (0.01, 0.02)
    numbers = {"misfit": nv.Misfit(data, sigma), "motion": "kinetic at 0.04", "speed": "p.velocity_1 at 0.06"}
    by = ["material.G_e", "creep.G_m"]
    tangent, adjoint = (
        nv.gradient(run(), UNTIL, of=numbers, by=by, method=method) for method in ("tangent", "adjoint")
    )
    off = (tangent.values[1:] - np.array([0.1, 0.2])) / sigma
    assert tangent.values[0] == pytest.approx(0.5 * off @ off, rel=1e-14)
    expected = (off / sigma) @ tangent.jacobian[1:]
    assert np.allclose(tangent.jacobian[0], expected, rtol=1e-13)
    assert np.allclose(adjoint.jacobian, tangent.jacobian, rtol=1e-8, atol=0)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"method": "forward"}, "'tangent' or 'adjoint'"),
        ({"of": {"m": "kinetic at 0.06"}, "method": "tangent", "by": []}, "at least one parameter"),
    ],
)
def test_gradients_that_the_adjoint_does_not_support_are_refused(given, said):
    with pytest.raises(nv.NgviscoError, match=said):
        nv.gradient(run(), UNTIL, **{"of": ["kinetic at 0.06"], "by": list(AT), "method": "adjoint"} | given)


def test_derivatives_by_a_field_require_the_adjoint_method_and_a_scalar_field():
    simulation, _ = soft()
    found = nv.gradient(simulation, UNTIL, of=["kinetic at 0.06"], by=["viscosity.G_v"])
    with pytest.raises(nv.ParameterError, match="method='adjoint'"):
        found.density("kinetic at 0.06", "theta")
    found = nv.gradient(soft()[0], UNTIL, of=["kinetic at 0.06"], method="adjoint")
    with pytest.raises(nv.UnknownNameError, match="unknown scalar field 'F'"):
        found.density("kinetic at 0.06", "F")
    with pytest.raises(nv.UnknownNameError, match="unknown number"):
        found.density("kinetic", "theta")


@pytest.mark.parametrize(
    ("data", "sigma", "said"),
    [
        ({}, 1.0, "a mapping"),
        ({"kinetic at 0": "x"}, 1.0, "a finite number"),
        ({"kinetic at 0": 1}, 0, "> 0"),
    ],
)
def test_bad_data_of_a_misfit_are_refused(data, sigma, said):
    with pytest.raises(nv.ParameterError, match=said):
        nv.Misfit(data, sigma)
