"""Every rule with every elastic state, solver, dimension and scheme: the ledger closes, and M : Pi >= 0."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from flow_rules import EXAMPLES
from ngsolve import CF, x, y
from support import others_by_ci

import ngvisco as nv
from ngvisco.geometries import annulus, box
from ngvisco.physics.tensors import if_positive
from ngvisco.solver.split.solver import INNER, TOLERANCE

MATERIALS = {
    "E": nv.LinearElastic(K_e=50.0, G_e=5.0),
    "F": nv.ReferentialNeoHookean(K_e=50.0, G_e=5.0, elastic_state="F"),
    "B": nv.ReferentialNeoHookean(K_e=50.0, G_e=5.0, elastic_state="B"),
}
EULER, MIDPOINT = "backward-euler", "midpoint"
DEFAULT = {("Norton, n = 10", "E", "split", 2, EULER), ("Drucker-Prager", "E", "coupled", 2, EULER)}
CI = {
    ("Bingham", "B", "split", 2, EULER),
    ("Perzyna, n = 2.5", "F", "coupled", 2, MIDPOINT),
    ("Norton, n = 3", "B", "split", 3, EULER),
}
VISCOSITY = nv.StokesViscosity(K_v=0.1, G_v=0.1)


def sheared(rule, material, solver="split", dim=2, scheme=EULER, dt=0.02):
    """A box whose lid starts at full speed: stresses of the first step are many times those that the rule
    admits."""
    model = nv.Model(material=material, viscosity=VISCOSITY, creep=rule)
    lid = {"top": nv.PrescribedTangential(CF((16 * x**2 * (1 - x) ** 2, *(dim - 1) * [0])))}
    start = {"initial": nv.Initial(density=1.0), "walls": lid, "solver": solver, "scheme": scheme}
    return nv.Simulation(box((1,) * dim, maxh=0.5 if dim == 2 else 1.0), model, dt=dt, **start)


def cases():
    for case in product(EXAMPLES, MATERIALS, ("split", "coupled"), (2, 3), (EULER, MIDPOINT)):
        marks = () if case in DEFAULT else (pytest.mark.long, *([pytest.mark.ci] if case in CI else []))
        yield pytest.param(*case, marks=marks, id="-".join(map(str, case)))


@pytest.mark.parametrize(("name", "material", "solver", "dim", "scheme"), list(cases()))
def test_the_ledger_closes_and_creep_takes_energy_at_every_point(name, material, solver, dim, scheme):
    run = sheared(EXAMPLES[name], MATERIALS[material], solver, dim, scheme)
    ledger = run.run(0.06)
    assert abs(ledger.column("closure_relative")).max() <= 1e-10
    assert not ledger.column("rejections").any()
    mean = ledger.column("dissipation_creep")
    assert ledger.column("creep_power_min").min() >= -1e-14 * mean.max()
    assert mean[-1] > 1e-6


GRADIENTS = {"Norton, n = 3": 1e-9, "Eyring": 1e-9, "Bingham": 1e-3, "Voce": 1e-3}


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("name", GRADIENTS)
def test_rules_with_a_gradient_close_the_ledger_in_both_solvers_alike(name):
    """Rules with a yield stress yield in a part of the box only. The rest creeps more slowly than
    ``rate_floor``."""
    powers = []
    for solver in ("split", "coupled"):
        run = sheared(replace(EXAMPLES[name], nu=1e-4, rate_floor=GRADIENTS[name]), MATERIALS["B"], solver)
        ledger = run.run(0.06)
        assert abs(ledger.column("closure_relative")).max() <= 1e-10
        assert not ledger.column("rejections").any()
        powers.append(ledger.column("dissipation_creep")[-1])
    assert np.isclose(*powers, rtol=1e-7) and powers[0] > 1e-6


@pytest.mark.long
@pytest.mark.parametrize("name", EXAMPLES)
def test_both_solvers_agree_for_every_flow_rule(name):
    runs = (sheared(EXAMPLES[name], MATERIALS["B"], solver) for solver in ("split", "coupled"))
    assert np.allclose(*(run.run(0.06).column("dissipation_creep") for run in runs), rtol=1e-7)


STIFF = {
    "Norton, n = 10": nv.Norton(A=1e3, n=10),
    "linear": nv.Creep(G_m=2e-6),
    "yield": nv.Perzyna(sigma_Y=0.5, G_m=1e-7),
    "yield that hardens": nv.Perzyna(sigma_Y=0.5, G_m=1e-7, H=2.0),
    "friction": nv.DruckerPrager(cohesion=0.3, friction_angle=30.0, G_m=1e-7),
}
"""Rules with Maxwell times of 1e-5 steps; yield with G_m = 1e-6 of 0.1 Pa s, the shear modulus times a
step."""
QUICK = {("yield", "B", "split", 2), ("yield", "F", "coupled", 2), ("linear", "F", "split", 2)}


@pytest.mark.parametrize(
    ("name", "material", "solver", "dim"),
    [
        pytest.param(*case, marks=() if case in QUICK else (pytest.mark.long, pytest.mark.ci))
        for case in product(STIFF, MATERIALS, ("split", "coupled"), (2, 3))
    ],
)
def test_stiff_creep_is_solved_in_few_iterations(name, material, solver, dim):
    """No step is divided, although the whole stress by the lid has to relax in the first step."""
    ledger = sheared(STIFF[name], MATERIALS[material], solver, dim).run(0.06)
    assert len(ledger.column("time")) == 4 and not ledger.column("rejections").any()
    assert abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("creep_power_min").min() >= -1e-14 * ledger.column("dissipation_creep").max()
    assert ledger.column("newton_iterations").sum() <= 60


@pytest.mark.parametrize(
    ("material", "solver"),
    others_by_ci(product(MATERIALS, ("split", "coupled")), ("E", "split"), ("B", "coupled")),
)
def test_yield_has_a_rate_independent_limit(material, solver):
    powers = []
    for G_m in (1e-2, 1e-3, 1e-7):
        ledger = sheared(nv.Perzyna(sigma_Y=0.5, G_m=G_m), MATERIALS[material], solver).run(0.06)
        powers.append(ledger.column("dissipation_creep")[-1])
    first, second = (power - powers[-1] for power in powers[:-1])
    assert 5 <= first / second <= 20  # the differences are proportional to G_m


def test_the_preconditioner_of_newton_krylov_is_linear():
    """GMRES in Newton-Krylov needs a preconditioner that is linear to more digits than a single increment
    needs."""
    run = sheared(nv.Perzyna(sigma_Y=0.5, G_m=1e-6), MATERIALS["E"])
    run.advance()
    split = run.solver.newton
    at = split.residual(split.unknowns.pack())
    split.preconditioner.update(at)
    derivative, noise = split.residual.derivative(at), np.random.default_rng(0)
    scale = split.unknowns.scales(at.x, split.residual.exchange)
    first, second = (scale * noise.standard_normal(len(at.x)) for _ in range(2))

    def defect(*tolerance):
        def solved(d):
            return split.preconditioner(replace(at, residual=derivative(d)), INNER[1], *tolerance) / scale

        total = solved(first + second)
        return np.linalg.norm(total - solved(first) - solved(second)) / np.linalg.norm(total)

    assert defect(INNER[1]) <= 0.01 * TOLERANCE < defect()


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("material", ["E", "B"])
def test_yield_with_little_inertia_is_solved(material):
    """A stiff, light body surrounds a cylinder that turns: undamped increments alternate."""
    walls = {"inner": nv.PrescribedTangential((-y, x)), "outer": nv.NoSlip()}
    linear = (4 / (x * x + y * y) - 1) / 3
    initial = nv.Initial(density=0.01, velocity=(-linear * y, linear * x))
    stiff = replace(MATERIALS[material], K_e=200.0, G_e=100.0 if material == "E" else 50.0)
    model = nv.Model(material=stiff, creep=nv.Perzyna(sigma_Y=0.35, G_m=0.2))
    run = nv.Simulation(annulus(1.0, 2.0, 0.25), model, dt=0.1, walls=walls, initial=initial, solver="split")
    ledger = run.run(0.2)
    assert not ledger.column("rejections").any()
    assert abs(ledger.column("closure_relative")).max() <= 1e-10


@dataclass(frozen=True, kw_only=True)
class Wrong(nv.FlowRule):
    """A rule that gives energy only where the body is stretched, so that no sample at rest shows it."""

    def rate(self, M, zeta, z):
        return if_positive(z["J"] - 1.0001, -0.1, 0.1) * M


def test_a_rate_of_the_wrong_sign_in_a_flow_is_warned_of():
    run = sheared(Wrong(), nv.ReferentialNeoHookean(K_e=5.0, G_e=5.0), dt=0.05, solver="coupled")
    with pytest.warns(nv.CreepPowerWarning, match="creep produces energy"):
        ledger = run.run(0.1)
    assert ledger.column("creep_power_min").min() < 0
