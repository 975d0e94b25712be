"""Setups that cases share: a block set in rotation in its box, by both models; layers, materials, checks."""

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from netgen.geom2d import SplineGeometry
from ngsolve import CF, CoefficientFunction, Id, Integrate, Mesh, cos, pi, sin, x, y, z

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import box, disc, sphere
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Jacobian

KINDS = {"linearised": "the linearised model", "finite": "the finite-strain model"}
"""Suffix of a case's name, and the model's name in the case's statement."""

LABELS = {"linearised": "Euler-small-viscoelastodyn+disc", "finite": "Euler-large-viscoelastodyn+disc"}

SWIRL = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
"""An eddy of at most 1 m/s that fills the unit box."""

SETTING = (
    "A block of 1 m x 1 m, density 1 + 0.2 cos(pi x) kg/m3, set in rotation in its box (slip); K_e = 10 Pa, "
    "G_e = 5 Pa (finite strain: neo-Hookean with epsilon = 0.1 Pa), K_v = G_v = 0.1 Pa s"
)


def material(kind: str) -> nv.Material:
    """The linear elastic or the paper's neo-Hookean material, by the model's kind."""
    if kind == "linearised":
        return nv.LinearElastic(K_e=10.0, G_e=5.0)
    return nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F")


def elastic(kind: str, bulk: float, shear: float) -> nv.Material:
    """A material by kind ("finite-b" by B = F F^T), with the usual moduli, Pa; the neo-Hookean G_e is half of
    the shear modulus."""
    if kind == "linearised":
        return nv.LinearElastic(K_e=bulk, G_e=shear)
    state: Literal["F", "B"] = "B" if kind == "finite-b" else "F"
    return nv.ReferentialNeoHookean(K_e=bulk, G_e=shear / 2, elastic_state=state)


def fluid(bulk: float) -> nv.Material:
    """A material without shear stress, with the bulk modulus, Pa, of a neighbouring body."""
    return nv.CustomMaterial(
        transported=(Jacobian(),), stored_energy=lambda J: bulk / 2 * (J - 1) * (J - 1) / J
    )


def at_rest(stiffness: float, weight: CoefficientFunction) -> CoefficientFunction:
    """The distortion F at hydrostatic rest in ``fluid(stiffness)``; J = det F solves J J' = rho_R g/K_e. The
    argument ``weight`` is the integral of rho_R g from the place where J = 1, Pa."""
    return (1 + 2 / stiffness * weight) ** (1 / 6) * Id(3)


def stokes(viscosity: float) -> nv.StokesViscosity:
    """Stokes viscosity with one value in bulk and shear, Pa s."""
    return nv.StokesViscosity(K_v=viscosity, G_v=viscosity)


def refinements(dim: int, maxh: float, levels: int) -> Iterator[tuple[float, Mesh]]:
    """Yield the unstructured mesh of the unit box and its uniform refinements, each with its cell size."""
    mesh = box((1.0,) * dim, maxh)
    for level in range(levels):
        if level:
            mesh.Refine()
        yield maxh / 2**level, mesh


def balls(dim: int, maxh: float, levels: int) -> Iterator[tuple[float, Mesh]]:
    """Yield meshes of the unit disc or ball, each with its cell size; refinement would keep coarse walls."""
    for level in range(levels):
        mesh = (disc if dim == 2 else sphere)(1, maxh / 2**level)
        yield mesh.ne ** (-1 / dim), mesh


def distance(f: CoefficientFunction, g: CoefficientFunction, mesh: Mesh) -> float:
    """The L2 norm of f - g."""
    return float(Integrate(square(f - g), mesh, order=12)) ** 0.5


@cache
def cube_mesh(maxh: float) -> Mesh:
    """A mesh of the unit cube, the same object at each call."""
    return box((1, 1, 1), maxh)


@cache
def square_mesh(maxh: float) -> Mesh:
    """A mesh of the unit square, the same object at each call, so that ``separation`` can compare runs."""
    return box((1, 1), maxh)


def layers(width: float, faces: Sequence[Callable[[float], float]], names: str, maxh: float) -> Mesh:
    """Mesh of layers between the curves y = f(x), f in ``faces`` from the bottom on, with edges of ``maxh``
    along x; each layer is a subdomain named by a letter of ``names``.  Walls are those of ``box``."""
    geometry, count = SplineGeometry(), round(width / maxh)
    at = [width * n / count for n in range(count + 1)]
    points = [[geometry.AppendPoint(s, face(s)) for s in at] for face in faces]
    walls = ["bottom", *("face" for _ in faces[2:]), "top"]
    for n, (line, name) in enumerate(zip(points, walls, strict=True)):
        above = 0 if name == "top" else n + 1
        for a, b in pairwise(line):
            geometry.Append(["line", a, b], leftdomain=above, rightdomain=n, bc=name)
    for n, (low, high) in enumerate(pairwise(points), start=1):
        geometry.SetMaterial(n, names[n - 1])
        geometry.Append(["line", low[0], high[0]], leftdomain=0, rightdomain=n, bc="left")
        geometry.Append(["line", low[-1], high[-1]], leftdomain=n, rightdomain=0, bc="right")
    return Mesh(geometry.GenerateMesh(maxh=maxh))


def block(
    kind: str,
    dt: float,
    *,
    mesh: Mesh | None = None,
    speed: float = 1.0,
    gravity: float = 0.0,
    viscosity: float | nv.StokesViscosity = 0.1,
    hyperviscosity: nv.HyperViscosity | None = None,
    creep: float | nv.Creep | None = None,
    of: nv.Material | None = None,
    **parts: Any,
) -> nv.Simulation:
    """The block of ``SETTING``; ``creep`` is G_m or a flow rule; ``parts`` are further arguments."""
    regularisation, mesh = parts.pop("regularisation", None), mesh or square_mesh(0.5)
    if not isinstance(viscosity, nv.StokesViscosity):
        viscosity = stokes(viscosity)
    model = nv.Model(
        material=of or material(kind),
        viscosity=viscosity,
        hyperviscosity=hyperviscosity,
        creep=nv.Creep(G_m=creep) if isinstance(creep, float) else creep,
        loads=(nv.Gravity((0.0,) * (mesh.dim - 1) + (-gravity,)),) if gravity else (),
        regularisation=regularisation,
    )
    swirl = SWIRL if mesh.dim == 2 else (*(v * (1 + 0.3 * cos(pi * z)) for v in SWIRL), CF(0.0))
    velocity = CF(tuple(speed * v for v in swirl))
    initial = parts.pop("initial", None) or nv.Initial(density=1 + 0.2 * cos(pi * x), velocity=velocity)
    return nv.Simulation(mesh, model, dt=dt, initial=initial, **parts)


def around(simulation: nv.Simulation, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of the azimuthal velocity and of the shear stress T_(r phi) on circles about the origin."""
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    c, s, means = np.cos(angles), np.sin(angles), []
    for r in radii:
        points = simulation.mesh(r * c, r * s)
        v = simulation.fields["velocity"](points)
        T_xx, T_xy, T_yy = simulation.fields["cauchy_stress"](points)[:, [0, 1, 4]].T
        shear = c * s * (T_yy - T_xx) + (c**2 - s**2) * T_xy
        means.append((np.mean(c * v[:, 1] - s * v[:, 0]), np.mean(shear)))
    velocities, stresses = np.array(means).T
    return velocities, stresses


def lid_driven(
    mesh: Mesh,
    material: nv.Material | None = None,
    *,
    lid: Sequence[Any] = (1.0, 0.0),
    mu: float = 1e-5,
    **options: Any,
) -> nv.Simulation:
    """A soft body under a lid that has full speed up to the corners; ``options`` are the run's."""
    of = material or nv.NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1)
    hyper = nv.HyperViscosity(mu=mu, p=4) if mu else None
    model = nv.Model(material=of, viscosity=stokes(0.01), hyperviscosity=hyper)
    others = tuple(sorted(set(mesh.GetBoundaries()) - {"top"}))
    walls: Conditions = {"top": nv.PrescribedTangential(tuple(lid)), others: nv.NoSlip()}
    return nv.Simulation(mesh, model, walls=walls, **options)


def state(simulation: nv.Simulation) -> dict[str, CoefficientFunction]:
    """The fields v, rho and z of the present state."""
    u = simulation.rothe_step.now
    return {"v": u.v, "rho": u.rho, "z": u.z}


def separation(one: nv.Simulation, other: nv.Simulation) -> dict[str, float]:
    """L2 distances of v, rho and z of two runs on one mesh."""
    a, b = state(one), state(other)
    return {name: distance(a[name], b[name], one.mesh) for name in a}


def followed(
    run: nv.Simulation, steps: int, of: Callable[[nv.Simulation], Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Times, s, and values of a function of a run, at its start and after each of its next steps."""
    times, values = [run.t], [of(run)]
    for _ in range(steps):
        run.advance()
        times.append(run.t)
        values.append(of(run))
    return np.array(times), np.array(values)


def swing_by_midpoint(values: np.ndarray, tau: float) -> complex:
    """The exponent s = -decay + i frequency of values over steps of the midpoint rule, without error in time.

    The values obey a_n+1 = (q + q*) a_n - |q|^2 a_n-1 with q = (1 + s tau/2)/(1 - s tau/2).
    """
    a = values / values[0]
    b = np.linalg.lstsq(np.array([a[1:-1], a[:-2]]).T, a[2:], rcond=None)[0]
    q = complex(np.roots([1.0, -b[0], -b[1]])[0])
    return 2 / tau * (q - 1) / (q + 1)


def released(t: np.ndarray, static: float, damping: float, omega: float) -> np.ndarray:
    """Displacement of an oscillator under a weight that acts from t = 0."""
    swing = np.cos(omega * t) + damping / omega * np.sin(omega * t)
    return np.asarray(static * (1 - np.exp(-damping * t) * swing))


def closure(*simulations: nv.Simulation) -> float:
    """The largest relative |closure| of all steps."""
    return max(float(np.abs(run.ledger.column("closure_relative")).max()) for run in simulations)


def drift(simulation: nv.Simulation) -> float:
    """The largest relative change of the mass."""
    return float(np.abs(simulation.ledger.column("mass_drift")).max())
