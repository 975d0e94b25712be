"""Viscosities of the state in a flow: both solvers agree, the ledger closes, with and without heat."""

import numpy as np
import pytest
from ngsolve import CF, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.parameters import Parameter

PLAIN = nv.StokesViscosity(K_v=0.1, G_v=0.1)
LAWS = {
    "power law": nv.PowerLaw(K_v=0.1, consistency=0.1, n=0.3, floor=1e-3),
    "thickening": nv.PowerLaw(K_v=0.1, consistency=0.1, n=2.0),
    "Carreau": nv.Carreau(K_v=0.1, G_0=0.5, relaxation=3.0, n=0.3),
    "Cross": nv.Cross(K_v=0.1, G_0=0.5, relaxation=3.0, m=0.9),
    "of the temperature": nv.ActivatedViscosity(viscosity=PLAIN, E=2e4, theta_R=300.0),
    "of a carried temperature": nv.ActivatedViscosity(
        viscosity=PLAIN, E=2e4, theta_R=300.0, temperature=300.0 + 50.0 * Parameter("hot", start=x)
    ),
    "of the pressure": nv.ActivatedViscosity(
        viscosity=PLAIN, E=0.0, theta_R=300.0, V=500.0, temperature=300.0
    ),
}
RULES = {
    "Norton of the temperature": nv.Activated(rule=nv.Norton(A=0.3, n=3), E=2e4, theta_R=300.0),
    "with a gradient": nv.Activated(rule=nv.Norton(A=0.3, n=3, nu=1e-3), E=2e4, theta_R=300.0),
}
DEFAULT = {"power law", "of the temperature"}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in DEFAULT else pytest.mark.long) for n in {**LAWS, **RULES}]
)
def test_both_solvers_agree_and_the_ledger_closes(name):
    solid = nv.ReferentialNeoHookean(K_e=20.0, G_e=2.0)
    has_heat = "of the temperature" in name or name in RULES
    material = nv.Thermal(material=solid, c=0.01, gruneisen=0.1, theta_R=300.0) if has_heat else solid
    model = nv.Model(material=material, viscosity=LAWS.get(name, PLAIN), creep=RULES.get(name))
    lid = {"top": nv.PrescribedTangential(CF((4 * x * (1 - x), 0)))}
    found = {}
    for solver in ("split", "coupled"):
        start = nv.Initial(density=1.0)
        run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.05, initial=start, walls=lid, solver=solver)
        ledger = run.run(0.15)
        assert abs(ledger.column("closure_relative")).max() <= 1e-10
        assert not ledger.column("rejections").any()
        found[solver] = ledger
        if has_heat:
            assert (np.diff(ledger.column("entropy")) > 0).all()
    for column in ("dissipation_stokes_shear", "stored", "kinetic"):
        split, coupled = (found[solver].column(column) for solver in ("split", "coupled"))
        assert np.allclose(split, coupled, rtol=1e-7), column
