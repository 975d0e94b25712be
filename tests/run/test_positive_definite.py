"""Positive definite B: cases in which B provably stays positive definite (FORMULATION 8), and messages."""

import numpy as np
import pytest
from ngsolve import CF, IfPos, x
from support import SWIRL

import ngvisco as nv
from ngvisco.forms.bounds import Bounds
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.geometries import box

MESH = box((1, 1), maxh=0.5)
CHAINS = nv.Branch(material=nv.OldroydB(K_e=20.0, G_e=1.0), creep=nv.Creep(G_m=4.0, law="conformation"))
SPRING = nv.Branch(material=nv.ReferentialNeoHookean(K_e=20.0, G_e=1.0, elastic_state="B"))
"""Chains whose energy has the barrier ln det B, and a spring whose energy is linear in B."""
JUMPING = IfPos(
    x - 0.5, CF((9.0, 0, 0, 0, 1 / 9, 0, 0, 0, 1.0), dims=(3, 3)), CF(tuple(np.eye(3).ravel()), dims=(3, 3))
)
"""Start values with det B = 1 and the least eigenvalue 1/9."""


def stirred(branches, m, speed=1.0, **options):
    model = nv.Model(material=nv.Network(branches=branches), viscosity=nv.StokesViscosity(K_v=1.0, G_v=1.0))
    start = {name: JUMPING for name in (f"B_{name}" for name in branches) if m == 0}
    initial = nv.Initial(density=1.0, velocity=tuple(speed * v for v in SWIRL), values=start)
    space = nv.Discretisation(k=2, m=m)
    return nv.Simulation(MESH, model, initial=initial, discretisation=space, **options)


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_eigenvalue_columns_are_the_least_eigenvalues_of_each_branch(solver):
    run = stirred({"chains": CHAINS, "spring": SPRING}, 1, dt=0.1, solver=solver)
    ledger = run.run(0.2)
    for name in ("chains", "spring"):
        column = ledger.column(f"eigenvalue_min_B_{name}")
        tensors = run.ledger.sampler.rows(run.fields[f"B_{name}"]).reshape(-1, 3, 3)
        assert column[0] == pytest.approx(1.0)
        assert column[-1] == pytest.approx(np.linalg.eigvalsh(tensors).min(), rel=1e-12)
        assert 0 < column[-1] < 0.99
    assert column[-1] < ledger.column("eigenvalue_min_B_chains")[-1] - 1e-3  # the spring does not relax


@pytest.mark.parametrize("branch", [CHAINS, SPRING], ids=["barrier", "linear"])
def test_constants_in_cells_stay_positive_definite_in_steps_within_the_proof(branch):
    """tau 2 lambda_max(sym L) is 0.2, below the limit 1, and the tensors that jump have an eigenvalue of
    1/9."""
    ledger = stirred({"one": branch}, 0, speed=0.3, dt=0.1, solver="split").run(0.3)
    assert ledger.column("v_max")[1:].max() > 0.05
    assert ledger.column("eigenvalue_min_B_one").min() > 0.05
    assert ledger.column("limited_cells").max() == 0


def test_an_indefinite_mean_of_a_branch_is_refused_and_indefinite_points_are_limited():
    """Two eigenvalues of B are negative, while det B is positive."""
    step = stirred({"chains": CHAINS, "spring": SPRING}, 1, dt=0.1).ledger.step
    bounds, states = Bounds(step, Sampler(step.mesh, step.quadrature)), step.layout.states
    z = step.state.vec.FV().NumPy()[step.layout.ranges["z"]].reshape(states.size, -1)
    at_rest, first = z.copy(), states.slices["B_spring"].start
    for diagonal in (first, first + 2):
        z[diagonal] -= 2 * at_rest[diagonal]  # B_11 and B_22 become -1
    found = bounds.violation()
    assert found is not None and found.is_mean and found.quantity == "B_spring_11"
    z[:] = at_rest
    z[first + 1, 1::3] += 3.0  # a slope of B_12 in each cell
    found = bounds.violation(everywhere=True)
    assert bounds.violation() is None and found is not None and "B_spring" in found.quantity
    assert bounds.limit() == step.mesh.ne and bounds.violation(everywhere=True) is None
    assert np.abs(bounds._means.of_cells("z")[first + 1]).max() < 1e-12
