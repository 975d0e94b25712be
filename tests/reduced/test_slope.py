"""The energy's slope by arrays equals NGSolve's, or is not used."""

import numpy as np
from ngsolve import CoefficientFunction
from support import small_run

import ngvisco as nv
from ngvisco.physics.pointwise import rest_state
from ngvisco.physics.tensors import square, tr
from ngvisco.physics.variables import CofactorLeftCauchyGreen, Distortion, Jacobian, LeftCauchyGreen


def energy(F, J):
    """An energy with a part that only arrays evaluate. The slope of this part is zero at rest."""
    factor = 0.0 if isinstance(J, CoefficientFunction) else 0.5
    strain = square(F) - 3
    return 2 * square(F) + 6 * (J - 1) * (J - 1) - 4 * J + factor * strain * strain


def test_an_energy_with_another_value_by_arrays_is_detected():
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


def test_rounding_at_rest_does_not_count_as_a_difference():
    """A run that starts at rest and a run resumed there would otherwise differ in their last bits."""
    fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 10 * (J + 1 / J - 2))
    both = {"material": fluid, "viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1)}
    disc = nv.Body(name="disc", where=nv.Ball((0.4, 0.5), 0.2), density=2.0, **both)
    bodies = [nv.Body(name="medium", density=1.0, **both), disc]
    run = small_run(0.2, bodies=bodies, solver="split")
    slope = run.solver.newton.residual.slope
    run.advance()
    assert slope.arrays is not None


def test_only_the_nonlinear_part_of_the_energy_of_bodies_is_differentiated():
    """Energies that are linear in X_i and n_i have the curvature of the common volumetric energy alone."""
    gas = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 10 * (J - 1) * (J - 1) / J)
    solid = nv.ReferentialNeoHookean(K_e=20.0, G_e=3.0)
    viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.1)
    disc = nv.Body(name="disc", where=nv.Ball((0.4, 0.5), 0.2), material=solid, density=2.0)
    run = small_run(
        bodies=[nv.Body(name="medium", material=gas, viscosity=viscosity, density=1.0), disc], solver="split"
    )
    slope, material = run.solver.newton.residual.slope, run.model.material
    assert [v.name for v in material.curved_part.variables] == ["n_medium", "n_disc"]
    z = rest_state(material, 2)[:, None]
    z = z + 0.1 * np.random.default_rng(0).standard_normal((len(z), 5))
    along, hessian = slope.derivative(z), slope.hessian(z)
    by_columns = np.stack([along(np.broadcast_to(e[:, None], z.shape)) for e in np.eye(len(z))], axis=1)
    assert abs(hessian).max() > 1
    assert np.allclose(hessian, by_columns, rtol=0, atol=1e-13 * abs(by_columns).max())
    response = slope.response(z.T).hessian.transpose(1, 2, 0)
    assert np.allclose(response, by_columns, rtol=0, atol=1e-13 * abs(by_columns).max())


def test_one_increment_gives_a_column_of_the_hessian_for_each_branch():
    coupled = nv.CustomMaterial(
        transported=(LeftCauchyGreen(exponent=-5 / 3), CofactorLeftCauchyGreen(exponent=-4 / 3), Jacobian()),
        stored_energy=lambda B, N, J: tr(B) * tr(B) / J + tr(N) * tr(N) + 20 * (J - 1) * (J - 1) / J,
    )
    made = {
        "slow": coupled,
        "spring": nv.ReferentialNeoHookean(K_e=0.0, G_e=1.0, elastic_state="B"),
        "chains": nv.OldroydB(K_e=3.0, G_e=2.0),
    }
    creep = {"slow": nv.Creep(G_m=2.0)}
    branches = {name: nv.Branch(material=part, creep=creep.get(name)) for name, part in made.items()}
    run = small_run(material=nv.Network(branches=branches), solver="split")
    slope, states = run.solver.newton.residual.slope, run.rothe_step.layout.states
    z = rest_state(run.model.material, 2)[:, None]
    z = z + 0.1 * np.random.default_rng(0).standard_normal((states.size, 5))
    along, curving, calls = slope.derivative(z), slope.curving, []
    by_columns = np.stack([along(np.broadcast_to(e[:, None], z.shape)) for e in np.eye(states.size)], axis=1)
    slope.curving = lambda values: calls.append(values.shape[1]) or curving(values)
    hessian = slope.hessian(z)
    largest = sum(states.spaces[name].size for name in ("B_slow", "N_slow"))
    # one call has 5 points for each column of a branch and for J
    assert calls == [5 * (largest + 1)] and largest + 1 < states.size
    assert abs(hessian[states.slices["B_slow"], states.slices["J"]]).max() > 0.1
    assert np.allclose(hessian, by_columns, rtol=0, atol=1e-14 * abs(by_columns).max())
