"""Rules of conformation tensors: polymers and elastoviscoplastic fluids, alone and as branches."""

import numpy as np
import pytest
from flow_rules import OF_CONFORMATION
from ngsolve import CF, y
from support import SWIRL, by_ci, each_once, others_by_ci, swirling

import ngvisco as nv
from ngvisco.geometries import box, channel

CHAINS = {"Hooke": nv.OldroydB(K_e=20.0, G_e=0.5), "FENE-P": nv.FENEP(K_e=20.0, G_e=0.5, b=20.0)}


def simulation(material, dim=2, **options):
    initial = nv.Initial(velocity=(*SWIRL, CF(0))[:dim])
    return swirling(
        box((1,) * dim, maxh=0.5 if dim == 2 else 2), dt=0.05, material=material, initial=initial, **options
    )


SETTINGS = [("coupled", 2, "backward-euler"), ("split", 2, "midpoint"), ("split", 3, "backward-euler")]


@pytest.mark.parametrize(("name", "chains"), each_once(OF_CONFORMATION, CHAINS))
def test_ledger_closes_and_power_is_not_negative(name, chains):
    solver, dim, scheme = dict(zip(CHAINS, SETTINGS, strict=False))[chains]
    run = simulation(CHAINS[chains], dim, creep=OF_CONFORMATION[name], solver=solver, scheme=scheme)
    ledger = run.run(0.2)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("creep_power_min")[1:].min() >= -1e-12
    assert ledger.column("dissipation_creep")[-1] > 1e-4


@pytest.mark.parametrize("setting", [by_ci(SETTINGS[0]), SETTINGS[1], by_ci(SETTINGS[2])], ids=str)
def test_the_ledger_closes_for_a_fluid_of_branches_with_different_laws(setting):
    solver, dim, scheme = setting
    parts = {
        f"mode_{i}": nv.Branch(material=CHAINS["Hooke"], creep=OF_CONFORMATION[name])
        for i, name in enumerate(("Giesekus", "exponential PTT", "Saramito"))
    }
    run = simulation(nv.Network(branches=parts), dim, solver=solver, scheme=scheme)
    ledger = run.run(0.1)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    assert ledger.column("creep_power_min")[1:].min() >= -1e-12


def steady(rule, Wi):
    """(T_12, N_1, N_2) over G of a steady shear flow at lambda = 1 s; 2D tensors are 3x3."""
    walls = {"top": nv.PrescribedTangential((Wi, 0.0)), "bottom": nv.NoSlip()}
    model = nv.Model(material=nv.OldroydB(K_e=50.0, G_e=0.5), creep=rule)
    initial = nv.Initial(velocity=(Wi * y, 0), density=1.0)
    run = nv.Simulation(channel(1, 1, maxh=1.0), model, dt=1.0, walls=walls, initial=initial)
    run.run(30.0)
    T = np.reshape(run.fields["cauchy_stress"](run.mesh(0.4, 0.4)), (3, 3))
    return np.array([T[0, 1], T[0, 0] - T[1, 1], T[1, 1] - T[2, 2]])


def giesekus(alpha, Wi):
    """The closed form of Giesekus (1982), J. Non-Newtonian Fluid Mech. 11."""
    s = 16 * alpha * (1 - alpha) * Wi**2
    chi = np.sqrt((np.sqrt(1 + s) - 1) / (0.5 * s))
    f = (1 - chi) / (1 + (1 - 2 * alpha) * chi)
    shear = Wi * (1 - f) ** 2 / (1 + (1 - 2 * alpha) * f)
    return np.array([shear, 2 * f * (1 - alpha * f) / (alpha * (1 - f)), -f])


def ptt(epsilon, Wi, form):
    """c_22 = 1, c_12 = Wi/f, c_11 = 1 + 2 (Wi/f)^2 with f of tr c - 3 = 2 (Wi/f)^2, by bisection."""
    low, high = 1.0, 1.0 + 10 * Wi**2
    for _ in range(200):
        f = 0.5 * (low + high)
        stretch = epsilon * 2 * (Wi / f) ** 2
        above = f > (1 + stretch if form == "linear" else np.exp(stretch))
        low, high = (low, f) if above else (f, high)
    return np.array([Wi / f, 2 * (Wi / f) ** 2, 0.0])


def saramito():
    """rheoTool, issue 121: tau_Y = G = 1 Pa, lambda = 1 s, at 1/s: sigma_12 = 1.500, N_1 = 4.50 Pa."""
    return np.array([1.5, 4.5, 0.0])


STEADY = {
    "Giesekus, alpha = 0.1": (nv.Giesekus(G_m=2.0, alpha=0.1), 3.0, giesekus(0.1, 3.0)),
    "Giesekus, alpha = 0.4": (nv.Giesekus(G_m=2.0, alpha=0.4), 1.0, giesekus(0.4, 1.0)),
    "linear PTT": (nv.PTT(G_m=2.0, epsilon=0.25), 2.0, ptt(0.25, 2.0, "linear")),
    "exponential PTT": (
        nv.PTT(G_m=2.0, epsilon=0.1, form="exponential"),
        2.0,
        ptt(0.1, 2.0, "exponential"),
    ),
    "Saramito": (nv.Perzyna(sigma_Y=3**0.5, G_m=2.0, law="conformation"), 1.0, saramito()),
}


@pytest.mark.parametrize("name", others_by_ci(STEADY, "Giesekus, alpha = 0.4", "linear PTT", "Saramito"))
def test_stresses_in_steady_shear_equal_those_of_the_literature(name):
    rule, Wi, expected = STEADY[name]
    found = steady(rule, Wi)
    assert np.allclose(found, expected, rtol=1e-5, atol=1e-6), (found, expected)


def test_a_rule_that_does_not_fit_a_conformation_tensor_is_refused():
    neo = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
    for name in OF_CONFORMATION:
        with pytest.raises(nv.ParameterError, match="since NeoHookean has none; OldroydB and FENEP have one"):
            nv.Model(material=neo, creep=OF_CONFORMATION[name])
    with pytest.raises(nv.ParameterError, match=r"PTT\.epsilon = 0\.4: expected a number < 1/3"):
        nv.PTT(G_m=1.0, epsilon=0.4)
    with pytest.raises(nv.ParameterError, match=r"Giesekus\.alpha"):
        nv.Giesekus(G_m=1.0, alpha=1.1)
    with pytest.raises(nv.ParameterError, match=r"Perzyna\.H"):
        nv.Perzyna(sigma_Y=1.0, G_m=1.0, H=1.0, law="conformation")
    with pytest.raises(nv.ParameterError, match=r"Norton\.nu"):
        nv.Norton(A=1.0, n=2.0, nu=1.0, law="conformation")
