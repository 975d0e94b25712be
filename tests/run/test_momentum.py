"""An unloaded body in a periodic box keeps its momentum, whatever jumps it carries."""

from itertools import product

import numpy as np
import pytest
from ngsolve import CF, IfPos, Integrate, Norm, exp, pi, sin, sqrt, x, y
from support import others_by_ci

import ngvisco as nv
from ngvisco.forms.terms.momentum import MomentumBalance
from ngvisco.forms.terms.tangents import TangentForce, TangentGap
from ngvisco.geometries import structured_box

VISCOUS = nv.StokesViscosity(K_v=0.05, G_v=0.05)
K_E = 10.0
"""Pa; with the density 1 kg/m^3 a wave has about 5 m/s."""
SCHEMES = ("backward-euler", "midpoint", "sdirk2")


def band(f):
    """A function of x that is 1 in the middle of [0, 1], and 0 elsewhere."""
    return IfPos(f - 0.25, IfPos(0.75 - f, 1.0, 0.0), 0.0)


def tensor(first, rest=0.0):
    return CF((first, 0, 0, 0, rest, 0, 0, 0, rest), dims=(3, 3))


LINEAR = nv.LinearElastic(K_e=K_E, G_e=K_E)
STRAIN = {"values": {"E": tensor(0.2 * band(x) * band(y))}}
STRETCH = {"F": tensor(1 + 0.3 * band(x) * band(y), 1.0)}
CRACK = {"values": {"damage": exp(-sqrt((x - 0.5) ** 2) / 0.1)}}
BROKEN = nv.Damaged(material=LINEAR, G_c=0.1, length=0.1)
STATES = {
    "quadratic": (LINEAR, STRAIN, 2e-13),
    "neo-Hookean, B": (nv.ReferentialNeoHookean(K_e=K_E, G_e=K_E), STRETCH, 2e-12),
    "neo-Hookean, F": (nv.NeoHookean(K_e=K_E, G_e=K_E, epsilon=0.1, elastic_state="F"), STRETCH, 2e-12),
    "stiffness 2 : 100": (nv.LinearElastic(K_e=2 + 98 * band(x), G_e=2 + 98 * band(x)), STRAIN, 1e-6),
    "cracked": (BROKEN, CRACK, 1e-6),
    "hardening band": (LINEAR, {"values": {"plastic_content": 0.5 * band(x)}}, 2e-13),
    "hot": (nv.Thermal(material=nv.ReferentialNeoHookean(K_e=K_E, G_e=5.0), c=1.0, theta_R=300.0), {}, 1e-13),
}
"""Material, start, and the admitted change of the momentum, relative to the whole momentum and to the impulse
of sound."""


def thrown(name, m=1, v=(0.05, 0.02), dim=2, **options):
    """A run of a body that is thrown with a jump, and its relative change of momentum."""
    material, start, _ = STATES[name]
    start = dict(start)
    if name == "hot":
        start["temperature"] = 300 + 30 * band(x)
        options["model"] = {"heat": nv.Heat(conductivity=0.0)}
    if name == "hardening band":
        options["model"] = {"creep": nv.Perzyna(sigma_Y=0.5, G_m=0.5, H=10.0)}
    cells = (4, 4) if dim == 2 else (3, 2, 2)
    mesh = structured_box((1.0,) * dim, cells, periodic="xyz"[:dim])
    model = nv.Model(material=material, viscosity=VISCOUS, **options.pop("model", {}))
    velocity = CF((*v, 0.0)[:dim]) + CF((0.1 * sin(2 * pi * x), 0.0, 0.0)[:dim])
    initial = nv.Initial(density=1.0, velocity=velocity, **start)
    run = nv.Simulation(
        mesh, model, dt=0.02, initial=initial, discretisation=nv.Discretisation(m=m), **options
    )
    now, before = run.rothe_step.now, momentum(run)
    scale = Integrate(now.rho * (Norm(now.v) + sqrt(2 * K_E)), mesh, order=6)
    run.run(0.06)
    return run, abs(momentum(run) - before).max() / scale


def momentum(run):
    now = run.rothe_step.now
    return np.array(Integrate(now.rho * now.v, run.mesh, order=8))


@pytest.mark.filterwarnings("ignore:.*a carried modulus jumps")
@pytest.mark.parametrize(
    ("name", "solver"),
    others_by_ci(product(STATES, ("split", "coupled")), *product(STATES, ["split"])),
)
def test_a_jump_of_the_state_does_not_move_the_body(name, solver):
    run, change = thrown(name, solver=solver)
    assert change <= STATES[name][2]
    assert abs(run.ledger.column("closure_relative")).max() <= 1e-10


@pytest.mark.parametrize(("name", "scheme"), list(product(["quadratic", "neo-Hookean, B"], SCHEMES)))
def test_every_scheme_keeps_momentum(name, scheme):
    assert thrown(name, scheme=scheme, solver="split")[1] <= STATES[name][2]


@pytest.mark.filterwarnings("ignore:.*a carried modulus jumps")
@pytest.mark.parametrize("name", ["quadratic", "neo-Hookean, B", "neo-Hookean, F", "stiffness 2 : 100"])
def test_constants_in_cells_keep_momentum_to_rounding(name):
    """With constants in cells, zeta equals phi'(z), and the weight of the momentum balance equals that of the
    Bregman distances."""
    run, change = thrown(name, m=0, solver="split")
    assert change <= 1e-12
    if "stiffness" not in name:  # the energy is convex
        assert run.ledger.column("dissipation_upwinding")[1:].min() > 0


@pytest.mark.parametrize("name", ["quadratic", "neo-Hookean, B"])
def test_momentum_is_conserved_in_three_dimensions(name):
    assert thrown(name, dim=3, solver="split")[1] <= 1e-10  # the tolerance of GMRES causes this error


@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_a_cracked_body_at_rest_stays_where_it_is(solver):
    """In an earlier scheme the body flew off at 0.2 m/s within half a second, although the ledger closed."""
    _, start, _ = STATES["cracked"]
    mesh = structured_box((1, 0.25), (4, 1), periodic="xy")
    model = nv.Model(material=BROKEN, viscosity=VISCOUS)
    run = nv.Simulation(mesh, model, dt=0.02, initial=nv.Initial(density=1.0, **start), solver=solver)
    run.run(0.06)
    assert abs(momentum(run)).max() <= 1e-12
    assert 0.1 < run.ledger.column("stored_surface")[-1] / run.ledger.column("stored_surface")[0] < 1


def nothing(self, u, w):
    return []


def test_momentum_is_lost_without_the_balance_of_inertia(monkeypatch):
    """A negative control."""
    monkeypatch.setattr(MomentumBalance, "cells", nothing)
    monkeypatch.setattr(MomentumBalance, "facets", nothing)
    assert thrown("quadratic", solver="coupled")[1] > 1e-9


def test_momentum_is_lost_with_a_nonquadratic_energy_without_its_facet_correction(monkeypatch):
    """A negative control, in which the ledger closes."""
    monkeypatch.setattr(TangentForce, "excess", lambda self, u: 0.0 * u.parts[TangentGap.name])
    assert thrown("neo-Hookean, B", solver="coupled")[1] > 1e-7
