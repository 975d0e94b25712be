"""Stresses at rest that open walls do not bear: a warning before the first step names their sizes."""

import math
import re

import pytest
from ngsolve import CF, Id
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian

K, G, EPSILON = 10.0, 5.0, 0.1
AT_REST = 3 * G + EPSILON**2 / (2 * K)
"""Stress of the paper's neo-Hookean material at rest, Pa: 15.0005."""
PAPER = {state: nv.NeoHookean(K_e=K, G_e=G, epsilon=EPSILON, elastic_state=state) for state in "FB"}
FREE = {state: nv.ReferentialNeoHookean(K_e=K, G_e=G, elastic_state=state) for state in "FB"}
GAS = nv.BarotropicFluid(B=1.0, gamma=2.0, rho_R=1.0)  # 1 Pa at rest


def fluid(at_rest):
    """A fluid with the stress ``at_rest`` at rest, Pa."""
    energy = lambda J: 5 * (J - 1) * (J - 1) / J + at_rest  # noqa: E731
    return nv.CustomMaterial(transported=(Jacobian(),), stored_energy=energy)


def between(material, F=None, bodies=None, **wall):
    """A bar between open walls at its start."""
    model = nv.Model(material=material) if bodies is None else nv.Model(bodies=bodies)
    initial = nv.Initial(F=F) if bodies or F is None else nv.Initial(F=F, density=1.0)
    walls = {("left", "right"): nv.Open(backflow=False, **wall)}
    return nv.Simulation(structured_box((1, 0.5), (2, 2)), model, dt=0.05, walls=walls, initial=initial)


def differences(warned):
    """T(I), the given stress and their difference, Pa, at each wall that a warning names."""
    numbers = r"at '(\w+)' T\(I\) is (\S+) Pa, the given stress (\S+) Pa, the difference ([\d.e+-]+) Pa"
    matches = [match for warning in warned for match in re.findall(numbers, str(warning.message))]
    return {name: tuple(map(float, values)) for name, *values in matches}


@pytest.mark.parametrize("state", "FB")
def test_an_unbalanced_stress_at_rest_is_warned_of_before_the_first_step(state):
    """With the difference of stresses that the warning reports, a bar starts to move at metres a second. With
    the pressure that the warning recommends, the bar stays."""
    for pull in (0.0, 1.0):
        with pytest.warns(nv.InputWarning, match="pressure of -T") as warned:
            run = between(PAPER[state], pressure=-pull)
        by_wall = differences(warned)
        assert by_wall.keys() == {"left", "right"}
        for stresses in by_wall.values():
            assert stresses == pytest.approx((AT_REST, pull, AT_REST - pull), rel=5e-3, abs=1e-9)
    assert run.advance()["v_max"] > 1.0
    borne = between(PAPER[state], pressure=-by_wall["left"][0])
    assert borne.advance()["v_max"] < 1e-3


@pytest.mark.parametrize("state", "FB")
def test_balanced_walls_and_materials_without_stress_at_rest_bring_no_warning(state, recwarn):
    between(PAPER[state], pressure=-AT_REST)
    between(PAPER[state], pressure=-AT_REST * 1.009)
    for wall in ({}, {"pressure": -1.0}, {"traction": (1.0, 0.0)}, {"stiffness": (1.0, 1.0)}):
        between(FREE[state], **wall)
    stiff = nv.NeoHookean(K_e=100.0, G_e=G, epsilon=EPSILON, elastic_state=state)

    def stress(J):  # the mean stress (J phi)' at F = J^(1/3) I
        x = J - 1 + EPSILON / 100
        return 50 * x * x + 3 * G - EPSILON * math.log(J) + J * (100 * x - EPSILON / J)

    between(stiff, F=brentq(stress, 0.67, 0.9) ** (1 / 3) * Id(3))  # the state without stress is not F = I
    assert not recwarn.list


@pytest.mark.parametrize("resists", ["impedance", "stiffness"])
def test_dashpots_and_springs_count_in_the_balance_at_the_start(resists, recwarn):
    """Dashpots at 0.1 m/s, and springs at 0.1 m, bear 2 Pa. The pressures of the walls are 2 Pa too large on
    the left and 2 Pa too small on the right."""
    walls = {
        name: nv.Open(pressure=-AT_REST - load, backflow=False, **{resists: (20.0, 0.0)})
        for name, load in (("left", -2.0), ("right", 2.0))
    }
    moved = CF((0.1, 0.0))
    at_start = {f"displacement_{name}": moved for name in walls} if resists == "stiffness" else {}
    velocity = moved if resists == "impedance" else None
    initial = nv.Initial(density=1.0, velocity=velocity, values=at_start)
    mesh, model = structured_box((1, 0.5), (2, 2)), nv.Model(material=PAPER["B"])
    nv.Simulation(mesh, model, dt=0.05, walls=walls, initial=initial)
    assert not recwarn.list


def test_a_difference_above_one_per_cent_of_the_stress_at_rest_is_warned_of():
    with pytest.warns(nv.InputWarning, match="stress of the matter at rest"):
        between(PAPER["B"], pressure=-AT_REST * 1.011)


def test_a_gas_beside_an_open_wall_without_pressure_is_warned_of(recwarn):
    between(GAS, pressure=1.5)  # gas enters at 0.5 Pa above its pressure at rest
    between(GAS, pressure=0.5)
    assert not recwarn.list
    with pytest.warns(nv.InputWarning) as warned:
        between(GAS)
    assert differences(warned)["left"] == pytest.approx((-1.0, 0.0, 1.0), rel=1e-5)


@pytest.mark.parametrize("place", ["at the walls", "inside"])
def test_the_stress_at_rest_is_that_of_the_body_beside_the_wall(place, recwarn):
    """The mean stress at the wall is computed in the body's half of the wall only. A medium that bears the
    load of the wall causes no warning."""
    where = nv.Block((0.0, 0.0), (1.0, 0.25)) if place == "at the walls" else nv.Ball((0.5, 0.25), 0.1)
    bodies = [
        nv.Body(name="body", material=fluid(15.0), where=where, density=1.0),
        nv.Body(name="medium", material=fluid(0.0), density=1.0),
    ]
    between(None, bodies=bodies, pressure=0.5)
    by_wall = differences(recwarn.list)
    if place == "inside":
        assert not by_wall
    else:  # on the body's half the difference is 15.5 Pa, on the medium's 0.5 Pa
        assert by_wall.keys() == {"left", "right"}
        assert by_wall["right"] == pytest.approx((7.5, -0.5, ((15.5**2 + 0.5**2) / 2) ** 0.5), rel=5e-3)
