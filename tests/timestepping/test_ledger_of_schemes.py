"""The energy identity of every scheme, to rounding: all walls, mechanisms, materials, both solvers."""

from itertools import product

import pytest
import support
from ngsolve import CF, x
from support import EXAMPLES, SWIRL, assert_balanced, swirling

import ngvisco as nv
from ngvisco.geometries import block_with_hole, box, half_disc
from ngvisco.timestepping.scheme import TimeScheme

NEO_HOOKEAN = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
SECOND_ORDER = ("midpoint", "sdirk2")
BY_DEFAULT = {
    **dict.fromkeys(["LinearElastic", "OldroydB", "ReferentialMooneyRivlin", "BarotropicFluid"], "midpoint"),
    **dict.fromkeys(["NeoHookean", 'ReferentialMooneyRivlin(elastic_state="B")'], "sdirk2"),
}.items()
"""Materials of every kind of variable."""


def simulation(mesh=0.5, **options):
    dim = getattr(mesh, "dim", 2)
    settings = {
        "viscosity": nv.StokesViscosity(K_v=0.05, G_v=0.05),
        "hyperviscosity": nv.HyperViscosity(mu=1e-5, p=4),
        "creep": nv.Creep(G_m=5.0),
        "loads": [nv.Gravity((0.0,) * (dim - 1) + (-1.0 - 5 * nv.time,))],
        "initial": nv.Initial(density=1 + 0.2 * x, velocity=(*SWIRL, CF(0))[:dim]),
        "scheme": "midpoint",
    }
    return swirling(mesh, **(settings | options))


def closes(run, until=0.06, bound=1e-12):
    ledger = run.run(until)
    assert_balanced(ledger, bound, 1e-13)
    return ledger


WALLS = {
    "curved slip walls": (lambda: block_with_hole((1, 1), 0.25, 1), {}, nv.Initial(velocity=(0.5, 0.3)), ()),
    "accelerated wall that meets a curved slip wall": (
        lambda: half_disc(1, 0.7),
        {"axis": nv.PrescribedTangential((0.0, nv.time))},
        nv.Initial(),
        (),
    ),
    **support.WALLS,
}
WALLS_BY_DEFAULT = (
    ("accelerated rotating wall", "midpoint", "coupled"),
    ("accelerated lid", "sdirk2", "split"),
    ("accelerated wall that meets a curved slip wall", "midpoint", "coupled"),
    ("traction with friction", "midpoint", "split"),
)
"""Walls and tractions of the default suite. Their data change in time, because schemes differ in the means
over time that they take. CI tries all walls and tractions."""


@pytest.mark.parametrize(
    ("name", "scheme", "solver"),
    [
        pytest.param(*case, marks=() if case in WALLS_BY_DEFAULT else [pytest.mark.long, pytest.mark.ci])
        for case in product(WALLS, SECOND_ORDER, ("split", "coupled"))
    ],
)
def test_ledger_closes_with_every_wall(name, scheme, solver):
    mesh, walls, initial, loads = WALLS[name]
    run = simulation(mesh(), scheme=scheme, solver=solver, initial=initial, walls=walls, loads=loads)
    closes(run, until=0.04)


@pytest.mark.parametrize(
    ("name", "scheme"),
    [
        pytest.param(name, scheme, marks=() if (name, scheme) in BY_DEFAULT else pytest.mark.long)
        for name, scheme in product(EXAMPLES, SECOND_ORDER)
    ],
)
def test_ledger_closes_with_every_material(name, scheme):
    run = simulation(material=EXAMPLES[name], scheme=scheme, solver="coupled")
    closes(run, until=0.04, bound=1e-10)


ALL_TERMS = nv.Regularisation(delta_density=1e-3, delta_fields=1e-2, epsilon=0.1, rho_max=1.1)


@pytest.mark.parametrize(
    ("scheme", "solver"),
    [
        ("midpoint", "split"),
        ("sdirk2", "coupled"),
        support.by_ci("theta", "split"),
        pytest.param("midpoint", "coupled", marks=pytest.mark.long),
        pytest.param("sdirk2", "split", marks=pytest.mark.long),
    ],
)
def test_ledger_closes_with_all_terms(scheme, solver):
    """The model has the terms of delta, epsilon, the cut-off and creep with a gradient; the cut-off acts."""
    options = {"theta": 0.6} if scheme == "theta" else {}
    creep = nv.Creep(G_m=5.0, nu=1e-3, q=4)
    run = simulation(scheme=scheme, solver=solver, creep=creep, regularisation=ALL_TERMS, **options)
    ledger = closes(run)
    assert ledger.column("cutoff_volume").max() > 0
    for name in ("dissipation_creep", "dissipation_creep_gradient", "dissipation_epsilon"):
        assert ledger.column(name).max() > 0


_DIAGONAL = (3 + 3**0.5) / 6
OF_ONES_OWN = {
    # the scheme of Crouzeix, of order three, is neither one-leg nor stiffly accurate
    "Crouzeix": TimeScheme("crouzeix", ((_DIAGONAL, 0.0), (1 - 2 * _DIAGONAL, _DIAGONAL)), (0.5, 0.5)),
    # two Rothe steps end at one time: their solutions give no rate, and the run does not extrapolate them
    "twins": TimeScheme("twins", ((0.5, 0.0), (0.0, 0.5)), (0.5, 0.5)),
}
YOSIDA = {"material": nv.Yosida(material=NEO_HOOKEAN, eps=1e-3), "solver": "coupled"}
IN_SPACE = {"mesh": box((1, 1, 1), maxh=2), "until": 0.02}


@pytest.mark.parametrize(
    ("scheme", "options"),
    [
        pytest.param("midpoint", YOSIDA, id="Yosida, midpoint"),
        support.by_ci("sdirk2", YOSIDA, id="Yosida, sdirk2"),
        pytest.param("midpoint", IN_SPACE, id="in space, midpoint"),
        pytest.param("sdirk2", IN_SPACE, marks=pytest.mark.long, id="in space, sdirk2"),
        *(pytest.param(scheme, {"solver": "split"}, id=name) for name, scheme in OF_ONES_OWN.items()),
    ],
)
def test_ledger_closes_for_yosida_energies_in_three_dimensions_and_for_a_user_s_tableau(scheme, options):
    """The runs are one with a Yosida approximation, one in three dimensions, and those with a user's
    tableaux."""
    options = {"until": 0.04} | options
    until = options.pop("until")
    closes(simulation(scheme=scheme, **options), until)


@pytest.mark.parametrize("scheme", support.others_by_ci(SECOND_ORDER, "midpoint"))
def test_solvers_agree_for_every_scheme(scheme):
    support.by_both_solvers(lambda solver: simulation(scheme=scheme, solver=solver), 0.06)
