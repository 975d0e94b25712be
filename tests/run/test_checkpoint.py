"""A restarted run is the uninterrupted one, and a checkpoint that does not fit is refused."""

import h5py
import numpy as np
import pytest
from ngsolve import SetNumThreads, sin, x, y
from support import assert_goes_on, swirling

import ngvisco as nv
from ngvisco.geometries import box

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


def test_files_of_a_restarted_run_are_those_of_the_uninterrupted_one(tmp_path):
    """Of runs of every kind see ``timestepping/test_steps_of_schemes``."""
    SetNumThreads(1)  # sums over threads have no fixed order
    whole = simulation(observers(tmp_path / "whole"))
    whole.run(0.16)
    simulation(observers(tmp_path / "parts")).run(0.06)
    rest = simulation(observers(tmp_path / "parts"))
    rest.restore(tmp_path / "parts" / "run.h5")
    assert (rest.t, rest.number) == (3 * 0.02, 3)
    rest.run(0.16)
    a, b = (run.rothe_step.state.vec.FV().NumPy() for run in (whole, rest))
    assert np.array_equal(a, b)
    assert (tmp_path / "whole/ledger.csv").read_bytes() == (tmp_path / "parts/ledger.csv").read_bytes()
    first, second = (nv.read_ledger(tmp_path / name / "run.h5") for name in ("whole", "parts"))
    assert all(np.array_equal(first[name], second[name], equal_nan=True) for name in first)
    series = (tmp_path / "whole/vtk/fields.pvd").read_text()
    assert [line.split('file="')[1] for line in series.splitlines() if "file=" in line] == [
        f'fields_{n:06d}.vtu"/>' for n in (0, 2, 4, 6, 8)
    ]


@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_a_run_goes_on_with_another_flow_rule(tmp_path, solver):
    """Linear creep has no stresses at which it was linearised, yield has them."""
    simulation([nv.Checkpoints(tmp_path / "run.h5", every=1)], SOLID, solver=solver).run(0.04)
    rest = simulation(material=SOLID, creep=nv.Perzyna(sigma_Y=0.05, G_m=0.1), solver=solver)
    rest.restore(tmp_path / "run.h5")
    ledger = rest.run(0.08)
    assert abs(ledger.column("closure_relative")).max() < 1e-12 and not ledger.column("rejections").any()


def test_a_given_checkpoint_is_restored_and_the_last_ones_are_kept(tmp_path):
    run = simulation([nv.Checkpoints(tmp_path / "run.h5", every=1, keep=2)])
    run.run(0.08)
    with h5py.File(tmp_path / "run.h5") as file:
        assert list(file["checkpoints"]) == ["00000003", "00000004"]
    again = simulation()
    again.restore(tmp_path / "run.h5", step=3)
    assert again.number == 3
    with pytest.raises(nv.CheckpointError, match=r"no checkpoint of step 1 \(there are 3, 4\)"):
        again.restore(tmp_path / "run.h5", step=1)


def test_a_checkpoint_of_something_else_is_refused_with_the_reason(tmp_path):
    simulation([nv.Checkpoints(tmp_path / "run.h5")]).run(0.02)
    stiffer = nv.NeoHookean(K_e=20.0, G_e=5.0, epsilon=0.1)
    for reason, other in (
        ("mesh", simulation(maxh=0.3)),
        ("spaces", simulation(discretisation=nv.Discretisation(m=2))),
        ("material", simulation(material=stiffer)),
    ):
        before = other.rothe_step.state.vec.FV().NumPy().copy()
        with pytest.raises(nv.CheckpointError, match=f"its {reason} is"):
            other.restore(tmp_path / "run.h5")
        assert np.array_equal(before, other.rothe_step.state.vec.FV().NumPy())


@pytest.mark.parametrize("damage", ["missing", "truncated", "empty", "text"])
def test_a_damaged_file_is_refused(tmp_path, damage):
    path = tmp_path / "run.h5"
    simulation([nv.Checkpoints(path)]).run(0.02)
    if damage == "missing":
        path.unlink()
    elif damage == "truncated":
        path.write_bytes(path.read_bytes()[:1000])
    else:
        path.write_bytes(b"" if damage == "empty" else b"not an HDF5 file")
    with pytest.raises(nv.CheckpointError, match=r"run\.h5"):
        simulation().restore(path)


def test_a_changed_bit_is_refused_or_changes_nothing(tmp_path):
    """Bytes of the file are of data, of names, or unused: none of them may make another state."""
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
    assert refused >= 10  # most of the file is data


def test_an_energy_is_known_by_its_values_not_by_its_name(tmp_path):
    from ngvisco.physics.tensors import square
    from ngvisco.physics.variables import Distortion, Jacobian

    def material(stiffness):
        def energy(F, J):
            return stiffness * square(F) / J ** (2 / 3) + 10 * (J - 1) * (J - 1) + 0.1 / J + 0.1 * J

        return nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=energy)

    simulation([nv.Checkpoints(tmp_path / "run.h5")], material(5.0)).run(0.02)
    simulation(material=material(5.0)).restore(tmp_path / "run.h5")
    with pytest.raises(nv.CheckpointError, match="its energies are"):
        simulation(material=material(5.000001)).restore(tmp_path / "run.h5")


def test_bodies_with_energies_of_their_own_go_on_from_a_checkpoint(tmp_path):
    """A function is another object in every process; a body is known by its name, numbers and energies."""
    from ngvisco.physics.variables import Jacobian

    def bodies(shear_modulus, stiffness=5.0):
        fluid = nv.CustomMaterial(
            transported=(Jacobian(),), stored_energy=lambda J: stiffness * (J - 2 + 1 / J)
        )
        solid = nv.ReferentialNeoHookean(K_e=10.0, G_e=shear_modulus / 2)
        disc = nv.Body(name="disc", where=nv.Ball((0.6, 0.5), 0.25), material=solid, density=2.0)
        model = nv.Model(bodies=[disc, nv.Body(name="rest", material=fluid, density=1.0)])
        return nv.Simulation(box((1, 1), maxh=0.5), model, time=nv.TimeSteps(dt=0.02, velocity_scale=1.0))

    run = bodies(1.0)
    run.observers = [nv.Checkpoints(tmp_path / "run.h5")]
    run.run(0.02)
    again = bodies(1.0)
    again.restore(tmp_path / "run.h5")
    assert np.array_equal(again.rothe_step.state.vec.FV().NumPy(), run.rothe_step.state.vec.FV().NumPy())
    for other in (bodies(1.1), bodies(1.0, stiffness=6.0)):
        with pytest.raises(nv.CheckpointError, match=r"its (material|energies) "):
            other.restore(tmp_path / "run.h5")


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_bodies_with_heat_go_on_bitwise_and_are_known_by_it(tmp_path, solver):
    """Of two thermal pressures, whose equilibrium at a point is found anew in every evaluation."""
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
