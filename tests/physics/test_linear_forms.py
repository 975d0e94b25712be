"""What multiplies a test function in a form that is linear in it, against the form's values at tests."""

import numpy as np
import pytest

from ngvisco.physics.arrays import Array, Linear, slots
from ngvisco.physics.tensors import embed_gradient, inner, skw, sym, tr

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
def test_slots_are_the_derivatives_by_the_tests(name):
    form = FORMS[name]
    found = slots(form({test: Linear(shape, slot=test) for test, shape in SHAPES.items()}))
    values = {test: RNG.standard_normal((*shape, POINTS)) for test, shape in SHAPES.items()}
    expected = form({test: Array(value, None) for test, value in values.items()}).value
    total = sum((slot * values[test]).reshape(-1, POINTS).sum(axis=0) for test, slot in found.items())
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
def test_what_is_not_linear_in_the_tests_is_refused(wrong):
    with pytest.raises(TypeError):
        wrong({test: Linear(shape, slot=test) for test, shape in SHAPES.items()})


def test_an_integrand_is_a_scalar():
    with pytest.raises(TypeError, match="scalar"):
        slots(u * Linear((), slot="q"))


def test_sums_do_not_change_the_values_that_they_are_made_of():
    q = Linear((), slot="q")
    before = s.value.copy()
    found = slots(s * q + s * q + s * q + 1.0 * q)["q"]
    assert found == pytest.approx(3 * before + 1)
    assert (s.value == before).all()
