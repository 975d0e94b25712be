"""Every material against closed forms: rates, stress at rest, moduli, state equation, convexity."""

import math
import re
import warnings

import numpy as np
import pytest
from materials import examples, table
from ngsolve import CF, Mesh, Parameter, log, unit_square
from scipy.linalg import expm
from support import by_ci, plane_strain, random_rotation, tensor, tensors, trace_free

import ngvisco as nv
from ngvisco.physics.material import cauchy_stress, conjugates, mandel_stress
from ngvisco.physics.materials.hyperelastic import referential_volume
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Cofactor, Distortion, Jacobian, LogJacobian, ReciprocalJacobian

MESH = Mesh(unit_square.GenerateMesh(maxh=2))
EXAMPLES = {example.constructor: example.material for example in examples()}
EVERYTHING = nv.CustomMaterial(
    transported=(
        *(Distortion(), Jacobian(), Cofactor(), Distortion("G", exponent=-1 / 3)),
        *(Cofactor("B", exponent=-7 / 6), ReciprocalJacobian(), LogJacobian()),
    ),
    stored_energy=lambda F, J, H, G, B, A, K: (
        square(F) / J + 0.3 * square(H) + 0.2 * square(G) * A + square(B) - 0.4 * K + J * J - log(J)
    ),
)
ALL = EXAMPLES | {"everything": EVERYTHING}
STRAIN = {n: m for n, m in ALL.items() if n.startswith(("LinearElastic", "HardeningElastic", "Isotropic"))}
FINITE = {name: m for name, m in ALL.items() if name not in STRAIN}


def at_point(f):
    """The values of a coefficient function that does not depend on x, as an array."""
    return np.array(f(MESH(0.3, 0.3))).reshape(f.dims or ())


def constants(material, F):
    """F as constants and scalars as parameters: NGSolve drops a constant 0 and its derivative."""
    return {
        name: tensor(at_point(z)) if z.dims else Parameter(float(at_point(z)))
        for name, z in {v.name: v.from_distortion(tensor(F)) for v in material.variables}.items()
    }


def energy(material, z):
    return float(at_point(material.energy(tensors(z))))


def energy_at(material, F):
    return float(at_point(material.energy(constants(material, F))))


def stress(material, z):
    return at_point(cauchy_stress(material, tensors(z)))


def mandel(material, z, dim=3):
    return at_point(mandel_stress(material, tensors(z), conjugates(material, tensors(z)), dim))


def state(name, rng):
    """Values of a material's variables for a random F in plane strain, or of a random strain."""
    A = plane_strain(rng.standard_normal((3, 3)))
    if name in STRAIN:
        return {"E": 0.3 * (A + A.T)}
    F = expm(0.4 * A)
    return {v.name: at_point(v.from_distortion(tensor(F))) for v in ALL[name].variables}


def test_the_linear_elastic_stress_is_hooke_s_law_plus_the_energy_as_pressure(rng):
    """T = S + phi I, S = K_e tr E I + 2 G_e dev E (paper: St.Venenat-Kirchhoff-linear); M = dev S."""
    linear, E = EXAMPLES["LinearElastic"], state("LinearElastic", rng)["E"]
    S = 10 * np.trace(E) * np.eye(3) + 10 * trace_free(E)
    phi = 5 * np.trace(E) ** 2 + 5 * np.sum(trace_free(E) ** 2)
    assert energy(linear, {"E": E}) == pytest.approx(phi, rel=1e-13)
    assert stress(linear, {"E": E}) == pytest.approx(S + phi * np.eye(3), abs=1e-12)
    assert mandel(linear, {"E": E}) == pytest.approx(trace_free(S), abs=1e-12)


def test_the_neo_hookean_stress_equals_the_stress_of_the_paper(rng):
    """T = phi'_F F^T + (J phi'_J + phi) I (paper: Cauchy-stress-polyconvex), with derivatives by hand."""
    K, G, eps = 3.0, 1.3, 0.4
    material = nv.NeoHookean(K_e=K, G_e=G, epsilon=eps)
    F = expm(0.4 * rng.standard_normal((3, 3)))
    J = 1.2 * np.linalg.det(F)  # J is a variable of its own
    S_F = 2 * G * J ** (-2 / 3) * F
    S_J = K * (J - 1 + eps / K) - 2 / 3 * G * J ** (-5 / 3) * np.sum(F * F) - eps / J
    phi = K / 2 * (J - 1 + eps / K) ** 2 + G * J ** (-2 / 3) * np.sum(F * F) - eps * np.log(J)
    z = {"F": F, "J": np.array(J)}
    assert energy(material, z) == pytest.approx(phi, rel=1e-13)
    assert stress(material, z) == pytest.approx(S_F @ F.T + (J * S_J + phi) * np.eye(3), rel=1e-12)
    FtS = F.T @ S_F
    assert mandel(material, z) == pytest.approx(trace_free(FtS + FtS.T) / 2, abs=1e-12)


@pytest.mark.parametrize("name", STRAIN)
def test_rotating_the_strain_rotates_the_stress_and_the_spin_is_powerless(name, rng):
    """S : (W E - E W) = 0, so that T is symmetric (paper: E:WS=E:SW)."""
    material, Q, z = STRAIN[name], random_rotation(rng), state(name, rng)
    T, star = stress(material, z), {"E": Q @ z["E"] @ Q.T}
    assert pytest.approx(T.T, abs=1e-11) == T
    assert energy(material, star) == pytest.approx(energy(material, z), rel=1e-13)
    assert stress(material, star) == pytest.approx(Q @ T @ Q.T, abs=1e-11)
    assert mandel(material, star) == pytest.approx(Q @ mandel(material, z) @ Q.T, abs=1e-11)


@pytest.mark.parametrize("name", FINITE)
def test_cauchy_stress_is_symmetric_and_the_derivative_of_energy(name):
    """T : A = d/dh [phi(F_h) J_h/J] at h = 0 with F_h = (I + h A) F, the power of a volume that moves with
    A."""
    material = FINITE[name]
    rng = np.random.default_rng(5)
    F = np.eye(3) + 0.2 * rng.uniform(-1, 1, (3, 3))
    A = rng.uniform(-1, 1, (3, 3))

    def referential(G):
        return energy_at(material, G) * np.linalg.det(G)

    h = 1e-5
    power = (referential(F + h * A @ F) - referential(F - h * A @ F)) / (2 * h) / np.linalg.det(F)
    T = at_point(cauchy_stress(material, constants(material, F)))
    scale = np.abs(T).max()
    if name != "CustomMaterial":  # all other examples are isotropic functions of F
        assert np.allclose(T, T.T, atol=1e-10 * scale)
    assert abs(np.sum(T * A) - power) < 1e-7 * scale


@pytest.mark.parametrize("name", FINITE)
def test_mandel_stress_is_trace_free_and_gives_the_power_of_creep(name):
    """M : P = -d/dh phi(F - h F P) at h = 0, or phi(F - h P F) for a rate P of the actual frame; J does not
    change."""
    material = FINITE[name]
    rng = np.random.default_rng(6)
    F = np.eye(3) + 0.2 * rng.uniform(-1, 1, (3, 3))
    P = rng.uniform(-1, 1, (3, 3))
    P = (P + P.T) / 2 - np.trace(P) / 3 * np.eye(3)
    z = constants(material, F)
    M = at_point(mandel_stress(material, z, conjugates(material, z), 3))

    h = 1e-5
    flow = P @ F if any(v.frame == "actual" for v in material.variables) else F @ P
    power = (energy_at(material, F + h * flow) - energy_at(material, F - h * flow)) / (2 * h)
    assert abs(np.trace(M)) < 1e-12
    assert np.allclose(M, M.T, atol=1e-12)
    assert abs(np.sum(M * P) - power) < 1e-7


REST_PRESSURE = {
    "NeoHookean": 3 * 5.0 + 0.1**2 / 20,
    "NeoHookean(kappa=ϰ)": 3 * 5.0 + 0.1 + (2 * 0.1) ** 2 / 20,
    "MooneyRivlin": 3 * 3.0 + 2 * 2.0 + 0.1**2 / 20,
    "ReferentialNeoHookean": 0.0,
    "ReferentialNeoHookean(epsilon=ε, kappa=ϰ)": 0.0,
    "IsochoricNeoHookean": 0.0,
    "LogarithmicNeoHookean": 0.0,
    "ReferentialMooneyRivlin": 0.0,
    "LogarithmicMooneyRivlin": 0.0,
    "BarotropicFluid": -0.4 * 10,
    'BarotropicFluid(form="A")': -0.4 * 10,
}


@pytest.mark.parametrize(("name", "stress"), REST_PRESSURE.items())
def test_stress_at_rest_is_as_documented(name, stress):
    material = EXAMPLES[name]
    T = at_point(cauchy_stress(material, constants(material, np.eye(3))))
    assert np.allclose(T, stress * np.eye(3), atol=1e-11)


MODULI = {  # usual bulk and shear moduli at rest by the docstrings; K_e = 10, G_e (+ G_mr) = 5, epsilon = 0.1
    "LinearElastic": (10.0, 5.0),
    "HardeningElastic": (10.0, 5.0),
    "IsotropicStrainEnergy": (10.0, 5.0),
    "NeoHookean": (10.0 + 0.1, 2 * 5.0),
    "NeoHookean(kappa=ϰ)": (10.0 + 2 * 3 * 0.1, 2 * 5.0),
    "MooneyRivlin": (10.0 + 0.1, 2 * (3.0 + 2.0)),
    "ReferentialNeoHookean": (10.0, 2 * 5.0),
    "ReferentialNeoHookean(epsilon=ε, kappa=ϰ)": (10.0 + 2 * 3 * 0.1, 2 * 5.0),
    "IsochoricNeoHookean": (10.0, 2 * 5.0),
    "LogarithmicNeoHookean": (10.0 + 0.1, 2 * 5.0),
    "ReferentialMooneyRivlin": (10.0, 2 * (3.0 + 2.0)),
    "LogarithmicMooneyRivlin": (10.0 + 0.1, 2 * (3.0 + 2.0)),
    "BarotropicFluid": (1.4 * 0.4 * 10, 0.0),
    'BarotropicFluid(form="A")': (1.4 * 0.4 * 10, 0.0),
    "Gent": (10.0, 2 * 5.0),
    "Ogden": (10.0, (10.0 * 1.3 + 0.5 * 4.0 + 0.5 * 2.0) / 2),
    "OldroydB": (10.0, 2 * 5.0),
    "FENEP": (10.0, 2 * 5.0),
    # (J phi)'' at J = 1 for F = J^(1/3) I, by hand
    "CustomMaterial": (3 * 3 * 10 / 9 + 2 * 3 * 28 / 9 + 2 * 10, 2 * (3.0 + 2.0)),
}


def by_F(name):
    """The row of the material by F to which a row by B belongs."""
    return name.replace(', elastic_state="B"', "").replace('(elastic_state="B")', "")


@pytest.mark.parametrize("name", EXAMPLES)
def test_moduli_at_rest_are_as_documented(name):
    """For F = I + h A the stress is T = T_rest + h (K tr A I + 2 G dev sym A) + O(h^2), which has no spin.

    K is dT/d ln J = -dp/d ln J in a dilation, and G is T_12 over the shear in a simple shear.
    """
    material, h = EXAMPLES[name], 1e-4
    bulk, shear = MODULI[by_F(name)]
    for seed in range(3):
        A = np.random.default_rng(seed).uniform(-1, 1, (3, 3))

        def stress(s, A=A):
            if name not in FINITE:
                return at_point(cauchy_stress(material, {"E": tensor(s * (A + A.T) / 2)}))
            return at_point(cauchy_stress(material, constants(material, np.eye(3) + s * A)))

        strain = (A + A.T) / 2 - np.trace(A) / 3 * np.eye(3)
        expected = bulk * np.trace(A) * np.eye(3) + 2 * shear * strain
        # the error is of fourth order; the energy |E|^3.5 of HardeningElastic adds an error of 10 h^1.5
        difference = (8 * (stress(h) - stress(-h)) - (stress(2 * h) - stress(-2 * h))) / (12 * h)
        assert np.allclose(difference, expected, atol=2e-4 if name == "HardeningElastic" else 1e-7)


def test_energies_are_the_closed_forms_of_the_isochoric_invariants():
    """F is random; the two referential neo-Hookean forms also have the same stress."""
    F = np.eye(3) + 0.3 * np.random.default_rng(9).uniform(-1, 1, (3, 3))
    J = np.linalg.det(F)
    iso = F / J ** (1 / 3)
    I_1, I_2 = np.sum(iso * iso), np.sum(np.linalg.inv(iso) ** 2)
    volume, with_log = 5 * (J - 1) ** 2, 5 * (J - 1 + 0.01) ** 2 - 0.1 * np.log(J)
    for name, expected in {
        "ReferentialNeoHookean": (volume + 5 * I_1) / J,
        "IsochoricNeoHookean": (volume + 5 * I_1) / J,
        "LogarithmicNeoHookean": (with_log + 5 * I_1) / J,
        "MooneyRivlin": with_log + 3 * I_1 + 2 * 2 / (3 * np.sqrt(3)) * I_2**1.5,
        "ReferentialMooneyRivlin": (volume + 3 * I_1 + 2 * I_2) / J,
        "LogarithmicMooneyRivlin": (with_log + 3 * I_1 + 2 * I_2) / J,
    }.items():
        assert energy_at(EXAMPLES[name], F) == pytest.approx(expected, rel=1e-13), name
    one, other = (EXAMPLES[f"{kind}NeoHookean"] for kind in ("Referential", "Isochoric"))
    T, S = (at_point(cauchy_stress(of, constants(of, F))) for of in (one, other))
    assert pytest.approx(S, abs=1e-12) == T


STRETCHES = (0.4, 0.9, 1.0, 1.3, 3.0, 7.0)
"""Stretches. A stretch of 7 in two directions leaves 1/49 in the third one, beyond the range of Ogden's
powers, 1/10 to 10."""
TRELOAR = {1.3: 0.63, 5.0: 0.0012, -2.0: -0.01}
"""mu_p, MPa, by alpha_p: Ogden's (1972) for the rubber of Treloar (1944)."""


def homogeneous(kind, stretch):
    """A distortion without a change of volume, and the principal stretches, the last one of a free side."""
    if kind == "shear":
        return np.eye(3) + (stretch - 1 / stretch) * np.eye(3)[[0]].T @ np.eye(3)[[1]], (stretch, 1 / stretch)
    across = stretch**-0.5 if kind == "uniaxial" else stretch**-2
    return np.diag([stretch, across if kind == "uniaxial" else stretch, across]), (stretch, across)


def stress_of(kind, T):
    """T_11 minus the stress of a free side, or the shear stress."""
    return T[0, 1] if kind == "shear" else T[0, 0] - T[2, 2]


@pytest.mark.parametrize("kind", ["uniaxial", "equibiaxial", "shear"])
def test_the_ogden_stress_equals_its_closed_form(kind):
    """sigma_1 - sigma_3 = sum mu (l_1^a - l_3^a) (Ogden 1972); in shear, T_12 is this difference times sin(2
    theta)/2 = 1/(l + 1/l)."""
    material = nv.Ogden(K_e=1e3, mu=tuple(TRELOAR.values()), alpha=tuple(TRELOAR))
    for stretch in STRETCHES[: 5 if kind == "equibiaxial" else 6]:
        F, (along, across) = homogeneous(kind, stretch)
        T = at_point(cauchy_stress(material, constants(material, F)))
        expected = sum(mu * (along**a - across**a) for a, mu in TRELOAR.items())
        expected /= along + across if kind == "shear" else 1.0
        scale = sum(abs(mu) * (along**a + across**a) for a, mu in TRELOAR.items())
        assert abs(stress_of(kind, T) - expected) < 1e-5 * scale, stretch


@pytest.mark.parametrize("elastic_state", ["F", "B"])
@pytest.mark.parametrize("kind", ["uniaxial", "equibiaxial", "shear"])
def test_the_gent_stress_equals_its_closed_form(kind, elastic_state):
    """sigma_1 - sigma_3 = 2 G_e J_m/(J_m - I_1 + 3) (l_1^2 - l_3^2) (Gent 1996), and T_12 with the shear
    gamma instead of l_1^2 - l_3^2."""
    material = nv.Gent(K_e=1e3, G_e=0.135, J_m=77.0, elastic_state=elastic_state)
    for stretch in STRETCHES:
        F, (along, across) = homogeneous(kind, stretch)
        T = at_point(cauchy_stress(material, constants(material, F)))
        if (slack := 77.0 - np.sum(F * F) + 3) < 0:
            assert np.isnan(T).any()  # the chains cannot be as long as this
            continue
        strain = F[0, 1] if kind == "shear" else along**2 - across**2
        assert stress_of(kind, T) == pytest.approx(0.27 * 77.0 / slack * strain, abs=1e-11)


def test_ogden_with_exponents_of_two_is_mooney_rivlin(rng):
    """Ogden's energy with mu_1 = 2 C_10 and mu_2 = -2 C_01 equals C_10 |F_iso|^2 + C_01 |Cof F_iso|^2, also
    with a change of volume."""
    F = np.eye(3) + 0.3 * rng.uniform(-1, 1, (3, 3))
    J = np.linalg.det(F)
    iso = F / J ** (1 / 3)
    chains = 3 * (np.sum(iso * iso) - 3) + 2 * (np.sum(np.linalg.inv(iso) ** 2) - 3)
    for state in ("F", "B"):
        material = nv.Ogden(K_e=10.0, mu=(6.0, -4.0), alpha=(2.0, -2.0), elastic_state=state)
        assert energy_at(material, F) == pytest.approx(5 * (J - 2 + 1 / J) + chains, rel=1e-13)


@pytest.mark.parametrize(
    ("field", "said", "given"),
    [
        ("alpha", "1 <= |alpha| <= 12", {"mu": (1.0,), "alpha": (0.5,)}),
        ("alpha", 'with elastic_state = "F"', {"mu": (1.0,), "alpha": (1.3,), "elastic_state": "B"}),
        ("alpha", "distinct exponents", {"mu": (1.0, 1.0), "alpha": (2.0, 2.0)}),
        ("mu", "at least one number", {"mu": (), "alpha": (2.0,)}),
        ("mu", "as many moduli as exponents, 2", {"mu": (1.0, 1.0, 1.0), "alpha": (2.0, 4.0)}),
        ("alpha", "as many exponents as moduli, 1", {"mu": (1.0,), "alpha": (2.0, 4.0)}),
        ("mu", "the sign of its exponent", {"mu": (1.0,), "alpha": (-2.0,)}),
    ],
)
def test_ogden_refuses_parameters_that_make_its_energy_not_convex(field, said, given):
    with pytest.raises(nv.ParameterError, match=re.escape(said)) as raised:
        nv.Ogden(K_e=1.0, **given)
    assert raised.value.field == f"Ogden.{field}"


@pytest.mark.parametrize("form", ["J", "A"])
def test_the_barotropic_pressure_is_a_power_of_the_density(form):
    """The Cauchy stress -p I has p = a rho^gamma with a = (gamma - 1) B/rho_R^gamma."""
    a, gamma, rho_R = 3.0, 1.7, 2.5
    fluid = nv.BarotropicFluid.from_state_equation(a, gamma, rho_R, form)
    for rho in (0.4, 2.5, 6.0):
        start = {name: CF(float(at_point(value))) for name, value in fluid.start(rho, rho_R).items()}
        T = at_point(cauchy_stress(fluid, start))
        assert np.allclose(T, -a * rho**gamma * np.eye(3), rtol=1e-12)


@pytest.mark.parametrize("s", [3.0, 3.5, 4.0, 6.0])
@pytest.mark.parametrize("size", [0.1, 1e4])
def test_hardening_has_the_documented_powers_of_strain(s, size):
    material = nv.HardeningElastic(K_e=2.0, G_e=3.0, K_h=5.0, G_h=7.0, s=s)
    E = size * np.array([[1.0, 0.5, 0], [0.5, -2.0, 0], [0, 0, 0.3]])
    trace, deviator = abs(np.trace(E)), np.linalg.norm(E - np.trace(E) / 3 * np.eye(3))
    quadratic = 0.5 * 2.0 * trace**2 + 3.0 * deviator**2
    hardening = 5.0 / s * trace**s + 2 * 7.0 / s * deviator**s
    assert energy(material, {"E": E}) == pytest.approx(quadratic + hardening, rel=1e-12)


def test_the_singular_part_is_linear_below_J_min_and_unchanged_above():
    plain = nv.ReferentialNeoHookean(K_e=10, G_e=5)
    material = nv.ReferentialNeoHookean(K_e=10, G_e=5, J_min=0.5)
    H = tensor(np.eye(3))

    def energy(m, J):
        return at_point(m.energy({"H": H, "J": Parameter(J)}))

    def slope(m, J):
        return at_point(conjugates(m, {"H": H, "J": Parameter(J)})["J"])

    for J in (0.5, 0.6, 2.0):
        assert math.isclose(energy(material, J), energy(plain, J), rel_tol=1e-14)
        assert math.isclose(slope(material, J), slope(plain, J), rel_tol=1e-14, abs_tol=1e-14)
    for J in (0.3, 0.0, -1.0):
        assert math.isclose(slope(material, J), slope(plain, 0.5), rel_tol=1e-14)
        expected = energy(plain, 0.5) + slope(plain, 0.5) * (J - 0.5)
        assert math.isclose(energy(material, J), expected, rel_tol=1e-13)


# the test in three dimensions contains the states of plane strain
@pytest.mark.parametrize("dim", [by_ci(2), 3])
@pytest.mark.parametrize("name", EXAMPLES)
def test_energy_is_jointly_convex(name, dim):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = nv.check_convexity(EXAMPLES[name], dim=dim)
    assert report.passed
    assert report.samples > 1000


@pytest.mark.parametrize("exponent, convex", [(-0.5, True), (-1.0, True), (-1.6, False), (0.5, False)])
def test_the_convexity_check_finds_an_exponent_outside_its_range(exponent, convex):
    """J^-a |F|^2 is jointly convex for 0 <= a <= 1 only."""
    material = nv.CustomMaterial(
        transported=(Distortion(), Jacobian()),
        stored_energy=lambda F, J: J**exponent * square(F) + 1e-3 * (J - 1) * (J - 1),
    )
    assert nv.check_convexity(material, warn=False).passed == convex


def test_non_convex_energy_warns_with_the_point():
    """J^{-5/3} |F|^2 is not convex in (F, J) (paper: convexity-neo-Hookean with p = 5/3)."""
    material = nv.CustomMaterial(
        transported=(Distortion(), Jacobian()),
        stored_energy=lambda F, J: 5 * (J - 2 + 1 / J) + 5 * J ** (-5 / 3) * square(F),
    )
    said = r"not convex at F = .*a motion can reach this state, whose distance from rest is \S+ in the norm"
    with pytest.warns(nv.ConvexityWarning, match=f"(?s){said}"):
        report = nv.check_convexity(material)
    assert not report.passed
    # the violation is real: phi(b) < phi(a) + phi'(a):(b - a), evaluated without the sampler
    F, J = report.point["F"], float(report.point["J"])
    dF, dJ = report.direction["F"], float(report.direction["J"])

    def phi(F, J):
        return 5 * (J - 2 + 1 / J) + 5 * J ** (-5 / 3) * np.sum(F * F)

    slope = 10 * J ** (-5 / 3) * np.sum(F * dF) + dJ * (5 - 5 / J**2 - 25 / 3 * J ** (-8 / 3) * np.sum(F * F))
    assert phi(F + dF, J + dJ) - phi(F, J) - slope < -1e-9
    assert report.reachable and pytest.approx(np.linalg.det(F), rel=1e-12) == J
    rest = np.concatenate([np.eye(3).ravel(), [1.0]])
    at = np.concatenate([F.ravel(), [J]])
    assert report.distance == pytest.approx(np.linalg.norm(at - rest), rel=1e-12)
    near = nv.check_convexity(material, warn=False, states=np.array([at + 0.01, rest]))
    assert near.distance == pytest.approx(0.01 * 10**0.5) and "the run's start" in str(near)


def test_simulation_warns_of_a_users_energy_that_is_not_convex():
    material = nv.CustomMaterial(
        transported=(Jacobian(),), stored_energy=lambda J: 1 / J - 3 * (J - 1) * (J - 1)
    )
    with pytest.warns(nv.ConvexityWarning):
        nv.Simulation(MESH, nv.Model(material=material), dt=0.1)


WRAPPERS = {"Damaged", "Network", "PerMass", "PerReferentialVolume", "Thermal", "WithQuadratic", "Yosida"}
"""Materials that wrap another material."""


def test_table_lists_every_material_with_a_label_of_the_paper():
    lines = table().splitlines()
    assert len(lines) == 2 + len(examples())
    for example, line in zip(examples(), lines[2:], strict=True):
        assert line.startswith(f"| `{example.constructor}` |")
        assert f"`{example.paper}`" in line or (example.paper is None and line.endswith("— |"))
    classes = {type(example.material).__name__ for example in examples()}
    exported = {
        name
        for name in nv.__all__
        if isinstance(getattr(nv, name), type) and issubclass(getattr(nv, name), nv.Material)
    }
    assert classes == exported - WRAPPERS - {"Material"}


@pytest.mark.parametrize(
    ("energy", "passes"),
    [
        (lambda J: J + 1 / J, True),  # only J > 0 counts: 1/J is not convex across J = 0
        (lambda J: (J - 1) ** 2.0, True),
        (lambda J: 1 / J - J * J, False),  # this energy is concave for J > 1
    ],
)
def test_convexity_is_required_in_the_energy_s_domain_only(energy, passes):
    material = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=energy)
    assert nv.check_convexity(material, dim=2, warn=False).passed is passes


def test_the_volumetric_energy_keeps_its_digits_near_J_of_one():
    """K_e/2 (J - 2 + 1/J) would have an error of K_e times the rounding of 1, which is 1e4 times the energy
    at J = 1 + 1e-10."""
    for J in (1 + 2.0**-33, 1 - 2.0**-33):
        assert referential_volume(1e10, 0.0, 1.0, J, None) == pytest.approx(0.5e10 * 2.0**-66 / J, rel=1e-15)
    slight = nv.LogarithmicNeoHookean(K_e=1e10, G_e=1e-15, epsilon=1e-15)
    F = (1 + 2.0**-33) ** (1 / 3) * np.eye(3)
    assert energy_at(slight, F) == pytest.approx(0.5e10 * 2.0**-66, rel=1e-2)
