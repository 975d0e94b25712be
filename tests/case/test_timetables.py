"""Loads and walls by tables of time: files beside the case, whose numbers the run's directory keeps."""

from pathlib import Path

import pytest

import ngvisco as nv
from ngvisco.case.build import load_case, parse_case
from ngvisco.case.faults import CaseError
from ngvisco.physics.signals import number_rows

CASE = """
[units]
time = "ms"
acceleration = "km/s^2"
[domain]
geometry = "box"
size = [1, 1]
maxh = 1.0
[material]
kind = "BarotropicFluid"
B = 1.0
gamma = 1.4
[time]
dt = 100.0
until = 200.0
[[loads]]
kind = "Gravity"
g = [{ file = "load.csv", column = 2 }, 0]
[walls.top]
kind = "Traction"
f = { file = "pull.csv" }
"""


def written(folder: Path, text: str = CASE) -> Path:
    (folder / "load.csv").write_text("t,a,b\n0,5,0\n10,5,0.003\n30,5,0\n")
    (folder / "pull.csv").write_text("0,1,0\n100,3,0\n")
    (folder / "case.toml").write_text(text)
    return folder / "case.toml"


def test_tables_are_read_in_the_case_s_units(tmp_path):
    """Times are in ms and accelerations in km/s^2; the means of the first step are those of the tables."""
    case = load_case(written(tmp_path))
    load = case.sections.loads[0].g
    assert load[0] == {"times": [0.0, pytest.approx(0.01), pytest.approx(0.03)], "values": [0.0, 3.0, 0.0]}
    run = case.simulation(case.mesh())
    average = run.rothe_step.context.average
    gravity, pull = run.model.loads[0].g, run.rothe_step.walls.conditions["top"].f
    run.rothe_step.context.set_loads(0.0, 0.1)
    assert average(gravity)(run.mesh(0.3, 0.3)) == pytest.approx((0.45, 0.0))
    nv.time.Set(0.05)
    assert pull(run.mesh(0.3, 0.3)) == pytest.approx((2, 0))
    nv.time.Set(0.0)


def test_a_resolved_case_contains_its_tables_and_needs_no_other_file(tmp_path):
    case = load_case(written(tmp_path))
    again = parse_case(case.resolved, "again", Path("nowhere"))
    assert again.resolved == case.resolved and again.hash == case.hash
    (tmp_path / "load.csv").write_text("0,1,2\n1,5,9\n")
    assert load_case(tmp_path / "case.toml").hash != case.hash


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"load.csv"', '"none.csv"', "can be read"),
        ("column = 2", "column = 3", "from 1 to 2"),
        ("column = 2", "column = true", "from 1 to 2"),
        ('"load.csv"', "7", "path of a CSV file"),
        ("column = 2", "row = 2", "a number, or an expression"),
    ],
)
def test_wrong_tables_are_refused_under_their_keys(tmp_path, old, new, message):
    with pytest.raises(CaseError, match=message) as caught:
        load_case(written(tmp_path, CASE.replace(old, new)))
    assert ":18: loads.0.g" in str(caught.value)


NUMBERS = {
    "names": ("t,p\n0,1\n1,2\n", None),
    "no names": ("0,1\n1,2\n", None),
    "semicolons, comments, empty lines": ("# s; Pa\n\n t ; p\n0; 1 # first\n1;2\n", None),
    "quotes": ('"t","p"\n"0","1"\n"1","2"\n', None),
    "a mark of the byte order": ("\ufeff0,1\n1,2\n", None),
    "a misspelt first number": ("0,1.0s\n1,2\n", "'0,1.0s': expected numbers like 0.5 .* in line 1"),
    "decimal commas": ("t;p\n0,0;1,0\n1,0;2,0\n", "'0,0;1,0': expected numbers like 0.5 with ';'"),
    "a name too few": ("t\n0,1\n1,2\n", "'2 numbers': expected 1 numbers in line 2"),
    "words": ("t,p\n0,1\nend,end\n", "'end,end': expected numbers .* in line 3"),
    "times in another column": ("p, Time\n0,1\n1,2\n", "'p, Time': expected the times in column 1"),
    "SI units": ("t [s], v (m s^-1)\n0,1\n1,2\n", None),
}


@pytest.mark.parametrize("kind", NUMBERS)
def test_a_file_of_numbers_is_read_completely_or_refused_with_the_line_at_fault(tmp_path, kind):
    text, message = NUMBERS[kind]
    (path := tmp_path / "numbers.csv").write_text(text, encoding="utf-8")
    if message is None:
        assert number_rows("table", path).tolist() == [[0, 1], [1, 2]]
    else:
        with pytest.raises(nv.ParameterError, match=f"table = {message}"):
            number_rows("table", path)


@pytest.mark.parametrize(
    ("names", "unit"), [("t [ms], p", "ms"), ("time, p (kPa)", "kPa"), ("t, e [%]", "%")]
)
def test_a_unit_in_the_names_of_columns_that_is_no_si_unit_is_named_as_not_read(tmp_path, names, unit):
    (path := tmp_path / "numbers.csv").write_text(f"{names}\n0,1\n1,2\n")
    with pytest.warns(
        nv.errors.InputWarning, match=f"numbers.csv: the unit '{unit}' of a column is not read"
    ):
        assert number_rows("table", path).tolist() == [[0, 1], [1, 2]]


def test_a_prony_table_whose_names_put_the_times_first_is_refused(tmp_path):
    """With the shares 0.1 and 0.5, the columns in the wrong order are a valid series too."""
    (path := tmp_path / "prony.csv").write_text("tau, g\n0.1, 0.3\n0.5, 0.2\n")
    with pytest.raises(nv.ParameterError, match="'tau, g': expected the times in column 2"):
        nv.read_prony(path)
    path.write_text("g, tau_i [s]\n0.1, 0.3\n0.5, 0.2\n")
    assert nv.read_prony(path).tolist() == [[0.1, 0.3], [0.5, 0.2]]


PRESSED = CASE.replace('kind = "Traction"\nf = { file = "pull.csv" }', 'kind = "Open"\npressure = PRESSURE')


def test_a_number_of_a_wall_may_be_given_by_a_table_of_time(tmp_path):
    """The file of the table may begin with a byte order mark."""
    table = '{ file = "pull.csv", column = 1 }'
    case = load_case(written(tmp_path, "\ufeff" + PRESSED.replace("PRESSURE", table)))
    again = parse_case(case.resolved, "again", Path("nowhere"))
    assert again.resolved == case.resolved
    run = again.simulation(again.mesh())
    average = run.rothe_step.context.average
    run.rothe_step.context.set_loads(0.0, 0.1)
    assert average(run.rothe_step.walls.conditions["top"].pressure)(run.mesh(0.3, 0.3)) == pytest.approx(2)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('{ file = "pull.csv" }', "expected one column of values"),
        ('{ file = "pull.csv", row = 1 }', "a number, or an expression"),
    ],
)
def test_a_table_of_several_columns_is_refused_for_a_number(tmp_path, table, message):
    with pytest.raises(CaseError, match=message) as caught:
        load_case(written(tmp_path, PRESSED.replace("PRESSURE", table)))
    assert "walls.top.pressure" in str(caught.value)
