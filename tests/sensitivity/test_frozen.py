"""Quantities that derivatives treat as constants: sides of upwinding, and the limiter's change of a state."""

import numpy as np
import pytest
from differentiated import VELOCITY, started
from ngsolve import IfPos, pi, sin, x

import ngvisco as nv
from ngvisco.geometries import structured_box
from tests.verification.cases.sensitivities import measure


def recoiling(stiffness):
    """A swirl that turns back between 0.1 s and 0.2 s, with a facet at x = 0.5 m."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10, G_e=stiffness, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
    )
    return started(
        model,
        scheme="backward-euler",
        mesh=structured_box((1, 1), (2, 2)),
        initial=nv.Initial(density=1.0 + 0.3 * sin(pi * x), velocity=VELOCITY),
        observers=[nv.Probes({"facet": (0.5, 0.2)}, ["velocity"])],
        limiter=False,
    )


@pytest.mark.long
@pytest.mark.ci
def test_derivatives_are_exact_when_the_upstream_side_changes_between_steps():
    numbers = ["kinetic at 0.24", "stored at 0.24", "facet.velocity_1 at 0.24"]
    run = recoiling(5.0)
    gradient = nv.gradient(run, 0.24, of=numbers, by=["material.G_e"]).jacobian[:, 0]
    across = run.observers[0].column("facet.velocity_1")
    assert (np.diff(np.sign(across)) != 0).any()
    h = 5e-4
    up, down = (measure(recoiling(5.0 + s * h), 0.24, numbers) for s in (1, -1))
    assert abs((up - down) / (2 * h) / gradient - 1).max() < 1e-6


def resting(push):
    """Matter at rest with two densities that meet at facets, pushed by a load."""
    model = nv.Model(
        material=nv.ReferentialNeoHookean(K_e=10, G_e=5),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        loads=[nv.Gravity((push, 0))],
    )
    given = {
        "mesh": structured_box((1, 1), (2, 1)),
        "initial": nv.Initial(density=IfPos(x - 0.5, 2.0, 1.0)),
        "observers": [nv.Integrals({"right": "density*(1 if x > 0.5 else 0)"})],
        "limiter": False,
    }
    return started(model, scheme="backward-euler", **given)


def test_at_rest_a_gradient_lies_between_the_one_sided_derivatives():
    """Matter that crosses the face has the density of the upstream side, 1 or 2."""
    numbers, h = ["right at 0.04"], 1e-4
    gradient = nv.gradient(resting(0.0), 0.04, of=numbers, by=["loads.gravity.g.0"]).jacobian[0, 0]
    down, unmoved, up = (measure(resting(s * h), 0.04, numbers)[0] for s in (-1, 0, 1))
    to_right, to_left = (up - unmoved) / h, (unmoved - down) / h
    assert to_left == pytest.approx(2 * to_right, rel=1e-2)
    assert 0.999 * to_right < gradient < 1.001 * to_left


def limited(stiffness, scheme="backward-euler", **options):
    """A swirl of two densities that meet within cells."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10, G_e=stiffness, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
    )
    initial = nv.Initial(density=IfPos(x - 0.4, 2.0, 0.1), velocity=VELOCITY)
    mesh = structured_box((1, 1), (3, 3))
    return started(model, scheme=scheme, mesh=mesh, initial=initial, **options)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("scheme", ["backward-euler", "midpoint"])
def test_tangents_and_adjoints_agree_for_steps_that_the_limiter_changed(scheme):
    """A wall's velocity acts on the end of a step also through the density that the limiter has changed."""
    walls, parameters = {"top": nv.PrescribedTangential((0.3, 0.0))}, ["walls.top.velocity.0", "material.G_e"]
    numbers = ["kinetic at 0.04", "momentum_1 at 0.04", "impulse_walls_1 at 0.04"]
    tangent, adjoint = (
        nv.gradient(limited(5.0, scheme, walls=walls), 0.04, of=numbers, by=parameters, method=method)
        for method in ("tangent", "adjoint")
    )
    assert tangent.limited > 0
    assert adjoint.jacobian == pytest.approx(tangent.jacobian, rel=1e-8)


@pytest.mark.long
@pytest.mark.ci
def test_derivatives_keep_the_limiter_factors_fixed():
    numbers = ["kinetic at 0.06", "share at 0.06"]
    gradient = nv.gradient(limited(5.0), 0.06, of=numbers, by=["material.G_e"])
    h = 5e-4
    up, down = (measure(limited(5.0 + s * h), 0.06, numbers) for s in (1, -1))
    error = abs((up - down) / (2 * h) / gradient.jacobian[:, 0] - 1).max()
    assert gradient.limited > 0
    assert 3e-4 < error < 3e-3  # constant factors cause an error of about a thousandth
