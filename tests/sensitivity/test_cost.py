"""Work of derivatives, counted in matrices, solves and residuals. These numbers do not depend on other
processes. The numbers do not measure time: a matrix takes much longer than a solve
(``ngvisco/sensitivity/NOTES.md``)."""

from collections import Counter

import numpy as np
import pytest
from ngsolve import CF, Integrate
from test_demos import load

import ngvisco as nv
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.starts import Starts
from ngvisco.solver.newton import CondensedJacobian

COUNTED = {
    "steps": (nv.Simulation, "advance"),
    "matrices": (CondensedJacobian, "factorise"),
    "solves": (CondensedJacobian, "solve"),
    "transposed solves": (CondensedJacobian, "solve_transposed"),
    "slopes by the start": (Starts, "transposed"),
    "residuals": (Follower, "residual"),
}


@pytest.fixture
def counts(monkeypatch):
    """Calls so far, by ``COUNTED``."""
    calls = Counter()

    def count(name, function):
        def counted(*given, **named):
            calls[name] += 1
            return function(*given, **named)

        return counted

    for name, (owner, method) in COUNTED.items():
        monkeypatch.setattr(owner, method, count(name, getattr(owner, method)))
    return calls


def test_the_work_of_an_adjoint_does_not_grow_with_the_number_of_parameters(counts):
    """In each stage an adjoint takes a matrix, a slope by the start and a solve; the run takes more
    solves."""
    demo = load("soft_spot")

    def ground():
        return demo.simulation(nv.Parameter("stiffness", start=3.0), cells=(4, 2), solver="coupled")

    ground().run(demo.UNTIL)
    alone = counts.copy()
    counts.clear()
    data = dict.fromkeys((f"s{i}.velocity_1 until {demo.UNTIL}" for i in range(demo.STATIONS)), 1e-3)
    numbers = {"misfit": nv.Misfit(data, demo.NOISE)}
    gradient = nv.gradient(ground(), demo.UNTIL, of=numbers, method="adjoint")
    density = gradient.density("misfit", "stiffness")
    of_blocks = Integrate(density * CF(tuple(demo.blocks())), density.space.mesh, order=3)
    assert len(of_blocks) == 50 and np.any(of_blocks)
    kinds = ("matrices", "slopes by the start", "transposed solves")
    assert counts - alone == Counter(dict.fromkeys(kinds, alone["steps"]))
    assert 3 * alone["steps"] <= 2 * alone["solves"]


@pytest.mark.long
@pytest.mark.ci
def test_a_fit_takes_fewer_linear_solves_than_ten_runs(counts):
    """Each run of the fit takes two solves and four residuals in each stage for its two derivatives."""
    demo = load("creep_test")
    data = demo.record(2.0, maxh=1.2)
    counts.clear()
    demo.simulation(1.2).run(2.0)
    alone = counts.copy()
    counts.clear()
    fit = nv.fit(demo.simulation(1.2), data, by=list(demo.TRUE), sigma=demo.NOISE)
    steps = fit.runs * alone["steps"]
    of_runs = counts["solves"] - 2 * steps
    assert counts["steps"] == steps and counts["residuals"] == 4 * steps
    assert counts["solves"] < 10 * alone["solves"]
    # each iteration of a run evaluates one residual
    assert of_runs + counts["residuals"] < 10 * alone["solves"]
    assert counts["matrices"] - steps < 10 * alone["matrices"]
