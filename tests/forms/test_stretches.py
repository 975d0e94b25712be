"""Tensors of bodies that are not positive at points: their treatment changes no energy."""

import numpy as np
import pytest
from ngsolve import VOL, Integrate

import ngvisco as nv
from ngvisco.forms.bounds import Bounds
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.start.initial import set_initial
from ngvisco.forms.system import Step
from ngvisco.geometries import box
from ngvisco.physics.variables import Jacobian

FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 10 * (J - 2 + 1 / J))
LINEAR = {
    "B": nv.ReferentialNeoHookean(K_e=20.0, G_e=1.0, elastic_state="B"),
    "B and its cofactor": nv.ReferentialMooneyRivlin(K_e=20.0, G_e=0.7, G_mr=0.3, elastic_state="B"),
}


def stretched(solid, size, dim=2):
    """A disc in a fluid; in all cells, linear polynomials of mean zero are added to the tensors."""
    bodies = (
        nv.Body(name="disc", where=nv.Ball((0.5,) * dim, 0.35), material=solid, density=1.0),
        nv.Body(name="rest", material=FLUID, density=1.0),
    )
    step = Step(box((1,) * dim, 0.5), nv.Model(bodies=bodies), nv.Discretisation(m=1))
    set_initial(step, nv.Initial(), Sampler(step.mesh, step.quadrature))
    z = values_of(step)
    space, rng = step.layout.scalar_space("z"), np.random.default_rng(1)
    for cell in step.mesh.Elements(VOL):
        dofs = np.array(space.GetDofNrs(cell))[1:]
        for X in step.model.material.contents("disc"):
            rows = z[step.layout.states.slices[X.name]]
            rows[:, dofs] += size * rng.uniform(-1, 1, (len(rows), len(dofs)))
    return step


def values_of(step):
    state = step.state.vec.FV().NumPy()[step.layout.ranges["z"]]
    return state.reshape(step.layout.states.size, -1)


def stored(step):
    return Integrate(step.energy.density(step.now), step.mesh, order=step.quadrature.volume_degree)


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.long)])
@pytest.mark.parametrize("solid", LINEAR)
def test_indefinite_tensors_are_made_positive_definite_and_no_other_value_changes(solid, dim):
    step = stretched(LINEAR[solid], 1.5, dim)
    sampler, u = Sampler(step.mesh, step.quadrature), step.now
    bounds, material = Bounds(step, sampler), step.model.material
    names = [X.name for X in material.contents("disc")]
    theta = sampler.values(material.fractions.at(u.z_tensors)["disc"])

    def least(name):
        X = np.asarray(sampler.values(u.z_tensors[name])).reshape(-1, 3, 3)
        return np.linalg.eigvalsh(X[theta > 0.1])[:, 0].min()

    def integrals(name):
        return np.array([Integrate(u.z_tensors[name][i, i], step.mesh, element_wise=True) for i in range(3)])

    energy = stored(step)
    assert all(least(name) < -0.1 for name in names) and bounds.is_exceeded()
    means, z = {name: integrals(name) for name in names}, values_of(step).copy()
    assert bounds.limit() > step.mesh.ne / 10 and not bounds.is_exceeded()
    assert all(least(name) > 0 for name in names)
    assert stored(step) == pytest.approx(energy, rel=1e-13)
    for name, mean in means.items():
        assert integrals(name) == pytest.approx(mean, abs=1e-14)
    changed = (values_of(step) != z).any(axis=1)
    where = step.layout.states.slices
    assert {name for name, rows in where.items() if changed[rows].any()} == set(names)
