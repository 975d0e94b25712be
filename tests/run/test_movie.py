"""Scenes and movies of VTK series, and pictures in the requested formats."""

import base64
import json
import os
import re
import shutil
import subprocess

import numpy as np
import pytest
from ngsolve import CF, L2, GridFunction, pi, sin, x, y, z
from support import SWIRL, by_ci, swirling

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.fields import scalar_fields
from ngvisco.run.frames import cut, frame_of, read_frame, read_series_files
from ngvisco.run.pictures import (
    Colours,
    CrossSection,
    PlotError,
    _Picture,
    plot_fields,
    unit_of_length,
    write_movie,
)
from ngvisco.run.scene import write_scene, write_scene_of_series
from ngvisco.run.waves import rest_pressure


def series(place, size, **options):
    initial = nv.Initial(density=1 + x + 2 * y, velocity=(*SWIRL, CF(0))[: len(size)])
    run = swirling(box(size, 0.8), initial=initial, observers=[nv.VTKSeries(place)], **options)
    run.run(0.04)
    return run


@pytest.fixture(scope="module", params=[pytest.param((1, 1), id="2d"), by_ci((1, 1, 0.5), id="3d")])
def written(request, tmp_path_factory):
    place = tmp_path_factory.mktemp("series")
    return place, series(place, request.param, passive=["reference_map"])


def test_a_vtk_series_is_read_back_as_it_was_written(written):
    place, run = written
    files = read_series_files(place)
    assert [time for time, _ in files] == [0, 0.02, 0.04]
    frame = read_frame(files[-1][1])
    assert frame.dim == run.mesh.dim and len(frame.cells) == run.mesh.ne
    start = read_frame(files[0][1])
    assert start.scalar("density") == pytest.approx(1 + start.points @ [1, 2, 0])
    assert frame.scalar("velocity") ** 2 == pytest.approx(
        sum(frame.scalar(f"velocity_{i}") ** 2 for i in (1, 2, 3))
    )
    assert frame.scalar("F_12").shape == (len(frame.points),) and "displacement" in frame.fields
    with pytest.raises(nv.UnknownNameError, match="did you mean 'density'"):
        frame.scalar("densiti")
    with pytest.raises(nv.UnknownNameError):
        frame.scalar("F_14")


def test_a_frame_has_the_surface_and_the_sections_of_a_body_of_any_size():
    for size in (1e-12, 1e3):
        frame = frame_of(box((size, size, size), 0.6 * size), {"x": x}, pieces=2)
        assert frame.scalar("x") == pytest.approx(frame.points[:, 0], abs=1e-14 * size)
        assert area(frame.points[frame.boundary()]) == pytest.approx(6 * size**2)
        for position in (0.0, 0.5 * size, size):
            ends, share, triangles = cut(frame, 2, position)
            a, b = frame.points[ends[:, 0]], frame.points[ends[:, 1]]
            section = (a + share[:, None] * (b - a))[triangles]
            assert area(section) == pytest.approx(size**2)


def area(corners):
    edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.linalg.norm(np.cross(*edges), axis=1).sum() / 2


def test_a_movie_has_a_frame_for_every_state(written, tmp_path):
    from PIL import Image

    place, _ = written
    write_movie(place, tmp_path / "movie.gif", ["velocity", "J"], title="a body")
    with Image.open(tmp_path / "movie.gif") as movie:
        assert movie.n_frames == 3
        frames = []
        for i in range(3):
            movie.seek(i)
            frames.append(np.asarray(movie.convert("RGB"), dtype=float))
    assert abs(frames[0] - frames[2]).max() > 50
    assert not list(tmp_path.glob("*.part*"))


def test_an_mp4_is_written_with_ffmpeg_and_refused_without(written, tmp_path, monkeypatch):
    place, _ = written
    if shutil.which("ffmpeg"):
        write_movie(place, tmp_path / "movie.mp4", ["J"])
        assert b"ftyp" in (tmp_path / "movie.mp4").read_bytes()[:16]
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(PlotError, match="needs ffmpeg"):
        write_movie(place, tmp_path / "other.mp4", ["J"])
    assert not list(tmp_path.glob("other*"))


def test_a_scene_of_a_series_has_its_times_and_values_inside_the_body(written, tmp_path):
    place, run = written
    write_scene_of_series(place, tmp_path / "scene.html", ["density", "velocity"], "a body")
    data = data_of(tmp_path / "scene.html")
    assert data["times"] == [0, 0.02, 0.04] and data["dim"] == run.mesh.dim
    assert data["mesh"] == [0, 0, 0] and len(data["meshes"]) == 1
    points = unpacked(data["meshes"][0]["points"]).reshape(-1, 3)
    density = unpacked(data["fields"][0]["values"]).reshape(3, len(points))
    assert density[0] == pytest.approx(1 + points @ [1, 2, 0], rel=1e-5)
    inside = unpacked(data["fields"][0]["inside"])
    assert len(inside) == (3 * 4 * run.mesh.ne if run.mesh.dim == 3 else 0)
    write_scene_of_series(place, tmp_path / "two.html", most=2)
    assert data_of(tmp_path / "two.html")["times"] == [0, 0.04]


def test_pictures_follow_a_mesh_that_changes(tmp_path):
    place, start = tmp_path / "vtk", nv.Initial(velocity=(0.1 * sin(pi * x), 0))
    model = nv.Model(material=nv.LinearElastic(K_e=4.0, G_e=1.0))
    run = nv.Simulation(box((1, 1), 0.5), model, dt=0.1, initial=start)
    run.observers.append(nv.VTKSeries(place))
    run = nv.run_refined(run, nv.Refinement(field="pressure", above=0.3, every=0.1), 0.3)
    write_scene_of_series(place, tmp_path / "scene.html", ["density"])
    data = data_of(tmp_path / "scene.html")
    sizes = [len(unpacked(data["meshes"][i]["points"])) // 3 for i in data["mesh"]]
    assert len(set(sizes)) > 1 and len(unpacked(data["fields"][0]["values"])) == sum(sizes)
    write_movie(place, tmp_path / "movie.gif", ["density"])
    assert (tmp_path / "movie.gif").exists()
    first, *_, last = (read_frame(file) for _, file in read_series_files(place))
    picture, alone = (_Picture(frame, ["density"], None) for frame in (first, last))
    picture.show(last)
    assert np.array_equal(picture.images[0].get_array(), alone.images[0].get_array())


@pytest.mark.parametrize(
    ("path", "fields", "error", "message"),
    [
        ("movie.avi", None, nv.ParameterError, r"ends in .gif or .mp4"),
        ("movie.gif", ["desity"], nv.UnknownNameError, "did you mean 'density'"),
        ("movie.gif", [], nv.ParameterError, "at least one field"),
    ],
)
def test_a_movie_that_cannot_be_made_is_refused(written, tmp_path, path, fields, error, message):
    with pytest.raises(error, match=message):
        write_movie(written[0], tmp_path / path, fields)
    with pytest.raises(nv.CheckpointError, match="no VTK series"):
        write_movie(tmp_path, tmp_path / "movie.gif")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("cut_at", [0.1, 0.5, 0.95])
def test_a_damaged_file_of_a_series_is_refused(written, tmp_path, cut_at):
    whole = read_series_files(written[0])[0][1].read_bytes()
    (tmp_path / "a.vtu").write_bytes(whole[: int(cut_at * len(whole))])
    with pytest.raises(nv.CheckpointError, match=r"a\.vtu: this is not a readable file"):
        read_frame(tmp_path / "a.vtu")


@pytest.mark.parametrize(("kind", "magic"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_pictures_have_the_format_of_their_name(tmp_path, kind, magic):
    path = tmp_path / f"fields.{kind}"
    plot_fields(box((1, 1), 0.7), [("x", x)], path, title="a picture")
    assert path.read_bytes().startswith(magic)
    with pytest.raises(nv.ParameterError, match=r"ends in .png, .pdf or .svg"):
        plot_fields(box((1, 1), 0.7), [("x", x)], tmp_path / "fields.bmp")


def test_a_picture_says_its_time_and_its_plane(tmp_path):
    """An SVG file contains time and plane as texts, which the test reads."""
    import matplotlib

    mesh = box((1, 2, 3), 1.0)
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        plot_fields(mesh, [("f", x + z)], tmp_path / "a.svg", section=CrossSection("y", 0.5), title="t = 2 s")
    text = (tmp_path / "a.svg").read_text()
    assert "t = 2 s, y = 0.5 m" in text and "z, m" in text and "x, m" in text and "y, m" not in text


@pytest.mark.parametrize(
    ("size", "field", "limits"),
    [((1, 1), 5 + x, (5, 6)), ((1, 1, 1), 7 + x, (7, 8)), ((1, 1), 7 + 1e-12 * x, (6.65, 7.35))],
)
def test_colours_of_a_picture_span_the_range_of_the_field(tmp_path, monkeypatch, size, field, limits):
    """If a field varies by rounding only, the range is a tenth of its value."""
    figures = []
    monkeypatch.setattr("ngvisco.run.pictures.save", lambda figure, path: figures.append(figure))
    plot_fields(box(size, 0.7), [("f", field)], tmp_path / "a.png")
    _, scale = figures[0].axes
    assert scale.get_ylim() == pytest.approx(limits)


@pytest.mark.parametrize("text", ["w", "x=", "x=a", "x=nan", "", "x=9"])
def test_an_invalid_plane_and_a_plane_beside_the_body_are_refused(tmp_path, text):
    with pytest.raises(nv.ParameterError, match=r"[Ss]ection"):
        plot_fields(box((1, 1, 1), 1.0), [("x", x)], tmp_path / "a.png", section=CrossSection.parse(text))


def test_pressure_from_rest_is_zero_at_rest_for_all_materials():
    materials = [
        nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0),
        nv.BarotropicFluid(B=1.0, gamma=1.4),
        nv.LinearElastic(K_e=1.0, G_e=1.0),
        nv.Yosida(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1), eps=1e-2),
    ]
    assert rest_pressure(materials[0], 2) == pytest.approx(-(3 * 5 + 0.1**2 / 20))
    assert rest_pressure(materials[2], 3) == pytest.approx(0.4)
    for material in materials:
        run = nv.Simulation(box((1, 1), 1.0), nv.Model(material=material), dt=0.1)
        assert run.fields["pressure_from_rest"](run.mesh(0.3, 0.4)) == pytest.approx(0, abs=1e-9)


def data_of(path):
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', path.read_text(), re.S)[1]
    return json.loads(text)


def unpacked(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


@pytest.mark.parametrize("size", [(1, 2), (1, 2, 0.5)])
def test_scene_holds_mesh_and_values(tmp_path, size):
    """The scene contains each piece of the surface once, and the values of an affine field at all corners."""
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


def test_a_scene_loads_no_other_file(tmp_path):
    write_scene(box((1, 1), maxh=0.7), {"x": x}, tmp_path / "scene.html")
    page = tmp_path / "scene.html"
    assert not re.search(r"https?:|//[a-z]+\.|\bsrc=|\bimport\b|fetch\(|XMLHttp|<link", page.read_text())


def browser():
    """The command of Chromium, or None; with NGVISCO_REQUIRE_BROWSER set, a missing Chromium is an error."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    found = next((path for path in map(shutil.which, names) if path), None)
    assert found or not os.environ.get("NGVISCO_REQUIRE_BROWSER"), (
        "NGVISCO_REQUIRE_BROWSER needs chromium: apt-get install chromium"
    )
    return found


@pytest.mark.skipif(
    browser() is None, reason="no chromium; with NGVISCO_REQUIRE_BROWSER set this is an error"
)
@pytest.mark.parametrize("size", [by_ci((1, 1)), (1, 1, 1)])
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


def test_unknown_fields_and_tensors_are_refused_for_a_scene(tmp_path):
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


def test_colours_ignore_spikes_and_are_logarithmic_for_rates():
    even = np.linspace(1.0, 2.0, 1000)
    plain = Colours.of("pressure", even)
    assert (plain.norm.vmin, plain.norm.vmax, plain.extend) == (1.0, 2.0, "neither")
    spiked = Colours.of("pressure", np.append(even, 1e4))
    assert 1.9 < spiked.norm.vmax < 2.01 and 1.0 < spiked.norm.vmin < 1.01
    assert spiked.extend == "both"
    rates = Colours.of("creep rate", np.geomspace(1e-22, 1e-14, 1000))
    assert type(rates.norm).__name__ == "LogNorm" and rates.norm.vmax == pytest.approx(1e-14)
    assert rates.norm.vmin == pytest.approx(1e-20) and rates.extend == "min"
    assert type(Colours.of("creep rate", even).norm).__name__ == "Normalize"
    assert Colours.of("J", np.ones(9)).norm.vmin < 1 < Colours.of("J", np.ones(9)).norm.vmax


def test_axes_have_a_unit_of_their_size_and_short_axes_show_their_ends(tmp_path):
    sizes = {4e4: "km", 1e3: "m", 1.0: "m", 5e-3: "mm", 3e-5: "µm", 1e-12: "nm"}
    assert {size: unit_of_length(size)[0] for size in sizes} == sizes
    mesh = box((1e4, 4e4), 2e4)
    picture = _Picture(frame_of(mesh, {"x": x}), ["x"], None)
    axis = picture.axes[0]
    assert axis.get_xlabel() == "x, km" and axis.get_xticks() == pytest.approx([0.0, 10.0], abs=1e-9)
    assert axis.get_ylim()[1] < 45
