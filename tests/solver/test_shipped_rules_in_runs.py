"""Every shipped flow rule in a flow: the ledger closes, and creep takes energy at every point."""

from __future__ import annotations

import numpy as np
import pytest
from flow_rules import EXAMPLES
from ngsolve import CF, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.tensors import inner, square

LID = {"top": nv.PrescribedTangential(CF((16 * x**2 * (1 - x) ** 2, 0)))}


@pytest.mark.parametrize("solver", ["split", "coupled"])
@pytest.mark.parametrize("name", EXAMPLES)
def test_creep_takes_energy_at_every_point(name, solver):
    """M : Pi >= 0, and somewhere more than the roundings of its factors."""
    model = nv.Model(
        material=nv.LinearElastic(K_e=10.0, G_e=5.0),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        creep=EXAMPLES[name],
    )
    start = nv.Initial(density=1.0)
    run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.1, initial=start, walls=LID, solver=solver)
    step = run.rothe_step
    u, rates = step.now, step.context.rates
    M, (Pi,) = rates.mandel(u), rates.creep(u)
    for end in (0.1, 0.2, 0.3):
        ledger = run.run(end)
        power, sizes = (run.sampler.values(f) for f in (inner(M, Pi), square(M) * square(Pi)))
        assert power.min() >= -1e-14 * np.sqrt(sizes.max())
    assert power.max() > 1e-3
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert not ledger.column("rejections").any()
