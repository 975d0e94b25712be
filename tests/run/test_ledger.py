"""The energy ledger: every entry is the power of its form, and the sum of all entries closes to rounding."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ngsolve import CF, Id, OuterProduct, sin, x, y
from support import (
    SWIRL,
    Case,
    assert_balanced,
    by_ci,
    parts_of,
    randomise,
    residual,
    small_box,
    step_of,
    uncondensed,
)

import ngvisco as nv
from ngvisco.forms.fields import Fields
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.start.initial import _recover_hessian
from ngvisco.forms.system import Step
from ngvisco.forms.term import PLACES, Entry, Integrand
from ngvisco.forms.terms.hyperviscosity import Hyperviscosity
from ngvisco.forms.terms.momentum import Inertia, Loading, Stokes
from ngvisco.forms.terms.transport import Kinematics
from ngvisco.geometries import box
from ngvisco.run.ledger import NUMERICAL, closure_limit, unit
from ngvisco.solver.problem import Attempt, NewtonIteration, Solution, Status
from ngvisco.timestepping.integrator import StepTaken

CASES = [
    Case(),
    Case(k=3, m=2, p=3.5, mu_1=0.3),
    Case(m=0, p=2.0),
    Case(material="linear", p=None),
    Case(material="hardening", m=2, creep=False),
    Case(dim=3),
    Case(dim=3, material="linear", m=0, p=3.5, mu_1=0.3),
]
by_case = pytest.mark.parametrize("case", CASES, ids=str)
COLUMNS = (
    *("step", "time", "dt", "kinetic", "stored", "closure", "closure_relative", "mass", "mass_drift"),
    *("rho_min", "rho_max", "J_min", "newton_iterations", "cfl"),
)


# --- entries against forms ---------------------------------------------------------------------------


def make_consistent(step: Step) -> None:
    for term in step.terms:
        if isinstance(term, Hyperviscosity):
            _recover_hessian(step, term)
            if term.law.is_linear:
                parts = parts_of(step)
                parts["hyperstress"].vec.data = (term.law.mu + term.law.mu_1) * parts["hess"].vec
    step.local_unknowns.update()


def own_test(step: Step) -> np.ndarray:
    """The test function of the energy balance: w = v with its trace a, G = zeta."""
    state, test = step.state.vec.FV().NumPy(), np.zeros(step.layout.space.ndof)
    ranges = step.layout.ranges
    for name in step.layout.names:
        if name == "v" or name.startswith("a_"):
            test[ranges[name]] = state[ranges[name]]
    test[ranges["z"]] = state[ranges["zeta"]]
    return test


def power(step: Step, *terms: type) -> float:
    trial, test = step.layout.space.TnT()
    u, w = Fields.of(step.layout, trial), Fields.of(step.layout, test)
    parts = [part for term in step.terms if isinstance(term, terms) for part in term.form(u, w)]
    return float(residual(uncondensed(step, parts), step.state.vec) @ own_test(step))


def entered(step: Step, *terms: type) -> dict[str, float]:
    totals = {}
    for term in step.terms:
        if isinstance(term, terms):
            for entry in term.entries(step.now):
                totals[entry.name] = integral(step, entry.integrand)
    return totals


def integral(step: Step, integrand: Integrand) -> float:
    total = 0.0
    if integrand.cells is not None:
        total += step.quadrature.integrate_cells(integrand.cells)
    if integrand.facets is not None:
        total += step.quadrature.integrate_facets(integrand.facets)
    if integrand.collocated is not None:
        total += step.quadrature.integrate_collocated(integrand.collocated)
    return total


@by_case
def test_dissipations_equal_the_powers_of_their_forms(case: Case) -> None:
    step = step_of(case)
    randomise(step, 1)
    make_consistent(step)
    for term in (Stokes, Hyperviscosity):
        entries = entered(step, term)
        assert (term is Hyperviscosity and case.p is None) or all(e > 0 for e in entries.values())
        assert sum(entries.values()) == pytest.approx(power(step, term), rel=1e-12)


@pytest.mark.filterwarnings("ignore::ngvisco.run.signs.DissipationWarning")  # the states are random
@by_case
def test_closure_equals_the_residual_tested_with_the_solution(case: Case) -> None:
    """For any state, converged or not, closure = tau <R(u), (v, zeta)>, which is zero for a solution."""
    run = nv.Simulation(
        small_box(case.dim), case.model, dt=0.3, discretisation=Discretisation(k=case.k, m=case.m)
    )
    step = run.rothe_step
    step.context.curvature.Set(0.2)
    step.context.tau.Set(0.3)
    step.context.set_loads(0.2, 0.3)
    randomise(step, 5)
    new = step.state.vec.CreateVector()
    new.data = step.state.vec
    step.state.vec.data = step.state_old.vec
    run.ledger.start(0.2)
    before = step.evolved()
    step.state.vec.data = new
    make_consistent(step)
    distance = run.integrator.distance(before, step.evolved())
    lines = (NewtonIteration(0.0, 0.0, 1.0, False),) * 7
    history = [Attempt("coupled", Solution(Status.CONVERGED, lines))]
    row = run.ledger.record(1, 0.5, StepTaken(0.3, history, run.ledger.rates(), distance))
    tested = 0.3 * float(residual(uncondensed(step), step.state.vec) @ own_test(step))
    assert abs(tested) > 1e-3
    assert row["closure"] == pytest.approx(tested, rel=1e-10)
    assert row["newton_iterations"] == 7 and set(COLUMNS) <= set(row)


# --- runs --------------------------------------------------------------------------------------------


def run_of(material: str, tau: float = 0.05, is_loaded: bool = True) -> nv.Simulation:
    model = nv.Model(
        material=Case(material=material).model.material,
        viscosity=nv.StokesViscosity(K_v=0.02, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-3, p=4),
        creep=nv.Creep(G_m=2.0),
        loads=(nv.Gravity((0.5 * sin(20 * nv.time), -1.0 - nv.time)),) if is_loaded else (),
    )
    F = Id(3) + 0.1 * x * y * OuterProduct(CF((1, 0.5, 0)), CF((0, 1, 0)))
    initial = nv.Initial(density=1 + 0.3 * x, velocity=SWIRL, F=F)
    newton = nv.NewtonOptions(tolerance=1e-12)
    return nv.Simulation(box((1, 1), 0.6), model, dt=tau, initial=initial, newton=newton)


@pytest.mark.parametrize("material", ["linear", "neo_hookean", "hardening"])
def test_ledger_closes_to_rounding(material: str) -> None:
    """Gravity changes in time, and every entry is at work."""
    ledger = run_of(material).run(until=0.2)
    assert_balanced(ledger, 1e-12, 1e-13)
    for row in ledger.rows[1:]:
        assert row["inertial"] > 0 and row["bregman"] > 0 and abs(row["power_gravity"]) > 1e-4
        assert all(row[name] > 0 for name in ledger.columns if name.startswith("dissipation_"))


@pytest.mark.parametrize(
    ("tau", "material"),
    [(0.5, "linear"), (5.0, "linear"), (0.5, "neo_hookean"), by_ci(5.0, "neo_hookean")],
)
def test_energy_never_rises_without_load(material: str, tau: float) -> None:
    """The energy falls for any length of the step (the paper's unconditional stability)."""
    ledger = run_of(material, tau, is_loaded=False).run(until=3 * tau)
    assert np.all(np.diff(ledger.column("kinetic") + ledger.column("stored")) < 0)
    assert_balanced(ledger, 1e-12, 1e-13)


def scaled(entries: Callable[..., list[Entry] | Entry], name: str, factor: float) -> Callable:
    def broken(self, *fields) -> list[Entry] | Entry:
        def one(entry: Entry) -> Entry:
            part = entry.integrand
            if entry.name == name:
                parts = (getattr(part, place) for place in PLACES)
                part = Integrand(*(None if each is None else factor * each for each in parts))
            return Entry(entry.name, entry.kind, part)

        result = entries(self, *fields)
        return one(result) if isinstance(result, Entry) else [one(entry) for entry in result]

    return broken


BROKEN = {
    "inertial": (Inertia, 2.0),  # the broken entry lacks its factor 1/2
    "bregman": (Kinematics, 1.01),
    "dissipation_creep": (Kinematics, 0.99),
    "dissipation_stokes_bulk": (Stokes, 1.01),
    "dissipation_stokes_shear": (Stokes, 0.5),
    "dissipation_hyper": (Hyperviscosity, 1.01),
    "power_gravity": (Loading, -1.0),
}


@pytest.mark.parametrize("name", BROKEN)
def test_the_ledger_does_not_close_with_a_wrong_entry(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A negative control: the ledger closes to rounding only if every entry has the right factor."""
    term, factor = BROKEN[name]
    method = "distance" if name in NUMERICAL else "entries"
    monkeypatch.setattr(term, method, scaled(getattr(term, method), name, factor))
    with pytest.warns(nv.ClosureWarning, match="THE LEDGER DOES NOT CLOSE in 1 step: "):
        row = run_of("neo_hookean").advance()
    assert abs(row["closure_relative"]) > 1e-8


def test_steps_whose_ledger_does_not_close_are_counted_in_one_warning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The limit is 1e-8, or 100 times the solver's tolerance if this is larger."""
    assert closure_limit(1e-12) == 1e-8 and closure_limit(1e-6) == pytest.approx(1e-4)
    monkeypatch.setattr(Inertia, "distance", scaled(Inertia.distance, "inertial", 1.01))
    run = run_of("linear")
    with pytest.warns(nv.ClosureWarning) as caught:
        run.run(3 * run.dt)
    assert len(caught) == 1
    worst = abs(run.ledger.column("closure_relative")).max()
    assert "in 3 steps" in run.ledger.unclosed and f"{worst:.1e}" in run.ledger.unclosed
    run.ledger.closed = 1.0
    assert not run.ledger.unclosed
    run.ledger.rows[-1]["closure_relative"] = float("nan")
    assert "is inf in step 3" in run.ledger.unclosed


def test_each_part_of_a_resumed_run_is_judged_by_the_tolerance_of_this_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a resume, the warning still names a step that did not close. The warning does not name a step
    that closes by the larger tolerance of its own part."""
    monkeypatch.setattr(Inertia, "distance", scaled(Inertia.distance, "inertial", 1.01))
    path = tmp_path / "run.h5"

    def part(steps: int, closed: float = 1e-8) -> str:
        run = run_of("linear")
        if path.exists():
            run.restore(path)
        run.ledger.closed, run.observers = closed, [nv.Checkpoints(path)]
        run.run(steps * run.dt)
        return run.ledger.unclosed

    assert not part(1, 1.0)
    with pytest.warns(nv.ClosureWarning, match="in 1 step: .* in step 2 .*above the limit 1e-08"):
        part(2)
    monkeypatch.undo()
    assert "in 1 step: " in part(3) and "in 1 step: " in part(4, 1.0)


# --- the other columns ---------------------------------------------------------------------------------


def test_extrema_of_density_and_jacobian_equal_those_of_the_fields() -> None:
    stretch = CF((1 + 0.5 * x, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    material = Case().model.material
    initial = nv.Initial(density=2 - y, F=stretch)
    run = nv.Simulation(box((1, 1), 0.5), nv.Model(material=material), dt=0.1, initial=initial)
    row = run.ledger.start(0.0)
    assert row["rho_min"] == pytest.approx(1.0) and row["rho_max"] == pytest.approx(2.0)
    assert row["J_min"] == pytest.approx(1.0)
    assert row["mass"] == pytest.approx(1.5)
    assert row["J_defect"] == pytest.approx(0.0, abs=1e-13)


def test_the_jacobian_defect_is_the_norm_of_J_minus_det_F() -> None:
    initial = nv.Initial(F=1.1 * Id(3), values={"J": 1.1**3 + 0.2})
    with pytest.warns(nv.InputWarning, match=r"J does not follow from F \(the difference is 0.2, at "):
        run = nv.Simulation(
            box((1, 2), 0.7), nv.Model(material=Case().model.material), dt=0.1, initial=initial
        )
    row = run.ledger.start(0.0)
    assert row["J_defect"] == pytest.approx(0.2 * 2**0.5)
    assert row["J_min"] == pytest.approx(1.1**3 + 0.2)


def test_the_jacobian_columns_of_a_linearised_material_are_nan() -> None:
    run = nv.Simulation(box((1, 1), 0.7), nv.Model(material=Case(material="linear").model.material), dt=0.1)
    row = run.ledger.start(0.0)
    assert np.isnan(row["J_min"]) and np.isnan(row["J_defect"])


def test_speed_and_courant_number_follow_from_the_velocity() -> None:
    mesh = box((1, 1), 0.5)
    run = nv.Simulation(mesh, nv.Model(material=Case().model.material), dt=0.1)
    parts_of(run.rothe_step)["v"].Set(CF((3, 4)))
    run.ledger.start(0.0)
    taken = StepTaken(0.1, [], run.ledger.rates(), {"inertial": 0.0, "bregman": 0.0})
    row = run.ledger.record(1, 0.1, taken)
    assert row["v_max"] == pytest.approx(5.0)
    assert row["cfl"] == pytest.approx(0.5 / min(run.rothe_step.context.h.vec))
    assert row["kinetic"] == pytest.approx(12.5)


def test_ledger_columns_have_units() -> None:
    ledger = run_of("neo_hookean").ledger
    units = {name: unit(name) for name in ledger.columns}
    assert units["kinetic"] == units["bregman"] == units["closure"] == "J"
    assert units["power_gravity"] == units["dissipation_hyper"] == "W"
    assert units["mass"] == "kg" and units["cfl"] == units["mass_drift"] == "1"
