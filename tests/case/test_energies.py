"""Energies of case files: their values by NGSolve and by arrays, refused texts with their positions, and
units."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ngsolve import x

import ngvisco as nv
from ngvisco.case.build import parse_case
from ngvisco.case.laws import custom_material, isotropic_strain_energy, parse_energy
from ngvisco.expressions import ExpressionError
from ngvisco.physics.arrays import Array, derivatives
from ngvisco.physics.pointwise import ExpressionResponse
from ngvisco.physics.tensors import exp
from ngvisco.physics.variables import Distortion, Jacobian

F_AND_J = (Distortion(), Jacobian())
CASE = """\
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.6
[material]
kind = "Custom"
variables = ["F", "J"]
energy = "G*norm2(F)/J**(2/3) + 4*(J + 1/J)"
parameters = { G = 3 }
[time]
dt = 0.02
until = 0.04
"""
RNG = np.random.default_rng(3)
F = np.eye(3)[:, :, None] + 0.2 * RNG.standard_normal((3, 3, 5))
J = 1 + 0.2 * RNG.random(5)


def by_arrays(text, **parameters):
    """Values of an energy by arrays at (F, J), and its derivatives with respect to F and J."""
    arguments = {"F": Array(F), "J": Array(J)}
    energy = parse_energy(text, F_AND_J, parameters)(**arguments)
    return energy.value, derivatives(energy, list(arguments.values()))


def each(function):
    return np.array([function(F[:, :, i], J[i]) for i in range(5)])


def cofactor(A):
    return np.linalg.det(A) * np.linalg.inv(A).T


def deviator(A):
    return A - np.trace(A) / 3 * np.eye(3)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("tr(F) + J", lambda F, J: np.trace(F) + J),
        ("det(F)", lambda F, J: np.linalg.det(F)),
        ("norm2(F - 2*I)", lambda F, J: np.sum((F - 2 * np.eye(3)) ** 2)),
        ("dot(F, trans(F)*F)", lambda F, J: np.sum(F * (F.T @ F))),
        ("norm2(cof(F))", lambda F, J: np.sum(cofactor(F) ** 2)),
        ("tr(inv(F)*cof(F))", lambda F, J: np.trace(np.linalg.inv(F) @ cofactor(F))),
        ("norm2(sym(F)) - norm2(sph(F))", lambda F, J: np.sum(((F + F.T) / 2) ** 2) - np.trace(F) ** 2 / 3),
        ("norm2(dev(F)/J)", lambda F, J: np.sum(deviator(F) ** 2) / J**2),
        ("F[0, 1]*(F*trans(F))[2, 2]", lambda F, J: F[0, 1] * (F @ F.T)[2, 2]),
        ("J**-2 - sqrt(J)", lambda F, J: J**-2 - J**0.5),
        ("exp(-J) + log(J)**2", lambda F, J: math.exp(-J) + math.log(J) ** 2),
        ("abs(J - 1.1) + tanh(J - 1.1)", lambda F, J: abs(J - 1.1) + math.tanh(J - 1.1)),
        ("sinh(J)*cosh(J)", lambda F, J: math.sinh(J) * math.cosh(J)),
        ("min(J, 1.1) + max(F[0,0], J)", lambda F, J: min(J, 1.1) + max(F[0, 0], J)),
        ("J if 1 < J < 1.1 else tr(F)", lambda F, J: J if 1 < J < 1.1 else np.trace(F)),
        ("norm2(F if not J < 1.1 else I)", lambda F, J: np.sum(F**2) if J >= 1.1 else 3),
        (
            "where(J > 1.05 or F[0,0] >= 1, G*J, pi*J)",
            lambda F, J: J * (7 if J > 1.05 or F[0, 0] >= 1 else math.pi),
        ),
    ],
)
def test_energy_has_the_value_and_slope_of_its_formula(text, meant):
    found, slopes = by_arrays(text, G=7)
    assert np.broadcast_to(found, 5) == pytest.approx(each(meant), rel=1e-13)
    step = 1e-6
    for i, j in np.ndindex(3, 3):
        shift = np.zeros((3, 3))
        shift[i, j] = step
        quotient = each(lambda F, J: (meant(F + shift, J) - meant(F - shift, J)) / (2 * step))  # noqa: B023
        assert np.broadcast_to(slopes[0][i, j], 5) == pytest.approx(quotient, rel=1e-7, abs=1e-7)
    quotient = each(lambda F, J: (meant(F, J + step) - meant(F, J - step)) / (2 * step))
    assert np.broadcast_to(slopes[1], 5) == pytest.approx(quotient, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize(
    ("text", "reason", "position"),
    [
        ("3*F", "an energy has to be a scalar", 1),
        ("3*4", "has to read at least one of F, J", 1),
        ("J + F", "cannot be added", 1),
        ("J + q", "unknown name 'q' (known: F, J, G, pi, I)", 5),
        ("J + x", "unknown name 'x'", 5),
        ("J*t", "unknown name 't'", 3),
        ("tr(J)", "tr takes tensors", 1),
        ("J + log(F)", "log takes scalars", 5),
        ("J + nrm2(F)", "did you mean 'norm2'?", 5),
        ("2 + sin(J)", "unknown function 'sin'", 5),
        ("J + F[0]", "two indices from 0 to 2", 7),
        ("J + F[0, 3]", "two indices from 0 to 2", 7),
        ("F[True, 0]", "two indices from 0 to 2", 3),
        ("F[J, 0]", "two indices from 0 to 2", 3),
        ("F[0:1, 0]", "two indices from 0 to 2", 3),
        ("J[0, 0]", "only tensors have entries", 1),
        ("J/F", "multiply by inv(A)", 1),
        ("F/0", "division by zero", 1),
        ("F**2", "only scalars have powers", 1),
        ("J**J", "an exponent has to be a number", 1),
        ("J if F < 1 else 2", "tensors cannot be compared", 6),
        ("J if J < 1 else F", "have to be two scalars or two tensors", 1),
        ("J*(1/0)", "the value is not finite", 4),
        ("dot(F)", "dot takes 2 arguments, not 1", 1),
        ("F.trans", "only numbers, names, entries", 1),
        ("__import__('os').system('true')", "a function is called by its name alone", 1),
        ("(lambda: J)()", "a function is called by its name alone", 1),
        ("F[__import__('os'), 0]", "two indices", 3),
        ("", "not an expression", 1),
    ],
)
def test_wrong_energy_is_refused_with_its_position(text, reason, position):
    with pytest.raises(ExpressionError) as caught:
        parse_energy(text, F_AND_J, {"G": 1.0})
    assert reason in str(caught.value)
    assert caught.value.position + 1 == position


def test_nested_calls_of_where_are_each_read_once():
    text = "J"
    for _ in range(25):
        text = f"where(J < 1, J, {text})"
    # each node is visited once; with two visits of each node there would be 2^25 visits
    parse_energy(text, F_AND_J)


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet="FJI()[]+-*/.,<>=012 trdeifls", max_size=30))
def test_any_text_is_read_as_an_energy_or_refused(text):
    try:
        energy = parse_energy(text, F_AND_J)
    except ExpressionError as error:
        assert 0 <= error.position <= len(text)
    else:
        with np.errstate(all="ignore"):
            assert energy(F=Array(F), J=Array(J)).is_scalar


@pytest.mark.parametrize(
    ("text", "name", "exponent"),
    [
        ("F", "F", 0),
        ("C = cof(F)", "C", 0),
        ("H = J**(-5/6) * F", "H", -5 / 6),
        ("b=J**2*F*trans(F)", "b", 2),
    ],
)
def test_a_variable_gets_its_exponent_from_its_definition(text, name, exponent):
    variable = custom_material([text, "J"], f"norm2({name}) + J").variables[0]
    assert (variable.name, variable.exponent) == (name, pytest.approx(exponent))


@pytest.mark.parametrize(
    ("variables", "energy", "parameters", "field"),
    [
        (["Q"], "Q", {}, "Custom.variables"),
        (["H = J**(F)*F"], "norm2(H)", {}, "Custom.variables"),
        (["H = F*F"], "norm2(H)", {}, "Custom.variables"),
        (["pi = F"], "norm2(pi)", {}, "Custom.variables"),
        (["F", "F"], "norm2(F)", {}, "Custom.variables"),
        (["K"], "K", {}, "Custom.variables"),
        ([], "1", {}, "Custom.variables"),
        (["F"], "norm2(F)*q", {}, "Custom.energy"),
        (["F"], "F[0, 0]**2", {}, "Custom.energy"),
        (["J"], "J", {"J": 1.0}, "Custom.parameters"),
        (["J"], "J", {"I": 1.0}, "Custom.parameters"),
        (["J"], "a*J", {"a": math.inf}, "Custom.parameters.a"),
    ],
)
def test_wrong_materials_are_refused_by_their_keys(variables, energy, parameters, field):
    with pytest.raises(nv.ParameterError) as caught:
        custom_material(variables, energy, parameters)
    assert caught.value.field == field


def test_a_refused_strain_energy_is_reported_with_the_rotation_that_changes_it():
    isotropic_strain_energy("5*tr(E)**2 + G*norm2(dev(E))", {"G": 5.0})
    with pytest.raises(nv.ParameterError, match=r"IsotropicStrainEnergy.energy .* under the rotation"):
        isotropic_strain_energy("norm2(E) + 0.01*E[0, 0]**2")


def test_the_energy_of_a_case_has_the_units_of_the_case():
    plain = parse_case(CASE, "case", Path("."))
    scaled = parse_case('[units]\npressure = "kPa"\n' + CASE, "case", Path("."))
    states = np.array([[1.1, 0.1, -0.2, 0.9, 1.0, 1.05]])
    energies = [ExpressionResponse(case.model(2).material, 2)(states).energy for case in (plain, scaled)]
    assert energies[1] == pytest.approx(1000 * energies[0], rel=1e-14)
    again = parse_case(scaled.resolved, "case", Path("."))
    assert again.hash == scaled.hash != plain.hash


WARM = """
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.7
[material]
kind = "LinearElastic"
K_e = 10
G_e = 10
[material.thermal]
c = 3
theta_R = 300
[rheology.heat]
conductivity = "0.1*(theta/300)**1.5 + 0.2*exp(-theta/300)"
[initial]
density = 1
temperature = "300 + 100*x"
[time]
dt = 0.02
until = 0.02
"""


@pytest.mark.parametrize("method", ["coupled", "split"])
def test_a_conductivity_may_be_an_expression_of_the_temperature(method):
    case = parse_case(WARM, "case", Path("."), [f"solver.method={method}"])
    ledger = case.simulation(case.mesh()).run(case.until)
    start = nv.Initial(density=1.0, temperature=300 + 100 * x)

    def law(theta):
        return 0.1 * (theta / 300) ** 1.5 + 0.2 * exp(-theta / 300)

    by_function = replace(case.model(2), heat=nv.Heat(conductivity=law))
    expected = nv.Simulation(case.mesh(), by_function, dt=0.02, initial=start, solver=method).run(0.02)
    name = "entropy_production_conduction"
    assert ledger.column(name)[-1] == pytest.approx(expected.column(name)[-1], rel=1e-9) != 0


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ('"0.1*T"', ["unknown name 'T' (known: theta, pi, I), at character 5"]),
        ('"2*3"', ["a law of the temperature has to read at least one of theta"]),
        ('"1 - theta"', ["'1 - theta': expected a function of the temperature with finite values >= 0"]),
        ("[[1, 0], [0, 1]]", ["[[1, 0], [0, 1]]: expected a number >= 0", "a 3x3 matrix"]),
        ("-1", ["-1: expected a finite number >= 0"]),
    ],
)
def test_a_wrong_conductivity_of_a_case_is_refused_with_the_reason(value, words):
    with pytest.raises(nv.CaseError) as caught:
        parse_case(WARM, "case", Path("."), [f"rheology.heat.conductivity={value}"]).model(2)
    assert all(word in str(caught.value) for word in ["rheology.heat.conductivity", *words])


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ('material.energy="G*norm2(F) + q"', ["material.energy", "unknown name 'q'", "at character 14"]),
        ('material.variables=["F", "Z"]', ["material.variables", "one of F, H, B, N, J, A, K, E"]),
        ("material.parameters={J=1}", ["material.parameters", "none of F, J, pi, I"]),
        ('material.parameters.G="5 kPa"', ["material.parameters.G", "expected a number"]),
        ("material.energy=3", ["material.energy", "expected a text"]),
    ],
)
def test_wrong_energies_of_a_case_are_refused_when_it_is_read(setting, words):
    with pytest.raises(nv.CaseError) as caught:
        parse_case(CASE, "case", Path("."), [setting])
    assert all(word in str(caught.value) for word in words), str(caught.value)
