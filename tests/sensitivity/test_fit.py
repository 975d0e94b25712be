"""Fits recover the parameters of their data, with deviations; invalid data are refused."""

import numpy as np
import pytest

import ngvisco as nv
from ngvisco.case.units import factor
from ngvisco.geometries import channel
from ngvisco.sensitivity.data import Data
from tests.verification.cases.sensitivities import measure

MESH = channel(1, 1, maxh=1.2)
TIMES = np.arange(1, 11) * 0.1
COLUMN = "integral of top.velocity_1"


def creep(G_e=2.0, G_m=1.0, **options):
    """A layer under a constant shear traction."""
    model = nv.Model(
        material=nv.LinearElastic(K_e=10, G_e=G_e),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        creep=nv.Creep(G_m=G_m),
    )
    walls = {"top": nv.Traction(f=(0.02, 0.0)), "bottom": nv.NoSlip()}
    observers = [nv.Probes({"top": (0.5, 1.0)}, ["velocity"])]
    given = dict(walls=walls, dt=0.1, scheme="backward-euler", solver="coupled", observers=observers)
    return nv.Simulation(MESH, model, **given | options)


def data_of(noise=0.0, **true):
    of = [f"top.velocity_1 until {t:.1f}" for t in TIMES]
    values = measure(creep(**true), 1.0, of)
    drawn = noise * np.random.default_rng(1).standard_normal(len(values))
    return {"time": TIMES, COLUMN: values + drawn}


@pytest.mark.long
@pytest.mark.ci
def test_a_fit_recovers_the_parameters_of_its_data():
    data, seen = data_of(G_e=1.3, G_m=1.7), []
    simulation = creep()
    found = nv.fit(
        simulation, data, by=["material.G_e", "creep.G_m"], sigma=1e-5, tolerance=1e-7, progress=seen.append
    )
    assert found["material.G_e"] == pytest.approx(1.3, rel=1e-6)
    assert found["creep.G_m"] == pytest.approx(1.7, rel=1e-6)
    assert found.runs == len(seen) <= 8 and simulation.number == 0
    assert "correlation of material.G_e and creep.G_m" in str(found)


@pytest.mark.long
@pytest.mark.ci
def test_a_fit_to_noisy_data_has_the_right_deviations(tmp_path):
    """The covariance equals that of the linearised problem, with derivatives by differences of whole runs."""
    noise, by = 2e-5, ["material.G_e", "creep.G_m"]
    found = nv.fit(creep(), data_of(noise, G_e=1.3, G_m=1.7), by=by, sigma=noise)
    off = (found.values - (1.3, 1.7)) / found.deviations
    assert abs(off).max() < 3 and 0.2 < found.reduced < 3
    h, columns = 1e-4, []
    for i in range(2):
        sides = []
        for s in (1, -1):
            p = found.values + s * h * np.eye(2)[i]
            sides.append(data_of(G_e=p[0], G_m=p[1])[COLUMN])
        columns.append((sides[0] - sides[1]) / (2 * h * noise))
    J = np.array(columns).T
    assert np.allclose(found.covariance, np.linalg.inv(J.T @ J), rtol=1e-4)
    estimated = nv.fit(creep(), data_of(noise, G_e=1.3, G_m=1.7), by=by)
    scale = estimated.deviations / found.deviations
    assert np.allclose(scale, np.sqrt(found.reduced), rtol=1e-3)
    found.plot(tmp_path / "fit.png")
    assert (tmp_path / "fit.png").stat().st_size > 10_000


@pytest.mark.long
@pytest.mark.ci
def test_a_fit_keeps_its_bounds_and_reports_active_ones():
    found = nv.fit(creep(), data_of(G_e=1.3), by=["material.G_e"], bounds={"material.G_e": (1.5, 3.0)})
    assert found["material.G_e"] == pytest.approx(1.5, rel=1e-4) and "AT ITS BOUND" in str(found)


def test_a_parameter_without_effect_has_an_unbounded_deviation():
    """The bulk modulus has no effect in shear."""
    found = nv.fit(creep(), data_of(), by=["material.G_e", "material.K_e"], sigma=1e-5)
    assert np.isinf(found.deviations).all() or found.deviations[1] > 1e3 * found.deviations[0]


@pytest.mark.long
@pytest.mark.ci
def test_the_file_of_a_fit_has_units(tmp_path):
    path = tmp_path / "data.csv"
    rows = zip(TIMES * 1e3, data_of(G_e=1.3)[COLUMN] * 1e3, strict=True)
    lines = [f"time [ms],{COLUMN} [mm]", *(f"{float(t)!r},{float(d)!r}" for t, d in rows)]
    path.write_text("\n".join(lines) + "\n")
    found = nv.fit(creep(), path, by=["material.G_e"], factor=factor)
    assert found["material.G_e"] == pytest.approx(1.3, rel=1e-4)
    with pytest.raises(nv.DataError, match="ngvisco fit converts units"):
        nv.fit(creep(), path, by=["material.G_e"])
    path.write_text("\n".join([f"time [m],{COLUMN}", *lines[1:]]))
    with pytest.raises(nv.DataError, match="unit of the column time, 'm'"):
        nv.fit(creep(), path, by=["material.G_e"], factor=factor)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no rows of data"),
        ("time,kinetic\n", "no rows of data"),
        ("0.1,2\n0.2,3\n", "not the name of a column"),
        ("t,kinetic\n0.1,2\n", "no column 'time'"),
        ("time\n0.1\n", "no column besides"),
        ("time,kinetic\n0.1\n", "row 2: the number of values is 1, but the number of columns is 2"),
        ("time,kinetic\n0.1,x\n", "kinetic = 'x'; expected a finite number"),
        ("time,kinetic\n-0.1,1\n", "times >= 0"),
        ("time,kinetic\n,1\n", "times >= 0"),
        ("time,kinetic\n0.1,\n", "kinetic has no values"),
        ("time,kinetic\n0.1,inf\n", "expected a finite number"),
    ],
)
def test_invalid_tables_of_data_are_refused(tmp_path, text, said):
    (tmp_path / "data.csv").write_text(text)
    with pytest.raises(nv.DataError, match=said):
        Data.of(tmp_path / "data.csv")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"tolerance": 0}, "a finite number > 0"),
        ({"until": 0.5}, "but the run ends at"),
        ({"sigma": -1.0}, "a standard deviation > 0"),
        ({"by": []}, "at least one parameter"),
        ({"bounds": {"creep.G_m": (1, 2)}}, "one of material.G_e"),
        ({"bounds": {"material.G_e": (3, 4)}}, "between them"),
        ({"data": {"time": [0.1, 0.2], "cinetic": [1, 2]}}, "unknown column 'cinetic'"),
        ({"data": {"time": [0.1], "kinetic": [1]}}, "expected at least 2"),
        ({"data": {"time": [0.1, 0.2], "kinetic": [1]}}, "as many values"),
        ({"data": {"time": [0.1, 0.2], "kinetic": ["a", 1]}}, "a sequence of numbers"),
    ],
)
def test_a_fit_of_unsuitable_parameters_is_refused(options, said):
    given = {"data": {"time": TIMES, COLUMN: TIMES}, "by": ["material.G_e"]} | options
    data = given.pop("data")
    with pytest.raises(nv.NgviscoError, match=said):
        nv.fit(creep(), data, **given)


@pytest.mark.long
@pytest.mark.ci
def test_a_stopped_fit_repeats_no_finished_run(tmp_path):
    """The second call stops within a step of its first run, which is the third run of the search."""
    data, given = data_of(G_e=1.3), {"by": ["material.G_e"], "sigma": 1e-4, "restart": tmp_path}
    seen, simulation = [], creep()

    def stop(line):
        seen.append(line)
        if len(seen) == 2:
            simulation.request_stop()

    with pytest.raises(nv.StopRequested, match="stopped in run 3"):
        nv.fit(simulation, data, progress=stop, **given)
    assert {path.name for path in tmp_path.iterdir()} == {"case.h5", "run-0001.h5", "run-0002.h5"}
    later = []
    found = nv.fit(creep(), data, progress=later.append, **given)
    whole = nv.fit(creep(), data, **given | {"restart": None})
    assert np.array_equal(found.values, whole.values) and np.array_equal(found.covariance, whole.covariance)
    assert len(later) == found.runs - 2 and found.runs == whole.runs
    with pytest.raises(nv.CheckpointError, match="another sigma"):
        nv.fit(creep(), data, **given | {"sigma": 2e-4})
    with pytest.raises(nv.CheckpointError, match="another data"):
        nv.fit(creep(), data_of(G_e=1.4), **given)
