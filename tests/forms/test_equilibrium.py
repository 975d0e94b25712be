"""Hydrostatic starts: the initial pressure bears the weight above, in materials, layers, bodies and heat."""

import warnings

import numpy as np
import pytest
from ngsolve import CF, IfPos, x, y

import ngvisco as nv
from ngvisco.forms.start.data_checks import InputWarning
from ngvisco.forms.tension import readers
from ngvisco.geometries import structured_box
from ngvisco.run.advice import scales

K, G, RHO, WEIGHT = 50.0, 30.0, 2.0, 1.0
ROCK = nv.ReferentialNeoHookean(K_e=K, G_e=G / 2)
DOWN = nv.Gravity((0.0, -WEIGHT))
VISCOUS = nv.StokesViscosity(K_v=0.1, G_v=0.1)


LOWEST = nv.Discretisation(k=1, m=0)


def at_rest(
    material=ROCK,
    *,
    discretisation=None,
    cells=(2, 4),
    size=(1, 1),
    loads=(DOWN,),
    model=None,
    solver="split",
    dt=0.05,
    periodic=(),
    **given,
):
    of = nv.Model(material=material, viscosity=VISCOUS, loads=loads) if model is None else model
    given = {"equilibrium": "hydrostatic"} | given
    mesh, orders = structured_box(size, cells, periodic=periodic), discretisation or nv.Discretisation()
    initial = nv.Initial(**given)
    return nv.Simulation(mesh, of, dt=dt, initial=initial, solver=solver, discretisation=orders)


def pressures(run, *heights):
    p = run.fields["pressure"]
    return [p(run.mesh(0.3, height)) for height in heights]


def speed(run, steps=3):
    return max(run.advance()["v_max"] for _ in range(steps))


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_a_body_starts_with_the_weight_above_and_stays_at_rest(solver):
    """The start is exact in cells of constant density; without the equilibrium the body falls at 0.03
    m/s."""
    run = at_rest(density=RHO, solver=solver)
    assert pressures(run, 0.0, 0.5, 1.0) == pytest.approx([RHO, RHO / 2, 0.0], abs=1e-3 * RHO)
    assert run.sampler.extrema(run.fields["J"]) == pytest.approx((1 - RHO / K, 1.0), abs=1e-6)
    assert speed(run) < 1e-5
    assert speed(at_rest(density=RHO, solver=solver, equilibrium=None)) > 0.02


@pytest.mark.parametrize("state", ["F", "B"])
@pytest.mark.parametrize(
    "law", [nv.NeoHookean(K_e=K, G_e=G / 2, epsilon=1.0), nv.LinearElastic(K_e=K, G_e=G / 2), ROCK], ids=str
)
def test_any_material_bears_its_weight(law, state):
    run = at_rest(law.with_elastic_state(state), density=RHO)
    rest = pressures(at_rest(law, density=RHO, equilibrium=None), 0.5)[0]
    assert np.array(pressures(run, 0.0, 0.5, 1.0)) - rest == pytest.approx(
        [RHO, RHO / 2, 0.0], abs=2e-3 * RHO
    )
    assert speed(run) < 1e-4


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_constants_in_cells_bear_the_weight_with_linear_velocities(solver):
    """With the lowest orders the body stays at rest; without the hydrostatic start it falls."""
    run = at_rest(density=RHO, solver=solver, discretisation=LOWEST)
    assert pressures(run, 0.125, 0.875) == pytest.approx([RHO * 0.875, RHO * 0.125], abs=0.1 * RHO)
    assert speed(run) < 1e-10
    assert speed(at_rest(density=RHO, solver=solver, discretisation=LOWEST, equilibrium=None)) > 0.01


@pytest.mark.parametrize("k", [2, 3])
def test_constants_in_cells_bear_no_weight_with_velocities_of_higher_order(k):
    """The start is refused by name; with m = 1, which the message recommends, at most a hundredth of the
    fall is left."""
    with pytest.raises(
        nv.ParameterError,
        match=rf"Discretisation\.m = 0: expected 1 or 2, or k = 1 with m = 0, .* for velocities of order {k}",
    ):
        at_rest(density=RHO, discretisation=nv.Discretisation(k=k, m=0))
    options = {"density": RHO, "discretisation": nv.Discretisation(k=k, m=1)}
    assert speed(at_rest(**options)) < 0.01 * speed(at_rest(equilibrium=None, **options))


def test_a_body_in_three_dimensions_starts_in_equilibrium():
    mesh = {"cells": (1, 1, 2), "size": (1, 1, 1), "loads": (nv.Gravity((0, 0, -WEIGHT)),)}
    run = at_rest(density=RHO, **mesh)
    p = run.fields["pressure"]
    assert p(run.mesh(0.5, 0.5, 0.0)) == pytest.approx(RHO, rel=3e-3) and speed(run, 1) < 1e-4


def test_the_density_follows_from_the_referential_density():
    """K (1 - J) = p and rho = rho_R/J have the solution J = sqrt(1 - 2 rho_R g s/K)."""
    soft = nv.PerReferentialVolume(
        material=nv.CustomMaterial(
            transported=(nv.physics.variables.Jacobian(),), stored_energy=lambda J: 3.0 * (J - 1) * (J - 1)
        ),
        rho_R=RHO,
    )
    run = at_rest(soft, cells=(2, 8))
    for height in (0.0, 0.5, 1.0):
        exact = np.sqrt(1 - 2 * RHO * WEIGHT * (1 - height) / 6.0)
        assert 1 / run.fields["A"](run.mesh(0.3, height)) == pytest.approx(exact, rel=3e-3)
        assert run.fields["density"](run.mesh(0.3, height)) == pytest.approx(RHO / exact, rel=3e-3)
    assert speed(run) < 2e-3 < 0.02 < speed(at_rest(soft, cells=(2, 8), equilibrium=None))


def test_layers_bodies_and_heat_start_in_equilibrium():
    layered = at_rest(density=IfPos(y - 0.5, 1.0, 3.0))
    assert pressures(layered, 0.0, 0.5) == pytest.approx([2.0, 0.5], rel=1e-3) and speed(layered) < 1e-5
    bodies = [
        nv.Body(
            name="water", where=y - 0.5, material=nv.ReferentialNeoHookean(K_e=20.0, G_e=0.1), density=1.0
        ),
        nv.Body(name="rock", material=ROCK, density=3.0),
    ]
    both = at_rest(model=nv.Model(bodies=bodies, loads=(DOWN,)))
    low, middle = pressures(both, 0.0, 0.5)
    assert low == pytest.approx(2.0, rel=0.04) and middle == pytest.approx(0.5, rel=0.04)
    assert speed(both) < 1e-3
    warm = nv.Thermal(material=ROCK, c=1.0, theta_R=300.0, expansion=1e-3, rho_R=RHO)
    hot = at_rest(warm, temperature=300 + 50 * y)
    top, base = pressures(hot, 1.0, 0.0)
    # the pressure is smaller where matter has expanded
    assert abs(top) < 0.1 and 0.93 * RHO < base < 1.05 * RHO
    assert speed(hot) < 1e-4


def test_the_datum_of_the_pressure_may_be_a_wall_a_point_or_the_top():
    for given, base in (
        ({}, RHO),
        ({"datum_pressure": 0.5}, RHO + 0.5),
        ({"datum": "bottom", "datum_pressure": 0.5}, 0.5),
        ({"datum": "left"}, RHO / 2),
        ({"datum_point": (0.5, 0.75)}, 0.75 * RHO),
    ):
        assert pressures(at_rest(density=RHO, **given), 0.0)[0] == pytest.approx(base, abs=2e-3 * RHO)


AIR = nv.Thermal(c=862.0, gruneisen=0.4, theta_R=293.0, rho_R=1.2)
OF_AIR = 0.4 * 862 * 293 / (1.2 * 9.81)
"""Pressure of the air divided by its weight per volume, m."""


@pytest.mark.parametrize(
    ("material", "height", "weight", "density"),
    [
        (nv.BarotropicFluid(B=2.5, gamma=1.4, rho_R=1.0), 3.0, 1.0, lambda h: (1 - h / 3.5) ** 2.5),
        (AIR, 2e4, 9.81, lambda h: 1.2 * np.exp(-h / OF_AIR)),
    ],
)
def test_a_column_of_gas_of_several_scale_heights_starts_at_rest(material, height, weight, density):
    """At the density of the ground the column would weigh two to three times the pressure of the ground."""
    run = at_rest(
        material,
        cells=(1, 12),
        size=(height / 10, height),
        loads=(nv.Gravity((0.0, -weight)),),
        datum="bottom",
        dt=0.01 * (height / weight) ** 0.5,
    )
    for h in (0.05 * height, 0.5 * height, 0.9 * height):
        assert run.fields["density"](run.mesh(0.0, h)) == pytest.approx(density(h), abs=2e-3 * density(0))
    assert speed(run) < 2e-3 * (height * weight) ** 0.5


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"equilibrium": "isostatic"}, nv.ParameterError, "hydrostatic"),
        ({"datum": "roof"}, nv.UnknownNameError, "roof"),
        ({"datum": (0, 1)}, nv.ParameterError, "datum_point"),
        (
            {"datum": "top", "datum_point": (0, 1)},
            nv.ParameterError,
            "None, since datum is given",
        ),
        ({"datum_point": (0.5, 2.0)}, nv.ParameterError, "datum"),
        ({"datum_pressure": np.nan}, nv.ParameterError, "finite number"),
        ({"datum": "top", "equilibrium": None}, nv.ParameterError, "no such value without equilibrium"),
        ({"F": np.eye(3)}, nv.ParameterError, "F follows from the equilibrium"),
        ({"values": {"J": CF(1.0)}}, nv.ParameterError, "the strain follows from the equilibrium"),
        ({"loads": ()}, nv.ParameterError, "an equilibrium needs a load"),
        ({"density": 100.0}, nv.InitialDataError, "a bulk law that has a J at every pressure"),
        (  # a polytropic atmosphere ends at 3.5 m
            {
                "material": nv.BarotropicFluid(B=2.5, gamma=1.4, rho_R=1.0),
                "size": (1, 4),
                "datum": "bottom",
                "density": None,
            },
            nv.InitialDataError,
            "a bulk law that has a J at every pressure",
        ),
    ],
)
def test_a_start_without_an_equilibrium_is_refused(given, error, said):
    with pytest.raises(error, match=said):
        at_rest(**{"density": RHO} | given)


def test_a_density_that_varies_along_levels_is_warned_of():
    with pytest.warns(InputWarning, match="balanced by no pressure, .* along level surfaces"):
        at_rest(density=1 + x)


def test_loads_along_a_periodic_direction_are_warned_of():
    with pytest.warns(InputWarning, match="balanced by no pressure, .* around the periodic domain"):
        at_rest(periodic="xy")


# --- laws that read a pressure -----------------------------------------------------------------------

FRICTION = nv.DruckerPrager(cohesion=0.05, friction_angle=30.0, G_m=1.0)


def frictional(**given):
    model = nv.Model(material=ROCK, viscosity=VISCOUS, creep=FRICTION, loads=(DOWN,))
    return at_rest(model=model, density=RHO, **given)


def test_a_negative_pressure_that_a_law_reads_is_warned_of_once_with_the_remedy():
    assert readers(frictional().model) == ["DruckerPrager"] and readers(at_rest(density=RHO).model) == []
    run = frictional(equilibrium=None)
    assert any(
        "DruckerPrager reads the pressure" in line and "hydrostatic" in line for line in scales(run).advice
    )
    with pytest.warns(InputWarning, match='DruckerPrager reads a negative pressure.*"hydrostatic"') as said:
        run.run(0.2)
    assert len([one for one in said if "negative pressure" in str(one.message)]) == 1


def test_a_start_in_equilibrium_brings_no_warning_of_tension():
    run = frictional()
    assert not any("pressure" in line for line in scales(run).advice)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ledger = run.run(0.2)
    assert ledger.column("v_max").max() < 1e-5 and run.sampler.extrema(run.fields["pressure"])[0] > -5e-3


def test_a_case_file_starts_a_run_in_hydrostatic_equilibrium(tmp_path):
    (tmp_path / "rock.toml").write_text("""
domain = { geometry = "box", size = ["10 km", "10 km"], maxh = "5 km" }
material = { kind = "ReferentialNeoHookean", K_e = "50 GPa", G_e = "15 GPa" }
initial = { density = 2700, equilibrium = "hydrostatic", datum = "top", datum_pressure = "1 bar" }
loads = [{ kind = "Gravity", g = [0, -9.81] }]
time = { dt = 1, until = 2 }
""")
    case = nv.load_case(tmp_path / "rock.toml")
    run = case.simulation(case.mesh())
    p = run.fields["pressure"]
    assert p(run.mesh(5e3, 0)) == pytest.approx(2700 * 9.81e4 + 1e5, rel=1e-3)
    assert p(run.mesh(5e3, 1e4)) == pytest.approx(1e5, abs=3e5)


@pytest.mark.parametrize(("datum", "given"), [(0.0, 0.5), (0.5, 0.0), (0.5, 0.5)])
def test_a_datum_that_contradicts_the_pressure_of_its_open_wall_is_warned_of(datum, given):
    def start():
        nv.Simulation(
            structured_box((1, 1), (2, 4)),
            nv.Model(material=ROCK, viscosity=VISCOUS, loads=[DOWN]),
            dt=0.05,
            initial=nv.Initial(density=RHO, equilibrium="hydrostatic", datum="top", datum_pressure=datum),
            walls={"top": nv.Open(pressure=given)},
        )

    if datum == given:
        return start()
    with pytest.warns(
        InputWarning, match=rf"datum_pressure gives .* Pa at the start on the wall 'top', .* {given:g} Pa"
    ):
        start()
