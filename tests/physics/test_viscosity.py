"""General linear viscosity: one D in three notations, its checks, and its powers."""

import numpy as np
import pytest
from support import tensor, value

import ngvisco as nv
from ngvisco.physics.rheology import PAIRS, full_tensor

RNG = np.random.default_rng(4)
ROOT = RNG.standard_normal((6, 6))
MANDEL = ROOT @ ROOT.T
LAW = nv.LinearViscosity(D=MANDEL, notation="mandel")
TRACE = np.array([1, 1, 1, 0, 0, 0])


def symmetric():
    A = RNG.standard_normal((3, 3))
    return 0.5 * (A + A.T)


def vector(A, weight):
    """Six entries of a tensor, those off the diagonal times a weight."""
    return np.array([A[i, j] * (1.0 if i == j else weight) for i, j in PAIRS])


def isotropic(K, G):
    sph = np.einsum("ij,kl->ijkl", np.eye(3), np.eye(3)) / 3
    one = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))
    one = 0.5 * (one + one.transpose(1, 0, 2, 3))
    return 3 * K * sph + 2 * G * (one - sph)


def test_every_notation_is_the_map_that_its_definition_says():
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


def test_the_two_powers_add_up_to_the_dissipation():
    for _ in range(5):
        e = symmetric()
        total = value(LAW.bulk_dissipation(tensor(e), {})) + value(LAW.shear_dissipation(tensor(e), {}))
        assert total == pytest.approx(np.sum(value(LAW.stress(tensor(e), {})) * e), rel=1e-12)
        assert total >= 0


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
        (MANDEL + np.eye(6, k=1), "mandel", "a symmetric D: there is"),
        (np.eye(6) - 0.5 * np.outer(TRACE, TRACE), "mandel", "it is -0.5 for e_11"),
        (np.eye(3), "mandel", r"6x6 finite numbers"),
        (np.eye(6), "tensor", r"3x3x3x3 finite numbers"),
        (np.eye(6) * np.nan, "voigt", r"6x6 finite numbers"),
        ([[1.0], [2.0, 3.0]], "voigt", r"6x6 finite numbers"),
        ("many", "voigt", r"6x6 finite numbers"),
        (np.eye(6), "kelvin", "one of mandel, voigt, tensor"),
    ],
)
def test_wrong_D_is_refused_with_what_is_wrong(D, notation, words):
    with pytest.raises(nv.ParameterError, match=words):
        nv.LinearViscosity(D=D, notation=notation)


def test_semidefinite_D_passes():
    nv.LinearViscosity(D=np.zeros((6, 6)), notation="mandel")
    nv.LinearViscosity(D=np.diag([1.0, 0, 0, 0, 0, 0]), notation="voigt")
    assert nv.LinearViscosity(D=np.eye(6), notation="mandel") == nv.LinearViscosity(
        D=np.eye(6).tolist(), notation="mandel"
    )
