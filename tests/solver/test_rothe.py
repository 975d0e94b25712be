"""A Rothe step: a rough start, the state after a failure, and the end of an iteration."""

from types import SimpleNamespace

import numpy as np
import pytest
from ngsolve import CF, Id, IfPos, OuterProduct, cos, pi, sin, x, y
from support import MATERIALS, SWIRL, small_run, state

import ngvisco as nv
from ngvisco import HyperViscosity, NewtonOptions, StepError, StokesViscosity, time
from ngvisco.geometries import box
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Concentration, Distortion, Jacobian, ReciprocalJacobian
from ngvisco.solver.options import SplitOptions
from ngvisco.solver.problem import Problem, Status, iterations
from ngvisco.solver.split.solver import Split, iterate

JUMP = Id(3) + IfPos(x - 0.4, 0.4, -0.2) * OuterProduct(CF((1, 0, 0)), CF((0.3, 1, 0)))


def simulation(material: str = "neo_hookean", speed: float = 1.0, F=None, dt: float = 0.05, **options):
    velocity = tuple(speed * component for component in SWIRL)
    return small_run(
        dt=dt,
        material=MATERIALS[material],
        viscosity=StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=HyperViscosity(mu=1e-3, p=4),
        velocity=velocity,
        F=F,
        **options,
    )


@pytest.mark.parametrize("material", ["linear", "neo_hookean"])
def test_first_step_from_a_rough_start_converges(material: str) -> None:
    """The distortion jumps inside cells, and the velocity crosses more than a cell in the step."""
    run = simulation(material, speed=10.0, F=JUMP)
    assert run.ledger.start(0.0)["v_max"] * run.dt > min(run.rothe_step.context.h.vec)
    row = run.advance()
    assert abs(row["closure_relative"]) < 1e-10
    assert row["rho_min"] > 0


def test_failed_step_restores_the_state_bitwise() -> None:
    run = simulation(newton=NewtonOptions(max_iterations=2), halvings=0)
    run.ledger.start(0.0)
    before = state(run)
    with pytest.raises(StepError, match=r"step of length 0\.05 s from t = 0 s.*too many iterations") as error:
        run.advance()
    assert np.array_equal(state(run), before)
    assert np.array_equal(run.rothe_step.state_old.vec.FV().NumPy(), before)
    assert (run.t, run.number, time.Get()) == (0.0, 0, 0.0)
    assert len(run.ledger.rows) == 1
    lines = iterations(error.value.history)
    assert len(lines) >= 2
    assert all(line.increment > 0 for line in lines)


def test_a_change_of_the_step_length_assembles_the_matrix_again() -> None:
    run = simulation()
    run.advance()
    assert run.solver.newton.is_factorised
    history = run.integrator.advance(run.t, 0.02).history
    assert history[0].solution.history[0].fresh_jacobian


class Posed(Problem):
    """Equations without parameters."""

    def pose(self):
        pass


class Increments:
    """Stand-in of a split solver for ``iterate``: increments of given sizes, by their number."""

    has_converged, reset_if_worn = Split.has_converged, lambda self, f, size: None
    is_steep, follow, is_rounding = False, lambda self, f: None, lambda self, f, size: False
    _left = 0.0  # linear systems are solved exactly

    def __init__(self, sizes):
        self.sizes, self.is_factorised, self.is_fresh = sizes, True, False
        self.options = NewtonOptions(split=SplitOptions(slow=60))  # Newton-Krylov does not take over
        self.at, self.starts, self.resets, self.solution = [], 0, 0, None
        self.unknowns = SimpleNamespace(pack=lambda: np.zeros(1), unpack=lambda x: None)
        self.residual = SimpleNamespace(put=self._put, start=self._start)

    def _put(self, x):
        self.solution = x

    def _start(self):
        self.starts += 1

    def evaluated(self, x, last):
        return None

    def increment(self, problem, x, at, last, expected):
        self.at.append(float(x[0]))
        size = self.sizes(len(self.at) - 1)
        return np.array([float(len(self.at))]), size

    def size(self, f, coarse=False):
        return self.sizes(len(self.at) - 1)

    def give_up(self):
        self.resets += 1


def test_increments_that_stall_below_the_tolerance_count_as_converged():
    tolerance = NewtonOptions().tolerance
    found = Increments(lambda n: max(10.0 ** (-3 * n - 1), 0.5 * tolerance))
    assert iterate(found, Posed(), []) is Status.CONVERGED


def test_slow_convergence_is_not_taken_for_rounding():
    """If each increment is 7 % smaller than the one before, the sum of the remaining increments is fourteen
    increments."""
    tolerance = NewtonOptions().tolerance
    found = Increments(lambda n: 10.0 ** (-3 * n - 1) if n < 3 else 2 * tolerance * 0.93**n)
    iterate(found, Posed(), [])
    assert found.solution is None or found.sizes(len(found.at)) * 14 <= tolerance


@pytest.mark.parametrize("contraction", [0.1, 0.3, 0.45])
def test_an_iteration_ends_if_the_expected_increments_are_within_the_margin(contraction):
    split, history = Increments(lambda number: 1e-9 * contraction**number), []
    assert iterate(split, Posed(), history) is Status.CONVERGED
    tolerance, margin = split.options.tolerance, split.options.split.margin
    share = contraction / (1 - contraction)  # the sum of all later increments over the last increment
    left = history[-1].increment * share
    assert left <= margin * tolerance * (1 + 1e-9) and history[-1].increment <= tolerance
    before = history[-2].increment
    assert before > tolerance or before * share > margin * tolerance


def test_a_single_increment_gives_no_estimate_of_contraction():
    split, history = Increments(lambda number: 0.5e-10 if number == 0 else 1e-12), []
    assert iterate(split, Posed(), history) is Status.CONVERGED
    assert len(history) == 2


@pytest.mark.parametrize("lost", [np.inf, np.nan, 50.0])
def test_a_diverging_increment_is_halved_from_the_best_iterate(lost):
    """The second increment leads away: half of it is taken, and has its own tangent."""
    sizes = (0.6, 0.3, lost, 0.1, 1e-3, 1e-6, 1e-12, 1e-14)
    split = Increments(lambda n: sizes[n])
    assert iterate(split, Posed(), []) is Status.CONVERGED
    assert split.at[:4] == [0.0, -1.0, -3.0, -2.0] and split.resets == 1


def test_a_step_fails_if_no_part_of_an_increment_converges():
    split, history = Increments(lambda n: 0.5 if n == 0 else np.inf), []
    assert iterate(split, Posed(), history) is Status.STALLED
    assert len(history) == 2 + split.options.split.halvings
    assert iterate(Increments(lambda n: np.nan), Posed(), []) is Status.NOT_FINITE


@pytest.mark.parametrize(("smallest", "gives_up"), [(0.02, False), (1e-5, True)])
def test_large_increments_may_grow_for_a_while(smallest, gives_up):
    """Far from the solution increments may grow threefold, and near it by a hundredth at most."""
    grown = 3 * smallest if not gives_up else 0.05
    sizes = (0.3, smallest, grown, 1e-3, 1e-6, 1e-12, 1e-14, 1e-15)
    split = Increments(lambda n: sizes[n])
    assert iterate(split, Posed(), []) is Status.CONVERGED
    assert split.resets == gives_up


def test_a_nearly_incompressible_body_takes_a_step_in_which_waves_pass_many_times():
    """In an earlier version, rounding of the energy on sides of cells was a force without resistance, so that
    the step was divided."""
    eddy = (1 + 0.5 * sin(2 * pi * x) * cos(2 * pi * y), 0.5 - 0.5 * cos(2 * pi * x) * sin(2 * pi * y))
    model = nv.Model(
        material=nv.ReferentialNeoHookean(K_e=1e10, G_e=5e5, elastic_state="F"),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
    )
    start = nv.Initial(density=1 + 0.2 * cos(2 * pi * x), velocity=eddy)
    run = nv.Simulation(box((1, 1), 0.4, periodic="xy"), model, dt=0.1, initial=start, solver="coupled")
    assert run.advance()["newton_iterations"] <= 15


def creeping(unit: float, kind: str) -> np.ndarray:
    """Coefficients of F in a body that is held in shear and creeps by a power of its stress, after a step.

    The body carries a concentration, or its shear modulus, in another ``unit``.
    """

    def energy(F, J, c):
        return 5 * (J - 1) * (J - 1) / J + 2 * square(F) / J + 0.5 * (unit * c) * (unit * c) / J

    variables = Distortion(), Jacobian(), Concentration()
    material: nv.Material = nv.CustomMaterial(transported=variables, stored_energy=energy)
    if kind == "modulus":
        modulus = 4 * unit * nv.Parameter("theta", start=1 / unit)
        material = nv.ReferentialNeoHookean(K_e=10.0, G_e=modulus, elastic_state="F")
    run = nv.Simulation(
        box((1, 1), 1),
        nv.Model(material=material, creep=nv.Norton(A=0.1, n=4.0)),
        dt=0.5,
        initial=nv.Initial(F=SHEARED, density=1.0, values={"c": CF(1 / unit)} if kind == "solute" else {}),
        walls=dict.fromkeys(("left", "right", "top", "bottom"), nv.NoSlip()),
        solver="coupled",
    )
    assert abs(run.advance()["closure_relative"]) < 1e-13
    return run.rothe_step.state.vec.FV().NumPy()[run.solver.norm.ranges["z"]].copy()


SHEARED = CF((1, 0.5, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))


@pytest.mark.parametrize("kind", ["solute", "modulus"])
def test_the_unit_of_a_carried_number_does_not_change_the_strains(kind):
    """In an earlier version numbers of 1e5, as in mol/m^3, hid the strains, which were then wrong by 1e-4."""
    strains = [creeping(unit, kind) for unit in (1.0, 1e-5, 1e5)]
    assert np.abs(strains[0] - 1).max() > 0.1
    for others in strains[1:]:
        assert np.abs(others - strains[0]).max() < 1e-12


@pytest.mark.parametrize("unit", [1.0, 1e-5])
def test_a_solute_that_begins_at_zero_is_resolved_up_to_rounding(unit):
    """Under a load of 1e-7 Pa the solute's amount is so small that rounding of the strain changes it by more
    than the tolerance. Terzaghi's settlement after 0.02 s is 0.0167 m/Pa; one step gives less."""

    def energy(A, c):
        room = 1 - A - unit * c
        return (5 * (1 - A) * (1 - A) + 500 * room * room) / A

    gel = nv.CustomMaterial(transported=(ReciprocalJacobian(), Concentration()), stored_energy=energy)
    drained = {"top": nv.WallExchange(potential=0.0, coefficient=1e3 / unit**2)}
    law = nv.Diffusion(variable="c", mobility=0.1 / unit**2, walls=drained)
    viscosity = nv.StokesViscosity(K_v=0.01, G_v=0.01)
    run = nv.Simulation(
        box((0.5, 1), 0.25),
        nv.Model(material=gel, viscosity=viscosity, diffusion=law),
        time=nv.TimeSteps(dt=0.02, velocity_scale=1e-7),
        initial=nv.Initial(density=0.01),
        walls={"top": nv.Open(pressure=1e-7, displacement=True)},
        solver="split",
    )
    assert run.advance()["newton_iterations"] <= 9
    settled = -run.fields["displacement_top"](run.mesh(0.1, 1.0))[1] / 1e-7
    assert 0.014 < settled < 0.0167
