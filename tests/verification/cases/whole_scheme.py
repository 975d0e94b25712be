"""The whole scheme at once, as the paper's proof has it: each of its estimates, on refined meshes."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, Integrate, Mesh

import ngvisco as nv
from ngvisco.forms.fields import Fields
from ngvisco.physics.tensors import dev, square
from tests.verification.case import CLOSURE, Bound, Cases, Curve, Outcome, Plot, Table, each, measured
from tests.verification.cases.dependent import COFACTORS
from tests.verification.setups import KINDS, SETTING, block, material, square_mesh

CASES = Cases("The whole scheme")

GRAVITY, RHO_MAX, MU, NU = 1.0, 2.0, 1e-4, 1e-2
EXPONENT = 4
"""p, q and r."""

WHOLE = (
    f"{SETTING}; creep with G_m = 2 Pa s, gravity {GRAVITY:g} m/s2, hyperviscosity mu = {MU:g}, cut-off at "
    f"{RHO_MAX:g} kg/m3, epsilon |v|^(p-2) v, delta-terms of density and fields; at finite "
    f"strain also creep's gradient nu = {NU:g}, the Yosida approximation with epsilon and sqrt(delta)/2 "
    f"|z|^2; p = q = r = {EXPONENT}"
)


def whole(kind: str, dt: float, mesh: Mesh, delta: float, epsilon: float) -> nv.Simulation:
    """The block of ``WHOLE``, not run yet; a delta or epsilon of 0 leaves its terms out."""
    law = nv.Regularisation(
        delta_density=delta, delta_fields=delta, epsilon=epsilon, r=EXPONENT, p=EXPONENT, rho_max=RHO_MAX
    )
    of = COFACTORS if kind == "cofactors" else material(kind)
    if kind != "linearised" and epsilon:
        of = nv.Yosida(material=of, eps=epsilon)
    if kind != "linearised" and delta:
        of = nv.WithQuadratic(material=of, delta=delta)
    creep = nv.Creep(G_m=2.0) if kind == "linearised" else nv.Creep(G_m=2.0, nu=NU, q=EXPONENT)
    hyper = nv.HyperViscosity(mu=MU, p=EXPONENT)
    return block(
        kind, dt, mesh=mesh, gravity=GRAVITY, creep=creep, hyperviscosity=hyper, of=of, regularisation=law
    )


# --- norms ----------------------------------------------------------------------------------------------

TAU, STEPS = 0.02, 8
MESHES = (0.5, 0.25, 0.125)
SIZES = (1e-1, 1e-2, 1e-3, 1e-4)


class Norms:
    """Norms over the time and the domain of one run, by name; ``after`` every step."""

    def __init__(self, run: nv.Simulation) -> None:
        self.run, step = run, run.rothe_step
        self._previous = GridFunction(step.layout.space)
        self._old = step.layout.fields(self._previous.components)
        self._over_time: dict[str, tuple[float, float]] = {}
        self.largest: dict[str, float] = {}
        self.gronwall = 0.0
        """The largest of gravity's power over the paper's bound M (1 + |p/sqrt(rho)|^2) |g|."""

    def advance(self) -> None:
        """A step of the run, and its share of all norms."""
        self._previous.vec.data = self.run.rothe_step.state.vec
        self.run.advance()
        self._densities(self.run.rothe_step.now)

    def _lp(self, f: CoefficientFunction, p: float) -> float:
        """The norm in L^p of a function whose square is ``f``."""
        return float(Integrate(f ** (p / 2), self.run.mesh, order=8)) ** (1 / p)

    def _sup(self, name: str, value: float) -> None:
        self.largest[name] = max(value, self.largest.get(name, 0.0))

    def _sum(self, name: str, value: float, p: float) -> None:
        """A norm in L^p(I)."""
        self._over_time[name] = (self._over_time.get(name, (0.0, p))[0] + self.run.dt * value**p, p)

    def _densities(self, u: Fields) -> None:
        old, tau, row = self._old, self.run.dt, self.run.ledger.rows[-1]
        T = self.run.fields["cauchy_stress"]
        self._sup("sup ‖√rho v‖ L2", self._lp(u.rho * square(u.v), 2))
        self._sup("sup ‖p‖ L1", self._lp(u.rho * u.rho * square(u.v), 1))
        self._sup("sup ‖T‖ L1", self._lp(square(T), 1))
        self._sup("sup ∫phi", row["stored"])
        self._sup("sup ‖rho‖ W1,r", self._lp(u.rho * u.rho + square(u.grad_rho), EXPONENT))
        grad_p = u.rho * u.grad_v + u.v.Reshape((self.run.mesh.dim, 1)) * u.grad_rho.Reshape((1, u.dim))
        self._sum("‖∇p‖ Lp(Lr)", self._lp(square(grad_p), EXPONENT), EXPONENT)
        rates = {"rho": square((u.rho - old.rho) / tau), "z": square((u.z - old.z) / tau)}
        for name, rate in rates.items():
            self._sum(f"‖∂t {name}‖ L2", self._lp(rate, 2), 2)
        self._sum("‖∂t rho‖ Lp(Lr)", self._lp(rates["rho"], EXPONENT), EXPONENT)
        self._sum("‖∂t z‖ Lp(L2)", self._lp(rates["z"], 2), EXPONENT)
        self._sum("‖∂t p‖ Lp'(L2)", self._lp(square((u.rho * u.v - old.rho * old.v) / tau), 2), 4 / 3)
        for name, part in self._parts(u).items():
            value, slope = part
            self._sup(f"sup ‖{name}‖ L2", self._lp(value, 2))
            self._sum(f"‖{name}‖ L10/3", self._lp(value, 10 / 3), 10 / 3)
            self._sum(f"‖{name}‖ L4(L3)", self._lp(value, 3), 4)
            self._sum(f"‖∇{name}‖ L2", self._lp(slope, 2), 2)
        if "Pi" in u.parts:
            Pi, slope = square(u.Pi), square(u.grad_Pi)
            self._sum("‖Pi‖ L2", self._lp(Pi, 2), 2)
            self._sum("‖∇Pi‖ Lq", self._lp(slope, EXPONENT), EXPONENT)
            self._sup("sup ‖Pi‖ W1,q", self._lp(Pi + slope, EXPONENT))
            M = u.context.rates.mandel(u)
            self._sup("sup ‖M‖ L1", self._lp(square(M), 1))
        else:
            self._sup("sup ‖dev T‖ L2", self._lp(square(dev(T)), 2))
        bound = row["mass"] * (1 + 2 * row["kinetic"]) * GRAVITY
        self.gronwall = max(self.gronwall, row["power_gravity"] / bound)

    def _parts(self, u: Fields) -> Mapping[str, tuple[CoefficientFunction, CoefficientFunction]]:
        """|z_i|^2 and |slope of z_i|^2 of every variable."""
        found = {}
        for name, where in u.layout.states.slices.items():
            value = sum((u.z[i] * u.z[i] for i in range(where.start + 1, where.stop)), u.z[where.start] ** 2)
            rows = [u.z_slope[i, j] for i in range(where.start, where.stop) for j in range(u.dim)]
            slope = sum((entry * entry for entry in rows[1:]), rows[0] * rows[0])
            found[name] = value, slope
        return found

    def values(self) -> dict[str, float]:
        """All norms, those over the time and the dissipated ones too."""
        ledger, tau = self.run.ledger, self.run.dt
        found = dict(self.largest)
        found |= {name: total ** (1 / p) for name, (total, p) in self._over_time.items()}
        viscous = ledger.column("dissipation_stokes_bulk") + ledger.column("dissipation_stokes_shear")
        found["‖D eps(v):eps(v)‖ L1"] = float(viscous.sum() * tau)
        found["‖∇²v‖ Lp"] = float(ledger.column("dissipation_hyper").sum() * tau / MU) ** (1 / EXPONENT)
        dissipated = float(ledger.column("dissipation_epsilon").sum() * tau)
        found["eps^(1/p) ‖v‖ Lp"] = dissipated ** (1 / EXPONENT)
        return found


COMMON = {
    "sup ‖√rho v‖ L2": "Euler-small-est1",
    "eps^(1/p) ‖v‖ Lp": "Euler-small-est1",
    "‖D eps(v):eps(v)‖ L1": "Euler-small-est2",
    "‖∇²v‖ Lp": "Euler-small-est2",
    "sup ∫phi": "Euler-small-est3",
    "sup ‖p‖ L1": "Euler-small-est3+++",
    "sup ‖rho‖ W1,r": "Euler-small-est10++, Euler-small-est-rho",
    "‖∇p‖ Lp(Lr)": "Euler-small-est10+",
    "‖∂t rho‖ L2": "Euler-small-est6, Euler-small-est-time-derivatives",
    "‖∂t p‖ Lp'(L2)": "Euler-small-est6+, Euler-small-est-time-derivatives+; in L2, a stronger norm",
    "‖∂t rho‖ Lp(Lr)": "Euler-small-est-time-derivatives+++",
    "‖∂t z‖ Lp(L2)": "Euler-small-est-time-derivatives+++",
}
"""Norms, and the labels of what bounds them without epsilon and delta."""

OWN = {
    "linearised": {
        "‖∂t z‖ L2": "Euler-small-est7, Euler-small-est-time-derivatives",
        "sup ‖E‖ L2": "Euler-small-est3+",
        "sup ‖T‖ L1": "Euler-small-est3+",
        "sup ‖dev T‖ L2": "Euler-small-est3+",
    },
    "finite": {
        "‖∂t z‖ L2": "Euler-large-est+",
        "sup ‖F‖ L2": "Euler-large-est3",
        "sup ‖J‖ L2": "Euler-large-est3+",
        "‖F‖ L10/3": "Euler-large-est3-10/3",
        "‖J‖ L10/3": "Euler-large-est3-10/3",
        "sup ‖T‖ L1": "Euler-large-est3-10/3",
        "sup ‖M‖ L1": "Euler-large-est3-10/3, Euler-larger-polyconvex-Mandel",
        "‖Pi‖ L2": "Euler-large-est3++",
        "‖∇Pi‖ Lq": "Euler-large-est3++",
        "sup ‖Pi‖ W1,q": "Euler-large-est-Lp",
    },
    "cofactors": {"sup ‖H‖ L2": "Euler-large-est3-H"},
}

POWERS = {
    "linearised": {"‖∇E‖ L2": (0.5, "Euler-small-est3")},
    "finite": {
        "‖∇F‖ L2": (0.75, "Euler-large-est3"),
        "‖∇J‖ L2": (0.75, "Euler-large-est3+"),
        "‖F‖ L4(L3)": (0.375, "Euler-large-est3*"),
        "‖J‖ L4(L3)": (0.375, "Euler-large-est3*"),
    },
    "cofactors": {"‖∇H‖ L2": (0.75, "Euler-large-est3-H")},
}
"""Norms that may grow like a power of 1/delta, this power, and the label."""


def estimates(
    kind: str, meshes: Mapping[float, Mesh] | None = None, sizes: Sequence[float] = SIZES, steps: int = STEPS
) -> Outcome:
    """All norms for a sequence of epsilon = delta, on meshes by their h, m (default: of ``MESHES``)."""
    meshes = meshes or {h: square_mesh(h) for h in MESHES}
    found: dict[tuple[float, float], dict[str, float]] = {}
    gronwall, densest = 0.0, 0.0
    for h, mesh in meshes.items():
        for size in sizes:
            run = whole(kind, TAU, mesh, size, size)
            norms = Norms(run)
            for _ in range(steps):
                norms.advance()
            found[h, size] = norms.values()
            gronwall = max(gronwall, norms.gronwall)
            densest = max(densest, float(run.ledger.column("rho_max").max()))
    bounded, powers = COMMON | OWN[kind], POWERS[kind]
    (coarse, fine), (small, smaller) = [list(meshes)[i] for i in (-2, -1)], sizes[-2:]
    values = {
        "largest rho": densest,
        "gravity's power over M (1 + ‖p/√rho‖²) |g|": gronwall,
    }
    rows: list[list[str | float]] = []
    for name in bounded:
        in_size = found[fine, smaller][name] / found[fine, small][name]
        in_mesh = found[fine, smaller][name] / found[coarse, smaller][name]
        values[f"growth of {name}"] = max(in_size, in_mesh)
    for name in powers:
        decades = [np.log10(found[fine, b][name] / found[fine, a][name]) for a, b in pairwise(sizes)]
        values[f"power of 1/delta in {name}"] = float(max(decades))
    for name in (*bounded, *powers):
        rows += [[name, h, *(found[h, size][name] for size in sizes)] for h in meshes]
    curves = [Curve(name, sizes, [found[fine, size][name] for size in sizes]) for name in (*bounded, *powers)]
    return measured(
        values,
        Table("norms", ["norm", "h, m", *(f"eps = delta = {size:g}" for size in sizes)], rows),
        Plot(f"Norms over eps = delta, h = {fine:g} m", "eps = delta", "norm", curves, log="xy"),
    )


def bounds(kind: str) -> tuple[Bound, ...]:
    """Those of ``estimates``."""
    growths = (
        Bound(f"growth of {name}", "<=", 1.2, f"{label}: bounded as eps, delta and h decrease")
        for name, label in (COMMON | OWN[kind]).items()
    )
    powers = (
        Bound(f"power of 1/delta in {name}", "<=", power, f"{label}: C delta^(-{power:g})")
        for name, (power, label) in POWERS[kind].items()
    )
    return (
        *growths,
        *powers,
        Bound("largest rho", "<=", RHO_MAX + 1, "Euler-small-est3+++"),
        Bound("gravity's power over M (1 + ‖p/√rho‖²) |g|", "<=", 1.0, "Euler-small-est-Gronwall"),
        CLOSURE,
    )


WHAT = {
    "linearised": "Euler-small-est, Euler-small-est+, Euler-small-est++, Euler-small-est+++",
    "finite": "Euler-large-est, Euler-large-est+, Euler-large-est-Lp",
}
"""Labels of all estimates together."""

for kind in KINDS:
    CASES(f"""whole-estimates-{kind}
        With all terms of the scheme of {KINDS[kind]} at once its a-priori estimates hold, also as the mesh is
          refined: norms neither grow over the last decade of epsilon = delta nor over the last refinement,
          and those that may grow like a power of 1/delta grow no faster.
        label: {WHAT[kind]}
        setting: {WHOLE}; h = 0.5, 0.25 and 0.125 m, {STEPS} steps of {TAU} s; epsilon = delta from 0.1 to
          1e-4.  Rates of change are measured in L2, which bounds the dual norms; slopes of z are those of the
          scheme (FORMULATION.md, Section 9).
        {each(bounds(kind))}
        """)(partial(estimates, kind))


COFACTOR_MESHES = (0.5, 0.25)

CASES(f"""whole-estimates-cofactors
    With Cof F among the variables the a-priori estimates of the finite-strain model hold, and that of Cof F:
      sup ‖H‖ is bounded, and ‖∇H‖ grows no faster than delta^(-3/4).
    label: Euler-large-est3-H, rem-polyconvex-general
    setting: {WHOLE}; MooneyRivlin with G_e = 3 Pa, G_mr = 2 Pa; h = 0.5 and 0.25 m, {STEPS} steps of {TAU} s;
      epsilon = delta from 0.1 to 1e-4.
    {each(bounds("cofactors"))}
    """)(lambda: estimates("cofactors", {h: square_mesh(h) for h in COFACTOR_MESHES}))
