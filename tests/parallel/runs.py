"""Runs small cases by one or several processes; the first rank prints their ledgers as JSON.

``test_runs`` runs this script.  The cases are scripts for one process: ``Simulation`` distributes the mesh.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import own
import walls
from ngsolve import CoefficientFunction, IfPos, cos, exp, pi, sin, x, y, z
from own import NEO_HOOKEAN, SWIRL
from walls import TWO_LEVELS

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.geometries import disc as round_disc
from ngvisco.parallel.communicator import TRAFFIC, Communicator
from ngvisco.physics.variables import Concentration, Jacobian, ReciprocalJacobian
from ngvisco.reduced.residual import Evaluation
from ngvisco.run.passive import NAMES
from ngvisco.solver.options import SplitOptions
from ngvisco.solver.split import preconditioner
from ngvisco.solver.split.preconditioner import Preconditioner

preconditioner.JOINED = 0  # several ranks have no normal derivatives in the tangent, however small the mesh

VISCOSITY = nv.StokesViscosity(K_v=0.05, G_v=0.05)
KRYLOV = nv.NewtonOptions(split=SplitOptions(slow=4))
REGULARISED = nv.Regularisation(delta_density=1e-3, delta_fields=1e-2, epsilon=0.1, rho_max=1.0)
DELTA = nv.Regularisation(delta_density=1e-3, delta_fields=1e-2)
CUT_OFF = nv.Regularisation(rho_max=1.0, width=0.5)


def gravity(dim: int) -> nv.Gravity:
    return nv.Gravity((0.0,) * (dim - 1) + (-1.0,))


def solid(dim: int, is_hyperviscous: bool = True) -> nv.Model:
    hyper = nv.HyperViscosity(mu=1e-4, p=4) if is_hyperviscous else None
    return nv.Model(material=NEO_HOOKEAN, viscosity=VISCOSITY, hyperviscosity=hyper, loads=[gravity(dim)])


def swirl(maxh: float, **options) -> nv.Simulation:
    options = {"dt": 0.02, "initial": nv.Initial(velocity=SWIRL), "solver": "coupled"} | options
    return nv.Simulation(box((1, 1), maxh=maxh), solid(2), **options)


def block(solver: str = "coupled", maxh: float = 0.9, **options) -> nv.Simulation:
    model, initial = solid(3, is_hyperviscous=solver == "split"), nv.Initial(velocity=(*SWIRL, 0.0))
    mesh = box((1, 1, 1), maxh=maxh)
    return nv.Simulation(mesh, model, dt=0.02, initial=initial, solver=solver, **options)


def disc(solver: str) -> nv.Simulation:
    inside = 1 - x * x - y * y
    return nv.Simulation(
        round_disc(1.0, maxh=0.4),
        solid(2),
        dt=0.02,
        initial=nv.Initial(velocity=(-y * inside, x * inside)),
        walls={"wall": nv.NoSlip()},
        solver=solver,
    )


def regularised(
    solver: str, dim: int, law: nv.Regularisation, maxh: float, density: CoefficientFunction | None = None
) -> nv.Simulation:
    """A swirl in which the density of half of the body exceeds the cut-off's."""
    model = nv.Model(material=NEO_HOOKEAN, viscosity=VISCOSITY, regularisation=law, loads=[gravity(dim)])
    initial = nv.Initial(velocity=(*SWIRL, 0.0)[:dim], density=density)
    return nv.Simulation(box((1,) * dim, maxh=maxh), model, dt=0.02, initial=initial, solver=solver)


def crowded(solver: str) -> nv.Simulation:
    """A density that jumps to 1.247 at the start; in the fifth step it is limited to the cut-off's bound
    1.25."""
    law = nv.Regularisation(delta_density=1e-4, delta_fields=1e-4, rho_max=1.0, width=0.25)
    return regularised(solver, 2, law, 0.25, density=1 + 0.158 * IfPos(x - 0.5, 1, 0))


def lid(solver: str = "coupled", maxh: float = 0.3) -> nv.Simulation:
    walls = {
        "top": nv.PrescribedTangential((x * (1 - x), 0.0)),
        "bottom": nv.NoSlip(),
        "left": nv.NavierFriction(0.3),
    }
    model = nv.Model(material=NEO_HOOKEAN, viscosity=VISCOSITY)
    mesh = box((1, 1), maxh=maxh)
    return nv.Simulation(mesh, model, dt=0.05, walls=walls, scheme="midpoint", solver=solver)


def window(solver: str = "coupled") -> nv.Simulation:
    """A run with walls that matter crosses; their values and stresses change in time and place."""
    walls = {
        "left": nv.Inflow(velocity=(y * (1 - y), 0.0), density=1 + 0.1 * y, values={"J": 1 + 0.1 * nv.time}),
        "right": nv.Open(
            pressure=-15 + y, traction=(0.0, nv.time), impedance=(0.3, 0.1), density=0.9, stiffness=(9, 4)
        ),
        "bottom": nv.NoSlip(),
    }
    model = nv.Model(material=NEO_HOOKEAN, viscosity=VISCOSITY)
    return nv.Simulation(box((1, 1), maxh=0.3), model, dt=0.02, walls=walls, scheme="midpoint", solver=solver)


def channel(solver: str = "coupled", **options) -> nv.Simulation:
    """A channel with a sliding lid, periodic in the direction of a force: leaving matter enters again."""
    walls = {"top": nv.PrescribedTangential((0.5, 0.0)), "bottom": nv.NoSlip()}
    loads = [nv.Gravity((3.0, 0.0))]
    hyper = nv.HyperViscosity(mu=1e-4, p=4)
    model = nv.Model(material=NEO_HOOKEAN, viscosity=VISCOSITY, hyperviscosity=hyper, loads=loads)
    initial = nv.Initial(velocity=(4.0, 0.5 * sin(pi * y)))
    mesh = box((1, 1), maxh=0.25, periodic="x")
    return nv.Simulation(mesh, model, dt=0.05, walls=walls, initial=initial, solver=solver, **options)


def crystal(solver: str, law: nv.Regularisation | None = None) -> nv.Simulation:
    """A cell of a body that is periodic in all directions, and drifts along a diagonal."""
    hyper = None if law else nv.HyperViscosity(mu=1e-4, p=4)
    model = nv.Model(material=NEO_HOOKEAN, viscosity=VISCOSITY, hyperviscosity=hyper, regularisation=law)
    wave = (1 + sin(2 * pi * y), 2 + cos(2 * pi * x), 1.0)
    mesh = structured_box((1, 1, 1), (3, 3, 3), periodic="xyz")
    return nv.Simulation(mesh, model, dt=0.05, initial=nv.Initial(velocity=wave), solver=solver)


def creep(
    solver: str = "coupled",
    regularisation: nv.Regularisation | None = REGULARISED,
    maxh: float = 0.5,
    **options,
) -> nv.Simulation:
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        viscosity=VISCOSITY,
        creep=nv.Creep(G_m=2.0, nu=1e-3, q=4),
        regularisation=regularisation,
    )
    initial = nv.Initial(velocity=SWIRL)
    mesh = box((1, 1), maxh=maxh)
    return nv.Simulation(mesh, model, dt=0.02, initial=initial, solver=solver, **options)


def limited() -> nv.Simulation:
    """A body under a lid of full speed; near the lid's corners cells are limited in the ninth step."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
    )
    walls = {"top": nv.PrescribedTangential((1.0, 0.0)), ("left", "right", "bottom"): nv.NoSlip()}
    mesh = box((1, 1), maxh=0.25)
    return nv.Simulation(mesh, model, dt=0.05, walls=walls, scheme="midpoint", solver="coupled")


STIFF = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)
FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 4 * (J - 2 + 1 / J))


def bodies(solver: str, maxh: float = 0.4) -> nv.Simulation:
    """A disc and a layer in a fluid; overshoots of their amounts are limited in every step."""
    disc = {"where": nv.Ball((0.6, 0.5), 0.25), "order": 1, "viscosity": VISCOSITY}
    parts = [
        nv.Body(name="disc", material=STIFF, density=2.0, **disc),
        nv.Body(name="layer", where=0.4 - y, material=STIFF, density=3.0, viscosity=VISCOSITY),
        nv.Body(name="rest", material=FLUID, density=1.0, viscosity=VISCOSITY),
    ]
    model = nv.Model(bodies=parts, hyperviscosity=nv.HyperViscosity(mu=1e-5))
    initial = nv.Initial(velocity=SWIRL)
    mesh = box((1, 1), maxh=maxh)
    return nv.Simulation(
        mesh,
        model,
        dt=0.02,
        initial=initial,
        newton=nv.NewtonOptions(method=solver, tolerance=1e-12),
        observers=[nv.Bodies()],
        scheme="midpoint",
    )


def apart(solver: str, dim: int = 2, outlines: bool = False) -> nv.Simulation:
    """Sharp bodies, separated by planes or by ``outlines``. Two bodies meet in a fluid, with films of fluid
    in shared cells; periodic in the plane."""
    laws = {"viscosity": VISCOSITY, "density": 1.0}
    solid = nv.ReferentialNeoHookean(K_e=8.0, G_e=2.0)
    centre = (0.5, 0.55, 0.5)[:dim]
    parts = [
        nv.Body(name="ball", where=nv.Ball(centre, 0.25), material=solid, order=1, **laws),
        nv.Body(name="layer", where=0.35 - y, material=solid, **laws),
        nv.Body(name="rest", material=FLUID, **laws),
    ]
    periodic = {"periodic": "x"} if dim == 2 else {}
    return nv.Simulation(
        structured_box((1,) * dim, (6, 5) if dim == 2 else (3, 3, 2), **periodic),
        nv.Model(bodies=parts),
        dt=0.04,
        initial=nv.Initial(velocity=(1 + y, 0.0) if dim == 2 else (*SWIRL, 0.0)),
        discretisation=nv.Discretisation(sharp=True, outlines=outlines),
        newton=nv.NewtonOptions(method=solver, tolerance=1e-12),
        observers=[nv.Bodies(measures=["outline"] if dim == 2 else [])],
        scheme="midpoint",
    )


def broken(solver: str) -> nv.Simulation:
    """A body that breaks, in a fluid with another bulk modulus; periodic."""
    rubber = nv.ReferentialNeoHookean(K_e=8.0, G_e=2.0)
    law = nv.Damaged(material=rubber, G_c=0.1, length=0.6, viscosity=0.01, floor=1e-3)
    parts = [
        nv.Body(name="ball", where=nv.Ball((0.5, 0.5), 0.3), material=law, density=1.0, viscosity=VISCOSITY),
        nv.Body(name="rest", material=FLUID, density=1.0, viscosity=VISCOSITY),
    ]
    seed = {"damage_ball": 0.3 * exp(-20 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))}
    mesh = structured_box((1, 1), (5, 4), periodic="x")
    initial = nv.Initial(velocity=(1 + y, 0.0), values=seed)
    return nv.Simulation(mesh, nv.Model(bodies=parts), dt=0.02, initial=initial, solver=solver)


def cracked(solver: str) -> nv.Simulation:
    """A material in space that breaks and heals, and is heated by the viscosity of its damage."""
    rubber = nv.ReferentialNeoHookean(K_e=8.0, G_e=2.0)
    law = nv.Damaged(material=rubber, G_c=0.1, length=0.9, viscosity=0.05, healing_viscosity=0.1, part="all")
    model = nv.Model(material=nv.Thermal(material=law, c=2.0, theta_R=1.0), viscosity=VISCOSITY)
    initial = nv.Initial(velocity=(*SWIRL, 0.0), values={"damage": 0.5 * x})
    mesh = structured_box((1, 1, 1), (2, 2, 2))
    return nv.Simulation(mesh, model, dt=0.02, initial=initial, solver=solver)


def parameters(solver: str) -> nv.Simulation:
    """A transported modulus and a transported viscosity, which overshoot and are limited."""
    theta = nv.Parameter("theta", start=0.5 + 0.4 * sin(3 * x) * cos(2 * y))
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=1 + 4 * theta, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.05, G_v=0.01 + 0.05 * theta),
    )
    initial = nv.Initial(velocity=SWIRL)
    return nv.Simulation(box((1, 1), maxh=0.4), model, dt=0.02, initial=initial, solver=solver)


def network(solver: str) -> nv.Simulation:
    """A network of a spring, chains by conformation and a branch that yields and hardens, each with its
    columns."""
    branches = {
        "spring": nv.Branch(material=STIFF),
        "chains": nv.Branch(
            material=nv.OldroydB(K_e=0.0, G_e=1.0), creep=nv.Creep(G_m=1.0, law="conformation")
        ),
        "hard": nv.Branch(
            material=nv.ReferentialNeoHookean(K_e=0.0, G_e=2.0),
            creep=nv.Perzyna(sigma_Y=0.05, G_m=0.1, H=1.0),
        ),
    }
    model = nv.Model(material=nv.Network(branches=branches), viscosity=VISCOSITY)
    initial = nv.Initial(velocity=SWIRL)
    return nv.Simulation(box((1, 1), maxh=0.4), model, dt=0.02, initial=initial, solver=solver)


def heated(solver: str) -> nv.Simulation:
    """A swirl that is heated by all dissipations, with conduction and a cooling wall."""
    material = nv.Thermal(material=STIFF, c=3.0, expansion=0.1, theta_R=1.0)
    model = nv.Model(
        material=material,
        viscosity=VISCOSITY,
        hyperviscosity=nv.HyperViscosity(mu=1e-4, p=4),
        creep=nv.Creep(G_m=1.0),
        heat=nv.Heat(conductivity=lambda theta: 0.05 * theta, numerical_heating=True),
    )
    initial = nv.Initial(velocity=SWIRL, temperature=1 + 0.2 * x)
    walls = {"left": nv.NavierFriction(0.3, heat=nv.WallHeat(temperature=0.5, coefficient=0.2))}
    mesh = box((1, 1), maxh=0.4)
    return nv.Simulation(mesh, model, dt=0.02, initial=initial, walls=walls, solver=solver)


def solute(solver: str) -> nv.Simulation:
    """A gel that swells with a solute, which spreads and comes in through a wall, in a swirl."""

    def energy(A, c):
        room = 1 - A - 0.2 * c
        return 10 * room * room / A + 0.5 * c * c / A + 0.1 * A * A

    gel = nv.CustomMaterial(transported=(ReciprocalJacobian(), Concentration()), stored_energy=energy)
    law = nv.Diffusion(variable="c", mobility=0.1, walls={"left": nv.WallExchange(flux=0.05)})
    model = nv.Model(material=gel, viscosity=VISCOSITY, diffusion=law)
    initial = nv.Initial(density=1.0, velocity=SWIRL, values={"c": 0.5 + 0.3 * x})
    return nv.Simulation(box((1, 1), maxh=0.4), model, dt=0.02, initial=initial, solver=solver)


def revolved(solver: str) -> nv.Simulation:
    """A body of revolution that yields in a vortex, between a wall with friction and an open wall."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="B"),
        viscosity=VISCOSITY,
        creep=nv.Perzyna(G_m=2.0, sigma_Y=0.1),
        loads=[gravity(2)],
    )
    vortex = (x * (1 - x) * (1 - 2 * y), -(2 - 3 * x) * y * (1 - y))
    return nv.Simulation(
        box((1, 1), maxh=0.4),
        model,
        dt=0.02,
        initial=nv.Initial(velocity=vortex),
        walls={"right": nv.NavierFriction(0.3), "top": nv.Open(pressure=-15.0)},
        passive=["F_tot"],
        observers=[nv.WallForces()],
        symmetry="axisymmetric",
        solver=solver,
    )


def observed(dim: int) -> nv.Simulation:
    """A run with tables of forces, of integrals, and of values at points: in cells, on walls, and on facets
    where fields jump."""
    middle = (0.5,) * dim
    tables = [
        nv.Probes({"middle": middle, "corner": (0.0,) * dim, "in a cell": (0.3,) * dim}),
        nv.LineSamples((0.0,) * dim, (1.0,) * dim, 7, fields=["velocity", "cauchy_stress"]),
        nv.WallForces(about=middle),
        nv.Integrals({"mass": "density", "momentum": "density*velocity_1"}),
    ]
    run = lid() if dim == 2 else block()
    run.observers = tables
    return run


def at_rest(dim: int = 2, as_bodies: bool = False, periodic: str = "", **datum) -> nv.Simulation:
    """One or two bodies that start with the pressure of their weight, and a table of the pressure."""
    rock = nv.ReferentialNeoHookean(K_e=50.0, G_e=15.0)
    loads, up = [gravity(dim)], y if dim == 2 else z
    model, density = nv.Model(material=rock, viscosity=VISCOSITY, loads=loads), {"density": 3 - 2 * up}
    if as_bodies:
        water = nv.ReferentialNeoHookean(K_e=20.0, G_e=0.1)
        laws = {"viscosity": VISCOSITY}
        of_water = nv.Body(name="water", where=up - 0.5, material=water, density=1.0, **laws)
        model = nv.Model(
            bodies=[of_water, nv.Body(name="rock", material=rock, density=3.0, **laws)], loads=loads
        )
        density = {}
    initial = nv.Initial(equilibrium="hydrostatic", **density, **datum)
    mesh = box((1,) * dim, maxh=0.3 if dim == 2 else 0.6, periodic=periodic)
    places = {f"at {height}": (0.4,) * (dim - 1) + (height,) for height in (0.0, 0.3, 0.7, 1.0)}
    table = nv.Probes(places, fields=["pressure", "density"])
    return nv.Simulation(mesh, model, dt=0.02, initial=initial, solver="split", observers=[table])


AT_REST: dict[str, Callable[[], nv.Simulation]] = {
    "at rest": at_rest,
    "at rest below a wall": lambda: at_rest(datum="left", datum_pressure=0.3),
    "at rest about a point": lambda: at_rest(datum_point=(0.3, 0.6)),
    "bodies at rest": lambda: at_rest(as_bodies=True, datum="top"),
    "at rest, periodic": lambda: at_rest(periodic="x"),
    "at rest in space": lambda: at_rest(3),
}


def yosida(solver: str) -> nv.Simulation:
    law = nv.Yosida(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"), eps=1e-3)
    model = nv.Model(material=law, viscosity=VISCOSITY, loads=[gravity(2)])
    initial = nv.Initial(velocity=SWIRL)
    return nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.02, initial=initial, solver=solver)


def carried(dim: int) -> nv.Simulation:
    """A block without creep, with a table of its passive fields of all kinds."""
    names = [name for name in NAMES if dim == 2 or name != "creep_strain"]
    run = creep(passive=names) if dim == 2 else block(passive=names)
    run.observers = [nv.Probes({"p": (0.3,) * dim}, fields=names)]
    return run


OF_BOTH: dict[str, Callable[[str], nv.Simulation]] = {
    **{
        "Yosida": yosida,
        "bodies": bodies,
        "apart": apart,
        "broken": broken,
        "cracked": cracked,
        "heated": heated,
        "parameters": parameters,
        "block": block,
    },
    **{"network": network, "solute": solute},
    **{"disc": disc, "lid": lid, "window": window, "revolved": revolved},
}
OF_DENSITY = {
    "delta, 2D, split": lambda: regularised("split", 2, DELTA, 0.25),
    "delta, 3D, split": lambda: regularised("split", 3, DELTA, 0.45),
    "cut-off, 2D, split": lambda: regularised("split", 2, CUT_OFF, 0.25),
    "cut-off, 3D, split": lambda: regularised("split", 3, CUT_OFF, 0.45),
}
CASES: dict[str, Callable[[], nv.Simulation]] = {
    f"{start}{name}": partial(make, solver)
    for solver, start in (("coupled", ""), ("split", "split "))
    for name, make in OF_BOTH.items()
}
CASES |= {
    "carried": lambda: carried(2),
    "carried in space": lambda: carried(3),
    "observed": lambda: observed(2),
    "observed block": lambda: observed(3),
    "swirl": lambda: swirl(0.3),
    "midpoint": lambda: swirl(0.3, scheme="midpoint"),
    "sdirk2": lambda: swirl(0.4, scheme="sdirk2"),
    "adaptive": lambda: swirl(0.4, adaptive=nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.1, tolerance=1e-2)),
    "channel": lambda: channel(passive=["reference_map"]),
    "split channel": lambda: channel("split"),
    "split channel, two levels": lambda: channel("split", newton=TWO_LEVELS),
    "split apart in space": lambda: apart("split", 3),
    "split outlined": lambda: apart("split", outlines=True),
    "split crystal": lambda: crystal("split"),
    "split crystal, delta": lambda: crystal("split", DELTA),
    "creep": creep,
    "limited": limited,
    "split": lambda: swirl(0.3, scheme="midpoint", solver="split"),
    "split, two levels": lambda: swirl(0.2, newton=TWO_LEVELS, solver="split"),
    "split, Newton-Krylov": lambda: swirl(0.4, newton=KRYLOV, solver="split"),
    "split, long steps": lambda: swirl(0.25, dt=0.15, solver="split"),
    "split block, two levels": lambda: block("split", 0.5, newton=TWO_LEVELS),
    "split block, gamg": lambda: block("split", 0.5, newton=replace(TWO_LEVELS, coarse="gamg")),
    "split block, hypre": lambda: block("split", 0.5, newton=replace(TWO_LEVELS, coarse="hypre")),
    "split creep": lambda: creep("split", nv.Regularisation(epsilon=0.1)),
    "split crowded": lambda: crowded("split"),
    "split, all regularisations": lambda: creep("split", passive=NAMES),
}
CASES |= OF_DENSITY | AT_REST | walls.CASES | own.CASES
STEPS = {
    **dict.fromkeys(AT_REST, 1),
    "limited": 9,
    "split crowded": 5,
    **dict.fromkeys(OF_DENSITY, 2),
} | walls.STEPS
"""Numbers of steps of cases that do not take three."""

LINEAR: list[int] = []
"""Numbers of iterations of the split solver's linear systems of the flow."""


def counted(self: Preconditioner, at: Evaluation, *tolerances: float) -> np.ndarray:
    increment = solved(self, at, *tolerances)
    LINEAR.append(self.iterations)
    return increment


solved, Preconditioner.__call__ = Preconditioner.__call__, counted

if __name__ == "__main__":
    found = {}
    for name in sys.argv[1:]:
        before = TRAFFIC.messages, TRAFFIC.bytes, TRAFFIC.reductions
        LINEAR.clear()
        run = CASES[name]()
        for observer in run.observers:
            observer.start(run)
        for _ in range(STEPS.get(name, 3)):
            row = run.advance()
            for observer in run.observers:
                observer.step(run, row)
        rows = [{key: float(value) for key, value in row.items()} for row in run.ledger.rows]
        found[name] = {"cells": run.cells, "unknowns": run.unknowns, "rows": rows, "linear": sum(LINEAR)}
        found[name]["tables"] = [
            {column: list(map(float, one.column(column))) for column in one.columns} for one in run.observers
        ]
        after = TRAFFIC.messages, TRAFFIC.bytes, TRAFFIC.reductions
        found[name]["traffic"] = [b - a for a, b in zip(before, after, strict=True)]
    if Communicator.world().is_first:
        print(json.dumps(found))
