"""Manufactured solutions: rates of the transport alone."""

from functools import partial

from tests.verification.case import Cases, Curve, Outcome, Plot, each, measured
from tests.verification.convergence import transport_rates

CASES = Cases()

NAMES = {"linear": "linearised", "neo-hookean": "finite"}
LABELS = {"linear": "Euler-small-viscoelastodyn+disc", "neo-hookean": "Euler-large-viscoelastodyn+disc"}
TERMS = "creep, gravity, Stokes viscosity, hyperviscosity p = 4, delta (r = 4) and epsilon (p = 4)"


def _transport(kind: str, dim: int, orders: tuple[int, ...], maxh: float, levels: int) -> Outcome:
    values, tables, curves = {}, [], []
    for m in orders:
        table = transport_rates(kind, dim, m, maxh, levels)
        tables.append(table.table("h, m"))
        for name in table.errors:
            values[f"rate of {name}, m = {m}"] = table.last(name)
            curves.append(Curve(f"{name}, m = {m}", table.sizes, table.errors[name]))
    plot = Plot(f"Transport alone, {kind}, {dim}D", "h, m", "L2 error", curves, log="xy")
    return measured(values, *tables, plot)


for kind, name, label in (
    ("linear", "linearised", "Euler-small-viscoelastodyn+0disc, Euler-small-viscoelastodyn+2disc"),
    ("neo-hookean", "finite", "DT-det-extended, ED-Euler-large2"),
):
    CASES(f"""manufactured-transport-{name}{" (reduced)" * (kind == "linear")}
        Density and fields alone, with the exact velocity, converge with order m + 1 in 2D.
        label: {label}
        setting: Unit square, 0.4 m refined twice, two steps of 0.25 s (CFL up to 3), m = 0, 1, 2.
        {each(f"- rate of [rho; z], m = {m} >= {m + 0.85}: order m + 1" for m in (0, 1, 2))}
        """)(partial(_transport, kind, 2, (0, 1, 2), 0.4, 3))
    CASES(f"""manufactured-transport-3d-{name}
        Density and fields alone converge with at least order m + 1/2 in 3D.
        label: {label}
        setting: Unit cube, 12 tetrahedra refined twice (m = 0, 1) to 768, two steps of 0.25 s.
        {each(f"- rate of [rho; z], m = {m} >= {m + 0.5}: the theory of upwind transport" for m in (0, 1))}
        """)(partial(_transport, kind, 3, (0, 1), 1.0, 3))
