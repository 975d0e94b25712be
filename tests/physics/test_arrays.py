"""Arrays at points: derivatives of energies, forms that are linear in tests, and unsupported operations."""

import math

import ngsolve
import numpy as np
import pytest
from ngsolve import CF
from support import one_triangle

from ngvisco.physics.arrays import Array, Linear, derivatives, factors_of_tests
from ngvisco.physics.materials.custom import CustomMaterial
from ngvisco.physics.pointwise import energy_and_slope
from ngvisco.physics.tensors import (
    dev,
    embed_gradient,
    expm1,
    if_positive,
    inner,
    log,
    power_of_square,
    skw,
    sph,
    square,
    sym,
    symmetric_tensors,
    tr,
)
from ngvisco.physics.variables import Distortion, Jacobian


def test_derivatives_of_every_operation_equal_differences():
    rng = np.random.default_rng(2)
    A, B, s = rng.standard_normal((3, 3, 4)), rng.standard_normal((3, 3, 4)), 1 + rng.random(4)

    def energy(A, B, s):
        products = inner(A * B, sym(B)) + tr(A * A.trans) / s + 2 / s - square(dev(A)) * s**1.5
        return products + log(s) * (3 - square(sph(B))) + if_positive(s - 1.5, s * s, 0.5 * s) - (1 - s)

    arguments = [Array(each) for each in (A, B, s)]
    found = derivatives(energy(*arguments), arguments)
    for i, (values, derivative) in enumerate(zip((A, B, s), found, strict=True)):
        for index in np.ndindex(values.shape[:-1]):
            quotient = []
            for sign in (1, -1):
                moved = [each.copy() for each in (A, B, s)]
                moved[i][index] += sign * 1e-6
                quotient.append(energy(*map(Array, moved)).value)
            assert derivative[index] == pytest.approx((quotient[0] - quotient[1]) / 2e-6, rel=1e-7, abs=1e-7)


def test_a_trace_is_computed_without_its_tensor():
    space, components = symmetric_tensors(3), Array(np.random.default_rng(1).standard_normal((6, 4)))
    B = space.tensor(components)
    trace = tr(B)
    (slope,) = derivatives(trace * trace, [components])
    assert np.abs(trace.value).min() > 0.1
    assert B._made is None
    assert np.allclose(trace.value, np.einsum("iip->p", B.value), rtol=1e-14)
    of_trace = space.columns.T @ np.eye(3).ravel()
    assert np.allclose(slope, 2 * trace.value * of_trace[:, None], rtol=1e-14)


def test_an_energy_that_needs_ngsolve_is_evaluated_by_ngsolve():
    material = CustomMaterial(
        transported=(Distortion(), Jacobian()),
        stored_energy=lambda F, J: 3 * square(F) + 10 * (J - 1) * (J - 1) - 6 * ngsolve.log(J),
    )
    assert energy_and_slope(material, 2) is None


@pytest.mark.parametrize(
    "wrong",
    [
        lambda T, s: T + s,
        lambda T, s: T / T,
        lambda T, s: T**2.0,
        lambda T, s: s**s,
        lambda T, s: T.log(),
        lambda T, s: s.trans,
        lambda T, s: T.InnerProduct(s),
        lambda T, s: s * "2",
    ],
)
def test_meaningless_operations_are_type_errors(wrong):
    with pytest.raises(TypeError):
        wrong(Array(np.ones((3, 3, 2))), Array(np.ones(2)))


@pytest.mark.parametrize("a", [1e-12, -3e-4, 0.7])
def test_exponential_less_one_has_all_digits_by_arrays_and_by_expressions(a):
    exact, slope = math.expm1(a), math.exp(a)
    values = Array(np.array([a]))
    result = expm1(values)
    assert result.value[0] == pytest.approx(exact, rel=1e-15, abs=0)
    assert derivatives(result, [values])[0][0] == pytest.approx(slope, rel=1e-15)
    variable, point = CF(a).MakeVariable(), one_triangle()(0.3, 0.3)
    assert expm1(variable)(point) == pytest.approx(exact, rel=1e-15, abs=0)
    assert expm1(variable).Diff(variable, CF(1.0))(point) == pytest.approx(slope, rel=1e-15)


@pytest.mark.parametrize("exponent", [0, 0.5, 1, 1.5, 2])
def test_powers_of_zero_have_their_values_without_a_warning(exponent):
    """A law may have a value at rest although it has no derivative there."""
    with np.errstate(all="raise"):
        assert (Array(np.zeros(2)) ** exponent).value == pytest.approx(0.0**exponent, abs=0)


POINTS = 4
RNG = np.random.default_rng(5)
s, u, A = (Array(RNG.standard_normal((*shape, POINTS)), None) for shape in ((), (2,), (2, 2)))
SHAPES = {"q": (), "w": (2,), "G": (2, 2)}

FORMS = {
    "scalar times scalar": lambda t: s * t["q"] + t["q"] * s,
    "inner product of vectors": lambda t: u * t["w"] - t["w"] * u * s,
    "matrix times vector": lambda t: inner(A * t["w"], u) + inner(t["G"] * u, u) + inner(t["G"].trans * u, u),
    "matrix times matrix": lambda t: inner(A * t["G"], A) + inner(t["G"] * A, A),
    "scalar test times tensors": lambda t: inner(t["q"] * A, A) + inner(u * t["q"], u),
    "quotients and numbers": lambda t: inner(t["w"] / s, u) / 3.0 - 2 * t["q"],
    "parts": lambda t: inner(sym(t["G"]), A) + inner(skw(t["G"]), A) + s * tr(t["G"]),
    "entries": lambda t: t["w"][1] * s + t["G"][0, 1] * s,
    "embedding": lambda t: inner(embed_gradient(t["G"], 2), embed_gradient(A, 2)),
    "zero": lambda t: 0 + t["q"] - 0 * t["q"],
}


@pytest.mark.parametrize("name", FORMS)
def test_factors_are_derivatives_with_respect_to_test_functions(name):
    form = FORMS[name]
    found = factors_of_tests(form({test: Linear(shape, test=test) for test, shape in SHAPES.items()}))
    values = {test: RNG.standard_normal((*shape, POINTS)) for test, shape in SHAPES.items()}
    expected = form({test: Array(value, None) for test, value in values.items()}).value
    total = sum((factor * values[test]).reshape(-1, POINTS).sum(axis=0) for test, factor in found.items())
    assert total == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda t: t["q"] * t["q"],
        lambda t: t["q"] + s,
        lambda t: t["q"] + t["w"],
        lambda t: s / t["q"],
        lambda t: t["w"] / u,
        lambda t: inner(t["w"], A),
        lambda t: t["w"] * A,
    ],
)
def test_a_form_not_linear_in_test_functions_is_refused(wrong):
    with pytest.raises(TypeError):
        wrong({test: Linear(shape, test=test) for test, shape in SHAPES.items()})


def test_an_integrand_is_a_scalar():
    with pytest.raises(TypeError, match="scalar"):
        factors_of_tests(u * Linear((), test="q"))


def test_sums_do_not_change_their_terms():
    q = Linear((), test="q")
    before = s.value.copy()
    found = factors_of_tests(s * q + s * q + s * q + 1.0 * q)["q"]
    assert found == pytest.approx(3 * before + 1)
    assert (s.value == before).all()


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0, 0.75, -0.25, 2.5])
def test_power_of_square_has_finite_derivatives_at_zero(exponent: float) -> None:
    s = CF(0.0).MakeVariable()
    f = power_of_square(s, exponent, 1e-5)
    point = one_triangle()(0.3, 0.3)
    assert np.isfinite(f(point)) and np.isfinite(f.Diff(s)(point))
    s = CF(1.7).MakeVariable()
    f = power_of_square(s, exponent, 1e-5)
    assert f(point) == pytest.approx(1.7**exponent, rel=1e-9)
    assert f.Diff(s)(point) == pytest.approx(exponent * 1.7 ** (exponent - 1), rel=1e-9)
