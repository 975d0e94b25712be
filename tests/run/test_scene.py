"""The scene is one file that needs no network, and a browser draws the field in it."""

import base64
import json
import os
import re
import shutil
import subprocess

import numpy as np
import pytest
from ngsolve import CF, L2, GridFunction, x, y, z

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.fields import scalar_fields
from ngvisco.run.scene import write_scene


def data_of(path):
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', path.read_text(), re.S)[1]
    return json.loads(text)


def unpacked(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


@pytest.mark.parametrize("size", [(1, 2), (1, 2, 0.5)])
def test_scene_holds_mesh_and_values(tmp_path, size):
    """The surface is drawn once and whole, and an affine field has its values at all corners."""
    mesh = box(size, maxh=0.7)
    field = GridFunction(L2(mesh, order=1))
    f = x + 2 * y + 3 * (z if len(size) == 3 else 0)
    field.Set(f)
    write_scene(mesh, {"f": field, "other": CF(1.0)}, tmp_path / "scene.html", "a </script> title")
    data = data_of(tmp_path / "scene.html")
    points = unpacked(data["meshes"][0]["points"]).reshape(-1, 3, 3)
    assert data["mesh"] == [0] and data["title"] == "a </script> title"
    values = unpacked(data["fields"][0]["values"]).reshape(-1, 3)
    assert values == pytest.approx(points @ [1, 2, 3 if len(size) == 3 else 0], abs=1e-5)
    areas = np.linalg.norm(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1) / 2
    exact = 2.0 if len(size) == 2 else 2 * (1 * 2 + 1 * 0.5 + 2 * 0.5)
    assert areas.sum() == pytest.approx(exact, rel=1e-5)


def test_scene_needs_nothing_from_outside(tmp_path):
    write_scene(box((1, 1), maxh=0.7), {"x": x}, tmp_path / "scene.html")
    page = tmp_path / "scene.html"
    assert not re.search(r"https?:|//[a-z]+\.|\bsrc=|\bimport\b|fetch\(|XMLHttp|<link", page.read_text())


def browser():
    """Chromium's command, or None; where NGVISCO_REQUIRE_BROWSER is set it must be there."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    found = next((path for path in map(shutil.which, names) if path), None)
    assert found or not os.environ.get("NGVISCO_REQUIRE_BROWSER"), (
        "NGVISCO_REQUIRE_BROWSER needs chromium: apt-get install chromium"
    )
    return found


@pytest.mark.skipif(
    browser() is None, reason="no chromium; with NGVISCO_REQUIRE_BROWSER set this is an error"
)
@pytest.mark.parametrize("size", [(1, 1), (1, 1, 1)])
def test_browser_draws_the_field(tmp_path, size):
    from matplotlib.image import imread

    mesh = box(size, maxh=0.5)
    write_scene(mesh, {"x": x, "y": y}, tmp_path / "scene.html", "an affine field")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--window-size=800,700", "--hide-scrollbars"]
    command = [browser(), *options, "--enable-logging=stderr", f"--user-data-dir={tmp_path / 'profile'}"]
    picture = tmp_path / "scene.png"
    result = subprocess.run(
        [*command, f"--screenshot={picture}", (tmp_path / "scene.html").as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert picture.exists(), result.stderr
    assert "Uncaught" not in result.stderr, result.stderr
    image = imread(picture)[100:640, :700, :3]
    row = image[len(image) // 2]
    drawn = np.flatnonzero(row.min(axis=1) < 0.9)
    assert len(drawn) > 250  # the body fills a good part of the window
    left, right = row[drawn[4]], row[drawn[-5]]
    assert left[2] > left[0]  # viridis: violet where x is small,
    if len(size) == 2:
        assert right[0] > 0.8 and right[1] > 0.8 and right[2] < 0.4  # yellow where it is large
    assert len(np.unique(np.round(row[drawn], 2), axis=0)) > 50


def test_unknown_fields_and_tensors(tmp_path):
    mesh = box((1, 1), maxh=0.7)
    tensor = CF((x, 0, 0, 0, y, 0, 0, 0, 1), dims=(3, 3))
    fields = {"velocity": CF((x, y)), "density": CF(1.0), "F": tensor}
    assert list(scalar_fields(fields)) == ["density", "velocity"]
    assert scalar_fields(fields, ["F_22"])["F_22"](mesh(0.2, 0.3)) == pytest.approx(0.3)
    with pytest.raises(nv.UnknownNameError, match="'F_44'"):
        scalar_fields(fields, ["F_44"])
    with pytest.raises(nv.ParameterError, match=r"'F'.*a scalar"):
        write_scene(mesh, {"F": tensor}, tmp_path / "scene.html")
    with pytest.raises(nv.ParameterError, match="at least one field"):
        write_scene(mesh, {}, tmp_path / "scene.html")
