"""Laws whose moduli differ from point to point, with the values of the variables there, in both solvers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import CF, cos, pi, sin, x, y
from test_flow_rules import Cubic
from test_split_derivative import assert_is_the_derivative

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.tensors import square


@dataclass(frozen=True, kw_only=True)
class Stiffening(nv.StokesViscosity):
    """Viscosities that grow where the material is compressed."""

    def moduli(self, z):
        factor = 1.0 / (z["J"] * z["J"] * z["J"])
        return self.K_v * factor, self.G_v * factor


@dataclass(frozen=True, kw_only=True)
class StiffeningHyper(nv.HyperViscosity):
    def moduli(self, z):
        return self.mu / z["J"], self.mu_1 * z["J"]


@dataclass(frozen=True, kw_only=True)
class Softening(nv.FlowRule):
    G_m: float
    nu: float = 0.0

    def rate(self, M, zeta, z):
        return (z["J"] * z["J"] * (1 / self.G_m)) * M

    def psi(self, Pi, z):
        return (0.5 * self.G_m / (z["J"] * z["J"])) * square(Pi)


LAWS = {
    "viscosity": {"viscosity": Stiffening(K_v=0.1, G_v=0.1)},
    "hyperviscosity": {"hyperviscosity": StiffeningHyper(mu=1e-4, mu_1=1e-4)},
    "linear hyperviscosity": {"hyperviscosity": StiffeningHyper(mu=1e-4, mu_1=1e-4, p=2)},
    "creep": {"creep": Softening(G_m=0.5)},
    "creep with a gradient": {"creep": Softening(G_m=0.5, nu=1e-3)},
    "power law": {"creep": Cubic(A=0.1)},
    "power law with a gradient": {"creep": Cubic(A=0.1, nu=1e-3)},
}
UNIFORM = {
    "viscosity": {"viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1)},
    "hyperviscosity": {"hyperviscosity": nv.HyperViscosity(mu=1e-4, mu_1=1e-4)},
    "linear hyperviscosity": {"hyperviscosity": nv.HyperViscosity(mu=1e-4, mu_1=1e-4, p=2)},
    "creep": {"creep": nv.Creep(G_m=0.5)},
    "creep with a gradient": {"creep": nv.Creep(G_m=0.5, nu=1e-3)},
    "power law": {"creep": nv.Creep(G_m=10.0)},
    "power law with a gradient": {"creep": nv.Creep(G_m=10.0, nu=1e-3)},
}


def simulation(solver, k=2, maxh=0.5, **laws):
    """A swirling square whose volume ratio differs from place to place."""
    settings = {"hyperviscosity": nv.HyperViscosity(mu=1e-5)}
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"), **(settings | laws)
    )
    F = CF((1 + 0.3 * sin(3 * x), 0, 0, 0, 1 + 0.2 * y, 0, 0, 0, 1), dims=(3, 3))
    velocity = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
    initial = nv.Initial(velocity=velocity, F=F)
    discretisation = nv.Discretisation(k=k)
    return nv.Simulation(
        box((1, 1), maxh), model, dt=0.02, initial=initial, solver=solver, discretisation=discretisation
    )


def states(run):
    state, ranges = run.rothe_step.state.vec.FV().NumPy(), run.rothe_step.layout.ranges
    return {name: state[ranges[name]].copy() for name in ("v", "rho", "z")}


@pytest.mark.parametrize(
    ("name", "k"),
    [*((name, 2) for name in LAWS), ("hyperviscosity", 3), ("power law with a gradient", 3)],
)
def test_both_solvers_have_the_point_s_moduli(name, k):
    found, ledgers = [], []
    for solver in ("split", "coupled"):
        run = simulation(solver, k, **LAWS[name])
        ledgers.append(run.run(0.04))
        found.append(states(run))
    for field, values in found[0].items():
        assert np.abs(values - found[1][field]).max() <= 1e-9 * np.abs(values).max()
    for ledger in ledgers:
        assert np.abs(ledger.column("closure_relative")).max() <= 1e-12
    uniform = simulation("split", k, **UNIFORM[name])
    uniform.run(0.04)
    assert np.abs(states(uniform)["v"] - found[0]["v"]).max() > 1e-4 * np.abs(found[0]["v"]).max()


@pytest.mark.parametrize("name", LAWS)
def test_the_derivative_follows_the_moduli(name):
    run = simulation("split", maxh=0.35, **LAWS[name])
    assert_is_the_derivative(run)
