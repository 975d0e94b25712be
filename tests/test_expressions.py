"""Expressions: their values, and refused texts. No text can do anything but give a value or an error."""

import ast
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from netgen.geom2d import unit_square
from ngsolve import Mesh

import ngvisco as nv
from ngvisco.expressions import FUNCTIONS, MAX_LENGTH, ExpressionError, parse, parse_region

MESH = Mesh(unit_square.GenerateMesh(maxh=1))
POINT = (0.3, 0.7)
NAMES = {"x": 0.3, "y": 0.7, "z": 0.0, "pi": math.pi, "t": 0.0}


def at_point(text):
    return parse(text).coefficient()(MESH(*POINT))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("sin(pi*x)*cos(pi*y)", math.sin(0.3 * math.pi) * math.cos(0.7 * math.pi)),
        ("(x - 1)**3", -(0.7**3)),
        ("x**-2", 0.3**-2),
        ("x**0.5 + 2**y", 0.3**0.5 + 2**0.7),
        ("-x**2", -0.09),
        ("1 if x < 0.5 else 2", 1.0),
        ("1 if 0.5 < x else 2", 2.0),
        ("where(0.2 < x <= 0.25 or not y < 1, 3, 4*x)", 1.2),
        ("where(x > 0.2 and y >= 0.7, 3, 4)", 3.0),
        ("1 if 2 > 3 else x", 0.3),
        ("min(x, y) + 10*max(x, y) + abs(x - 1)", 0.3 + 7 + 0.7),
        ("tanh(x - 1)", math.tanh(-0.7)),
        ("atan2(x, y)", math.atan2(0.3, 0.7)),
        ("\n  x\n  + 1e-3", 0.301),
    ],
)
def test_expression_has_the_value_of_its_formula(text, value):
    assert at_point(text) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_of_coefficients_agree_with_those_of_numbers(name):
    count, exact, _ = FUNCTIONS[name]
    names = ("x", "y")[:count]
    assert at_point(f"{name}({', '.join(names)})") == pytest.approx(exact(*POINT[:count]), rel=1e-13)
    assert at_point(f"{name}({', '.join(['0.3', '0.7'][:count])})") == exact(*POINT[:count])


def test_the_time_in_an_expression_is_the_time_of_the_run():
    rate = parse("3*t").coefficient()
    try:
        nv.time.Set(2.0)
        assert rate(MESH(*POINT)) == 6.0
    finally:
        nv.time.Set(0.0)


@pytest.mark.parametrize(
    ("text", "reason", "position"),
    [
        ("1 + sinn(x)", "unknown function 'sinn'; did you mean 'sin'?", 5),
        ("x + q", "unknown name 'q'", 5),
        ("2*sin", "needs its arguments", 3),
        ("x + 1/0", "the value is not finite", 5),
        ("x/(1-1)", "division by zero", 1),
        ("2 + log(-1)", "the value is not finite", 5),
        ("1e999", "the value is not finite", 1),
        ("x*nan", "unknown name 'nan'", 3),
        ("inf", "unknown name 'inf'", 1),
        ("9**9**9**9", "the value is not finite", 4),
        ("(-1)**0.5", "the value is not finite", 1),
        ("x < 1", "a condition may only stand", 1),
        ("1 if x else 2", "expected a condition", 6),
        ("min(x)", "takes 2 arguments, not 1", 1),
        ("x y", "not an expression", 3),
        ("", "not an expression", 1),
        ("x.real", "only numbers", 1),
        ("().__class__.__bases__", "only numbers", 1),
        ("__import__('os').system('true')", "a function is called by its name alone", 1),
        ("(lambda: 1)()", "a function is called by its name alone", 1),
        ("[x for x in (1,)]", "only numbers", 1),
        ("'a'", "not a number", 1),
        ("True", "not a number", 1),
        ("1j", "not a number", 1),
        ("x if x == 1 else 2", "only the comparisons", 6),
        ("x // 2", "only the operators", 1),
        ("sin(*x)", "only positional arguments", 1),
        ("é", "unexpected character", 1),
    ],
)
def test_a_wrong_expression_is_refused_with_the_position_of_its_fault(text, reason, position):
    with pytest.raises(ExpressionError) as caught:
        parse(text)
    assert reason in str(caught.value)
    assert caught.value.position + 1 == position


@pytest.mark.parametrize(
    "text", ["x" * (MAX_LENGTH + 1), "(" * 300 + "x" + ")" * 300, "-" * 200 + "x", "x" + "+x" * 500]
)
def test_expressions_of_absurd_size_are_refused(text):
    with pytest.raises(ExpressionError):
        parse(text)


@settings(max_examples=400, deadline=None)
@given(st.text(max_size=40) | st.text(alphabet="xyzt()+-*/.,<>=01_'[]{}:\n ifelsn", max_size=30))
def test_any_text_is_parsed_or_refused(text):
    try:
        expression = parse(text)
    except ExpressionError as error:
        assert 0 <= error.position <= len(text)
    else:
        expression.coefficient()


def binary(parts):
    operators = st.sampled_from(["+", "-", "*"])
    return st.builds(lambda a, o, b: f"({a} {o} {b})", parts, operators, parts) | st.builds(
        lambda f, a: f"{f}({a})", st.sampled_from(["sin", "cos", "tanh", "abs"]), parts
    )


LEAVES = st.sampled_from(["x", "y", "z", "pi"]) | st.floats(0, 9).map(lambda v: repr(round(v, 3)))


@settings(max_examples=100, deadline=None)
@given(st.recursive(LEAVES, binary, max_leaves=12))
def test_a_random_expression_has_the_value_that_python_computes(text):
    functions = {name: exact for name, (_, exact, _) in FUNCTIONS.items()}
    code = compile(ast.parse(text, mode="eval"), "", "eval")
    assert at_point(text) == pytest.approx(eval(code, functions | NAMES), rel=1e-11, abs=1e-11)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("x**2 + y**2 < 1", 1 - 0.58),
        ("x > 0.5", -0.2),
        ("0.1 <= x <= 0.35", 0.05),
        ("x < 0.5 and y < 0.75", 0.05),
        ("x < 0.2 or not y < 0.5", 0.2),
        ("0 < 1", 1.0),
    ],
)
def test_a_region_s_function_is_the_margin_of_its_condition(text, value):
    assert parse_region(text).coefficient()(MESH(*POINT)) == pytest.approx(value, rel=1e-13)


@pytest.mark.parametrize(
    "text",
    [
        "x == 1",
        "x < ",
        "x - 0.5",
        "x > 0 and y",
        "1 if x < 1 else 0",
        "(x < 1) + 1",
        "q < 1",
        "not",
        "x < 1/0",
    ],
)
def test_a_text_that_is_no_region_is_refused_with_the_position_of_its_fault(text):
    with pytest.raises(ExpressionError, match="at character"):
        parse_region(text)
