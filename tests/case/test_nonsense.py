"""Wrong case files are refused at once, with the key at fault and the right value."""

import os
import re
import threading
from pathlib import Path

import pytest
from support import faults

import ngvisco as nv
from ngvisco.case.build import parse_case
from ngvisco.case.faults import CaseError, in_case
from ngvisco.words import FUNCTION, Mention, Words, call

pytestmark = [
    pytest.mark.filterwarnings("ignore:bodies .* meet with different stresses"),
    pytest.mark.timeout(30),  # a hanging case once ran for hours
]

HEAD = """
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.5
[time]
dt = 0.02
until = 0.04
[[loads]]
kind = "Gravity"
g = [0, -1]
"""
LAW = 'kind = "NeoHookean"\nK_e = 10\nG_e = 5\nepsilon = 0.1\n'
ONE = f"{HEAD}[initial]\ndensity = 1\n[rheology.viscosity]\nK_v = 0.01\nG_v = 0.01\n[material]\n{LAW}"
BALL = '{ kind = "Ball", centre = [0.6, 0.5], radius = 0.2 }'
TWO = f"""{HEAD}
[[bodies]]
name = "rest"
density = 1.0
material = {{ kind = "ReferentialNeoHookean", K_e = 10, G_e = 0.1, epsilon = 0.1 }}
creep = {{ G_m = 0.01 }}
[[bodies]]
name = "disc"
where = {BALL}
density = 2.0
material = {{ kind = "ReferentialNeoHookean", K_e = 10, G_e = 5, epsilon = 0.1 }}
"""
OWN = 'kind = "Custom"\nvariables = ["F"]\nenergy ='
GAS = 'kind = "Gas"\nc = 1.0\ntheta_R = 293\n'
LAW_OF_DISC = 'kind = "ReferentialNeoHookean", K_e = 10, G_e = 5, epsilon = 0.1'


NONSENSE = """\
# what was accepted
TWO | BALL -> "x - 0.5" | bodies.1.where: 'x - 0.5': expected a condition such as x < 0.5
ONE | + [[output.integrals]]; name = "a"; of = "1/(density - density)"
  | output.integrals.0.of: '1/(density - density)': expected an integrand with a finite integral
ONE | + [[output.integrals]]; name = "a"; of = "log(-density)"
  | output.integrals.0.of: 'log(-density)': expected an integrand with a finite integral
ONE | + J_min = 2.0 | material.J_min: 2.0: expected less than 1, the least J
TWO | LAW_OF_DISC -> LAW_OF_DISC, J_min = 2.0 | expected a material without J_min, since the continued energy
ONE | density = 1 -> density = "1+t" | initial.density: '1+t': expected a function of the place alone
ONE | density = 1 -> velocity = ["t*y", 0]
  | initial.velocity: ['t*y', 0]: expected a function of the place alone
ONE | density = 1 -> density = 1e-300 | initial.density: 1e-300: expected a finite number from 1e-60
ONE | density = 1 -> density = "1e-300"
  | initial density rho_0: the values are from 1e-300 to 1e-300; expected values from 1e-30
ONE | K_e = 10 -> K_e = 1e-300 | material.K_e: 1e-300: expected a finite number from 1e-60
ONE | + [rheology.creep]; G_m = inf | rheology.creep.G_m: inf: expected a finite number
ONE | g = [0, -1] -> g = [[0, -1]] | loads.0.g: [[0, -1]]: expected an array of components
ONE | g = [0, -1] -> g = [[0], [-1]] | loads.0.g: [[0], [-1]]: expected an array of components
ONE | density = 1 -> density = [[1]] | initial.density: [[1]]: expected a number, or an expression
ONE | + [output]; passive = ["creep_strain"]
  | output.passive: 'creep_strain': expected no creep strain in a model
ONE | + [output.bodies]; every = 2 | output.bodies: { every = 2 }: expected a model with bodies, since
ONE | + [output.vtk]; fields = [] | output.vtk.fields: []: expected at least one
ONE | + [[output.probes]]; name = "a"; point = [0.5, 0.5]; fields = []
  | output.probes.0.fields: []: expected at least one
ONE | + [output.forces]; walls = [] | output.forces.walls: []: expected at least one
ONE | + [output.forces]; walls = ["top", "top"] | output.forces.walls: ['top', 'top']: expected each name once
ONE | LAW -> OWN "det(F) - det(F)" | material.energy: 'det(F) - det(F)': expected an energy that changes
TWO | LAW_OF_DISC -> kind = "Custom", variables = ["J"], energy = "0*J + 1"
  | bodies.1.material.energy: '0*J + 1': expected an energy that changes with J
# what was blamed on something else
ONE | [[loads]] -> [loads] | loads: { kind = "Gravity", g = [0, -1] }: expected an array of tables, [[loads]]
ONE | g = [0, -1] -> g = -1 | loads.0.g: -1: expected an array of components
ONE | K_e = 10 -> K_e = "10*x" | material.K_e: '10*x': at the start the minimum is
ONE | G_v = 0.01 -> G_v = "x - 2" | rheology.viscosity.G_v: 'x - 2': at the start the minimum is -2
TWO | K_e = 10, G_e = 5 -> K_e = 10, G_e = "x - 1"
  | bodies.1.material.G_e: 'x - 1': at the start the minimum is -1
ONE | + [rheology.hyperviscosity]; mu = 1; p = "4" | rheology.hyperviscosity.p: '4': expected a number
ONE | + [rheology.regularisation]; delta_density = 1; r = "4"
  | rheology.regularisation.r: '4': expected a number
ONE | density = 1 -> values = { J = -1 } | initial.values.J: initial projected J_0: the minimum is -1
ONE | g = [0, -1] -> g = [0, -1]; name = "a b" | loads.0.name: 'a b': expected a name of letters
ONE | + [[loads]]; kind = "Gravity"; g = [0, 1] | loads.1.name: 'gravity': expected a name that no other
ONE | + [[loads]]; kind = "CentralGravity"; strength = 1; name = "q"; centre = [0, 0, 0]
  | loads.1.centre: [0.0, 0.0, 0.0]: expected 2 numbers
TWO | density = 2.0 -> density = 1e30 | bodies.1.density: 1e+30: expected at most 1e+10 times that of 'rest'
TWO | radius = 0.2 -> radius = 0.001
  | bodies.1.where: { kind = "Ball", centre = [0.6, 0.5], radius = 0.001 }: expected a place within the
  domain that is at least 1/4 of a cell thick
TWO | BALL -> "x > -1" | bodies.1.where: 'x > -1': expected a smaller place
TWO | name = "rest" -> name = "rest"; where = "x < 0.2"; order = 1
  | bodies: ['rest', 'disc']: expected one body without a place, for the rest
TWO | LAW_OF_DISC -> kind = "NeoHookean", K_e = 10, G_e = 5, epsilon = 0.1
  | an energy f(B) + U(J) per reference volume
# bodies that are none
TWO | name = "disc" -> name = "rest" | bodies.1.name: 'rest': expected a name that no other
TWO | name = "disc" -> name = "a disc" | bodies.1.name: 'a disc': expected a letter
TWO | name = "disc" ->  | bodies.1.name: is missing
TWO | where = BALL ->  | bodies.1.where: is missing: expected a place, since 'rest' without a place
TWO | kind = "Ball" -> kind = "Bal" | bodies.1.where.kind: 'Bal': expected one of Ball, Block
TWO | radius = 0.2 -> radius = -1 | bodies.1.where.radius: -1.0: expected a finite number > 0
TWO | G_e = 5 -> G_e = -5 | bodies.1.material.G_e: -5.0: expected a finite number > 0
TWO | BALL -> "x <" | bodies.1.where: 'x <': the text is not an expression, at character
TWO | BALL -> "x < t" | expected a condition that reads only x, y and z
TWO | BALL -> [] | bodies.1.where: []: expected at least one shape
TWO | BALL -> 3 | bodies.1.where: 3: expected a table
TWO | until = 0.04 -> until = 0.04; [rheology.creep]; G_m = 1
  | rheology.creep: { G_m = 1 }: expected nothing with bodies, since each body has its own creep
TWO | until = 0.04 -> until = 0.04; [material]; kind = "LinearElastic"; K_e = 1; G_e = 1
  | material: { kind = "LinearElastic", K_e = 1, G_e = 1 }: expected nothing with bodies, since each body
ONE | [material]; LAW ->  | material: is missing: expected a table [material], or bodies
ONE | K_e = 10 -> K_e = "10 + 5*t" | material.K_e: '10 + 5*t': expected a number, or an expression of
ONE | K_e = 10 -> K_e = true | material.K_e: true: expected a number, or an expression
ONE | K_e = 10 -> K_e = [1, 2] | material.K_e: [1, 2]: expected a number, or an expression
# what was said in Python's words
TWO | until = 0.04 -> until = 0.04; [initial]; density = 2
  | initial.density: 2: expected nothing, since each body has a density
ONE | density = 1 -> temperature = 300
  | initial.temperature: 300: expected nothing for a material without a temperature; material.thermal gives a
ONE | density = 1 -> F = 1.1 | initial.F: 1.1: expected three rows of three, as in
ONE | LAW -> GAS | material.gruneisen: is missing: expected a number > 0, which gives the pressure of a gas
ONE | LAW -> GASexpansion = 1e-4 | material.expansion: unknown key
ONE | LAW -> kind = "Damaged"; G_c = 1; length = 1; material = { kind = "BarotropicFluid", B = 1, gamma = 2 }
  | material.material: { kind = "BarotropicFluid", B = 1, gamma = 2 }: expected a material without
ONE | + [rheology.creep]; kind = "Composite"; rules = [{ kind = "Perzyna", sigma_Y = 1, G_m = 1, Q = 2 }]
  | rheology.creep.rules.0.Q: 2.0: expected 0, no hardening
ONE | maxh = 0.5 -> maxh = 0.5; adapt = { field = "G", every = 0.02 } | unknown domain.adapt.field 'G'
ONE | maxh = 0.5 -> maxh = 0.5; adapt = { field = "J", every = 0.03 } | domain.adapt.every: 0.03: expected a
ONE | maxh = 0.5 -> maxh = 0.5; adapt = { field = "J", every = 0.02, levels = 9 } | a whole number from 1 to 8
ONE | until = 0.04 -> until = 0.04; relaxation = true | time.relaxation: true: expected false, or the scheme
ONE | + [output.vtk]; fields = ["G"] | unknown field 'G' (known: F, J, cauchy_stress, density
ONE | + [output.vtk]; fields = ["None"] | unknown field 'None'
ONE | + [walls."Slip(True)"]; kind = "Slip" | unknown boundary 'Slip(True)'
ONE | + [[output.integrals]]; name = "a"; of = "G"
  | density, F_11 ... F_33, J, cauchy_stress_11 ... cauchy_stress_33, pressure
ONE | maxh = 0.5 -> maxh = 0.5; periodic = true | domain.periodic: true: expected a text in quotes
ONE | maxh = 0.5 -> maxh = 0.5; periodic = ["x", 3] | domain.periodic.1: 3: expected a text in quotes
# what hung
ONE | K_e = 10 -> K_e = "10 Pa**9**9**9" | material.K_e: '10 Pa**9**9**9': 'Pa**9**9**9' is not a unit
ONE | dt = 0.02 -> dt = "2 s*99999999999**9999999999" | time.dt: '2 s*99999999999**9999999999':
ONE | LAW -> OWN "norm2(inv(inv(inv(inv(inv(inv(F)))))))"
  | 1e+05 operations when its powers are written out; expected at most 5000
ONE | LAW -> OWN "((((norm2(F))**9)**9)**9)**9 + norm2(F)" | written out; expected at most 5000
ONE | density = 1 -> density = "(((((((((1 + x)**16)**16)**16)**16)**16)**16)**16)**16)**16"
  | written out; expected at most 5000
"""


@pytest.mark.parametrize(("text", "message"), faults(NONSENSE, globals()))
def test_a_wrong_value_is_refused_with_its_place_in_the_file(text, message):
    with pytest.raises(CaseError) as caught:
        case = parse_case(text, "case.toml", Path("."))
        case.simulation(case.mesh())
    assert message in str(caught.value)
    said = str(caught.value).replace("Slip(True)", "")  # a wall has this text as its name
    assert not re.search(r" object at 0x|nv\.|\b[A-Z][a-z]\w*[(.]", said)


@pytest.mark.parametrize(
    ("parts", "in_python", "in_a_case"),
    [
        (
            ("Take ", call("Discretisation", k=1, m=0), ", or"),
            "Take nv.Discretisation(k=1, m=0), or",
            "Take discretisation.k = 1, discretisation.m = 0, or",
        ),
        (
            ("is ", call("Inflow", velocity=...)),
            "is nv.Inflow(velocity=...)",
            'is walls.NAME.kind = "Inflow"',
        ),
        (
            ("by ", call("Slip", straight=True)),
            "by nv.Slip(straight=True)",
            'by walls.NAME.kind = "Slip", walls.NAME.straight = true',
        ),
        ((call("Thermal", material=...), " has"), "nv.Thermal(material=...) has", "material.thermal has"),
        (("a 3x3 ", FUNCTION), "a 3x3 coefficient function", "a 3x3 expression"),
        (
            (Mention("walls['top'].f"), ": ", Mention("Initial.F")),
            "walls['top'].f: Initial.F",
            "walls.top.f: initial.F",
        ),
        (
            (Mention("Model.heat"), " or ", Mention("Model.bodies")),
            "Model.heat or Model.bodies",
            "rheology.heat or bodies",
        ),
        ((None, ", ", True, " or ", False), "None, True or False", "nothing, true or false"),
        ((Words(None, " with "), Words("bodies")), "None with bodies", "nothing with bodies"),
        (("None of U(J), Poisson(x)",), "None of U(J), Poisson(x)", "None of U(J), Poisson(x)"),
    ],
)
def test_a_message_about_a_case_names_keys_instead_of_python_names(parts, in_python, in_a_case):
    assert Words(*parts) == in_python
    assert in_case(nv.InputWarning(Words(*parts))) == in_case(Words(*parts)) == in_a_case
    assert in_case(nv.ParameterError("Initial.F", 1, *parts)) == f"initial.F = 1: expected {in_a_case}"
    for value, word in ((None, "nothing"), (True, "true")):
        error = nv.ParameterError("until", value, *parts)
        assert in_case(error) == f"time.until = {word}: expected {in_a_case}"


def test_a_message_about_a_case_writes_true_and_false_as_toml_does():
    with pytest.raises(nv.ParameterError, match=r"sharp = 1: expected True or False") as caught:
        nv.Discretisation(sharp=1)
    assert in_case(caught.value) == "discretisation.sharp = 1: expected true or false"


def test_a_pipe_is_refused_as_a_case_file(tmp_path):
    os.mkfifo(tmp_path / "case.toml")
    found = []

    def read():
        with pytest.raises(CaseError, match="a pipe or a device; expected a file"):
            nv.load_case(tmp_path / "case.toml")
        found.append(True)

    reader = threading.Thread(target=read, daemon=True)  # a failing read leaves this thread waiting
    reader.start()
    reader.join(5)
    assert found
