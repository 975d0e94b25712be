"""Networks: branches in parallel, each with tensors, flow rule, hardening and power of its own."""

from itertools import product

import numpy as np
import pytest
from flow_rules import EXAMPLES as RULES
from flow_rules import OF_CONFORMATION
from ngsolve import CF, Integrate, x
from support import SWIRL, by_ci, swirling

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.physics.energy_checks import check_convexity
from ngvisco.physics.materials import Branch, Network
from ngvisco.physics.tensors import tr
from ngvisco.physics.variables import Jacobian, LeftCauchyGreen

SPRING = Branch(material=nv.ReferentialNeoHookean(K_e=20.0, G_e=1.0))
SCHEMES = ("backward-euler", "midpoint", "sdirk2")


def network(rule, branches=2):
    """A network of up to three branches: one with the rule, a spring, and an Oldroyd fluid."""
    others = {
        "spring": SPRING,
        "chains": Branch(material=nv.OldroydB(K_e=0.0, G_e=2.0), creep=nv.Creep(G_m=2.0, law="conformation")),
    }
    made = nv.ReferentialMooneyRivlin(K_e=20.0, G_e=1.5, G_mr=0.5)
    if rule in OF_CONFORMATION.values():
        made = nv.OldroydB(K_e=20.0, G_e=1.5)
    first = Branch(material=made, creep=rule)
    return Network(branches={"slow": first} | dict(list(others.items())[: branches - 1]))


def simulation(material, dim=2, **options):
    settings = {"initial": nv.Initial(density=1, velocity=(*SWIRL, CF(0))[:dim]), "dt": 0.05}
    mesh = box((1, 1), maxh=0.5) if dim == 2 else structured_box((1, 1, 1), (1, 1, 1))
    return swirling(mesh, material=material, **settings | options)


EVERY = RULES | OF_CONFORMATION
ALL = list(product([None, *EVERY], (1, 2, 3), ("coupled", "split"), (2, 3), SCHEMES))
BY_DEFAULT = {(*ALL[0][:1], 2, "split", 2, "midpoint")} | {
    (rule, 1 + i % 3, ("coupled", "split")[i // 2 % 2], 2 + (i == 4), SCHEMES[i % 3])
    for i, rule in enumerate(RULES)
}
DEAR = {case for case in BY_DEFAULT if case[0] in ("Bingham", "Drucker-Prager", "Perzyna, n = 2.5")}
BY_DEFAULT -= DEAR
OF_CI = DEAR | {
    (rule, 1 + (i + 1) % 3, ("split", "coupled")[i // 2 % 2], 2 + (i % 4 == 1), SCHEMES[(i + i // 3) % 3])
    for i, rule in enumerate(EVERY)
}
"""Cases of CI, one more for each rule. In 3D they use the split solver, since the coupled solver needs up to
ten seconds for three branches."""


def _marks(case):
    if case in BY_DEFAULT:
        return ()
    return (pytest.mark.long, pytest.mark.ci) if case in OF_CI else pytest.mark.long


@pytest.mark.filterwarnings("ignore::ngvisco.DefectWarning")
@pytest.mark.parametrize(
    ("rule", "branches", "solver", "dim", "scheme"), [pytest.param(*case, marks=_marks(case)) for case in ALL]
)
def test_ledger_closes_and_every_branch_dissipates(rule, branches, solver, dim, scheme, record_property):
    made = network(None if rule is None else EVERY[rule], branches)
    ledger = simulation(made, dim, solver=solver, scheme=scheme).run(0.1)
    record_property("closure", float(np.abs(ledger.column("closure_relative")).max()))
    for column in ledger.columns:
        if column.startswith(("dissipation_creep", "creep_power_min")):
            record_property(column, float(ledger.column(column)[1:].min()))
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    flowing = (["slow"] if rule else []) + (["chains"] if branches == 3 else [])
    columns = [name for name in ledger.columns if name.startswith("dissipation_creep")]
    assert columns == [f"dissipation_creep_{name}" for name in flowing]
    for column in columns:
        assert ledger.column(column)[1:].min() > 0
    if flowing:
        assert ledger.column("creep_power_min")[1:].min() >= -1e-12


@pytest.mark.parametrize(
    ("material", "creep"),
    [
        by_ci(nv.LinearElastic(K_e=10.0, G_e=5.0), nv.Creep(G_m=2.0)),
        by_ci(nv.ReferentialMooneyRivlin(K_e=10.0, G_e=3.0, G_mr=2.0), RULES["Voce"]),
        (nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"), nv.Norton(A=0.3, n=3)),
        (nv.FENEP(K_e=10.0, G_e=5.0, b=30.0), nv.Creep(G_m=2.0, law="conformation")),
        (nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1), None),
    ],
    ids=lambda value: type(value).__name__,
)
@pytest.mark.parametrize("solver", ["coupled", "split"])
@pytest.mark.filterwarnings("ignore::ngvisco.DefectWarning")
def test_a_network_of_one_branch_equals_its_material_bitwise(material, creep, solver):
    alone = simulation(material, creep=creep, solver=solver).run(0.1)
    of_one = simulation(Network(branches={"one": Branch(material=material, creep=creep)}), solver=solver)
    ledger = of_one.run(0.1)
    for column in alone.columns:
        of_branch = column == "dissipation_creep" or column.startswith("eigenvalue_min_")
        name = column + "_one" if of_branch else column
        assert np.array_equal(alone.column(column), ledger.column(name), equal_nan=True), column


def test_each_branch_has_the_stress_and_creep_rate_that_it_has_alone():
    """At the end of a run each branch has the Mandel stress of its own energy at its own tensors."""
    made = network(nv.Norton(A=0.3, n=3), 3)
    run = simulation(made, scheme="midpoint")
    run.run(0.2)
    mesh, places = run.mesh, [(0.2, 0.3), (0.7, 0.6), (0.4, 0.9)]

    def at(f):
        return np.array([f(mesh(*place)) for place in places])

    B = at(run.fields["B_slow"]).reshape(-1, 3, 3)
    N = at(run.fields["N_slow"]).reshape(-1, 3, 3)
    # these are the conjugates for the energy G_e tr B + G_mr tr N
    zeta_B, zeta_N = 1.5 * np.eye(3), 0.5 * np.eye(3)
    M = 2 * (zeta_B @ B) - 2 * (zeta_N @ N)
    M = M - np.trace(M, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
    found = at(run.fields["mandel_stress_slow"]).reshape(-1, 3, 3)
    assert np.abs(M).max() > 0.1 and np.allclose(found, M, rtol=1e-9, atol=1e-9)
    size = np.sqrt((M * M).sum(axis=(1, 2)))[:, None, None]
    rate = at(run.fields["creep_rate_slow"]).reshape(-1, 3, 3)
    assert np.allclose(rate, 0.3 * size**2 * M, rtol=1e-6, atol=1e-9)
    spring = at(run.fields["B_spring"]).reshape(-1, 3, 3)
    assert np.abs(spring - B).max() > 0.01  # one branch relaxes, the other does not
    chains = at(run.fields["B_chains"]).reshape(-1, 3, 3)
    shear = M + 2 * 1.0 * spring + 2 * 2.0 * chains  # the stress of all branches up to a pressure
    T = at(run.fields["cauchy_stress"]).reshape(-1, 3, 3)
    gap = np.abs((T - shear)[:, ~np.eye(3, dtype=bool)]).max()
    assert gap < 0.01 * np.abs(shear[:, 0, 1]).max()  # conjugates of the chains are projected


def test_every_branch_hardens_by_itself():
    hard = {
        name: Branch(
            material=nv.ReferentialNeoHookean(K_e=10.0, G_e=G_e),
            creep=nv.Perzyna(sigma_Y=0.3, G_m=0.5, H=H),
        )
        for name, G_e, H in (("soft", 1.0, 1.0), ("stiff", 3.0, 4.0))
    }
    run = simulation(Network(branches=hard), passive=["creep_strain"])
    ledger = run.run(0.2)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    made = {name: Integrate(run.fields[f"plastic_strain_{name}"], run.mesh) for name in hard}
    for name, total in made.items():  # the compared fields are in spaces of different orders
        passive = Integrate(run.fields[f"creep_strain_{name}"], run.mesh)
        assert total > 1e-2 and abs(passive / total - 1) < 0.05
    assert abs(made["soft"] / made["stiff"] - 1) > 0.1


HEATED = {
    "heat": lambda made: nv.Thermal(material=made, c=100.0, theta_R=300.0, expansion=1e-3),
    "damage": lambda made: nv.Damaged(material=made, G_c=0.05, length=0.3),
    "Yosida": lambda made: nv.Yosida(material=made, eps=1e-3),
    "a quadratic energy": lambda made: nv.WithQuadratic(material=made, delta=1e-4),
}


@pytest.mark.filterwarnings("ignore::ngvisco.DefectWarning", "ignore::ngvisco.InputWarning")
@pytest.mark.parametrize("around", HEATED)
def test_a_network_may_be_wrapped_like_any_material(around):
    made = HEATED[around](network(nv.Creep(G_m=2.0)))
    run = simulation(made, solver="split")
    ledger = run.run(0.1)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("dissipation_creep_slow")[-1] > 0
    if around == "heat":
        assert ledger.column("temperature_min")[-1] > 299


def stretched(material):
    """Von Mises' stress and the damage of a stretched strip, held until the damage is constant."""
    F = CF((1.2, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    run = nv.Simulation(
        box((1, 1), maxh=1.0), nv.Model(material=material), dt=0.5, initial=nv.Initial(F=F, density=1.0)
    )
    ledger = run.run(10.0)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    at = run.mesh(0.4, 0.4)
    damage = run.fields["damage"](at) if "damage" in run.fields else 0.0
    return run.fields["von_mises"](at), damage


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("small", [by_ci(False, id="by B"), pytest.param(True, id="small strain")])
def test_named_branches_break_and_the_others_keep_their_stress(small):
    def solid(G):
        if small:
            return nv.LinearElastic(K_e=20.0 * G, G_e=2 * G)
        return nv.ReferentialNeoHookean(K_e=20.0 * G, G_e=G)

    strong = {"spring": Branch(material=solid(1.0)), "brittle": Branch(material=solid(2.0))}
    broken = nv.Damaged(
        material=Network(branches=strong), G_c=0.02, length=0.5, viscosity=1e-3, breaking=["brittle"]
    )
    whole = nv.Damaged(material=Network(branches=strong), G_c=0.02, length=0.5, viscosity=1e-3)
    (spring, _), (both, _) = stretched(solid(1.0)), stretched(solid(3.0))
    (left, damage), (nothing, _) = stretched(broken), stretched(whole)
    share = (1 - damage) ** 2
    assert 0.8 < damage < 1 and both > 2.5 * spring
    assert left == pytest.approx(spring + share * (both - spring), rel=1e-3)
    assert abs(nothing) < 0.1 * spring


def test_damage_of_unknown_branches_is_refused():
    with pytest.raises(nv.UnknownNameError, match="unknown branch 'slaw'; did you mean 'slow'"):
        nv.Damaged(material=network(None), G_c=1.0, length=0.1, breaking=["slaw"])
    with pytest.raises(nv.ParameterError, match="the material has no branches"):
        nv.Damaged(material=NEO, G_c=1.0, length=0.1, breaking=["slow"])


def test_moduli_of_branches_may_be_functions_of_the_place():
    parts = {
        name: Branch(
            material=nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0 + a * x), creep=nv.Creep(G_m=1.0 + a * x)
        )
        for name, a in (("one", 1.0), ("two", 2.0))
    }
    run = simulation(Network(branches=parts))
    assert {v.name for v in run.model.material.variables} >= {"G_e", "G_e_2", "G_m", "G_m_2"}
    assert np.abs(run.run(0.1).column("closure_relative")).max() <= 1e-10


NEO = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0)
WRONG = {
    "no branches": ({}, "at least one branch"),
    "a name": ({"a b": SPRING}, "letters, digits"),
    "no branch": ({"a": NEO}, "a mapping of names to Branch objects"),
    "a gradient": (
        {"a": Branch(material=NEO, creep=nv.Creep(G_m=1.0, nu=1.0))},
        "creep of a branch has no gradient",
    ),
    "no conformation": ({"a": Branch(material=NEO, creep=nv.Creep(G_m=1.0, law="leonov"))}, "conformation"),
    "branches of branches": ({"a": Branch(material=Network(branches={"b": SPRING}))}, "without branches"),
    "heat within": ({"a": Branch(material=HEATED["heat"](NEO))}, "without heat and damage"),
    "no pressure": ({"a": Branch(material=nv.OldroydB(K_e=0.0, G_e=1.0))}, "has to carry pressure"),
    "small and large": ({"a": SPRING, "b": Branch(material=nv.LinearElastic(K_e=1, G_e=1))}, "small strain"),
}


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.filterwarnings("ignore::ngvisco.DefectWarning")
def test_a_network_keeps_its_variables_over_meshes_that_follow_a_field():
    """Every branch keeps its tensors and its hardening from one mesh to the next."""
    start = simulation(network(RULES["linear hardening"], 3), solver="split")
    followed = nv.Refinement(field="plastic_strain_slow", above=0.3, every=0.1)
    run = nv.run_refined(start, followed, 0.2)
    ledger = run.ledger
    assert run.mesh.ne > start.mesh.ne and ledger.column("transfer").any()
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("creep_power_min")[1:].min() >= -1e-12
    assert ledger.column("dissipation_creep_chains")[1:].min() > 0
    assert ledger.column("dissipation_creep_slow")[3] > 0  # the first step on the new mesh
    before, after = (Integrate(each.fields["plastic_strain_slow"], each.mesh) for each in (start, run))
    assert after > before > 0  # the strain grows, and a change of the mesh keeps it


@pytest.mark.parametrize("name", WRONG)
def test_an_invalid_network_is_refused(name):
    branches, said = WRONG[name]
    with pytest.raises(nv.ParameterError, match=said):
        Network(branches=branches)


def test_laws_that_a_network_does_not_support_are_refused():
    with pytest.raises(nv.ParameterError, match="whose branches have flow rules"):
        nv.Model(material=network(None), creep=nv.Creep(G_m=1.0))
    with pytest.raises(nv.ParameterError, match=r"LinearElastic\.K_e = 0\.0: expected a number > 0"):
        nv.Model(material=nv.LinearElastic(K_e=0.0, G_e=1.0))
    with pytest.raises(nv.ParameterError, match="> 0 if epsilon is not 0"):
        nv.ReferentialNeoHookean(K_e=0.0, G_e=1.0, epsilon=1.0)
    with pytest.raises(nv.ParameterError, match="wrap the material of each branch"):
        nv.PerReferentialVolume(material=network(None))
    fluid = {"chains": network(None, 3).parts["chains"], "spring": SPRING}
    with pytest.raises(nv.ParameterError, match="reads no conformation tensor"):
        nv.Model(material=nv.WithQuadratic(material=Network(branches=fluid), delta=1e-4))


def test_a_users_branch_that_is_not_convex_is_named():
    own = nv.CustomMaterial(
        transported=(LeftCauchyGreen(exponent=-2 / 3), Jacobian()),
        stored_energy=lambda B, J: 2 * tr(B) - 0.1 * tr(B) * tr(B) + J + 1 / J,
    )
    made = Network(branches={"spring": SPRING, "own": Branch(material=own)})
    assert not check_convexity(made, warn=False).passed
    assert check_convexity(network(None, 3), warn=False).passed
    with (
        pytest.warns(nv.ConvexityWarning, match="^Network: the stored energy is not convex"),
        pytest.warns(nv.ConvexityWarning, match=r"branches\['own'\].* alone is not convex"),
    ):
        simulation(made)


def of_bodies(material, solver="coupled"):
    """Bodies: a disc of the given material, in a body that creeps."""
    viscosity = nv.StokesViscosity(K_v=0.05, G_v=0.05)
    place = nv.Ball((0.5, 0.5), 0.3)
    disc = nv.Body(name="disc", where=place, material=material, viscosity=viscosity, density=1.0)
    creep = nv.Creep(G_m=0.5)
    rest = nv.Body(name="rest", material=SPRING.material, creep=creep, viscosity=viscosity, density=1.0)
    initial = nv.Initial(velocity=SWIRL)
    return nv.Simulation(
        box((1, 1), maxh=0.5), nv.Model(bodies=[disc, rest]), dt=0.05, initial=initial, solver=solver
    )


@pytest.mark.parametrize("solver", [by_ci("coupled"), "split"])
def test_a_body_may_be_a_network(solver):
    run = of_bodies(network(nv.Perzyna(sigma_Y=0.05, G_m=0.5, H=1.0)), solver)
    assert [each.names for each in run.model.mechanisms] == [
        ("B_slow_disc", "N_slow_disc"),
        ("B_rest",),
    ]
    ledger = run.run(0.1)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("dissipation_creep_slow")[-1] > 0 and ledger.column("dissipation_creep")[-1] > 0
    assert "plastic_strain_slow_disc" in run.fields
    with pytest.raises(nv.ParameterError, match="None with a Network"):
        nv.Model(bodies=[nv.Body(name="one", material=network(None), creep=nv.Creep(G_m=1.0), density=1.0)])


@pytest.mark.long
@pytest.mark.ci
def test_a_network_and_one_body_of_this_network_agree():
    made, viscosity = network(RULES["Norton, n = 3"]), nv.StokesViscosity(K_v=0.05, G_v=0.05)
    initial = nv.Initial(velocity=SWIRL)
    bodies = [nv.Body(name="all", material=made, viscosity=viscosity, density=1.0)]
    runs = (
        nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.01, initial=initial)
        for model in (nv.Model(material=made, viscosity=viscosity), nv.Model(bodies=bodies))
    )
    alone, of_body = (run.run(0.05) for run in runs)
    for column in ("kinetic", "dissipation_creep_slow"):  # J and n = 1/J agree to the scheme's order
        assert np.allclose(alone.column(column), of_body.column(column), rtol=1e-3), column


@pytest.mark.long
@pytest.mark.ci
def test_derivatives_by_parameters_of_branches_equal_differences():
    """Exact derivatives by a branch's moduli are those of central differences."""
    parts = {
        "spring": SPRING,
        "slow": Branch(material=nv.ReferentialNeoHookean(K_e=0.0, G_e=2.0), creep=nv.Creep(G_m=1.0)),
    }

    def run(G_e=2.0, G_m=1.0):
        slow = Branch(material=nv.ReferentialNeoHookean(K_e=0.0, G_e=G_e), creep=nv.Creep(G_m=G_m))
        return simulation(Network(branches=parts | {"slow": slow}), solver="coupled")

    names = ["material.branches.slow.material.G_e", "material.branches.slow.creep.G_m"]
    found = nv.gradient(run(), until=0.15, of=["stored at 0.15"], by=names)
    for name, key, value in zip(names, ("G_e", "G_m"), (2.0, 1.0), strict=True):
        ends = [run(**{key: value * (1 + s)}).run(0.15).column("stored")[-1] for s in (1e-4, -1e-4)]
        difference = (ends[0] - ends[1]) / (2e-4 * value)
        assert found["stored at 0.15", name] == pytest.approx(difference, rel=1e-5)
