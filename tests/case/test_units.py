"""Units are converted when a case is read: the same case in other units gives the same run."""

import math
import warnings
from pathlib import Path

import pytest

import ngvisco as nv
from ngvisco.case.build import parse_case
from ngvisco.case.reference import entries
from ngvisco.case.units import SI, Converter, UnitError, converted, factor, key_and_unit_of

CASE = """\
[units]
length = "km"
time = "min"
pressure = "GPa"
velocity = "cm/s"
[domain]
geometry = "box"
size = [2, "1 km"]
maxh = "600 m"
refine = { top = 0.4 }
[material]
kind = "LinearElastic"
K_e = 10
G_e = "5e3 MPa"
[rheology.viscosity]
K_v = "1 GPa min"
G_v = 1e9
[rheology.hyperviscosity]
mu = "1e3 Pa km^4 s^3"
[[loads]]
kind = "Gravity"
g = [0, "-981 cm/s^2"]
[initial]
density = "2500 + 100*y"
velocity = ["3*sin(pi*x/2)", 0]
values = { E = [["0.001*x", 0, 0], [0, 0, 0], [0, 0, 0]] }
[walls.top]
kind = "Traction"
f = ["1e-6*sin(t)", 0]
[time]
dt = "100 ms"
until = "0.2 s"
[[output.probes]]
name = "tip"
point = [2, 0.5]
"""
IN_SI = """\
[domain]
geometry = "box"
size = [2000, 1000]
maxh = 600
refine = { top = 400 }
[material]
kind = "LinearElastic"
K_e = 10e9
G_e = 5e9
[rheology.viscosity]
K_v = 60e9
G_v = 1e9
[rheology.hyperviscosity]
mu = 1e15
[[loads]]
kind = "Gravity"
g = [0, -9.81]
[initial]
density = "2500 + 0.1*y"
velocity = ["0.03*sin(pi*x/2000)", 0]
values = { E = [["1e-6*x", 0, 0], [0, 0, 0], [0, 0, 0]] }
[walls.top]
kind = "Traction"
f = ["1e3*sin(t/60)", 0]
[time]
dt = 0.1
until = 0.2
[[output.probes]]
name = "tip"
point = [2000, 500]
"""


def case(text, *settings):
    from pathlib import Path

    return parse_case(text, "case.toml", Path("."), settings)


def flat(node, path=()):
    if isinstance(node, dict):
        node = node.items()
    elif isinstance(node, list):
        node = enumerate(node)
    else:
        yield path, node
        return
    for name, part in node:
        yield from flat(part, (*path, name))


def test_a_case_in_other_units_equals_the_case_in_si_units():
    given, expected = (dict(flat(case(text).sections.model_dump())) for text in (CASE, IN_SI))
    assert given.keys() == expected.keys()
    for path, value in expected.items():
        if isinstance(value, float):
            assert given[path] == pytest.approx(value, rel=1e-12), path
        elif not isinstance(value, str) or path[0] not in ("initial", "walls"):
            assert given[path] == value, path


def test_a_run_in_other_units_equals_the_run_in_si_units():
    ledgers = []
    for text in (CASE, IN_SI):
        loaded = case(text)
        ledgers.append(loaded.simulation(loaded.mesh()).run(0.2))
    for name in ledgers[0].columns:
        a, b = (ledger.column(name) for ledger in ledgers)
        if name in ("kinetic", "stored", "mass", "power_traction_top", "dissipation_hyper", "v_max"):
            assert a == pytest.approx(b, rel=1e-6), name


def test_a_resolved_case_is_in_si_and_resolves_to_itself():
    loaded = case(CASE)
    again = case(loaded.resolved)
    assert again.resolved == loaded.resolved and again.hash == loaded.hash
    assert again.sections.units.length == "m" and again.sections.domain.size == [2000, 1000]


def test_every_unit_in_the_reference_of_keys_is_known():
    exponents = {"p": 4.0, "q": 4.0, "r": 3.0, "n": 3.0, "gamma": 1.4}
    for meant in entries():
        if meant.unit not in ("", "1", "any"):
            unit = meant.unit
            for letter, value in exponents.items():
                unit = unit.replace(f"^{letter}", f"^{value}").replace(f"(2-{letter})", f"({2 - value})")
            assert factor(unit, unit) == 1, meant.name
    assert factor("kyr", "s") == 1000 * 365.25 * 86400 and factor("km", "m") == 1000
    assert set(SI) == set(type(case(IN_SI).sections.units).model_fields)


def test_the_unit_of_a_key_may_depend_on_an_exponent_of_its_section():
    """The unit of mu depends on p, because mu |hess v|^p is in W/m^3."""
    text = IN_SI.replace("mu = 1e15", 'mu = "2 Pa km^2 s"\np = 2')
    assert case(text).sections.rheology.hyperviscosity.mu == pytest.approx(2e6)
    wrong = IN_SI.replace("mu = 1e15", 'mu = "2 Pa km^2 s"')
    with pytest.raises(
        nv.CaseError, match=r"rheology.hyperviscosity.mu: .*does not have the dimension of W/m\^3"
    ):
        case(wrong)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        (
            "units.length='kg'",
            r"units.length .*'kg' does not have the dimension of m; expected a unit such as m",
        ),
        ("units.length='foo'", "units.length .*'foo' is not a known unit"),
        ("units.length=''", "units.length .*expected a unit"),
        ("units.length='__import__(1)'", "units.length .*not a known unit"),
        ("units.length=3", "units.length .*3: expected a text"),
        ("units.lenght='km'", "units.lenght .*did you mean 'length'"),
        ("time.dt='10 m'", "time.dt .*'10 m': 'm' does not have the dimension of s"),
        ("time.dt='-10 ms'", r"time.dt .*-0.01: expected a finite number > 0 .*the case has '-10 ms'"),
        ("time.dt='ten s'", "time.dt .*'ten s': expected a number"),
        ("time.dt='1e999 s'", "time.dt .*expected"),
        ("domain.maxh=-3", r"domain.maxh .*-3000.0: expected .*the case has -3"),
        ("domain.size=['2 km', '1 s']", "domain.size .*'s' does not have the dimension of m"),
        ("initial.density='3 km'", "initial.density .*'km' does not have the dimension of kg"),
        ("initial.density='3300 + q'", r"initial.density .*unknown name 'q' .*character 8 of '3300 \+ q'"),
        ("initial.values={J='3 m'}", "initial.values .*a pure number is expected"),
        ("discretisation.k='2 m'", "discretisation.k .*expected a whole number"),
    ],
)
def test_a_wrong_unit_is_refused_under_its_key(setting, message):
    with pytest.raises(nv.CaseError, match=message):
        loaded = case(CASE, setting)
        loaded.mesh()


def test_degrees_celsius_are_converted_by_an_offset_and_have_no_factor():
    assert converted(-20.0, "degC", "K") == pytest.approx(253.15, rel=1e-15)
    assert converted(2.0, "W/(m delta_degC)", "W/(m K)") == pytest.approx(2.0, rel=1e-15)
    with pytest.raises(UnitError, match="degC"):
        factor("degC", "K")


@pytest.mark.parametrize("unit", ["m" * 500, "(", "m**m", "1/0", "m**1e400", "\0", "degC", "-m", "[[", "m;m"])
def test_any_wrong_unit_raises_a_unit_error(unit):
    with pytest.raises(UnitError):
        factor(unit, "m")


def test_expressions_whose_signs_also_occur_in_units_are_not_read_as_units():
    sections = case(IN_SI, "initial.density='1 if x > 0 else 2'").sections
    assert sections.initial.density == "1 if x > 0 else 2"
    scaled = case(CASE, "initial.density='1 if x > 0 else 2 - y*(x + t)'")
    f = scaled.sections.initial.density
    from ngvisco.expressions import parse

    mesh = nv.geometries.box(size=[2000.0, 1000.0], maxh=2000.0)
    nv.time.Set(120.0)
    assert parse(f).coefficient()(mesh(1000, 500)) == 1
    g = case(CASE, "initial.density='2 + y*(x + t)'").sections.initial.density
    assert parse(g).coefficient()(mesh(1000, 500)) == pytest.approx(2 + 0.5 * (1 + 2))
    nv.time.Set(0.0)
    assert math.isclose(factor("min", "s"), 60)


def test_a_time_of_the_command_line_is_in_seconds_or_has_its_unit():
    number = Converter(None).number
    assert number("12.5", "s") == 12.5 and number("2 min", "s") == 120
    assert number("140 kyr", "s") == pytest.approx(140e3 * 365.25 * 86400)
    for text in ("soon", "2 m", "1 kyr 3", "1 inf"):
        with pytest.raises(UnitError):
            number(text, "s")


def test_velocities_without_a_unit_beside_lengths_and_times_with_units_bring_a_warning():
    """No unit is derived from others: with km and kyr a plain velocity is in m/s."""
    text = CASE.replace('velocity = "cm/s"\n', "", 1)
    with pytest.warns(
        nv.InputWarning, match="length in km and time in min, but velocities without a unit are in m/s"
    ):
        parse_case(text, "case.toml", Path("."))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parse_case(CASE, "case.toml", Path("."))


NORTON = """\
[domain]
geometry = "box"
size = [1, 1]
maxh = 1
[material]
kind = "LinearElastic"
K_e = 10
G_e = 5
[rheology.creep]
kind = "Norton"
A = "0.5 1/s/MPa^2.5"
n = 2.5
[time]
dt = "0.1 1/Hz"
until = 0.2
"""


def test_a_unit_may_begin_with_1_and_a_slash():
    sections = parse_case(NORTON, "case.toml", Path()).sections
    factor_of_power = sections.rheology.creep.A
    assert factor_of_power == pytest.approx(0.5e-15, rel=1e-12)
    assert sections.time.dt == pytest.approx(0.1, rel=1e-12)


def test_a_fit_prints_a_power_law_in_the_unit_of_its_fitted_exponent():
    """A fit prints A in the unit that belongs to the fitted n, so that the printed command runs."""
    sections = parse_case(NORTON, "case.toml", Path()).sections
    assert key_and_unit_of("creep.A", sections) == ("rheology.creep.A", "1/s/Pa^(2.5)")
    key, unit = key_and_unit_of("creep.A", sections, {"rheology.creep.n": 2.988765432})
    settings = [f"{key}=0.25 {unit}", "rheology.creep.n=2.988765432"]
    again = parse_case(NORTON, "case.toml", Path(), settings)
    assert again.sections.rheology.creep.A == 0.25
