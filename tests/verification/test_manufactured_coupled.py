"""The whole system with creep, gravity and viscosity, without and with hyperviscosity."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh import quadrature
from ngvisco.forms.term import Integrand
from ngvisco.physics.flows import Flow
from ngvisco.physics.model import Model
from tests.verification.convergence import coupled_rates
from tests.verification.models import FURTHER, KINDS
from tests.verification.sources import Sources, TakingPartWholly


@pytest.mark.parametrize("kind", ["neo-hookean", pytest.param("linear", marks=pytest.mark.long)])
def test_coupled_rates_without_hyperviscosity_are_k_plus_1_and_m_plus_1(kind: str) -> None:
    coupled_rates(kind, 2, None, 2, 1, 0.4, 3).require(v=2.7, rho=1.85, z=1.85)


@pytest.mark.long
@pytest.mark.parametrize("kind", [pytest.param("linear", marks=pytest.mark.ci), "neo-hookean"])
def test_coupled_rates_with_hyperviscosity_are_2_for_k_2(kind: str) -> None:
    coupled_rates(kind, 2, 4.0, 2, 1, 0.4, 3).require(v=1.7, rho=1.75, z=1.75)


@pytest.mark.long  # half a minute to two minutes each
@pytest.mark.parametrize(
    ("p", "k", "m", "least"),
    [
        pytest.param(2.0, 2, 1, {"v": 1.7, "rho": 1.75, "z": 1.75}, marks=pytest.mark.ci),
        (None, 3, 2, {"v": 3.5, "rho": 2.7, "z": 2.7}),
        (2.0, 3, 2, {"v": 3.4, "rho": 2.7, "z": 2.7}),
        (4.0, 3, 2, {"v": 2.9, "rho": 2.35, "z": 2.5}),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_coupled_rates_of_higher_order(
    kind: str, p: float | None, k: int, m: int, least: dict[str, float]
) -> None:
    coupled_rates(kind, 2, p, k, m, 0.4, 3).require(**least)


@pytest.mark.long  # two to ten minutes each
@pytest.mark.parametrize(
    ("p", "least"),
    [
        pytest.param(None, {"v": 2.7, "rho": 2.2, "z": 1.8}, marks=pytest.mark.ci),
        (4.0, {"v": 1.65, "rho": 2.0, "z": 1.85}),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_coupled_rates_in_3d_on_small_meshes(kind: str, p: float | None, least: dict[str, float]) -> None:
    coupled_rates(kind, 3, p, 2, 1, 1.0, 2).require(**least)


ORDER_3 = {"v": 2.5, "rho": 2.5, "z": 2.5}
"""Upwind transport with m = 2 has m + 1/2 on any mesh, and v, by its stress, no less."""


@pytest.mark.long  # minutes each
@pytest.mark.parametrize("kind", KINDS)
def test_coupled_rates_in_3d_of_order_3(kind: str) -> None:
    """To 768 tetrahedra."""
    coupled_rates(kind, 3, None, 3, 2, 1.0, 3).require(**ORDER_3)


@pytest.mark.long
def test_faces_whose_sides_see_different_points_lose_the_rates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: NGSolve's own rules of triangles, which have no symmetry; 2.38 instead of 3.05."""
    monkeypatch.setattr(quadrature, "SYMMETRIC_DEGREE", 20)
    assert coupled_rates("linear", 3, None, 3, 2, 1.0, 3).last("rho") < ORDER_3["rho"]


@pytest.mark.long
@pytest.mark.parametrize("kind", [pytest.param("linear", marks=pytest.mark.ci), "neo-hookean"])
def test_coupled_rates_on_a_disc_are_k_plus_1_and_m_plus_1(kind: str) -> None:
    coupled_rates(kind, 2, None, 2, 1, 0.5, 3, curved=True).require(v=2.7, rho=1.85, z=1.85)


@pytest.mark.long  # a quarter of a minute each
@pytest.mark.filterwarnings("ignore:.*no longer belong to one distortion")  # exact fields are unrelated
@pytest.mark.parametrize("kind", FURTHER)
def test_coupled_rates_of_further_materials(kind: str) -> None:
    """By B, of F and Cof F at once, of Yosida approximations, with heat, of bodies; orders as of others."""
    coupled_rates(kind, 2, None, 2, 1, 0.4, 3).require(v=2.7, rho=1.85, z=1.85)


class WithoutTraction(Sources):
    """What exact fields do at a curved wall is left out."""

    def _through_walls(self, u: Fields, w: Fields) -> list[Integrand]:
        return []


class WithoutCreep(Sources):
    """Nothing creeps."""

    def _creep_rate(self, flow: Flow) -> CoefficientFunction:
        return 0 * super()._creep_rate(flow)


def energy_itself(system: Model, dim: int, tau: float, curved: bool = False) -> Sources:
    """In place of its Yosida approximation."""
    return Sources(replace(system, material=system.material.material), dim, tau, curved)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*no longer belong to one distortion")
@pytest.mark.parametrize(
    ("kind", "dim", "k", "curved", "wrong", "name"),
    [
        pytest.param("linear", 2, 2, True, WithoutTraction, "v", id="traction", marks=pytest.mark.ci),
        pytest.param("by B", 2, 2, False, WithoutCreep, "z", id="B"),
        pytest.param("cofactors", 2, 2, False, WithoutCreep, "z", id="cofactors"),
        pytest.param("two bodies", 2, 2, False, WithoutCreep, "z", id="bodies", marks=pytest.mark.ci),
        pytest.param("two bodies", 2, 2, False, TakingPartWholly, "z", id="taking part"),
        pytest.param("linear", 3, 3, False, WithoutCreep, "z", id="3D"),
        pytest.param("Yosida", 2, 2, False, energy_itself, "z", id="F"),
        pytest.param("Yosida, quartic", 2, 2, False, energy_itself, "z", id="E"),
    ],
)
def test_wrong_sources_do_not_converge(
    kind: str, dim: int, k: int, curved: bool, wrong: Callable[..., Sources], name: str
) -> None:
    """Negative control: what the sources leave out stays, and the rate falls below what is asked for."""
    levels, maxh = (3, 0.4) if dim == 2 else (2, 1.0)
    table = coupled_rates(kind, dim, None, k, k - 1, maxh, levels, curved=curved, sources=wrong)
    assert table.last(name) <= (1.35 if dim == 2 else 1.75), table
