"""Values that are not finite are refused in state, energy, ledger and observers; domains of energies."""

import io
import re
from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import CF, sqrt, x
from support import LINEAR, by_ci, each_once, small_run

import ngvisco as nv
from ngvisco.forms.bounds import Bounds
from ngvisco.forms.context import time
from ngvisco.forms.term import Entry, Integrand, PointTerm
from ngvisco.geometries import box
from ngvisco.physics.tensors import inner, log, tr
from ngvisco.physics.variables import Jacobian, LeftCauchyGreen
from ngvisco.run import observers
from ngvisco.solver.problem import iterations

DT, STRETCH = 0.05, 0.2
BY_B = (LeftCauchyGreen(exponent=-2 / 3), Jacobian())


def limited(B, J):  # Gent's rubber, which cannot be drawn further than tr B = 3 + STRETCH
    return 5 * (J - 2 + 1 / J) - 2 * STRETCH * log(1 - (tr(B) - 3) / STRETCH)


GENT = nv.CustomMaterial(
    transported=BY_B, stored_energy=limited, bounds={"room to stretch": lambda B, J: 3 + STRETCH - tr(B)}
)


def sheared(material, speed, solver, **options):
    """A body under a lid, on 14 triangles."""
    walls = {
        "top": nv.PrescribedTangential((16 * speed * x**2 * (1 - x) ** 2, 0)),
        ("left", "right"): nv.Slip(),
    }
    model = nv.Model(
        material=material,
        viscosity=nv.StokesViscosity(K_v=1, G_v=1),
        creep=options.pop("creep", nv.Creep(G_m=2.0)),
    )
    options = {"dt": DT, "walls": walls, "solver": solver} | options
    return nv.Simulation(box((1, 1), 0.5), model, initial=nv.Initial(density=1.0), **options)


def largest(run, name, value):
    assert run.bounds.violation(everywhere=True) is None
    return run.sampler.extrema(value(run.rothe_step.now.z_tensors))[1]


@pytest.mark.parametrize(
    ("solver", "scheme"), each_once(["split", "coupled"], ["midpoint", "backward-euler"])
)
def test_states_stay_within_the_domain_of_the_energy(solver, scheme):
    """FENE-P chains are stretched almost to their largest length; the ledger closes."""
    creep = nv.Creep(G_m=10.0, law="conformation")
    run = sheared(nv.FENEP(K_e=10, G_e=5, b=5), 4.0, solver, creep=creep, scheme=scheme)
    ledger = run.run(3 * DT)
    for name in ("stored", "bregman", "closure", "limiter"):
        assert np.isfinite(ledger.column(name)).all()
    assert abs(ledger.column("closure_relative")).max() < 1e-9
    assert 4.0 < largest(run, "B", lambda z: tr(z["B"])) < 5.0


@pytest.mark.parametrize("solver", [by_ci("coupled"), "split"])
def test_a_step_beyond_the_domain_of_the_energy_is_refused_with_the_name_of_the_bound(solver):
    """A lid stretches an elastic body until a step is refused. The error states the remaining stretch."""
    run = sheared(GENT, 4.0, solver, creep=None, halvings=1)
    with pytest.raises(nv.StepError) as caught:
        run.run(1.0)
    assert np.isfinite(run.ledger.column("stored")).all() and run.t < 1.0
    assert "not a number; the energy of B, J has values only where room to stretch > 0" in str(caught.value)
    furthest = largest(run, "B", lambda z: tr(z["B"]))
    assert furthest < 3 + STRETCH
    for told in (str(caught.value), str(caught.value.report).splitlines()[0]):
        found = re.search(
            r"before the step room to stretch is (\S+) in cell \d+ at \(.+\) m, .*0.2 at rest", told
        )
        assert found is not None and float(found[1]) == pytest.approx(3 + STRETCH - furthest, rel=0.01)


@pytest.mark.long
@pytest.mark.ci
def test_a_coupled_step_that_reaches_a_bound_is_refused_after_few_iterations():
    """Steps of growing length end as soon as the remaining lengths cannot reach the whole step."""
    run = sheared(nv.FENEP(K_e=10, G_e=5, b=5), 4.0, "coupled", creep=None, halvings=0)
    run.advance()
    with pytest.raises(
        nv.StepError, match=r"before the step b - tr B is 0\.46\d in cell 3 at \(0, 1\)"
    ) as caught:
        run.advance()
    lengths = [attempt for attempt in caught.value.history if attempt.start == "by growing lengths"]
    assert 5 <= len(lengths) <= 14 and 100 < len(iterations(caught.value.history)) < 250


def test_the_limiter_moves_a_state_into_the_domain_of_its_energy():
    run = sheared(GENT, 1.0, "coupled")
    z, bounds = run.rothe_step.state.components[1], Bounds(run.rothe_step, run.sampler)
    values = run.rothe_step.state.vec.FV().NumPy()[run.rothe_step.layout.ranges["z"]]
    rng = np.random.default_rng(0)
    before = values.copy()
    values += 0.15 * rng.uniform(-1, 1, values.shape) * (rng.uniform(size=values.shape) < 0.3)
    found = bounds.violation(everywhere=True)
    assert z is not None and found.quantity == "room to stretch" and found.value < 0
    means = bounds.violation()  # no limiter can correct a mean outside of the domain
    values[:] = 0.5 * (values + before) if means is not None else values
    assert bounds.violation() is None and bounds.limit() > 0
    assert bounds.violation(everywhere=True) is None and bounds.lack() is None


def test_start_values_out_of_the_domain_are_refused():
    with pytest.raises(nv.InitialDataError, match="room to stretch"):
        sheared_from = nv.Initial(density=1.0, F=CF((1.5, 0, 0, 0, 1 / 1.5, 0, 0, 0, 1), dims=(3, 3)))
        nv.Simulation(box((1, 1), 0.5), nv.Model(material=GENT), dt=DT, initial=sheared_from)


@pytest.mark.parametrize(
    ("bounds", "said"),
    [
        ([1], "a mapping of names"),
        ({"a": 1}, "a mapping of names"),
        ({"a": lambda B: 1 - tr(B)}, "a function of B, J"),
        ({"a": lambda B, J: J - 1}, "positive at rest"),
        ({"a": lambda B, J: x * J}, "reads the position"),
        ({"a": lambda B, J: B[0, 0]}, "the same for all observers"),
        ({"a": lambda B, J: (tr(B) - 3) * (tr(B) - 3) + J - 0.99}, "a convex set"),
    ],
)
def test_invalid_bounds_of_a_material_are_refused(bounds, said):
    with pytest.raises(nv.ParameterError, match=re.escape("CustomMaterial.bounds") + f".*{said}"):
        nv.CustomMaterial(transported=BY_B, stored_energy=limited, bounds=bounds)


def test_bounds_of_a_body_are_refused_by_name():
    foam = nv.CustomMaterial(
        transported=(LeftCauchyGreen(exponent=-5 / 3), Jacobian()),
        stored_energy=lambda B, J: 2 * tr(B) + 5 * (J - 2 + 1 / J),
        bounds={"room": lambda B, J: 9 - tr(B)},
    )
    body = nv.Body(name="foam", where=nv.Ball((0.5, 0.5), 0.2), material=foam, density=1)
    with pytest.raises(nv.ParameterError, match="has a value only for room > 0"):
        nv.Model(bodies=[body, nv.Body(name="rest", material=foam, density=1)])


@dataclass(frozen=True)
class Misnamed(nv.ReferentialNeoHookean):
    def positive(self, z):
        return super().positive(z) | {"Jay": {"J - 0.1": z["J"] - 0.1 if "J" in z else z["A"]}}


def test_a_bound_of_an_unknown_variable_is_named():
    material = Misnamed(K_e=2.0, G_e=1.0, elastic_state="B")
    with pytest.raises(nv.errors.UnknownNameError, match=r"Misnamed\.positive.*'Jay'"):
        nv.Simulation(box((1, 1), 1.0), nv.Model(material=material), dt=DT)


class Pole(PointTerm):
    """A drag that has no value from a time on."""

    def rate(self, u):
        return sqrt(0.061 - time) * (1 + x)

    def cells(self, u, w):
        return [0.0 * inner(u.v, w.v)]

    def entries(self, u):
        return [Entry("dissipation_pole", "dissipation", Integrand(1e-30 * self.rate(u)))]


@pytest.mark.parametrize("adaptive", [None, nv.AdaptiveSteps(dt_min=0.02, dt_max=0.04)])
def test_a_rate_that_is_not_finite_rejects_the_step(adaptive):
    run = small_run(
        terms=[Pole()], time=nv.TimeSteps(dt=0.04, adaptive=adaptive, **({} if adaptive else {"halvings": 1}))
    )
    run.advance(0.04)
    with pytest.raises(nv.StepError, match=r"dissipation_pole is -?nan, in cell \d+ at \("):
        run.run(1.0)
    assert run.ledger.rows[-1]["time"] == run.t >= 0.04 and np.isfinite(run.ledger.column("closure")).all()


def test_a_ledger_row_that_is_not_finite_rejects_the_step(monkeypatch):
    run = small_run()
    run.advance()
    measured = run.ledger._measured
    monkeypatch.setattr(run.ledger, "_measured", lambda *of: measured(*of) | {"v_max": np.nan})
    state, t = run.rothe_step.state.vec.FV().NumPy().copy(), run.t
    with pytest.raises(nv.StepError, match="v_max is nan at t = "):
        run.advance()
    assert len(run.ledger.rows) == 2 and run.t == t
    assert np.array_equal(state, run.rothe_step.state.vec.FV().NumPy())


@pytest.mark.parametrize("what", ["probe", "line", "force", "integral"])
def test_an_observer_with_a_value_that_is_not_finite_ends_the_run(what, monkeypatch):
    seen = {
        "probe": nv.Probes([(0.5, 0.5)], ["density"]),
        "line": nv.LineSamples((0.1, 0.1), (0.9, 0.1), 3, ["density"]),
        "force": nv.WallForces(["top"]),
        "integral": nv.Integrals({"pole": "sqrt(0.03 - t)"}),
    }[what]
    run = small_run(material=LINEAR, observers=[seen])
    if what != "integral":
        run.run(0.02)
        spoilt = np.zeros(len(seen.columns) - 2)
        spoilt[-1] = np.inf
        original = seen._sample
        monkeypatch.setattr(seen, "_sample", lambda run: np.asarray(original(run)) + spoilt)
    name = {
        "probe": "Probes: 'p1.density' is inf",
        "line": "'density' at s = ",
        "force": "WallForces: .* is inf",
        "integral": "'pole' is nan",
    }[what]
    with pytest.raises(nv.NotANumberError, match=f"{name}.* at t = 0.04 s"):
        run.run(0.06)


def test_a_step_that_costs_ten_times_the_median_is_reported(monkeypatch):
    lines, now = io.StringIO(), [0.0]
    monkeypatch.setattr(observers.clock, "perf_counter", lambda: now[0])

    class Clock(nv.Observer):
        def step(self, simulation, row):
            now[0] += 4.0 if simulation.number == 7 else 0.3 if simulation.number < 9 else 2.9

    run = small_run(material=LINEAR, observers=[Clock(), nv.Progress(until=0.2, stream=lines)])
    run.run(0.2)
    said = [line for line in lines.getvalue().splitlines() if "median" in line]
    assert (
        len(said) == 1 and said[0].startswith("step     7/10") and "took 4 s, 13 times the median" in said[0]
    )
