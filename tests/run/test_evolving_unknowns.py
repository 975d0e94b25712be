"""Evolving unknowns of further terms: schemes, ledger, error estimate, restart and transfer include them."""

from functools import partial

import numpy as np
import pytest
from ngsolve import CF, Integrate, exp, x, y
from support import assert_goes_on, each_once

import ngvisco as nv
from ngvisco.errors import ParameterError, UnknownNameError
from ngvisco.forms.term import Entry, Integrand, PointTerm
from ngvisco.forms.unknown import Unknown
from ngvisco.geometries import box
from ngvisco.physics.tensors import inner, square, tr
from ngvisco.run.fields import component_fields
from ngvisco.run.simulation import Simulation
from ngvisco.run.transfer import transfer
from ngvisco.timestepping.scheme import scheme_of

RATE = 2.0
MODEL = nv.Model(
    material=nv.NeoHookean(K_e=10, G_e=5, epsilon=0.1),
    viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
    loads=[nv.Gravity((0.3, -1))],
)


class Relaxation(PointTerm):
    """The equation dt theta + RATE theta = 0 with the energy theta^2/2, which has no effect on the flow."""

    place, evolves, scale, size = "continuous", True, 1.0, None

    def unknowns(self, setting):
        return (Unknown("theta", self.place, 1, self.size, evolves=self.evolves, scale=self.scale),)

    def cells(self, u, w):
        theta, old = u.parts["theta"], u.context.old.parts["theta"]
        return [inner(u.context.rate(theta - old) + RATE * theta, w.parts["theta"])]

    def entries(self, u):
        return [Entry("dissipation_theta", "dissipation", Integrand(RATE * square(u.parts["theta"])))]

    def energy(self, u):
        return Entry("stored", "energy", Integrand(0.5 * square(u.parts["theta"])))

    def slope(self, b, d):
        return Integrand(inner(b.parts["theta"], d.parts["theta"]))

    def distance(self, a, b):
        return Entry("bregman", "numerical", Integrand(0.5 * square(a.parts["theta"] - b.parts["theta"])))


class Pores(Relaxation):
    """A pore pressure that diffuses and is coupled to the flow in both directions."""

    def cells(self, u, w):
        p, q, dp, dq = u.parts["theta"], w.parts["theta"], u.gradient("theta"), w.gradient("theta")
        carried = 0.5 * (inner(u.v, dp) * q - p * inner(u.v, dq))
        change = u.context.rate(p - u.context.old.parts["theta"]) * q
        return [change, carried, 0.1 * inner(dp, dq), tr(u.L) * q - p * tr(w.L)]

    def entries(self, u):
        seeping = Integrand(0.1 * square(u.gradient("theta")))
        return [Entry("dissipation_theta", "dissipation", seeping)]


class Swelling(Pores):
    """Matter swells with the mean of old and new pore pressure, so that the equations of z read another
    evolving unknown."""

    def _growth(self, u):
        return 0.05 * (u.parts["theta"] + u.context.old.parts["theta"])

    def cells(self, u, w):
        return [*super().cells(u, w), -self._growth(u) * w.z_tensors["J"]]

    def entries(self, u):
        power = Integrand(self._growth(u) * u.zeta_tensors["J"])
        return [*super().entries(u), Entry("power_swelling", "power", power)]


def simulation(term: object, model: nv.Model = MODEL, maxh: float = 0.6, theta=0.7, **options) -> Simulation:
    values = {} if theta is None else {"theta": theta}
    return Simulation(
        box((1, 1), maxh=maxh), model, dt=0.05, terms=[term], initial=nv.Initial(values=values), **options
    )


def theta_of(run: Simulation) -> np.ndarray:
    return run.rothe_step.state.vec.FV().NumPy()[run.rothe_step.layout.ranges["theta"]].copy()


@pytest.mark.parametrize("name", ["backward-euler", "midpoint", "sdirk2"])
@pytest.mark.parametrize("place", ["continuous", "cells"])
def test_a_scalar_relaxes_by_the_schemes_stability_function(name, place):
    """theta_1 = R(-RATE tau) theta_0 with the tableau's R; the energy dissipated by the scheme is
    metered."""
    scheme = scheme_of(name)
    one, A, b = np.ones(scheme.stages), np.array(scheme.A), np.array(scheme.b)
    z = -RATE * 0.05
    stability = 1 + z * b @ np.linalg.solve(np.eye(scheme.stages) - z * A, one)
    term = Relaxation()
    term.place = place
    run = simulation(term, scheme=name, solver="coupled")
    ledger = run.run(0.1)
    mean = Integrate(run.rothe_step.now.parts["theta"], run.mesh)
    assert mean == pytest.approx(0.7 * stability**2, rel=1e-12)
    assert np.abs(ledger.column("closure_relative")).max() < 1e-13
    assert ledger.column("dissipation_theta")[-1] > 0.1


@pytest.mark.parametrize(
    ("term", "scheme"), each_once([Pores(), Swelling()], ["backward-euler", "midpoint", "sdirk2"])
)
def test_solvers_agree_and_the_ledger_closes_where_an_evolving_unknown_drives_the_flow(term, scheme):
    states, ledgers = [], []
    for solver in ("coupled", "split"):
        run = simulation(term, theta=exp(x) * y, scheme=scheme, solver=solver)
        ledgers.append(run.run(0.1))
        states.append(theta_of(run))
        assert np.abs(ledgers[-1].column("closure_relative")).max() < 1e-13
    assert np.allclose(*states, rtol=1e-9)
    stored = [ledger.column("stored")[-1] for ledger in ledgers]
    assert stored[0] == pytest.approx(stored[1], rel=1e-12)


def test_the_error_estimate_counts_evolving_unknowns():
    """The body is at rest, so that only theta changes. The estimate is (theta_2 - 2 theta_1 + theta_0)/3,
    relative to theta_2."""
    model = nv.Model(material=MODEL.material)
    steps = nv.AdaptiveSteps(dt_min=0.05, dt_max=0.05, tolerance=0.5)
    term = Relaxation()
    term.scale = 0.0
    run = simulation(term, model, adaptive=steps, solver="coupled")
    estimates = [run.advance()["error_estimate"] for _ in range(3)]
    assert estimates[-1] == pytest.approx((RATE * 0.05) ** 2 / 3, rel=1e-8)


def test_a_resumed_run_equals_the_uninterrupted_run_bit_for_bit(tmp_path):
    options = {
        "theta": exp(x) * y,
        "scheme": "midpoint",
        "solver": "split",
        "adaptive": nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.1, tolerance=1e-2),
    }
    run = assert_goes_on(partial(simulation, Pores(), **options), tmp_path / "run.h5", 0.2, -1)
    assert run.ledger.rows[-1]["error_estimate"] > 0


@pytest.mark.parametrize("place", ["continuous", "cells"])
def test_a_transfer_keeps_evolving_unknowns(place):
    """A linear field is transferred exactly, with its energy."""
    terms = [Relaxation(), Relaxation()]
    for term in terms:
        term.place = place
    source = simulation(terms[0], theta=1 + x - 2 * y, solver="coupled")
    source.run(0.05)
    target = simulation(terms[1], maxh=0.45, theta=None, solver="coupled")
    transfer(source, target)
    error = target.rothe_step.now.parts["theta"] - (1 + x - 2 * y) / (1 + RATE * 0.05)
    assert Integrate(error * error, target.mesh) < 1e-24
    ledger = target.run(0.1)
    assert abs(ledger.column("closure_relative")[-1]) < 1e-13
    without = Simulation(box((1, 1), maxh=0.6), MODEL, dt=0.05)
    with pytest.raises(ParameterError, match="the evolving unknown theta"):
        transfer(without, simulation(terms[0]))


def test_the_old_value_of_an_unknown_that_does_not_evolve_is_refused_by_name():
    term = Relaxation()
    term.evolves = False
    with pytest.raises(ParameterError, match=r"Relaxation reads the old value of theta.*evolves=True"):
        simulation(term, theta=None)


class Reading(Relaxation):
    """A term whose entries read the old value of another term's unknown."""

    def entries(self, u):
        return [Entry("power_old", "power", Integrand(square(u.context.old.zeta)))]


def test_an_old_value_in_ledger_entries_is_refused():
    with pytest.raises(ParameterError, match="Reading reads the old value of zeta"):
        simulation(Reading(), theta=None)


def test_the_split_solver_says_why_it_refuses_rows_in_cells():
    term = Relaxation()
    term.place = "cells"
    with pytest.raises(
        ParameterError, match=r"Relaxation \(there is no theta in cells; if the term has rows"
    ):
        simulation(term, solver="split")


class Half(PointTerm):
    """A term with a distance and without an energy."""

    def distance(self, a, b):
        return Entry("bregman", "numerical", Integrand(square(a.z - b.z)))


class Misnamed(Relaxation):
    """A term whose energy is in a separate column that the balance does not contain."""

    def energy(self, u):
        return Entry("heat", "energy", Integrand(square(u.parts["theta"])))


class ByVelocity(Relaxation):
    """A term whose slope has a part by v, which the conservation of momentum excludes."""

    def slope(self, b, d):
        return Integrand(inner(b.v, d.v))


@pytest.mark.parametrize(
    ("term", "said"),
    [
        (Half(), "this term lacks energy, slope"),
        (Misnamed(), "'kinetic' or 'stored'"),
        (ByVelocity(), "ByVelocity has a slope that reads the change of v"),
    ],
)
def test_a_term_whose_energy_would_be_lost_is_refused(term, said):
    with pytest.raises(ParameterError, match=said):
        simulation(term, theta=None)


@pytest.mark.parametrize("size", [None, 2, 4])
def test_an_evolving_unknown_is_a_field_of_the_run(size):
    term = Relaxation()
    term.size = size
    run = simulation(term, theta=x if size is None else CF((x,) * size), solver="coupled")
    parts = component_fields(run.fields, ["theta"])
    assert list(parts) == (["theta"] if size is None else [f"theta_{i + 1}" for i in range(size)])
    for part in parts.values():
        assert Integrate((part - x) ** 2, run.mesh) < 1e-24


def test_an_unknown_with_the_name_of_a_field_is_refused():
    for name in ("density", "F_tot"):
        term = Relaxation()
        term.unknowns = lambda setting, name=name: (Unknown(name, "cells", evolves=True),)
        term.cells = lambda u, w, name=name: [u.context.rate(u.parts[name]) * w.parts[name]]
        term.entries = lambda u: []
        with pytest.raises(ParameterError, match=r"Unknown\.name"):
            simulation(term, theta=None)


def test_declarations_of_evolving_unknowns_are_checked():
    with pytest.raises(ParameterError, match="'cells' or 'continuous' for 'theta'"):
        Unknown("theta", "facets", evolves=True)
    with pytest.raises(ParameterError, match=r"Unknown\.scale"):
        Unknown("theta", "cells", evolves=True, scale=-1.0)
    term = Relaxation()
    term.unknowns = lambda setting: (Unknown("F", "cells", evolves=True),)
    with pytest.raises(
        ParameterError, match="another name for this unknown, since the material has a variable 'F'"
    ):
        simulation(term, theta=None)


def test_an_unknown_start_value_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"thata.*theta"):
        Simulation(
            box((1, 1), maxh=0.6),
            MODEL,
            dt=0.05,
            terms=[Relaxation()],
            initial=nv.Initial(values={"thata": 1.0}),
        )
    with pytest.raises(ParameterError, match=r"Initial\.values\['theta'\]"):
        simulation(Relaxation(), theta=CF((1.0, 2.0)))
