"""The elastic state by F and by B = F F^T: the same material where nothing winds up; what each one loses."""

import math

import numpy as np
import pytest
from ngsolve import CF
from support import swirling

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.tensors import dev, square, tr
from ngvisco.physics.variables import Distortion, Jacobian, LeftCauchyGreen
from tests.verification.cases.winding import lid

TWO_FORMED = {
    "NeoHookean": lambda **state: nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, **state),
    "MooneyRivlin": lambda **state: nv.MooneyRivlin(K_e=10.0, G_e=3.0, G_mr=2.0, epsilon=0.1, **state),
    "ReferentialNeoHookean": lambda **state: nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, **state),
    "IsochoricNeoHookean": lambda **state: nv.IsochoricNeoHookean(K_e=10.0, G_e=5.0, **state),
    "LogarithmicNeoHookean": lambda **state: nv.LogarithmicNeoHookean(
        K_e=10.0, G_e=5.0, epsilon=0.1, **state
    ),
    "ReferentialMooneyRivlin": lambda **state: nv.ReferentialMooneyRivlin(
        K_e=10.0, G_e=3.0, G_mr=2.0, **state
    ),
}


def names(material):
    return [v.name for v in material.variables]


# --- which form a model has --------------------------------------------------------------------------


@pytest.mark.parametrize("name", TWO_FORMED)
def test_model_with_creep_is_by_B_and_one_without_by_F(name):
    material, creep = TWO_FORMED[name](), nv.Creep(G_m=1.0)
    assert "B" in names(nv.Model(material=material, creep=creep).material)
    for none in (None, nv.Creep(G_m=math.inf)):
        assert "B" not in names(nv.Model(material=material, creep=none).material)
    for state in ("F", "B"):
        given = TWO_FORMED[name](elastic_state=state)
        assert nv.Model(material=given, creep=creep).material == given
        assert nv.Model(material=given).material == given


def test_wrapped_materials_take_the_form_of_their_model():
    inner = TWO_FORMED["NeoHookean"]()
    wrapped = nv.WithQuadratic(material=nv.Yosida(material=inner, eps=1e-3), delta=0.1, only=("B",))
    found = nv.Model(material=wrapped, creep=nv.Creep(G_m=1.0)).material
    assert found.material.material.elastic_state == "B"
    with pytest.raises(nv.UnknownNameError, match="for elastic_state = 'F' 'B'"):
        nv.Model(material=wrapped)


def test_bad_input_is_refused_with_what_would_be_right():
    with pytest.raises(nv.ParameterError, match=r"NeoHookean.elastic_state = 'C': expected one of F, B"):
        TWO_FORMED["NeoHookean"](elastic_state="C")
    with pytest.raises(nv.ParameterError, match=r"rotation \[\[.*\]\] of B = "):
        nv.CustomMaterial(
            transported=(LeftCauchyGreen(), Jacobian()), stored_energy=lambda B, J: B[0, 0] + tr(B) + J * J
        )
    with pytest.raises(nv.ParameterError, match="tensors of one frame"):
        nv.CustomMaterial(
            transported=(LeftCauchyGreen(), Distortion()), stored_energy=lambda B, F: tr(B) + square(F)
        )
    with pytest.raises(nv.ParameterError, match="a material with a conformation tensor"):
        nv.Model(material=TWO_FORMED["NeoHookean"](), creep=nv.Creep(G_m=1.0, law="conformation"))
    with pytest.raises(nv.ParameterError, match=r"Creep\.nu"):
        nv.Creep(G_m=1.0, nu=0.1, law="leonov")
    with pytest.raises(nv.ParameterError, match=r"FENEP\.b = 3: expected a finite number > 3"):
        nv.FENEP(K_e=1.0, G_e=1.0, b=3)
    not_positive = CF((1, 2, 0, 2, 1, 0, 0, 0, 1), dims=(3, 3))
    model = nv.Model(material=TWO_FORMED["NeoHookean"](elastic_state="B"))
    with pytest.raises(nv.InitialDataError, match=r"projected B_11 B_22 - B_12\^2_0"):
        nv.Simulation(box((1, 1), maxh=1), model, dt=0.1, initial=nv.Initial(values={"B": not_positive}))


# --- the two forms agree -----------------------------------------------------------------------------


def swirl(state, dt, maxh, until=0.04, **options):
    material, viscosity = TWO_FORMED["NeoHookean"](elastic_state=state), nv.StokesViscosity(K_v=0.1, G_v=0.1)
    run = swirling(maxh, dt, material=material, viscosity=viscosity, **options)
    run.run(until)
    return run


@pytest.mark.parametrize("creep", [None, nv.Creep(G_m=2.0)], ids=["elastic", "creep"])
def test_short_runs_agree_at_first_order_in_time(creep):
    """Halving tau (and h) halves the difference of the stresses; velocities agree to 1 %."""
    gaps = []
    for dt, maxh in ((0.02, 0.35), (0.01, 0.175)):
        by_F, by_B = (swirl(state, dt, maxh, creep=creep) for state in "FB")
        T, S = (run.sampler.values(dev(run.fields["cauchy_stress"])) for run in (by_F, by_B))
        gaps.append(np.linalg.norm(T - S) / np.linalg.norm(T))
        v, w = (run.sampler.values(run.fields["velocity"]) for run in (by_F, by_B))
        assert np.linalg.norm(v - w) <= 0.01 * np.linalg.norm(v)
    assert gaps[1] < 0.6 * gaps[0]
    assert gaps[1] > 1e-6  # they are discretised differently


def stored_by_B_and_by_F(dt, scheme="backward-euler"):
    """What B stores at the end beyond F, and the ledgers of both."""
    by_F, by_B = (swirl(state, dt, 0.35, until=0.2, scheme=scheme).ledger for state in "FB")
    return by_B.column("stored")[-1] - by_F.column("stored")[-1], by_F, by_B


def test_B_stores_what_F_dissipates_in_the_step():
    """B^k = B + tau (L B + B L^T) misses tau^2 L B L^T of F F^T, which F loses as ``bregman``.

    Measured: the difference of the stored energies is 0.985 and 0.98 of F's bregman at 0.02 and 0.01 s; by
    the midpoint rule 0.9 % of it is left at 0.02 s, which is of the space.
    """
    stored = []
    for dt in (0.02, 0.01):
        gap, by_F, by_B = stored_by_B_and_by_F(dt)
        lost = by_F.column("bregman").sum()
        assert gap == pytest.approx(lost, rel=0.1)
        assert by_B.column("bregman").sum() < 0.05 * lost
        stored.append(gap)
    assert stored[0] / stored[1] == pytest.approx(2, rel=0.25)  # of first order in tau
    assert abs(stored_by_B_and_by_F(0.02, "midpoint")[0]) < 0.02 * stored[0]


# --- what winds up says so ---------------------------------------------------------------------------


def under_a_lid(state):
    """Ten Maxwell times of the creeping body of the verification's ``winding-lid``, on a coarse mesh."""
    of = nv.ReferentialNeoHookean(K_e=20.0, G_e=0.05, elastic_state=state)
    return lid(of, 0.3, 0.05, creep=nv.Creep(G_m=0.005))


def test_run_that_winds_up_warns_once_and_names_the_remedy():
    run = under_a_lid("F")
    with pytest.warns(nv.DefectWarning) as caught:
        run.run(0.5)
    messages = [str(w.message) for w in caught if w.category is nv.DefectWarning]
    assert len(messages) == 1 and 'elastic_state="B"' in messages[0] and "det H and J" in messages[0]
    first = float(next(row["time"] for row in run.ledger.rows if row["defect_rms"] >= 0.01))
    assert messages[0].startswith(f"at t = {first:.4g} s, most at (")
    ledger = run.ledger
    assert ledger.column("defect_rms")[-1] > 0.05 and ledger.column("defect_max")[-1] > 0.2
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10  # which does not see it
