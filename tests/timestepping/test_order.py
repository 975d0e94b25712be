"""Second order in time of v, rho and z: all materials, loads and lids that change in time, passive fields.

One mesh, steps tau, tau/2, tau/4: successive differences fall by 4.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from ngsolve import cos, sin, x, y
from support import EXAMPLES, by_ci, evolved, swirling
from test_ledger_of_schemes import ALL_TERMS

import ngvisco as nv
from ngvisco.geometries import disc


def run_to(until, steps, scheme, mesh=0.5, **options):
    """Run by the coupled solver, which takes less time on few straight cells. Both solvers have the same
    results."""
    settings = {
        "viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1),
        "hyperviscosity": nv.HyperViscosity(mu=1e-4, p=4),
        "creep": nv.Creep(G_m=2.0),
        "loads": [nv.Gravity((0.0, -cos(20 * nv.time)))],
        "solver": "coupled",
    }
    run = swirling(mesh, dt=until / steps, scheme=scheme, **(settings | options))
    run.run(until)
    return run


def rates(values):
    """Rates of the differences of successive solutions, each with half the step."""
    differences = [{name: np.linalg.norm(a[name] - b[name]) for name in a} for a, b in pairwise(values)]
    return [{name: math.log2(a[name] / b[name]) for name in a} for a, b in pairwise(differences)]


def in_time(scheme, until=0.02, steps=(2, 4, 8), of=evolved, **options):
    return rates([of(run_to(until, n, scheme, **options)) for n in steps])[-1]


STIFFER = {"CustomMaterial": 0.01}
"""Shorter runs, with shorter steps."""


MARKS = {"LinearElastic": ()} | dict.fromkeys(
    ["NeoHookean", "OldroydB", "BarotropicFluid", "CustomMaterial"], (pytest.mark.long, pytest.mark.ci)
)
"""Materials of every kind of variable: E; F with J; B with J; J alone; and a user's energy."""


BY_MATERIAL = [
    pytest.param(scheme, name, marks=marks.get(name, pytest.mark.long))
    for scheme, marks in (("midpoint", MARKS), ("sdirk2", {"NeoHookean": ()}))
    for name in EXAMPLES
]


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize(("scheme", "name"), BY_MATERIAL)
def test_runs_are_of_second_order_for_every_material(scheme, name):
    found = in_time(scheme, STIFFER.get(name, 0.02), material=EXAMPLES[name])
    assert min(found.values()) >= 1.9, found


@pytest.mark.long
@pytest.mark.ci
def test_backward_euler_is_of_first_order():
    found = in_time("backward-euler", 0.04, (4, 8, 16))
    assert max(found.values()) <= 1.2 and min(found.values()) >= 0.75, found


AT_REST = {"initial": nv.Initial(), "loads": []}
LID = {"top": nv.PrescribedTangential((16 * x**2 * (1 - x) ** 2 * sin(10 * nv.time) ** 2, 0.0))}
TURNED = {"wall": nv.Traction(f=(-y * sin(20 * nv.time), x * sin(20 * nv.time)), friction=0.1)}
SETTINGS = {
    "all terms": {"until": 0.01, "regularisation": ALL_TERMS},
    "a lid that is accelerated": {"until": 0.05, "steps": (4, 8, 16), "walls": LID, **AT_REST},
    "traction on a curved slip wall": {"until": 0.04, "steps": (4, 8, 16), "walls": TURNED, **AT_REST},
}
CURVED = "traction on a curved slip wall"


@pytest.mark.parametrize(
    ("name", "scheme"),
    [
        *(by_ci(name, "midpoint") for name in SETTINGS),
        *(pytest.param(name, "sdirk2", marks=pytest.mark.long) for name in SETTINGS),
    ],
)
def test_runs_are_of_second_order_with_further_terms(name, scheme):
    curved = {"mesh": disc(1, 0.8), "solver": "split"} if name == CURVED else {}
    found = in_time(scheme, **SETTINGS[name], **curved)
    assert min(found.values()) >= 1.9, found


def passive(run):
    return run.passive.arrays()


@pytest.mark.long
@pytest.mark.parametrize("scheme", [pytest.param("midpoint", marks=pytest.mark.ci), "sdirk2"])
def test_passive_fields_converge_with_the_order_of_the_scheme(scheme):
    found = in_time(scheme, of=passive, passive=("F_tot", "reference_map", "creep_strain"))
    assert min(found.values()) >= 1.9, found
    first = in_time("backward-euler", of=passive, passive=("F_tot",))
    assert max(first.values()) <= 1.3


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("startup", [1, 2])
def test_a_few_euler_steps_at_the_start_keep_the_order(startup):
    found = in_time("midpoint", 0.04, (4, 8, 16), startup=startup)
    assert min(found.values()) >= 1.8, found
