"""Rates of convergence to manufactured solutions, and their loss with wrong sources."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from ngsolve import CoefficientFunction

from ngvisco import Initial, Model
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh import quadrature
from ngvisco.forms.term import Integrand
from ngvisco.physics.model import CreepMechanism
from tests.verification.convergence import FURTHER, KINDS, coupled_rates, free_solution, model
from tests.verification.manufactured import Exact, Sources, TakingPartWholly

LONG, CI = pytest.mark.long, (pytest.mark.long, pytest.mark.ci)


# --- the whole system -------------------------------------------------------------------------------------

FULL, THIRD = (2.7, 1.85, 1.85), (2.5, 2.5, 2.5)
"""Least rates of v, rho and z: near k + 1 and m + 1 for k = 2. For k = 3 and m = 2 in 3D the rates are
m + 1/2: upwind transport has this rate on any mesh, and v has it because of the stress."""
TABLE: list[tuple[int, float | None, int, int, tuple[float, ...], dict[str, Any]]] = [
    # dim, p, k, m, rates, marks by kind; 3D takes seconds to ten minutes, higher order half a minute to two
    (2, None, 2, 1, FULL, {"neo-hookean": (), "linear": LONG}),
    (2, 4.0, 2, 1, (1.7, 1.75, 1.75), {"linear": CI, "neo-hookean": LONG}),
    (2, 2.0, 2, 1, (1.7, 1.75, 1.75), {"linear": CI, "neo-hookean": CI}),
    (2, None, 3, 2, (3.5, 2.7, 2.7), dict.fromkeys(KINDS, LONG)),
    (2, 2.0, 3, 2, (3.4, 2.7, 2.7), dict.fromkeys(KINDS, LONG)),
    (2, 4.0, 3, 2, (2.9, 2.35, 2.5), dict.fromkeys(KINDS, LONG)),
    (3, None, 2, 1, (2.7, 2.2, 1.8), dict.fromkeys(KINDS, CI)),
    (3, 4.0, 2, 1, (1.65, 2.0, 1.85), dict.fromkeys(KINDS, LONG)),
    (3, None, 3, 2, THIRD, dict.fromkeys(KINDS, LONG)),
]


@pytest.mark.parametrize(
    ("kind", "dim", "p", "k", "m", "least"),
    [pytest.param(kind, *row, marks=marks) for *row, kinds in TABLE for kind, marks in kinds.items()],
)
def test_coupled_rates_are_those_of_theory(
    kind: str, dim: int, p: float | None, k: int, m: int, least: tuple[float, ...]
) -> None:
    """The runs have creep, gravity and viscosity.  Rates are k + 1 and m + 1; with hyperviscosity, p = 4 and
    k = 2, they are 2."""
    maxh, levels = (0.4, 3) if dim == 2 else (1.0, k)
    table = coupled_rates(kind, dim, p, k, m, maxh, levels)
    table.require(**dict(zip(("v", "rho", "z"), least, strict=True)))


@pytest.mark.long
def test_convergence_rates_are_lost_if_the_two_sides_of_a_face_have_different_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Negative control: NGSolve's own rules for triangles, which are not symmetric, give 2.38, not 3.05."""
    monkeypatch.setattr(quadrature, "SYMMETRIC_DEGREE", 20)
    assert coupled_rates("linear", 3, None, 3, 2, 1.0, 3).last("rho") < THIRD[1]


@pytest.mark.long
@pytest.mark.parametrize("kind", [pytest.param("linear", marks=pytest.mark.ci), "neo-hookean"])
def test_coupled_rates_on_a_disc_are_k_plus_1_and_m_plus_1(kind: str) -> None:
    coupled_rates(kind, 2, None, 2, 1, 0.5, 3, curved=True).require(v=2.7, rho=1.8, z=1.8)


@pytest.mark.long  # each case takes a quarter of a minute
# the exact fields of F and J are unrelated
@pytest.mark.filterwarnings("ignore:.*no longer belong to one distortion")
@pytest.mark.parametrize("kind", FURTHER)
def test_coupled_rates_of_further_materials(kind: str) -> None:
    """Materials by B, by F with Cof F, Yosida approximations, with heat, and bodies have the usual orders."""
    coupled_rates(kind, 2, None, 2, 1, 0.4, 3).require(v=2.7, rho=1.85, z=1.85)


class WithoutTraction(Sources):
    """Sources that lack the traction of the exact fields at a curved wall."""

    def _through_walls(self, u: Fields, w: Fields) -> list[Integrand]:
        return []


class WithoutCreep(Sources):
    """Sources without creep."""

    def _creep_rate(self, mechanism: CreepMechanism) -> CoefficientFunction:
        return 0 * super()._creep_rate(mechanism)


def energy_itself(system: Model, dim: int, tau: float, curved: bool = False) -> Sources:
    """Sources of the energy itself, in place of its Yosida approximation."""
    return Sources(replace(system, material=system.material.material), dim, tau, curved)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*no longer belong to one distortion")
@pytest.mark.parametrize(
    ("kind", "dim", "curved", "wrong", "name"),
    [
        pytest.param("linear", 2, True, WithoutTraction, "v", id="traction", marks=pytest.mark.ci),
        pytest.param("by B", 2, False, WithoutCreep, "z", id="B"),
        pytest.param("cofactors", 2, False, WithoutCreep, "z", id="cofactors"),
        pytest.param("two bodies", 2, False, WithoutCreep, "z", id="bodies"),
        pytest.param("two bodies", 2, False, TakingPartWholly, "z", id="taking part"),
        pytest.param("linear", 3, False, WithoutCreep, "z", id="3D"),
        pytest.param("Yosida", 2, False, energy_itself, "z", id="F"),
        pytest.param("Yosida, quartic", 2, False, energy_itself, "z", id="E"),
    ],
)
def test_wrong_sources_do_not_converge(
    kind: str, dim: int, curved: bool, wrong: Callable[..., Sources], name: str
) -> None:
    """Negative control: the missing part of the sources stays as an error, and the rate falls."""
    maxh, levels = (0.4, 3) if dim == 2 else (1.0, 2)
    table = coupled_rates(kind, dim, None, dim, dim - 1, maxh, levels, curved=curved, sources=wrong)
    assert table.last(name) <= (1.35 if dim == 2 else 1.75), table


# --- in time ----------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.ci
def test_short_steps_converge_where_the_flow_turns_round() -> None:
    """The sign of v.n changes on a facet at t = 0.18."""
    exact = Exact(model("neo-hookean", 2, None), 2, 0.0)
    start = Initial(density=exact.rho, velocity=exact.v, F=exact.values["F"])
    ledger = free_solution("neo-hookean", 128, 0.2, initial=start).ledger
    assert abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("time")[-1] == pytest.approx(0.2)
