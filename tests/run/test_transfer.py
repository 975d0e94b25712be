"""Runs that continue on another mesh or with other parameters: kept mass, and lost energy in the ledger."""

import numpy as np
import pytest
from ngsolve import CF, Integrate, exp, x, y
from support import SWIRL, swirling

import ngvisco as nv
from ngvisco.geometries import box, disc


def simulation(maxh=0.3, dt=0.02, G_e=5.0, g=-1.0, observers=(), mesh=None, velocity=SWIRL, **options):
    options["loads"] = [nv.Gravity((0.0, g), **({"name": options.pop("load")} if "load" in options else {}))]
    options["material"] = nv.NeoHookean(K_e=10.0, G_e=G_e, epsilon=0.1)
    options |= {"viscosity": nv.StokesViscosity(K_v=0.05, G_v=0.05), "observers": list(observers)}
    return swirling(mesh or maxh, dt, density=1 + 0.3 * x * y, velocity=velocity, **options)


def gap(a, b, name):
    """Relative L2 distance of a field of two runs, on the finer of both meshes."""
    f, g = a.fields[name], b.fields[name]
    values = [np.asarray(part(run.mesh(P, Q))) for part, run in ((f, a), (g, b))]
    return np.linalg.norm(values[0] - values[1]) / np.linalg.norm(values[0])


P, Q = (part.ravel() for part in np.meshgrid(np.linspace(0.02, 0.98, 25), np.linspace(0.03, 0.97, 25)))


def test_a_transfer_to_the_same_mesh_keeps_the_state():
    source = simulation(passive=["F_tot", "reference_map"])
    source.run(0.1)
    target = simulation(passive=["reference_map", "F_tot"])
    done = nv.transfer(source, target)
    assert target.t == source.t and abs(done.scaled - 1) < 1e-14
    assert abs(done.lost) < 1e-13 * done.energy_before
    for name in ("velocity", "density", "F", "J", "F_tot", "reference_map"):
        assert gap(source, target, name) < 1e-12
    source.solver.reset()  # a transferred run cannot extrapolate from an earlier step
    reached, again = source.run(0.14), target.run(0.14)
    assert again.column("kinetic")[-1] == pytest.approx(reached.column("kinetic")[-1], rel=1e-9)
    assert again.column("step").tolist() == [0, 1, 2] and again.column("time")[-1] == pytest.approx(0.14)


def test_a_transfer_to_another_mesh_keeps_the_mass_and_records_the_lost_energy():
    source = simulation(0.3)
    source.run(0.1)
    lost = []
    for maxh in (0.3, 0.15):
        target = simulation(0.9 * maxh, dt=0.01)
        done = nv.transfer(source, target)
        for name, bound in (("velocity", 0.02), ("density", 0.01), ("F", 0.02)):
            assert gap(source, target, name) < bound
        ledger = target.run(0.12)
        mass = source.ledger.column("mass")[-1]
        assert ledger.column("mass") == pytest.approx(mass, rel=1e-14) and abs(done.scaled - 1) < 1e-3
        before = source.ledger.rows[-1]
        energy = ledger.rows[0]["kinetic"] + ledger.rows[0]["stored"]
        assert ledger.column("transfer")[0] == done.lost
        assert done.lost == pytest.approx(before["kinetic"] + before["stored"] - energy, abs=1e-12)
        assert ledger.column("transfer")[1:].tolist() == [0, 0]
        assert abs(ledger.column("closure_relative")).max() < 1e-12
        assert ledger.column("time").tolist() == pytest.approx([0.1, 0.11, 0.12])
        lost.append(abs(done.lost))
    assert lost[1] < lost[0] < 1e-2 * done.energy_before


def with_bodies(maxh=0.4, density=2.0, radius=0.25, reverse=False, observers=()):
    stokes = nv.StokesViscosity(K_v=0.05, G_v=0.05)
    solid = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)
    place = nv.Ball((0.6, 0.5), radius)
    bodies = [
        nv.Body(name="disc", where=place, material=solid, density=density, viscosity=stokes),
        nv.Body(name="rest", material=solid, density=1.0, viscosity=stokes),
    ]
    newton = nv.NewtonOptions(tolerance=1e-12)  # with this tolerance the ledger closes to rounding
    return swirling(maxh, bodies=bodies[::-1] if reverse else bodies, observers=observers, newton=newton)


def amounts(run):
    """Masses of the bodies, and their density at the points."""
    u, quadrature = run.rothe_step.now, run.rothe_step.quadrature
    parts = [(body.density, u.z_tensors[f"n_{body.name}"]) for body in run.model.bodies]
    masses = [density * quadrature.integrate_cells(n) for density, n in parts]
    return np.array(masses), sum(density * n for density, n in parts)


@pytest.mark.long
@pytest.mark.ci
def test_a_transfer_to_another_mesh_keeps_the_mass_of_each_body():
    """The density of a run with bodies is the sum over amounts times referential densities."""
    source = with_bodies()
    source.run(0.06)
    before, _ = amounts(source)
    for maxh in (0.3, 0.6):
        target = with_bodies(maxh)
        nv.transfer(source, target)
        masses, density = amounts(target)
        assert masses == pytest.approx(before, rel=1e-13)
        assert abs(target.sampler.values(density - target.rothe_step.now.rho)).max() < 1e-13
        assert abs(target.run(0.08).column("closure_relative")).max() < 1e-12


def test_a_body_of_another_density_is_refused_by_its_name():
    with pytest.raises(nv.ParameterError, match=r"bodies\['disc'\].density = 3.0: expected 2 kg/m"):
        nv.transfer(with_bodies(), with_bodies(density=3.0))


def test_a_state_on_a_curved_domain_is_transferred():
    source = simulation(mesh=disc(1, 0.6), velocity=(-y, x))
    source.run(0.02)
    target = simulation(mesh=disc(1, 0.4))
    nv.transfer(source, target)
    ledger = target.run(0.04)
    assert ledger.column("mass_drift") == pytest.approx(0, abs=1e-13)
    assert abs(ledger.column("closure_relative")).max() < 1e-12


def test_a_resumed_run_with_changed_densities_of_bodies_is_refused(tmp_path):
    """The amounts in the state are volumes, which with another density would not add up to rho."""
    path = tmp_path / "run.h5"
    with_bodies(observers=[nv.Checkpoints(path)]).run(0.02)
    with pytest.raises(
        nv.CheckpointError, match=r"bodies = 'disc of 2.0 kg.* this run has bodies = 'disc of 3.0"
    ):
        nv.resume_changed(with_bodies(density=3.0), path)
    with pytest.raises(nv.CheckpointError, match=r"this run has bodies = 'rest of 1.0 kg.*, disc of 2.0"):
        nv.resume_changed(with_bodies(reverse=True), path)


def test_fields_of_python_functions_and_of_grids_equal_those_functions():
    mesh = box((1, 2), 0.4)
    f = nv.function_field(mesh, lambda x, y: np.exp(x) * y, order=3)
    assert Integrate((f - exp(x) * y) ** 2, mesh) ** 0.5 < 1e-5
    xs, ys = np.linspace(-0.1, 1.1, 13), np.linspace(0, 2, 5)
    X, Y = np.meshgrid(xs, ys, indexing="ij")
    g = nv.grid_field(mesh, (xs, ys), 1 + 2 * X - Y, order=1)  # a linear function is interpolated exactly
    assert Integrate((g - (1 + 2 * x - y)) ** 2, mesh) < 1e-26
    v = nv.grid_field(mesh, (xs, ys), np.stack([X, -Y], axis=-1), order=1)
    assert v.dim == 2 and Integrate((v - CF((x, -y))) ** 2, mesh) < 1e-26
    F = nv.function_field(mesh, lambda x, y: [[1 + x, y, 0], [0, 1, 0], [0, 0, 1]], order=1)
    assert tuple(F.dims) == (3, 3) and F(mesh(0.25, 0.5))[1] == pytest.approx(0.5)
