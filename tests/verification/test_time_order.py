"""First order in tau: one mesh, steps tau, tau/2, tau/4 against tau/8 of the midpoint rule."""

import pytest

from tests.verification.convergence import free_solution, separation
from tests.verification.rates import RateTable

DURATION = 0.1


@pytest.mark.parametrize(
    "kind", ["linear", pytest.param("neo-hookean", marks=[pytest.mark.long, pytest.mark.ci])]
)
def test_scheme_is_of_first_order_in_tau(kind: str) -> None:
    table = RateTable(f"order in tau, {kind}")
    reference = free_solution(kind, 32, DURATION, scheme="midpoint")
    for steps in (4, 8, 16):
        table.add(DURATION / steps, **separation(reference, free_solution(kind, steps, DURATION)))
    print(table)
    for name in table.errors:
        for rate in table.rates(name):
            assert 0.85 <= rate <= 1.2, f"{name}\n{table}"


def test_short_steps_converge_where_the_flow_turns_round() -> None:
    """At t = 0.18 v.n changes sign on a facet, and the elastic force jumps with the upwind side."""
    ledger = free_solution("neo-hookean", 128, 0.2).ledger
    assert abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("time")[-1] == pytest.approx(0.2)
