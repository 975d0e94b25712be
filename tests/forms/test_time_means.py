"""Means over time: exact to their tolerance, whatever happens within the interval."""

import math

import numpy as np
import pytest
from ngsolve import CF, IfPos, cos, exp, sin, sqrt, x, y

import ngvisco as nv
from ngvisco.forms.time_means import TOLERANCE, mean_in_cells, rule
from ngvisco.geometries import box

T = nv.time
MESH = box((1, 1), 0.5)

MEANS = {
    "smooth": (sin(3 * T), (1 - math.cos(0.3)) / 0.3),
    "five periods": (sin(300 * T), (1 - math.cos(30)) / 30),
    "a bump of 3 %": (exp(-(((T - 0.05) / 0.003) ** 2)), 0.03 * math.sqrt(math.pi)),
    "a kink": (sqrt((T - 0.033) ** 2), (0.033**2 + 0.067**2) / 0.2),
    "a condition": (IfPos(T - 0.0333, 1.0, 0.0), 0.667),
    "many conditions": (IfPos(cos(200 * T), 1.0, 0.0), (20 - 3 * math.pi) / 20),
    "step": (nv.step(0.07), 0.3),
    "pulse": (nv.pulse(0.03, 0.01), 0.1),
    "pulse of a millionth": (1e6 * nv.pulse(0.03, 1e-7), 1.0),
    "table": (nv.table([0.01, 0.02, 0.5], [1, 5, 2]), 4.2),
}
"""Over [0, 0.1] s."""


def mean(value, begin=0.0, length=0.1):
    function, average = mean_in_cells(CF(value), MESH, 6)
    error = average.update(begin, length)
    return function(MESH(0.3, 0.4)), error


@pytest.mark.parametrize("name", MEANS)
def test_means_are_exact_to_the_tolerance(name):
    """And to ten roundings of the time over the pulse's length, where that is more."""
    value, exact = MEANS[name]
    found, error = mean(value)
    assert error <= TOLERANCE
    assert found == pytest.approx(exact, rel=10 * TOLERANCE)


def test_a_mean_over_no_time_is_the_value():
    value = nv.step(0.05) * x
    assert mean(value, 0.06, 0.0)[0] == pytest.approx(0.3) and mean(value, 0.04, 0.0)[0] == 0


def test_a_mean_is_projected_in_cells():
    """Against polynomials of the forms' degree a load's mean is the load's, sines of place too."""
    from ngvisco.forms.mesh.quadrature import Quadrature

    value = CF((sin(9 * x) * T, exp(y) * T))
    function, average = mean_in_cells(value, MESH, 6)
    average.update(0.0, 0.2)
    rule_of_forms = Quadrature(MESH, 6, 6)
    present = T.Get()
    T.Set(0.1)  # the mean of a linear function
    for test in (CF((1, x)), CF((x * y, x**3)), CF((y**3, x * x * y))):
        exact = rule_of_forms.integrate_cells(value * test)
        assert rule_of_forms.integrate_cells(function * test) == pytest.approx(exact, rel=1e-12)
    T.Set(present)


def test_the_present_time_is_left_alone():
    T.Set(0.7)
    mean(nv.pulse(0.03, 0.01))
    assert T.Get() == 0.7
    T.Set(0.0)


def test_a_front_that_moves_is_said_not_to_be_resolved():
    """At each place it breaks at another time: the error is that of 50 panels, and known."""
    front = IfPos(x - 10 * T, 1.0, 0.0)
    found, error = mean(front)
    assert TOLERANCE < error < 0.02
    assert abs(found - 0.3) <= 0.1  # a polynomial of third degree across jumps within a cell


def test_the_error_is_not_less_than_it_is():
    """Panels that are not halved enough: the rule's own error bounds the true one."""
    for times in (40, 160, 640):

        def values(t, times=times):
            return np.array([math.sin(times * t) ** 2, math.sin(times * t + 1) ** 2])

        found = rule(values, 0.0, 10.0)
        exact = [0.5 - (math.sin(2 * (10 * times + c)) - math.sin(2 * c)) / (40 * times) for c in (0, 1)]
        assert np.abs(found.mean(values) - exact).max() <= max(found.error, TOLERANCE)


@pytest.mark.parametrize(
    ("source", "values", "message"),
    [
        ([0, 1, 1], [1, 2, 3], "times that increase"),
        ([0, 1], [1, 2, 3], "as many values"),
        ([0], [1], "two rows"),
        ([0, 1], [1, math.nan], "finite"),
        (["a", 1], [1, 2], "times"),
        ("missing.csv", (), "can be read"),
    ],
)
def test_bad_tables_are_refused(source, values, message):
    with pytest.raises(nv.ParameterError, match=message):
        nv.table(source, values)


def test_a_table_is_read_from_a_file(tmp_path):
    path = tmp_path / "load.csv"
    path.write_text("time, east, north\n0, 1, 0\n\n0.5, 3, 1\n2, 0, 1\n")
    load = nv.table(path)
    assert load.dim == 2
    for t, expected in (
        (-1, (1, 0)),
        (0.25, (2, 0.5)),
        (0.5, (3, 1)),
        (1.25, (1.5, 1)),
        (2, (0, 1)),
        (9, (0, 1)),
    ):
        T.Set(t)
        assert load(MESH(0.1, 0.1)) == pytest.approx(expected)
    T.Set(0.0)
    path.write_text("0,1\n1,x\n")
    with pytest.raises(nv.ParameterError, match="line 2"):
        nv.table(path)
    path.write_text("0,1\n1,2,3\n")
    with pytest.raises(nv.ParameterError, match="line 2"):
        nv.table(path)


@pytest.mark.parametrize("bad", [(nv.step, ("a",)), (nv.pulse, (0, -1)), (nv.pulse, (math.inf, 1))])
def test_steps_and_pulses_are_of_numbers(bad):
    make, arguments = bad
    with pytest.raises(nv.ParameterError):
        make(*arguments)
