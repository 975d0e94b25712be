"""Laws whose moduli depend on the state at a point, in both solvers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import CF, sin, x, y
from support import SWIRL, by_both_solvers, evolved, swirling
from test_flow_rules import Cubic
from test_split_derivative import assert_is_the_derivative

import ngvisco as nv
from ngvisco.physics.tensors import square


@dataclass(frozen=True, kw_only=True)
class Stiffening(nv.StokesViscosity):
    """Viscosities that grow where the material is compressed."""

    def moduli(self, s, z):
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
LATER = ("creep", "linear hyperviscosity", "power law with a gradient")
"""Laws for which only CI compares solutions. The default suite compares the derivatives of all laws."""
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
    F = CF((1 + 0.3 * sin(3 * x), 0, 0, 0, 1 + 0.2 * y, 0, 0, 0, 1), dims=(3, 3))
    return swirling(
        maxh,
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        initial=nv.Initial(velocity=SWIRL, F=F),
        solver=solver,
        discretisation=nv.Discretisation(k=k),
        **({"hyperviscosity": nv.HyperViscosity(mu=1e-5)} | laws),
    )


@pytest.mark.parametrize(
    ("name", "k"),
    [
        *((name, 2) for name in LAWS if name not in LATER),
        *(
            pytest.param(name, k, marks=(pytest.mark.long, pytest.mark.ci))
            for name, k in (*((name, 2) for name in LATER), *((name, 3) for name in LATER))
        ),
    ],
)
def test_both_solvers_use_the_moduli_at_each_point(name, k):
    runs = by_both_solvers(lambda solver: simulation(solver, k, **LAWS[name]), 0.02)
    uniform = simulation("coupled", k, **UNIFORM[name])
    uniform.run(0.02)
    v, found = evolved(uniform)["v"], evolved(runs[0])["v"]
    assert np.abs(v - found).max() > 1e-4 * np.abs(found).max()


@pytest.mark.parametrize("name", LAWS)
def test_the_derivative_contains_the_moduli_at_each_point(name):
    assert_is_the_derivative(simulation("split", **LAWS[name]))
