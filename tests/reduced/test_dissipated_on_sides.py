"""Dissipation on the cells' sides by arrays is that of NGSolve's integrals."""

import numpy as np
import pytest
from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from tests.support import small_run

SWIRL = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
PRESSING = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
SOFT, STIFF = (nv.ReferentialNeoHookean(K_e=10.0, G_e=G) for G in (2.0, 5.0))
BODIES = [
    nv.Body(name="ball", material=STIFF, density=1.0, where=nv.Ball((0.5, 0.5), 0.3)),
    nv.Body(name="rest", material=SOFT, density=1.0),
]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"creep": nv.Creep(G_m=2.0), "hyperviscosity": nv.HyperViscosity(mu=1e-3, p=4)},
        {"material": nv.Thermal(material=PRESSING, c=1.0, theta_R=300.0), "heat": nv.Heat(conductivity=0.1)},
        {"bodies": BODIES},
    ],
    ids=["neo-Hookean", "creep and hyperviscosity", "heat", "bodies"],
)
def test_dissipation_on_sides_by_arrays_equals_ngsolve_s_integrals(options):
    viscosity = {} if "bodies" in options else {"viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1)}
    run = small_run(solver="split", velocity=SWIRL, **viscosity, **options)
    run.advance()
    run.advance()
    exchange, names = run.ledger.exchange, run.solver.dissipated_on_sides()
    assert "dissipation_upwinding" in names
    assert ("dissipation_hyper" in names) == ("hyperviscosity" in options)
    by_arrays = exchange()
    exchange.on_sides = dict
    integrals = exchange()
    for name in names:
        assert names[name] > 1e-8
        assert np.isclose(by_arrays[name], integrals[name], rtol=1e-9, atol=1e-14)
