"""Derived stresses against closed forms and differences of the energy; invariance; convexity."""

from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import CoefficientFunction, Trace, log
from scipy.linalg import expm
from support import central_difference, random_rotation, tensor, tensors, trace_free, value, values

from ngvisco import CustomMaterial, IsotropicStrainEnergy, LinearElastic, Material, NeoHookean
from ngvisco.physics.material import cauchy_stress, conjugates, mandel_stress, rate_power
from ngvisco.physics.tensors import dev, square
from ngvisco.physics.variables import (
    Cofactor,
    Distortion,
    Jacobian,
    LogJacobian,
    ReciprocalJacobian,
    Values,
    Variable,
)

LINEAR = LinearElastic(K_e=3.0, G_e=1.3)
HARDENING = IsotropicStrainEnergy(
    strain_energy=lambda E: 0.7 * Trace(E) * Trace(E) + square(dev(E)) + 2 * square(dev(E)) * square(E)
)
NEO_HOOKEAN = NeoHookean(K_e=3.0, G_e=1.3, epsilon=0.4)
EVERYTHING = CustomMaterial(
    transported=(
        Distortion(),
        Jacobian(),
        Cofactor(),
        Distortion("G", exponent=-1 / 3),
        Cofactor("B", exponent=-7 / 6),
        ReciprocalJacobian(),
        LogJacobian(),
    ),
    stored_energy=lambda F, J, H, G, B, A, K: (
        square(F) / J + 0.3 * square(H) + 0.2 * square(G) * A + square(B) - 0.4 * K + J * J - log(J)
    ),
)
STRAIN = {"linear": LINEAR, "hardening": HARDENING}
FINITE = {"neo_hookean": NEO_HOOKEAN, "everything": EVERYTHING}
ALL = {**STRAIN, **FINITE}


def random_distortion(rng: np.random.Generator, size: float = 0.4) -> np.ndarray:
    return expm(size * rng.standard_normal((3, 3)))


def state(material: Material, F: np.ndarray) -> dict[str, np.ndarray]:
    return values({v.name: v.from_distortion(tensor(F)) for v in material.variables})


def energy(material: Material, z: dict[str, np.ndarray]) -> float:
    return float(value(material.energy(tensors(z))))


def stress(material: Material, z: dict[str, np.ndarray]) -> np.ndarray:
    return value(cauchy_stress(material, tensors(z)))


def mandel(material: Material, z: dict[str, np.ndarray], dim: int = 3) -> np.ndarray:
    z_cf = tensors(z)
    return value(mandel_stress(material, z_cf, conjugates(material, z_cf), dim))


# --- stresses ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL)
def test_conjugates_are_the_energy_s_differences(name: str, rng: np.random.Generator) -> None:
    material = ALL[name]
    z = state(material, random_distortion(rng))
    zeta = values(conjugates(material, tensors(z)))
    for variable, array in z.items():
        direction = rng.standard_normal(array.shape)

        def along(s: float, variable: str = variable, direction: np.ndarray = direction) -> float:
            return energy(material, {**z, variable: z[variable] + s * direction})

        expected = central_difference(along, 1e-3)
        assert np.sum(zeta[variable] * direction) == pytest.approx(expected, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("name", FINITE)
def test_cauchy_stress_is_the_energy_s_difference_along_a_motion(name: str, rng: np.random.Generator) -> None:
    """J T : A = d/ds J phi(z(exp(sA) F)): the energy per referential volume, for any A."""
    material, F = FINITE[name], random_distortion(rng)
    T = stress(material, state(material, F))
    for _ in range(3):
        A = rng.standard_normal((3, 3))

        def referential(s: float, A: np.ndarray = A) -> float:
            F_s = expm(s * A) @ F
            return float(np.linalg.det(F_s)) * energy(material, state(material, F_s))

        expected = central_difference(referential, 1e-3) / np.linalg.det(F)
        assert np.sum(T * A) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("name", FINITE)
def test_mandel_stress_is_the_energy_s_difference_along_creep(name: str, rng: np.random.Generator) -> None:
    """M : P = - d/ds phi(z(F exp(-sP))) with a minus sign of the rate -F P: positive power is released."""
    material, F = FINITE[name], random_distortion(rng)
    M = mandel(material, state(material, F))
    assert pytest.approx(trace_free(M), abs=1e-12) == M
    assert pytest.approx(M.T, abs=1e-12) == M
    for _ in range(3):
        A = rng.standard_normal((3, 3))
        P = trace_free(A + A.T)
        expected = -central_difference(
            lambda s, P=P: energy(material, state(material, F @ expm(-s * P))), 1e-3
        )
        assert np.sum(M * P) == pytest.approx(expected, rel=1e-7)


def test_neo_hookean_stress_is_the_paper_s(rng: np.random.Generator) -> None:
    """T = phi'_F F^T + (J phi'_J + phi) I (paper: Cauchy-stress-polyconvex), derivatives by hand."""
    K, G, eps = NEO_HOOKEAN.K_e, NEO_HOOKEAN.G_e, NEO_HOOKEAN.epsilon
    F = random_distortion(rng)
    J = 1.2 * np.linalg.det(F)  # J is a variable of its own
    S_F = 2 * G * J ** (-2 / 3) * F
    S_J = K * (J - 1 + eps / K) - 2 / 3 * G * J ** (-5 / 3) * np.sum(F * F) - eps / J
    phi = K / 2 * (J - 1 + eps / K) ** 2 + G * J ** (-2 / 3) * np.sum(F * F) - eps * np.log(J)
    z = {"F": F, "J": np.array(J)}
    assert energy(NEO_HOOKEAN, z) == pytest.approx(phi, rel=1e-13)
    assert stress(NEO_HOOKEAN, z) == pytest.approx(S_F @ F.T + (J * S_J + phi) * np.eye(3), rel=1e-12)
    FtS = F.T @ S_F
    assert mandel(NEO_HOOKEAN, z) == pytest.approx(trace_free(FtS + FtS.T) / 2, abs=1e-12)


def test_neo_hookean_stress_at_rest_is_the_documented_pressure() -> None:
    K, G, eps = NEO_HOOKEAN.K_e, NEO_HOOKEAN.G_e, NEO_HOOKEAN.epsilon
    z = state(NEO_HOOKEAN, np.eye(3))
    assert stress(NEO_HOOKEAN, z) == pytest.approx((3 * G + eps**2 / (2 * K)) * np.eye(3), rel=1e-13)
    # det F = J = 1 is a minimum among all J and all isochoric F
    assert energy(NEO_HOOKEAN, {**z, "J": np.array(1.0)}) < energy(
        NEO_HOOKEAN, state(NEO_HOOKEAN, 1.1 * np.eye(3))
    )
    zeta_J = float(value(conjugates(NEO_HOOKEAN, tensors(z))["J"]))
    assert zeta_J == pytest.approx(-2 * G, rel=1e-13)


def test_neo_hookean_simple_shear_has_twice_the_modulus() -> None:
    for gamma in (0.1, 0.7, 3.0):
        F = np.eye(3)
        F[0, 1] = gamma
        T = stress(NEO_HOOKEAN, state(NEO_HOOKEAN, F))
        assert T[0, 1] == pytest.approx(2 * NEO_HOOKEAN.G_e * gamma, rel=1e-13)
        assert T[0, 0] - T[1, 1] == pytest.approx(2 * NEO_HOOKEAN.G_e * gamma**2, rel=1e-12)


def test_linear_elastic_stress_is_hooke_s_with_the_energy_s_pressure(rng: np.random.Generator) -> None:
    """T = S + phi I, S = K_e tr E I + 2 G_e dev E (paper: St.Venenat-Kirchhoff-linear); M = dev S."""
    A = 0.3 * rng.standard_normal((3, 3))
    E = (A + A.T) / 2
    S = LINEAR.K_e * np.trace(E) * np.eye(3) + 2 * LINEAR.G_e * trace_free(E)
    phi = LINEAR.K_e / 2 * np.trace(E) ** 2 + LINEAR.G_e * np.sum(trace_free(E) ** 2)
    assert energy(LINEAR, {"E": E}) == pytest.approx(phi, rel=1e-13)
    assert stress(LINEAR, {"E": E}) == pytest.approx(S + phi * np.eye(3), abs=1e-13)
    assert mandel(LINEAR, {"E": E}) == pytest.approx(trace_free(S), abs=1e-13)
    assert stress(LINEAR, {"E": np.zeros((3, 3))}) == pytest.approx(np.zeros((3, 3)))


@pytest.mark.parametrize("name", STRAIN)
def test_spin_is_powerless_in_an_isotropic_strain_energy(name: str, rng: np.random.Generator) -> None:
    """S : (W E - E W) = 0, so that T is symmetric (paper: E:WS=E:SW)."""
    A = rng.standard_normal((3, 3))
    T = stress(STRAIN[name], {"E": A + A.T})
    assert pytest.approx(T.T, abs=1e-11) == T


@pytest.mark.parametrize("name", ALL)
def test_plane_strain_mandel_stress_is_the_projected_3d_one(name: str, rng: np.random.Generator) -> None:
    """In plane strain the creep rate keeps its 33 entry; it is that of the 3D body."""
    material = ALL[name]
    F = expm(0.4 * rng.standard_normal((3, 3)))
    F[:2, 2] = F[2, :2] = 0.0
    F[2, 2] = 1.4
    z = state(material, F)
    M = mandel(material, z, dim=2)
    assert mandel(material, z, dim=3) == pytest.approx(M, abs=1e-12)
    assert abs(M[2, 2]) > 1e-3


# --- invariance --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FINITE)
def test_rotating_the_distortion_rotates_the_stress(name: str, rng: np.random.Generator) -> None:
    """F -> Q F gives T -> Q T Q^T, the same energy and the same Mandel stress."""
    material, F, Q = FINITE[name], random_distortion(rng), random_rotation(rng)
    z, star = state(material, F), state(material, Q @ F)
    assert energy(material, star) == pytest.approx(energy(material, z), rel=1e-13)
    assert stress(material, star) == pytest.approx(Q @ stress(material, z) @ Q.T, abs=1e-12)
    assert mandel(material, star) == pytest.approx(mandel(material, z), abs=1e-12)
    T = stress(material, z)
    assert pytest.approx(T.T, abs=1e-12) == T


@pytest.mark.parametrize("name", STRAIN)
def test_rotating_the_strain_rotates_the_stress(name: str, rng: np.random.Generator) -> None:
    material, Q = STRAIN[name], random_rotation(rng)
    A = 0.3 * rng.standard_normal((3, 3))
    z = {"E": A + A.T}
    star = {"E": Q @ z["E"] @ Q.T}
    assert energy(material, star) == pytest.approx(energy(material, z), rel=1e-13)
    assert stress(material, star) == pytest.approx(Q @ stress(material, z) @ Q.T, abs=1e-12)
    assert mandel(material, star) == pytest.approx(Q @ mandel(material, z) @ Q.T, abs=1e-12)


@dataclass(frozen=True)
class FirstEntry(Material):
    """(F_11)^2, which the package's own materials refuse."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (Distortion(),)

    def energy(self, z: Values) -> CoefficientFunction:
        return z["F"][0, 0] * z["F"][0, 0]


def test_an_energy_that_is_not_objective_is_seen(rng: np.random.Generator) -> None:
    """Negative control: (F_11)^2 has neither the same energy nor a symmetric stress."""
    material = FirstEntry()
    F, Q = random_distortion(rng), random_rotation(rng)
    T = stress(material, state(material, F))
    assert abs(energy(material, state(material, Q @ F)) - energy(material, state(material, F))) > 1e-2
    assert np.abs(T - T.T).max() > 1e-2


# --- convexity ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PowerOfJacobian(Material):
    """G_e J^exponent |F|^2 + (J - 1)^2: jointly convex where -1 <= exponent <= 0 only."""

    exponent: float

    @property
    def variables(self) -> tuple[Distortion, Jacobian]:
        return Distortion(), Jacobian()

    def energy(self, z) -> CoefficientFunction:
        J = z["J"]
        return J**self.exponent * square(z["F"]) + 1e-3 * (J - 1) * (J - 1)


def random_values(material: Material, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Independent values of all variables, scalars > 0."""
    return {
        v.name: np.array(np.exp(rng.uniform(-1.5, 1.5)))
        if v.kind == "scalar"
        else 2 * rng.standard_normal((3, 3))
        for v in material.variables
    }


def least_bregman(material: Material, rng: np.random.Generator, samples: int = 120) -> float:
    """Least phi(a) - phi(b) - phi'(b) : (a - b) over pairs, every other one with parallel tensors."""
    least = np.inf
    for sample in range(samples):
        b = random_values(material, rng)
        a = random_values(material, rng)
        if sample % 2:
            a = {name: x if x.ndim == 0 else rng.uniform(0, 3) * b[name] for name, x in a.items()}
        slope = values(conjugates(material, tensors(b)))
        linear = sum(np.sum(slope[name] * (a[name] - b[name])) for name in a)
        least = min(least, energy(material, a) - energy(material, b) - linear)
    return least


@pytest.mark.parametrize("material", [LINEAR, NEO_HOOKEAN], ids=["linear", "neo_hookean"])
def test_bregman_distance_is_never_negative(material: Material, rng: np.random.Generator) -> None:
    assert least_bregman(material, rng) >= 0


@pytest.mark.parametrize("exponent, convex", [(-0.5, True), (-1.0, True), (-1.6, False), (0.5, False)])
def test_bregman_sampling_sees_an_exponent_outside_the_convex_range(
    exponent: float, convex: bool, rng: np.random.Generator
) -> None:
    """Negative control: J^{-a}|F|^2 is jointly convex for 0 <= a <= 1 only."""
    least = least_bregman(PowerOfJacobian(exponent), rng)
    assert least >= 0 if convex else least < -0.1


# --- components --------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [2, 3])
def test_component_vector_and_tensors_are_inverse(dim: int, rng: np.random.Generator) -> None:
    size = EVERYTHING.states(dim).size
    assert size == {2: 4 * 5 + 3, 3: 4 * 9 + 3}[dim]
    covered = [i for where in EVERYTHING.states(dim).slices.values() for i in range(where.start, where.stop)]
    assert covered == list(range(size))
    vector = rng.standard_normal(size)
    z = EVERYTHING.states(dim).tensors(lambda: tensor(vector))
    assert value(EVERYTHING.states(dim).components(z)) == pytest.approx(vector, abs=1e-14)


def test_rate_power_sums_all_variables(rng: np.random.Generator) -> None:
    """sum zeta : rate(L, Pi) = T : L - phi tr L - M : Pi, the local energy balance."""
    material, F = EVERYTHING, random_distortion(rng)
    z = tensors(state(material, F))
    zeta = conjugates(material, z)
    L, A = rng.standard_normal((2, 3, 3))
    Pi = trace_free(A + A.T)
    power = float(value(rate_power(material, z, zeta, tensor(L), tensor(Pi))))
    T, M = value(cauchy_stress(material, z)), value(mandel_stress(material, z, zeta, 3))
    phi = float(value(material.energy(z)))
    assert power == pytest.approx(np.sum(T * L) - phi * np.trace(L) - np.sum(M * Pi), rel=1e-12)
