"""The run that the tests of this folder differentiate, and its results and parameters."""

from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box
from tests.verification.cases.sensitivities import measure

UNTIL = 0.06
"""End of the runs, s."""
OF = {
    "motion": "kinetic at 0.06",
    "elasticity": "stored at 0.06",
    "creep": "dissipation_creep at 0.06",
    "loss": "dissipation_creep until 0.06",
    "speed": "p.velocity_1 at 0.05",
    "stress": "p.cauchy_stress_12 at 0.06",
    "way": "p.velocity_2 until 0.06",
    "share": "share at 0.06",
    "spin": "angular_momentum at 0.06",
}
AT = {
    "material.G_e": 5.0,
    "creep.G_m": 2.0,
    "viscosity.G_v": 0.05,
    "loads.gravity.g.1": -1.0,
    "initial.density": 1.0,
}
MESH = box((1, 1), maxh=0.8)
VELOCITY = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))


def run(values=AT, scheme="midpoint", solver="coupled", mesh=MESH, **options):
    stiffness, creep, viscosity, gravity, density = values.values()
    model = nv.Model(
        material=nv.NeoHookean(K_e=10, G_e=stiffness, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=viscosity),
        creep=nv.Creep(G_m=creep),
        loads=[nv.Gravity((0, gravity))],
    )
    return started(model, density, scheme, solver, mesh, **options)


def started(model, density=1.0, scheme="midpoint", solver="coupled", mesh=MESH, **options):
    observers = [
        nv.Probes({"p": (0.3, 0.6)}, ["velocity", "cauchy_stress"]),
        nv.WallForces(["bottom"]),
        nv.Integrals({"share": "x*density*velocity_1**2"}),
    ]
    given = {"dt": 0.02, "velocity_scale": 1.0, "observers": observers} | options
    given.setdefault("initial", nv.Initial(density=density, velocity=VELOCITY))
    newton = nv.NewtonOptions(tolerance=1e-12, method=solver)
    return nv.Simulation(mesh, model, scheme=scheme, newton=newton, **given)


def differences(name, h, of=OF, **options):
    """Central differences of whole runs by a parameter of ``AT``."""
    up, down = (measure(run(AT | {name: AT[name] + s * h}, **options), UNTIL, of) for s in (1, -1))
    return (up - down) / (2 * h)
