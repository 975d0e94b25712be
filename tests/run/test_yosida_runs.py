"""Runs with Yosida approximations: the ledger, the limit eps -> 0, output, restarts and failures."""

import numpy as np
import pytest
from ngsolve import CF, VOL, Id, Integrate
from support import by_ci

import ngvisco as nv
from ngvisco.errors import InitialDataError
from ngvisco.geometries import box
from ngvisco.physics.energy_checks import ConvexityWarning
from ngvisco.physics.pointwise import respond
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian

NEO_HOOKEAN = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F")
REFERENTIAL = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F")


def foam(F, J):
    return 4 * square(F) / J ** (2 / 3) + 6 * (J - 1) * (J - 1) + 0.2 / (J * J) + 0.4 * J


FOAM = nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=foam)


def simulation(material: nv.Material, dim: int = 2, **options) -> nv.Simulation:
    model = nv.Model(
        material=material,
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        creep=nv.Creep(G_m=2.0),
        loads=[nv.Gravity((0.3, -1.0, 0.2)[:dim])],
    )
    return nv.Simulation(box((1,) * dim, 0.6 if dim == 2 else 1.2), model, dt=0.05, **options)


@pytest.mark.parametrize(
    ("material", "dim"),
    [
        *((material, 2) for material in (NEO_HOOKEAN, REFERENTIAL, FOAM)),
        by_ci(NEO_HOOKEAN, 3),
        *(pytest.param(material, 3, marks=pytest.mark.long) for material in (REFERENTIAL, FOAM)),
    ],
)
def test_the_ledger_closes_and_energy_is_not_created(material: nv.Material, dim: int) -> None:
    run = simulation(nv.Yosida(material=material, eps=0.02), dim)
    steps = 2 if dim == 2 else 1
    ledger = run.run(0.05 * steps)
    assert np.abs(ledger.column("closure_relative")).max() < 1e-13
    assert (ledger.column("bregman")[1:] > 0).all()
    assert (ledger.column("dissipation_creep")[1:] > 0).all()
    stored = Integrate(run.rothe_step.energy.projected, run.mesh)  # the projection keeps cellwise means
    assert ledger.column("stored")[-1] == pytest.approx(stored, rel=1e-13)
    u, sampler = run.rothe_step.now, run.sampler
    pointwise = run.rothe_step.energy.samples(u.z_tensors, sampler)
    plain = sampler.values(material.energy(u.z_tensors))
    assert (pointwise < plain).all()


def test_the_papers_energy_has_both_regularisations_in_the_ledger() -> None:
    both = nv.WithQuadratic(material=nv.Yosida(material=NEO_HOOKEAN, eps=0.02), delta=0.01)
    ledger = simulation(both).run(0.1)
    assert np.abs(ledger.column("closure_relative")).max() < 1e-13
    assert (ledger.column("stored_quadratic")[1:] > 0.1).all()


def test_cauchy_stress_contains_the_approximated_energy() -> None:
    """T = zeta_F F^T + (J zeta_J + phi_eps) I, so that T_11 without the parts of zeta_F and zeta_J is
    phi_eps."""
    run = simulation(nv.Yosida(material=NEO_HOOKEAN, eps=0.02))
    fields = run.fields  # fields are functions of the present state, so that they are obtained only once
    run.run(0.1)
    u = run.rothe_step.now
    z, zeta = u.z_tensors, u.zeta_tensors
    T, rate = fields["cauchy_stress"], zeta["F"] * z["F"].trans
    points = run.mesh.MapToAllElements(run.rothe_step.quadrature.cell_rules, VOL)
    phi = (T[0, 0] - rate[0, 0] - z["J"] * zeta["J"])(points).ravel()
    states = np.asarray(u.z(points))
    exact = respond(run.model.material, 2)(states).energy
    assert np.abs(phi - exact).max() < 2e-3 * np.abs(exact).max()  # phi_eps is projected on P_1 in each cell
    assert np.abs((T[0, 1] - rate[0, 1])(points)).max() < 1e-12
    assert np.isfinite(T(run.mesh(0.31, 0.47))).all()


def test_a_users_energy_without_a_minimum_is_refused_with_the_reason() -> None:
    """The convexity check warns of this energy, as of any energy of a user. At F = 3 I it has no
    minimiser."""

    def energy(F, J):
        return square(F) + 5 * (J - 1) * (J - 1) - 40 * (J - 1) * (J - 1) * (J - 1)

    concave = nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=energy)
    with (
        pytest.warns(ConvexityWarning, match="Yosida: the stored energy is not convex"),
        pytest.raises(
            InitialDataError, match=r"initial stored energy: .*Yosida .* eps = 0.001 has no minimiser"
        ),
    ):
        simulation(nv.Yosida(material=concave, eps=0.001), initial=nv.Initial(F=3 * CF(Id(3))))
