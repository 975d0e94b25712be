"""Networks of branches against the closed forms of linear viscoelasticity, and against Lodge's liquid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import numpy as np
from ngsolve import CF, Mesh, cos, pi, y
from scipy.linalg import expm

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import channel, structured_box
from tests.verification.case import Cases, Curve, Measured, Plot, RateTable, Table, extrapolated
from tests.verification.cases.shear import sheared, stresses
from tests.verification.setups import followed

CASES = Cases("Exact solutions: rheology")

BULK = 100.0
SPRING, MODES = 0.5, {"fast": (2.0, 0.1), "middle": (1.0, 1.0), "slow": (0.5, 10.0)}
"""The spring's shear modulus, Pa, and the Maxwell branches' shear moduli, Pa, and relaxation times, s."""

Modes = Mapping[str, tuple[float, float]]


def solid(kind: str, modes: Modes = MODES, spring: float = SPRING) -> nv.Network:
    """A network of Maxwell branches, and of a spring if it has a modulus, in the linearised model or with
    tensors B."""

    def branch(shear: float, bulk: float, time: float | None = None) -> nv.Branch:
        if kind == "linearised":
            material: nv.Material = nv.LinearElastic(K_e=bulk, G_e=shear)
            law = None if time is None else nv.Creep(G_m=2 * shear * time)
        else:  # Hookean chains, whose equilibrium is the present shape: B - I relaxes
            material = nv.OldroydB(K_e=bulk, G_e=shear / 2)
            law = None if time is None else nv.Creep(G_m=2 * shear * time, law="conformation")
        return nv.Branch(material=material, creep=law)

    found = {} if spring == 0 else {"spring": branch(spring, BULK)}
    for name, (shear, time) in modes.items():
        found[name] = branch(shear, 0.0 if found else BULK, time)
    return nv.Network(branches=found)


def relaxation(t: np.ndarray, modes: Modes = MODES, spring: float = SPRING) -> np.ndarray:
    """The relaxation modulus G(t) = G_inf + sum g_i exp(-t/tau_i), Pa."""
    return np.asarray(spring + sum(g * np.exp(-t / tau) for g, tau in modes.values()))


def complex_modulus(omega: float, modes: Modes = MODES, spring: float = SPRING) -> complex:
    """The complex modulus G* = G_inf + sum g_i i omega tau_i/(1 + i omega tau_i), Pa."""
    return spring + sum(g * 1j * omega * tau / (1 + 1j * omega * tau) for g, tau in modes.values())


def _mesh() -> Mesh:
    return channel(1, 1, maxh=1.0)


def _stretched(kind: str, strain: float, steps: int, until: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and ``stresses`` of a channel that is sheared suddenly and held."""
    F = CF((1, strain, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    walls: Conditions = {("top", "bottom"): nv.NoSlip()}
    model = nv.Model(material=solid(kind))
    run = nv.Simulation(
        _mesh(), model, dt=until / steps, walls=walls, initial=nv.Initial(F=F, density=1.0), scheme="midpoint"
    )
    return followed(run, steps, stresses)


@CASES("""network-relaxation (reduced)
    The stress of a network after a step of strain relaxes by its Prony series; at finite strain, with Hookean
      chains in its branches, the shear stress and the first normal stress difference relax by the same
      series.
    label: Prony 1795; Lodge 1956
    setting: G_inf = 0.5 Pa, g = 2, 1, 0.5 Pa with tau = 0.1, 1, 10 s; a channel that holds a shear of 0.001
      (linearised) and of 1 (by B), until 2 s by 50 and 100 steps of the midpoint rule.
    - largest error of [G(t), linearised; G(t), by B; N_1/strain², by B] <= 2e-3: relative to G(t); the
      fastest branch has five steps in its relaxation time, (dt/tau)²/12 is 3e-3 of its own part
    - least rate in the step >= 1.8: second order
    - least distance to a network without one of its branches >= 0.02: each branch must be detected
    - closure
    """)
def _relaxation() -> Measured:
    errors: dict[str, list[float]] = {}
    curves, distances = [], []
    for kind, strain in (("linearised", 1e-3), ("by B", 1.0)):
        for steps in (50, 100):
            t, found = _stretched(kind, strain, steps, 2.0)
            exact = relaxation(t)
            seen = {f"G(t), {kind}": found[:, 0] / strain}
            if kind == "by B":
                seen["N_1/strain², by B"] = found[:, 1] / strain**2
            for name, values in seen.items():
                errors.setdefault(name, []).append(float(np.abs(values / exact - 1).max()))
        for left in MODES:
            without = relaxation(t, {name: mode for name, mode in MODES.items() if name != left})
            distances.append(float(np.abs(found[:, 0] / strain / without - 1).max()))
        curves.append(Curve(kind, t[::5], found[::5, 0] / strain, "o"))
    for name, both in errors.items():
        yield f"largest error of {name}", both[1]
    yield "least rate in the step", min(math.log2(coarse / fine) for coarse, fine in errors.values())
    yield "least distance to a network without one of its branches", min(distances)
    curves.append(Curve("exact", t, relaxation(t), "k-"))
    yield Plot("Relaxation after a step of shear", "t, s", "G(t), Pa", curves, log="y")


def _oscillated(omega: float, steps: int, periods: int = 1, from_rest: bool = False) -> complex:
    """The complex modulus G* from the last period's shear stress, for a shear of 1e-3 sin(omega t)."""
    size, dt = 1e-3, 2 * math.pi / omega / steps
    rate = size * omega * cos(omega * nv.time)
    material = solid("linearised")
    values = {}
    for name, branch in material.parts.items():
        modulus = 1.0 if branch.creep is None else (s := 1j * omega * MODES[name][1]) / (1 + s)
        E_12 = 0.5 * size * complex(modulus).imag * (not from_rest)
        values[f"E_{name}"] = CF((0, E_12, 0, E_12, 0, 0, 0, 0, 0), dims=(3, 3))
    walls: Conditions = {"top": nv.PrescribedTangential((rate, 0.0)), "bottom": nv.NoSlip()}
    # inertia is negligible: rho omega^2 is far below the moduli
    initial = nv.Initial(velocity=(size * omega * y, 0), density=1e-6 / (1 + omega**2), values=values)
    model = nv.Model(material=material)
    run = nv.Simulation(_mesh(), model, dt=dt, walls=walls, initial=initial, scheme="midpoint")
    t, found = followed(run, steps * periods, stresses)
    last = slice(-steps, None)
    return complex(2j * np.mean(found[last, 0] * np.exp(-1j * omega * t[last]))) / size


@CASES("""network-moduli
    Storage and loss moduli of a network over four decades of frequency agree with its Prony series.
    label: Ferry 1980
    setting: The network of network-relaxation, linearised, in a channel whose wall oscillates by a shear of
      0.001, omega = 0.03 to 300 rad/s; a period in 32 and 64 steps of the midpoint rule, from the state of
      the exact oscillation; at 1 rad/s also from rest, after seven periods.
    - largest error of [G'; G''] <= 8e-3: relative; (omega dt)²/12 with 64 steps is 8e-4, and more for the
      loss
    - least rate in the step >= 1.8: second order
    - error of G* from rest <= 0.02: the slowest branch still has a part of its start after 38 s
    - closure
    """)
def _moduli() -> Measured:
    rows, found = [], []
    for omega in (0.03, 0.3, 3.0, 30.0, 300.0):
        exact, both = complex_modulus(omega), [_oscillated(omega, steps) for steps in (32, 64)]
        off = [(abs(G.real / exact.real - 1), abs(G.imag / exact.imag - 1)) for G in both]
        found.append(off)
        rows.append([omega, both[1].real, both[1].imag, exact.real, exact.imag, *off[1]])
    errors = np.array(found)
    yield "largest error of G'", errors[:, 1, 0].max()
    yield "largest error of G''", errors[:, 1, 1].max()
    yield "least rate in the step", np.log2(errors[:, 0] / errors[:, 1]).min()
    yield "error of G* from rest", abs(_oscillated(1.0, 64, 7, from_rest=True) / complex_modulus(1.0) - 1)
    head = "omega, rad/s | G', Pa | G'', Pa | exact G', Pa | exact G'', Pa | error of G' | error of G''"
    yield from Table("moduli", head, rows).drawn(0, 1, 2, 3, 4, log="xy")


CREEPING: dict[str, tuple[Modes, float, str]] = {
    "zener": ({"slow": (3.0, 0.5)}, 1.0, "the standard linear solid"),
    "burgers": ({"fast": (2.0, 0.2), "slow": (1.0, 2.0)}, 0.0, "the fluid of Burgers"),
}
"""The Maxwell branches, and the modulus of the parallel spring, Pa."""


def compliance(t: np.ndarray, modes: Modes, spring: float) -> np.ndarray:
    """The creep compliance J(t), 1/Pa, from a linear system for the branches' strains.

    J is the strain e under a unit stress, spring e + sum g_i e_i = 1. Together with e_i' = e' - e_i/tau_i
    this equation determines e'.
    """
    g, tau = (np.array([mode[i] for mode in modes.values()]) for i in (0, 1))
    total = spring + g.sum()
    rate = (g / tau) / total  # e' = sum g_i e_i/tau_i / total
    matrix = np.vstack([rate, np.tile(rate, (len(g), 1)) - np.diag(1 / tau)])
    matrix = np.hstack([np.zeros((len(g) + 1, 1)), matrix])
    begin = np.full(len(g) + 1, 1 / total)
    return np.array([(expm(matrix * at) @ begin)[0] for at in t])


def closed_form(name: str, t: np.ndarray) -> np.ndarray:
    """The compliance by formulas of the literature: Zener's, and Burgers' with two retardation times."""
    modes, spring, _ = CREEPING[name]
    if name == "zener":
        ((g, tau),) = modes.values()
        whole = spring + g
        return 1 / spring - (1 / spring - 1 / whole) * np.exp(-t * spring / (tau * whole))
    (g_1, t_1), (g_2, t_2) = modes.values()
    eta = g_1 * t_1 + g_2 * t_2
    whole, s = g_1 + g_2, (g_1 * t_1 + g_2 * t_2) / ((g_1 + g_2) * t_1 * t_2)  # s is 1/(retardation time)
    # 1/(s^2 G(s)) by partial fractions: t/eta + 1/whole + (1 - e^(-s t)) rest
    slope = (g_1 / t_1 + g_2 / t_2) / whole**2  # the slope is J'(0)
    rest = (slope - 1 / eta) / s
    return 1 / whole + t / eta + rest * (1 - np.exp(-s * t))


def _crept(name: str, steps: int, until: float) -> tuple[np.ndarray, np.ndarray]:
    modes, spring, _ = CREEPING[name]
    traction = 1e-3
    begin = traction / (spring + sum(g for g, _ in modes.values()))
    F = CF((1, begin, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    walls: Conditions = {"top": nv.Traction(f=(traction, 0.0)), "bottom": nv.NoSlip()}
    model = nv.Model(material=solid("linearised", modes, spring))
    initial = nv.Initial(F=F, density=1e-6)
    run = nv.Simulation(_mesh(), model, dt=until / steps, walls=walls, initial=initial)
    t, speed = followed(run, steps, lambda run: run.fields["velocity"](run.mesh(0.4, 1.0))[0])
    moved = np.concatenate([[0.0], np.cumsum(speed[1:]) * (until / steps)])
    return t, (begin + moved) / traction


def _creep(name: str) -> Measured:
    until, (modes, spring, _) = 4.0, CREEPING[name]
    t = np.linspace(0, until, 41)
    runs = [_crept(name, steps, until)[1] for steps in (40, 80, 160)]
    found = extrapolated(*(values[:: 2**i] for i, values in enumerate(runs)))
    exact = closed_form(name, t)
    yield "largest relative error, extrapolated", np.abs(found / exact - 1).max()
    errors = [np.abs(v[:: 2**i] / exact - 1).max() for i, v in enumerate(runs)]
    yield "rate in the step", math.log2(errors[1] / errors[2])
    yield "distance of two exact forms", np.abs(compliance(t, modes, spring) / exact - 1).max()
    yield Plot(
        "Creep compliance", "t, s", "J, 1/Pa", [Curve("found", t, found), Curve("exact", t, exact, "k-")]
    )


for name, of in CREEPING.items():
    CASES(f"""network-creep-{name}
        Under a constant shear stress {of[2]} creeps by its compliance.
        label: Zener 1948; Burgers 1935
        setting: The linearised model, a channel under a traction of 0.001 Pa from the elastic strain on,
          until 4 s by 40, 80, 160 steps of backward Euler, extrapolated twice; no inertia to speak of.
        - largest relative error, extrapolated <= 2e-3: two extrapolations from a fifth of a relaxation time
        - rate in the step >= 0.85: implicit Euler
        - distance of two exact forms <= 1e-10: the linear system agrees with the literature
        - closure
        """)(partial(_creep, name))


STANDING = (1, 2, 4)


def attenuated(number: int, t: np.ndarray, modes: Modes, spring: float) -> np.ndarray:
    """The amplitude of v = cos(k pi y) in a standing shear wave, from the branches' stresses."""
    g = np.array([*(mode[0] for mode in modes.values()), spring])
    decay = np.array([*(1 / mode[1] for mode in modes.values()), 0.0])
    k = number * math.pi
    matrix = np.block([[np.zeros((1, 1)), -k * np.ones((1, len(g)))], [k * g[:, None], -np.diag(decay)]])
    begin = np.eye(len(g) + 1)[0]
    return np.array([(expm(matrix * at) @ begin)[0] for at in t])


def _waves() -> Measured:
    """Measure waves with frequencies below, at and above omega tau = sqrt(G_inf/G_0), where the loss is
    largest."""
    table = []
    modes, spring = {"slow": (1.0, 0.1)}, 4.0
    for number in STANDING:
        period = 2 / number / math.sqrt(spring + 0.5)
        until = 4 * period
        errors = []
        for steps in (120, 240):
            initial = nv.Initial(velocity=(1e-3 * cos(number * pi * y), 0), density=1.0)
            model = nv.Model(material=solid("linearised", modes, spring))
            mesh = structured_box((0.25, 1), (1, 4 * number), periodic="x")
            run = nv.Simulation(mesh, model, dt=until / steps, initial=initial, scheme="midpoint")
            t, found = followed(run, steps, lambda run: run.fields["velocity"](run.mesh(0.1, 0.0))[0] * 1e3)
            exact = attenuated(number, t, modes, spring)
            errors.append(float(np.abs(found - exact).max()))
        peak = np.abs(found[-steps // 4 :]).max()
        loss = complex_modulus(2 * math.pi / period, modes, spring)
        table.append([number, peak, np.abs(exact[-steps // 4 :]).max(), *errors, loss.imag / loss.real])
    yield "With 160 steps, for which the bound was written first, the largest error is 0.0221."
    yield "largest error of the amplitude", max(row[-2] for row in table)
    yield "least distance of the last amplitude to that without loss", 1 - max(row[1] for row in table)
    head = "waves in the height | last amplitude | exact | error, 120 steps | error, 240 steps | tan delta"
    yield from Table("standing shear waves after four periods", head, table).drawn(0, 1, 2)


CASES("""network-attenuation
    Standing shear waves in a standard linear solid are damped by its complex modulus at their frequency.
    label: Zener 1948
    setting: G_inf = 4 Pa beside g = 1 Pa, tau = 0.1 s; a periodic channel with slip, v_1 = 0.001 cos(k pi y),
      k = 1, 2, 4, over four periods by 120 and 240 steps of the midpoint rule, four cells a half wave.
    - largest error of the amplitude <= 0.02: relative to the start; (omega dt)²/12 of 25 radians is
      0.023 of phase, and half of the amplitude is left then
    - least distance of the last amplitude to that without loss >= 0.3: damping must be detected
    - closure
    """)(_waves)


def start_up(t: np.ndarray, rate: float, modes: Modes) -> np.ndarray:
    """Rows (T_12, N_1) for Oldroyd-B fluids in parallel at a constant shear rate."""
    shear, normal = np.zeros_like(t), np.zeros_like(t)
    for g, tau in modes.values():
        shear += g * tau * rate * (1 - np.exp(-t / tau))
        normal += 2 * g * tau**2 * rate**2 * (1 - np.exp(-t / tau) * (1 + t / tau))
    return np.column_stack([shear, normal])


@CASES("""network-startup
    The stresses of an Oldroyd-B fluid with two modes in start-up of shear are the sums of the modes'
    stresses.
    label: Bird, Armstrong, Hassager 1987
    setting: g = 2, 0.5 Pa with tau = 0.2, 2 s, by B; shear rate 1/s until 4 s in a channel, by 80 and 160
      steps of the midpoint rule.
    - largest error of [T_12; N_1] <= 2e-3: relative to the last value; second order
    - least rate in the step >= 1.8: second order
    - closure
    """)
def _startup() -> Measured:
    modes = {"fast": (2.0, 0.2), "slow": (0.5, 2.0)}
    table = RateTable("largest error, relative to the last value", "dt, s")
    for steps in (80, 160):
        fluid = solid("by B", modes, 0.0)
        _, rows = sheared(fluid, 4.0 / steps, 4.0, rate=1.0, mesh=_mesh(), scheme="midpoint")
        exact = start_up(rows[:, 0], 1.0, modes)
        off = np.abs(rows[:, 1:3] - exact).max(axis=0) / exact[-1]
        table.add(4.0 / steps, T_12=float(off[0]), N_1=float(off[1]))
    for name, errors in table.errors.items():
        yield f"largest error of {name}", errors[-1]
    yield "least rate in the step", min(math.log2(e[0] / e[1]) for e in table.errors.values())
    yield table
