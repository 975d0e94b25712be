"""Flow rules and state-dependent viscosities with both solvers, of one material and of bodies."""

from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import CF, x
from scipy.optimize import root

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.physics.parameters import Parameter
from ngvisco.physics.tensors import power_of_square, square

MATERIAL = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, elastic_state="F")
BY_B = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, elastic_state="B")
F_0 = np.diag([1.3, 0.9, 1.1])


@dataclass(frozen=True, kw_only=True)
class Cubic(nv.FlowRule):
    """A user's rule Pi = A |M|^2 M."""

    A: float
    nu: float = 0.0

    def rate(self, M, zeta, z):
        return self.A * square(M) * M

    def psi(self, Pi, z):
        return 0.75 * self.A ** (-1 / 3) * power_of_square(square(Pi), 2 / 3, self.rate_floor)


def stretched(rule, solver, bodies):
    """A homogeneous box at rest whose shape cannot change: only the elastic strain changes."""
    initial = nv.Initial(F=CF(tuple(F_0.ravel()), dims=(3, 3)))
    viscosity = nv.StokesViscosity(K_v=1.0, G_v=1.0)
    if bodies:
        left, right = (
            nv.Body(name=name, where=where, material=BY_B, viscosity=viscosity, creep=rule, density=1.0)
            for name, where in (("left", 0.5 - x), ("right", None))
        )
        model = nv.Model(bodies=[left, right])
    else:
        model = nv.Model(material=MATERIAL, viscosity=viscosity, creep=rule)
    mesh = structured_box((1, 1), (2, 1))  # bodies meet between cells
    return nv.Simulation(mesh, model, dt=0.02, initial=initial, solver=solver)


def implicit_steps(rate, lengths, by_B):
    """H or H H^T, diagonals, after steps of backward Euler for H' = -H Pi, with M = dev(2 G_e H^T H)."""
    H = np.diag(F_0) * np.linalg.det(F_0) ** (-5 / 6)

    def defect(new, old, tau):
        M = 2 * MATERIAL.G_e * new * new
        return new - old + tau * new * rate(M - M.mean())

    def defect_by_B(new, old, tau):
        M = 2 * MATERIAL.G_e * new
        return new - old + 2 * tau * new * rate(M - M.mean())

    if by_B:
        H = H * H
    for tau in lengths:
        H = root(defect_by_B if by_B else defect, H, args=(H, tau), tol=1e-13).x
    return H


@pytest.mark.parametrize("solver", ["split", "coupled"])
@pytest.mark.parametrize(("nu", "bodies"), [(0.0, False), (0.1, False), (0.0, True)])
def test_a_user_s_flow_rule_follows_its_differential_equation(nu, bodies, solver):
    """The body is homogeneous, so that its steps are those of an ordinary differential equation."""
    run = stretched(Cubic(A=0.02, nu=nu), solver, bodies)
    ledger = run.run(0.04)
    names = ("B_left", "B_right") if bodies else ("H",)
    found = sum(np.diag(np.array(run.fields[name](run.mesh(0.3, 0.4))).reshape(3, 3)) for name in names)
    expected = implicit_steps(lambda M: 0.02 * (M @ M) * M, np.diff(ledger.column("time")), bodies)
    # the trace that every cell has of every body enlarges a body's share of a point by TRACE^2
    assert np.abs(found - expected).max() <= (1e-5 if bodies else 1e-8)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("dissipation_creep")[1:].min() > 0


PLAIN = nv.StokesViscosity(K_v=0.1, G_v=0.1)
LAWS = {
    "power law": nv.PowerLaw(K_v=0.1, consistency=0.1, n=0.3, floor=1e-3),
    "thickening": nv.PowerLaw(K_v=0.1, consistency=0.1, n=2.0),
    "Carreau": nv.Carreau(K_v=0.1, G_0=0.5, relaxation=3.0, n=0.3),
    "Cross": nv.Cross(K_v=0.1, G_0=0.5, relaxation=3.0, m=0.9),
    "of the temperature": nv.ActivatedViscosity(viscosity=PLAIN, E=2e4, theta_R=300.0),
    "of a carried temperature": nv.ActivatedViscosity(
        viscosity=PLAIN, E=2e4, theta_R=300.0, temperature=300.0 + 50.0 * Parameter("hot", start=x)
    ),
    "of the pressure": nv.ActivatedViscosity(
        viscosity=PLAIN, E=0.0, theta_R=300.0, V=500.0, temperature=300.0
    ),
}
RULES = {
    "Norton of the temperature": nv.Activated(rule=nv.Norton(A=0.3, n=3), E=2e4, theta_R=300.0),
    "with a gradient": nv.Activated(rule=nv.Norton(A=0.3, n=3, nu=1e-3), E=2e4, theta_R=300.0),
}
DEFAULT = {"power law", "of the temperature"}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in DEFAULT else pytest.mark.long) for n in {**LAWS, **RULES}]
)
def test_both_solvers_agree_and_the_ledger_closes(name):
    solid = nv.ReferentialNeoHookean(K_e=20.0, G_e=2.0)
    has_heat = "of the temperature" in name or name in RULES
    material = nv.Thermal(material=solid, c=0.01, gruneisen=0.1, theta_R=300.0) if has_heat else solid
    model = nv.Model(material=material, viscosity=LAWS.get(name, PLAIN), creep=RULES.get(name))
    lid = {"top": nv.PrescribedTangential(CF((4 * x * (1 - x), 0)))}
    found = {}
    for solver in ("split", "coupled"):
        start = nv.Initial(density=1.0)
        run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.05, initial=start, walls=lid, solver=solver)
        ledger = run.run(0.15)
        assert abs(ledger.column("closure_relative")).max() <= 1e-10
        assert not ledger.column("rejections").any()
        found[solver] = ledger
        if has_heat:
            assert (np.diff(ledger.column("entropy")) > 0).all()
    for column in ("dissipation_stokes_shear", "stored", "kinetic"):
        split, coupled = (found[solver].column(column) for solver in ("split", "coupled"))
        assert np.allclose(split, coupled, rtol=1e-7), column
