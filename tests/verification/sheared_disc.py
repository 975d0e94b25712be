"""A neo-Hookean disc in a sheared fluid of the same viscosity, by two methods that are independent of the
package.

*An ellipse.*  In creeping, incompressible flow without bounds, the stress of the disc is uniform, and so are
its distortion F and the velocity's gradient L inside (Eshelby). In a bounded cell, the disc's images add a
gradient that is linear in the disc's stress; ``images`` computes this gradient for a round disc.

*A fitted mesh.*  ``Fitted`` solves the equations of a compressible fluid and disc with inertia by P_3
velocities on a mesh whose curved edges follow the interface, with steps of the BDF scheme of order 2.  The
mesh moves with the normal velocity of the interface, and B = F F^T and J are discontinuous P_2.  The motion
of the mesh is explicit and becomes unstable after about four strains with steps of 0.04 strains.

Lengths are in radii of the disc, and times in reciprocal shear rates.  The viscosity is 1, in bulk too.  The
square cell has its middle in the disc's middle. The cell is periodic in x, and its walls y = +-size/2 move
with the shear flow v = (y, 0).
"""

from __future__ import annotations

import numpy as np
from netgen.occ import Glue, IdentificationType, OCCGeometry, TopoDS_Shape, Vec, WorkPlane, gp_Trsf
from ngsolve import (
    CF,
    H1,
    L2,
    BilinearForm,
    CoefficientFunction,
    FacetFESpace,
    Grad,
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    Integrate,
    LinearForm,
    Mesh,
    NumberSpace,
    Parameter,
    Periodic,
    Trace,
    VectorH1,
    div,
    ds,
    dx,
    grad,
    specialcf,
    x,
    y,
)
from scipy.integrate import solve_ivp

_SHEAR = np.array([[0.0, 1.0], [0.0, 0.0]])
_COARSE, _GRADING = 1.0, 0.3


def mesh_of(size: float, maxh: float, order: int) -> Mesh:
    """The square cell with cells of the size ``maxh`` in the disc, curved by ``order``."""
    square = WorkPlane().MoveTo(-size / 2, -size / 2).Rectangle(size, size).Face()
    disc = WorkPlane().Circle(0, 0, 1).Face()
    disc.faces.name, disc.faces.maxh, disc.edges.name = "disc", maxh, "interface"
    whole = Glue([disc, square - disc])
    for face in whole.faces:
        face.name = face.name or "fluid"
    mesh = Mesh(periodic_cell(whole, size).GenerateMesh(maxh=_COARSE, grading=_GRADING))
    mesh.Curve(order)
    return mesh


def periodic_cell(whole: TopoDS_Shape, size: float) -> OCCGeometry:
    """The geometry of faces that fill the square cell: its edges are named left, right, bottom and top, and
    the cell is periodic in x."""
    sides = {}
    for edge in whole.edges:
        for name, i, end in (("left", 0, -1), ("right", 0, 1), ("bottom", 1, -1), ("top", 1, 1)):
            if abs(edge.center[i] - end * size / 2) < 1e-9:
                edge.name, sides[name] = name, edge
    along = gp_Trsf.Translation(Vec(size, 0, 0))
    sides["left"].Identify(sides["right"], "periodic", IdentificationType.PERIODIC, along)
    return OCCGeometry(whole, dim=2)


def axes(B: np.ndarray) -> tuple[float, float]:
    """Deformation (a - b)/(a + b) of an ellipse with the squared axes of ``B``, (2, 2), and the angle of the
    long axis with the flow, degrees."""
    squares, directions = np.linalg.eigh(B)
    short, long = np.sqrt(squares)
    angle = np.degrees(np.arctan2(directions[1, 1], directions[0, 1])) % 180
    return (long - short) / (long + short), float(angle)


# --- an ellipse ----------------------------------------------------------------------------------------


def images(size: float, maxh: float = 0.25) -> tuple[np.ndarray, np.ndarray]:
    """Mean gradients of the velocity in a round disc, (2, 2), that its images add in the cell, for the
    disc's stresses ((0, 1), (1, 0)) and ((1, 0), (0, -1))."""
    mesh = mesh_of(size, maxh, 4)
    velocities = Periodic(VectorH1(mesh, order=4, dirichlet="top|bottom"))
    space = velocities * Periodic(H1(mesh, order=3)) * NumberSpace(mesh)
    (u, p, mean), (v, q, mean_test) = space.TnT()
    form = BilinearForm(space)
    strain = Grad(u) + Grad(u).trans
    form += (InnerProduct(strain, Grad(v)) - p * div(v) - q * div(u) + mean * q + mean_test * p) * dx
    inverse = form.Assemble().mat.Inverse(space.FreeDofs(), "umfpack")
    found, solution = [], GridFunction(space)
    for stress in (((0.0, 1.0), (1.0, 0.0)), ((1.0, 0.0), (0.0, -1.0))):
        load = LinearForm(space)
        values = CF((*stress[0], *stress[1]), dims=(2, 2))
        load += -InnerProduct(values, Grad(v)) * dx(definedon=mesh.Materials("disc"))
        solution.vec.data = inverse * load.Assemble().vec
        inside = Integrate(Grad(solution.components[0]), mesh, definedon=mesh.Materials("disc"), order=8)
        without = -0.25 * np.array(stress)  # a round disc in a fluid without bounds
        found.append(np.array(inside).reshape(2, 2) / np.pi - without)
    return found[0], found[1]


def ellipse(
    capillary: float, times: np.ndarray, of_images: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """Deformation and angle, degrees, of the disc that is round at t = 0, (times, 2)."""
    around = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    wave = np.array([np.cos(around), np.sin(around)])

    def rate(_: float, F: np.ndarray) -> np.ndarray:
        F = F.reshape(2, 2)
        B = F @ F.T
        stress = (B - np.trace(B) / 2 * np.eye(2)) / capillary
        weights = 1 / np.einsum("it,ij,jt->t", wave, B, wave)
        traction = stress @ wave
        traction -= wave * (wave * traction).sum(axis=0)
        L = _SHEAR - np.einsum("it,jt,t->ij", traction, wave, weights / weights.sum())
        if of_images is not None:
            L = L + stress[0, 1] * of_images[0] + stress[0, 0] * of_images[1]
        return np.asarray((L @ F).ravel())

    start = np.eye(2).ravel()
    found = solve_ivp(rate, (0, times[-1]), start, t_eval=times, rtol=1e-9, atol=1e-10)
    return np.array([axes(F.reshape(2, 2) @ F.reshape(2, 2).T) for F in found.y.T])


# --- a fitted mesh -------------------------------------------------------------------------------------


class Fitted:
    """The disc on a mesh that follows the interface; ``advance`` makes a step of ``dt`` strains."""

    def __init__(
        self, capillary: float, bulk: float, reynolds: float, size: float, maxh: float, dt: float
    ) -> None:
        self.t, self._dt, self._is_first = 0.0, dt, True
        self.mesh = mesh = mesh_of(size, maxh, 3)
        walls = "top|bottom"
        self._velocities = Periodic(VectorH1(mesh, order=3, dirichlet=walls))
        self._moves = VectorH1(mesh, order=3, dirichlet=f"{walls}|left|right|interface")
        self._states = L2(mesh, order=2, dgjumps=True)
        self._v, self._v_old, self._v_next, self._v_new = (GridFunction(self._velocities) for _ in range(4))
        self._place, self._place_old, self._w = (GridFunction(self._moves) for _ in range(3))
        self._z, self._z_old, self._z_next = ([GridFunction(self._states) for _ in range(4)] for _ in "123")
        for function, value in zip(self._z, (1.0, 0.0, 1.0, 1.0), strict=True):
            function.Set(value)  # B_11, B_12, B_22, J
        self._v.Set(CF((y, 0)))
        self._weights = now, new, old = Parameter(1.0), Parameter(1.0), Parameter(0.0)
        self._rim = mesh.Boundaries("interface")
        on_rim = GridFunction(FacetFESpace(mesh, order=0))
        on_rim.Set(1, definedon=self._rim)
        normal = specialcf.normal(2)

        def tensor(z: list[GridFunction]) -> CoefficientFunction:
            return CF((z[0], z[1], z[1], z[2]), dims=(2, 2))

        def in_plane(B: CoefficientFunction, B_33: float) -> CoefficientFunction:
            return B - (Trace(B) + B_33) / 3 * Id(2)

        # the balance of momentum has the stress at the end of the step
        u, test = self._velocities.TnT()
        B, J = tensor(self._z_next), self._z_next[3]
        relative = self._v_next - self._w
        carried = [relative * grad(z) for z in self._z_next]
        B_old = (new * tensor(self._z) - old * tensor(self._z_old) - dt * tensor(carried)) / now
        J_old = (new * self._z[3] - old * self._z_old[3] - dt * carried[3]) / now
        modulus = mesh.MaterialCF({"disc": 1 / capillary}, default=0.0) * J ** (-5 / 3)
        strain = 0.5 * (Grad(u) + Grad(u).trans)
        stress = 2 * (strain - div(u) / 3 * Id(2)) + (1 + bulk * dt / now * J) * div(u) * Id(2)
        stress += dt / now * modulus * in_plane(Grad(u) * B + B * Grad(u).trans, 0.0)
        known = modulus * in_plane(B_old, 1.0) + bulk * (J_old - 1) * Id(2)
        exact = dx(bonus_intorder=2)
        self._momentum, self._load = BilinearForm(self._velocities), LinearForm(self._velocities)
        inertia = reynolds * (now / dt * u + Grad(u) * relative)
        self._momentum += (inertia * test + InnerProduct(stress, Grad(test))) * exact
        inertia = reynolds / dt * (new * self._v - old * self._v_old)
        self._load += (inertia * test - InnerProduct(known, Grad(test))) * exact
        # transport of B and J on each side of the interface
        z, of_z = self._states.TnT()
        v, relative = self._v_new, self._v_new - self._w
        through, inside = relative * normal, 1 - on_rim
        skeleton = dx(skeleton=True)
        self._transport = BilinearForm(self._states)
        self._transport += (now / dt * z + relative * grad(z)) * of_z * exact
        self._transport += inside * IfPos(through, 0, -through) * (z - z.Other()) * of_z * skeleton
        self._transport += inside * IfPos(through, through, 0) * (z.Other() - z) * of_z.Other() * skeleton
        growth = Grad(v) * B + B * Grad(v).trans
        self._sources = []
        for rate, z_new, z_old in zip(
            (growth[0, 0], growth[0, 1], growth[1, 1], J * div(v)), self._z, self._z_old, strict=True
        ):
            source = LinearForm(self._states)
            source += ((new * z_new - old * z_old) / dt + rate) * of_z * exact
            self._sources.append(source)
        # velocity of the mesh: normal at the interface, harmonic elsewhere
        w, of_w = self._moves.TnT()
        self._harmonic = BilinearForm(self._moves)
        self._harmonic += InnerProduct(Grad(w), Grad(of_w)) * dx
        rim = ds(definedon=self._rim)
        self._on_rim = BilinearForm(self._moves, check_unused=False)
        self._on_rim += w.Trace() * of_w.Trace() * rim
        self._normal = LinearForm(self._moves)
        self._normal += (self._v_next * normal) * (normal * of_w.Trace()) * rim
        mesh.SetDeformation(self._place)

    def advance(self) -> None:
        """Make a step; the first one is of backward Euler."""
        for parameter, value in zip(
            self._weights, (1.0, 1.0, 0.0) if self._is_first else (1.5, 2.0, 0.5), strict=True
        ):
            parameter.Set(value)
        now, new, old = (parameter.Get() for parameter in self._weights)
        before = [self._v_old, *self._z_old, self._place_old]
        present = [self._v, *self._z, self._place]
        ahead = [1.0, 0.0] if self._is_first else [2.0, -1.0]
        ends = [
            (ahead[0] * a.vec + ahead[1] * b.vec).Evaluate() for a, b in zip(present, before, strict=True)
        ]
        for function, end in zip((self._v_next, *self._z_next), ends, strict=False):
            function.vec.data = end
        place = self._place.vec.CreateVector()
        place.data = self._place.vec
        self._place.vec.data = ends[-1]
        self._move()
        end = (new / now * place - old / now * self._place_old.vec + self._dt / now * self._w.vec).Evaluate()
        self._place_old.vec.data, self._place.vec.data = place, end
        self._v_new.vec.data = self._v.vec
        matrix = self._momentum.Assemble().mat
        rest = (self._load.Assemble().vec - matrix * self._v_new.vec).Evaluate()
        self._v_new.vec.data += matrix.Inverse(self._velocities.FreeDofs(), "umfpack") * rest
        inverse = self._transport.Assemble().mat.Inverse(self._states.FreeDofs(), "umfpack")
        states = [(inverse * source.Assemble().vec).Evaluate() for source in self._sources]
        for a, b, state in zip(self._z, self._z_old, states, strict=True):
            b.vec.data, a.vec.data = a.vec, state
        self._v_old.vec.data, self._v.vec.data = self._v.vec, self._v_new.vec
        self.t, self._is_first = self.t + self._dt, False

    def _move(self) -> None:
        """Set the velocity of the mesh for the places at the end of the step."""
        mass, normal = self._on_rim.Assemble().mat, self._normal.Assemble().vec
        self._w.vec.data = mass.Inverse(self._moves.GetDofs(self._rim), "sparsecholesky") * normal
        matrix = self._harmonic.Assemble().mat
        rest = (-1.0 * (matrix * self._w.vec)).Evaluate()
        self._w.vec.data += matrix.Inverse(self._moves.FreeDofs(), "sparsecholesky") * rest

    def shape(self) -> tuple[float, float, float]:
        """Deformation and angle, degrees, by second moments, and the area over that of the round disc."""
        inside = self.mesh.Materials("disc")

        def over(f: CoefficientFunction) -> float:
            return float(Integrate(f, self.mesh, definedon=inside, order=8))

        off = over(x * y)
        D, angle = axes(np.array([[over(x * x), off], [off, over(y * y)]]))
        return D, angle, over(CF(1.0)) / np.pi
