"""The energy's slope by arrays is NGSolve's, or is not taken."""

import numpy as np
from ngsolve import CoefficientFunction
from support import small_run

import ngvisco as nv
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian


def energy(F, J):
    """Means something else with arrays, in a part without a slope at rest."""
    factor = 0.0 if isinstance(J, CoefficientFunction) else 0.5
    strain = square(F) - 3
    return 2 * square(F) + 6 * (J - 1) * (J - 1) - 4 * J + factor * strain * strain


def test_an_energy_that_means_something_else_with_arrays_is_found_out():
    material = nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=energy)
    viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.1)
    run = small_run(material=material, viscosity=viscosity, solver="split")
    slope = run.solver.newton.residual.slope
    states = run.rothe_step.layout.states
    rest = np.zeros((states.size, slope.points.count))
    rest[states.slices["F"]] = states.spaces["F"].columns.T @ np.eye(3).ravel()[:, None]
    rest[states.slices["J"]] = 1.0
    assert slope.arrays is None
    J = rest[states.slices["J"]]
    assert np.allclose(slope(rest)[states.slices["J"]], 12 * (J - 1) - 4, rtol=1e-12)


def test_rounding_at_rest_is_no_difference():
    """A run that starts at rest and one resumed there would otherwise differ in their last bits."""
    fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 10 * (J + 1 / J - 2))
    both = {"material": fluid, "viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1)}
    disc = nv.Body(name="disc", where=nv.Ball((0.4, 0.5), 0.2), density=2.0, **both)
    bodies = [nv.Body(name="medium", density=1.0, **both), disc]
    run = small_run(0.2, bodies=bodies, solver="split")
    slope = run.solver.newton.residual.slope
    run.advance()
    assert slope.arrays is not None
