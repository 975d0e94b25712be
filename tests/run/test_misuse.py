"""Nonsense in scripts is named where it is met, in place of a bare error, a wrong picture or a wrong run."""

import re

import pytest

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.frames import read_pvd
from ngvisco.run.pictures import Section, plot_fields, write_movie
from ngvisco.run.plots import plot_energies, plot_history

DT = 0.02


@pytest.fixture(scope="module")
def mesh():
    return box((1, 1), maxh=0.7)


def simulation(mesh, *observers):
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        loads=[nv.Gravity((0.0, -1.0))],
    )
    return nv.Simulation(mesh, model, dt=DT, observers=observers)


class Meddler(nv.Observer):
    def step(self, simulation, row):
        simulation.t = 0.5


def test_an_observer_does_not_set_the_time(mesh):
    run = simulation(mesh, Meddler())
    with pytest.raises(nv.ParameterError, match=r"Simulation\.t = 0\.5: expected not to be set"):
        run.run(2 * DT)
    assert run.t == DT


@pytest.mark.parametrize(
    "make", [nv.Checkpoints, nv.LedgerCSV, lambda path: nv.Probes({"p": (0.5, 0.5)}, path=path)]
)
def test_a_directory_is_no_file(make, tmp_path):
    with pytest.raises(
        nv.ParameterError, match=r"\.path = .*expected the path of a file; this is a directory"
    ):
        make(tmp_path)


def test_a_file_is_no_directory(tmp_path):
    (tmp_path / "there").write_text("mine")
    with pytest.raises(
        nv.ParameterError, match=r"VTKSeries\.directory = .*expected a directory; this is a file"
    ):
        nv.VTKSeries(tmp_path / "there")


@pytest.mark.parametrize(
    "make",
    [
        lambda: nv.VTKSeries("vtk", fields=[]),
        lambda: nv.Probes({"p": (0.5, 0.5)}, fields=[]),
        lambda: nv.LineSamples((0, 0), (1, 1), fields=[]),
        lambda: nv.WallForces([]),
        lambda: nv.WallForces(["top", "top"]),
    ],
)
def test_nothing_is_not_all(make):
    with pytest.raises(nv.ParameterError, match="at least one name, and each once"):
        make()


def test_a_refined_mesh_ends_the_run():
    mesh = box((1, 1), maxh=0.7)
    run = simulation(mesh)
    run.run(DT)
    cells = mesh.ne
    mesh.Refine()
    with pytest.raises(
        nv.MeshError, match=f"has {mesh.ne} cells, and {cells} when the run was made.*nv.transfer"
    ):
        run.run(2 * DT)


def test_a_ledger_without_steps_has_no_picture(mesh, tmp_path):
    run = simulation(mesh)
    for plot in (plot_energies, plot_history):
        with pytest.raises(
            nv.ParameterError, match=r"ledger = '0 rows': expected a ledger of a run that made a step"
        ):
            plot(run.ledger, tmp_path / "picture.png")
    assert not list(tmp_path.iterdir())


def test_what_is_flat_has_no_section(mesh, tmp_path):
    run = simulation(mesh, nv.VTKSeries(tmp_path / "vtk"))
    run.run(DT)
    with pytest.raises(nv.ParameterError, match="section = 'x': expected none"):
        plot_fields(mesh, [("density", run.fields["density"])], tmp_path / "a.png", Section("x"))
    with pytest.raises(nv.ParameterError, match="section = 'x': expected none"):
        write_movie(tmp_path / "vtk", tmp_path / "a.gif", section=Section("x"))


@pytest.mark.parametrize("content", [b"\xff\xfe\x00\x81", b"nothing", b'timestep="soon" file="a.vtu"'])
def test_what_is_no_series_is_said(content, tmp_path):
    (tmp_path / "fields.pvd").write_bytes(content)
    with pytest.raises(nv.CheckpointError, match=r"fields\.pvd: not a "):
        read_pvd(tmp_path / "fields.pvd")


def test_no_state_out_of_turn_stays_in_a_series(mesh, tmp_path):
    """What an interrupted run wrote as its last state is no longer in the series when it goes on."""

    def files():
        return {path.name for path in tmp_path.glob("vtk/*.vtu")}

    observers = [nv.VTKSeries(tmp_path / "vtk", every=2), nv.Checkpoints(tmp_path / "run.h5", every=1)]
    simulation(mesh, *observers).run(DT)
    assert files() == {"fields_000000.vtu", "fields_000001.vtu"}
    (tmp_path / "vtk" / "fields_000007.vtu").write_text("of a process that was killed before it listed it")
    (tmp_path / "vtk" / "fields_of_mine.vtu").write_text("mine")
    again = simulation(mesh, *observers)
    again.restore(tmp_path / "run.h5")
    again.run(2 * DT)
    assert files() == {"fields_000000.vtu", "fields_000002.vtu", "fields_of_mine.vtu"}
    assert [name for _, name in read_pvd(tmp_path / "vtk/fields.pvd")] == [
        "fields_000000.vtu",
        "fields_000002.vtu",
    ]


def test_an_integral_that_is_none_any_more_is_said_once(mesh):
    once = nv.Integrals({"pole": "sqrt(0.03 - t)"})
    run = simulation(mesh, once)
    with pytest.warns(nv.InputWarning, match=r"integral 'pole': it is nan at t = 0\.04 s") as said:
        run.run(3 * DT)
    assert len([one for one in said if "pole" in str(one.message)]) == 1


def test_functions_in_messages_have_no_address(mesh):
    model = nv.Model(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1), loads=[nv.Gravity(nv.time)])
    with pytest.raises(nv.ParameterError) as caught:
        nv.Simulation(mesh, model, dt=DT)
    assert re.match(
        r"loads\['gravity'\]\.g = <Parameter>: expected a vector of length 2, not 1", str(caught.value)
    )
