"""VTK series, CSV ledger and pictures: the files contain the computed values."""

import csv
import re
import struct
import time
import xml.dom.minidom
from functools import partial

import numpy as np
import pytest
from support import SWIRL, swirling

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.fields import usual
from ngvisco.run.frames import read_frame, read_pvd
from ngvisco.run.pictures import widened
from ngvisco.run.plots import plot_energies, plot_history


def small_run(observers, material=None, steps=4):
    laws = {"viscosity": nv.StokesViscosity(K_v=0.01, G_v=0.01), "loads": [nv.Gravity((0.0, -1.0))]}
    run = swirling(observers=observers, **laws | ({"material": material} if material else {}))
    run.run(steps * 0.02)
    return run


def read_vtu(path):
    """Arrays by name with their components' names, from a .vtu with raw appended data."""
    head, _, tail = path.read_bytes().partition(b'<AppendedData encoding="raw">')
    document = xml.dom.minidom.parseString(head + b"</VTKFile>")
    raw = tail[tail.index(b"_") + 1 :]
    kinds = {"Float64": "<f8", "Int32": "<i4", "UInt8": "<u1"}
    arrays = {}
    for node in document.getElementsByTagName("DataArray"):
        offset, count = int(node.getAttribute("offset")), int(node.getAttribute("NumberOfComponents") or 1)
        (length,) = struct.unpack_from("<I", raw, offset)
        data = np.frombuffer(raw, kinds[node.getAttribute("type")], length // 8, offset + 4) if length else []
        labels = [node.getAttribute(f"ComponentName{i}") for i in range(count)]
        if node.getAttribute("type") == "Float64":
            arrays[node.getAttribute("Name")] = (np.reshape(data, (-1, count)), labels)
    return arrays


def two_bodies(maxh=0.3, **options):
    rest = {"viscosity": nv.StokesViscosity(K_v=0.01, G_v=0.01), "density": 1}
    disc = nv.Body(
        name="disc",
        where=nv.Ball((0.6, 0.5), 0.3),
        material=nv.IsochoricNeoHookean(K_e=50, G_e=0.1),
        order=1,
        **rest,
    )
    fluid = nv.Body(name="fluid", material=nv.IsochoricNeoHookean(K_e=50, G_e=0.2), **rest)
    return nv.Simulation(box((1, 1), maxh), nv.Model(bodies=[fluid, disc]), dt=0.02, **options)


def test_writing_stresses_and_outlines_of_bodies_takes_less_time_than_a_step(tmp_path):
    """In an earlier version, which evaluated each part of the pressure again for each use, writing a stress
    took as long as sixty steps."""
    run = two_bodies()
    began = time.process_time()
    run.advance()
    taken = time.process_time() - began
    series = nv.VTKSeries(tmp_path, fields=["von_mises"], subdivision=2)
    began = time.process_time()
    series.start(run)
    series.finish(run)
    assert time.process_time() - began < taken
    frame = read_frame(tmp_path / series.files.written[-1][1])
    assert frame.bodies == ["fluid_fraction"] and next(iter(frame.fields)) == "von_mises"
    assert len(frame.cells) == 16 * run.mesh.ne
    x, y, _ = frame.points[frame.cells[40]].mean(axis=0)
    inside = frame.fields["von_mises"][frame.cells[40], 0].mean()
    assert inside == pytest.approx(run.fields["von_mises"](run.mesh(x, y)), rel=0.1, abs=1e-12)


@pytest.mark.long
@pytest.mark.ci
def test_writing_a_file_of_stresses_costs_less_than_a_tenth_of_a_step(tmp_path):
    """The test compares medians of processor time, for bodies that move on 420 cells."""
    spent = {"step": [], "file": []}
    series = nv.VTKSeries(tmp_path, every=1, fields=["von_mises"], subdivision=2)
    run = two_bodies(0.075, initial=nv.Initial(velocity=SWIRL))
    series.start(run)
    for _ in range(4):
        for name, work in (("step", run.advance), ("file", partial(series.step, run, {}))):
            began = time.process_time()
            work()
            spent[name].append(time.process_time() - began)
    assert len(series.files.written) == 5
    assert np.median(spent["file"]) < 0.1 * np.median(spent["step"])


def test_a_file_of_the_velocity_alone_has_one_point_per_vertex(tmp_path):
    run = swirling()
    for names, count in ((["velocity"], run.mesh.nv), (["velocity", "density"], 3 * run.mesh.ne)):
        series = nv.VTKSeries(tmp_path / str(count), fields=names)
        series.start(run)
        frame = read_frame(series.directory / series.files.written[-1][1])
        assert len(frame.points) == count and len(frame.cells) == run.mesh.ne
        a = frame.points[frame.cells[2, 1]]
        assert frame.fields["velocity"][frame.cells[2, 1], :2] == pytest.approx(
            run.fields["velocity"](run.mesh(a[0], a[1])), abs=1e-12
        )


def test_vtk_series_holds_the_fields_with_labelled_components(tmp_path):
    run = small_run([nv.VTKSeries(tmp_path, every=2)])
    series = read_pvd(tmp_path / "fields.pvd")
    assert [t for t, _ in series] == [0.0, 0.04, 0.08]
    arrays = read_vtu(tmp_path / series[-1][1])
    assert set(arrays) - {"Points"} == set(usual(run.fields))
    assert arrays["velocity"][1] == ["x", "y", "z"]
    assert arrays["cauchy_stress"][1] == ["11", "12", "13", "21", "22", "23", "31", "32", "33"]
    rho, _ = arrays["density"]
    points, _ = arrays["Points"]
    assert rho.shape == (3 * run.mesh.ne, 1)
    low, high = run.sampler.extrema(run.fields["density"])
    # density is linear in each cell: its extrema are at the vertices, which are the output's points
    assert rho.min() == pytest.approx(low, rel=1e-12) and rho.max() == pytest.approx(high, rel=1e-12)
    assert points.min() >= -1e-12 and points.max() <= 1 + 1e-12
    T, _ = arrays["cauchy_stress"]
    assert arrays["pressure"][0][:, 0] == pytest.approx(-T[:, [0, 4, 8]].sum(axis=1) / 3, rel=1e-10)
    deviator = T - T[:, [0, 4, 8]].mean(axis=1)[:, None] * np.eye(3).ravel()
    mises = np.sqrt(1.5 * (deviator**2).sum(axis=1))
    assert arrays["von_mises"][0][:, 0] == pytest.approx(mises, rel=1e-9)


def test_the_csv_file_has_a_row_for_each_step_and_the_agreed_column_names(tmp_path):
    run = small_run([nv.LedgerCSV(tmp_path / "ledger.csv")])
    with (tmp_path / "ledger.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    agreed = "step time dt kinetic stored closure closure_relative mass mass_drift rho_min rho_max J_min"
    assert set([*agreed.split(), "newton_iterations", "cfl"]) <= set(rows[0])
    assert [float(row["step"]) for row in rows] == [0, 1, 2, 3, 4]
    for name in run.ledger.columns:
        np.testing.assert_array_equal([float(row[name]) for row in rows], run.ledger.column(name))


def test_progress_prints_every_nth_step_and_the_last(tmp_path, capsys):
    small_run([nv.Progress(until=0.08, every=3)])
    printed = capsys.readouterr().out
    assert re.findall(r"step\s+(\d+)/4", printed) == ["3", "4"]
    assert "closure" in printed and "0 s left" in printed


def test_entropies_and_states_are_not_drawn_as_energies(tmp_path, monkeypatch):
    """Entropies have their own axes, and a share of the stored energy is a state, not a rate."""
    drawn = {}
    monkeypatch.setattr("ngvisco.run.plots.save", lambda figure, path: drawn.update({path.stem: figure}))
    cold = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)
    laws = {"loads": [nv.Gravity((0, -1))], "viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1)}
    warm = nv.Model(material=nv.Thermal(material=cold, c=2.0, theta_R=1.0), **laws)
    broken = nv.Model(material=nv.Damaged(material=cold, G_c=0.1, length=0.5), loads=[nv.Gravity((0, -1))])
    labels = {}
    for name, model in (("warm", warm), ("broken", broken)):
        run = nv.Simulation(box((1, 1), maxh=1.0), model, dt=0.02)
        ledger = run.run(0.04)
        plot_energies(ledger, tmp_path / f"{name}.png")
        plot_history(ledger, tmp_path / f"{name}-history.png")
        for picture in (name, f"{name}-history"):
            labels[picture] = {line.get_label() for line in drawn[picture].axes[0].lines}
    assert not any("entropy" in label for of in labels.values() for label in of)
    *others, production, warmth = drawn["warm-history"].axes
    assert len(others) == len(drawn["broken-history"].axes)
    assert {line.get_label() for line in production.lines} == {"stokes bulk", "stokes shear", "upwinding"}
    assert warmth.get_title() == "least and largest temperature, K"
    assert [line.get_ydata()[0] for line in warmth.lines] == [1.0, 1.0]
    for low, high, wide in ((1, 1 + 1e-12, True), (1, 1 + 1e-8, False), (-15, -15, True), (0, 1e-15, False)):
        least, most = widened(low, high)
        assert (most - least > 0.09 * abs(high)) if wide else (least, most) == (low, high)
    surface = next(line for line in drawn["broken"].axes[0].lines if "surface" in line.get_label())
    assert surface.get_label() == "stored surface − initial"
    column = ledger.column("stored_surface")
    assert np.allclose(surface.get_ydata(), column - column[0])
    assert not any("surface" in label for label in labels["broken-history"])
