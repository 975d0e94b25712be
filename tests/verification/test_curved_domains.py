"""Rates on curved domains with slip, of solutions in time: decaying rotations of a disc and of a ball.

v = c(t) f(r)/r (-y, x[, 0]) is divergence-free and tangential to circles about the axis.  With f the Bessel
function J_1(k r), J_2(k R) = 0 (disc), or the spherical one j_1(k r), j_2(k R) = 0 (ball), div(2 eps(v)) is
-k^2 v and the wall r = R has no tangential stress.  At small amplitude the linearised model is linear, and
its implicit Euler steps keep the shape f: with E = e(t) eps(f), viscosity G_v and creep,

    rho (c - c_old)/tau = -k^2 (G_v c + G_e e),   (e - e_old)/tau = c - 2 G_e/G_m e.

What a run differs by is then the error in space alone.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from manufactured import RateTable
from ngsolve import CF, CoefficientFunction, Mesh, x, y, z
from problems import distance
from scipy.special import jv, spherical_jn

from ngvisco import Creep, Initial, LinearElastic, Model, Simulation, StokesViscosity
from ngvisco.geometries import disc
from ngvisco.physics.tensors import embed_gradient

RHO, G_E, G_V, G_M, TAU, STEPS = 1.3, 0.4, 0.05, 0.6, 0.05, 4
AMPLITUDE = 1e-6
"""m/s: the terms of second order are about 1e-6 of those of first order."""

ROOTS = {2: 5.135622301840683, 3: 5.763459196894550}  # first zeros of J_2 and of j_2


def shape(s: CoefficientFunction, dim: int) -> CoefficientFunction:
    """f(r)/r, 1 at r = 0, as a series in s = (k r)^2: sum_n (-s/2)^n / (n! (d+2)(d+4)...(d+2n))."""
    total, factor = CF(1.0), CF(1.0)
    for n in range(1, 25):
        factor = factor * s * (-0.5 / (n * (dim + 2 * n)))
        total = total + factor
    return total


def rotation(dim: int) -> CoefficientFunction:
    """The velocity of unit angular velocity at the centre."""
    k = ROOTS[dim]
    X = (x, y, z)[:dim]
    w = shape(k * k * sum(s * s for s in X), dim)
    return CF((-y * w, x * w, 0 * x)[:dim])


def factors() -> dict[int, tuple[float, float]]:
    """c and e after the steps, by the two equations, for both dimensions."""
    result = {}
    for dim, k in ROOTS.items():
        relaxation = 1 + TAU * 2 * G_E / G_M
        c, e = AMPLITUDE, 0.0
        for _ in range(STEPS):
            # e = (e_old + tau c)/relaxation put into the momentum equation
            c = (RHO * c / TAU - k**2 * G_E * e / relaxation) / (
                RHO / TAU + k**2 * (G_V + G_E * TAU / relaxation)
            )
            e = (e + TAU * c) / relaxation
        result[dim] = (c, e)
    return result


def test_the_shapes_are_bessel_functions_without_stress_at_the_wall() -> None:
    """Against scipy, and d(f/r)/dr = 0 at the wall by differences."""
    r = np.linspace(0.05, 1, 7)
    mesh = disc(1, 0.5)
    for dim, exact in ((2, lambda s: 2 * jv(1, s) / s), (3, lambda s: 3 * spherical_jn(1, s) / s)):
        k = ROOTS[dim]
        series = shape(k * k * x * x, dim)
        assert np.allclose([series(mesh(s * 0.99, 0)) for s in r], exact(k * 0.99 * r), rtol=1e-11)
        assert abs(exact(k * 1.001) - exact(k * 0.999)) < 1e-6 * abs(exact(k))


def decay_rates(dim: int, meshes: Iterable[Mesh]) -> RateTable:
    """Relative errors of v and of E after the steps."""
    model = Model(
        material=LinearElastic(K_e=2.0, G_e=G_E),
        viscosity=StokesViscosity(K_v=0.1, G_v=G_V),
        creep=Creep(G_m=G_M),
    )
    c, e = factors()[dim]
    f = rotation(dim)
    L = CF(tuple(f[i].Diff(s) for i in range(dim) for s in (x, y, z)[:dim]), dims=(dim, dim))
    E = embed_gradient(0.5 * (L + L.trans), dim)
    table = RateTable(f"decaying rotation, slip at a curved wall, {dim}D")
    for mesh in meshes:
        run = Simulation(mesh, model, dt=TAU, initial=Initial(density=RHO, velocity=AMPLITUDE * f))
        ledger = run.run(STEPS * TAU)
        assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
        assert np.abs(ledger.column("mass_drift")).max() <= 1e-12
        errors = {
            "v": distance(run.fields["velocity"], c * f, mesh) / distance(0 * f, c * f, mesh),
            "E": distance(run.fields["E"], e * E, mesh) / distance(0 * E, e * E, mesh),
        }
        table.add(mesh.ne ** (-1 / dim), **errors)
        print(table)
    return table


def test_rates_on_a_disc_with_slip() -> None:
    decay_rates(2, (disc(1, maxh) for maxh in (0.5, 0.25, 0.125))).require(v=2.6, E=1.8)
