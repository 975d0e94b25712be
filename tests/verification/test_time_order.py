"""First order in tau: one mesh, steps tau, tau/2, tau/4 against tau/32."""

from __future__ import annotations

import pytest
from cases import KINDS, model
from manufactured import Exact, RateTable
from ngsolve import GridFunction
from problems import distance

from ngvisco import Initial, Simulation, time
from ngvisco.geometries import box

DURATION = 0.1


def solution(kind: str, steps: int, duration: float = DURATION) -> Simulation:
    system = model(kind, 2, None)
    time.Set(0.0)
    exact = Exact(system, 2, 0.0)
    initial = Initial(density=exact.rho, velocity=exact.v, values=exact.values)
    simulation = Simulation(box((1, 1), 0.6), system, dt=duration / steps, initial=initial)
    simulation.run(duration)
    return simulation


@pytest.mark.parametrize("kind", KINDS)
def test_scheme_is_of_first_order_in_tau(kind: str) -> None:
    coarsest = 4
    reference = solution(kind, 32 * coarsest)
    mesh, best = reference.mesh, reference.rothe_step
    table = RateTable(f"order in tau, {kind}")
    for steps in (coarsest, 2 * coarsest, 4 * coarsest):
        other = solution(kind, steps).rothe_step
        # the two runs have equal meshes of their own: compare on one of them
        copy = GridFunction(best.layout.space)
        copy.vec.data = other.state.vec
        u = best.layout.fields(copy.components)
        errors = {
            name: distance(getattr(u, name), getattr(best.now, name), mesh) for name in ("v", "rho", "z")
        }
        table.add(DURATION / steps, **errors)
    print(table)
    for name in table.errors:
        for rate in table.rates(name):
            assert 0.85 <= rate <= 1.2, f"{name}\n{table}"


def test_short_steps_converge_where_the_flow_turns_round() -> None:
    """At t = 0.18 v.n changes sign on a facet, and the elastic force jumps with the upwind side.

    Newton from the old state then ends in a fold; the solution is found by narrowing the upwinding.
    """
    ledger = solution("neo-hookean", 128, duration=0.2).ledger
    assert abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("time")[-1] == pytest.approx(0.2)
