"""Bodies at rest without loads: nothing moves, and no ledger is called open for an energy of zero."""

from dataclasses import fields, replace

import numpy as np
import pytest
from materials import examples
from ngsolve import CF, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.forms.terms.momentum import Stokes
from ngvisco.geometries import box
from ngvisco.run.ledger import Ledger

MODULI = {"K_e": 7.3, "G_e": 0.37}
"""Of which 1 + 1/3 and their like are not numbers of the machine: zero at rest only to rounding."""
VISCOSITY = nv.StokesViscosity(K_v=0.1, G_v=0.1)
NEAR_ZERO = ("LinearElastic", "HardeningElastic", "IsotropicStrainEnergy", "OldroydB", "FENEP", "NeoHookean")
"""Materials whose energy at rest is zero, and one whose is not; the others close like it."""
OLDROYD_B = nv.OldroydB(**MODULI)


def materials():
    for example in examples():
        own = {f.name for f in fields(example.material)}
        changed = {name: value for name, value in MODULI.items() if name in own}
        marks = [] if example.constructor in NEAR_ZERO else [pytest.mark.long]
        yield pytest.param(replace(example.material, **changed), id=example.constructor, marks=marks)


def run_of(model: nv.Model, **options) -> nv.Simulation:
    return nv.Simulation(box((1.3, 0.7), 0.7), model, dt=0.1, **options)


def require_rest(run: nv.Simulation) -> None:
    """A warning is an error here, so that the run itself is the test; nothing moves but by rounding."""
    ledger = run.run(0.2)
    assert not run.ledger.unclosed
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-8
    assert ledger.column("v_max").max() <= 1e-12


@pytest.mark.parametrize("material", list(materials()))
def test_a_body_at_rest_closes(material):
    """Before: closure 5e-33 J over an energy of 0 J, called 2.0 and not to be trusted (OldroydB)."""
    model = nv.Model(material=material, viscosity=VISCOSITY)
    require_rest(run_of(model, initial=nv.Initial(density=2.3 + x), solver="coupled"))


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_bodies_at_rest_close(solver):
    disc = nv.Body(
        name="disc",
        material=nv.ReferentialNeoHookean(**MODULI),
        density=1.7,
        viscosity=VISCOSITY,
        where=nv.Ball(centre=(0.5, 0.35), radius=0.2),
    )
    rest = nv.Body(
        name="rest",
        material=nv.ReferentialMooneyRivlin(K_e=3.3, G_e=0.1, G_mr=0.1),
        density=1.1,
        viscosity=VISCOSITY,
    )
    require_rest(run_of(nv.Model(bodies=[disc, rest]), solver=solver))


def test_a_turned_body_at_rest_closes():
    turned = CF((0.8, 0.6, 0, -0.6, 0.8, 0, 0, 0, 1), dims=(3, 3))
    require_rest(run_of(nv.Model(material=OLDROYD_B), initial=nv.Initial(F=turned)))


def test_the_scale_of_rounding_is_that_of_the_moduli():
    """30 roundings of phi''[z, z]: K_e + 3 G_e of OldroydB, over 0.91 m^2; of a quadratic energy twice it."""
    ledger = run_of(nv.Model(material=OLDROYD_B)).ledger
    moduli = MODULI["K_e"] + 3 * MODULI["G_e"]
    assert ledger.rounding() == pytest.approx(30 * 2.22e-16 * moduli * 0.91, rel=1e-3)
    strained = nv.Initial(F=CF((1 + 1e-6, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3)))
    ledger = run_of(nv.Model(material=nv.LinearElastic(**MODULI)), initial=strained).ledger
    assert ledger.rounding() == pytest.approx(60 * 2.22e-16 * ledger.energy(), rel=1e-3)


def test_a_small_motion_is_still_held_to_account(monkeypatch):
    """Negative control: a wrong dissipation of strains of 1e-5 opens the ledger of the same body."""
    wrong = Stokes.entries

    def doubled(self, u):
        bulk, shear = wrong(self, u)
        return [bulk, replace(shear, integrand=replace(shear.integrand, cells=2 * shear.integrand.cells))]

    monkeypatch.setattr(Stokes, "entries", doubled)
    a, b = pi * x / 1.3, pi * y / 0.7
    swirl = 1e-5 * CF((1.3 * sin(a) * cos(b), -0.7 * cos(a) * sin(b)))
    model = nv.Model(material=OLDROYD_B, viscosity=VISCOSITY)
    with pytest.warns(nv.ClosureWarning):
        run_of(model, initial=nv.Initial(velocity=swirl)).advance()


def test_without_the_scale_of_rounding_a_body_at_rest_is_called_open(monkeypatch):
    """Negative control: it is what keeps the alarm silent."""
    monkeypatch.setattr(Ledger, "rounding", lambda self: 0.0)
    with pytest.warns(nv.ClosureWarning):
        run_of(nv.Model(material=OLDROYD_B, viscosity=VISCOSITY)).run(0.2)
