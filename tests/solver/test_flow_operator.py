"""The flow's linear operator against differences of the rows, on fields that the coarse rule integrates."""

from __future__ import annotations

import numpy as np
import pytest
from ngsolve import CF

import ngvisco as nv
from ngvisco.geometries import box

STEP = 1e-5


pytestmark = pytest.mark.usefixtures("double_precision")


@pytest.fixture
def run():
    """A box at rest in z, with v linear and density one."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.2),
        hyperviscosity=nv.HyperViscosity(mu=1e-4, p=4),
        loads=[nv.Gravity((0.0, -1.0))],
    )
    run = nv.Simulation(
        box((1, 1), maxh=0.4), model, dt=0.5, initial=nv.Initial(velocity=CF((0.0, 0.0))), solver="split"
    )
    return run


def linear(run, expressions):
    """Coefficients of a linear field in v's space, (dim, .), whatever the walls say."""
    split = run.solver.newton
    vertices = np.array([vertex.point for vertex in run.mesh.vertices])
    result = np.zeros_like(split.transport.v)
    for row, values in zip(result, expressions(*vertices.T), strict=True):
        row[: run.mesh.nv] = values
    return result


def prepared(run):
    split = run.solver.newton
    run.rothe_step.context.tau.Set(0.5)
    split.momentum.start()
    split.residual()
    split.preconditioner.operator.update()
    return split, split.preconditioner.operator


def derivative(split, dv, rows):
    """Central difference of ``rows()`` in the direction dv."""
    v = split.transport.v.copy()
    values = []
    for sign in (1, -1):
        split.transport.v[:] = v + sign * STEP * dv
        split.transport.set_velocity()
        values.append(rows())
    split.transport.v[:] = v
    split.transport.set_velocity()
    return (values[0] - values[1]) / (2 * STEP)


def test_inertia_convection_and_viscosity(run):
    split = run.solver.newton
    split.transport.v[:] = linear(run, lambda x, y: (1 + 2 * y - x, x + 0.5 * y))
    split, operator = prepared(run)
    operator.elements.from_fields[:] = 0.0  # what the fields answer is not asked here
    operator.derivative = None
    dv = linear(run, lambda x, y: (y - 0.3, 2 * x))  # div dv would change the density too
    expected = derivative(split, dv, lambda: split.momentum.residual()[: operator.nv])
    found = operator(np.concatenate([dv.ravel(), np.zeros(operator.size - operator.nv)]), None)[0]
    tests = np.zeros_like(dv, dtype=bool)
    tests[:, : run.mesh.nv] = True  # linear ones
    difference = (found[: operator.nv] - expected)[tests.ravel()]
    assert np.abs(difference).max() <= 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("eta", [0.05, 0.5])
def test_what_the_fields_and_the_facets_take(run, eta, monkeypatch):
    """Where every facet counts as reversing nothing is left out."""
    monkeypatch.setattr("ngvisco.solver.split.reversal.SUDDEN", 0.0)
    run.rothe_step.context.eta.Set(eta)
    split = run.solver.newton
    t = split.transport
    t.v[:] = linear(run, lambda x, y: (1 + 2 * y - x, x + 0.5 * y))
    rng = np.random.default_rng(0)
    t.z += 0.1 * rng.standard_normal(t.z.shape)
    split, operator = prepared(run)
    assert operator.reversal.exists
    dv = linear(run, lambda x, y: (y - 0.3, 2 * x + y))

    def rows():
        t.facets.set_fields(t.z, t.z_hat)
        return np.concatenate([t.facets.elastic_force(t.zeta).ravel(), t.residual()[1].ravel()])

    expected = derivative(split, dv, rows)
    force, through = operator.reversal(dv)
    op = operator.op
    source = np.einsum("pnx,xp->np", operator.p.columns[:, :, :4], op.velocity_gradient(dv))
    for j, values in enumerate(op.v(dv)):
        source -= operator.p.dz[:, j] * values
    found = np.concatenate([force.ravel(), (through - op.z.test(source)).ravel()])
    assert np.abs(found - expected).max() <= 1e-7 * np.abs(expected).max()
    # and the operator carries just this source
    operator.sweep.fields = lambda r: r
    carried = operator.carried(dv, None).T.ravel()
    assert np.abs(carried + found[operator.nv :]).max() <= 1e-12 * np.abs(carried).max()
    # the element matrices' force is that of the resolved fields, tested with the gradients of v's functions
    dz = rng.standard_normal((t.z.shape[1], t.n))
    resolved = np.einsum("pnm,mp->np", operator.p.resolvent, op.z(dz.T.copy()))
    stress = np.einsum("pxn,np->xp", operator.p.force[:, :4], resolved).reshape(2, 2, -1)
    expected = sum(D.test(np.ascontiguousarray(stress[:, j])) for j, D in enumerate(op.dv))
    assert np.abs(operator.force(dz) - expected).max() <= 1e-12 * np.abs(expected).max()
