"""Every key of the schema with wrong values: a case runs, or is refused under the key at fault.

The keys are read from the schema, so that the sweep includes a new key without a change of this file.
"""

import copy
import datetime
import re
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest
from support import required

from ngvisco.case import CaseError
from ngvisco.case.build import parse_case
from ngvisco.case.catalogue import GEOMETRIES, LOADS, MATERIALS, MECHANISMS, WALLS, WRAPPERS
from ngvisco.case.schema import CaseSections
from ngvisco.case.toml import write

WRONG = {
    "text": "many",
    "empty text": "",
    "long text": "x" * 3000,
    "true": True,
    "empty array": [],
    "array": [1.0, 2.0, 3.0, 4.0],
    "matrix": [[1.0, 2.0], [3.0, 4.0]],
    "ragged": [[1.0], [2.0, 3.0]],
    "array of texts": ["a", "b"],
    "table": {"a": 1},
    "date": datetime.date(2024, 1, 1),
    "fraction": 1.5,
    "minus one": -1,
    "minus": -0.5,
    "zero": 0,
    "nan": float("nan"),
    "inf": float("inf"),
    "minus inf": float("-inf"),
    "huge": 1e300,
    "tiny": 1e-300,
    "huge integer": 10**400,
    "with a unit": "5 kPa",
    "expression": "x - 0.5",
    "nowhere finite": "sqrt(x - 5)",
    "later infinite": "1/(0.05 - t)",
    "division by zero": "1/0",
    "unknown name": "q + 1",
    "code": "__import__('os')",
}

BASE = {
    "title": "a case",
    "domain": {"geometry": "box", "size": [1.0, 1.0], "maxh": 2.0},
    "material": {"kind": "BarotropicFluid", "B": 1.0, "gamma": 1.4},
    "time": {"dt": 0.02, "until": 0.1},
}
NEEDED = {
    "annulus": {"inner": 0.5, "outer": 1.0, "maxh": 1.0},
    "bar": {"length": 2.0, "thickness": 1.0, "maxh": 2.0},
    "block_with_hole": {"size": [1.0, 1.0], "radius": 0.25, "maxh": 1.0},
    "box": {"size": [1.0, 1.0], "maxh": 2.0},
    "channel": {"length": 2.0, "height": 1.0, "maxh": 1.0},
    "cylinder": {"radius": 1.0, "height": 1.0, "maxh": 2.0},
    "disc": {"radius": 1.0, "maxh": 1.0},
    "half_disc": {"radius": 1.0, "maxh": 1.0},
    "file": {"path": "missing.vol"},
    "sphere": {"radius": 1.0, "maxh": 2.0},
    "spherical_shell": {"inner": 0.5, "outer": 1.0, "maxh": 1.0},
    "structured_box": {"size": [1.0, 1.0], "cells": [1, 1]},
    "Damaged": {"G_c": 0.1, "length": 0.5, "material": {"kind": "LinearElastic", "K_e": 10.0, "G_e": 5.0}},
    "PerReferentialVolume": {"material": {"kind": "NeoHookean", "K_e": 10.0, "G_e": 5.0, "epsilon": 0.1}},
    "Network": {
        "branches": {"slow": {"material": {"kind": "ReferentialNeoHookean", "K_e": 10.0, "G_e": 5.0}}}
    },
    "Prony": {"material": {"kind": "ReferentialNeoHookean", "K_e": 10.0, "G_e": 5.0}},
    "Gas": {"c": 1.0, "theta_R": 300.0, "gruneisen": 0.4},
    "Yosida": {"eps": 1e-3, "material": {"kind": "LinearElastic", "K_e": 10.0, "G_e": 5.0}},
    "WithQuadratic": {"delta": 1e-3, "material": {"kind": "LinearElastic", "K_e": 10.0, "G_e": 5.0}},
    "heat": {"conductivity": 1.0},
    "CentralGravity": {"strength": 1.0, "centre": [-1.0, 0.5]},
    "Inflow": {"velocity": [0.0, -0.1], "density": 1.0},
    "Open": {"density": 1.0},
    "PrescribedTangential": {"velocity": [1.0, 0.0]},
}
"""Sizes and other values that are needed in addition to the reference's examples, or instead of them."""


def tables():
    """(path in the case, content) of every table that a case can have."""
    for name in GEOMETRIES:
        yield ("domain",), {"geometry": name, **NEEDED[name]}
    for kinds, path in (
        ({**MATERIALS, **WRAPPERS}, ("material",)),
        (LOADS, ("loads", 0)),
        (WALLS, ("walls", "top")),
    ):
        for name in (
            name for name in kinds if name != "Python"
        ):  # materials of a file are in case/test_python_materials.py
            section = tuple({"top": "NAME", 0: "N"}.get(part, part) for part in path)
            yield path, {"kind": name, **required(section, name), **NEEDED.get(name, {})}
    for name in MECHANISMS:
        yield ("rheology", name), required(("rheology", name)) | NEEDED.get(name, {})
    yield ("time",), BASE["time"]
    yield ("time", "adaptive"), {"dt_min": 1e-3, "dt_max": 0.1}
    for name in ("discretisation", "initial", "solver", "output"):
        yield (name,), {}
    yield ("output", "vtk"), {}
    yield ("output", "checkpoint"), {}
    yield ("output", "probes", 0), {"name": "a", "point": [0.5, 0.5]}
    yield ("output", "lines", 0), {"name": "b", "start": [0.0, 0.5], "end": [1.0, 0.5]}
    yield ("output", "forces"), {}
    yield ("output", "integrals", 0), {"name": "c", "of": "density"}
    yield ("units",), {}
    yield (), BASE


def with_table(path, table):
    """The base case with one table replaced."""
    data = copy.deepcopy(BASE)
    node = data
    for part, following in pairwise(path):
        node = node.setdefault(part, [{}] if following == 0 else {})
    if path:
        node[path[-1]] = copy.deepcopy(table)
    return data


@cache
def keys():
    """(table's path, table, key) of every key of the schema."""
    found = []
    for path, table in tables():
        data = with_table(path, table)
        node = CaseSections.model_validate(data)
        for part in path:
            node = node[part] if isinstance(node, (list, dict)) else getattr(node, part)
        found += [(path, table, key) for key in type(node).model_fields]
    return found


def placed(path, table, key, value):
    data = with_table(path, table)
    node = data
    for part in path:
        node = node[part]
    node[key] = value
    return data


@cache
def square():
    return parse_case(write(BASE), "case.toml", Path(".")).mesh()


def outcome(data, is_built, on_square):
    """None if the case is valid and, where it is built, can run; the error if it is refused."""
    try:
        case = parse_case(write(data), "case.toml", Path("."))
        if is_built:
            mesh = square() if on_square else case.mesh()
            if on_square:
                case.simulation(mesh)
    except CaseError as error:
        return error
    return None


def is_blamed(fault, where):
    """Whether a fault is located at the key, or names the key as one of two that contradict each other."""
    here = re.sub(r"\.\d+(?=\.|$)", "", fault.key) if where[-1] != 0 else fault.key
    path = [str(part) for part in where if not isinstance(part, int)]
    own = here.split(".")[: len(path)] == path
    return own or re.search(rf"\b{re.escape(path[-1])}\b", f"{fault.key} {fault.message}")


def name_of(path, table):
    parts = (".".join(map(str, path)), table.get("kind") or table.get("geometry"))
    return " ".join(filter(None, parts)) or "case"


def faults_of(path, table, key, what, is_made):
    """Faults that a case has with a wrong value, and does not have without the wrong value."""
    value = WRONG[what]
    error = outcome(placed(path, table, key, value), is_made, path[:1] != ("domain",))
    return error.faults if error else ()


def tried(turn, number, by_default):
    """Wrong values of a key, and whether a run is made of each; the default suite tries every sixth value,
    and CI the others.

    Numbers that the schema admits have equal effects except the extremes, one of which the default suite
    runs.
    """
    made = {what: what in ("huge", "tiny") or isinstance(WRONG[what], (str, list, dict)) for what in WRONG}
    other = ("tiny", "huge")[number % 2]
    first = {what: made[what] and what != other for what in list(WRONG)[turn % 6 :: 6]}
    return first if by_default else {what: made[what] for what in WRONG if first.get(what) is not made[what]}


def swept(name, by_default):
    count, wrong = 0, []
    for turn, (path, table, key) in enumerate(keys()):
        if name_of(path, table) != name:
            continue
        without = outcome(with_table(path, table), name == "domain file", False)
        known = {fault.message for fault in without.faults} if without else set()
        number = [k for p, t, k in keys() if (p, t) == (path, table)].index(key)
        for what, is_made in tried(turn, number, by_default).items():
            count += 1
            for fault in faults_of(path, table, key, what, is_made):
                if fault.message not in known and not is_blamed(fault, (*path, key)):
                    wrong.append(f"{key} = {what}: {fault}")
    assert count and not wrong, "\n".join(wrong)


NAMES = sorted({name_of(path, table) for path, table, _ in keys()})


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_value_is_refused_under_its_key_or_runs(name, monkeypatch, tmp_path):
    """Each key has every sixth value, and the next keys have other values; CI tries all values of each
    key."""
    monkeypatch.chdir(tmp_path)
    swept(name, by_default=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("name", NAMES)
def test_other_wrong_values_are_refused_and_extremes_of_numbers_may_run(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    swept(name, by_default=False)


def test_the_sweep_tries_every_key_of_the_schema():
    assert len(keys()) > 150 and len(keys()) * len(WRONG) > 4000
