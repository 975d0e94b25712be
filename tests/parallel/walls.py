"""Small cases with oblique and curved walls, some of which move."""

import numpy as np
from netgen.occ import Axis, Box, OCCGeometry, Pnt, WorkPlane, X, Z
from ngsolve import Mesh, x, y

import ngvisco as nv
from ngvisco.geometries import annulus, sphere
from ngvisco.geometries import disc as round_disc
from ngvisco.solver.options import SplitOptions

TWO_LEVELS = nv.NewtonOptions(split=SplitOptions(direct_up_to=(100, 100)))
_NORMALS = (1.0, 0.6), (-0.4, 1.0), (-1.0, -0.3), (0.2, -1.0)
"""Normals of the sides of ``quadrilateral``, a, b, c and d."""


def model(dim: int, mu: float | None = 1e-4) -> nv.Model:
    return nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.05, G_v=0.05),
        hyperviscosity=None if mu is None else nv.HyperViscosity(mu=mu, p=4),
        loads=[nv.Gravity((0.3,) + (0.0,) * (dim - 2) + (-1.0,))],
    )


def simulation(mesh: Mesh, solver: str, mu: float | None = 1e-4, **options) -> nv.Simulation:
    """A run with a table of the body's forces on its walls."""
    forces = nv.WallForces(about=(0.1,) * mesh.dim)
    options = {"dt": 0.02, "observers": [forces]} | options
    return nv.Simulation(mesh, model(mesh.dim, mu), solver=solver, **options)


def slip_disc(solver: str, maxh: float = 0.4, **options) -> nv.Simulation:
    """A swirl that slides along a circle, whose centre is not exactly the swirl's."""
    start = nv.Initial(velocity=(-y + 0.3 * x * y, x + 0.2))
    return simulation(round_disc(1.0, maxh=maxh), solver, initial=start, **options)


def turned(solver: str) -> nv.Simulation:
    """A ring whose outer wall turns, with friction at the inner one."""
    walls = {"outer": nv.PrescribedTangential((-0.5 * y, 0.5 * x)), "inner": nv.NavierFriction(0.3)}
    return simulation(annulus(0.4, 1.0, maxh=0.4), solver, walls=walls, scheme="midpoint")


def quadrilateral(solver: str, k: int = 2) -> nv.Simulation:
    """A body between four oblique walls: slip, moving, at rest, with friction."""
    corners = [_corner(i) for i in range(4)]
    face = WorkPlane().MoveTo(*corners[-1])
    for corner in corners:
        face = face.LineTo(*corner)
    face = face.Face()
    sides = sorted(face.edges, key=lambda edge: _side(edge.center))
    for side, name in zip(sides, "abcd", strict=True):
        side.name = name
    (n_x, n_y) = _NORMALS[1]
    along = 1 / (n_x * n_x + n_y * n_y) ** 0.5
    walls = {
        "b": nv.PrescribedTangential((0.4 * n_y * along, -0.4 * n_x * along)),
        "c": nv.NoSlip(),
        "d": nv.NavierFriction(0.3),
    }
    mesh = Mesh(OCCGeometry(face, dim=2).GenerateMesh(maxh=0.4))
    start = nv.Initial(velocity=(0.2 * y, 0.3 - 0.4 * x))
    discretisation = nv.Discretisation(k=k)
    return simulation(mesh, solver, walls=walls, initial=start, discretisation=discretisation)


def _corner(i: int) -> tuple[float, float]:
    """The corner between side i and the next side; each side is the line n . x = 1/2."""
    (a, b), (c, d) = _NORMALS[i], _NORMALS[(i + 1) % 4]
    return (d - b) / (2 * (a * d - b * c)), (a - c) / (2 * (a * d - b * c))


def _side(place) -> int:
    return min(range(4), key=lambda i: abs(_NORMALS[i][0] * place[0] + _NORMALS[i][1] * place[1] - 0.5))


def ball(solver: str, maxh: float = 1.2, **options) -> nv.Simulation:
    """A ball that turns within its wall about an axis beside its middle."""
    start = nv.Initial(velocity=(-y, x + 0.1, 0.1 * x))
    return simulation(sphere(1.0, maxh=maxh), solver, initial=start, **options)


def turned_ball(solver: str, **options) -> nv.Simulation:
    """A ball whose wall begins to turn around it."""
    walls = {"wall": nv.PrescribedTangential((-0.3 * y, 0.3 * x, 0.0))}
    return simulation(sphere(1.0, maxh=1.2), solver, walls=walls, **options)


def leaning(solver: str, maxh: float = 0.6, **options) -> nv.Simulation:
    """A block, rotated about two axes; one wall slides, one is at rest, four have slip."""
    block = Box(Pnt(0, 0, 0), Pnt(1, 1, 1))
    for face, name in zip(block.faces, ("left", "right", "front", "back", "bottom", "top"), strict=True):
        face.name = name
    about_z, about_x = 30.0, 25.0
    turned = block.Rotate(Axis((0, 0, 0), Z), about_z).Rotate(Axis((0, 0, 0), X), about_x)
    sine, cosine = np.sin(np.deg2rad([about_z, about_x])), np.cos(np.deg2rad([about_z, about_x]))
    along = -sine[0], cosine[0] * cosine[1], cosine[0] * sine[1]  # the rotated axis y, in the right wall
    walls = {"right": nv.PrescribedTangential(tuple(0.1 * each for each in along)), "bottom": nv.NoSlip()}
    mesh = Mesh(OCCGeometry(turned).GenerateMesh(maxh=maxh, parallel_meshing=False))
    return simulation(mesh, solver, walls=walls, **options)


CASES = {
    "slip disc": lambda: slip_disc("coupled"),
    "turned": lambda: turned("coupled"),
    "quadrilateral": lambda: quadrilateral("coupled"),
    "quadrilateral, k = 3": lambda: quadrilateral("coupled", 3),
    "ball": lambda: ball("coupled", mu=None),
    "turned ball": lambda: turned_ball("coupled", mu=None),
    "leaning": lambda: leaning("coupled", mu=None),
    "split slip disc": lambda: slip_disc("split"),
    "split slip disc, two levels": lambda: slip_disc("split", newton=TWO_LEVELS),
    "split turned": lambda: turned("split"),
    "split quadrilateral": lambda: quadrilateral("split"),
    "split quadrilateral, k = 3": lambda: quadrilateral("split", 3),
    "split ball": lambda: ball("split"),
    "split turned ball": lambda: turned_ball("split"),
    "split leaning": lambda: leaning("split"),
}
STEPS = dict.fromkeys(("quadrilateral, k = 3", "ball", "turned ball", "split ball"), 1)
STEPS |= dict.fromkeys(("slip disc", "split turned ball", "split turned", "leaning", "split leaning"), 2)
