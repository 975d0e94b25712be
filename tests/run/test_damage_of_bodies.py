"""Bodies that break: signs and closure of both halves of a step, other bodies, restart, refusals."""

import numpy as np
import pytest
from ngsolve import CF, cos, exp, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.physics.variables import Jacobian
from tests.run.test_damage import damaged
from tests.support import assert_same

SEED = 0.3 * exp(-20 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))
STOKES = nv.StokesViscosity(K_v=0.1, G_v=0.1)
LAW = damaged(floor=1e-3)


def fluid(K=20.0):
    return nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: K / 2 * (J - 1) * (J - 1) / J)


def bodies(law=LAW, dim=2, beside=None, **options):
    disc = nv.Body(
        name="disc", where=nv.Ball((0.5,) * dim, 0.35), material=law, density=1.0, viscosity=STOKES, **options
    )
    return disc, nv.Body(name="rest", material=beside or fluid(), density=1.0, viscosity=STOKES)


def turned(law=LAW, dim=2, beside=None, names=("disc",), of_body=None, **options):
    """A disc that breaks in a fluid, or beside a solid, in an eddy."""
    swirl = CF((sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y), 0)[:dim])
    seeds = {f"damage_{name}": SEED for name in names}
    model = nv.Model(bodies=bodies(law, dim, beside, **(of_body or {})))
    initial = nv.Initial(velocity=swirl, values=seeds)
    return nv.Simulation(box((1,) * dim, maxh=0.5), model, dt=0.02, initial=initial, **options)


def assert_damage(run, until=0.04, is_euler=True):
    ledger = run.run(until)
    assert abs(ledger.column("closure_relative")).max() < 1e-11
    for name in ("dissipation_damage", "bregman_damage", *(["bregman"] if is_euler else [])):
        assert ledger.column(name)[1:].min() > 0, name
    for name in run.model.material.damages:
        values = run.sampler.values(run.fields[f"damage_{name}"])
        assert values.min() > -1e-9 and values.max() < 1 + 1e-9
    return ledger


def test_both_halves_of_a_step_dissipate_and_both_solvers_agree():
    runs = [turned(solver=solver) for solver in ("coupled", "split")]
    for run in runs:
        assert_damage(run)
    assert_same(*runs)


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "dim", "scheme", "of_body"),
    [
        (damaged(floor=1e-3, law="AT1", G_c=0.001), 2, "backward-euler", None),
        (damaged(floor=1e-3, part="all"), 2, "backward-euler", None),
        (damaged(floor=1e-3, healing_viscosity=0.1), 2, "midpoint", None),
        (LAW, 2, "backward-euler", {"creep": nv.Creep(G_m=5.0)}),
        (LAW, 2, "backward-euler", {"creep": nv.Perzyna(G_m=2.0, sigma_Y=0.1, H=1.0)}),
        pytest.param(LAW, 3, "backward-euler", None, marks=pytest.mark.ci),
    ],
)
def test_ledger_closes_for_laws_flow_rules_and_dimensions(law, dim, scheme, of_body):
    runs = [
        turned(law, dim, scheme=scheme, of_body=of_body, solver=s) for s in ("split", "coupled")[: 4 - dim]
    ]
    for run in runs:
        assert_damage(run, is_euler=scheme == "backward-euler")
    if dim == 2:
        assert_same(*runs)


def test_each_of_two_bodies_breaks_by_its_own_damage():
    """Each body has its own names, fields and dissipation, and the ledger has the sums."""
    weak = damaged(floor=1e-3, G_c=0.02, material=nv.ReferentialNeoHookean(K_e=10.0, G_e=2.0))
    run = turned(beside=weak, names=("rest",))
    assert_damage(run)
    whole, broken = (run.sampler.values(run.fields[f"damage_{name}"]) for name in ("disc", "rest"))
    assert broken.max() > 0.2 and abs(whole - broken).max() > 0.1


def states(material, count=40, seed=1):
    """Random states of positive amounts and strains, and random values of the damage."""
    rng, space = np.random.default_rng(seed), material.states(2)
    F = np.eye(3) + np.pad(0.2 * rng.uniform(-1, 1, (count, 2, 2)), ((0, 0), (0, 1), (0, 1)))
    share, result = rng.uniform(0.2, 0.8, count), np.zeros((count, space.size))
    B = np.linalg.det(F)[:, None, None] ** (-2 / 3) * (F @ F.swapaxes(1, 2))
    components = B.reshape(count, 9) @ space.spaces["B_disc"].columns
    n = share[:, None] * rng.uniform(0.8, 1.2, (count, 1))
    result[:, space.slices["B_disc"]], result[:, space.slices["n_disc"]] = n * components, n
    result[:, space.slices["n_rest"]] = (1 - share)[:, None] * rng.uniform(0.8, 1.2, (count, 1))
    result[:, space.slices["damage_disc"]] = rng.uniform(0, 1, (count, 1))
    result[:, space.slices["grad_damage_disc"]] = rng.uniform(-1, 1, (count, 2))
    return result


@pytest.fixture(scope="module")
def mixture():
    """A mixture with a much softer fluid. Bodies of one volume ratio would not be in equilibrium."""
    return nv.Model(bodies=bodies(beside=fluid(2.0))).material


def test_a_step_between_any_two_states_dissipates_at_every_point(mixture):
    """phi(old; d_old) - phi(now; d) - slope : (old - now) >= 0, with the slope at the old damage."""
    respond, lagged = mixture.response(2), np.zeros(mixture.states(2).size, dtype=bool)
    for name in mixture.lagged:
        lagged[mixture.states(2).slices[name]] = True
    old, now = states(mixture, seed=1), states(mixture, seed=2)
    before, after = respond(old), respond(now, np.where(lagged, old, now))
    distance = before.energy - after.energy - (after.slope * (old - now)).sum(axis=1)
    assert distance.min() > 0
    # a control: with the slope at the present volumes and damage, some distances are negative
    present = respond(now)
    of_present = before.energy - present.energy - (present.slope * (old - now)).sum(axis=1)
    assert of_present.min() < 0


def test_slopes_of_damaged_bodies_equal_differences_of_the_energy(mixture):
    """The slopes at one state, and the Hessian with lagged damages, are those of central differences."""
    respond, h = mixture.response(2), 1e-5
    now, old = states(mixture, 20, 3), states(mixture, 20, 4)
    space = mixture.states(2)
    lagged = np.concatenate([np.arange(space.size)[space.slices[name]] for name in mixture.lagged])
    seen = now.copy()
    seen[:, lagged] = old[:, lagged]
    found, of_seen = respond(now), respond(now, seen)
    for i in range(now.shape[1]):
        ends = []
        for sign in (1, -1):
            moved, moved_seen = now.copy(), seen.copy()
            moved[:, i] += sign * h
            if i not in lagged:
                moved_seen[:, i] += sign * h
            ends.append((respond(moved).energy, respond(moved, moved_seen).slope))
        slope, hessian = ((a - b) / (2 * h) for a, b in zip(*ends, strict=True))
        assert slope == pytest.approx(found.slope[:, i], rel=1e-6, abs=1e-6)
        assert np.allclose(hessian, of_seen.hessian[:, :, i], rtol=1e-5, atol=1e-4)


def test_damage_of_one_body_changes_nothing_where_it_is_absent(mixture):
    """An absent body is represented by a trace of matter. Its damage changes only the energy of cracks in
    this trace."""
    space, respond = mixture.states(2), mixture.response(2)
    alone = np.zeros((2, space.size))
    alone[:, space.slices["n_rest"]] = 1.1
    alone[1, space.slices["damage_disc"]] = 0.9
    found = respond(alone)
    rest = space.slices["n_rest"].start
    law = LAW.G_c / 2 / LAW.length * 0.9**2
    backing = 0.1 / 1.1
    assert found.energy[1] - found.energy[0] == pytest.approx(1.1 * backing * law, rel=1e-12)
    assert found.slope[1, rest] - found.slope[0, rest] == pytest.approx(backing * law, rel=1e-12)


def test_energy_that_bodies_release_by_changing_volumes_as_damage_grows_is_counted():
    """A stretched block shares cells with a soft fluid: when its damage grows, the volumes change."""
    run = turned(beside=fluid(2.0), of_body={})
    run.advance()
    step, grow, ledger = run.rothe_step, run.rothe_step.damage, run.ledger
    before = step.quadrature.integrate_cells(step.energy.density(step.now))
    rates, numerical = grow(0.05)
    step.energy.require()
    fallen = before - step.quadrature.integrate_cells(step.energy.density(step.now))
    assert fallen == pytest.approx(0.05 * rates["dissipation_damage"] + numerical["bregman_damage"], rel=1e-9)
    assert grow._held.released() >= 0 and ledger.column("bregman_damage")[-1] > 0


@pytest.mark.long
@pytest.mark.ci
def test_a_run_of_breaking_bodies_is_resumed_from_its_checkpoint(tmp_path):
    whole, first = turned(), turned(observers=[nv.Checkpoints(tmp_path / "run.h5")])
    whole.run(0.06)
    first.run(0.04)
    again = turned()
    again.restore(tmp_path / "run.h5")
    again.run(0.06)
    assert np.array_equal(whole.rothe_step.state.vec.FV().NumPy(), again.rothe_step.state.vec.FV().NumPy())


@pytest.mark.parametrize(
    ("law", "match"),
    [
        (damaged(area="reference"), r"bodies\['disc'\].material.area.*does not carry the distortion"),
        (
            nv.Thermal(material=damaged(part="all"), c=1.0, theta_R=300.0),
            r"bodies\['disc'\].material.*Damaged",
        ),
        (
            damaged(material=nv.Network(branches={"a": nv.Branch(material=LAW.material)}), breaking=("a",)),
            r"material.breaking.*all branches of a body break together",
        ),
    ],
)
def test_laws_that_damage_of_a_body_does_not_support_are_refused_by_name(law, match):
    with pytest.raises(nv.ParameterError, match=match):
        nv.Model(bodies=bodies(law))


def test_damage_of_bodies_with_heat_or_with_constants_in_cells_is_refused():
    warm = nv.Thermal(material=fluid(), c=1.0, theta_R=300.0)
    with pytest.raises(nv.ParameterError, match=r"bodies\['disc'\].material.*no damage beside heat"):
        nv.Model(bodies=bodies(beside=warm))
    with pytest.raises(nv.ParameterError, match=r"Discretisation.m = 0: expected 1 with damage"):
        nv.Simulation(
            structured_box((1.0, 1.0), (2, 2)),
            nv.Model(bodies=bodies()),
            dt=0.1,
            discretisation=nv.Discretisation(k=1, m=0),
        )
