"""The amounts of a state: none is negative at a point, nor is their sum, and the density is theirs."""

import numpy as np
import pytest
from ngsolve import CF, GridFunction, Integrate, x

import ngvisco as nv
from ngvisco.forms.bounds import SHARE, Bounds
from ngvisco.geometries import box
from ngvisco.physics.variables import Jacobian

DENSITIES = {"a": 1.0, "b": 1000.0}


def fluid():
    return nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 10 * (J - 2 + 1 / J))


@pytest.fixture
def run():
    places = {"a": nv.HalfSpace((0.5, 0.5), (1.0, 0.0)), "b": None}
    bodies = [
        nv.Body(name=name, where=places[name], material=fluid(), density=density)
        for name, density in DENSITIES.items()
    ]
    return nv.Simulation(box((1, 1), maxh=0.5), nv.Model(bodies=bodies), dt=0.02)


def overshoot(run):
    """Amounts and density steepened alike in the first cell, so that the sum of the amounts is negative at a
    corner."""
    step, mesh = run.rothe_step, run.mesh
    space = step.layout.blocks["rho"]
    sizes, moments = (np.asarray(Integrate(f, mesh, element_wise=True)) for f in (CF(1.0), x))
    slope = GridFunction(space)
    slope.Set((x - moments[0] / sizes[0]) * 8)
    dofs = [d for d in next(iter(space.Elements())).dofs]
    change = slope.vec.FV().NumPy()[dofs]
    state, ranges = step.state.vec.FV().NumPy(), step.layout.ranges
    z, rho = state[ranges["z"]].reshape(step.layout.states.size, -1), state[ranges["rho"]]
    for name, density in DENSITIES.items():
        amount = step.now.z_tensors[f"n_{name}"]
        share = np.asarray(Integrate(amount, mesh, element_wise=True))[0] / sizes[0]
        z[step.layout.states.slices[f"n_{name}"].start][dofs] += share * change
        rho[dofs] += density * share * change


def total(run):
    return sum(run.rothe_step.now.z_tensors[f"n_{name}"] for name in DENSITIES)


def masses(run):
    amounts = (run.rothe_step.now.z_tensors[f"n_{name}"] for name in DENSITIES)
    return [Integrate(amount, run.mesh) for amount in amounts]


def test_the_sum_of_amounts_stays_positive_and_the_density_is_theirs(run):
    overshoot(run)
    before, mean = masses(run), 1.0
    assert run.sampler.extrema(total(run))[0] < -0.1
    bounds = Bounds(run.rothe_step, run.sampler)
    assert bounds.is_exceeded()
    assert bounds.limit() == 1
    assert run.sampler.extrema(total(run))[0] == pytest.approx(SHARE * mean, rel=1e-6)
    assert masses(run) == pytest.approx(before, rel=1e-13)
    of_bodies = sum(
        density * run.rothe_step.now.z_tensors[f"n_{name}"] for name, density in DENSITIES.items()
    )
    assert Integrate((run.rothe_step.now.rho - of_bodies) ** 2, run.mesh) ** 0.5 <= 1e-11
    assert not bounds.is_exceeded()
