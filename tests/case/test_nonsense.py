"""Nonsense in case files: each is refused, at once, with the key to blame and what would be right."""

import os
import threading
from pathlib import Path

import pytest

import ngvisco as nv
from ngvisco.case.build import parse_case
from ngvisco.case.faults import CaseError

pytestmark = [
    pytest.mark.filterwarnings("ignore:bodies .* meet with different stresses"),
    pytest.mark.timeout(30),  # what hung did so for hours
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
LAW_OF_DISC = 'kind = "ReferentialNeoHookean", K_e = 10, G_e = 5, epsilon = 0.1'


def custom(energy, variables='["F"]'):
    return f'kind = "Custom"\nvariables = {variables}\nenergy = "{energy}"\n'


def more(table):
    """A table after all others."""
    return ("epsilon = 0.1\n", f"epsilon = 0.1\n{table}\n")


WRONGLY_ACCEPTED = [
    (TWO, (BALL, '"x - 0.5"'), "bodies.1.where: 'x - 0.5': expected a condition such as x < 0.5"),
    (
        ONE,
        more('[[output.integrals]]\nname = "a"\nof = "1/(density - density)"'),
        "output.integrals.0.of: '1/(density - density)': expected an integrand that is finite",
    ),
    (
        ONE,
        more('[[output.integrals]]\nname = "a"\nof = "log(-density)"'),
        "output.integrals.0.of: 'log(-density)': expected an integrand that is finite",
    ),
    (
        ONE,
        ("epsilon = 0.1", "epsilon = 0.1\nJ_min = 2.0"),
        "material.J_min: 2.0: expected less than J at the start",
    ),
    (TWO, (LAW_OF_DISC, LAW_OF_DISC + ", J_min = 2.0"), "expected no J_min: continued below it"),
    (
        ONE,
        ("density = 1", 'density = "1+t"'),
        "initial.density: '1+t': expected a function of the place alone",
    ),
    (
        ONE,
        ("density = 1", 'velocity = ["t*y", 0]'),
        "initial.velocity: ['t*y', 0]: expected a function of the place alone",
    ),
    (
        ONE,
        ("density = 1", "density = 1e-300"),
        "initial.density: 1e-300: expected 0, or a finite number from 1e-60",
    ),
    (
        ONE,
        ("density = 1", 'density = "1e-300"'),
        "initial density rho_0: 1e-300 to 1e-300; expected kg/m^3 from 1e-30",
    ),
    (ONE, ("K_e = 10", "K_e = 1e-300"), "material.K_e: 1e-300: expected 0, or a finite number from 1e-60"),
    (ONE, more("[rheology.creep]\nG_m = inf"), "rheology.creep.G_m: inf: expected a finite number"),
    (ONE, ("g = [0, -1]", "g = [[0, -1]]"), "loads.0.g: [[0, -1]]: expected an array of its components"),
    (ONE, ("g = [0, -1]", "g = [[0], [-1]]"), "loads.0.g: [[0], [-1]]: expected an array of its components"),
    (ONE, ("density = 1", "density = [[1]]"), "initial.density: [[1]]: expected a number, or an expression"),
    (
        ONE,
        more('[output]\npassive = ["creep_strain"]'),
        "output.passive: ['creep_strain']: expected a model with creep",
    ),
    (
        ONE,
        more("[output.bodies]\nevery = 2"),
        "output.bodies: { every = 2 }: expected no such table without [[bodies]]",
    ),
    (ONE, more("[output.vtk]\nfields = []"), "output.vtk.fields: []: expected at least one"),
    (
        ONE,
        more('[[output.probes]]\nname = "a"\npoint = [0.5, 0.5]\nfields = []'),
        "output.probes.0.fields: []: expected at least one",
    ),
    (ONE, more("[output.forces]\nwalls = []"), "output.forces.walls: []: expected at least one"),
    (
        ONE,
        more('[output.forces]\nwalls = ["top", "top"]'),
        "output.forces.walls: ['top', 'top']: expected each name",
    ),
    (
        ONE,
        (LAW, custom("det(F) - det(F)")),
        "material.energy: 'det(F) - det(F)': expected an energy that changes",
    ),
    (
        TWO,
        (LAW_OF_DISC, 'kind = "Custom", variables = ["J"], energy = "0*J + 1"'),
        "bodies.1.material.energy: '0*J + 1': expected an energy that changes with J",
    ),
]
WRONGLY_BLAMED = [
    (ONE, ("g = [0, -1]", "g = -1"), "loads.0.g: -1: expected an array of its components"),
    (ONE, ("K_e = 10", 'K_e = "10*x"'), "material.K_e: '10*x': at the start minimum"),
    (ONE, ("G_v = 0.01", 'G_v = "x - 2"'), "rheology.viscosity.G_v: 'x - 2': at the start minimum -2"),
    (
        TWO,
        ("K_e = 10, G_e = 5", 'K_e = 10, G_e = "x - 1"'),
        "bodies.1.material.G_e: 'x - 1': at the start minimum -1",
    ),
    (
        ONE,
        more('[rheology.hyperviscosity]\nmu = 1\np = "4"'),
        "rheology.hyperviscosity.p: '4': expected a number",
    ),
    (ONE, more('[rheology.creep]\nG_m = 1\nnu = 0.1\nq = "4"'), "rheology.creep.q: '4': expected a number"),
    (
        ONE,
        more('[rheology.regularisation]\ndelta_density = 1\nr = "4"'),
        "rheology.regularisation.r: '4': expected a number",
    ),
    (ONE, ("density = 1", "values = { J = -1 }"), "initial.values.J: initial projected J_0: minimum -1"),
    (ONE, ("g = [0, -1]", 'g = [0, -1]\nname = "a b"'), "loads.0.name: 'a b': expected a name of letters"),
    (
        ONE,
        more('[[loads]]\nkind = "Gravity"\ng = [0, 1]'),
        "loads.1.name: 'gravity': expected a name that no other",
    ),
    (
        ONE,
        more('[[loads]]\nkind = "CentralGravity"\nstrength = 1\nname = "q"\ncentre = [0, 0, 0]'),
        "loads.1.centre: [0.0, 0.0, 0.0]: expected 2 numbers",
    ),
    (
        TWO,
        ("density = 2.0", "density = 1e30"),
        "bodies.1.density: 1e+30: expected at most 1e+10 times that of 'rest'",
    ),
    (
        TWO,
        ("radius = 0.2", "radius = 0.001"),
        'bodies.1.where: { kind = "Ball", centre = [0.6, 0.5], radius = 0.001 }: expected a place within '
        "the domain, no thinner than 1/4 of the cells there",
    ),
    (
        TWO,
        (BALL, '"x > -1"'),
        "bodies.1.where: 'x > -1': expected a place that leaves something of the domain to 'rest'",
    ),
    (
        TWO,
        ('name = "rest"', 'name = "rest"\nwhere = "x < 0.2"\norder = 1'),
        "bodies: ['rest', 'disc']: expected one without a place, for the rest",
    ),
    (
        TWO,
        (LAW_OF_DISC, 'kind = "NeoHookean", K_e = 10, G_e = 5, epsilon = 0.1'),
        "an energy f(B) + U(J) per reference volume",
    ),
]
PYTHONS_WORDS = [
    (
        TWO,
        ("until = 0.04", "until = 0.04\n[initial]\ndensity = 2"),
        "initial.density: 2: expected nothing with bodies",
    ),
    (
        ONE,
        ("until = 0.04", "until = 0.04\nrelaxation = true"),
        "time.relaxation: true: expected false, or the scheme",
    ),
    (ONE, more('[output.vtk]\nfields = ["G"]'), "unknown field 'G' (known: F, J, cauchy_stress, density"),
    (
        ONE,
        more('[[output.integrals]]\nname = "a"\nof = "G"'),
        "density, F_11 ... F_33, J, cauchy_stress_11 ... cauchy_stress_33, pressure",
    ),
]
HUNG = [
    (ONE, ("K_e = 10", 'K_e = "10 Pa**9**9**9"'), "material.K_e: '10 Pa**9**9**9': 'Pa**9**9**9' is no unit"),
    (ONE, ("dt = 0.02", 'dt = "2 s*99999999999**9999999999"'), "time.dt: '2 s*99999999999**9999999999': "),
    (ONE, (LAW, custom("norm2(inv(inv(inv(inv(inv(inv(F)))))))")), "it has 1e+05 operations, at most 5000"),
    (ONE, (LAW, custom("((((norm2(F))**9)**9)**9)**9 + norm2(F)")), "operations, at most 5000"),
    (ONE, ("density = 1", f'density = "{"(" * 9}1 + x{")**16" * 9}"'), "operations, at most 5000"),
]


@pytest.mark.parametrize(
    ("text", "change", "message"), [*WRONGLY_ACCEPTED, *WRONGLY_BLAMED, *PYTHONS_WORDS, *HUNG]
)
def test_nonsense_is_refused_where_it_stands(text, change, message):
    assert change[0] in text
    with pytest.raises(CaseError) as caught:
        case = parse_case(text.replace(*change, 1), "case.toml", Path("."))
        case.simulation(case.mesh())
    assert message in str(caught.value)
    assert " object at 0x" not in str(caught.value) and "NeoHookean(" not in str(caught.value)


def test_a_pipe_is_no_case_file(tmp_path):
    os.mkfifo(tmp_path / "case.toml")
    found = []

    def read():
        with pytest.raises(CaseError, match="a pipe or a device, and no file"):
            nv.load_case(tmp_path / "case.toml")
        found.append(True)

    reader = threading.Thread(target=read, daemon=True)  # which a failing one leaves waiting
    reader.start()
    reader.join(5)
    assert found
