"""Flow rules in both solvers, local and with a gradient, alone and of bodies, against a step at a point."""

from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import CF, Integrate, x
from scipy.optimize import root

import ngvisco as nv
from ngvisco.forms.term import PointTerm, dissipations
from ngvisco.geometries import box, structured_box
from ngvisco.physics.tensors import power_of_square, square, tr
from ngvisco.physics.variables import Variable

MATERIAL = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, elastic_state="F")
BY_B = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, elastic_state="B")
F_0 = np.diag([1.3, 0.9, 1.1])


@dataclass(frozen=True, kw_only=True)
class Cubic(nv.FlowRule):
    """Pi = A |M|^2 M, a rule of one's own."""

    A: float
    nu: float = 0.0

    def rate(self, M, zeta, z):
        return self.A * square(M) * M

    def psi(self, Pi, z):
        return 0.75 * self.A ** (-1 / 3) * power_of_square(square(Pi), 2 / 3, self.rate_floor)


def stretched(rule, solver, bodies):
    """A homogeneous box at rest whose shape cannot change: what moves is the elastic strain alone."""
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
def test_a_rule_of_one_s_own_gives_what_it_says(nu, bodies, solver):
    """At a point its step is that of an ordinary equation."""
    run = stretched(Cubic(A=0.02, nu=nu), solver, bodies)
    ledger = run.run(0.04)
    names = ("B_left", "B_right") if bodies else ("H",)
    found = sum(np.diag(np.array(run.fields[name](run.mesh(0.3, 0.4))).reshape(3, 3)) for name in names)
    expected = implicit_steps(lambda M: 0.02 * (M @ M) * M, np.diff(ledger.column("time")), bodies)
    # of a trace of matter a body's share of the point is larger by TRACE^2
    assert np.abs(found - expected).max() <= (1e-5 if bodies else 1e-8)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("dissipation_creep")[1:].min() > 0


@dataclass(frozen=True)
class Heat(Variable):
    """What has become of dissipated energy, per actual volume, J/m^3."""

    name: str = "heat"
    kind: str = "scalar"

    def rate(self, z, L, Pi):
        return -tr(L) * z[self.name]

    def from_distortion(self, F):
        return CF(0.0)

    @property
    def is_conserved(self):
        return True

    @property
    def is_strain(self):
        return False


class Heating(PointTerm):
    """int dissipation : q in the equation of the heat: what other terms dissipate is its source."""

    def cells(self, u, w):
        return [-xi * w.z_tensors["heat"] for xi in dissipations(u, self).values()]

    def nodes(self, u, w):
        return [-xi * w.z_tensors["heat"] for xi in dissipations(u, self, "nodes").values()]


@pytest.mark.parametrize("nu", [0.0, 0.01])
@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_a_term_of_cells_reads_what_others_dissipate(nu, solver):
    """In a flow, where all of it is carried on: none is lost, none made."""
    elastic = nv.LinearElastic(K_e=10.0, G_e=5.0)
    material = nv.CustomMaterial(
        transported=(*elastic.variables, Heat()), stored_energy=lambda E, heat: elastic.energy({"E": E})
    )
    rule = nv.Creep(G_m=2.0, nu=nu) if nu else Cubic(A=0.5)
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1), creep=rule)
    lid = {"top": nv.PrescribedTangential(CF((16 * x**2 * (1 - x) ** 2, 0)))}
    start = {"initial": nv.Initial(density=1.0), "walls": lid, "terms": [Heating()]}
    run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.05, solver=solver, **start)
    ledger = run.run(0.1)
    names = [name for name in ledger.columns if name.startswith("dissipation_")]
    assert ("dissipation_creep_gradient" in names) == (nu > 0)
    dissipated = sum((ledger.column(name) * ledger.column("dt")).sum() for name in names)
    heat = Integrate(run.fields["heat"], run.mesh, order=4)
    assert heat == pytest.approx(dissipated, rel=1e-9)
    assert ledger.column("dissipation_creep")[-1] > 1e-3
    assert abs(ledger.column("closure_relative")).max() <= 1e-10


@pytest.mark.parametrize("creep", [nv.Perzyna(sigma_Y=0.5, G_m=0.5), nv.Eyring(A=0.1, sigma_0=1.0)])
def test_cells_of_one_value_creep_by_rules_that_are_no_polynomials(creep):
    found = {}
    for solver in ("split", "coupled"):
        lid = {"top": nv.PrescribedTangential(CF((16 * x**2 * (1 - x) ** 2, 0)))}
        model = nv.Model(
            material=nv.ReferentialNeoHookean(K_e=50.0, G_e=5.0, elastic_state="B"),
            viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
            creep=creep,
        )
        run = nv.Simulation(
            box((1, 1), maxh=0.3),
            model,
            dt=0.02,
            walls=lid,
            solver=solver,
            discretisation=nv.Discretisation(m=0),
        )
        found[solver] = run.run(0.06).column("dissipation_creep")[-1]
    assert found["split"] > 0
    assert found["split"] == pytest.approx(found["coupled"], rel=1e-8)
