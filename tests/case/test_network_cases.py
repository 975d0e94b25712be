"""Networks and Prony series in case files: equal to scripts, resumed, from tables, and refused."""

import math

import numpy as np
import pytest
from ngsolve import x
from support import SWIRL

import ngvisco as nv
from ngvisco.case import CaseError, load_case, reference
from ngvisco.case import run as run_case
from ngvisco.geometries import box

NETWORK = """
domain = { geometry = "box", size = [1, 1], maxh = 0.5 }
initial = { velocity = ["sin(pi*x)*cos(pi*y)", "-cos(pi*x)*sin(pi*y)"] }
time = { dt = 0.05, until = 0.1 }
output = { passive = ["creep_strain"] }
[material]
kind = "Network"
[material.branches.spring]
material = { kind = "ReferentialNeoHookean", K_e = "20 Pa", G_e = 1 }
[material.branches.slow]
material = { kind = "ReferentialNeoHookean", K_e = 0, G_e = "2 + x" }
creep = { kind = "Perzyna", sigma_Y = 0.5, G_m = 0.5, H = 1 }
"""
PRONY = """
domain = { geometry = "box", size = [1, 1], maxh = 0.5 }
initial = { velocity = ["sin(pi*x)*cos(pi*y)", "-cos(pi*x)*sin(pi*y)"] }
time = { dt = 0.05, until = 0.1 }
[material]
kind = "Prony"
of = "G_0"
prony = [[0.3, 0.1], [0.2, "1000 ms"]]
material = { kind = "ReferentialNeoHookean", K_e = 20, G_e = 1 }
"""


def written(tmp_path, text, *changes):
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "case.toml").write_text(text)
    return tmp_path / "case.toml"


def by_script(material):
    initial = nv.Initial(velocity=SWIRL)
    return nv.Simulation(box((1, 1), maxh=0.5), nv.Model(material=material), dt=0.05, initial=initial)


@pytest.mark.long
@pytest.mark.ci
def test_a_network_of_a_case_equals_the_network_of_a_script_and_is_resumed_bit_for_bit(tmp_path):
    case = load_case(written(tmp_path, NETWORK))
    first = run_case(case, tmp_path / "half")
    slow = nv.ReferentialNeoHookean(K_e=0.0, G_e=2.0 + x)
    parts = {
        "spring": nv.Branch(material=nv.ReferentialNeoHookean(K_e=20.0, G_e=1.0)),
        "slow": nv.Branch(material=slow, creep=nv.Perzyna(sigma_Y=0.5, G_m=0.5, H=1.0)),
    }
    ledger = by_script(nv.Network(branches=parts)).run(0.1)
    for column in ("kinetic", "stored", "dissipation_creep_slow"):
        assert np.allclose(first.ledger.column(column), ledger.column(column), rtol=1e-9, atol=1e-12), column
    on = nv.case.resume(tmp_path / "half", until=0.2)
    whole = run_case(
        load_case(written(tmp_path, NETWORK, ("until = 0.1", "until = 0.2"))), tmp_path / "whole"
    )
    for column in whole.ledger.columns:
        assert np.array_equal(on.ledger.column(column), whole.ledger.column(column), equal_nan=True), column
    field = "creep_strain_slow"
    assert on.fields[field](on.mesh(0.3, 0.4)) == whole.fields[field](whole.mesh(0.3, 0.4))


def test_the_resolved_case_has_the_elastic_state_of_each_branch(tmp_path):
    for text, count in ((NETWORK, 2), (PRONY, 1)):
        resolved = load_case(written(tmp_path, text)).resolved
        assert resolved.count('elastic_state = "B"') == count and 'elastic_state = "F"' not in resolved
    still = [('creep = { kind = "Perzyna", sigma_Y = 0.5, G_m = 0.5, H = 1 }', "")]
    resolved = load_case(written(tmp_path, NETWORK, *still)).resolved
    assert resolved.count('elastic_state = "F"') == 2


@pytest.mark.parametrize("of", ["G_0", "G_inf"])
def test_prony_shares_refer_to_the_named_modulus(tmp_path, of):
    material = load_case(written(tmp_path, PRONY, ("G_0", of))).model(2).material
    parts = {name: branch.material.G_e for name, branch in material.parts.items()}
    assert parts == pytest.approx({"spring": 0.5 if of == "G_0" else 1.0, "mode_1": 0.3, "mode_2": 0.2})
    assert [branch.material.K_e for branch in material.parts.values()] == [20.0, 0.0, 0.0]
    # G_m/(2 G) is the relaxation time, with the usual shear modulus 2 G_e
    times = [b.creep.G_m / (4 * b.material.G_e) for b in material.parts.values() if b.creep is not None]
    assert times == pytest.approx([0.1, 1.0])


def test_prony_modes_may_be_read_from_a_table(tmp_path):
    (tmp_path / "rows.csv").write_text("# of a rubber\ng,tau\n0.3, 0.1\n0.2, 1\n")
    rows = 'prony = [[0.3, 0.1], [0.2, "1000 ms"]]'
    case = load_case(written(tmp_path, PRONY, (rows, 'prony = { file = "rows.csv" }')))
    assert case.model(2).material == load_case(written(tmp_path, PRONY)).model(2).material
    assert "[0.3, 0.1]" in case.resolved.replace("\n", "")
    (tmp_path / "rows.csv").write_text("0.3, 0.1\n0.2\n")
    with pytest.raises(CaseError, match=r"material\.prony.*2 numbers in line 2"):
        load_case(written(tmp_path, PRONY, (rows, 'prony = { file = "rows.csv" }')))
    (tmp_path / "rows.csv").write_text("0.3\n0.2\n")
    with pytest.raises(CaseError, match=r"material\.prony.*rows \[g, tau\]"):
        load_case(written(tmp_path, PRONY, (rows, 'prony = { file = "rows.csv" }')))
    with pytest.raises(CaseError, match=r"material\.prony.*can be read"):
        load_case(written(tmp_path, PRONY, (rows, 'prony = { file = "others.csv" }')))


WRONG = {
    "shares above one": (PRONY, ("[0.3, 0.1]", "[0.9, 0.1]"), r"material\.prony.*at most 1"),
    "a row of one": (PRONY, ("[0.3, 0.1]", "[0.9]"), r"material\.prony.*two numbers > 0"),
    "no modulus": (PRONY, ('of = "G_0"', 'of = "G"'), r"material\.of"),
    "of what has no part of shear": (
        PRONY,
        ('"ReferentialNeoHookean"', '"NeoHookean", epsilon = 1'),
        r"material\.material.*IsochoricNeoHookean, OldroydB",
    ),
    "half a shift": (PRONY, ('of = "G_0"', 'of = "G_0"\nC_1 = 17'), r"material\.C_1.*together"),
    "no branch": (NETWORK, ("H = 1", "HH = 1"), r"slow\.creep.*HH"),
    "a gradient": (NETWORK, ("H = 1", "nu = 1"), r"branches\.slow\.creep\.nu.*no gradient term"),
    "a modulus": (NETWORK, ('"2 + x"', "-1"), r"branches\.slow\.material\.G_e"),
    "no pressure": (NETWORK, ('"20 Pa"', "0"), r"material\.branches.*has to carry pressure"),
    "creep beside it": (
        NETWORK,
        ("output = ", "rheology = { creep = { G_m = 1 } }\noutput = "),
        r"creep.*whose branches have flow rules",
    ),
    "no shares of pressure": (
        PRONY,
        ("K_e = 20", "K_e = 0"),
        r"has to carry pressure",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_fault_of_a_network_is_reported_under_its_key(tmp_path, name):
    text, change, said = WRONG[name]
    with pytest.raises(CaseError, match=said):
        load_case(written(tmp_path, text, change)).model(2)


def test_keys_of_branches_are_explained():
    assert "material.branches.NAME.creep" in reference.explain("material.branches")
    assert "Elastic modulus of shear" in reference.explain("material.branches.slow.material.G_e")
    assert "relaxation time" in reference.explain("material.branches.slow.creep.G_m")
    assert "tau_i" in reference.explain("material.prony")


@pytest.mark.parametrize(
    ("material", "G"),
    [
        (nv.LinearElastic(K_e=10.0, G_e=5.0), 5.0),
        (nv.OldroydB(K_e=10.0, G_e=5.0), 10.0),
        (nv.ReferentialMooneyRivlin(K_e=10.0, G_e=3.0, G_mr=1.0), 8.0),
        (nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0), 10.0),
    ],
)
def test_a_prony_mode_relaxes_with_its_relaxation_time_at_small_strains(material, G):
    """Stresses 2 G e of small strains e, without a trace, relax by e' = -2 G e/G_m."""
    (branch,) = nv.prony_network(material, prony=[[1.0, 3.0]], of="G_0").parts.values()
    assert branch.creep.G_m / (2 * G) == pytest.approx(3.0, rel=1e-14)


def test_temperature_shifts_follow_their_formulas():
    chains = nv.OldroydB(K_e=10.0, G_e=5.0)
    shift = 10 ** (17.4 * 20 / (51.6 + 20))
    for options, factor in (
        ({"C_1": 17.4, "C_2": 51.6, "theta_R": 300.0, "temperature": 320.0}, shift),
        (
            {"E": 1e5, "theta_R": 300.0, "temperature": 320.0},
            math.exp(1e5 / 8.31446261815324 * (1 / 300 - 1 / 320)),
        ),
        ({"C_1": 17.4, "C_2": 51.6, "theta_R": 300.0, "temperature": 240.0}, 0.0),
    ):
        (branch,) = nv.prony_network(chains, prony=[[1.0, 2.0]], of="G_0", **options).parts.values()
        assert branch.creep.rule.law == "conformation"
        assert float(branch.creep.factor({})) == pytest.approx(factor, rel=1e-12, abs=1e-100)


def test_a_body_may_be_a_prony_series_from_a_file(tmp_path):
    (tmp_path / "rows.csv").write_text("0.3, 0.1\n0.2, 1\n")
    material = PRONY[PRONY.index("[material]") :].replace("[material]", "[bodies.material]")
    rows = 'prony = [[0.3, 0.1], [0.2, "1000 ms"]]'
    body = '[[bodies]]\nname = "all"\ndensity = 1\n' + material.replace(rows, 'prony = { file = "rows.csv" }')
    case = load_case(written(tmp_path, PRONY[: PRONY.index("[material]")] + body))
    flows = case.model(2).mechanisms
    assert [(each.body, each.branch, each.names) for each in flows] == [
        ("all", "mode_1", ("B_mode_1_all",)),
        ("all", "mode_2", ("B_mode_2_all",)),
    ]
