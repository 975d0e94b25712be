"""Tangents and adjoints of the tables of bodies."""

from functools import partial

import numpy as np
import pytest
from differentiated import UNTIL, VELOCITY, started
from ngsolve import x, y, z
from support import by_ci
from test_adjoint import directional

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.sensitivity.body_slopes import BodySlopes
from ngvisco.sensitivity.columns import tables_of
from ngvisco.sensitivity.outline_slopes import OutlineSlopes
from tests.verification.cases.sensitivities import measure

VISCOSITY = nv.StokesViscosity(K_v=0.1, G_v=0.1)
MESH = box((1, 1), maxh=0.3)
SHAPES = ("deformation", "outline", "turning", "stress", "traction", "gap")
NUMBERS = {"mean torque": "disc_torque until 0.05", "mean angle": "disc_angle until 0.05"}


def bodies(stiffness=5.0, bulk=10.0, mesh=MESH, measures=SHAPES, **options):
    """Two discs in a softer body."""
    parts = [
        (
            "disc",
            nv.Ball((0.3, 0.5, 0.5)[: mesh.dim], 0.25),
            nv.IsochoricNeoHookean(K_e=10, G_e=stiffness),
            2.0,
        ),
        ("ball", nv.Ball((0.8, 0.6, 0.5)[: mesh.dim], 0.2), nv.IsochoricNeoHookean(K_e=bulk, G_e=2), 1.5),
        ("rest", None, nv.IsochoricNeoHookean(K_e=10, G_e=0.5), 1.0),
    ]
    model = nv.Model(
        bodies=[
            nv.Body(name=name, where=where, material=material, density=density, viscosity=VISCOSITY)
            for name, where, material, density in parts
        ]
    )
    given = {"observers": [nv.Bodies(measures=measures)], "initial": nv.Initial(velocity=VELOCITY)}
    return started(model, mesh=mesh, **given | options)


def columns(run, of="disc"):
    """The differentiable columns of one body and of gaps; its mass is constant."""
    (table,) = tables_of(run)
    names = [name for name in table.prepare(run) if name.startswith((f"{of}_", "gap"))]
    return [name for name in names if name not in (*table.jumping, f"{of}_mass")]


def numbers(run, **of):
    return {name: f"{name} at 0.06" for name in columns(run, **of)} | NUMBERS


def relative(found, exact, names):
    """Differences of derivatives, relative to the largest derivative of the same kind of column: energies,
    stresses, forces and so on."""
    energies = dict.fromkeys(("kinetic", "stored"), "energy")
    words = [name.replace(" ", "_").split("_")[1] for name in names]
    kinds = [energies.get(word, word[:5]) for word in words]
    sizes = [max(abs(exact[[other == kind for other in kinds]])) for kind in kinds]
    return abs(found - exact) / sizes


@pytest.mark.parametrize(
    ("scheme", "solver"),
    [
        by_ci("backward-euler", "coupled"),
        by_ci("midpoint", "split"),
        by_ci("sdirk2", "coupled"),
        by_ci("sdirk2", "split"),
    ],
)
def test_products_of_tangent_and_adjoint_are_equal(scheme, solver):
    """The test changes the velocities of the start, because viscosities of mixtures have a kink where a
    fraction is 0.

    With the seed 0, a fraction changes its sign at a point within the tangent's differences (third step of
    SDIRK2). The products then differ by 1e-6. With a third of the spacing, the products are equal.
    """
    of, seed = numbers(bodies()), int(scheme == "sdirk2")
    by_tangent, by_adjoint = directional(partial(bodies, solver=solver), scheme, of, 0.5, "v", seed)
    assert len(of) == 25
    assert relative(by_adjoint, by_tangent, of).max() < 1e-10


@pytest.mark.long
def test_products_agree_to_the_tolerance_of_energies_that_are_solved_for_at_points():
    """The energies of bodies of different bulk moduli are found by a search at points, and are right to
    1e-8."""
    of = numbers(bodies())
    make = partial(bodies, bulk=20.0, scheme="backward-euler")
    by_tangent, by_adjoint = directional(make, "backward-euler", of, 0.1, "v")
    assert relative(by_adjoint, by_tangent, of).max() < 1e-6


WIDTHS = (1e-2, 1e-3, 1e-4, 1e-5)
NAME = "bodies.disc.material.G_e"


def errors(method, make, of):
    """Relative errors of derivatives by a modulus against central differences, (widths, numbers)."""
    found = nv.gradient(make(), UNTIL, of=of, by=[NAME], method=method).jacobian[:, 0]
    errors = []
    for width in WIDTHS:
        up, down = (measure(make(5.0 * (1 + sign * width)), UNTIL, of) for sign in (1, -1))
        errors.append(relative((up - down) / (10 * width), found, of))
    return np.array(errors)


@pytest.mark.parametrize("method", [by_ci("adjoint"), pytest.param("tangent", marks=pytest.mark.long)])
def test_derivatives_are_limits_of_central_differences(method):
    of = numbers(bodies())
    off = errors(method, partial(bodies, scheme="backward-euler"), of)
    assert off.min(axis=0).max() < 1e-6
    assert off[0].max() > 20 * off[1].max()


@pytest.mark.long
def test_forces_and_stresses_in_three_dimensions_have_derivatives():
    start = nv.Initial(velocity=(y * (1 - y) * z * x * (1 - x), 0, 0))
    given = {"mesh": structured_box((1, 1, 1), (1, 1, 1)), "initial": start, "scheme": "backward-euler"}
    make = partial(bodies, measures=("stress", "traction"), **given)
    of = {name: f"{name} at 0.02" for name in columns(make())}
    tangent, adjoint = (
        nv.gradient(make(), 0.02, of=of, by=[NAME], method=method) for method in ("tangent", "adjoint")
    )
    # the derivatives of some places are below the rounding of differences
    sizes = np.maximum(abs(tangent.jacobian[:, 0]), 1e-3 * abs(tangent.values / 5.0))
    assert (abs(adjoint.jacobian - tangent.jacobian)[:, 0] / sizes).max() < 1e-6


@pytest.mark.long
@pytest.mark.ci
def test_an_adjoint_without_one_of_its_parts_is_wrong(monkeypatch):
    """Negative controls: adjoints without the part of the outline's motion, of the velocity inside, of the
    averaged fraction, or of the volume."""
    names = ("disc_L", "disc_perimeter", "disc_turning", "disc_force_x", "disc_x")
    of, make = {name: f"{name} at 0.02" for name in names}, partial(bodies, scheme="backward-euler")
    given = {"of": of, "by": ["bodies.rest.density"], "method": "adjoint", "order": 2}
    exact = nv.gradient(make(), 0.02, **given).jacobian[:, 0]
    monkeypatch.setattr(OutlineSlopes, "_of_region", lambda self, f: 0 * self.theta)
    monkeypatch.setattr(OutlineSlopes, "of_ends", lambda self, w: (0 * self.theta, 0 * self.places))
    monkeypatch.setattr(OutlineSlopes, "_of_velocity", lambda self, f: 0 * self.places)
    monkeypatch.setattr(
        BodySlopes, "_averaged", lambda self, name: lambda rows: np.zeros(self.step.layout.space.ndof)
    )
    monkeypatch.setattr(BodySlopes, "_quotient", lambda self, name, of_integral, density: of_integral)
    cut = nv.gradient(make(), 0.02, **given).jacobian[:, 0]
    assert abs(cut / exact - 1).min() > 0.01


@pytest.mark.parametrize("method", ["tangent", "adjoint"])
@pytest.mark.parametrize(
    ("column", "said"),
    [("disc_x_max", "jumps between points"), ("ball_smeared", "counts parts of cells")],
)
def test_gradients_of_columns_that_jump_are_refused(method, column, said):
    with pytest.raises(nv.ParameterError, match=said):
        nv.gradient(bodies(), UNTIL, of=[f"{column} at 0.06"], by=[NAME], method=method)
