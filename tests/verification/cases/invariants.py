"""Mass, and the range of density and Jacobian: 0 < rho <= rho_max + 1, min rho and min J away from 0."""

from functools import partial

import numpy as np
from ngsolve import CF, cos, pi, sin, x

import ngvisco as nv
from ngvisco.geometries import box
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.setups import KINDS, SETTING, block, closure, square_mesh, stokes

CASES = Cases("Mass, density and Jacobian")

REGULARISATIONS = {
    "none": None,
    "delta": nv.Regularisation(delta_density=1e-2, delta_fields=1e-2),
    "epsilon": nv.Regularisation(epsilon=0.1),
    "cut-off": nv.Regularisation(rho_max=1.05),
    "all": nv.Regularisation(delta_density=1e-2, delta_fields=1e-2, epsilon=0.1, rho_max=1.05),
}


def mass(kind: str) -> Outcome:
    """Mass after every step, with each of the scheme's terms that move it."""
    curves = []
    rows: list[list[str | float]] = []
    for name, law in REGULARISATIONS.items():
        for tau in (0.02, 0.5):
            run = block(
                kind,
                tau,
                creep=2.0,
                gravity=2.0,
                hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
                regularisation=law,
            )
            ledger = run.run(6 * tau)
            drift = np.abs(ledger.column("mass_drift"))
            rows.append([name, tau, float(drift.max()), closure(run)])
            curves.append(Curve(f"{name}, tau = {tau:g} s", range(7), drift))
    return measured(
        {
            "largest relative drift of the mass": max(float(row[2]) for row in rows),
        },
        Table("mass", "regularisation | tau, s | largest drift | closure", rows),
        Plot("|mass drift| after each step", "step", "relative", curves, log="y"),
    )


RHO_MAX = 1.0


def converging(
    kind: str, law: nv.Regularisation | None, maxh: float, tau: float, m: int = 1, dim: int = 2
) -> tuple[nv.Simulation, str]:
    """Matter of density 1 runs into the middle of a soft tube at 3 m/s; up to 0.3 s, or why it ended."""
    soft = nv.LinearElastic(K_e=1.0, G_e=0.5)
    model = nv.Model(
        material=soft if kind == "linearised" else nv.NeoHookean(K_e=1.0, G_e=0.5, epsilon=0.1),
        viscosity=stokes(0.1),
        regularisation=law,
    )
    initial = nv.Initial(density=1.0, velocity=(3 * sin(2 * pi * x), *(0.0,) * (dim - 1)))
    mesh, discretisation = box((1, *(0.125,) * (dim - 1)), maxh), nv.Discretisation(m=m)
    run = nv.Simulation(mesh, model, dt=tau, initial=initial, discretisation=discretisation)
    try:
        run.run(0.3)
    except nv.StepError as error:
        return run, f"stopped at t = {run.t:.2f} s: {str(error).split('; ')[0][:90]}"
    return run, ""


CUT_OFF_RUNS = (
    ("m = 0, no delta", 0.0, 1 / 8, 0.02, 0),
    ("m = 0, no delta, fine", 0.0, 1 / 16, 0.01, 0),
    ("m = 0, no delta, long steps", 0.0, 1 / 8, 0.1, 0),
    ("m = 1, no delta", 0.0, 1 / 8, 0.02, 1),
    ("m = 1, no delta, fine", 0.0, 1 / 16, 0.01, 1),
    ("m = 1, delta too weak for its mesh", 1e-4, 1 / 8, 0.02, 1),
    ("m = 1, delta, coarse", 1e-3, 1 / 8, 0.02, 1),
    ("m = 1, delta", 1e-3, 1 / 16, 0.01, 1),
)
"""Name, delta, h, tau and m."""


def cut_off(kind: str) -> Outcome:
    """The tube with the cut-off, the delta-term resolved, too weak and absent; and without a cut-off."""
    rows: list[list[str | float]] = []
    curves = []
    for name, delta, maxh, tau, m in (*CUT_OFF_RUNS, ("no cut-off", 1e-3, 1 / 16, 0.01, 1)):
        rho_max = None if name == "no cut-off" else RHO_MAX
        run, end = converging(kind, nv.Regularisation(delta_density=delta, rho_max=rho_max), maxh, tau, m)
        ledger = run.ledger
        highest, lowest = ledger.column("rho_max"), float(ledger.column("rho_min").min())
        volume = float(ledger.column("cutoff_volume").max() / 0.125) if rho_max else 0.0
        limited = float(ledger.column("limited_cells").sum())
        rows.append(
            [name, delta, maxh, tau, lowest, float(highest.max()), volume, limited, closure(run), end]
        )
        curves.append(Curve(name, ledger.column("time"), highest))
    curves.append(Curve("rho_max + 1", [0.0, 0.3], [RHO_MAX + 1] * 2, "k--"))
    cut, without = rows[:-1], rows[-1]
    return measured(
        {
            "largest rho": max(float(row[5]) for row in cut),
            "smallest rho": min(float(row[4]) for row in cut),
            "share of the volume where the cut-off acts": min(float(row[6]) for row in cut),
            "runs that ended early": float(sum(bool(row[9]) for row in cut)),
            "largest rho without the cut-off": float(without[5]),
        },
        Table(
            f"range of the density; rho_max = {RHO_MAX:g}, cut-off from 1 to 0 over rho_max to rho_max + 1",
            "run | delta | h, m | tau, s | min rho | max rho | volume cut | cells limited | closure | end",
            rows,
        ),
        Plot("Largest density", "t, s", "kg/m3", curves),
        "The flux between cells is monotone in the densities of both sides, so that nothing flows into "
        "a full cell; with m = 1 the limiter keeps the bound at points. The delta-term is not needed.",
    )


def positivity(kind: str) -> Outcome:
    """Smallest rho and J of a strong compression and extension under refinement of h and tau together."""
    rows: list[list[str | float]] = []
    curves, lows = [], []
    for h, tau in ((0.5, 0.02), (0.25, 0.01), (0.125, 0.005)):
        initial = nv.Initial(density=1.0, velocity=CF((sin(pi * x) * cos(pi * x), 0.0)) * 4)
        run = block(
            kind, tau, mesh=square_mesh(h), initial=initial, hyperviscosity=nv.HyperViscosity(mu=1e-4)
        )
        ledger = run.run(0.2)
        low = float(ledger.column("rho_min").min())
        J = float(ledger.column("J_min").min())
        lows.append((low, J))
        rows.append([h, tau, low, J, float(ledger.column("rho_max").max())])
        times = ledger.column("time")
        curves.append(Curve(f"min rho, h = {h:g} m", times, ledger.column("rho_min")))
        if kind == "finite":
            curves.append(Curve(f"min J, h = {h:g} m", times, ledger.column("J_min"), "s:"))
    values = {
        "smallest rho": min(low for low, _ in lows),
        "fall of min rho from the coarser to the finest mesh": lows[-2][0] - lows[-1][0],
    }
    if kind == "finite":
        values["smallest J"] = min(J for _, J in lows)
        values["fall of min J from the coarser to the finest mesh"] = lows[-2][1] - lows[-1][1]
    return measured(
        values,
        Table("extrema", "h, m | tau, s | min rho | min J | max rho", rows),
        Plot("Smallest density and Jacobian", "t, s", "", curves),
    )


for kind in KINDS:
    finite = kind == "finite"
    CASES(f"""mass-{kind}{" (reduced)" * (not finite)}
        In {KINDS[kind]} mass is conserved to rounding, with each of the scheme's regularisations.
        label: Euler-small-est-1+
        setting: {SETTING}, creep, gravity 2 m/s2, hyperviscosity; cells of 0.5 m, 6 steps of 0.02 and 0.5 s.
        - largest relative drift of the mass <= 1e-12: rounding
        - closure
        """)(partial(mass, kind))
    CASES(f"""cut-off-{kind}
        With the cut-off 0 < rho <= rho_max + 1 in {KINDS[kind]}, with any delta and without, for m = 0 and m
          = 1, in a problem whose density would otherwise pass it.
        label: {"cut-off, Euler-small-est3+++" if not finite else "cut-off, Euler-large-est"}
        setting: A soft tube of 1 m x 0.125 m (K_e = 1 Pa, G_e = 0.5 Pa, K_v = G_v = 0.1 Pa s), density 1, v =
          3 sin(2 pi x) m/s, until 0.3 s; rho_max = {RHO_MAX:g}; delta = 0, 1e-4 and 1e-3 (r = 4), h = 1/8 and
          1/16 m, tau = 0.01 to 0.1 s.
        - largest rho <= {RHO_MAX + 1}: the paper's bound
        - smallest rho >= 1e-3: positive, with distance
        - share of the volume where the cut-off acts >= 0.05: the case is built so that it must
        - runs that ended early <= 0: no step is refused
        - largest rho without the cut-off >= {RHO_MAX + 1}: the case is built so that it must
        - closure
        """)(partial(cut_off, kind))
    of_J = """- smallest J >= 0.3: as for the density
        - fall of min J from the coarser to the finest mesh <= 0.05: no trend to 0"""
    CASES(f"""positivity-{kind}
        In {KINDS[kind]} min rho{" and min J stay" if finite else " stays"} away from 0 as h and tau are
          refined.
        label: {"basic-est-of-v, cont-eq-inverse" if not finite else "1/J-continuity-eq, J-min"}
        setting: A block of 1 m x 1 m with slip, density 1 kg/m3, compressed in its middle and extended at its
          sides by v = 2 sin(2 pi x) m/s at first; {SETTING.split("; ", 1)[1]}; hyperviscosity mu = 1e-4, p =
          4; h = 0.5 to 0.125 m with tau = 0.04 h, until 0.2 s.
        - smallest rho >= 0.3: an extension by a factor of two at most
        - fall of min rho from the coarser to the finest mesh <= 0.05: no trend to 0
        {of_J if finite else ""}
        - closure
        """)(partial(positivity, kind))
