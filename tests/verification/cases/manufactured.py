"""Manufactured solutions: rates in space of the whole system, of bodies, and of creep with a gradient."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from ngsolve import CF, VOL, CoefficientFunction, x, y, z
from scipy.linalg import solve_banded

import ngvisco as nv
from ngvisco.forms.context import time
from ngvisco.forms.mesh.points import CellPoints
from ngvisco.forms.mesh.symmetry import NO_SYMMETRY
from ngvisco.geometries import box, disc, sphere
from tests.verification.bounds import VerificationError, each
from tests.verification.case import Cases, Curve, Measured, Plot, RateTable, Table
from tests.verification.convergence import KINDS as MODELS
from tests.verification.convergence import RULES, coefficients, coupled_rates, model, transport_rates
from tests.verification.differences import mismatch
from tests.verification.manufactured import Sources, TakingPartWholly
from tests.verification.setups import KINDS

CASES = Cases("Convergence: manufactured solutions")

# --- transport, the whole system, two bodies -----------------------------------------------------------

NAMES = {"linear": "linearised", "neo-hookean": "finite"}
LABELS = {"linear": "Euler-small-viscoelastodyn+disc", "neo-hookean": "Euler-large-viscoelastodyn+disc"}
TERMS = "creep, gravity, Stokes viscosity, hyperviscosity p = 4, delta (r = 4) and epsilon (p = 4)"


def _transport(kind: str) -> Measured:
    for m in (0, 1, 2):
        table = transport_rates(kind, m, 0.4, 3)
        yield from table.lasts(f"rate of {{}}, m = {m}")
        yield table


for kind, name, label in (
    ("linear", "linearised", "Euler-small-viscoelastodyn+0disc, Euler-small-viscoelastodyn+2disc"),
    ("neo-hookean", "finite", "DT-det-extended, ED-Euler-large2"),
):
    CASES(f"""manufactured-transport-{name}{" (reduced)" * (kind == "linear")}
        Density and fields, with the exact velocity, converge with order m + 1 in 2D.
        label: {label}
        setting: Unit square, 0.4 m refined twice, two steps of 0.25 s (CFL up to 3), m = 0, 1, 2.
        {each(f"- rate of [rho; z], m = {m} >= {m + 0.85}: order m + 1" for m in (0, 1, 2))}
        """)(partial(_transport, kind))

V_RATES = {(2, 0): 1.0, (2, 1): 1.7, (2, 2): 1.7, (3, 0): 1.0, (3, 1): 1.7, (3, 2): 2.3}
"""Required rates of v with p = 4 in 2D: 2 for k = 2 (FORMULATION.md, Section 5), and above 2 for k = 3. The
rates of the fields that are coupled to v bound those of v."""
MOMENTUM = {"linear": "Euler-small-viscoelastodyn+1disc", "neo-hookean": "Euler-large-viscoelastodyn+1disc"}
CARRIED = {
    "linear": "Euler-small-viscoelastodyn+0disc, Euler-small-viscoelastodyn+2disc",
    "neo-hookean": "DT-det-extended, ED-Euler-large2",
}
"""Labels of the equations of v, and of those of rho and z."""
_SHARP = 1.7
"""Required rate where theory gives order 2 only: of v with k = 2, and of fields transported by this v."""


def _least(dim: int, k: int, m: int) -> tuple[float, float]:
    """The required rates of v and of the fields.

    In 2D the required rate is m + 1 - 0.3. In 3D with k = 3 or m = 2 the required rate is that of theory. The
    rate of upwind transport is m + 1/2 on any mesh. The rate of v is min(k, m + 1/2), since the stress has
    the order m + 1/2. With k = 2 the rate of v is at most 2.
    """
    if dim == 3 and (k == 3 or m == 2):
        least = min(m + 0.5, _SHARP) if k == 2 else min(m + 0.5, k)
        return least, least
    return V_RATES[k, m], min(m + 0.7, 2.3 if k == 3 else _SHARP)


@dataclass(frozen=True)
class Series:
    """Meshes for velocities of the order k and fields of the orders ``degrees``, m."""

    dim: int
    k: int
    degrees: tuple[int, ...] = (0, 1, 2)


SERIES = (Series(2, 2), Series(2, 3), Series(3, 2, (0, 1)), Series(3, 2, (2,)), Series(3, 3))
MESHES = {
    2: (0.4, 3, "unit square, 0.4 m refined twice"),
    3: (1.0, 3, "unit cube, 12 tetrahedra refined twice to 768"),
}
"""Size of the first mesh's cells, m, number of meshes, and their description."""


def _measure(kind: str, series: Series) -> Measured:
    curves, k, (maxh, levels, _) = [], series.k, MESHES[series.dim]
    for m in series.degrees:
        # the delta-terms need gradients of the fields
        table = coupled_rates(kind, series.dim, 4.0, k, m, maxh, levels, regularised=True, delta=m > 0)
        yield from table.lasts(f"rate of {{}}, k = {k}, m = {m}")
        yield table.table()
        of = f"k = {k}, m = {m}"
        curves += [Curve(f"{name}, {of}", table.sizes, errors) for name, errors in table.errors.items()]
    title = f"All terms, {kind}, {series.dim}D, k = {k}"
    yield Plot(title, "h, m", "L2 error", curves, log="xy")


for kind in NAMES:
    for series in SERIES:
        order = "" if series.k == 2 else f"-k{series.k}"
        if series.degrees == (2,):
            order += "-m2"
        claim = "v with order 2" if series.k == 2 else "v with an order above 2 (p = 4 limits it) for m = 2"
        fields = "m + 1"
        if series.dim == 3 and (series.k == 3 or 2 in series.degrees):
            fields = "m + 1/2 at least"
        rates = [
            f"- rate of {what}, k = {series.k}, m = {m} >= {least}: {reason}"
            for m in series.degrees
            for what, least, reason in zip(
                ("v", "[rho; z]"),
                _least(series.dim, series.k, m),
                (
                    f"the lifted penalty with p = 4; {MOMENTUM[kind]}",
                    f"order {fields}, but not above v's; {CARRIED[kind]}",
                ),
                strict=True,
            )
        ]
        reduced = " (reduced)" * (series == SERIES[0] and kind == "linear")
        CASES(f"""manufactured-{series.dim}d{order}-{NAMES[kind]}{reduced}
            With k = {series.k} the whole system with all its terms converges in space in {series.dim}D:
              {claim}, rho and z with order {fields}, but with no higher order than v admits.
            label: {LABELS[kind]}
            setting: {TERMS} (delta only for m >= 1); {MESHES[series.dim][2]}; two steps of 0.05 s with the
              discrete time derivative in the sources; the solver chosen by itself (3D: the split one).
            {each(rates)}
            """)(partial(_measure, kind, series))


_BODIES = {(2, 0): 1.0, (2, 1): 2.7, (3, 2): 3.3}
"""Required rates of v for two bodies without hyperviscosity, by k and m."""

_ABOVE_Z, _AS_ELSEWHERE = "order k + 1, but one above z at most", "order m + 1, less 0.3 as elsewhere"


@CASES(f"""manufactured-bodies
    Two bodies of different stiffness, viscosity, creep and density that share every point converge in space:
      amounts and tensors with order m + 1.
    label: FORMULATION.md, Section 9
    setting: Fractions of 0.15 to 0.36 and 0.64 to 0.85; each with its own tensor, creep and viscosity, one
      volumetric energy, gravity; unit square, 0.4 m refined twice, two steps of 0.05 s.  The control's
      sources stretch the amount of a body as a whole.
    {each(f"- rate of v, k = {k}, m = {m} >= {v}: {_ABOVE_Z}" for (k, m), v in _BODIES.items())}
    {each(f"- rate of [rho; z], k = {k}, m = {m} >= {m + 0.7}: {_AS_ELSEWHERE}" for k, m in _BODIES)}
    - rate of z, control <= 1.0: the control solves another equation
    """)
def _bodies() -> Measured:
    for k, m in _BODIES:
        table = coupled_rates("two bodies", 2, None, k, m, 0.4, 3)
        yield from table.lasts(f"rate of {{}}, k = {k}, m = {m}")
        yield table
    wrong = coupled_rates("two bodies", 2, None, 2, 1, 0.4, 3, sources=TakingPartWholly)
    yield "rate of z, control", wrong.last("z")
    yield wrong.table()
    yield "For rho and z m + 0.8 was written first, of which rho with m = 2 had 2.793 after 2.55."


# --- creep with a gradient term, nu > 0 ----------------------------------------------------------------

CASES.theme = "Creep with a gradient"

NU = 0.1
LABEL = {
    "linear": "Euler-small-flow-rule",
    "neo-hookean": "ED-Euler-large3, Euler-large-viscoelastodyn+4disc",
}

AGREES = 1e-6
"""Admitted relative error of the analytic sources against differences of eighth order."""


def _with_gradient(kind: str, dim: int) -> Measured:
    """Compare the sources with finite differences, and measure rates in space."""
    sources = Sources(model(kind, dim, 4.0, True, nu=NU), dim, 0.05)
    differences, control = (
        mismatch(coefficients(kind, 4.0, True, nu), sources, kind, 0.3, box((1,) * dim, 1.0))
        for nu in (NU, 1.01 * NU)
    )
    maxh, levels, _ = MESHES[dim]
    table = coupled_rates(kind, dim, 4.0, 2, 1, maxh, levels, regularised=True, nu=NU)
    yield "largest difference of a source and its independent residual", max(differences.values())
    yield "difference of the flow rule with a nu that is 1 % off", control["Pi"]
    yield from table.lasts()
    yield Table(
        "relative differences at eight random points", "equation | difference", [*differences.items()]
    )
    yield table


for kind in NAMES:
    for dim in (2, 3):
        name = NAMES[kind]
        CASES(f"""creep-gradient-{dim}d-{name}{" (reduced)" * (dim == 2 and kind == "linear")}
            With nu > 0 the whole system of {KINDS[name]} with all its terms converges in space in {dim}D,
              including the creep rate; the source of the creep rate agrees with an independent residual.
            label: {LABEL[kind]}, {LABELS[kind]}
            setting: {TERMS}, nu = {NU} with q = 4; {MESHES[dim][2]}; k = 2, m = 1, two steps of 0.05 s with
              the discrete time derivative in the sources; Pi of order 1 with (n . grad) Pi = 0.
            - largest difference of a source and its independent residual <= {AGREES}: differences
            - difference of the flow rule with a nu that is 1 % off >= {10 * AGREES}: the negative control
            - rate of [v; rho; z; Pi] >= 1.7: order 2 of the penalty with p = 4 and of m = 1
            """)(partial(_with_gradient, kind, dim))


# --- flow rules of a potential that is not quadratic ------------------------------------------------------

NONLINEAR = ("Norton", "Eyring", "Perzyna")
FIELDS = {"linear": "E", "neo-hookean": "F", "by B": "B"}


class Stiffer(Sources):
    """Sources of a flow rule whose psi' is a tenth larger."""

    @property
    def creep(self) -> CoefficientFunction:
        rule, residual = self.model.creep, super().creep
        assert rule is not None and residual is not None
        return residual + 0.1 * rule.force(self.new.Pi, self.new.values)


@CASES(f"""creep-gradient-flow-rules
    With nu > 0 and a creep rate that varies in space, flow rules whose potential is not quadratic converge in
      space, by E, by F and by B; their sources agree with the literature's formulas.
    label: Euler-small-flow-rule, ED-Euler-large3, Euler-large-viscoelastodyn+4disc
    setting: Norton (n = 3), Eyring, Perzyna (n = 2, psi smoothed below |Pi| = 1e-4/s); |Pi| from 0 at a
      point, where psi'' of the first is infinite and psi' of the last jumps, to 0.6/s; nu = {NU}, q = 4;
      creep, gravity, Stokes viscosity; unit square, 0.4 m refined twice; k = 2, m = 1, two steps of 0.05 s.
    - largest difference of a source and its independent residual <= {AGREES}: differences
    - least difference of a flow rule with a constant that is 1 % off >= {10 * AGREES}: the negative control
      of the formulas
    - least rate of v >= 2.5: k + 1 of v, but not above Pi's by half; m + 1
    - least rate of [rho; z; Pi] >= 1.75: k + 1 of v, but not above Pi's by half; m + 1
    - largest rate of Pi, control with psi' a tenth off <= 1.0: an error stays
    """)
def _of_rules() -> Measured:
    """Measure rates in space for every rule and material; compare the rules with their formulas by
    differences."""
    t, mesh, largest, least, controls = 0.3, box((1, 1), 1.0), 0.0, np.inf, []
    found: dict[str, list[float]] = {name: [] for name in ("v", "rho", "z", "Pi")}
    for rule in NONLINEAR:
        for kind in MODELS:
            sources = Sources(model(kind, 2, None, nu=NU, rule=rule), 2, 0.05)
            right = coefficients(kind, None, nu=NU, rule=rule)
            largest = max(largest, *mismatch(right, sources, kind, t, mesh).values())
            for name in RULES[rule][1]:
                wrong = replace(right, **{name: 1.01 * getattr(right, name)})
                least = min(least, mismatch(wrong, sources, kind, t, mesh)["Pi"])
        for kind, tensor in FIELDS.items():
            table = coupled_rates(kind, 2, None, 2, 1, 0.4, 3, nu=NU, rule=rule)
            table.title = f"{rule} by {tensor}"
            for name in found:
                found[name].append(table.last(name))
            yield table.table()
        control = coupled_rates("neo-hookean", 2, None, 2, 1, 0.4, 3, nu=NU, rule=rule, sources=Stiffer)
        controls.append(control.last("Pi"))
    yield "largest difference of a source and its independent residual", largest
    yield "least difference of a flow rule with a constant that is 1 % off", least
    for name, rates in found.items():
        yield f"least rate of {name}", min(rates)
    yield "largest rate of Pi, control with psi' a tenth off", max(controls)


# --- an independent creep rate -----------------------------------------------------------------------------

G_E, G_M, Q = 1.0, 2.0, 4.0
DIRECTION = np.array([[1.0, 0.5, 0.0], [0.5, -0.4, 0.0], [0.0, 0.0, -0.6]])
DIRECTION /= np.linalg.norm(DIRECTION)
STRENGTH = 0.3
"""The coefficient nu, W/m^3 (m s)^4, which halves the creep rate at the centre."""


def profile(square: Any) -> Any:
    """The strain's amplitude as a function of r^2, which is an array or a coefficient function."""
    return 0.5 - 2.0 * square + 1.2 * square * square


def radial_creep(
    dim: int, nu: float, q: float, driving: Callable[[np.ndarray], np.ndarray], intervals: int = 4000
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes r and values a(r) of Pi = a(r) D in the unit disc or ball for a driving stress M = m(r) D.

    a minimises int (G_m a^2/2 + nu |a'|^q/q - m a) r^{d-1} dr. The minimiser is computed with linear elements
    and a damped Newton iteration in NumPy, independently of the package's forms and spaces.
    """
    points, weights = np.polynomial.legendre.leggauss(4)
    r, h, share = np.linspace(0.0, 1.0, intervals + 1), 1 / intervals, 0.5 * (points + 1)
    at = r[:-1, None] + h * share
    volume, shapes = 0.5 * h * weights * at ** (dim - 1), np.stack([1 - share, share])
    mass, size = G_M * np.einsum("cp,ap,bp->abc", volume, shapes, shapes), volume.sum(axis=1)

    def gathered(of_cells: np.ndarray) -> np.ndarray:
        """Sum values at the cells' ends, (2, cells), over the nodes."""
        return np.append(of_cells[0], 0.0) + np.append(0.0, of_cells[1])

    load = gathered(np.stack([(volume * driving(at) * s).sum(axis=1) for s in shapes]))

    def energy(a: np.ndarray) -> float:
        ends, slope = np.stack([a[:-1], a[1:]]), np.diff(a) / h
        squares = np.einsum("abc,ac,bc->", mass, ends, ends)
        return float(0.5 * squares + nu / q * (size * abs(slope) ** q).sum() - load @ a)

    a = driving(r) / G_M
    for _ in range(200):
        ends, slope = np.stack([a[:-1], a[1:]]), np.diff(a) / h
        flux = nu * size * abs(slope) ** (q - 2) * slope / h
        residual = gathered(np.einsum("abc,bc->ac", mass, ends) + np.stack([-flux, flux])) - load
        stiff = nu * (q - 1) * size * abs(slope) ** (q - 2) / h**2
        matrix = np.zeros((3, intervals + 1))
        matrix[1] = gathered(np.stack([mass[0, 0], mass[1, 1]]) + stiff)
        matrix[0, 1:] = matrix[2, :-1] = mass[0, 1] - stiff
        step = solve_banded((1, 1), matrix, -residual, check_finite=False)
        damping, before, along = 1.0, energy(a), residual @ step
        if -along <= 1e-15 * abs(before):
            return r, a
        while energy(a + damping * step) > before + 1e-4 * damping * along and damping > 1e-10:
            damping *= 0.5
        a = a + damping * step
    raise VerificationError("the radial creep rate has not converged")


def solved(dim: int, maxh: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Pi, (points, 9), r and weights at quadrature points after one step of 1e-8 s, in which nothing moves.

    The last value is the mean size of cells, (|Omega|/cells)^(1/dim), m, because the size given to the mesher
    is none: in a ball, 0.4 m gives only twice as many cells as 0.8 m, not eight times as many.
    """
    mesh = disc(1.0, maxh) if dim == 2 else sphere(1.0, maxh)
    square = x * x + y * y + (z * z if dim == 3 else 0.0)
    E = profile(square) * CF(tuple(DIRECTION.ravel().tolist()), dims=(3, 3))
    time.Set(0.0)
    run = nv.Simulation(
        mesh,
        nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=G_E), creep=nv.Creep(G_m=G_M, nu=STRENGTH, q=Q)),
        dt=1e-8,
        initial=nv.Initial(values={"E": E}),
        discretisation=nv.Discretisation(k=2, m=2),
    )
    run.advance()
    points = CellPoints(mesh, 4, NO_SYMMETRY)
    at = mesh.MapToAllElements(points.rules, VOL)
    Pi, r = np.asarray(run.rothe_step.now.Pi(at)).reshape(-1, 9), np.sqrt(np.asarray(square(at)).ravel())
    return Pi, r, points.weights, float((points.weights.sum() / mesh.ne) ** (1 / dim))


def independent(dim: int, sizes: tuple[float, ...]) -> Measured:
    """Compare Pi for M = m(r) D with the minimiser in one dimension."""

    def driving(r: np.ndarray) -> np.ndarray:
        return np.asarray(2 * G_E * profile(r * r))

    nodes, a = radial_creep(dim, STRENGTH, Q, driving)
    table = RateTable(f"relative L2 error of Pi, {dim}D, m = 2", "(|Omega|/cells)^(1/d), m")
    for maxh in sizes:
        Pi, r, weights, h = solved(dim, maxh)
        exact = np.interp(r, nodes, a)
        gap = ((Pi - exact[:, None] * DIRECTION.ravel()) ** 2).sum(axis=1)
        without = (driving(r) / G_M - exact) ** 2
        error, control = (((weights @ of) / (weights @ exact**2)) ** 0.5 for of in (gap, without))
        table.add(h, Pi=float(error))
    yield "relative L2 error of Pi on the finest mesh", table.errors["Pi"][-1]
    yield "rate of Pi", table.last("Pi")
    yield "relative L2 distance of M/G_m from the reference", control
    yield table


for dim, sizes, largest, rate in ((2, (0.5, 0.25, 0.125), 2e-3, 1.7), (3, (0.8, 0.4, 0.3), 0.06, 1.5)):
    shape = "disc" if dim == 2 else "ball"
    CASES(f"""creep-gradient-{shape}
        For a driving stress that varies along the radius of a {shape} the creep rate is the minimiser of its
          potential, computed in one dimension without the package.
        label: ED-Euler-large3, Euler-large-viscoelastodyn+4disc
        setting: Unit {shape}, E = (0.5 - 2 r² + 1.2 r⁴) D, G_e = 1 Pa, G_m = 2 Pa s, nu = {STRENGTH}, q = 4;
          one step of 1e-8 s; k = 2, m = 2, curved cells of {", ".join(map(str, sizes))} m.
        - relative L2 error of Pi on the finest mesh <= {largest}: a few cells over the radius
        - rate of Pi >= {rate}: a' is like r^(1/3) at the centre and like (1 - r)^(1/3) at the wall: two, not
          three
        - relative L2 distance of M/G_m from the reference >= 0.2: nu is not small: the control
        """)(partial(independent, dim, sizes))
