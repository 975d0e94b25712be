"""Walls by name, and meshes that the scheme refuses."""

import netgen.occ as occ
import numpy as np
import pytest
from netgen.meshing import Element1D, Element2D, FaceDescriptor, MeshingStep, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Integrate, Mesh, dx
from ngsolve.meshes import Make1DMesh, MakeStructured3DMesh

from ngvisco import MeshError, Model, NeoHookean, NoSlip, ParameterError
from ngvisco.forms.boundary.boundaries import (
    axis_parallel_walls,
    interior_boundaries,
    periodic_boundaries,
)
from ngvisco.forms.context import inner_facets
from ngvisco.forms.mesh.mesh_arrays import check_mesh
from ngvisco.forms.system import Step
from ngvisco.geometries import box


def named_square(names: tuple[str, str, str, str]) -> Mesh:
    """A unit square with the walls x = 0, x = 1, y = 0, y = 1 under these names."""
    face = occ.Rectangle(1, 1).Face()
    for name, direction in zip(names, (-occ.X, occ.X, -occ.Y, occ.Y), strict=True):
        face.edges.Max(direction).name = name
    return Mesh(occ.OCCGeometry(face, dim=2).GenerateMesh(maxh=0.6))


def cells(points: list[tuple[float, float]], corners: list[tuple[int, ...]], edges=()) -> Mesh:
    """A 2D mesh from its cells' corners and its boundary edges."""
    mesh = NetgenMesh(dim=2)
    numbers = [mesh.Add(MeshPoint(Pnt(x, y, 0))) for x, y in points]
    mesh.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    for cell in corners:
        mesh.Add(Element2D(1, [numbers[i] for i in cell]))
    for a, b in edges:
        mesh.Add(Element1D([numbers[a], numbers[b]], index=1))
    return Mesh(mesh)


def free_vertices(mesh: Mesh) -> list[bool]:
    """Vertices that are free for a velocity that slips on all walls, component by component."""
    step = Step(mesh, Model(material=NeoHookean(K_e=1, G_e=1, epsilon=0.1)))
    free = np.array(list(step.layout.velocity_space(step.walls.dirichlet).FreeDofs()))
    return free.reshape(mesh.dim, -1)[:, : mesh.nv].ravel().tolist()


@pytest.mark.parametrize(
    "names",
    [
        ("a.b", "a.b2", "axb", "axb2"),
        ("in|out", "in", "out", "x"),
        ("in (1)", "wall*", "w[a]", "top+"),
        ("^", "$", "\\", "?"),
        ("a b", "wänd", "c-d", "e/f"),
        ("side", "side", "lid", "lid"),
    ],
    ids=str,
)
def test_wall_names_are_not_regular_expressions(names: tuple[str, str, str, str]) -> None:
    """A pattern "a.b" would also match "axb", and constrain a wall in a wrong direction."""
    mesh, plain = named_square(names), named_square(("left", "right", "bottom", "top"))
    assert axis_parallel_walls(mesh)[0] == [sorted(set(names[:2])), sorted(set(names[2:]))]
    assert free_vertices(mesh) == free_vertices(plain)
    assert set(mesh.GetBoundaries()) == set(names)


def test_unnamed_walls_are_found() -> None:
    mesh = named_square(("", "a", "b", "c"))
    assert axis_parallel_walls(mesh) == ([["a", "default"], ["b", "c"]], [])


def disc() -> Mesh:
    face = occ.Circle(occ.Pnt(0, 0), 1).Face()
    face.edges.name = "rim"
    return Mesh(occ.OCCGeometry(face, dim=2).GenerateMesh(maxh=0.5)).Curve(3)


def test_a_curved_wall_is_not_axis_parallel() -> None:
    assert axis_parallel_walls(disc()) == ([[], []], ["rim"])


def test_a_boundary_with_walls_of_two_directions_is_not_axis_parallel() -> None:
    assert axis_parallel_walls(named_square(("all", "all", "all", "all"))) == ([[], []], ["all"])


# --- meshes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["hexahedra", "prisms"])
def test_cells_of_types_without_finite_element_spaces_are_refused(kind) -> None:
    mesh = MakeStructured3DMesh(hexes=kind == "hexahedra", prism=kind == "prisms", nx=1)
    with pytest.raises(MeshError, match=f"cells of the types {kind}; expected triangles"):
        check_mesh(mesh)


def test_an_interface_between_cells_is_not_a_wall() -> None:
    """Runs with an interface equal runs on the same cells without it, see ``run/test_periodic``."""
    left, right = occ.Rectangle(0.5, 1).Face(), occ.MoveTo(0.5, 0).Rectangle(0.5, 1).Face()
    left.edges.Max(occ.X).name = "interface"
    mesh = Mesh(occ.OCCGeometry(occ.Glue([left, right]), dim=2).GenerateMesh(maxh=0.4))
    assert interior_boundaries(mesh) == {"interface"}
    with pytest.raises(ParameterError, match="lies between cells"):
        Step(mesh, Model(material=NeoHookean(K_e=1, G_e=1, epsilon=0.1)), conditions={"interface": NoSlip()})


SQUARE = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
RIM = [(0, 1), (1, 2), (2, 3), (3, 0)]


def test_a_folded_mesh_is_refused() -> None:
    """The second triangle lies inside the first; both have positive volume."""
    points = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.2, 0.2)]
    mesh = cells(points, [(0, 1, 2), (1, 3, 2)], [(0, 1), (2, 0), (1, 3), (3, 2)])
    with pytest.raises(MeshError, match="cells on one side only"):
        check_mesh(mesh)


def test_an_inverted_tetrahedron_is_refused() -> None:
    netgen_mesh = MakeStructured3DMesh(hexes=False, nx=2, ny=2, nz=2).ngmesh
    inner = [p for p in netgen_mesh.Points() if max(abs(c - 0.5) for c in p.p) < 1e-9]
    assert len(inner) == 1
    inner[0][0] = 1.4  # the vertex is moved through the wall at x = 1
    with pytest.raises(MeshError, match="cells on one side only"):
        check_mesh(Mesh(netgen_mesh))


def test_a_quadrilateral_with_a_reentrant_corner_is_refused() -> None:
    mesh = cells([(0, 0), (1, 0), (0.2, 0.2), (0, 1)], [(0, 1, 2, 3)], RIM)
    with pytest.raises(MeshError, match="element 0 is inverted or flat"):
        check_mesh(mesh)


def test_a_flat_cell_is_refused() -> None:
    points = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5)]
    mesh = cells(points, [(0, 1, 2), (1, 3, 2)], [(0, 1), (2, 0), (1, 3), (3, 2)])
    with pytest.raises(MeshError, match="element 1 is inverted or flat"):
        check_mesh(mesh)


def test_a_mesh_without_walls_is_refused() -> None:
    """Some facets belong to one cell and to no boundary: mass would leave through them."""
    with pytest.raises(MeshError, match="lacks a boundary element"):
        check_mesh(cells(SQUARE, [(0, 1, 2), (0, 2, 3)]))


def test_a_surface_mesh_is_refused() -> None:
    geometry = occ.OCCGeometry(occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(1, 1, 1)))
    mesh = Mesh(geometry.GenerateMesh(maxh=1.0, perfstepsend=MeshingStep.MESHSURFACE, parallel_meshing=False))
    assert mesh.dim == 3
    with pytest.raises(MeshError, match="no volume elements"):
        check_mesh(mesh)


def test_a_one_dimensional_mesh_is_refused() -> None:
    with pytest.raises(MeshError, match="dimension 1; expected 2"):
        check_mesh(Make1DMesh(3))


@pytest.mark.parametrize("dim", [2, 3])
def test_identified_walls_of_a_refined_mesh_are_found(dim):
    """In a refined mesh facets have other numbers than edges or faces, among which divided ones are counted
    too."""
    mesh = box((1,) * dim, 0.5, periodic="x")
    mesh.Refine()
    assert periodic_boundaries(mesh) == {"left", "right"}
    on_walls = Integrate((1 - inner_facets(mesh)) * dx(element_boundary=True), mesh)
    assert on_walls == pytest.approx(2 * (dim - 1))
