"""Columns at rest under their weight: rock in a box, and a column so soft that its density grows by half.

The energy phi = K/2 (J - 2 + 1/J) has the pressure K (1 - J).  With rho = rho_R/J the pressure grows by
rho_R g/J a metre, so that J = sqrt(1 - 2 rho_R g s/K) at the depth s.
"""

import numpy as np
from ngsolve import CF, IfPos, Integrate, sqrt, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.tensors import tr
from ngvisco.physics.variables import Jacobian, LeftCauchyGreen
from tests.verification.case import Cases, Measured, Table
from tests.verification.setups import stokes

CASES = Cases("Bodies and their interfaces")

DEPTH, GRAVITY, DENSITY = 1e4, 9.81, 2700.0
"""Depth, m; gravity, m/s^2; density, kg/m^3."""
BULK, SHEAR, VISCOSITY = 5e10, 3e10, 1e9
"""Bulk and shear modulus, Pa, and viscosity, Pa s, of rock."""
SOFT = 1e9
"""Bulk modulus, Pa, of a column whose density grows by 46 % to its base."""
BASE = DENSITY * GRAVITY * DEPTH
"""Pressure at the base, 265 MPa."""
STEPS, STEP = 20, 5.0
"""Number and length of the steps, s: a wave of compression goes through the rock in 1.9 s."""


def _rock(equilibrium: str | None, density: CF, cells: tuple[int, int] = (4, 8)) -> nv.Simulation:
    material = nv.ReferentialNeoHookean(K_e=BULK, G_e=SHEAR / 2)
    start = nv.Initial(density=density, equilibrium=equilibrium)  # type: ignore[arg-type]
    model = nv.Model(material=material, viscosity=stokes(VISCOSITY), loads=(nv.Gravity((0.0, -GRAVITY)),))
    return nv.Simulation(structured_box((DEPTH, DEPTH), cells), model, dt=STEP, initial=start)


def _soft(rows: int) -> nv.Simulation:
    def energy(B: CF, J: CF) -> CF:
        return SOFT / 2 * (J - 1) * (J - 1) / J + SOFT / 4 * tr(B)

    variables = (LeftCauchyGreen(exponent=-5 / 3), Jacobian())
    material = nv.CustomMaterial(transported=variables, stored_energy=energy, rho_R=DENSITY)
    model = nv.Model(material=material, viscosity=stokes(VISCOSITY), loads=(nv.Gravity((0.0, -GRAVITY)),))
    start = nv.Initial(equilibrium="hydrostatic", datum="top")
    return nv.Simulation(structured_box((DEPTH, DEPTH), (rows // 2, rows)), model, dt=STEP, initial=start)


def _fastest(run: nv.Simulation) -> float:
    return float(run.run(STEPS * STEP).column("v_max").max())


@CASES(f"""rock-at-rest
    Ten kilometres of rock - uniform, in two layers, or so soft that the density grows by half - start with
      the pressure of the overlying weight, and stay at rest.
    label: benchmark: hydrostatic equilibrium of a compressible column
    setting: Box of {DEPTH / 1e3:g} km x {DEPTH / 1e3:g} km with slip, K = {BULK:g} Pa, G = {SHEAR:g} Pa,
      viscosity {VISCOSITY:g} Pa s, {DENSITY:g} kg/m3 (2000 over 3000 in layers of 5 km), {GRAVITY:g} m/s2;
      soft: K = {SOFT:g} Pa; 4 x 8 cells, {STEPS} steps of {STEP:g} s; J of the soft one on 8, 16 and 32 rows.
    - |pressure at the base over rho g H, less one| <= 0.001: 265 MPa: J is piecewise linear
    - error |pressure at the top| over that at the base <= 0.001: nothing lies above
    - |pressure under the layers over their weight, less one| <= 0.001: 245 MPa, kinked between cells
    - error of rest: fastest rock in 100 s, m/s <= 1e-8: the residual of equilibrium
    - error of rest: fastest layers, m/s <= 1e-8: their boundary lies between cells
    - error of rest: fastest soft column, m/s <= 0.01: J is linear in cells, the exact J is not
    - fastest rock without equilibrium, m/s in [0.1, 981]: the finding: it sags by metres
    - largest error |J/sqrt(1 - 2 rho_R g s/K) - 1| on 32 rows <= 2e-4: J is 0.685
      at the base
    - |rate of the mean error of J, less 2| <= 0.2: second order for J linear in cells
    - closure
    - drift
    """)
def _at_rest() -> Measured:
    layers = IfPos(y - DEPTH / 2, 2000.0, 3000.0)
    under = 0.5 * DEPTH * GRAVITY * 5000.0
    runs = {
        "rock": _rock("hydrostatic", CF(DENSITY)),
        "layers": _rock("hydrostatic", layers),
        "soft": _soft(8),
        "without": _rock(None, CF(DENSITY)),
    }
    p = {name: run.fields["pressure"] for name, run in runs.items()}
    at = {name: [p[name](run.mesh(0.3 * DEPTH, s)) for s in (0.0, DEPTH)] for name, run in runs.items()}
    yield "|pressure at the base over rho g H, less one|", abs(at["rock"][0] / BASE - 1)
    yield "error |pressure at the top| over that at the base", abs(at["rock"][1]) / at["rock"][0]
    yield "|pressure under the layers over their weight, less one|", abs(at["layers"][0] / under - 1)
    yield "error of rest: fastest rock in 100 s, m/s", _fastest(runs["rock"])
    yield "error of rest: fastest layers, m/s", _fastest(runs["layers"])
    yield "error of rest: fastest soft column, m/s", _fastest(runs["soft"])
    yield "fastest rock without equilibrium, m/s", _fastest(runs["without"])
    rows, errors = [], []
    for count in (8, 16, 32):
        run = _soft(count)
        exact = sqrt(1 - 2 * DENSITY * GRAVITY * (DEPTH - y) / SOFT)
        gap = run.fields["J"] / exact - 1
        errors.append(float(np.sqrt(Integrate(gap * gap, run.mesh, order=6)) / DEPTH))
        largest = float(abs(run.sampler.values(gap)).max())
        rows.append([count, errors[-1], largest, run.fields["J"](run.mesh(0.3 * DEPTH, 0.0))])
    yield "largest error |J/sqrt(1 - 2 rho_R g s/K) - 1| on 32 rows", rows[-1][2]
    yield "|rate of the mean error of J, less 2|", abs(float(np.log2(errors[-2] / errors[-1])) - 2)
    yield Table("a soft column: J against the exact one", "rows | mean error | largest | J at the base", rows)
