"""Tangents and adjoints of further models: bodies, heat, yield, energies without an expression.

The verification case ``sensitivities`` has all models by all schemes.
"""

from functools import partial

import numpy as np
import pytest
from differentiated import UNTIL, VELOCITY, started
from ngsolve import x
from support import by_ci

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.physics.variables import Jacobian
from tests.verification.cases.sensitivities import measure

VISCOSITY = nv.StokesViscosity(K_v=0.1, G_v=0.1)
ELASTIC = nv.NeoHookean(K_e=10, G_e=5, epsilon=0.1)
OF = ["kinetic at 0.06", "stored at 0.06", "p.cauchy_stress_11 at 0.06"]


def bodies(stiffness, **options):
    disc = nv.Body(
        name="disc",
        where=nv.Ball((0.5, 0.5), 0.3),
        material=nv.IsochoricNeoHookean(K_e=10, G_e=stiffness),
        density=2.0,
        viscosity=VISCOSITY,
    )
    rest = nv.Body(
        name="rest", material=nv.IsochoricNeoHookean(K_e=10, G_e=0.5), density=1, viscosity=VISCOSITY
    )
    model = nv.Model(bodies=[disc, rest])
    return started(model, mesh=box((1, 1), maxh=0.6), initial=nv.Initial(velocity=VELOCITY), **options)


def heated(expansion, by_scheme=False, **options):
    material = nv.Thermal(material=ELASTIC, c=2.0, theta_R=300.0, expansion=expansion)
    initial = nv.Initial(density=1.0, velocity=VELOCITY, temperature=300 + 20 * x)
    heat = nv.Heat(conductivity=0.5, numerical_heating=by_scheme)
    return started(nv.Model(material=material, viscosity=VISCOSITY, heat=heat), initial=initial, **options)


def yielding(stress, **options):
    creep = nv.Perzyna(G_m=1.0, sigma_Y=stress, H=0.5)
    return started(nv.Model(material=ELASTIC, viscosity=VISCOSITY, creep=creep), **options)


def smoothed(eps, **options):
    return started(nv.Model(material=nv.Yosida(material=ELASTIC, eps=eps), viscosity=VISCOSITY), **options)


@pytest.mark.parametrize(
    ("make", "name", "value", "options"),
    [
        by_ci(bodies, "bodies.disc.material.G_e", 5.0, {}),
        by_ci(heated, "material.expansion", 1e-3, {"solver": "split", "scheme": "backward-euler"}),
        by_ci(yielding, "creep.sigma_Y", 0.3, {}),
        by_ci(smoothed, "material.eps", 0.01, {"scheme": "sdirk2"}),
    ],
    ids=["bodies", "heat by split", "yield", "Yosida"],
)
def test_tangents_and_adjoints_are_limits_of_differences(make, name, value, options):
    tangent, adjoint = (
        nv.gradient(make(value, **options), UNTIL, of=OF, by=[name], method=method).jacobian[:, 0]
        for method in ("tangent", "adjoint")
    )
    h = 1e-3 * value
    up, down = (measure(make(value + s * h, **options), UNTIL, OF) for s in (1, -1))
    assert np.allclose(tangent, (up - down) / (2 * h), rtol=3e-6, atol=0)
    # sums with 600 J of heat have larger rounding errors, which differences divide by the spacing (NOTES)
    assert np.allclose(adjoint, tangent, rtol=3e-6 if make is heated else 1e-6, atol=0)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("solver", ["coupled", by_ci("split")])
def test_the_heat_of_the_scheme_has_derivatives_in_spite_of_rounding(solver):
    """The power changes relatively by 7e-5 of the change of the expansion. Rounding of 600 J of heat limits
    the accuracy."""
    value, of = 1e-3, ["power_heat_numerical at 0.06", "power_heat_numerical until 0.06", "bregman at 0.06"]
    make = partial(heated, by_scheme=True, solver=solver, scheme="backward-euler")
    tangent, adjoint = (
        nv.gradient(make(value), UNTIL, of=of, by=["material.expansion"], method=method).jacobian[:, 0]
        for method in ("tangent", "adjoint")
    )
    up, down = (measure(make(value * (1 + s * 1e-2)), UNTIL, of) for s in (1, -1))
    assert np.allclose(adjoint, (up - down) / (2e-2 * value), rtol=1e-5, atol=0)
    assert np.allclose(tangent, adjoint, rtol=5e-5, atol=0)


def layered(stiffness, **options):
    """A stiff disc in a thin fluid. The normals of their interface are those at the start of the step."""
    of_bodies = [("disc", nv.Ball((0.35, 0.55), 0.25), stiffness, 0.3), ("rest", None, 0.5, 0.05)]
    model = nv.Model(
        bodies=[
            nv.Body(
                name=name,
                where=where,
                material=nv.IsochoricNeoHookean(K_e=10, G_e=G_e),
                density=1.0,
                viscosity=nv.StokesViscosity(K_v=0.1, G_v=G_v),
            )
            for name, where, G_e, G_v in of_bodies
        ]
    )
    observers = [nv.Bodies(measures=["traction"]), nv.Probes({"p": (0.35, 0.75)}, ["viscous_stress"])]
    given = {"mesh": box((1, 1), maxh=0.4), "initial": nv.Initial(velocity=VELOCITY), "observers": observers}
    return started(model, **given | options)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize(
    ("columns", "options"),
    [
        (("disc_force_x", "p.viscous_stress_12"), {"scheme": "backward-euler"}),
        by_ci(("disc_force_y", "disc_torque", "p.viscous_stress_11"), {"solver": "split"}),
    ],
)
def test_columns_that_read_the_start_of_a_step_have_derivatives(columns, options):
    """The tangent differentiates such columns by differences, which change the start of each stage."""
    columns = ("dissipation_stokes_shear", *columns)
    of = [f"{column} {when}" for column in columns for when in ("at 0.06", "until 0.05")]
    given = {"of": of, "by": ["bodies.disc.material.G_e"], "order": 2}
    tangent, adjoint = (
        nv.gradient(layered(5.0, **options), UNTIL, method=method, **given).jacobian[:, 0]
        for method in ("tangent", "adjoint")
    )
    assert np.allclose(adjoint, tangent, rtol=1e-6, atol=0)


@pytest.mark.long
@pytest.mark.ci
def test_integrals_of_stresses_have_derivatives_for_an_energy_without_an_expression():
    """Stress and pressure read a projection of the energy's values at points."""
    table = nv.Integrals({"pressed": "pressure*x", "square": "cauchy_stress_11**2"})
    of = ["pressed at 0.04", "square at 0.04"]
    options = {"observers": [table], "scheme": "backward-euler"}
    tangent, adjoint = (
        nv.gradient(
            smoothed(0.01, **options), 0.04, of=of, by=["viscosity.G_v"], method=method, order=2
        ).jacobian
        for method in ("tangent", "adjoint")
    )
    assert np.allclose(adjoint, tangent, rtol=1e-7, atol=0)


@pytest.mark.parametrize(
    ("discretisation", "method", "said"),
    [
        (nv.Discretisation(k=1, m=0), "tangent", "direction of interfaces has no derivative"),
        (nv.Discretisation(sharp=True), "adjoint", "'tangent' for a run with Discretisation.sharp"),
    ],
)
def test_interfaces_without_derivatives_are_refused(discretisation, method, said):
    matter = nv.BarotropicFluid(B=10.0, gamma=1.5)
    low, high = (
        nv.Body(
            name=name, where=where, material=matter, viscosity=nv.StokesViscosity(K_v=1, G_v=G), density=1
        )
        for name, where, G in (("low", 0.5 - x, 1.0), ("high", None, 2.0))
    )
    options = {"initial": nv.Initial(velocity=VELOCITY), "discretisation": discretisation}
    run = started(nv.Model(bodies=[low, high]), **options)
    with pytest.raises(nv.ParameterError, match=said):
        nv.gradient(
            run, UNTIL, of={"motion": "kinetic at 0.06"}, by=["bodies.low.viscosity.G_v"], method=method
        )


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("scheme", [by_ci("backward-euler"), "midpoint"])
def test_tangents_of_runs_with_sharp_interfaces_equal_differences(scheme):
    """The exchanged amounts and the places of planes depend on the parameters. With constant exchanges,
    derivatives of the place would be off by 6 to 30 %, and the derivative of D by half. The disc hardly
    moves upwards, so that the default tolerance of Newton's method would be a ten-thousandth of a
    difference of its place."""

    def made(G_e):
        table = nv.Bodies(measures=["deformation"])
        fluid = nv.CustomMaterial(
            transported=(Jacobian(),), stored_energy=lambda J: 5 * (J - 1) * (J - 1) / J
        )
        solid = nv.ReferentialNeoHookean(K_e=10.0, G_e=G_e)
        both = {"viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1), "density": 1.0}
        bodies = (
            nv.Body(name="fluid", material=fluid, **both),
            nv.Body(name="disc", where=nv.Ball((0.5, 0.6), 0.25), material=solid, **both),
        )
        run = nv.Simulation(
            structured_box((1, 1), (4, 4), split_corners=True),
            nv.Model(bodies=bodies),
            time=nv.TimeSteps(dt=0.05, scheme=scheme),
            walls={"top": nv.PrescribedTangential((1.0, 0.0))},
            discretisation=nv.Discretisation(m=1, sharp=True),
            newton=nv.NewtonOptions(tolerance=1e-12),
            observers=[table],
        )
        return run, table

    names, h = ["disc_x", "disc_y", "disc_D", "disc_stored"], 1e-3
    path = "bodies.disc.material.G_e"
    of = [f"{name} at 0.3" for name in names]
    found = nv.gradient(made(1.0)[0], 0.3, of=of, by=[path], order=2).jacobian[:, 0]
    ends = []
    for G_e in (1 + h, 1 - h):
        run, table = made(G_e)
        run.run(0.3)
        ends.append(np.array([table.column(name)[-1] for name in names]))
    assert np.abs(found / ((ends[0] - ends[1]) / (2 * h)) - 1).max() < 1e-4


def test_derivatives_of_damage_are_refused():
    material = nv.Damaged(material=nv.LinearElastic(K_e=10, G_e=5), G_c=1.0, length=0.5)
    with pytest.raises(nv.ParameterError, match="growth of damage has no derivative"):
        run = started(nv.Model(material=material, viscosity=VISCOSITY))
        nv.gradient(run, UNTIL, of=OF, by=["viscosity.G_v"])
