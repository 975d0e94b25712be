"""Flow rules and viscosities in case files, by kind, of a material and of a body."""

import numpy as np
import pytest

import ngvisco as nv
from ngvisco.case import CaseError, load_case
from ngvisco.case.catalogue import ALL_VISCOSITIES
from ngvisco.case.catalogue import CREEPS as KINDS

ONE = """
domain = {{ geometry = "box", size = [1, 1], maxh = 1 }}
material = {{ kind = "LinearElastic", K_e = 10, G_e = 5 }}
rheology = {{ viscosity = {{ {viscosity} }}, creep = {{ {creep} }} }}
time = {{ dt = 0.1, until = 0.1 }}
"""

TWO = """
domain = {{ geometry = "box", size = [1, 1], maxh = 1 }}
time = {{ dt = 0.1, until = 0.1 }}
[[bodies]]
name = "slab"
material = {{ kind = "ReferentialNeoHookean", K_e = 10, G_e = 5 }}
viscosity = {{ {viscosity} }}
creep = {{ {creep} }}
density = 1
"""

CREEPS = {
    "Linear": ("G_m = 2", nv.Creep(G_m=2)),
    "Norton": ('A = "0.5 Hz/MPa^3", n = 3', nv.Norton(A=0.5e-18, n=3)),
    "Perzyna": (
        'sigma_Y = "3 kPa", G_m = 2, H = "1 kPa", Q = 2, b = 20',
        nv.Perzyna(sigma_Y=3000.0, G_m=2, H=1000.0, Q=2, b=20),
    ),
    "DruckerPrager": (
        "cohesion = 1, friction_angle = 30, G_m = 2",
        nv.DruckerPrager(cohesion=1, friction_angle=30, G_m=2),
    ),
    "Eyring": ("A = 0.5, sigma_0 = 2", nv.Eyring(A=0.5, sigma_0=2)),
    "Activated": (
        'E = "200 kJ/mol", theta_R = 1300, V = 1e-5, temperature = 1500, '
        'rule = { kind = "Norton", A = 0.5, n = 3 }',
        nv.Activated(rule=nv.Norton(A=0.5, n=3), E=2e5, theta_R=1300.0, V=1e-5, temperature=1500.0),
    ),
    "Giesekus": ("G_m = 2, alpha = 0.3", nv.Giesekus(G_m=2, alpha=0.3)),
    "PTT": ('G_m = 2, epsilon = 0.5, form = "exponential"', nv.PTT(G_m=2, epsilon=0.5, form="exponential")),
    "WLF": (
        "C_1 = 17.4, C_2 = 51.6, theta_R = 300, temperature = 320, rule = { G_m = 2 }",
        nv.WLF(rule=nv.Creep(G_m=2), C_1=17.4, C_2=51.6, theta_R=300.0, temperature=320.0),
    ),
    "Composite": (
        'rules = [{ G_m = "2 kPa s" }, { kind = "Activated", E = 1, theta_R = 2, temperature = 3, '
        'rule = { kind = "Eyring", A = 0.5, sigma_0 = 2 } }]',
        nv.Composite(
            rules=(
                nv.Creep(G_m=2000.0),
                nv.Activated(rule=nv.Eyring(A=0.5, sigma_0=2), E=1, theta_R=2, temperature=3),
            )
        ),
    ),
}

VISCOSITIES = {
    "StokesViscosity": ("K_v = 1, G_v = 2", nv.StokesViscosity(K_v=1, G_v=2)),
    "LinearViscosity": (
        'notation = "mandel", D = '
        "[[1,0,0,0,0,0],[0,1,0,0,0,0],[0,0,1,0,0,0],[0,0,0,1,0,0],[0,0,0,0,1,0],[0,0,0,0,0,1]]",
        nv.LinearViscosity(D=np.eye(6), notation="mandel"),
    ),
    "PowerLaw": (
        'K_v = 1, consistency = "3 kPa s^0.5", n = 0.5, floor = 0.01',
        nv.PowerLaw(K_v=1, consistency=3000.0, n=0.5, floor=0.01),
    ),
    "Carreau": ("K_v = 1, G_0 = 2, relaxation = 3, n = 0.4", nv.Carreau(K_v=1, G_0=2, relaxation=3, n=0.4)),
    "Cross": ("K_v = 1, G_0 = 2, relaxation = 3, m = 0.4", nv.Cross(K_v=1, G_0=2, relaxation=3, m=0.4)),
    "ActivatedViscosity": (
        "E = 1, theta_R = 2, temperature = 3, viscosity = { K_v = 1, G_v = 2 }",
        nv.ActivatedViscosity(viscosity=nv.StokesViscosity(K_v=1, G_v=2), E=1, theta_R=2, temperature=3),
    ),
}
STOKES = "K_v = 1, G_v = 1"


def case_of(text, creep, tmp_path, viscosity=STOKES):
    path = tmp_path / "case.toml"
    path.write_text(text.format(creep=creep, viscosity=viscosity))
    return load_case(path)


def test_every_kind_of_creep_and_viscosity_has_an_example_in_these_tests():
    assert set(CREEPS) == set(KINDS) and set(VISCOSITIES) == set(ALL_VISCOSITIES)


@pytest.mark.parametrize("kind", CREEPS)
def test_a_case_makes_the_flow_rule_that_its_keys_describe(kind, tmp_path):
    keys, expected = CREEPS[kind]
    of_conformation = expected.reads_conjugate
    text = ONE.replace("LinearElastic", "OldroydB") if of_conformation else ONE
    assert case_of(text, f'kind = "{kind}", {keys}', tmp_path).model(2).creep == expected
    if of_conformation:
        with pytest.raises(
            CaseError, match=r"creep.*no conformation tensor, since bodies have no such tensor"
        ):
            case_of(TWO, f'kind = "{kind}", {keys}', tmp_path).model(2)
        return
    (body,) = case_of(TWO, f'kind = "{kind}", {keys}', tmp_path).model(2).bodies
    assert body.creep == expected


@pytest.mark.parametrize("kind", VISCOSITIES)
def test_a_case_makes_the_viscosity_that_its_keys_describe(kind, tmp_path):
    keys, expected = VISCOSITIES[kind]
    keys = f'kind = "{kind}", {keys}'
    assert case_of(ONE, "G_m = 1", tmp_path, keys).model(2).viscosity == expected
    (body,) = case_of(TWO, "G_m = 1", tmp_path, keys).model(2).bodies
    assert body.viscosity == expected


def test_creep_without_a_kind_is_linear(tmp_path):
    assert case_of(ONE, 'G_m = "2 kPa s"', tmp_path).model(2).creep == nv.Creep(G_m=2000.0)


@pytest.mark.parametrize(
    ("creep", "message"),
    [
        ('kind = "Nortom", A = 1, n = 3', "rheology.creep.*Nortom.*Norton"),
        ('kind = "Norton", A = 1, n = 0.5', "rheology.creep.*n.*from 1 to 10"),
        ('kind = "Perzyna", sigma_Y = -1, G_m = 1', "rheology.creep.*sigma_Y"),
        ('kind = "Perzyna", sigma_Y = 1, G_m = 1, H = -1', "rheology.creep.*H"),
        ('kind = "Norton", G_m = 1, A = 1, n = 3', "rheology.creep.*G_m"),
        ('kind = "Composite", rules = [{ kind = "Norton", A = 1, n = 20 }]', "rheology.creep.rules.0.*n"),
        ('kind = "Activated", E = 1, theta_R = 2, rule = { G_m = -1 }', "rheology.creep.rule.*G_m"),
        ('kind = "Activated", E = 1, theta_R = -2, rule = { G_m = 1 }', "rheology.creep.*theta_R"),
    ],
)
def test_an_invalid_flow_rule_is_refused_under_its_key(creep, message, tmp_path):
    with pytest.raises(CaseError, match=f"(?s){message}"):
        case_of(ONE, creep, tmp_path)
