"""Meshes in the files of run directories."""

import pytest

from ngvisco.geometries import disc
from ngvisco.parallel.mesh import volume_and_surface
from ngvisco.run.files import mesh_image, mesh_of

ROUND = disc(1.0, maxh=0.4)


def test_a_curved_mesh_comes_back_with_the_shape_of_its_geometry():
    """Netgen writes eight decimals of curved cells: 3e-10 of this area."""
    found = mesh_of(mesh_image(ROUND))
    assert found.GetCurveOrder() == ROUND.GetCurveOrder() > 1
    assert volume_and_surface(found) == pytest.approx(volume_and_surface(ROUND), rel=1e-14)


def test_curved_cells_without_a_geometry_stay_as_the_file_has_them():
    image = mesh_image(ROUND)
    found = mesh_of(image[: image.index(b"endmesh") + len(b"endmesh\n")])
    assert found.GetCurveOrder() == ROUND.GetCurveOrder()
    assert volume_and_surface(found) == pytest.approx(volume_and_surface(ROUND), rel=1e-8)
