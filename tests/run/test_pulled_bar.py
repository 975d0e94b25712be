"""A bar that is pulled at both ends by one traction, through walls that matter crosses, stays where it is."""

from itertools import product

import pytest
from ngsolve import Integrate

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.run.momentum import column

MATERIALS = {
    "E": nv.LinearElastic(K_e=10.0, G_e=5.0),
    "F": nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, elastic_state="F"),
    "B": nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, elastic_state="B"),
}
SCHEMES = ("backward-euler", "midpoint", "sdirk2")
PULL = 0.5

QUICK = {("E", "sdirk2", "split", 2), ("F", "midpoint", "coupled", 2), ("B", "backward-euler", "split", 2)}
OF_CI = {(kind, scheme, "split", 3) for kind, scheme in zip("EFB", SCHEMES, strict=True)}


def _marked(run):
    marks = [] if run in QUICK else [pytest.mark.long]
    return pytest.param(*run, marks=[*marks, pytest.mark.ci] if run in OF_CI else marks)


def pulled(mesh, kind, scheme, solver):
    """The momentum along the bar after six steps, and without what matter took along through its ends, of the
    impulse of sound, traction x area x length/c."""
    run = nv.Simulation(
        mesh,
        nv.Model(material=MATERIALS[kind], viscosity=nv.StokesViscosity(K_v=0.3, G_v=0.3)),
        time=nv.TimeSteps(dt=0.05, scheme=scheme),
        walls={("left", "right"): nv.Open(pressure=-PULL, backflow=False)},
        initial=nv.Initial(density=1.0),
        solver=solver,
    )
    ledger = run.run(0.3)
    assert abs(ledger.column("closure_relative")).max() <= 1e-11
    impulse = PULL * Integrate(1.0, mesh) / (10 + 4 / 3 * 5) ** 0.5
    momentum = Integrate(run.fields["density"] * run.fields["velocity"][0], mesh, order=9)
    motion = next(iter(ledger.momentum.motions))
    taken = [ledger.column(column(f"impulse_carried_{end}", motion))[1:].sum() for end in ("left", "right")]
    assert min(taken[0], -taken[1]) > 1e-3 * impulse  # the ends swell out
    return abs(momentum) / impulse, abs(momentum - sum(taken)) / impulse


@pytest.mark.parametrize(
    ("kind", "scheme", "solver", "dim"),
    [_marked(run) for run in product(MATERIALS, SCHEMES, ("split", "coupled"), (2, 3))],
)
def test_a_bar_that_is_pulled_at_both_ends_has_no_momentum(kind, scheme, solver, dim):
    """On a mesh that is its own mirror image none, on others what matter takes along through the ends."""
    of_mirrored = structured_box((1, 0.55), (2, 1)) if dim == 2 else None
    if of_mirrored is not None:
        assert pulled(of_mirrored, kind, scheme, solver)[0] <= 1e-8
    mesh = box((1, 0.55, 0.5)[:dim], 0.4 if dim == 2 else 0.9)
    whole, without = pulled(mesh, kind, scheme, solver)
    assert without <= 1e-8 and whole <= 1e-3
