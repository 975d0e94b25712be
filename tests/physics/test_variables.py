"""Kinematic rates against the time-integrated equation of their distortion."""

import numpy as np
import pytest
from ngsolve import CoefficientFunction
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from support import random_rotation, tensor, tensors, trace_free, value

from ngvisco.physics.tensors import log_det
from ngvisco.physics.variables import (
    Cofactor,
    CofactorLeftCauchyGreen,
    Distortion,
    Jacobian,
    LeftCauchyGreen,
    LogJacobian,
    ReciprocalJacobian,
    SmallStrain,
    Variable,
)

MOONEY_RIVLIN = Cofactor(exponent=-7 / 6)
EXPONENTS = (-7 / 6, -5 / 6, -1 / 3, 0.0, 0.7)
LISTS = {
    "J": [Jacobian()],
    "A": [ReciprocalJacobian()],
    "K": [ReciprocalJacobian(), LogJacobian()],
    **{f"J^{a:.3g} F": [Distortion(exponent=a)] for a in EXPONENTS},
    **{f"J^{b:.3g} Cof F": [Cofactor(exponent=b)] for b in EXPONENTS},
}
SPATIAL: dict[str, Variable] = {
    **{f"J^{a:.3g} F F^T": LeftCauchyGreen(exponent=a) for a in (-5 / 3, -2 / 3, 0.0, 0.7)},
    **{f"J^{b:.3g} Cof(F F^T)": CofactorLeftCauchyGreen(exponent=b) for b in (-7 / 3, -4 / 3, 0.0, 0.7)},
}
TIME = 0.7


def motion(seed: int, creep: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Constant L and Pi, and F at time 0."""
    rng = np.random.default_rng(seed)
    L, A = rng.standard_normal((2, 3, 3))
    F_0 = expm(0.4 * rng.standard_normal((3, 3)))
    return L, trace_free(A + A.T) / 2 if creep else np.zeros((3, 3)), F_0


def integrate(rate, start: np.ndarray) -> np.ndarray:
    solution = solve_ivp(rate, (0, TIME), start, method="DOP853", rtol=1e-12, atol=1e-13)
    return solution.y[:, -1]


def distortion(L: np.ndarray, Pi: np.ndarray, F_0: np.ndarray, spatial: bool = False) -> np.ndarray:
    """F at TIME by the equation dF/dt = L F - F Pi, or dF/dt = (L - Pi) F if ``spatial``."""

    def rate(t: float, F: np.ndarray) -> np.ndarray:
        F = F.reshape(3, 3)
        return (L @ F - (Pi @ F if spatial else F @ Pi)).ravel()

    return integrate(rate, F_0.ravel()).reshape(3, 3)


def pack(variables: list[Variable], F: np.ndarray) -> np.ndarray:
    return np.concatenate([value(v.from_distortion(tensor(F))).ravel() for v in variables])


def unpack(variables: list[Variable], flat: np.ndarray) -> dict[str, np.ndarray]:
    shapes = [() if v.kind == "scalar" else (3, 3) for v in variables]
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    parts = np.split(flat, ends[:-1])
    return {v.name: p.reshape(s) for v, p, s in zip(variables, parts, shapes, strict=True)}


def rates(variables: list[Variable], flat: np.ndarray, L: np.ndarray, Pi: np.ndarray) -> np.ndarray:
    z = tensors(unpack(variables, flat))
    return np.concatenate([value(v.rate(z, tensor(L), tensor(Pi))).ravel() for v in variables])


def linear_rate(variables: list[Variable], size: int, L: np.ndarray, Pi: np.ndarray):
    """The rates as an affine map of the values: matrix and constant part."""
    constant = rates(variables, np.zeros(size), L, Pi)
    columns = [rates(variables, e, L, Pi) - constant for e in np.eye(size)]
    return np.array(columns).T, constant


def transported(
    variables: list[Variable],
    L: np.ndarray,
    Pi: np.ndarray,
    F_0: np.ndarray,
    by: list[Variable] | None = None,
) -> np.ndarray:
    """The variables at TIME, integrated from their values at F_0 by their own rates, or by the rates of
    ``by``."""
    start = pack(variables, F_0)
    A, b = linear_rate(by or variables, start.size, L, Pi)
    return integrate(lambda t, z: A @ z + b, start)


@pytest.mark.parametrize("creep", [False, True], ids=["elastic", "creep"])
@pytest.mark.parametrize("name", [*LISTS, *SPATIAL])
def test_rate_follows_the_integrated_distortion(name: str, creep: bool) -> None:
    """The start F_0 is not coaxial with L and Pi; the rate of another exponent is detected."""
    variables = LISTS.get(name) or [SPATIAL[name]]
    L, Pi, F_0 = motion(0, creep)
    expected = pack(variables, distortion(L, Pi, F_0, spatial=name in SPATIAL))
    assert transported(variables, L, Pi, F_0) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    if name not in ("J", "A", "K"):
        other = type(variables[0])(exponent=variables[0].exponent + 0.1)
        wrong = transported(variables, L, Pi, F_0, [other])
        assert np.abs(wrong - expected).max() > 1e-2 * np.abs(expected).max()


# --- left Cauchy-Green tensors -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "eigenvalues", [(-1.0, 1, 1), (1, -1.0, 1), (1, 1, -1.0), (-1.0, -1.0, 1), (1, -1.0, -1.0), (-1, 1, -1.0)]
)
def test_minors_find_every_tensor_that_is_not_positive_definite(eigenvalues: tuple[float, ...]) -> None:
    """Tensors with two negative eigenvalues, whose determinant is positive, are detected too; ln det of each
    of these tensors is NaN."""
    Q = random_rotation(np.random.default_rng(14))
    B = tensor(Q @ np.diag(eigenvalues) @ Q.T)
    assert min(float(value(m)) for m in LeftCauchyGreen().positive(B).values()) < 0
    assert np.isnan(value(log_det(B)))
    good = tensor(Q @ np.diag(np.abs(eigenvalues) * (1, 2, 3)) @ Q.T)
    assert min(float(value(m)) for m in LeftCauchyGreen().positive(good).values()) > 0
    assert float(value(log_det(good))) == pytest.approx(np.log(6), rel=1e-12)


class PrintedMooneyRivlin(Cofactor):
    """The rate as the paper prints it: (Cof' F)((grad v) H - H Pi) - 7/6 (div v) H.

    Here Cof' F is the derivative of Cof at F, in the direction (grad v) H - H Pi.
    """

    F: np.ndarray

    def rate(self, z, L: CoefficientFunction, Pi: CoefficientFunction) -> CoefficientFunction:
        H, F = value(z[self.name]), self.F
        G = value(L) @ H - H @ value(Pi)
        J, inverse = np.linalg.det(F), np.linalg.inv(F)
        derivative = J * (np.trace(inverse @ G) * inverse.T - inverse.T @ G.T @ inverse.T)
        return tensor(derivative - 7 / 6 * np.trace(value(L)) * H)


def test_the_mooney_rivlin_rate_printed_in_the_paper_is_wrong() -> None:
    """The printed rate differs from the derivative of J^{-7/6} Cof F by a number of order one. The package's
    rate equals the derivative."""
    L, Pi, F_0 = motion(6, True)
    h = 1e-4

    def H(t: float) -> np.ndarray:
        F = F_0 + t * (L @ F_0 - F_0 @ Pi)
        return value(MOONEY_RIVLIN.from_distortion(tensor(F)))

    derivative = (8 * (H(h) - H(-h)) - (H(2 * h) - H(-2 * h))) / (12 * h)
    z = {"H": tensor(H(0))}
    assert value(MOONEY_RIVLIN.rate(z, tensor(L), tensor(Pi))) == pytest.approx(derivative, abs=1e-9)
    printed = PrintedMooneyRivlin(exponent=-7 / 6)
    object.__setattr__(printed, "F", F_0)
    miss = np.abs(value(printed.rate(z, tensor(L), tensor(Pi))) - derivative).max()
    assert miss > 0.1 * np.abs(derivative).max()


# --- the small strain and the Zaremba-Jaumann rate --------------------------------------------------


def zaremba_jaumann(L: np.ndarray, Pi: np.ndarray, E_0: np.ndarray, t: float) -> np.ndarray:
    """E(t) = Q E_0 Q^T + int_0^t Q(t-s) (eps(v) - Pi) Q(t-s)^T ds with Q(t) = exp(t W), closed form."""
    W, D = (L - L.T) / 2, (L + L.T) / 2 - Pi
    nodes, weights = np.polynomial.legendre.leggauss(30)
    Q = expm(t * W)
    E = Q @ E_0 @ Q.T
    for node, weight in zip(nodes, weights, strict=True):
        Q = expm(0.5 * t * (1 + node) * W)
        E = E + 0.5 * t * weight * Q @ D @ Q.T
    return E


@pytest.mark.parametrize("creep", [False, True], ids=["elastic", "creep"])
def test_small_strain_follows_the_zaremba_jaumann_equation(creep: bool) -> None:
    for seed in range(3):
        L, Pi, F_0 = motion(seed, creep)
        expected = zaremba_jaumann(L, Pi, value(SmallStrain().from_distortion(tensor(F_0))), TIME)
        result = transported([SmallStrain()], L, Pi, F_0).reshape(3, 3)
        assert result == pytest.approx(expected, abs=1e-9)


def test_zaremba_jaumann_rate_is_objective() -> None:
    """E* = Q(t) E Q(t)^T obeys the same equation with L* = Q L Q^T + Q' Q^T and Pi* = Q Pi Q^T."""
    rng = np.random.default_rng(8)
    L, Pi, F_0 = motion(8, True)
    spin = rng.standard_normal((3, 3))
    spin = spin - spin.T
    Q = random_rotation(rng)
    E = (F_0 + F_0.T) / 2
    rate = rates([SmallStrain()], E.ravel(), L, Pi).reshape(3, 3)
    # this is the derivative of Q E Q^T with Q' = spin Q
    expected = spin @ Q @ E @ Q.T + Q @ rate @ Q.T - Q @ E @ Q.T @ spin
    E_star, L_star, Pi_star = Q @ E @ Q.T, Q @ L @ Q.T + spin, Q @ Pi @ Q.T
    assert rates([SmallStrain()], E_star.ravel(), L_star, Pi_star).reshape(3, 3) == pytest.approx(
        expected, abs=1e-12
    )
    # a control: a rate without the spin is not objective
    assert np.abs(expected - ((L_star + L_star.T) / 2 - Pi_star)).max() > 0.1


# --- plane strain ------------------------------------------------------------------------------------


# --- the row of H = Cof F as the paper prints it ---------------------------------------------------------


def cofactor(F: np.ndarray) -> np.ndarray:
    return np.linalg.det(F) * np.linalg.inv(F).T


def printed(F: np.ndarray, L: np.ndarray, Pi: np.ndarray) -> np.ndarray:
    """Cof'(F)(L F - F Pi), by a central difference."""
    step, along = 1e-5, L @ F - F @ Pi
    return (cofactor(F + step * along) - cofactor(F - step * along)) / (2 * step)


def test_the_printed_cofactor_equation_equals_ours_where_H_is_the_cofactor_of_F() -> None:
    """The equation of H in Euler-large-viscoelastodyn-H contains F^k. For H = Cof F it equals the package's
    equation, for any L and Pi."""
    rng = np.random.default_rng(3)
    for _ in range(3):
        F, L = np.eye(3) + 0.3 * rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
        Pi = trace_free(rng.normal(size=(3, 3)))
        ours = value(Cofactor().rate({"H": tensor(cofactor(F))}, tensor(L), tensor(Pi))).reshape(3, 3)
        assert np.allclose(ours, printed(F, L, Pi), rtol=1e-8, atol=1e-8)
        other = value(Cofactor().rate({"H": tensor(1.1 * cofactor(F))}, tensor(L), tensor(Pi))).reshape(3, 3)
        assert not np.allclose(other, printed(F, L, Pi), rtol=1e-2)


def after_one_second(steps: int, L: np.ndarray, with_F: bool) -> np.ndarray:
    """H after one second of a homogeneous flow, by implicit Euler steps whose equation of H contains F^k or
    H^k."""
    tau, F, H = 1 / steps, np.eye(3), np.eye(3)
    for _ in range(steps):
        F = np.linalg.solve(np.eye(3) - tau * L, F)
        if with_F:
            H = H + tau * (np.trace(L) * cofactor(F) - L.T @ cofactor(F))
        else:
            H = np.linalg.solve((1 - tau * np.trace(L)) * np.eye(3) + tau * L.T, H)
    return H


def test_the_printed_cofactor_equation_differs_from_ours_by_the_order_of_the_step() -> None:
    """The H of the printed equation and the package's H differ from Cof F^k by similar errors of first order
    in tau."""
    L = np.array([[0.3, 1.0, 0.2], [-0.4, 0.1, 0.5], [0.2, -0.3, -0.1]])
    exact = cofactor(expm(L))
    size, between, errors = np.linalg.norm(exact), [], []
    for steps in (20, 40, 80):
        ours, theirs = (after_one_second(steps, L, with_F) for with_F in (False, True))
        between.append(np.linalg.norm(ours - theirs) / size)
        errors.append([np.linalg.norm(H - exact) / size for H in (ours, theirs)])
    assert 1.9 <= between[-2] / between[-1] <= 2.1
    assert all(1.9 <= coarse / fine <= 2.1 for coarse, fine in zip(errors[-2], errors[-1], strict=True))
    assert between[-1] <= min(errors[-1])
