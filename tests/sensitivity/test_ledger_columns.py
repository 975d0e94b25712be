"""Derivatives of further columns of the ledger: exchanges in a step, defects, extrema."""

from functools import partial
from itertools import product

import numpy as np
import pytest
from differentiated import AT, UNTIL, VELOCITY, run
from ngsolve import CF, x, y
from support import by_ci, others_by_ci
from test_adjoint import between, curved, directional, smooth
from test_models import heated

import ngvisco as nv
from ngvisco.geometries import block_with_hole, half_disc
from ngvisco.sensitivity.distance_slopes import DistanceSlopes
from tests.verification.cases.sensitivities import measure

EXTREMA = ("rho_min", "rho_max", "J_min", "v_max", "creep_power_min", "eigenvalue_min_B")
DEFECTS = ("defect_max", "defect_rms")
ENERGY, MOMENTUM = ("stored", "inertial", "bregman"), ("impulse_walls_2", "impulse_gravity_2")
MOMENTA = (
    *("impulse_walls_1", "angular_impulse_walls", "angular_impulse_gravity"),
    *("angular_defect_facets", "defect_cells_1", "angular_defect_inertia", "momentum_defect_2"),
    *("angular_momentum_defect", "angular_defect_cells"),
)
NAMES = (*ENERGY, *MOMENTUM, *MOMENTA, *EXTREMA, *DEFECTS)
SCHEMES = [
    ("backward-euler", "coupled"),
    by_ci("backward-euler", "split"),
    by_ci("midpoint", "coupled"),
    by_ci("midpoint", "split"),
    by_ci("sdirk2", "coupled"),
    ("sdirk2", "split"),
]


def of(names=NAMES):
    """Names of each column's value at the end, and of its integral or sum until the middle of the last
    step."""
    return {f"{name} {when}": f"{name} {when}" for name in names for when in ("at 0.06", "until 0.05")}


HEAT = ("power_heat_dissipated", "power_heat_numerical")
PRODUCTIONS = ("stokes_bulk", "stokes_shear", "upwinding", "conduction", "numerical")
PRODUCTIONS = tuple(f"entropy_production_{name}" for name in PRODUCTIONS)


def relative(found, exact, names):
    """Differences of derivatives, relative to the largest derivative of a column of the same kind: energies,
    momenta, powers, productions."""
    sizes = []
    for name, value in zip(names, exact, strict=True):
        column, when = name.split(" ", 1)
        kind = next((k for k in (ENERGY, (*MOMENTUM, *MOMENTA), HEAT, PRODUCTIONS) if column in k), (column,))
        beside = [abs(v) for n, v in zip(names, exact, strict=True) if n in [f"{c} {when}" for c in kind]]
        sizes.append(max(beside) if beside else abs(value))
    return abs(found - exact) / np.array(sizes)


STRETCHED = CF((1.6 + 0.1 * x, 0.2, 0, 0.2, 0.9 - 0.05 * y, 0, 0, 0, 0.62), dims=(3, 3))
"""Start values of B with different eigenvalues and det B = 0.87. At B = I, the least eigenvalue and the norm
of det B - 1 have kinks. The distance of the start from the kinks must exceed the spacing of the tangent's
differences."""


@pytest.mark.parametrize(("scheme", "solver"), SCHEMES)
def test_products_of_tangent_and_adjoint_are_equal(scheme, solver):
    start = nv.Initial(density=1.0, velocity=VELOCITY, values={"B": STRETCHED})
    make = partial(run, solver=solver, initial=start)
    by_tangent, by_adjoint = directional(make, scheme, of(), 0.07)
    assert relative(by_adjoint, by_tangent, of()).max() < 1e-10


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize(
    ("scheme", "solver"),
    [by_ci("backward-euler", "coupled"), ("backward-euler", "split"), by_ci("midpoint", "coupled")],
)
def test_products_of_tangent_and_adjoint_are_equal_for_columns_of_heat(scheme, solver):
    """The scheme's heat is a difference of energies of 600 J. Rounding and the spacing of differences leave a
    relative error of 2e-9."""
    by_scheme = scheme == "backward-euler"
    own = (*ENERGY, "entropy", *HEAT, *PRODUCTIONS, "temperature_min", "temperature_max")
    numbers = of([name for name in own if by_scheme or not name.endswith("numerical")])
    make = partial(heated, 1e-3, by_scheme=by_scheme, solver=solver)
    by_tangent, by_adjoint = directional(make, scheme, numbers, 0.1)
    bounds = [1e-8 if name.startswith("power_heat_numerical") else 1e-10 for name in numbers]
    assert (relative(by_adjoint, by_tangent, numbers) < bounds).all()


WIDTHS = (1e-2, 1e-3)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize(
    ("scheme", "solver"),
    others_by_ci(
        product(("backward-euler", "midpoint", "sdirk2"), ("coupled", "split")), ("sdirk2", "split")
    ),
)
def test_derivatives_are_limits_of_central_differences(scheme, solver):
    make, name = partial(run, scheme=scheme, solver=solver), "material.G_e"
    found = nv.gradient(make(), UNTIL, of=of(), by=[name], method="adjoint").jacobian[:, 0]
    errors = []
    for width in WIDTHS:
        up, down = (measure(make(AT | {name: 5.0 * (1 + s * width)}), UNTIL, of()) for s in (1, -1))
        errors.append(relative((up - down) / (10 * width), found, of()))
    errors = np.array(errors)
    assert errors.min(axis=0).max() < 1e-6
    assert errors[0].max() > 20 * errors[1].max()


def test_values_equal_those_of_the_run():
    simulation = run()
    found = nv.gradient(simulation, UNTIL, of=of(), by=["creep.G_m"])
    ledger = simulation.ledger
    for name in NAMES:
        column = ledger.column(name)
        value = found.values[found.of.index(f"{name} at 0.06")]
        assert value == pytest.approx(column[-1], rel=1e-7, abs=1e-13)
        if name in (*MOMENTUM, *MOMENTA, "inertial", "bregman"):
            total = found.values[found.of.index(f"{name} until 0.05")]
            assert total == pytest.approx(column[1:3].sum() + 0.5 * column[3], rel=1e-7, abs=1e-13)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("scheme", ["midpoint", by_ci("backward-euler")])
def test_columns_of_energies_without_an_expression_have_derivatives(scheme):
    """Dissipation and defects read values of such an energy at points, and its projection."""
    names = ("stored", "bregman", "impulse_walls_1", "angular_defect_facets", "angular_defect_cells")
    numbers, given = of(names), {"of": of(names), "by": ["material.G_e"]}
    tangent, adjoint = (
        nv.gradient(smooth(5.0, scheme=scheme), UNTIL, method=method, **given).jacobian[:, 0]
        for method in ("tangent", "adjoint")
    )
    assert relative(adjoint, tangent, numbers).max() < 1e-6  # the symmetric swirl's momenta are tiny


WALLS = ("impulse_walls_1", "angular_impulse_walls", "momentum_defect_1", "angular_momentum_defect")
OPEN = (
    "impulse_springs_bottom_1",
    "impulse_carried_bottom_2",
    "impulse_friction_left_2",
    "bregman",
    "stored",
)


@pytest.mark.parametrize(
    ("make", "columns", "options", "least"),
    [
        # a swirl in a disc, whose momentum and its derivatives are tiny
        (curved, (*WALLS, "angular_defect_cells"), {"observers": []}, 0.1),
        by_ci(between, (*WALLS, *OPEN), {"solver": "split", "scheme": "sdirk2"}, 1e-3),
        (between, (*WALLS, *OPEN), {}, 1e-3),
    ],
)
def test_adjoint_and_tangent_agree_for_impulses_of_walls(make, columns, options, least):
    """The walls have multipliers, or move, or matter crosses them, with springs and friction."""
    numbers = of(columns)
    given = {"of": numbers, "by": ["material.G_e"]}
    tangent, adjoint = (
        nv.gradient(make(5.0, **options), UNTIL, method=method, **given).jacobian[:, 0]
        for method in ("tangent", "adjoint")
    )
    sizes = np.maximum(abs(tangent), least * abs(tangent).max())  # a defect is a sum of larger impulses
    # impulses are rounded to 2e-16, an error of 4e-13 over the spacing 5e-4; the least slopes are 3e-6
    assert (abs(adjoint - tangent) / sizes).max() < 1e-6


def test_the_slope_of_a_bregman_distance_without_one_of_its_states_is_wrong(monkeypatch):
    """A negative control: only one of the states of B(a, b) changes."""
    numbers = of(("inertial", "bregman"))
    whole = DistanceSlopes.__call__
    by_tangent, _ = directional(run, "midpoint", numbers, 0.1)
    monkeypatch.setattr(DistanceSlopes, "__call__", lambda *given: (0 * given[2], whole(*given)[1]))
    _, cut = directional(run, "midpoint", numbers, 0.1)
    assert abs(cut / by_tangent - 1).min() > 1e-2


@pytest.mark.parametrize("method", ["tangent", "adjoint"])
@pytest.mark.parametrize(
    ("column", "said"),
    [
        ("newton_iterations", "this column is a count"),
        ("closure", "this column measures rounding"),
        ("limiter", "treat the limiter's changes as constant"),
        ("dt", "treat the lengths of steps as constant"),
        ("momentum_size", "kinks where matter comes to rest"),
        ("momentum_defect_relative", "the largest values of all steps"),
    ],
)
def test_columns_without_a_derivative_are_refused_with_the_reason(method, column, said):
    with pytest.raises(nv.ParameterError, match=said):
        nv.gradient(run(), UNTIL, of=[f"{column} at 0.06"], by=["creep.G_m"], method=method)


@pytest.mark.parametrize("scheme", ["midpoint", "backward-euler"])
def test_the_power_of_a_wall_beside_a_curved_wall_has_a_derivative_if_a_stage_ends_the_step(scheme):
    simulation = nv.Simulation(
        half_disc(1, 0.7),
        nv.Model(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)),
        time=nv.TimeSteps(dt=0.02, scheme=scheme),
        walls={"axis": nv.PrescribedTangential((0.0, nv.time))},
        initial=nv.Initial(density=1.0),
    )
    derivative = partial(nv.gradient, simulation, 0.02, of=["power_wall_axis at 0.02"], by=["material.G_e"])
    if scheme == "midpoint":
        with pytest.raises(nv.ParameterError, match=r"power_wall_axis.*oblique and curved walls"):
            derivative()
    else:
        assert derivative().values[0] == simulation.run(0.02).column("power_wall_axis")[-1]


def test_the_power_of_a_wall_away_from_a_curved_wall_has_a_derivative_in_every_scheme():
    simulation = nv.Simulation(
        block_with_hole((1, 1), 0.25, 1),
        nv.Model(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)),
        time=nv.TimeSteps(dt=0.02, scheme="midpoint"),
        walls={"top": nv.PrescribedTangential((nv.time, 0.0))},
        initial=nv.Initial(density=1.0),
    )
    found = nv.gradient(simulation, 0.02, of=["power_wall_top at 0.02"], by=["material.G_e"])
    assert found.values[0] == pytest.approx(simulation.run(0.02).column("power_wall_top")[-1], rel=1e-9)


@pytest.mark.parametrize("method", ["tangent", "adjoint"])
def test_a_name_that_two_columns_have_is_refused(method):
    """Without an error, the column of the table would silently take the place of the ledger's column."""
    simulation = run(observers=[nv.Integrals({"kinetic": "density"})])
    with pytest.raises(nv.ParameterError, match="the name of one column, but 2 columns have it"):
        nv.gradient(simulation, UNTIL, of=["kinetic at 0.06"], by=["creep.G_m"], method=method)
