"""Finds a soft spot below a surface from the surface's displacements: fifty numbers by adjoints.
Run with ``python demos/soft_spot/soft_spot.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import CF, IfPos, Integrate, exp, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box

COLUMNS, ROWS, STATIONS = 10, 5, 19
NOISE, SMOOTH, UNTIL = 2e-5, 3.0, 2.0
"""Standard deviation of displacements, m; weight of ln(G_i/G_j) for neighbouring blocks; end of the run,
s."""
TRUE = 3 - 2 * exp(-(((x - 2.6) / 0.5) ** 2) - ((y - 0.7) / 0.25) ** 2)
"""The stiffness of the ground from which the data are computed, Pa."""


def blocks() -> list:
    """Indicators of the blocks of 0.4 m x 0.2 m, row by row."""
    along = [IfPos(x - 0.4 * i, IfPos(0.4 * (i + 1) - x, 1.0, 0.0), 0.0) for i in range(COLUMNS)]
    up = [IfPos(y - 0.2 * j, IfPos(0.2 * (j + 1) - y, 1.0, 0.0), 0.0) for j in range(ROWS)]
    return [a * b for b in up for a in along]


def simulation(stiffness=3.0, cells=(COLUMNS, ROWS), **options) -> nv.Simulation:
    """A layer of 4 m x 1 m on a rigid ground, pulled at its surface by up to 0.02 Pa; it rests after 2 s."""
    model = nv.Model(
        material=nv.LinearElastic(K_e=10, G_e=stiffness), viscosity=nv.StokesViscosity(K_v=1.0, G_v=1.0)
    )
    walls = {"top": nv.Traction(f=(0.02 * exp(-((x - 2) ** 2) / 2), 0.0)), "bottom": nv.NoSlip()}
    at = np.arange(1, STATIONS + 1) * 4.0 / (STATIONS + 1)
    probes = nv.Probes({f"s{i}": (float(a), 1.0) for i, a in enumerate(at)}, ["velocity"])
    given = {"dt": 0.25, "scheme": "backward-euler", "walls": walls, "observers": [probes]}
    return nv.Simulation(structured_box((4, 1), cells), model, **given | options)


def field(numbers) -> object:
    """The stiffness, Pa, constant in blocks, from the logarithms of its values over 3 Pa."""
    values = (3 * np.exp(numbers)).reshape(ROWS, COLUMNS).tolist()

    def cascade(parts: list, coordinate, width: float):
        whole = parts[-1]
        for i in range(len(parts) - 2, -1, -1):
            whole = IfPos(width * (i + 1) - coordinate, parts[i], whole)
        return whole

    return cascade([cascade(row, x, 0.4) for row in values], y, 0.2)


def displacements() -> dict[str, float]:
    """Displacements at the stations, with noise, of the true ground."""
    run, of = simulation(TRUE), [f"s{i}.velocity_1 until {UNTIL}" for i in range(STATIONS)]
    values = nv.gradient(run, UNTIL, of=of, by=["viscosity.G_v"]).values
    return dict(zip(of, values + NOISE * np.random.default_rng(1).standard_normal(STATIONS), strict=True))


def linearised(numbers: np.ndarray, data: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Residuals over the noise, and their derivatives by the fifty numbers, with one adjoint a station."""
    run = simulation(nv.Parameter("stiffness", start=field(numbers)))
    found = nv.gradient(run, UNTIL, of=list(data), method="adjoint")
    densities = [found.density(name, "stiffness") for name in data]
    of_blocks = CF(tuple(blocks()))
    rows = [Integrate(density * of_blocks, run.mesh, order=3) for density in densities]
    return (found.values - list(data.values())) / NOISE, np.array(rows) * 3 * np.exp(numbers) / NOISE


def differences() -> np.ndarray:
    """The matrix of Tikhonov's term, which takes differences of neighbouring blocks, (pairs, blocks)."""
    unit = np.eye(COLUMNS * ROWS).reshape(ROWS, COLUMNS, -1)
    pairs = [np.diff(unit, axis=axis).reshape(-1, COLUMNS * ROWS) for axis in (0, 1)]
    return SMOOTH * np.concatenate(pairs)


def main(directory: str = "results/soft_spot", iterations: int = 4) -> np.ndarray:
    data, numbers, smooth = displacements(), np.zeros(COLUMNS * ROWS), differences()
    for _ in range(iterations):  # Gauss-Newton
        off, J = linearised(numbers, data)
        print(f"half the sum of squares of {STATIONS} residuals: {0.5 * off @ off:.5g}")
        rows, right = np.vstack([J, smooth]), np.concatenate([off, smooth @ numbers])
        numbers = numbers - np.linalg.lstsq(rows, right, rcond=None)[0]
    Path(directory).mkdir(parents=True, exist_ok=True)
    shown = [("true stiffness, Pa", TRUE), ("found, Pa", field(numbers))]
    nv.plot_fields(simulation().mesh, shown, Path(directory) / "soft_spot.png")
    return numbers


if __name__ == "__main__":
    main(*sys.argv[1:2])
