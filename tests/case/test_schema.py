"""Case files: every fault is named with its place, value and remedy, and valid cases run."""

import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from support import faults

import ngvisco as nv
from ngvisco.case import CaseError
from ngvisco.case.build import parse_case
from ngvisco.case.faults import Locator, faults_of
from ngvisco.case.schema import CaseSections
from ngvisco.case.toml import key_lines, override, parse_override, write

CASE = """\
title = "a case"
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.5

[material]
kind = "NeoHookean"
K_e = 10
G_e = 5
epsilon = 0.1

[rheology.creep]
G_m = 5

[[loads]]
kind = "Gravity"
g = [0, "-1 + 0.1*t"]

[initial]
density = "1 + 0.1*x"
velocity = ["sin(pi*x)*cos(pi*y)", "-cos(pi*x)*sin(pi*y)"]

[walls.left]
kind = "Slip"

[time]
dt = 0.02
until = 0.1
"""


def case(text, *overrides):
    return parse_case(text, "case.toml", Path("."), overrides)


def simulation(text):
    loaded = case(text)
    made = loaded.simulation(loaded.mesh())
    loaded.check_end(made)
    return made


FAULTS = """\
CASE | G_e = 5 -> Ge = 5 | case.toml:10: material.Ge: unknown key; did you mean 'G_e'?
CASE | G_e = 5 ->  | case.toml:7: material.G_e: is missing
CASE | K_e = 10 -> K_e = -10 | case.toml:9: material.K_e: -10.0: expected a finite number > 0
CASE | K_e = 10 -> K_e = "10" | case.toml:9: material.K_e: '10': expected a number
CASE | "NeoHookean" -> "NeoHokean" | did you mean 'NeoHookean'?
CASE | kind = "NeoHookean" ->  | case.toml:7: material: the key 'kind' is missing
CASE | geometry = -> geomtry = | 'geometry' is missing; the key 'geomtry' is unknown: did you mean 'geometry'?
CASE | size = [1, 1] -> size = 1 | case.toml:4: domain.size: 1: expected an array
CASE | size = [1, 1] -> size = [1, "a"] | case.toml:4: domain.size.1: 'a': expected a number
CASE | [rheology.creep] -> [rheology.crep] | rheology.crep: unknown key; did you mean 'creep'?
CASE | "Gravity" -> "gravity" | case.toml:17: loads.0.kind: 'gravity'
CASE | 0.1*t -> 0.1*q | case.toml:18: loads.0.g: [0, '-1 + 0.1*q']: unknown name 'q'
CASE | 0.1*t -> 0.1/0 | the value is not finite (float division by zero), at character 6 of '-1 + 0.1/0'
CASE | g = [0, -> g = [nan, | loads.0.g: [nan, '-1 + 0.1*t']: expected a finite number
CASE | "1 + 0.1*x" -> "os.system(1)" | case.toml:21: initial.density: 'os.system(1)': a function is called by
CASE | [initial] -> [intial] | case.toml:20: intial: unknown key; did you mean 'initial'?
CASE | dt = 0.02 -> dt = 1e-300 | time.dt: 1e-300: expected at least 1.1e-09 s, since this length makes
CASE | dt = 0.02 -> dt = true | case.toml:28: time.dt: true: expected a number
CASE | until = 0.1 -> until = 0.11 | time.until: 0.11: expected a multiple of dt = 0.02
CASE | until = 0.1 -> until = 0.1; [solver]; max_iterations = 2.5 | expected a whole number
CASE | until = 0.1 -> until = 0.1; [solver]; coarse = "amg"
  | solver.coarse: 'amg': expected 'direct', 'gamg' or 'hypre'
CASE | until = 0.1 -> until = 0.1; [output.vtk]; interval = 0.03 | output.vtk.interval: 0.03: expected a mult
CASE | until = 0.1 -> until = 0.1; [time.adaptive]; dt_min = 1; dt_max = 0.1 | time.adaptive.dt_max: 0.1
CASE | title = "a case" -> title = 3 | case.toml:1: title: 3: expected a text in quotes
CASE | [domain] -> [domain | the file is not TOML
CASE | walls.left -> walls.lef | case.toml:24: walls.lef: unknown boundary 'lef'; did you mean 'left'?
CASE | size = [1, 1] -> size = [1] | case.toml:4: domain.size: [1.0]: expected two or three
CASE | 1 + 0.1*x -> x - 1 | case.toml:21: initial.density: initial density rho_0: the minimum is -1
CASE | sin(pi*x)*cos -> log(x - 2)*cos | case.toml:22: initial.velocity
CASE | 1 + 0.1*x -> z + 1 | initial.density: 'z + 1': expected a function of x and y, since
CASE | -1 + 0.1*t -> z | case.toml:18: loads.0.g: [0, 'z']: expected a function of x and y, since
CASE | -1 + 0.1*t -> log(x - 2) | case.toml:18: loads.0.g: [0, 'log(x - 2)']: expected finite
CASE | -1 + 0.1*t -> sqrt(0.05 - t) | finite values; at t = 0.075 s the value is not finite somewhere
CASE | g = [0, -> g = [0, 0, | case.toml:18: loads.0.g: [0, 0, '-1 + 0.1*t']: expected a vector with 2
CASE | [walls -> [initial.values]; Q = 1; [walls | unknown material variable 'Q'
CASE | [walls -> [initial.values]; F = [[1, 0], [0]]; [walls | initial.values.F: [[1, 0], [0]]: expected three
CASE | velocity = -> F = [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]; velocity =
  | initial.F: initial det F_0: the minimum is -1
CASE | until = 0.1 -> until = 0.1; [output.vtk]; fields = ["desity"] | did you mean 'density'?
"""


@pytest.mark.parametrize(("text", "message"), faults(FAULTS, {"CASE": CASE}))
def test_a_fault_is_reported_with_line_key_value_and_remedy(text, message):
    with pytest.raises(CaseError) as caught:
        simulation(text)
    assert message in str(caught.value)


def test_a_number_with_thousands_of_digits_is_reported_as_a_fault_of_the_file():
    with pytest.raises(CaseError, match=r"case\.toml: the file is not TOML: Exceeds the limit"):
        simulation(CASE.replace("until = 0.1", "until = " + "9" * 5000))


def test_the_limit_of_the_number_of_adaptive_steps_counts_steps_of_the_largest_length():
    """In a run with steps from half a second to a year, dt is only the length of the first step."""
    steps = ["time.dt=0.5", "time.until='30 yr'", "time.adaptive.dt_min=0.1"]
    assert case(CASE, *steps, "time.adaptive.dt_max='1 yr'").until > 9e8
    with pytest.raises(
        CaseError,
        match=r"time.adaptive.dt_max.*: expected at least 10 s, since this length makes 9e\+08",
    ):
        case(CASE, *steps, "time.adaptive.dt_max=1")


@pytest.mark.parametrize("until", [1.04, 3.0])
def test_the_least_step_that_a_refusal_names_is_accepted(until):
    """The nearest number with two digits would be refused as well."""
    steps = [f"time.until={until}", "time.dt=1e-12", "time.adaptive.dt_min=1e-13"]
    with pytest.raises(CaseError, match="expected at least") as caught:
        case(CASE, *steps, "time.adaptive.dt_max=1e-11")
    least = re.search(r"at least (\S+) s", str(caught.value))[1]
    assert float(least) < 1.2e-8 * until
    case(CASE, *steps, f"time.adaptive.dt_max={least}")


def test_all_faults_are_reported_at_once():
    broken = (
        CASE.replace("G_e = 5", "Ge = 5").replace("dt = 0.02", "dt = -1").replace("[initial]", "[intial]")
    ).replace('kind = "Slip"', 'kind = "Open"\ndensity = -1\npressure = "x"')
    with pytest.raises(CaseError) as caught:
        case(broken)
    assert {fault.key for fault in caught.value.faults} >= {
        "material.Ge",
        "material.G_e",
        "time.dt",
        "intial",
        "walls.left.density",
    }


def test_resolved_case_is_complete_and_resolves_to_itself():
    loaded = case(CASE)
    again = case(loaded.resolved)
    assert again.resolved == loaded.resolved and again.hash == loaded.hash
    data = tomllib.loads(loaded.resolved)
    orders = {"k": 2, "m": 1, "quadrature_bonus": 0}
    assert data["discretisation"] == orders | {"sharp": False, "outlines": False}
    assert data["solver"]["tolerance"] == nv.NewtonOptions().tolerance


def test_the_hash_depends_on_the_keys_that_change_the_solution_and_on_no_others():
    same = case(CASE, "time.until=0.2", "title=b", "output.vtk.every=3")
    assert same.hash == case(CASE).hash
    for setting in ("material.G_e=6", "time.dt=0.01", "solver.tolerance=1e-9", "initial.density=1"):
        assert case(CASE, setting).hash != case(CASE).hash


def test_settings_of_the_command_line_override_keys_and_are_named_in_faults():
    changed = case(CASE, "material.G_e=6", "loads.0.g=[1, 0]", "initial.density=2 + x", "title=new")
    assert changed.sections.material.G_e == 6 and changed.sections.loads[0].g == [1, 0]
    assert changed.sections.initial.density == "2 + x" and changed.sections.title == "new"
    with pytest.raises(CaseError, match=r"material\.G_e \(set on the command line\): -6.0: expected"):
        case(CASE, "material.G_e=-6")
    for setting, message in (
        ("G_e", "expected key.path=value"),
        ("=3", "expected key.path=value"),
        ("loads.7.g=1", "the command line's loads.7: expected an index below 1"),
        ("title.x=1", "is not a table"),
    ):
        with pytest.raises(CaseError, match=message):
            case(CASE, setting)


def test_without_creep_the_default_elastic_state_follows_from_the_orders():
    """The resolved case of a run directory stores the elastic state; a law that exists by F only keeps F."""
    still = CASE.replace("[rheology.creep]\nG_m = 5\n", "")
    for m, state in ((0, "B"), (1, "F")):
        found = case(still, f"discretisation.m={m}", f"discretisation.k={m + 1}")
        assert tomllib.loads(found.resolved)["material"]["elastic_state"] == state
        assert [v.name for v in found.model(2).material.variables] == [state, "J"]
        assert f"by the default elastic_state = '{state}'" in found.carried
        assert case(found.resolved).hash == found.hash and "default" not in case(found.resolved).carried
    ogden = case(CASE, "material={kind='Ogden', K_e=10, mu=[1.0], alpha=[1.3]}")
    assert tomllib.loads(ogden.resolved)["material"]["elastic_state"] == "F"
    assert case(ogden.resolved).hash == ogden.hash


def test_the_default_elastic_state_is_B_with_creep_and_F_without():
    creeping, still = case(CASE), case(CASE.replace("[rheology.creep]\nG_m = 5\n", ""))
    found = [tomllib.loads(c.resolved)["material"]["elastic_state"] for c in (creeping, still)]
    assert found == ["B", "F"]
    assert [v.name for v in creeping.model(2).material.variables] == ["B", "J"]
    given = case(CASE, "material.elastic_state='F'")
    assert [v.name for v in given.model(2).material.variables] == ["F", "J"]
    assert given.hash != creeping.hash == case(CASE, "material.elastic_state='B'").hash
    with pytest.raises(CaseError, match=r"material.elastic_state .*'C'.*expected 'F' or 'B'"):
        case(CASE, "material.elastic_state='C'")
    law = "rheology.creep.law='conformation'"
    with pytest.raises(CaseError, match=r"rheology\.creep: .*a rule that reads no conformation tensor"):
        case(CASE, law).model(2)
    fluid = case(CASE, law, "material={kind='OldroydB', K_e=10, G_e=5}").model(2)
    assert fluid.creep.law == "conformation"


WRAPPED = """\
[material]
kind = "WithQuadratic"
delta = 1e-6

[material.material]
kind = "Yosida"
eps = 1e-3

[material.material.material]
"""


def test_a_material_may_wrap_another_one():
    """The test builds the paper's energy: the Yosida approximation with the quadratic term."""
    text = CASE.replace("[material]\n", WRAPPED)
    run = simulation(text)
    assert run.model.material == nv.WithQuadratic(
        material=nv.Yosida(
            material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="B"), eps=1e-3
        ),
        delta=1e-6,
    )
    assert abs(run.run(0.02).column("closure_relative")[-1]) < 1e-13
    loaded = case(text)
    assert case(loaded.resolved).hash == loaded.hash
    assert case(text, "material.material.eps=2e-3").hash != loaded.hash


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "material.material.eps=-1",
            r"material.material.eps \(set on the command line\): -1.0: expected a fin",
        ),
        ("material.material.eps='a'", "expected a number"),
        ("material.material.epsilon=1", r"unknown key; did you mean 'eps'\?"),
        ("material.material.material.kind='WithQuadratic'", "'WithQuadratic': expected one of BarotropicFl"),
        ("material.material.material.G_e=0", "material.material.material.G_e .*: 0.*: expected a finite"),
        ("material.material.material.Ge=1", r"unknown key; did you mean 'G_e'\?"),
        ("material.only=['Q']", r"unknown material variable 'Q' \(known: B, F, J\)"),
        ("material.material=1", "expected a table"),
    ],
)
def test_faults_of_wrapped_materials_are_reported_with_their_path(override, message):
    with pytest.raises(CaseError, match=message):
        case(CASE.replace("[material]\n", WRAPPED), override)


def test_missing_unreadable_and_huge_files_are_refused(tmp_path):
    with pytest.raises(CaseError, match="cannot be read: No such file"):
        nv.load_case(tmp_path / "a.toml")
    with pytest.raises(CaseError, match="cannot be read: Is a directory"):
        nv.load_case(tmp_path)
    (tmp_path / "b.toml").write_bytes(b"title = '\xff'")
    with pytest.raises(CaseError, match=r"b.toml:1: the file is not text in UTF-8"):
        nv.load_case(tmp_path / "b.toml")
    with (tmp_path / "c.toml").open("wb") as file:
        file.truncate(3_000_000_000)  # a sparse file, which takes no space on the disk
    with pytest.raises(CaseError, match="longer than 1000000 bytes"):
        nv.load_case(tmp_path / "c.toml")


def outcome(text):
    try:
        return case(text)
    except CaseError as error:
        assert str(error)
        return None


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_read_as_a_case_or_raises_a_case_error(text):
    outcome(text)


@settings(max_examples=200, deadline=None)
@given(
    st.integers(0, len(CASE)),
    st.integers(0, 12),
    st.text(max_size=8) | st.text(alphabet='[]{}"=.,0123456789eE-+\nnaif', max_size=12),
)
def test_a_damaged_case_file_is_read_or_raises_a_case_error(start, length, insertion):
    outcome(CASE[:start] + insertion + CASE[start + length :])


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**20), 10**20)
    | st.floats()
    | st.text(alphabet=st.characters(codec="utf-8", exclude_characters="\r"), max_size=10),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text("abg_", min_size=1), inner, max_size=3)
    ),
    max_leaves=6,
)
PATHS = sorted(".".join(path) for path in key_lines(CASE))


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(PATHS), VALUES)
def test_any_value_of_any_key_is_accepted_or_raises_a_case_error(path, value):
    data = tomllib.loads(CASE)
    override(data, tuple(path.split(".")), value)
    try:
        CaseSections.model_validate(data)
    except ValidationError as error:
        assert faults_of(error, CaseSections, Locator(key_lines(CASE)))


TABLES = st.dictionaries(
    st.text(alphabet=st.characters(codec="utf-8"), max_size=6),
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(alphabet=st.characters(codec="utf-8"), max_size=12)
    | st.lists(st.integers(0, 9), max_size=3)
    | st.dictionaries(st.text("ab", min_size=1, max_size=2), st.integers(0, 9), max_size=2),
    max_size=4,
)


@settings(max_examples=200, deadline=None)
@given(TABLES)
def test_toml_that_is_written_is_read_back_unchanged(data):
    assert tomllib.loads(write(data)) == data


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=30))
def test_any_setting_of_the_command_line_is_read_or_refused(text):
    try:
        path, _ = parse_override(text)
    except ValueError:
        return
    assert path and all(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        (".5", 0.5),
        ("-.5e3", -500.0),
        ("5.", 5.0),
        ("5.0", 5.0),
        (".5.2", ".5.2"),
        (".5 m", ".5 m"),
        (".", "."),
    ],
)
def test_a_number_in_a_setting_may_begin_or_end_with_its_decimal_point(text, value):
    assert parse_override(f"domain.maxh={text}") == (("domain", "maxh"), value)


def test_an_index_may_stand_in_brackets_or_behind_a_dot():
    assert parse_override("loads[0].g=[0, -1]") == parse_override("loads.0.g=[0, -1]")
