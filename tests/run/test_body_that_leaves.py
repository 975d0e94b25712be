"""A stressed body leaves through an open wall at its own speed; the order of three bodies in one cell does
not change the result."""

from typing import Any

import numpy as np
import pytest
from ngsolve import CF, IfPos, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian

_FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 5 * (J - 1) * (J - 1) / J)


_SHARP = {"k": 2, "m": 1, "sharp": True}
_Q = float(max(np.roots([1.0, 0.0, -0.36, -1.0]).real))
"""q with q (q + 0.6) (q - 0.6) = 1."""


def _solid(shear: float) -> nv.Material:
    return nv.ReferentialNeoHookean(K_e=10.0, G_e=shear)


def _leaving(J: float, right: nv.Open) -> tuple[nv.Simulation, nv.Bodies]:
    """A block of 0.4 m x 0.2 m, stretched across its way and ten times as dense as the air, in translation at
    1 m/s.  With these stretches, whose product is J, the block has the air's stress along its way, 10 (J - 1)
    Pa, so that v stays constant."""
    inside = (x - 0.4) * (0.8 - x)
    stretches = [J ** (1 / 3) * IfPos(inside, s**0.5, 1.0) for s in (_Q, _Q + 0.6, _Q - 0.6)]
    F = CF((stretches[0], 0, 0, 0, stretches[1], 0, 0, 0, stretches[2]), dims=(3, 3))
    bodies = (
        nv.Body(name="block", where=inside, material=_solid(1.0), density=10.0),
        nv.Body(name="air", material=_FLUID, density=1.0),
    )
    table = nv.Bodies()
    run = nv.Simulation(
        structured_box((1, 0.2), (10, 2)),
        nv.Model(bodies=bodies),
        time=nv.TimeSteps(dt=0.04, scheme="midpoint", velocity_scale=1.0),
        initial=nv.Initial(velocity=(1.0, 0.0), F=F),
        walls={"left": nv.Inflow(velocity=(1.0, 0.0)), "right": right},
        discretisation=nv.Discretisation(k=1, m=0),
        observers=[table],
    )
    return run, table


@pytest.mark.filterwarnings("ignore::ngvisco.SmearedWarning")
def test_a_stressed_dense_block_leaves_through_an_open_wall_at_its_speed() -> None:
    run, table = _leaving(1.0, nv.Open())
    assert abs(run.fields["cauchy_stress"](run.mesh(0.6, 0.1))[4] - 1.2) < 1e-9
    run.run(0.8)
    column, mass = run.ledger.column, table.column("block_mass")
    assert 0.0 < mass[-1] < 0.05 * mass[0]  # without smearing no mass would be left
    assert abs(mass[10] / mass[0] - 0.5) < 0.02
    assert abs(column("v_max") - 1).max() < 1e-8
    assert abs(column("kinetic") - column("mass") / 2).max() < 1e-8 * column("kinetic")[0]
    assert abs(column("closure_relative")).max() < 1e-9


@pytest.mark.filterwarnings("ignore::ngvisco.SmearedWarning")
def test_the_entries_of_an_open_wall_have_their_closed_forms_while_a_compressed_block_leaves() -> None:
    """In 0.8 s, 0.08 m^2 of the block and as much air leave; without smearing, none of the block is left.
    The energies per volume at rest are 5 (J - 1)^2 and, in the block, also tr B = 3 q."""
    J, A = 0.95, 0.2
    p, U = 10 * (1 - J), 5 * (J - 1) ** 2
    run, table = _leaving(J, nv.Open(pressure=p))
    run.run(0.8)

    def of(name: str) -> np.ndarray:
        return run.ledger.column(name)[1:]

    for name, value in (
        ("power_traction_right", -p * A),
        ("power_wall_left", p * A),
        ("inflow_left", A / J),
        ("power_kinetic_left", A / J / 2),
        ("power_stored_left", A * U / J),
    ):
        assert abs(of(name) / value - 1).max() < 1e-7, name
    assert abs(of("power_kinetic_right") / of("inflow_right") - 0.5).max() < 1e-8
    left = table.column("block_mass")[-1] / table.column("block_mass")[0]
    assert 0.0 < left < 0.05
    kinetic, stored = (float(0.04 * of(f"power_{kind}_right").sum()) for kind in ("kinetic", "stored"))
    # air takes the place of the part of the block that is left
    assert kinetic == pytest.approx(-(0.8 * (1 - left) + 0.08 * (1 + left)) / J / 2, rel=1e-7)
    assert stored == pytest.approx(-(0.08 * 3 * _Q * (1 - left) + 0.16 * U) / J, rel=1e-7)


def _in_front_of_the_wall(length: float) -> tuple[float, float]:
    """Mass of a block within 1 m of a channel of this length when the block's rear face is at 1.1 m, over the
    block's mass, and the least density until then."""
    bodies = (
        nv.Body(name="block", where=(x - 0.4) * (0.8 - x), material=_solid(1.0), density=2.0),
        nv.Body(name="air", material=_FLUID, density=1.0),
    )
    run = nv.Simulation(
        structured_box((length, 0.1), (round(10 * length), 1)),
        nv.Model(bodies=bodies),
        time=nv.TimeSteps(dt=0.025, scheme="midpoint", velocity_scale=1.0),
        initial=nv.Initial(velocity=(1.0, 0.0)),
        walls={"left": nv.Inflow(velocity=(1.0, 0.0)), "right": nv.Open()},
        discretisation=nv.Discretisation(k=2, m=1),
    )
    amount = run.rothe_step.now.z_tensors["n_block"] * IfPos(1 - x, 1.0, 0.0)
    whole = run.rothe_step.quadrature.integrate_cells(amount)
    run.run(0.7)
    assert abs(run.ledger.column("v_max") - 1).max() < 1e-6
    return run.rothe_step.quadrature.integrate_cells(amount) / whole, run.ledger.column("rho_min").min()


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.filterwarnings("ignore::ngvisco.SmearedWarning")
def test_negative_mass_behind_a_body_that_has_left_is_a_ripple_of_transport_and_not_of_the_wall() -> None:
    """With m = 1, means of fractions become negative behind a moving jump; the density stays positive."""
    (left, least), (beyond, _) = _in_front_of_the_wall(1.0), _in_front_of_the_wall(1.2)
    assert -0.02 < left < -0.004
    assert abs(beyond - left) < 1e-4
    assert 0.0 < least <= 1.0


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize(
    ("densities", "options", "off"), [((2, 1, 0.1), {}, 1e-7), ((1, 1, 1), _SHARP, 1e-6)]
)
def test_a_run_does_not_depend_on_the_order_of_three_bodies_in_a_cell(
    densities: tuple[float, ...], options: dict[str, Any], off: float
) -> None:
    """``off`` is relative to the disc's displacement."""
    ball = 0.04 - (x - 0.5) * (x - 0.5) - (y - 0.5) * (y - 0.5)
    viscous = nv.StokesViscosity(K_v=0.05, G_v=0.05)
    bodies = {
        "disc": nv.Body(
            name="disc",
            where=nv.Ball((0.5, 0.5), 0.2),
            material=_solid(1.0),
            viscosity=viscous,
            density=densities[0],
        ),
        "layer": nv.Body(
            name="layer", where=0.3 - y, material=_solid(3.0), viscosity=viscous, density=densities[1]
        ),
        "medium": nv.Body(name="medium", material=_FLUID, viscosity=viscous, density=densities[2]),
    }
    rows = []
    for order in (list(bodies), list(bodies)[::-1]):
        run = nv.Simulation(
            structured_box((1, 1), (5, 5)),
            nv.Model(
                bodies=[bodies[name] for name in order],
                loads=[nv.BodyForce((IfPos(ball, 0.2, 0.0), IfPos(ball, -1.0, 0.0)))],
            ),
            time=nv.TimeSteps(dt=0.1, velocity_scale=0.3),
            walls={"bottom": nv.NoSlip()},
            discretisation=nv.Discretisation(**{"k": 1, "m": 0} | options),
            observers=[table := nv.Bodies()],
        )
        run.run(0.3)
        names = [f"{name}_{what}" for name in bodies for what in ("x", "y", "mass")]
        rows.append(np.array([table.column(name) for name in names]))
    moved = abs(rows[0][1, -1] - rows[0][1, 0])
    assert moved > 1e-3
    assert abs(rows[0] - rows[1]).max() < off * moved
    assert all(abs(masses / masses[0] - 1).max() < 1e-12 for masses in rows[0][2::3])
