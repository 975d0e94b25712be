"""All terms of the scheme at once: both solvers agree, the ledger closes, and the norms are what they say."""

import numpy as np
import pytest
from ngsolve import Integrate

import ngvisco as nv
from tests.verification.cases.whole_scheme import Norms, whole
from tests.verification.setups import KINDS, cube_mesh, separation, square_mesh


def after_two_steps(kind, mesh, solver):
    run = whole(kind, 0.02, mesh, 1e-2, 1e-2)
    again = nv.Simulation(mesh, run.model, dt=0.02, initial=start(run), solver=solver)
    again.run(0.04)
    return again


def start(run):
    u = run.rothe_step.now
    return nv.Initial(density=u.rho, velocity=u.v, values=dict(u.z_tensors.items()))


@pytest.mark.parametrize(
    "kind", ["linearised", pytest.param("finite", marks=[pytest.mark.long, pytest.mark.ci])]
)
def test_both_solvers_agree_on_the_whole_scheme(kind):
    mesh = square_mesh(0.5)
    runs = [after_two_steps(kind, mesh, solver) for solver in ("coupled", "split")]
    for run in runs:
        assert np.abs(run.ledger.column("closure_relative")).max() <= 1e-10
        assert np.abs(run.ledger.column("mass_drift")).max() <= 1e-12
    assert max(separation(*runs).values()) <= 1e-8


@pytest.mark.parametrize("kind", KINDS)
def test_norms_are_those_of_the_ledger_and_of_the_fields(kind):
    norms = Norms(whole(kind, 0.02, square_mesh(0.5), 1e-2, 1e-2))
    for _ in range(2):
        norms.advance()
    found, run = norms.values(), norms.run
    ledger, u = run.ledger, run.rothe_step.now
    assert found["sup ‖√rho v‖ L2"] == pytest.approx(
        (2 * ledger.column("kinetic")[1:].max()) ** 0.5, rel=1e-6
    )
    assert found["sup ‖p‖ L1"] >= Integrate(u.rho * u.v[0], run.mesh)
    assert 0 < norms.gronwall <= 1
    assert all(np.isfinite(value) and value > 0 for value in found.values())


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_whole_scheme_closes_in_space(kind):
    run = whole(kind, 0.02, cube_mesh(1.0), 1e-2, 1e-2)
    ledger = run.run(0.04)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("dissipation_delta_fields")[1:].min() > 0
