"""Channel flow of fluids whose viscosity depends on the shear rate or the temperature, against quadrature.

Between resting walls at y = 0 and 1 a force f along x makes the shear stress tau = f (c - y).  The shear rate
solves G_v(rate) rate = tau, and v is its integral, with c such that v(1) = 0.  The formulas are written here.
P2 interpolates v within h^3/(72 sqrt 3) max |v'''|, less than 1 per cent of max v for h = 1/4; the tests
allow 2 per cent.
"""

import numpy as np
import pytest
from ngsolve import y
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.geometries import box

FORCE, BOUND = 1.0, 0.02
LAWS = {
    "power law": (nv.PowerLaw(K_v=0.1, consistency=0.5, n=0.5, floor=1e-4), lambda rate, y: 0.5 * rate**-0.5),
    "thickening": (nv.PowerLaw(K_v=0.1, consistency=0.5, n=1.5), lambda rate, y: 0.5 * rate**0.5),
    "Carreau": (
        nv.Carreau(K_v=0.1, G_0=1.0, G_inf=0.1, relaxation=5.0, n=0.4),
        lambda rate, y: 0.1 + 0.9 * (1 + 25 * rate**2) ** -0.3,
    ),
    "Cross": (
        nv.Cross(K_v=0.1, G_0=1.0, G_inf=0.1, relaxation=5.0, m=0.9),
        lambda rate, y: 0.1 + 0.9 / (1 + (5 * rate) ** 0.9),
    ),
    "Arrhenius": (
        nv.ActivatedViscosity(
            viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.5),
            E=2e4,
            theta_R=300.0,
            temperature=300.0 + 60.0 * nv.Parameter("hot", start=y),
        ),
        lambda rate, y: 0.5 * np.exp(2e4 / 8.31446261815324 * (1 / (300 + 60 * y) - 1 / 300)),
    ),
}
DEFAULT = {"power law"}


def exact(G_v, at):
    """The exact v at the places ``at``, by the trapezoidal rule on 2000 intervals."""
    ys = np.linspace(0, 1, 2001)

    def rates(c):
        tau = FORCE * (c - ys)
        low, high = np.full_like(ys, 1e-20), np.full_like(ys, 1e4)
        for _ in range(100):
            middle = np.sqrt(low * high)
            above = G_v(middle, ys) * middle > abs(tau)
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return np.sign(tau) * low

    c = brentq(lambda c: np.trapezoid(rates(c), ys), 0.2, 0.8, xtol=1e-8)
    slope = rates(c)
    v = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(ys))])
    return np.interp(at, ys, v)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in DEFAULT else pytest.mark.long) for n in LAWS]
)
def test_the_velocity_profile_in_a_channel_follows_the_viscosity_law(name):
    law, G_v = LAWS[name]
    fluid = nv.BarotropicFluid.from_state_equation(a=10.0, gamma=1.4, rho_R=1.0)
    model = nv.Model(material=fluid, viscosity=law, loads=(nv.BodyForce((FORCE, 0.0)),))
    walls = {"bottom": nv.NoSlip(), "top": nv.NoSlip()}
    start = {"initial": nv.Initial(density=1.0), "walls": walls, "solver": "coupled"}
    run = nv.Simulation(box((0.5, 1.0), maxh=0.25, periodic="x"), model, dt=100.0, **start)
    run.run(400.0)
    at = np.linspace(0.05, 0.95, 10)
    found = np.array([run.fields["velocity"](run.mesh(0.25, s))[0] for s in at])
    expected = exact(G_v, at)
    error = abs(found - expected).max() / expected.max()
    assert error <= BOUND
    # a viscosity larger by a tenth gives another profile
    assert abs(found - exact(lambda r, y: 1.1 * G_v(r, y), at)).max() / expected.max() > 2 * BOUND
    assert abs(run.ledger.column("closure_relative")).max() <= 1e-10
