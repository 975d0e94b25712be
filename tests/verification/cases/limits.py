"""Stability for every step length, limits with their rates, and comparisons of the models."""

import math
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise, product
from typing import Any

import numpy as np
from ngsolve import CF, BilinearForm, BitArray, GridFunction, Integrate, LinearForm, Mesh, y

import ngvisco as nv
from ngvisco.forms.fields import Fields
from ngvisco.forms.terms.regularisation import DensityDiffusion, FieldDiffusion
from ngvisco.physics.tensors import IDENTITY, dev, inner, square
from ngvisco.physics.variables import SmallStrain
from ngvisco.run.ledger import ClosureWarning
from tests.verification.case import Cases, Curve, Measured, Plot, RateTable, Table
from tests.verification.setups import (
    KINDS,
    LABELS,
    SETTING,
    SWIRL,
    block,
    closure,
    distance,
    elastic,
    fluid,
    material,
    separation,
    square_mesh,
    stokes,
)

CASES = Cases("Stability for every step length")

# --- stability: four decades of tau, without and with a load -------------------------------------------

TAUS, LONG = (1e-3, 1e-2, 1e-1, 1.0, 10.0), 5
"""Lengths of steps, s, and number of steps of each length."""


def energies(
    kind: str, gravity: float, mesh: Mesh | None = None, taus: Sequence[float] = TAUS, steps: int = LONG
) -> Measured:
    """Energies after every step, including the potential energy of the weight, for every tau."""
    rows, curves, rises, remainders, unsolved = [], [], [], [], 0

    def energy(run: nv.Simulation) -> float:
        weight = Integrate(run.fields["density"] * y, run.mesh, order=6) if gravity else 0.0
        return float(run.ledger.energy() + gravity * weight)

    for tau in taus:
        law = nv.HyperViscosity(mu=1e-5, p=4)
        # in steps longer than the motion F and J drift apart, which must not end a run here
        run = block(kind, tau, mesh=mesh, gravity=gravity, creep=2.0, hyperviscosity=law, drift=1.0)
        found = [energy(run)]
        for _ in range(steps):
            try:
                row = run.advance()
            except nv.StepError:
                unsolved += 1
                break
            found.append(energy(run))
            remainders.append(min(row["inertial"], row["bregman"]) / found[0])
        relative = np.array(found) / found[0]
        rises.append(float(np.diff(relative).max()))
        curves.append(Curve(f"tau = {tau:g} s", range(len(relative)), relative))
        defect = run.ledger.rows[-1]["J_defect"]
        rows.append([tau, len(relative) - 1, relative[-1], rises[-1], closure(run), defect])
    yield "largest relative rise of the energy in a step", max(rises)
    yield "steps without a solution", unsolved
    yield "smallest numerical dissipation of a step, relative", min(remainders)
    columns = "tau, s | steps | energy | largest rise | closure | ‖J − det F‖"
    yield Table("energy at the end, relative to the start", columns, rows)
    yield Plot("Energy after each step", "step", "energy / initial energy", curves)
    if kind == "finite":
        yield "Stable is not accurate: where tau is longer than the motion J and det F part."


BOUNDS = """- largest relative rise of the energy in a step <= 1e-12: rounding
    - steps without a solution <= 0: the paper: solutions exist for every tau
    - closure
    - smallest numerical dissipation of a step, relative >= -1e-13: convexity of kinetic and stored energy"""
BALANCES = {"linearised": "Euler-ED-basic-energy-balance-disc", "finite": "Euler-large-energy-balance-disc"}
"""Labels of the balances."""

for gravity, kind in product((0.0, 2.0), KINDS):
    what = "kinetic, stored and the weight's potential energy" if gravity else "kinetic plus stored energy"
    name = f"stability-{'loaded' if gravity else 'free'}-{kind}"
    CASES(f"""{name}{" (reduced)" * (name == "stability-free-linearised")}
        In {KINDS[kind]} {what} never rises in a step, whatever its length.
        label: {BALANCES[kind]}
        setting: {SETTING}, creep with G_m = 2 Pa s, hyperviscosity mu = 1e-5, p =
          4{", gravity 2 m/s2" * bool(gravity)}; cells of 0.5 m, {LONG} steps each of tau = 1e-3 to 10 s.
        {BOUNDS}
        """)(partial(energies, kind, gravity))


# --- limits: tau, the energy balance as an equality; the delta-terms ---------

CASES.theme = "Limits"

DURATION = 0.16


def in_tau(kind: str) -> Measured:
    """Differences of the runs with tau, tau/2, ... from the run with the next smaller tau, and the numerical
    dissipation of each run."""
    table, losses, _ = _halved(lambda tau: block(kind, tau, creep=2.0, gravity=1.0), (8, 16, 32, 64, 128))
    yield from table.lasts("last rate of {}")
    yield "last rate of the numerical dissipation", losses.last("inertial_and_bregman")
    yield table
    yield losses


def _halved(
    make: Callable[[float], nv.Simulation], counts: Sequence[int], duration: float = DURATION
) -> tuple[RateTable, RateTable, list[nv.Simulation]]:
    """The table of differences from the next finer run, the table of the numerical dissipation, and the
    runs."""
    table = RateTable(f"distance to the run with half the step, t = {duration} s", "tau, s")
    losses = RateTable("numerical dissipation until then, relative to the initial energy", "tau, s")
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
    """Halves the strain of traces after each step. The strain relaxes at the rate 1/tau, which has no limit
    for tau -> 0."""

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


QUARTIC = nv.CustomMaterial(
    transported=(SmallStrain(),), stored_energy=lambda E: 5 * square(E) + 50 * square(E) * square(E)
)
"""The energy 5 |E|^2 + 50 |E|^4 Pa; at |E| = 0.3, which the swirl reaches, both terms have the same size."""


def in_yosida(kind: str, of: nv.Material) -> Measured:
    """Differences of runs with Yosida approximations of the energy from the run with the energy itself."""
    table = RateTable(f"distance to epsilon = 0, t = {DURATION} s", "epsilon, 1/Pa")
    runs = {}
    for size in (0.0, 1e-2, 1e-3, 1e-4, 1e-5):
        used = nv.Yosida(material=of, eps=size) if size else of
        runs[size] = block(kind, DURATION / 8, mesh=square_mesh(0.35), creep=2.0, gravity=1.0, of=used)
        runs[size].run(DURATION)
        if size:
            table.add(size, **separation(runs[size], runs[0.0]))
    yield from table.lasts("last rate of {}")
    yield table


DELTAS, TAU, STEPS = (1e-2, 1e-3, 1e-4, 1e-5), 0.02, 8


def delta_terms(run: nv.Simulation) -> Callable[[], np.ndarray]:
    """Make a function that returns norms of the delta-terms in the present state.

    The norms are the L2 norms of div(delta |grad rho|^{r-2} grad rho) and of delta Laplace z, and the L^{r'}
    norm of the compensating force delta |grad rho|^{r-2} (grad v) grad rho.  Both L2 norms are computed as in
    the scheme, from Riesz representatives in the spaces of rho and z.
    """
    step, law, u = run.rothe_step, run.model.regularisation, run.rothe_step.now
    assert law is not None
    space = step.layout.space
    trial, test = (Fields.of(step.layout, functions) for functions in space.TnT())
    terms = {"rho": DensityDiffusion(law), "z": FieldDiffusion(law, step.model.material, step.mesh.dim)}
    parts = []
    for name, term in terms.items():
        mass, load, only = BilinearForm(space, check_unused=False), LinearForm(space), BitArray(space.ndof)
        mass += step.quadrature.cells(inner(getattr(trial, name), getattr(test, name)))
        only.Clear()
        only[step.layout.ranges[name]] = True
        step.quadrature.add(load, term.form(u, test))
        parts.append((mass.Assemble().mat.Inverse(only, inverse="umfpack"), load))
    force, dual = law.diffusivity(square(u.grad_rho)) * (u.grad_v * u.grad_rho), law.r / (law.r - 1)

    def norms() -> np.ndarray:
        found = []
        for inverse, load in parts:
            load.Assemble()
            found.append(math.sqrt(max((inverse * load.vec).Evaluate().InnerProduct(load.vec), 0.0)))
        return np.array([*found, Integrate(square(force) ** (0.5 * dual), run.mesh, order=8) ** (1 / dual)])

    return norms


def in_delta_terms(kind: str) -> Measured:
    """Norms in L2(I x Omega) of the delta-terms, and of the gradients, which stay bounded."""
    slopes = RateTable("largest gradients of rho, in L4, and of z, in L2", "delta")
    title = "delta-terms of rho and z in L2(I x Omega), compensating force in L4(I; L4/3(Omega))"
    table, powers = RateTable(title, "delta"), np.array([2, 2, 4])
    for delta in DELTAS:
        law = nv.Regularisation(delta_density=delta, delta_fields=delta, epsilon=delta)
        hyper = nv.HyperViscosity(mu=1e-4, p=4)
        run = block(kind, TAU, creep=2.0, hyperviscosity=hyper, regularisation=law)
        norms, u, sums, steepest = delta_terms(run), run.rothe_step.now, np.zeros(3), np.zeros(2)
        of_slopes = square(u.grad_rho) ** 2, square(u.grad_z)
        for _ in range(STEPS):
            run.advance()
            sums += TAU * norms() ** powers
            steepest = np.maximum(steepest, [Integrate(f, run.mesh, order=8) for f in of_slopes])
        table.add(delta, **dict(zip(("rho", "z", "force"), sums ** (1 / powers), strict=True)))
        slopes.add(delta, rho=steepest[0] ** 0.25, z=steepest[1] ** 0.5)
    yield "least rate of div(delta|∇rho|^{r-2}∇rho)", min(table.rates("rho"))
    yield "least rate of delta Laplace z", min(table.rates("z"))
    yield "least rate of delta|∇rho|^{r-2}(∇v)∇rho", min(table.rates("force"))
    for name, g in slopes.errors.items():
        yield f"growth of ∇{name} over two decades", g[-1] / g[-3]
    yield table
    yield slopes.table()


DELTA_LABELS = {
    "linearised": "Euler-small-est-rho-E-",
    "finite": "Euler-large-est++, Euler-large-est++F, Euler-large-est++J",
}

for kind in KINDS:
    finite = kind == "finite"
    setting = f"{SETTING}, creep with G_m = 2 Pa s, gravity 1 m/s2, until {DURATION} s"
    CASES(f"""limit-tau-{kind}{" (reduced)" * (not finite)}
        As tau -> 0 {KINDS[kind]} converges at first order, and the energy inequality becomes an equality:
          the numerical dissipation vanishes like tau.
        label: {LABELS[kind]}, Euler-{"large" if finite else "small"}-energy-balance-stress
        setting: {setting}; cells of 0.5 m; 8 to 128 steps, each run compared with the one of half the step.
        - last rate of v >= 0.85: implicit Euler is of first order{"; ED-Euler-large1-polyconvex" * finite}
        - last rate of [rho; z] >= 0.85: implicit Euler is of first order
        - last rate of the numerical dissipation >= 0.9: order tau
        - closure
        """)(partial(in_tau, kind))
    CASES(f"""limit-yosida-{kind}
        As epsilon -> 0 the solutions of {KINDS[kind]} with the Yosida approximation of the stored energy tend
          to the solutions with the energy itself.
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
        - growth of ∇rho over two decades in [0.95, 1.05]: Euler-small-est-rho: bounded
        - growth of ∇z over two decades in [0.95, 1.05]: Euler-small-est-E: bounded
        """)(partial(in_delta_terms, kind))


CASES(f"""limit-yosida-quartic
    As epsilon -> 0 the solutions with the Yosida approximation of an energy that grows like |E|^4 tend to the
      solutions with the energy itself.
    label: rem-general-phi, varphi-regularized
    setting: As limit-yosida-linearised, with the energy 5 |E|^2 + 50 |E|^4 Pa until {DURATION} s.
    - last rate of [v; rho; z] >= 0.9: the approximation is of first order in epsilon
    - closure
    """)(partial(in_yosida, "linearised", QUARTIC))


@CASES(f"""limit-tau-bodies
    Thinly spread matter takes part in the flow by its fraction, whatever the step: as tau -> 0 the result
      converges; with a relaxation of traces in each step it does not converge.
    label: FORMULATION.md, Section 9
    setting: Disc of 0.2 m, G_e = 1 Pa, in a fluid that turns with 1 m/s at first, K_e = 10 Pa and 0.1 Pa s in
      both; cells of 0.25 m, 16 to 256 steps until {2 * DURATION} s, each run compared with the one of half
      the step.  The control halves the strain of traces after each step.
    - last rate of v >= 0.7: first order; the waves of the start need short steps
    - last rate of rho >= 0.7: the same
    - last rate of z >= 0.85: implicit Euler is of first order
    - last rate of z, control <= 0.5: no limit
    - closure
    """)
def _bodies() -> Measured:
    counts = (16, 32, 64, 128, 256)
    table, losses, runs = _halved(smeared, counts, 2 * DURATION)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClosureWarning)
        control, _, _ = _halved(partial(smeared, fades=True), counts, 2 * DURATION)
    yield from table.lasts("last rate of {}")
    yield "last rate of z, control", control.last("z")
    yield "largest |closure|", closure(*runs)
    yield from (table, losses.table(), control.table())
    yield "The bounds were written after trials with 8 to 128 steps."


# --- the models against each other ---------------------------------------------------------------------

CASES.theme = "The models against each other"


@CASES(f"""small-strain
    The linearised and the finite-strain model agree as strains go to zero: their relative difference is of
      first order in the strain.
    label: ZJ, ED-Euler-large2
    setting: {SETTING.split("; K_e")[0]}, bulk modulus 10 Pa and shear modulus 5 Pa of both, creep with G_m =
      2 Pa s; 0.4 to 0.025 m/s; k = 3, m = 2, without whose orders the meshes' errors are seen, cells of 0.35
      m, 10 steps of 0.01 s.
    - last rate of v >= 0.9: first order in the strain
    - last rate of the stress >= 0.9: first order in the strain
    - relative difference of v at the smallest speed <= 0.02: strains below 1 %
    - closure
    """)
def _small_strain() -> Measured:
    table = RateTable("relative difference at t = 0.1 s", "initial speed, m/s")
    mesh, orders = square_mesh(0.35), nv.Discretisation(k=3, m=2)
    for speed in (0.4, 0.2, 0.1, 0.05, 0.025):
        found = []
        for kind in KINDS:
            of = elastic(kind, 10.0, 5.0)
            run = block(kind, 0.01, mesh=mesh, speed=speed, of=of, creep=2.0, discretisation=orders)
            run.run(0.1)
            found.append((run.fields["velocity"], dev(run.fields["cauchy_stress"])))
        (v, S), (w, T) = found
        of_v = distance(v, w, mesh) / distance(v, 0 * v, mesh)
        table.add(speed, v=of_v, stress=distance(S, T, mesh) / distance(S, 0 * S, mesh))
    yield "last rate of v", table.last("v")
    yield "last rate of the stress", table.last("stress")
    yield "relative difference of v at the smallest speed", table.errors["v"][-1]
    yield table


def _kelvin_voigt(kind: str) -> Measured:
    """Measure the limit G_m -> infinity, and the deviatoric stress under a lasting load with and without
    creep."""
    options: dict[str, Any] = {"mesh": square_mesh(0.35), "of": elastic(kind, 10.0, 5.0)}
    table = RateTable("distance to Kelvin–Voigt at t = 0.16 s", "1/G_m, 1/(Pa s)")
    runs = {}
    for G_m in (None, 10.0, 100.0, 1e3, 1e4):
        runs[G_m] = block(kind, 0.02, creep=G_m, speed=0.2, **options)
        runs[G_m].run(0.16)
        if G_m is not None:
            table.add(1 / G_m, **separation(runs[G_m], runs[None]))
    deviators = []
    for creep in (2.0, None):
        # the density is uniform, so that the settled body has a static stress and does not overturn slowly
        run = block(kind, 0.25, creep=creep, gravity=2.0, initial=nv.Initial(density=1.0), **options)
        run.run(4.0)
        S = dev(run.fields["cauchy_stress"])
        deviators.append(distance(S, 0 * S, run.mesh))
    yield "last rate of v in 1/G_m", table.last("v")
    yield "last rate of z in 1/G_m", table.last("z")
    yield "stress deviator at 4 s, Jeffreys / Kelvin–Voigt", deviators[0] / deviators[1]
    yield table


for kind in KINDS:
    CASES(f"""kelvin-voigt-{kind}
        In {KINDS[kind]} a Jeffreys material tends to the Kelvin–Voigt material as G_m -> infinity; with creep
          the deviatoric stress under a lasting load relaxes, without creep it stays.
        label: {"Euler-small-viscoelastodyn+2" if kind == "linearised" else "ED-Euler-large3"}
        setting: The block of the other cases with K_e = 10 Pa, shear modulus 5 Pa, 0.2 m/s; cells of 0.35 m;
          8 steps of 0.02 s with G_m = 10 to 1e4 Pa s; 16 steps of 0.25 s under gravity 2 m/s2 from rest and
          uniform density with G_m = 2 Pa s.
        - last rate of [v; z] in 1/G_m >= 0.9: a regular perturbation
        - stress deviator at 4 s, Jeffreys / Kelvin–Voigt in [4e-5, 1e-3]: ten relaxation times:
          exp(-10), by backward Euler's steps of 0.6 of one 4e-4
        - closure
        """)(partial(_kelvin_voigt, kind))
