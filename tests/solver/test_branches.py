"""The flow operator of networks: computing it branch by branch gives the same as all branches at once."""

import numpy as np
import pytest

import ngvisco as nv
from ngvisco.reduced.point_fields import derivative_of, incremented
from ngvisco.reduced.residual import CellPart
from tests.support import small_run

pytestmark = pytest.mark.usefixtures("double_precision")


def network(slow=None):
    """Two branches that creep, and a spring, with one J."""
    materials = {
        "slow": (nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0), slow or nv.Creep(G_m=2.0)),
        "fast": (nv.OldroydB(K_e=0.0, G_e=2.0), nv.Creep(G_m=0.5)),
        "spring": (nv.ReferentialNeoHookean(K_e=0.0, G_e=1.0), None),
    }
    branches = {name: nv.Branch(material=m, creep=creep) for name, (m, creep) in materials.items()}
    return nv.Network(branches=branches)


def evaluated(material):
    """A run, the split solver's residual at a strained state, and its operator, updated there."""
    viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.2)
    matter = {"material": material, "viscosity": viscosity}
    run = small_run(**({"bodies": material} if isinstance(material, tuple) else matter), solver="split")
    split, random = run.solver.newton, np.random.default_rng(0)
    run.rothe_step.context.tau.Set(0.1)
    x, slices = split.unknowns.pack(), split.unknowns.slices
    for name, size in (("v", 0.1), ("z", 0.02)):
        x[slices[name]] += size * random.standard_normal(x[slices[name]].shape)
    split.residual.start()
    at, operator = split.residual(x), split.preconditioner.operator
    operator.update(at)
    return run, split, at, operator


def test_the_matrix_of_a_cell_is_inverted_branch_by_branch():
    run, _, _, operator = evaluated(network())
    points, cells = operator.points, slice(0, run.mesh.ne)
    # each branch has four components and J
    assert [len(group) for group in points._groups(cells)] == [5, 5, 5]
    resolvent, (tested,) = points._resolvent(cells), points.tested(cells, [np.arange(points.components)])
    assert np.abs(tested).max() > 0.05
    count, size, n = *tested.shape[:2], points.components
    expected = np.linalg.inv(np.eye(size) - tested)
    rows = np.broadcast_to(np.eye(size).reshape(size, -1, n).swapaxes(0, 1), (count, size // n, size, n))
    found = np.empty_like(expected)
    resolvent.after(rows, found)
    assert np.abs(found - expected).max() <= 3e-4  # the truncated series has an error of 1e-4
    dz = np.random.default_rng(1).standard_normal((count, size // n, n))
    assert np.abs(resolvent(dz) - (expected @ dz.reshape(count, size, 1)).reshape(dz.shape)).max() <= 3e-3
    empty = points._resolvent(slice(0, 0))  # a rank may have no cells
    empty.after(rows[:0], found[:0])
    assert empty(dz[:0]).shape == (0, *dz.shape[1:])


def test_branches_that_act_on_each_other_are_inverted_together():
    run, _, _, operator = evaluated(network())
    points, cells = operator.points, slice(0, run.mesh.ne)
    points.rate_slope[0, 0, -2] = 1e-3  # a rate of the first branch depends on the last one
    assert [len(group) for group in points._groups(cells)] == [points.components]


def bodies():
    """Two solids that creep, and a fluid around them."""
    solid, fluid = (nv.ReferentialNeoHookean(K_e=2.0, G_e=G_e) for G_e in (1.0, 1e-3))
    places = {"left": nv.Ball((0.25, 0.5), 0.2), "right": nv.Ball((0.7, 0.5), 0.25)}
    parts = [
        nv.Body(name=name, where=place, material=solid, creep=nv.Creep(G_m=G_m), density=1.0)
        for (name, place), G_m in zip(places.items(), (0.05, 0.2), strict=True)
    ]
    return (*parts, nv.Body(name="rest", material=fluid, density=1.0))


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("slow", [None, nv.Creep(G_m=1.0, law="conformation"), "bodies"])
def test_derivatives_of_creep_through_its_stress_equal_derivatives_by_all_components(slow):
    """Rates of the law "conformation" are functions of zeta instead of the stress; rates of bodies also
    depend on the amounts."""
    material = network()
    if isinstance(slow, nv.Creep):
        branch = nv.Branch(material=nv.OldroydB(K_e=10.0, G_e=5.0), creep=slow)
        material = nv.Network(branches=material.parts | {"slow": branch})
    _, split, at, operator = evaluated(bodies() if slow == "bodies" else material)
    points, u = operator.points, operator.points.terms.fields(at.coefficients)
    rates, z, by_stress = split.residual.rates, u.z.value, points.rate_slope.copy()
    g, columns = rates.tensors.gradients, rates.columns(z)
    X = np.concatenate([rates.entries_of_L(u), rates.creep_components(u)])
    expected, _ = rates.slopes(z, X, u.zeta.value)
    zeta = points.slope.hessian(z).transpose(1, 0, 2)
    for m, unit in enumerate(np.eye(points.components)):
        _, changed = next(incremented(u, z=unit[None, :, None], zeta=zeta[m : m + 1]))
        by_z = derivative_of(rates.creep_components(changed), 1)[:, 0].T
        expected[:, :, m] += (columns[:, :, g:] @ by_z[:, :, None])[:, :, 0]
    assert np.abs(by_stress).max() > 1
    assert np.abs(expected - by_stress).max() <= 1e-12 * np.abs(by_stress).max()
    empty = slice(0, 0)  # a rank may have no cells
    operator._form((empty, points.terms.part(empty), CellPart(split.residual, empty)), at)
