"""Topography between rock and light air instead of a free surface.

The first case of Crameri et al. (Geophys. J. Int. 189, 38, 2012): 7 km of topography, a wave of 2800 km, on
100 km of lithosphere and 600 km of mantle relaxes as exp(-0.2139e-11 t/s), to 1/e in 14.8 kyr; the analytic
rate of these layers below a free surface.  Their air has no density; here it has a thousandth of the rock's.

In a cell that the surface cuts the viscosity is the sum of fraction times viscosity: a trace of rock makes
the air of a cell stiff.  On cells of 100 km the surface has slowed down by a third at 5 kyr.
"""

from __future__ import annotations

import math

import numpy as np
from ngsolve import CoefficientFunction, Id, IfPos, Integrate, cos, x, y

import ngvisco as nv
from ngvisco.physics.mixture import Mixture
from tests.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from tests.verification.setups import CLOSURE, DRIFT, closure, drift, fluid, layers

KYR = 3.15576e10
LENGTH, BASE, SURFACE, TOP, HEIGHT = 2.8e6, 6e5, 7e5, 8.5e5, 7e3
"""Of a wave; the lithosphere's lower and upper face; the air's; the topography, m."""
ROCK, AIR, GRAVITY, BULK = 3300.0, 3.3, 10.0, 1e13
VISCOSITIES = {"mantle": 1e21, "lithosphere": 1e23, "air": 1e18}
RATE, AGE = -0.2139e-11, 14.8
"""1/s; the time in which topography falls to 1/e, kyr."""
MAXH, TAU, END = (50e3, 25e3), 1.0, 16.0
"""m; kyr."""
WAVE = 2 * math.pi / LENGTH


def _surface(s: float) -> float:
    return SURFACE + HEIGHT * math.cos(WAVE * s)


def _rest() -> CoefficientFunction:
    """F of hydrostatic rest, J J' = rho_R g/K_e with J = 1 at the top."""
    weight = IfPos(y - SURFACE, AIR * (y - TOP), ROCK * (y - SURFACE) - AIR * (TOP - SURFACE))
    return (1 + 2 * GRAVITY / BULK * weight) ** (1 / 6) * Id(3)


def relaxation(maxh: float) -> nv.Simulation:
    """Half a wave, at its start."""
    body = fluid(BULK)
    bodies = tuple(
        nv.Body(
            name=name,
            where=nv.Subdomain(name[0]),
            material=body,
            viscosity=nv.StokesViscosity(K_v=0.0, G_v=viscosity),
            density=AIR if name == "air" else ROCK,
        )
        for name, viscosity in VISCOSITIES.items()
    )
    return nv.Simulation(
        layers(LENGTH / 2, (lambda s: 0.0, lambda s: BASE, _surface, lambda s: TOP), "mla", maxh),
        nv.Model(bodies=bodies, loads=(nv.Gravity((0.0, -GRAVITY)),)),
        time=nv.TimeSteps(dt=TAU * KYR, scheme="sdirk2", velocity_scale=1e-8),
        initial=nv.Initial(F=_rest()),
        walls={"bottom": nv.NoSlip()},
        newton=nv.NewtonOptions(tolerance=1e-8),  # of 2e10 Pa of pressure rounding leaves 1e-3 Pa
    )


def _height(run: nv.Simulation) -> float:
    """Of the surface's wave, m, from the fraction of air."""
    material = run.model.material
    assert isinstance(material, Mixture)
    air = material.fractions.at(run.rothe_step.now.z_tensors)["air"]
    return -4 / LENGTH * float(Integrate(air * cos(WAVE * x), run.mesh, order=6))


def _relaxation() -> Outcome:
    runs, rows, curves = [], [], []
    for maxh in MAXH:
        run = relaxation(maxh)
        times, heights = [0.0], [_height(run)]
        while times[-1] < END - 1e-9:
            times.append(run.advance()["time"] / KYR)
            heights.append(_height(run))
        runs.append(run)
        logarithms = np.log(np.array(heights) / heights[0])
        age = float(np.interp(1.0, -logarithms, times))
        rate = float(np.polyfit(np.array(times) * KYR, logarithms, 1)[0])
        rows.append([maxh, run.mesh.ne, heights[0], rate, rate / RATE - 1, age, age / AGE - 1])
        curves.append(Curve(f"cells of {maxh / 1e3:g} km", times, heights))
    exact = [HEIGHT * math.exp(RATE * t * KYR) for t in curves[0].x]
    coarse, fine = (abs(float(row[4])) for row in rows)
    return Outcome(
        values={
            "relative error of the rate, cells of 50 km": coarse,
            "relative error of the rate, cells of 25 km": fine,
            "relative error of the time to 1/e, cells of 25 km": abs(float(rows[1][6])),
            "error of the rate on finer cells over that on coarser": fine / coarse,
            "drift of the mass": drift(*runs),
            "largest |closure|": closure(*runs),
        },
        tables=[
            Table(
                "topography",
                ["cells, m", "triangles", "first, m", "rate, 1/s", "its error", "to 1/e, kyr", "its error"],
                rows,
            )
        ],
        plots=[
            Plot(
                "Relaxation of topography",
                "t, kyr",
                "height of the wave, m",
                [*curves, Curve("exp(-0.2139e-11 t/s)", curves[0].x, exact, "k--")],
            )
        ],
        remarks=[
            "The bounds were written after trials until 10 kyr, with mean rates 3.3 % and 2 % too slow."
        ],
    )


CASES = (
    Case(
        name="topography-relaxation",
        theme="Bodies and their interfaces",
        statement="Topography under light air instead of a free surface relaxes at the analytic rate.",
        label="benchmark: Crameri et al. (2012), case 1",
        setting=f"Half a wave of {LENGTH / 1e3:g} km, slip but for the bottom; 100 km of lithosphere, 1e23 "
        f"Pa s, on 600 km of mantle, 1e21 Pa s, {ROCK:g} kg/m3, below 150 km of air, {AIR:g} kg/m3, 1e18 "
        f"Pa s; topography {HEIGHT:g} m; K_e = {BULK:g} Pa, g = {GRAVITY:g} m/s2; cells of 50 and 25 km, "
        f"SDIRK2, tau = {TAU:g} kyr until {END:g} kyr.",
        bounds=(
            Bound("relative error of the rate, cells of 50 km", "<=", 0.06, "7 km are a seventh of a cell"),
            Bound("relative error of the rate, cells of 25 km", "<=", 0.03, "half of that"),
            Bound("relative error of the time to 1/e, cells of 25 km", "<=", 0.03, "half of that"),
            Bound("error of the rate on finer cells over that on coarser", "<=", 0.9, "it falls"),
            DRIFT,
            CLOSURE,
        ),
        run=_relaxation,
    ),
)
