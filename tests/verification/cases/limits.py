"""Stability for every step length, limits with their rates, and the models against each other."""

import math
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise, product

import numpy as np
from ngsolve import CF, GridFunction, Integrate, Mesh

import ngvisco as nv
from ngvisco.physics.tensors import IDENTITY, dev, square
from ngvisco.physics.variables import SmallStrain
from ngvisco.run.ledger import ClosureWarning
from tests.verification.case import Cases, Curve, Measured, Plot, Table
from tests.verification.functionals import DeltaTerms
from tests.verification.problems import distance
from tests.verification.rates import RateTable
from tests.verification.setups import (
    KINDS,
    LABELS,
    SETTING,
    SWIRL,
    block,
    closure,
    elastic,
    fluid,
    followed,
    material,
    potential,
    separation,
    square_mesh,
    stokes,
)

CASES = Cases("Stability for every step length")

# --- stability: four decades of tau, without and with a load -------------------------------------------

TAUS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
LONG = 5


def energies(
    kind: str, gravity: float, mesh: Mesh | None = None, taus: Sequence[float] = TAUS, steps: int = LONG
) -> Measured:
    """Energy, with the weight's potential, after every step, for every tau."""
    rows: list[list[str | float]] = []
    curves, rises, closures, remainders, unsolved = [], [], [], [], 0
    for tau in taus:
        law = nv.HyperViscosity(mu=1e-5, p=4)
        run = block(kind, tau, mesh=mesh, gravity=gravity, creep=2.0, hyperviscosity=law)
        energies: list[float] = []
        failure = ""
        with_potential = potential(run, gravity)
        for _ in range(steps):
            try:
                row = run.advance()
            except nv.StepError as error:
                failure, unsolved = str(error), unsolved + 1
                break
            if not energies:
                start = run.ledger.rows[0]
                energies.append(start["kinetic"] + start["stored"] + with_potential)
            energies.append(row["kinetic"] + row["stored"] + potential(run, gravity))
            remainders.append(min(row["inertial"], row["bregman"]) / energies[0])
        scale = energies[0] if energies else 1.0
        rise = float(np.diff(energies).max() / scale) if len(energies) > 1 else np.nan
        rises.append(rise)
        closures.append(closure(run))
        curves.append(Curve(f"tau = {tau:g} s", range(len(energies)), [e / scale for e in energies]))
        defect = run.ledger.rows[-1]["J_defect"] if run.ledger.rows else np.nan
        rows.append([tau, len(energies) - 1, energies[-1] / scale, rise, closures[-1], defect, failure])
    yield "largest relative rise of the energy in a step", max(rises)
    yield "steps without a solution", unsolved
    yield "smallest numerical dissipation of a step, relative", min(remainders)
    yield Table(
        "energy at the end, relative to the start",
        "tau, s | steps | energy | largest rise | closure | ‖J − det F‖ | failure",
        rows,
    )
    yield Plot("Energy after each step", "step", "energy / initial energy", curves)
    if kind == "finite":
        yield (
            "Stable is not accurate: in the finite-strain model J and det F part where tau is longer "
            "than the motion, and the stored energy of (F, J) then falls below that of a body at rest."
        )


BOUNDS = """- largest relative rise of the energy in a step <= 1e-12: rounding
    - steps without a solution <= 0: the paper: solutions exist for every tau
    - closure
    - smallest numerical dissipation of a step, relative >= -1e-13: convexity of kinetic and stored energy"""
BALANCES = {"linearised": "Euler-ED-basic-energy-balance-disc", "finite": "Euler-large-energy-balance-disc"}
"""Labels."""

for gravity, kind in product((0.0, 2.0), KINDS):
    what = "kinetic, stored and the weight's potential energy" if gravity else "kinetic plus stored energy"
    name = f"stability-{'loaded' if gravity else 'free'}-{kind}"
    CASES(f"""{name}{" (reduced)" * (name == "stability-free-linearised")}
        In {KINDS[kind]} {what} never rises in a step, whatever its
          length, {"under gravity" if gravity else "without load"}.
        label: {BALANCES[kind]}
        setting: {SETTING}, creep with G_m = 2 Pa s, hyperviscosity mu = 1e-5, p =
          4{", gravity 2 m/s2" * bool(gravity)}; cells of 0.5 m, {LONG} steps each of tau = 1e-3 to 10 s (at
          first the eddy crosses a cell in 0.5 s).
        {BOUNDS}
        """)(partial(energies, kind, gravity))


# --- limits: tau, the energy balance as an equality; the Yosida approximation; the delta-terms ---------

CASES.theme = "Limits"

DURATION = 0.16
DISTANCE = "distance in L2"
YOSIDA_SIZES = (1e-2, 1e-3, 1e-4, 1e-5)


def in_tau(kind: str) -> Measured:
    """Runs with tau, tau/2, ... against the next finer one, and what they dissipate numerically."""
    table, losses, _ = _halved(lambda tau: block(kind, tau, creep=2.0, gravity=1.0), (8, 16, 32, 64, 128))
    yield from table.lasts("last rate of {}")
    yield "last rate of the numerical dissipation", losses.last("inertial_and_bregman")
    yield from table.shown("tau, s", DISTANCE, 1.0)
    yield losses.table("tau, s")
    yield losses.plot("tau, s", "share of the energy", 1.0)


def _halved(
    make: Callable[[float], nv.Simulation], counts: Sequence[int], duration: float = DURATION
) -> tuple[RateTable, RateTable, list[nv.Simulation]]:
    """Distances to the next finer run, numerical dissipation, and the runs."""
    table = RateTable(f"distance to the run with half the step, t = {duration} s")
    losses = RateTable("numerical dissipation until then, relative to the initial energy")
    runs: list[nv.Simulation] = []
    for steps in counts:
        run = make(duration / steps)
        ledger = run.run(duration)
        runs.append(run)
        lost = ledger.column("inertial").sum() + ledger.column("bregman").sum()
        energy = ledger.column("kinetic")[0] + ledger.column("stored")[0]
        losses.add(duration / steps, inertial_and_bregman=float(lost / energy))
    for coarse, fine in pairwise(runs):
        table.add(coarse.dt, **separation(coarse, fine))
    return table, losses, runs


class Fading(nv.Observer):
    """Halves the strain of what takes no part after each step: at the rate 1/tau, which has no limit."""

    def step(self, simulation: nv.Simulation, row: dict[str, float]) -> None:
        step, material = simulation.rothe_step, simulation.model.material
        z = step.now.z_tensors
        X, rest = z["B_disc"], z["n_disc"] * IDENTITY
        kept = 0.5 * (1 + material.taking_part(z)["B_disc"])
        part = dict(zip(step.layout.names, step.state.components, strict=True))["z"]
        faded = GridFunction(part.space)
        faded.Set(material.states(2).components({**z, "B_disc": rest + kept * (X - rest)}))
        part.vec.data = faded.vec
        step.state_old.vec.data = step.state.vec
        step.start_from_old()


def smeared(tau: float, fades: bool = False) -> nv.Simulation:
    """A soft disc within an eddy, on cells as large as its radius."""
    soft, disc = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0), nv.Ball((0.5, 0.75), 0.2)
    bodies = (
        nv.Body(name="disc", where=disc, material=soft, viscosity=stokes(0.1), density=1.0),
        nv.Body(name="fluid", material=fluid(10.0), viscosity=stokes(0.1), density=1.0),
    )
    return nv.Simulation(
        square_mesh(0.25),
        nv.Model(bodies=bodies),
        time=nv.TimeSteps(dt=tau, velocity_scale=1.0),
        initial=nv.Initial(velocity=CF(SWIRL)),
        observers=[Fading()] if fades else [],
    )


def in_yosida(kind: str, of: nv.Material) -> Measured:
    """Runs with the Yosida approximations of a material, of decreasing size, against its own."""
    dt, mesh, name = DURATION / 8, square_mesh(0.35), "epsilon, 1/Pa"
    without = block(kind, dt, mesh=mesh, creep=2.0, gravity=1.0, of=of)
    without.run(DURATION)
    table = RateTable(f"distance to {name} = 0, t = {DURATION} s")
    for size in YOSIDA_SIZES:
        run = block(kind, dt, mesh=mesh, creep=2.0, gravity=1.0, of=nv.Yosida(material=of, eps=size))
        run.run(DURATION)
        table.add(size, **separation(run, without))
    yield from table.lasts("last rate of {}")
    yield from table.shown(name, DISTANCE, 1.0)


DELTAS, TAU, STEPS = (1e-2, 1e-3, 1e-4, 1e-5), 0.02, 8


def gradients(run: nv.Simulation) -> tuple[float, ...]:
    """Norms of the cells' own gradients of rho, in L4, and of z, in L2."""
    u = run.rothe_step.now
    rho, z = square(u.grad_rho), square(u.grad_z)
    return tuple(float(Integrate(f, run.mesh, order=8)) ** s for f, s in ((rho * rho, 0.25), (z, 0.5)))


def in_delta_terms(kind: str) -> Measured:
    """L2(I x Omega) norms of the delta-terms, and the gradients that they leave bounded."""
    norms = RateTable("largest gradients of rho, in L4, and of z, in L2")
    table = RateTable("delta-terms of rho and z in L2(I x Omega), compensating force in L4(I; L4/3(Omega))")
    for delta in DELTAS:
        law = nv.Regularisation(delta_density=delta, delta_fields=delta, epsilon=delta)
        hyper = nv.HyperViscosity(mu=1e-4, p=4)
        run = block(kind, TAU, creep=2.0, hyperviscosity=hyper, regularisation=law)
        terms = DeltaTerms(run.rothe_step)
        squares, force = np.zeros(2), 0.0
        steepest: tuple[float, ...] = (0.0, 0.0)
        for _ in range(STEPS):
            run.advance()
            steepest = tuple(map(max, steepest, gradients(run)))
            squares += TAU * np.square(terms.norms())
            force += TAU * terms.compensating_force() ** 4
        table.add(delta, rho=math.sqrt(squares[0]), z=math.sqrt(squares[1]), force=force**0.25)
        norms.add(delta, rho=steepest[0], z=steepest[1])
    yield "least rate of div(delta|∇rho|^{r-2}∇rho)", min(table.rates("rho"))
    yield "least rate of delta Laplace z", min(table.rates("z"))
    yield "least rate of delta|∇rho|^{r-2}(∇v)∇rho", min(table.rates("force"))
    for name, g in norms.errors.items():
        yield f"growth of ∇{name} over two decades", g[-1] / g[-3]
    yield from table.shown("delta", "norm", 0.5, "z")
    yield norms.table("delta")
    yield "On one mesh the norms end up proportional to delta, which is better than the bound."


QUARTIC = nv.CustomMaterial(
    transported=(SmallStrain(),), stored_energy=lambda E: 5 * square(E) + 50 * square(E) * square(E)
)
"""5 |E|^2 + 50 |E|^4 Pa: at |E| = 0.3, which the swirl reaches, both are of one size."""


DELTA_LABELS = {
    "linearised": "Euler-small-est-rho-E-",
    "finite": "Euler-large-est++, Euler-large-est++F, Euler-large-est++J",
}

for kind in KINDS:
    finite = kind == "finite"
    setting = f"{SETTING}, creep with G_m = 2 Pa s, gravity 1 m/s2, until {DURATION} s"
    CASES(f"""limit-tau-{kind}{" (reduced)" * (not finite)}
        As tau -> 0 {KINDS[kind]} converges at first order, and the energy inequality becomes an equality:
          what the scheme dissipates numerically vanishes like tau.
        label: {LABELS[kind]}, Euler-{"large" if finite else "small"}-energy-balance-stress
        setting: {setting}; cells of 0.5 m; 8 to 128 steps, each run compared with the one of half the step.
        - last rate of v >= 0.85: implicit Euler is of first order{"; ED-Euler-large1-polyconvex" * finite}
        - last rate of [rho; z] >= 0.85: implicit Euler is of first order
        - last rate of the numerical dissipation >= 0.9: order tau
        - closure
        """)(partial(in_tau, kind))
    CASES(f"""limit-yosida-{kind}
        As epsilon -> 0 the solutions of {KINDS[kind]} with the Yosida approximation of the stored energy go
          to those with the energy itself.
        label: varphi-regularized{", ED-Euler-large-polyconvex-eps" * finite}
        setting: {setting}; cells of 0.35 m, 8 steps; epsilon from 1e-2 to 1e-5 1/Pa.
        - last rate of [v; rho; z] >= 0.9: the approximation is of first order in epsilon
        - closure
        """)(partial(in_yosida, kind, material(kind)))
    CASES(f"""delta-terms-{kind}
        In {KINDS[kind]} the delta-terms vanish in L2(I x Omega) like sqrt(delta) or faster, and the
          compensating force like delta; gradients stay bounded.
        label: Euler-small-est-rho-E, {DELTA_LABELS[kind]}
        setting: {SETTING}, creep with G_m = 2 Pa s, hyperviscosity mu = 1e-4, p = 4, all regularising terms
          (r = 4); cells of 0.5 m, {STEPS} steps of {TAU} s; delta from 1e-2 to 1e-5.
        - least rate of div(delta|∇rho|^{{r-2}}∇rho) >= 0.5: the paper's sqrt(delta)
        - least rate of delta Laplace z >= 0.5: the paper's sqrt(delta)
        - least rate of delta|∇rho|^{{r-2}}(∇v)∇rho >= 0.9: the paper's delta
        - growth of ∇rho over two decades <= 1.05: Euler-small-est-rho: bounded
        - growth of ∇z over two decades <= 1.05: Euler-small-est-E: bounded
        """)(partial(in_delta_terms, kind))


CASES(f"""limit-yosida-quartic
    As epsilon -> 0 the solutions with the Yosida approximation of an energy that grows like |E|^4 go to those
      with the energy itself.
    label: rem-general-phi, varphi-regularized
    setting: As limit-yosida-linearised, with the energy 5 |E|^2 + 50 |E|^4 Pa until {DURATION} s.
    - last rate of [v; rho; z] >= 0.9: the approximation is of first order in epsilon
    - closure
    """)(partial(in_yosida, "linearised", QUARTIC))


@CASES(f"""limit-tau-bodies
    What is spread thin takes part in the flow by its fraction, not by the step: as tau -> 0 the result
      converges; with a relaxation of traces in each step it does not.
    label: FORMULATION.md, Section 9
    setting: Disc of 0.2 m, G_e = 1 Pa, in a fluid that turns with 1 m/s at first, K_e = 10 Pa and 0.1 Pa s in
      both; cells of 0.25 m, backward Euler, 16 to 256 steps until {2 * DURATION} s, each run compared with
      the one of half the step.  The control halves the strain of traces after each step.
    - last rate of v >= 0.7: first order; the waves of the start need short steps
    - last rate of rho >= 0.7: the same
    - last rate of z >= 0.85: implicit Euler is of first order
    - last rate of z, control <= 0.5: no limit
    - closure
    """)
def in_tau_of_bodies() -> Measured:
    """Runs of ``smeared`` with tau, tau/2, ..., and the same of its control."""
    counts = (16, 32, 64, 128, 256)
    table, losses, runs = _halved(smeared, counts, 2 * DURATION)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClosureWarning)
        control, _, _ = _halved(partial(smeared, fades=True), counts, 2 * DURATION)
    yield from table.lasts("last rate of {}")
    yield "last rate of z, control", control.last("z")
    yield "largest |closure|", closure(*runs)
    yield from table.shown("tau, s", DISTANCE, 1.0)
    yield losses.table("tau, s")
    yield control.table("tau, s")
    yield "The bounds were written after trials with 8 to 128 steps."


# --- the models against each other: small strains, Kelvin–Voigt and Jeffreys ---------------------------

CASES.theme = "The models against each other"

MAXH = 0.35
SMALL = {kind: elastic(kind, 10.0, 5.0) for kind in KINDS}


@CASES(f"""small-strain
    The linearised and the finite-strain model agree as strains go to zero: their relative difference is of
      first order in the strain.
    label: ZJ, ED-Euler-large2
    setting: {SETTING.split("; K_e")[0]}, with equal bulk (10 Pa) and shear moduli (5 Pa;
      ReferentialNeoHookean with G_e = 2.5 Pa), creep with G_m = 2 Pa s; 0.4 to 0.025 m/s; k = 3, m = 2, cells
      of 0.35 m, 10 steps of 0.01 s.
    - last rate of v >= 0.9: first order in the strain
    - last rate of the stress >= 0.9: first order in the strain
    - relative difference of v at the smallest speed <= 0.02: strains below 1 %
    - closure
    """)
def small_strain() -> Measured:
    """Relative differences of velocity and stress, over the initial speed."""
    table, strains = RateTable("relative difference at t = 0.1 s"), []
    mesh, orders = square_mesh(MAXH), nv.Discretisation(k=3, m=2)
    for speed in (0.4, 0.2, 0.1, 0.05, 0.025):
        pair = {
            kind: block(kind, 0.01, mesh=mesh, speed=speed, of=of, creep=2.0, discretisation=orders)
            for kind, of in SMALL.items()
        }
        for run in pair.values():
            run.run(0.1)
        linear, finite = pair["linearised"].fields, pair["finite"].fields
        zero = 0 * linear["cauchy_stress"]
        S, T = (dev(fields["cauchy_stress"]) for fields in (linear, finite))
        table.add(
            speed,
            v=distance(linear["velocity"], finite["velocity"], mesh)
            / distance(linear["velocity"], 0 * linear["velocity"], mesh),
            stress=distance(S, T, mesh) / distance(S, zero, mesh),
        )
        strains.append(distance(linear["E"], zero, mesh))
    yield "last rate of v", table.last("v")
    yield "last rate of the stress", table.last("stress")
    yield "relative difference of v at the smallest speed", table.errors["v"][-1]
    yield table.table("speed, m/s")
    yield table.plot("initial speed, m/s", "relative difference", 1.0, "v")
    yield f"Strains |E| in L2 from {strains[0]:.2g} down to {strains[-1]:.2g}."
    yield (
        "On one mesh the difference stops at that of the two models' errors in space: with k = 2, m "
        "= 1 and "
        "the same cells at 0.5 % of v, with k = 3, m = 2 it is not seen."
    )


def _run(kind: str, dt: float, steps: int, creep: float | None, gravity: float = 0.0) -> nv.Simulation:
    run = block(kind, dt, mesh=square_mesh(MAXH), of=SMALL[kind], creep=creep, gravity=gravity, speed=0.2)
    run.run(steps * dt)
    return run


def _deviator(run: nv.Simulation) -> float:
    """Size of the stress's, Pa m."""
    S = dev(run.fields["cauchy_stress"])
    return distance(S, 0 * S, run.mesh)


def kelvin_voigt(kind: str) -> Measured:
    """G_m -> infinity is Kelvin–Voigt; with creep the deviatoric stress relaxes under a lasting load."""
    solid = _run(kind, 0.02, 8, None)
    table = RateTable("distance to Kelvin–Voigt at t = 0.16 s")
    for G_m in (10.0, 100.0, 1e3, 1e4):
        run = _run(kind, 0.02, 8, G_m)
        table.add(1 / G_m, **separation(run, solid))
    deviators, curves = {}, []
    for name, creep in (("Kelvin–Voigt", None), ("Jeffreys", 2.0)):
        # uniform density: what is left then is the stress of the settled body, not a slow overturn
        initial = nv.Initial(density=1.0)
        run = block(
            kind, 0.25, mesh=square_mesh(MAXH), of=SMALL[kind], creep=creep, gravity=2.0, initial=initial
        )
        t, sizes = followed(run, 16, _deviator)
        deviators[name] = sizes[-1]
        curves.append(Curve(name, t[1:], sizes[1:]))
    yield "last rate of v in 1/G_m", table.last("v")
    yield "last rate of z in 1/G_m", table.last("z")
    yield (
        "stress deviator at 4 s, Jeffreys / Kelvin–Voigt",
        deviators["Jeffreys"] / deviators["Kelvin–Voigt"],
    )
    yield table.table("1/G_m")
    yield table.plot("1/G_m, 1/(Pa s)", "distance in L2", 1.0, "z")
    yield Plot("Stress deviator under gravity", "t, s", "Pa m", curves, log="y")


for kind in KINDS:
    moduli = "K_e = 10 Pa, shear modulus 5 Pa, 0.2 m/s; cells of 0.35 m"
    CASES(f"""kelvin-voigt-{kind}
        In {KINDS[kind]} a Jeffreys material goes to the Kelvin–Voigt one as G_m -> infinity; with creep the
          deviatoric stress under a lasting load relaxes, without it stays.
        label: {"Euler-small-viscoelastodyn+2" if kind == "linearised" else "ED-Euler-large3"}
        setting: The block of the other cases with {moduli}; 8 steps of 0.02 s with G_m = 10 to 1e4 Pa s; and
          16 steps of 0.25 s under gravity 2 m/s2 from rest and uniform density with G_m = 2 Pa s.
        - last rate of v in 1/G_m >= 0.9: a regular perturbation
        - last rate of z in 1/G_m >= 0.9: a regular perturbation
        - stress deviator at 4 s, Jeffreys / Kelvin–Voigt <= 0.1: ten relaxation times
        - closure
        """)(partial(kelvin_voigt, kind))
