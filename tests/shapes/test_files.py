"""Shapes from files and from the mesh: closed surfaces, pictures, subdomains."""

import struct
import sys

import numpy as np
import pytest
from netgen.occ import Circle, Glue, OCCGeometry, Rectangle
from ngsolve import Mesh, pi

from ngvisco.errors import ParameterError, UnknownNameError
from ngvisco.geometries import box
from ngvisco.shapes.files import ClosedSurface, Image, crossings
from ngvisco.shapes.fractions import volumes
from ngvisco.shapes.shape import Block, Subdomain


def cube(low=0.2, high=0.8):
    """The twelve triangles of a cube, counterclockwise as seen from outside."""
    corner = np.array([[i, j, k] for i in (low, high) for j in (low, high) for k in (low, high)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return np.array([corner[list(t)] for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def ascii_stl(triangles):
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in triangles
    )
    return f"solid part\n{facets}endsolid part\n".encode()


def binary_stl(triangles):
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(t), 0) for t in triangles)
    return b"solid, though binary".ljust(80) + struct.pack("<I", len(triangles)) + records


@pytest.mark.parametrize("write", [ascii_stl, binary_stl])
@pytest.mark.parametrize("inward", [False, True])
def test_a_closed_surface_contains_its_volume(tmp_path, write, inward):
    path = tmp_path / "cube.stl"
    path.write_bytes(write(cube()[:, ::-1] if inward else cube()))
    mesh = box((1, 1, 1), maxh=0.4)
    surface = ClosedSurface(path)
    exact = volumes(mesh, [Block((0.2,) * 3, (0.8,) * 3)])[0]
    assert volumes(mesh, [surface])[0] == pytest.approx(0.216, rel=5e-3)
    assert volumes(mesh, [surface])[0] == pytest.approx(exact, rel=5e-3)
    assert volumes(mesh, [ClosedSurface(path, scale=0.5)])[0] == pytest.approx(0.027, rel=0.05)


def sphere(count, radius=0.3):
    """An octahedron's faces, each divided in four again and again."""
    ends = np.concatenate([np.eye(3), -np.eye(3)])
    faces = [(a, b, c) for a in (0, 3) for b in (1, 4) for c in (2, 5)]
    triangles = np.array([ends[list(f if sum(i > 2 for i in f) % 2 == 0 else f[::-1])] for f in faces])
    for _ in range(count):
        a, b, c = triangles.transpose(1, 0, 2)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return 0.5 + radius * triangles / np.linalg.norm(triangles, axis=2, keepdims=True)


def enclosed(triangles):
    a, b, c = triangles.transpose(1, 0, 2)
    return float(np.sum(a * np.cross(b, c))) / 6


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("part", [cube(), sphere(4)], ids=["cube", "sphere"])
def test_volume_in_a_closed_surface_is_right_on_cells_of_its_own_size(tmp_path, part, turned):
    """The surface lies along or across the faces of 28 cells of 0.5 m. If only the corners inside the surface
    counted, the volume would be up to 13 % off."""
    axes = np.linalg.qr([[1.0, 2, 3], [0, 1, -2], [1, 0, 1]])[0] if turned else np.eye(3)
    turn = axes * np.sign(np.linalg.det(axes))
    path = tmp_path / "part.stl"
    placed = 0.5 + 0.8 * (part - 0.5) @ turn.T if turned else part
    path.write_bytes(binary_stl(placed))
    found = volumes(box((1, 1, 1), maxh=0.5), [ClosedSurface(path)])[0]
    assert found == pytest.approx(enclosed(placed), rel=0.012)


def test_a_surface_cut_by_a_shape_has_the_remaining_volume(tmp_path):
    """The level functions of the surface and of the shape are both lengths, in domains of any size, so that
    the cut is at the right place."""
    for size in (1e-3, 1.0, 1e3):
        path = tmp_path / "cube.stl"
        path.write_bytes(binary_stl(size * cube()))
        half = ClosedSurface(path) - Block((0.0,) * 3, (size, 0.37 * size, size))
        mesh = box((size,) * 3, maxh=0.4 * size)
        assert volumes(mesh, [half])[0] == pytest.approx(0.6 * 0.43 * 0.6 * size**3, rel=0.01)


def test_overlapping_parts_count_their_volume_once(tmp_path):
    """A level that sums two shells would move the surface outwards."""
    mesh, path = box((1, 1, 1), maxh=0.5), tmp_path / "two.stl"
    path.write_bytes(binary_stl(np.concatenate([cube(0.2, 0.7), cube(0.3, 0.8)])))
    volume = 2 * 0.5**3 - 0.4**3
    assert volumes(mesh, [ClosedSurface(path)])[0] == pytest.approx(volume, rel=0.02)


@pytest.mark.parametrize("turned", [(), (0,), (1, 2), (0, 1, 2)])
def test_shells_inside_a_part_are_holes_for_any_orientation_of_the_triangles(tmp_path, turned):
    """The parts are a small cube and a larger one with a cavity, whose shell is turned together with the
    cube around it."""
    parts = [cube(0.0, 0.2), cube(0.3, 0.9), cube(0.5, 0.7)[:, ::-1]]
    path = tmp_path / "parts.stl"
    path.write_bytes(
        ascii_stl(np.concatenate([p[:, ::-1] if i in turned else p for i, p in enumerate(parts)]))
    )
    points = np.array([[0.1, 0.12, 0.09], [0.4, 0.41, 0.42], [0.6, 0.61, 0.6], [0.25, 0.25, 0.25]])
    assert crossings(ClosedSurface(path).triangles, points).tolist() == [1, 1, 0, 0]


_A, _B, _C, _D = ([0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0])
FLAT = np.array([[_A, _B, _C], [_A, _C, _D], [_A, _D, _B], [_B, _D, _C]], dtype=float)
"""Both sides of a square, each divided along another diagonal."""


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (ascii_stl(cube()[:-1]), "3 of 18 edges"),
        (binary_stl(cube()[1:]), "closed surface"),
        (ascii_stl(np.concatenate([cube()[:1, ::-1], cube()[1:]])), "3 of 18 edges .* opposite orientations"),
        (
            binary_stl(np.concatenate([cube(), cube()])),
            "each triangle once, but 12 of the 24 triangles are repeated",
        ),
        (ascii_stl(np.concatenate([cube(), cube()[:1, ::-1]])), "each triangle once, but 1 of the 13"),
        (ascii_stl([]), "has none"),
        (binary_stl([]), "has none"),
        (b"", "whole STL file"),
        (binary_stl(cube())[:-7], "whole STL file"),
        (ascii_stl(cube())[:300], "whole STL file"),
        (ascii_stl(cube()).replace(b"vertex 0.2", b"vertex q", 1), "three corners"),
        (ascii_stl(cube() * 0), "are one point"),
        (ascii_stl(FLAT), "encloses a volume"),
    ],
)
def test_an_open_empty_or_broken_surface_is_refused(tmp_path, content, expected):
    path = tmp_path / "part.stl"
    path.write_bytes(content)
    with pytest.raises(ParameterError, match=expected) as caught:
        ClosedSurface(path)
    assert caught.value.field == "ClosedSurface.path"


def test_a_missing_surface_and_a_surface_in_a_plane_mesh_are_refused(tmp_path):
    with pytest.raises(ParameterError, match="readable file"):
        ClosedSurface(tmp_path / "none.stl")
    path = tmp_path / "cube.stl"
    path.write_bytes(ascii_stl(cube()))
    with pytest.raises(ParameterError, match="no closed surface in a mesh of two dimensions"):
        volumes(box((1, 1), maxh=0.5), [ClosedSurface(path)])


def picture(path, pixels):
    from matplotlib.image import imsave

    imsave(path, pixels)
    return path


def test_a_picture_gives_the_shape_of_its_dark_part(tmp_path):
    X, Y = np.meshgrid((np.arange(200) + 0.5) / 200, (199.5 - np.arange(200)) / 200)
    # the disc is above the middle, since the first row is the highest one
    dark = (X - 0.5) ** 2 + (Y - 0.7) ** 2 < 0.04
    path = picture(tmp_path / "disc.png", np.repeat(np.where(dark, 0.0, 1.0)[..., None], 3, axis=2))
    mesh = box((2, 1), maxh=0.1)
    image = Image(path, (0, 0), (1, 1))
    assert volumes(mesh, [image])[0] == pytest.approx(0.04 * pi, rel=0.01)
    assert volumes(mesh, [image & Block((0, 0.5), (1, 1))])[0] == pytest.approx(0.04 * pi, rel=0.01)
    bright = Image(path, (0, 0), (1, 1), dark=False)
    assert volumes(mesh, [bright])[0] == pytest.approx(1 - 0.04 * pi, rel=0.01)
    assert volumes(mesh, [Image(path, (0, 0), (2, 1))])[0] == pytest.approx(0.08 * pi, rel=0.01)
    moved = Image(path, low=(0.8, 0), high=(1.8, 1))  # the picture's middle is at x = 1.3
    for low, share in ((1.3, 0.5), (1.15, 0.5 + (np.arcsin(0.75) + 0.75 * (1 - 0.75**2) ** 0.5) / pi)):
        part = moved & Block((low, 0), (2, 1))
        assert volumes(mesh, [part])[0] == pytest.approx(share * 0.04 * pi, rel=0.02)


def test_threshold_of_a_picture_is_the_grey_of_its_edge(tmp_path):
    grey = np.repeat(np.tile((np.arange(200) + 0.5) / 200, (20, 1))[..., None], 3, axis=2)
    path = picture(tmp_path / "ramp.png", grey)
    for threshold in (0.3, 0.6):
        image = Image(path, (0, 0), (1, 1), threshold=threshold)
        assert volumes(box((1, 1), maxh=0.3), [image])[0] == pytest.approx(threshold, abs=0.01)


def test_transparent_pixels_count_as_white(tmp_path):
    pixels = np.zeros((10, 10, 4))
    pixels[:, :5, 3] = 1.0
    path = picture(tmp_path / "half.png", pixels)
    assert volumes(box((1, 1), maxh=0.3), [Image(path, (0, 0), (1, 1))])[0] == pytest.approx(0.5, abs=0.01)


def test_a_file_that_is_no_picture_is_refused(tmp_path, monkeypatch):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no picture")
    good = picture(tmp_path / "good.png", np.zeros((4, 4, 3)))
    for make, field in [
        (lambda: Image(broken, (0, 0), (1, 1)), "Image.path"),
        (lambda: Image(tmp_path / "none.png", (0, 0), (1, 1)), "Image.path"),
        (lambda: Image(tmp_path / "shape.gif", (0, 0), (1, 1)), "Image.path"),
        (lambda: Image(good, (0, 0), (0, 1)), "Image.high"),
        (lambda: Image(good, (0, 0), (1, 1), threshold=1.5), "Image.threshold"),
    ]:
        with pytest.raises(ParameterError) as caught:
            make()
        assert caught.value.field == field
    monkeypatch.setitem(sys.modules, "matplotlib.image", None)
    with pytest.raises(ParameterError, match="pip install"):
        Image(good, (0, 0), (1, 1))


def test_a_subdomain_consists_of_its_own_cells():
    outer, inner = Rectangle(1, 1).Face(), Circle((0.6, 0.5), 0.2).Face()
    inner.faces.name, inner.edges.name = "disc", "interface"
    outer = outer - inner
    outer.faces.name = "matrix"
    mesh = Mesh(OCCGeometry(Glue([outer, inner]), dim=2).GenerateMesh(maxh=0.2)).Curve(3)
    disc, rest = volumes(mesh, [Subdomain("disc")])
    assert disc == pytest.approx(0.04 * pi, rel=1e-3)
    assert disc + rest == pytest.approx(1, rel=1e-12)
    values = Subdomain("disc").inside(mesh, 0).vec.FV().NumPy()
    assert np.unique(np.round(values, 14)).tolist() == [0, 1]
    assert volumes(mesh, [Subdomain(["disc", "matrix"])])[0] == pytest.approx(1, rel=1e-12)
    with pytest.raises(UnknownNameError, match="did you mean 'disc'"):
        volumes(mesh, [Subdomain("dics")])
    with pytest.raises(ParameterError):
        Subdomain([])
