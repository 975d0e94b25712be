"""A resumed run equals the uninterrupted one; checkpoints of other runs are refused; meshes in files."""

import h5py
import numpy as np
import pytest
from ngsolve import SetNumThreads, sin, x, y
from support import assert_goes_on, assert_same, swirling

import ngvisco as nv
from ngvisco.geometries import box, disc
from ngvisco.parallel.mesh import volume_and_surface
from ngvisco.run import checkpoint
from ngvisco.run.files import mesh_image, mesh_of

NEO_HOOKEAN = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)


CREEP = nv.Creep(G_m=5.0)


def simulation(observers=(), material=NEO_HOOKEAN, maxh=0.5, creep=CREEP, **options):
    loads, hyper = [nv.Gravity((0.0, sin(3 * nv.time)))], nv.HyperViscosity(mu=1e-4)
    laws = {"material": material, "creep": creep, "hyperviscosity": hyper, "loads": loads}
    return swirling(maxh, observers=observers, **laws, **options)


def observers(directory):
    return [
        nv.LedgerCSV(directory / "ledger.csv"),
        nv.VTKSeries(directory / "vtk", every=2),
        nv.Checkpoints(directory / "run.h5", every=3),
    ]


SOLID = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0)


@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_a_run_is_resumed_with_another_flow_rule(tmp_path, solver):
    """The checkpoint of linear creep has no linearisation stresses, which the flow rule with a yield stress
    needs."""
    simulation([nv.Checkpoints(tmp_path / "run.h5", every=1)], SOLID, solver=solver).run(0.04)
    rest = simulation(material=SOLID, creep=nv.Perzyna(sigma_Y=0.05, G_m=0.1), solver=solver)
    rest.restore(tmp_path / "run.h5")
    ledger = rest.run(0.08)
    assert abs(ledger.column("closure_relative")).max() < 1e-12 and not ledger.column("rejections").any()


@pytest.mark.parametrize("solver, other", [("split", "coupled"), ("coupled", "split")])
def test_a_run_is_resumed_with_the_other_solver(tmp_path, solver, other):
    """A checkpoint by the split solver has only the unknowns on which that solver iterates."""
    whole = simulation([nv.Checkpoints(tmp_path / "run.h5", every=1, keep=9)], SOLID, solver=solver)
    whole.run(0.06)
    again, same = (simulation(material=SOLID, solver=name) for name in (other, solver))
    for run in (again, same):
        run.restore(tmp_path / "run.h5", step=2)
    # unknowns that the file lacks are zero: a matrix at this state would differ, so that none is assembled
    assert same.solver.newton.is_factorised and not again.solver.newton.is_factorised
    again.run(0.06)
    assert_same(whole, again)


def test_a_checkpoint_of_another_run_is_refused_with_the_reason(tmp_path):
    simulation([nv.Checkpoints(tmp_path / "run.h5")]).run(0.02)
    stiffer = nv.NeoHookean(K_e=20.0, G_e=5.0, epsilon=0.1)
    for reason, other in (
        ("mesh", simulation(maxh=0.3)),
        ("spaces", simulation(discretisation=nv.Discretisation(m=2))),
        ("material", simulation(material=stiffer)),
    ):
        before = other.rothe_step.state.vec.FV().NumPy().copy()
        with pytest.raises(nv.CheckpointError, match=f"the checkpoint has {reason} = "):
            other.restore(tmp_path / "run.h5")
        assert np.array_equal(before, other.rothe_step.state.vec.FV().NumPy())


def test_a_checkpoint_with_a_flipped_bit_is_refused_or_reads_the_same(tmp_path):
    """The file's bytes are data, names, or unused: a changed byte must not give another state."""
    path = tmp_path / "run.h5"
    simulation([nv.Checkpoints(path)]).run(0.02)
    run = simulation()
    run.restore(path)
    state, row = run.rothe_step.state.vec.FV().NumPy().copy(), run.ledger.rows[-1]
    whole, chance = path.read_bytes(), np.random.default_rng(7)
    refused = 0
    for where in chance.choice(len(whole), 60, replace=False):
        damaged = bytearray(whole)
        damaged[where] ^= 1 << int(chance.integers(8))
        path.write_bytes(bytes(damaged))
        try:
            run.restore(path)
        except nv.CheckpointError:
            refused += 1
        assert np.array_equal(run.rothe_step.state.vec.FV().NumPy(), state)
        assert run.ledger.rows[-1] == pytest.approx(row, rel=0, abs=0, nan_ok=True)
    assert refused >= 10  # most of the file is data, in which a flipped bit is refused


def test_a_checkpoint_identifies_an_energy_by_its_values_not_by_its_name(tmp_path):
    from ngvisco.physics.tensors import square
    from ngvisco.physics.variables import Distortion, Jacobian

    def material(stiffness):
        def energy(F, J):
            return stiffness * square(F) / J ** (2 / 3) + 10 * (J - 1) * (J - 1) + 0.1 / J + 0.1 * J

        return nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=energy)

    simulation([nv.Checkpoints(tmp_path / "run.h5")], material(5.0)).run(0.02)
    simulation(material=material(5.0)).restore(tmp_path / "run.h5")
    with pytest.raises(nv.CheckpointError, match="the checkpoint has energies = "):
        simulation(material=material(5.000001)).restore(tmp_path / "run.h5")


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_bodies_with_heat_are_resumed_bit_for_bit_and_a_run_with_another_heat_law_is_refused(
    tmp_path, solver
):
    """Two bodies have thermal pressures, so that each evaluation searches for their equilibrium at each
    point."""
    SetNumThreads(1)

    def bodies(conductivity=0.1, **options):
        parts = [
            nv.Body(
                name=name,
                where=where,
                material=nv.Thermal(material=SOLID, c=1.0, theta_R=1.0, expansion=expansion),
                heat=nv.Heat(conductivity=conductivity),
                density=1.0,
            )
            for name, where, expansion in (("left", 0.5 - x, 0.1), ("rest", None, 0.3))
        ]
        start = nv.Initial(velocity=(y - 0.5, 0.0), temperature=1 + 0.1 * x)
        model = nv.Model(bodies=parts, viscosity=None)
        return nv.Simulation(box((1, 1), maxh=0.7), model, dt=0.02, initial=start, solver=solver, **options)

    assert_goes_on(bodies, tmp_path / "run.h5", 0.08, -2)
    with pytest.raises(nv.CheckpointError, match="heat"):
        bodies(conductivity=0.2).restore(tmp_path / "run.h5")


ROUND = disc(1.0, maxh=0.4)


def test_a_curved_mesh_is_read_back_with_the_shape_of_its_geometry():
    """Netgen writes curved cells to eight decimals, which changes this area by 3e-10."""
    found = mesh_of(mesh_image(ROUND))
    assert found.GetCurveOrder() == ROUND.GetCurveOrder() > 1
    assert volume_and_surface(found) == pytest.approx(volume_and_surface(ROUND), rel=1e-14)


def test_curved_cells_without_a_geometry_keep_the_shape_in_the_file():
    image = mesh_image(ROUND)
    found = mesh_of(image[: image.index(b"endmesh") + len(b"endmesh\n")])
    assert found.GetCurveOrder() == ROUND.GetCurveOrder()
    assert volume_and_surface(found) == pytest.approx(volume_and_surface(ROUND), rel=1e-8)


def test_a_checkpoint_that_could_not_be_written_is_written_at_the_end_of_the_run(tmp_path, monkeypatch):
    run, write, calls = (
        swirling(observers=[nv.Checkpoints(tmp_path / "run.h5", every=1)]),
        checkpoint.write_atomically,
        [],
    )

    def written(path, content):
        calls.append(path)
        if len(calls) == 3:  # the first call writes the checkpoint of the start
            raise OSError("no space left on device")
        write(path, content)

    monkeypatch.setattr(checkpoint, "write_atomically", written)
    with pytest.raises(OSError, match="no space"):
        run.run(until=3 * run.dt)
    with h5py.File(tmp_path / "run.h5") as file:
        assert "00000002" in file["checkpoints"]
