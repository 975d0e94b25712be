"""The reference is complete and right: every key is described, every example is admitted, every template
runs."""

import copy
import inspect
import tomllib
from pathlib import Path

import jsonschema
import pytest
from support import A_BODY, TWO_STEPS, required

import ngvisco as nv
from ngvisco.case import reference, template, toml
from ngvisco.case.build import parse_case
from ngvisco.case.catalogue import WRAPPERS
from ngvisco.case.reference import meanings
from ngvisco.case.schema import CaseSections
from ngvisco.case.section import models_in, owner_of, quantity

ENTRIES = reference.entries()
COMPANIONS = {
    "theta": {"scheme": "theta"},
    "relaxation": {"scheme": "midpoint", "adaptive": {"dt_min": 0.001, "dt_max": 0.1}},
    **{key: {"equilibrium": "hydrostatic"} for key in ("datum", "datum_point", "datum_pressure")},
}
"""Keys of [time] and [initial] that require other keys, with these keys."""
NUMBERS = ("number", "array of numbers", "table of numbers")
BASE = A_BODY + TWO_STEPS
OF_BODY = {"kind": "ReferentialNeoHookean", "K_e": 10, "G_e": 5}


def test_every_number_has_a_unit_and_every_key_a_meaning():
    for entry in ENTRIES:
        assert entry.meaning and not entry.meaning.endswith("."), entry.name
        if entry.type.startswith(("number", *NUMBERS)):
            assert entry.unit, entry.name
        if entry.type.startswith(("text", "true")):
            assert not entry.unit, entry.name


def owners(model=CaseSections):
    """The classes and functions whose docstrings describe keys of sections."""
    found = {owner_of(model)} - {model}
    for field in model.model_fields.values():
        found = found.union(*map(owners, models_in(field.annotation)))
    return found


def test_every_description_belongs_to_a_parameter_that_exists():
    """A description of a parameter that no longer exists would never be shown."""
    for owner in owners():
        assert set(meanings(owner)) <= set(inspect.signature(owner).parameters), owner
    with pytest.raises(KeyError):
        quantity(CaseSections, "nonsense")


WITHIN = {
    "Damaged": {"material": {"kind": "ReferentialNeoHookean", "K_e": 10, "G_e": 5}},
    "Activated": {"rule": {"G_m": 1.0}},
    "Network": {"branches": {"one": {"material": {"kind": "ReferentialNeoHookean", "K_e": 10, "G_e": 5}}}},
    "Prony": {"material": {"kind": "ReferentialNeoHookean", "K_e": 10, "G_e": 5}},
    "WLF": {"rule": {"G_m": 1.0}},
    "Composite": {"rules": [{"G_m": 1.0}]},
    "ActivatedViscosity": {"viscosity": {"K_v": 1.0, "G_v": 1.0}},
}
"""Laws that contain laws, with the tables that they require."""


def placed(entry, kind):
    """A case with the example of the key, in a section of this kind that has all other keys that it
    requires."""
    data = tomllib.loads(BASE)
    if {"bodies", "contours"} & {*entry.path[:2]}:  # tables of bodies need bodies
        data["bodies"] = [{"name": "block", "material": OF_BODY, "density": 1.0}]
        del data["material"]
    path = [{"NAME": "left", "N": "0"}.get(part, part) for part in entry.path]
    section = entry.path[:-1]
    needed = required(section, kind)
    if kind is not None:
        needed["geometry" if section == ("domain",) else "kind"] = kind
    if kind == "Gas":
        needed["gruneisen"] = 0.4
    if kind in WRAPPERS and kind != "Network":
        needed["material"] = data["material"]
    needed |= WITHIN.get(kind, {})
    if entry.path[-1] == "parameters" and kind != "Python":  # the energy has to read its parameters
        needed["energy"] = f"G*({needed['energy']})"
    node = data
    for depth, part in enumerate(section):
        last = depth == len(section) - 1
        if part == "N":
            node = node[0]
        elif entry.path[depth + 1] == "N":
            node = node.setdefault(part, [{}])
        else:
            fresh = last and kind is not None
            node[{"NAME": "left"}.get(part, part)] = {} if fresh else node.get(part, {})
            node = node[{"NAME": "left"}.get(part, part)]
    if section[-1:] == ("heat",) and section[0] == "walls":  # a wall with heat needs a kind
        data["walls"]["left"] |= {"kind": "Slip"}
        needed = {"temperature": 300.0, "coefficient": 10.0}
    if section:
        node.update(needed)
    toml.override(data, tuple(path), entry.example)
    return data


CASES = [
    pytest.param(entry, kind, id=f"{entry.name}-{kind}" if kind else entry.name)
    for entry in ENTRIES
    if not entry.is_table
    for kind in (entry.kinds or (None,))
    if entry.path[-1] not in ("kind", "geometry")
    and (entry.name, kind) not in (("material.expansion", "Gas"), ("material.thermal.p_infinity", None))
]


@pytest.mark.parametrize(("entry", "kind"), CASES)
def test_every_example_is_admitted(entry, kind, schema):
    data = placed(entry, kind)
    if entry.name == "time.adaptive.dt_max":
        data["time"]["adaptive"]["dt_min"] = 0.001
    if entry.path[:-1] in (("time",), ("initial",)):
        data[entry.path[0]] |= COMPANIONS.get(entry.path[-1], {})
    if entry.name == "material.breaking":
        branches = {"slow": {"material": WITHIN["Prony"]["material"]}}
        data["material"]["material"] = {"kind": "Network", "branches": branches}
    if entry.path[:3] == ("rheology", "diffusion", "walls"):
        data["rheology"]["diffusion"] |= {"variable": "c", "mobility": 0.1}
        if entry.path[-1] != "flux":  # potential and coefficient go together
            data["rheology"]["diffusion"]["walls"]["left"] |= {"potential": 2.0, "coefficient": 10.0}
    if kind == "Prony":
        data["material"] |= {"C_1": {"C_2": 51.6}, "C_2": {"C_1": 17.4}}.get(entry.path[-1], {})
    loaded = CaseSections.model_validate(data)
    assert loaded.time.dt
    schema.validate(data)


@pytest.fixture(scope="module")
def schema():
    made = reference.json_schema()
    jsonschema.Draft202012Validator.check_schema(made)
    return jsonschema.Draft202012Validator(made)


def test_the_schema_admits_the_demos_and_refuses_misspelt_keys(schema):
    for path in template.demos().values():
        data = tomllib.loads(path.read_text())
        schema.validate(data)
        for section in ("material", "time", "domain"):
            wrong = copy.deepcopy(data)
            where = wrong["bodies"][0] if section == "material" and "bodies" in wrong else wrong
            where[section]["nonsense"] = 1
            assert not schema.is_valid(wrong), (path, section)
    text = Path(__file__).with_name("test_units.py").read_text()
    in_units = tomllib.loads(text.split('CASE = """\\\n')[1].split('"""')[0])
    schema.validate(in_units)
    in_units["time"]["dt"] = "ten"
    assert not schema.is_valid(in_units)
    described = reference.json_schema()["$defs"]["NeoHookean"]["properties"]["G_e"]
    assert "half the usual shear modulus, > 0 [Pa]" in described["description"]


@pytest.mark.parametrize("name", list(template.demos()))
def test_a_template_is_the_case_of_its_demo_with_comments(name):
    text = template.template(name)
    made, demo = parse_case(text, name, Path(".")), nv.load_case(template.demos()[name])
    assert made.resolved == demo.resolved
    assert "# s: Length of a step" in text and "ngvisco explain KEY" in text


def test_optional_lines_of_a_template_are_admitted():
    """Each optional line of a template, added to the case alone, gives a valid case (except COMPANIONS)."""
    lines = template.template("swirl").splitlines()
    start = lines.index("[material]")
    for number in range(start, len(lines)):
        before, line = lines[:number], lines[number]
        if not line.startswith("# ") or "=" not in line or "Of scheme" in line:
            continue
        table = next(text for text in reversed(before) if text.lstrip("# ").startswith("["))
        if table.startswith("#"):
            break  # whole tables from here on, since a case takes a table as a whole
        if line[2:].split(" = ")[0] in COMPANIONS:
            continue
        parse_case("\n".join([*before, line[2:], *lines[number + 1 :]]), "swirl", Path("."))


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("time.dt", ["unit     s", "dt = 0.02", "required"]),
        ("walls.top.velocity", ["m/s", "PrescribedTangential"]),
        ("loads.0.g", ["m/s^2", "of       Gravity"]),
        ("material", ["material.G_e [LinearElastic]"]),
        ("NeoHookean", ["neo-Hookean energy", "half the usual shear modulus"]),
        ("rheology.creep.G_m", ["G_m = 2 eta", "relaxation time of shear is G_m/(2 G)"]),
        ("K_E", ["the bulk modulus is K_e + epsilon (LogarithmicMooneyRivlin, LogarithmicNeoHookean)"]),
        ("gravity", ["Gravity: Gravity acceleration", 'kind = "Gravity"']),
        ("foundation", ["walls.NAME.stiffness [Open]"]),
        ("Bingham", ["Perzyna: Viscoplasticity with the yield condition"]),
        ("creep_rate", ["the field creep_rate is Pi, 3x3"]),
        ("hyperstress_2", ["|hess v|^{p-2}) d_j d_k v_i"]),
        ("initial.F", ["three rows of three numbers"]),
        ("bodies.1.material.material.K_e", ["material.K_e\n"]),
        ("material.branches.slow.creep.rules.0.G_m", ["rheology.creep.G_m\n"]),
    ],
)
def test_explain_says_what_a_key_is(path, words):
    text = reference.explain(path)
    assert all(word in text for word in words), text
    assert text.count("material.K_e\n") <= 2  # the key is listed once for each of its ranges


@pytest.mark.parametrize(
    "path", ["tim.dt", "", ".", "time.dt.x", "material.Ge", "loads.x.g", "\0", "a" * 5000]
)
def test_an_unknown_key_is_refused_with_the_nearest_key(path):
    with pytest.raises(nv.ParameterError, match="ngvisco list --keys"):
        reference.explain(path)


def test_the_page_of_keys_in_the_package_equals_the_generated_page():
    page = Path(reference.__file__).with_name("reference.md")
    assert page.read_text(encoding="utf-8") == reference.markdown(), "ngvisco list --markdown > " + str(page)
