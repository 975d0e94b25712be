"""Materials of case files from Python files: a solute that swells a gel, and refused files."""

from pathlib import Path

import numpy as np
import pytest

import ngvisco as nv
from ngvisco.case.build import parse_case
from ngvisco.case.runs import load, run

LAW = '''\
from dataclasses import dataclass

import ngvisco as nv
from ngvisco.physics.variables import Concentration, ReciprocalJacobian


@dataclass(frozen=True, kw_only=True)
class Gel(nv.Material):
    """phi = K (1 - A - swelling c)^2/A + c^2/(2 A) + A^2/10, of A = 1/J and the amount c of a solute."""

    K: float
    swelling: float = 0.2

    def __post_init__(self):
        if not self.K > 0:
            raise nv.ParameterError("Gel.K", self.K, "a modulus > 0, Pa")

    @property
    def variables(self):
        return ReciprocalJacobian(), Concentration()

    def energy(self, z):
        A, c = z["A"], z["c"]
        off = 1 - A - self.swelling * c
        return self.K * off * off / A + 0.5 * c * c / A + 0.1 * A * A


def number(K=1.0):
    return K
'''
CASE = """\
domain = {{ geometry = "box", size = [1, 1], maxh = 0.6 }}
time = {{ dt = 0.05, until = 0.1 }}
initial = {{ density = 1.0, values = {{ c = "0.5 + 0.3*cos(pi*x)" }} }}
solver = {{ method = "{solver}" }}
[material]
{material}
[rheology]
viscosity = {{ K_v = 0.1, G_v = 0.1 }}
diffusion = {{ variable = "c", mobility = 0.1, walls = {{ left = {{ flux = "0.05" }} }} }}
"""
BY_PYTHON = """\
kind = "Python"
path = "gel.py"
law = "Gel"
parameters = { K = 10 }
"""
BY_EXPRESSION = """\
kind = "Custom"
variables = ["A", "c = amount"]
energy = "10*(1 - A - 0.2*c)**2/A + 0.5*c**2/A + 0.1*A**2"
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "gel.py").write_text(LAW)
    return tmp_path


def case(place: Path, material: str = BY_PYTHON, solver: str = "split") -> nv.Case:
    return parse_case(CASE.format(material=material, solver=solver), "gel.toml", place)


@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_a_material_from_a_python_file_runs_like_its_energy_given_as_an_expression(
    place: Path, solver: str
) -> None:
    found = []
    for material in (BY_PYTHON, BY_EXPRESSION):
        nv.time.Set(0.0)
        made = case(place, material, solver)
        ledger = made.simulation(made.mesh()).run(until=0.1)
        assert ledger.column("newton_iterations").max() <= 8
        found.append(ledger.column("dissipation_diffusion_c"))
    assert found[0][-1] > 1e-4 and np.allclose(*found, rtol=1e-9)


def test_a_run_directory_keeps_the_file_and_the_hash_depends_on_its_content(place: Path) -> None:
    made = case(place)
    (copy,), before = made.files, made.hash
    run(made, place / "run")
    assert (place / "run" / copy).read_text() == LAW
    assert nv.load_case(place / "run" / "case.toml").hash == before
    (place / "gel.py").write_text(LAW.replace("0.5 * c", "0.6 * c"))
    assert case(place).hash != before
    (place / "gel.py").unlink()
    assert load(place / "run").simulation.number == 2


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        (
            "path",
            '"sol.py"',
            r"material\.path.*a Python file that can be read, but sol\.py cannot be read: No such file",
        ),
        (
            "law",
            '"Sol"',
            r"material\.law.*'Sol'.*a class or function of gel\.py that makes a material; gel\.py has Gel",
        ),
        ("law", '"number"', r"material\.law.*makes an ngvisco\.Material, not a float"),
        ("parameters", "{ G = 1 }", r"material\.parameters.*Gel\(.*K.*missing a required"),
        ("parameters", "{ K = -1 }", r"material\.parameters\.K.*-1.*a modulus > 0, Pa"),
    ],
)
def test_a_wrong_material_of_a_python_file_is_refused_under_the_key_at_fault(
    place: Path, key: str, value: str, said: str
) -> None:
    lines = [f"{key} = {value}" if line.startswith(key) else line for line in BY_PYTHON.splitlines()]
    with pytest.raises(nv.CaseError, match=f"(?s){said}"):
        case(place, "\n".join(lines)).model(2)


def test_a_file_that_raises_is_refused(place: Path) -> None:
    (place / "gel.py").write_text("import nowhere\n")
    with pytest.raises(nv.CaseError, match=r"material\.path.*this file raises ModuleNotFoundError"):
        case(place).model(2)
