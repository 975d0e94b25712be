"""Energies per referential volume and per mass: the paper's stresses, convexity, and refused energies."""

import warnings

import numpy as np
import pytest
from scipy.linalg import expm
from support import tensor, tensors, value, values

import ngvisco as nv
from ngvisco.physics.material import cauchy_stress, conjugates, mandel_stress
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Cofactor, Distortion, Jacobian, LeftCauchyGreen

RHO_R = 2.5
POLYCONVEX = nv.CustomMaterial(
    transported=(Distortion(), Cofactor(), Jacobian()),
    stored_energy=lambda F, H, J: 3 * square(F) * square(F) + 2 * square(H) + 14 / J + (J - 1) * (J - 1),
)
PSI = {
    "neo_hookean": nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
    "neo_hookean_B": nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="B"),
    "mooney_rivlin": nv.MooneyRivlin(K_e=10.0, G_e=3.0, G_mr=2.0, epsilon=0.1, elastic_state="F"),
    "mooney_rivlin_B": nv.MooneyRivlin(K_e=10.0, G_e=3.0, G_mr=2.0, epsilon=0.1, elastic_state="B"),
    "fluid": nv.BarotropicFluid(B=10.0, gamma=1.4),
    "polyconvex": POLYCONVEX,
}


def distortion(seed):
    return expm(0.3 * np.random.default_rng(seed).standard_normal((3, 3)))


def state(material, F):
    return values({v.name: v.from_distortion(tensor(F)) for v in material.variables})


def psi(material, F):
    return float(value(material.energy(tensors(state(material, F)))))


def slope(material, F, step=1e-6):
    """psi'(F) by differences."""
    result = np.empty((3, 3))
    for i, j in np.ndindex(3, 3):
        shift = np.zeros((3, 3))
        shift[i, j] = step
        result[i, j] = (psi(material, F + shift) - psi(material, F - shift)) / (2 * step)
    return result


@pytest.mark.parametrize("name", PSI)
def test_stress_of_an_energy_per_mass_is_rho_times_its_slope_times_F_transposed(name):
    """T = rho psi'(F) F^T with rho = rho_R/det F (paper, after ED-Euler-large), and phi = rho psi."""
    material, F = nv.PerMass(material=PSI[name], rho_R=RHO_R), distortion(1)
    rho, z = RHO_R / np.linalg.det(F), tensors(state(material, F))
    expected = rho * slope(PSI[name], F) @ F.T
    assert value(material.energy(z)) == pytest.approx(rho * psi(PSI[name], F), rel=1e-13)
    assert value(cauchy_stress(material, z)) == pytest.approx(expected, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("name", PSI)
def test_the_stress_of_an_energy_per_referential_volume_equals_the_stress_of_the_paper(name):
    """T = psi'(F) F^T/det F and M = sym dev(F^T psi'(F))/det F (paper: Cauchy-stress++, Mandel-stress++)."""
    material, F = nv.PerReferentialVolume(material=PSI[name]), distortion(2)
    z = tensors(state(material, F))
    S = slope(PSI[name], F) / np.linalg.det(F)
    assert value(cauchy_stress(material, z)) == pytest.approx(S @ F.T, rel=1e-7, abs=1e-7)
    actual = any(v.frame == "actual" for v in material.variables)
    M = S @ F.T if actual else F.T @ S
    M = 0.5 * (M + M.T) - np.trace(M) / 3 * np.eye(3)
    assert value(mandel_stress(material, z, conjugates(material, z), 3)) == pytest.approx(
        M, rel=1e-7, abs=1e-7
    )


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", PSI)
def test_convex_energies_stay_convex(name, dim):
    for material in (
        nv.PerReferentialVolume(material=PSI[name]),
        nv.PerMass(material=PSI[name], rho_R=RHO_R),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert nv.check_convexity(material, dim=dim).passed
        assert nv.check_isotropy(material, dim=dim).passed


def test_an_energy_of_F_and_J_that_is_only_divided_by_J_is_not_convex():
    """The perspective is convex: phi = psi(F, J)/J with the neo-Hookean psi of F and J."""
    inner = PSI["neo_hookean"]
    plain = nv.CustomMaterial(
        transported=(Distortion(), Jacobian()), stored_energy=lambda F, J: inner.energy({"F": F, "J": J}) / J
    )
    with pytest.warns(nv.ConvexityWarning):
        assert not nv.check_convexity(plain).passed


def test_an_energy_per_mass_has_the_elastic_state_of_its_material():
    open_one = nv.PerMass(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1), rho_R=RHO_R)
    by_F = nv.Model(material=open_one).material
    by_B = nv.Model(material=open_one, creep=nv.Creep(G_m=1.0)).material
    assert [v.name for v in by_F.variables] == ["AF", "A"]
    assert [v.name for v in by_B.variables] == ["AB", "A"]
    assert [v.exponent for v in (by_F.variables[0], by_B.variables[0])] == pytest.approx([-1, -5 / 3])
    assert isinstance(by_B.variables[0], LeftCauchyGreen)
    assert by_B.referential_density == RHO_R


def test_wrappers_of_an_energy_per_mass_have_its_referential_density():
    inner = nv.PerMass(material=PSI["fluid"], rho_R=RHO_R)
    wrapped = nv.WithQuadratic(material=nv.Yosida(material=inner, eps=1e-3), delta=1e-4)
    assert wrapped.referential_density == RHO_R
