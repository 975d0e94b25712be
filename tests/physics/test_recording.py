"""Programs of array operations: the same bits as their functions; functions that cannot be recorded."""

import numpy as np
import pytest

from ngvisco.physics.recording import Program, called, datum


def arrays(seed):
    rng = np.random.default_rng(seed)
    return {"a": rng.random((3, 5)), "b": rng.random((3, 5))}


def written(a, factor):
    """A function that writes into an array of its own."""
    result = np.zeros_like(a)
    result[1] += factor * a[0]
    return result


WEIGHTS = np.linspace(1, 2, 5)


def several(c):
    a, b = c["a"], c["b"]
    products = np.einsum("ip,ip->p", a, b) * WEIGHTS + 2.0 ** np.sqrt(a[0])
    joined = np.concatenate([a.reshape(15), np.stack([b, a], axis=1).sum(axis=1).T[0]])
    chosen = np.where(a > 0.5, a - b, -b).swapaxes(0, 1)
    return {
        "products": products,
        "joined": joined,
        "chosen": chosen,
        "called": called(written, a, 3),
        "w": WEIGHTS,
    }


def test_a_recorded_program_has_the_same_bits_as_its_function():
    program, first = Program.of(several, arrays(0))
    for seed, found in (
        (0, first),
        (1, program(arrays(1))),
        (2, program(arrays(2))),
        (1, program(arrays(1))),
    ):
        expected = several(arrays(seed))
        assert set(found) == set(expected)
        assert all(np.array_equal(found[name], values) for name, values in expected.items())


def test_repeated_and_unused_operations_are_left_out():
    calls = []

    def counted(a):
        calls.append(a)
        return 2 * a

    def function(c):
        called(counted, c["b"])
        return {"sum": called(counted, c["a"]) + called(counted, c["a"])}

    program, _ = Program.of(function, arrays(0))
    calls.clear()
    program(arrays(1))
    assert len(calls) == 1


def test_a_program_reads_its_data_once_after_each_begin():
    data, squares = {"x": np.arange(5.0)}, []

    def squared(x):
        squares.append(x)
        return x**2

    def function(c):
        x = datum(lambda: data["x"], "x")
        return {"sum": c["a"] + called(squared, datum(lambda: 0 * x, "x")), "data": x + 1, "both": c["b"] * x}

    program, _ = Program.of(function, arrays(0))
    for steps, value in enumerate((np.arange(5.0), np.full(5, 7.0), np.linspace(0, 1, 5))):
        data["x"] = value
        if steps:
            program.begin()
        for seed in (1, 2):
            found, given = program(arrays(seed)), arrays(seed)
            assert np.array_equal(found["sum"], given["a"] + value**2)
            assert np.array_equal(found["data"], value + 1)
            assert np.array_equal(found["both"], given["b"] * value)
        assert len(squares) == steps + 1
    data["x"] = np.zeros(5)
    assert np.array_equal(program(arrays(1))["data"], np.linspace(0, 1, 5) + 1)


@pytest.mark.parametrize(
    "function",
    [
        lambda c: {"chosen": c["a"] if c["a"][0, 0] > 0.5 else c["b"]},
        lambda c: {"number": np.array(float(c["a"][0, 0]))},
        lambda c: {"converted": np.asarray(c["a"])},
        lambda c: {"written": written(c["a"].__array__(), 1)},
        lambda c: {"out": np.add(c["a"], c["b"], out=c["a"])},
        lambda c: {"list": np.array(list(c["a"]))},
    ],
)
def test_a_function_that_cannot_be_recorded_is_refused(function):
    with pytest.raises(TypeError, match="cannot depend on values"):
        Program.of(function, arrays(0))
