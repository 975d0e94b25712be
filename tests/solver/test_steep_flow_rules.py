"""Every rule with every kind of elastic state, in both solvers: the ledger closes, creep gives no energy."""

from __future__ import annotations

import numpy as np
import pytest
from flow_rules import EXAMPLES
from ngsolve import CF, InnerProduct, Integrate, x

import ngvisco as nv
from ngvisco.geometries import box

MATERIALS = {
    "E": nv.LinearElastic(K_e=50.0, G_e=5.0),
    "F": nv.ReferentialNeoHookean(K_e=50.0, G_e=5.0, elastic_state="F"),
    "B": nv.ReferentialNeoHookean(K_e=50.0, G_e=5.0, elastic_state="B"),
}
DEFAULT = {("Norton, n = 10", "E")}


def sheared(rule, material, solver, scheme="backward-euler", maxh=0.5, dt=0.02):
    """A box whose lid starts at once: stresses of the first step are many times what the rule lets stand."""
    viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.1)
    model = nv.Model(material=material, viscosity=viscosity, creep=rule)
    lid = {"top": nv.PrescribedTangential(CF((16 * x**2 * (1 - x) ** 2, 0)))}
    start = {"initial": nv.Initial(density=1.0), "walls": lid, "solver": solver, "scheme": scheme}
    return nv.Simulation(box((1, 1), maxh=maxh), model, dt=dt, **start)


def cases():
    for name in EXAMPLES:
        for material in MATERIALS:
            for scheme in ("backward-euler", "midpoint"):
                is_default = (name, material) in DEFAULT and scheme == "backward-euler"
                marks = () if is_default else pytest.mark.long
                yield pytest.param(name, material, scheme, marks=marks, id=f"{name}-{material}-{scheme}")


@pytest.mark.parametrize(("name", "material", "scheme"), list(cases()))
def test_the_ledger_closes_and_creep_takes_energy_at_every_point(name, material, scheme):
    found = []
    for solver in ("coupled", "split"):
        run = sheared(EXAMPLES[name], MATERIALS[material], solver, scheme)
        power = InnerProduct(run.fields["creep_rate"], run.fields["mandel_stress"])
        for number in (1, 2, 3):
            run.run(0.02 * number)
            points = np.array([[0.1 + 0.2 * i, 0.1 + 0.2 * j] for i in range(5) for j in range(5)])
            assert min(power(run.mesh(*point)) for point in points) >= 0
        ledger = run.ledger
        assert abs(ledger.column("closure_relative")).max() <= 1e-10
        assert not ledger.column("rejections").any()
        assert Integrate(power, run.mesh) > 1e-6
        found.append(ledger.column("dissipation_creep"))
    assert np.allclose(*found, rtol=1e-7)
