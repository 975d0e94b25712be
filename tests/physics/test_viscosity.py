"""Viscosities: one D in three notations, state-dependent viscosities, refused viscosities."""

from dataclasses import dataclass

import numpy as np
import pytest
from support import tensor, value

import ngvisco as nv
from ngvisco.physics.activation import GAS_CONSTANT
from ngvisco.physics.arrays import TINY, Array
from ngvisco.physics.rheology import PAIRS, full_tensor
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import PRESSURE, TEMPERATURE

RNG = np.random.default_rng(4)
ROOT = RNG.standard_normal((6, 6))
MANDEL = ROOT @ ROOT.T
LAW = nv.LinearViscosity(D=MANDEL, notation="mandel")
TRACE = np.array([1, 1, 1, 0, 0, 0])


def symmetric():
    A = RNG.standard_normal((3, 3))
    return 0.5 * (A + A.T)


def vector(A, weight):
    """The six entries of a symmetric tensor; off-diagonal entries are multiplied by a weight."""
    return np.array([A[i, j] * (1.0 if i == j else weight) for i, j in PAIRS])


def isotropic(K, G):
    sph = np.einsum("ij,kl->ijkl", np.eye(3), np.eye(3)) / 3
    one = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))
    one = 0.5 * (one + one.transpose(1, 0, 2, 3))
    return 3 * K * sph + 2 * G * (one - sph)


def test_every_notation_of_a_viscosity_gives_the_stress_of_its_definition():
    e = symmetric()
    in_mandel = value(LAW.stress(tensor(e), {}))
    assert vector(in_mandel, 2**0.5) == pytest.approx(MANDEL @ vector(e, 2**0.5), rel=1e-13)
    voigt = RNG.standard_normal((6, 6))
    voigt = voigt @ voigt.T
    in_voigt = value(nv.LinearViscosity(D=voigt, notation="voigt").stress(tensor(e), {}))
    assert vector(in_voigt, 1) == pytest.approx(voigt @ vector(e, 2), rel=1e-13)
    D = full_tensor(MANDEL)
    found = value(nv.LinearViscosity(D=D, notation="tensor").stress(tensor(e), {}))
    assert found == pytest.approx(np.einsum("ijkl,kl->ij", D, e), rel=1e-13)
    assert found == pytest.approx(in_mandel, rel=1e-13)


def test_isotropic_D_is_the_stokes_viscosity():
    law = nv.LinearViscosity(D=isotropic(3.0, 0.7), notation="tensor")
    plain = nv.StokesViscosity(K_v=3.0, G_v=0.7)
    e = tensor(symmetric())
    assert (law.K_v, law.G_v) == (pytest.approx(3.0), pytest.approx(0.7))
    for name in ("stress", "bulk_dissipation", "shear_dissipation"):
        assert value(getattr(law, name)(e, {})) == pytest.approx(
            value(getattr(plain, name)(e, {})), rel=1e-13
        )
    # K_v + 4/3 G_v and G_v stand where the docstring says
    voigt = np.array([[isotropic(3.0, 0.7)[*a, *b] for b in PAIRS] for a in PAIRS])
    assert voigt[0, 0] == pytest.approx(3 + 4 / 3 * 0.7) and voigt[3, 3] == pytest.approx(0.7)
    assert nv.LinearViscosity(D=voigt, notation="voigt").mandel == pytest.approx(law.mandel)


def changed(at, by):
    D = full_tensor(MANDEL).copy()
    D[at] += by
    return D


@pytest.mark.parametrize(
    ("D", "notation", "words"),
    [
        (changed((0, 1, 2, 2), 0.1), "tensor", r"D_ijkl = D_jikl"),
        (changed((0, 0, 1, 2), 0.1), "tensor", r"D_ijkl = D_ijlk"),
        (changed((0, 0, 1, 1), 0.1), "tensor", r"at 1122': expected D_ijkl = D_klij"),
        (MANDEL + np.eye(6, k=1), "mandel", "a symmetric D, but the opposite entry is"),
        (np.eye(6) - 0.5 * np.outer(TRACE, TRACE), "mandel", "the value is -0.5 for e_11"),
        (np.eye(3), "mandel", r"6x6 finite numbers"),
        (np.eye(6), "tensor", r"3x3x3x3 finite numbers"),
        (np.eye(6) * np.nan, "voigt", r"6x6 finite numbers"),
        ([[1.0], [2.0, 3.0]], "voigt", r"6x6 finite numbers"),
        ("many", "voigt", r"6x6 finite numbers"),
        (np.eye(6), "kelvin", "one of mandel, voigt, tensor"),
    ],
)
def test_a_wrong_D_is_refused_with_the_reason(D, notation, words):
    with pytest.raises(nv.ParameterError, match=words):
        nv.LinearViscosity(D=D, notation=notation)


def test_a_semidefinite_D_is_accepted():
    nv.LinearViscosity(D=np.zeros((6, 6)), notation="mandel")
    nv.LinearViscosity(D=np.diag([1.0, 0, 0, 0, 0, 0]), notation="voigt")
    assert nv.LinearViscosity(D=np.eye(6), notation="mandel") == nv.LinearViscosity(
        D=np.eye(6).tolist(), notation="mandel"
    )


SHEAR = np.array([[0.0, 0.5, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
"""The strain rate of a shear rate of 1/s."""
PLAIN = nv.StokesViscosity(K_v=1.0, G_v=2.0)
LAWS = {
    "power law": nv.PowerLaw(K_v=1.0, consistency=2.0, n=0.4, floor=1e-12),
    "Carreau": nv.Carreau(K_v=1.0, G_0=2.0, G_inf=0.5, relaxation=3.0, n=0.4),
    "Cross": nv.Cross(K_v=1.0, G_0=2.0, G_inf=0.5, relaxation=3.0, m=0.7),
    "activated": nv.ActivatedViscosity(viscosity=PLAIN, E=2e4, theta_R=300.0, V=1e-6),
}


def stress(law, eps, pressure=0.0, temperature=300.0):
    read = {PRESSURE: pressure, TEMPERATURE: temperature}
    z = {name: Array(np.array([value]), None) for name, value in read.items()}
    return law.stress(Array(np.asarray(eps)[..., None], None), z).value[..., 0]


@pytest.mark.parametrize(
    ("name", "rate", "expected"),
    [
        ("power law", 3.0, 2.0 * 3.0**0.4),
        ("Carreau", 4.0, (0.5 + 1.5 * 145.0**-0.3) * 4.0),
        ("Cross", 4.0, (0.5 + 1.5 / (1 + 12.0**0.7)) * 4.0),
        ("activated", 4.0, 8.0),
    ],
)
def test_shear_stresses_equal_the_formulas_of_the_literature(name, rate, expected):
    assert stress(LAWS[name], rate * SHEAR)[0, 1] == pytest.approx(expected, rel=1e-8)
    assert stress(LAWS[name], np.eye(3)) == pytest.approx(3.0 * np.eye(3), rel=1e-12)


def test_the_activation_factor_follows_arrhenius_and_barus():
    warm = stress(LAWS["activated"], SHEAR, pressure=1e6, temperature=350.0)[0, 1]
    assert warm == pytest.approx(
        2.0 * np.exp((2e4 + 1.0) / (GAS_CONSTANT * 350) - 2e4 / (GAS_CONSTANT * 300))
    )
    rule = nv.Activated(rule=nv.Norton(A=0.3, n=3), E=2e4, theta_R=300.0, V=1e-6)
    M = Array(SHEAR[..., None], None)
    z = {PRESSURE: Array(np.array([1e6]), None), TEMPERATURE: Array(np.array([350.0]), None)}
    factor = 2.0 / warm
    Pi = rule.rate(M, None, z)
    assert Pi.value == pytest.approx(factor * rule.rule.rate(M, None, z).value, rel=1e-13)
    assert rule.force(Pi, z).value == pytest.approx(M.value, rel=1e-9)  # psi has the same factor


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("rate", [1e-6, 1.0])
def test_slopes_by_complex_increments_equal_central_differences(name, rate):
    law, along, h = LAWS[name], SHEAR + np.diag([0.5, 0.3, -0.2]), 1e-5 * rate
    of_increment = stress(law, rate * SHEAR + 1j * TINY * along).imag / TINY
    difference = (stress(law, rate * SHEAR + h * along) - stress(law, rate * SHEAR - h * along)) / (2 * h)
    assert of_increment == pytest.approx(difference, rel=1e-6, abs=1e-7 * abs(difference).max())


@dataclass(frozen=True, kw_only=True)
class Odd(nv.StokesViscosity):
    """A viscosity that gives energy, or whose stress falls with the strain rate."""

    falls: bool = False

    def stress(self, eps, z):
        return 1 / (1 + square(eps)) * eps if self.falls else -1.0 * eps


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: model(LAWS["activated"]), "ActivatedViscosity.temperature.*nv.Thermal"),
        (lambda: model(Odd(K_v=1, G_v=1)), r"Odd.stress.*D\(eps\) : eps/\|eps\| >= 0"),
        (lambda: model(Odd(K_v=1, G_v=1, falls=True)), "Odd.stress = -.*a rise >= 0 of the stress along eps"),
        (lambda: model(nv.Carreau(K_v=1, G_0=1, G_inf=20, relaxation=1, n=4)), "Carreau.stress"),
    ],
)
def test_an_invalid_viscosity_is_refused_by_name(make, words):
    with pytest.raises(nv.ParameterError, match=words):
        make()


def model(viscosity):
    return nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=1.0), viscosity=viscosity)


@pytest.mark.parametrize("name", ["power law", "Carreau", "Cross"])
def test_a_model_accepts_every_shipped_viscosity(name):
    model(LAWS[name])
