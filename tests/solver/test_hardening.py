"""Hardening in both solvers: relaxation at a point, the stored energy, and refused models."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF
from scipy.optimize import brentq
from support import each_once
from test_rules_in_flows import MATERIALS, sheared

import ngvisco as nv
from ngvisco.geometries import box

G_E, G_M, SIGMA_Y, DT, STEPS = 5.0, 0.05, 0.5, 0.02, 5
START = 0.1 * np.diag([2.0, -1.0, -1.0]) / math.sqrt(6)
LAWS = {"linear": {"H": 3.0}, "Voce": {"H": 1.0, "Q": 2.0, "b": 20.0}, "none": {}}


def slope_and_energy(law, k):
    """phi_h'(k) and phi_h(k), Pa, by the formulas of the literature."""
    H, Q, b = law.get("H", 0.0), law.get("Q", 0.0), law.get("b", 1.0)
    return H * k + Q * (1 - math.exp(-b * k)), H * k**2 / 2 + Q * (k - (1 - math.exp(-b * k)) / b)


def relaxed(law, A=1.0):
    """|dev E| and k after steps of backward Euler from |START| in a body that cannot move.

    ``A`` is the reference volume per actual volume.
    """
    e, k = np.linalg.norm(START), 0.0
    for _ in range(STEPS):

        def defect(d, e=e, k=k):  # the unknown is d = tau |Pi|
            hardened = A * slope_and_energy(law, k + math.sqrt(2 / 3) * d)[0]
            threshold = math.sqrt(2 / 3) * (SIGMA_Y + hardened)
            return d - DT / G_M * max(2 * G_E * (e - d) - threshold, 0.0)

        d = brentq(defect, 0.0, e, xtol=1e-15)
        e, k = e - d, k + math.sqrt(2 / 3) * d
    return e, k


@pytest.mark.parametrize(("name", "solver"), each_once(LAWS, ["split", "coupled"]))
def test_the_yield_stress_grows_by_the_law_and_its_work_is_stored(name, solver):
    """In a homogeneous body a step is a scalar equation. The entries of the ledger follow from its
    solution."""
    law = LAWS[name]
    model = nv.Model(
        material=nv.LinearElastic(K_e=10.0, G_e=G_E),
        viscosity=nv.StokesViscosity(K_v=1.0, G_v=1.0),
        creep=nv.Perzyna(sigma_Y=SIGMA_Y, G_m=G_M, **law),
    )
    initial = nv.Initial(F=CF(tuple((np.eye(3) + START).ravel()), dims=(3, 3)))
    run = nv.Simulation(box((1, 1), maxh=1.0), model, dt=DT, initial=initial, solver=solver)
    ledger = run.run(STEPS * DT)
    A = 1 / np.linalg.det(np.eye(3) + START)
    e, k = relaxed(law, A)
    found = np.array(run.fields["E"](run.mesh(0.3, 0.4))).reshape(3, 3)
    assert np.abs(found - e / np.linalg.norm(START) * START).max() <= 1e-9
    stored = G_E * e**2 + A * slope_and_energy(law, k)[1]
    assert ledger.column("stored")[-1] == pytest.approx(stored, rel=1e-8)
    assert abs(ledger.column("closure_relative")).max() <= 1e-10
    if law:
        assert run.fields["plastic_strain"](run.mesh(0.3, 0.4)) == pytest.approx(k, rel=1e-8)
    else:
        assert "plastic_strain" not in run.fields


def test_plastic_work_that_is_not_stored_becomes_heat():
    material = nv.Thermal(material=MATERIALS["B"], c=1.0, theta_R=300.0, expansion=1e-3)
    run = sheared(nv.Perzyna(sigma_Y=0.5, G_m=0.5, H=20.0), material, "coupled")
    ledger = run.run(0.04)
    assert abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("creep_power_min").min() >= 0


def test_a_copy_of_a_model_with_another_rule_hardens_by_this_rule():
    first = nv.Model(material=MATERIALS["B"], creep=nv.Perzyna(sigma_Y=0.5, G_m=0.5, H=2.0))
    assert [v.name for v in replace(first, loads=()).material.variables] == ["B", "J", "A", "plastic_content"]
    assert [v.name for v in replace(first, creep=nv.Creep(G_m=1.0)).material.variables] == ["B", "J"]


def body(name="one", **parts):
    options = {"material": MATERIALS["B"], "viscosity": nv.StokesViscosity(K_v=1.0, G_v=1.0), "density": 1.0}
    return nv.Body(name=name, **(options | parts))


@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_a_body_hardens_by_the_law(solver):
    """Strains and stresses are a thousandth of those of ``relaxed``, so that the body at finite strain
    behaves as at small strains."""
    small, law = 1e-3, {"H": 1.0, "Q": 2.0, "b": 20.0}
    rule = nv.Perzyna(sigma_Y=small * SIGMA_Y, G_m=G_M, H=1.0, Q=small * 2.0, b=20.0 / small)
    material = nv.ReferentialNeoHookean(K_e=10.0, G_e=G_E / 2, elastic_state="B")
    model = nv.Model(bodies=[body(material=material, creep=rule)])
    initial = nv.Initial(F=CF(tuple((np.eye(3) + small * START).ravel()), dims=(3, 3)))
    run = nv.Simulation(box((1, 1), maxh=1.0), model, dt=DT, initial=initial, solver=solver)
    ledger = run.run(STEPS * DT)
    assert run.fields["plastic_strain_one"](run.mesh(0.3, 0.4)) == pytest.approx(
        small * relaxed(law)[1], rel=2e-3
    )
    assert abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("creep_power_min").min() >= 0
