"""Flow rules in case files, by kind, of a material and of a body."""

from __future__ import annotations

import pytest

import ngvisco as nv
from ngvisco.case import CaseError, load_case
from ngvisco.case.catalogue import FLOW_RULES

ONE = """
domain = {{ geometry = "box", size = [1, 1], maxh = 1 }}
material = {{ kind = "LinearElastic", K_e = 10, G_e = 5 }}
rheology = {{ viscosity = {{ K_v = 1, G_v = 1 }}, creep = {{ {creep} }} }}
time = {{ dt = 0.1, until = 0.1 }}
"""

TWO = """
domain = {{ geometry = "box", size = [1, 1], maxh = 1 }}
time = {{ dt = 0.1, until = 0.1 }}
[[bodies]]
name = "slab"
material = {{ kind = "ReferentialNeoHookean", K_e = 10, G_e = 5 }}
viscosity = {{ K_v = 1, G_v = 1 }}
creep = {{ {creep} }}
density = 1
"""

CREEPS = {
    "Linear": ("G_m = 2", nv.Creep(G_m=2)),
    "Norton": ('A = "0.5 Hz/MPa^3", n = 3', nv.Norton(A=0.5e-18, n=3)),
    "Perzyna": ('sigma_Y = "3 kPa", G_m = 2', nv.Perzyna(sigma_Y=3000.0, G_m=2)),
    "DruckerPrager": (
        "cohesion = 1, friction_angle = 30, G_m = 2",
        nv.DruckerPrager(cohesion=1, friction_angle=30, G_m=2),
    ),
    "Eyring": ("A = 0.5, sigma_0 = 2", nv.Eyring(A=0.5, sigma_0=2)),
}


def case_of(text, creep, tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(text.format(creep=creep))
    return load_case(path)


def test_every_kind_is_tried():
    assert set(CREEPS) == set(FLOW_RULES)


@pytest.mark.parametrize("kind", CREEPS)
def test_a_case_names_a_flow_rule(kind, tmp_path):
    keys, expected = CREEPS[kind]
    assert case_of(ONE, f'kind = "{kind}", {keys}', tmp_path).model(2).creep == expected
    (body,) = case_of(TWO, f'kind = "{kind}", {keys}', tmp_path).model(2).bodies
    assert body.creep == expected


def test_creep_without_a_kind_is_linear(tmp_path):
    assert case_of(ONE, 'G_m = "2 kPa s"', tmp_path).model(2).creep == nv.Creep(G_m=2000.0)


@pytest.mark.parametrize(
    ("creep", "message"),
    [
        ('kind = "Nortom", A = 1, n = 3', "rheology.creep.*Nortom.*Norton"),
        ('kind = "Norton", A = 1, n = 0.5', "rheology.creep.*n.*from 1 to 10"),
        ('kind = "Perzyna", sigma_Y = -1, G_m = 1', "rheology.creep.*sigma_Y"),
        ('kind = "Norton", G_m = 1, A = 1, n = 3', "rheology.creep.*G_m"),
    ],
)
def test_what_makes_no_sense_is_refused_by_its_key(creep, message, tmp_path):
    with pytest.raises(CaseError, match=f"(?s){message}"):
        case_of(ONE, creep, tmp_path)
