"""Going on with another mesh or other parameters: mass exact, what is lost of the energy in the ledger."""

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
    return swirling(mesh or maxh, dt, nv.Initial(density=1 + 0.3 * x * y, velocity=velocity), **options)


def gap(a, b, name):
    """Relative L2 distance of a field of two runs, on the finer of both meshes."""
    f, g = a.fields[name], b.fields[name]
    values = [np.asarray(part(run.mesh(P, Q))) for part, run in ((f, a), (g, b))]
    return np.linalg.norm(values[0] - values[1]) / np.linalg.norm(values[0])


P, Q = (part.ravel() for part in np.meshgrid(np.linspace(0.02, 0.98, 25), np.linspace(0.03, 0.97, 25)))


def test_the_same_mesh_gives_the_same_state():
    source = simulation(passive=["F_tot", "reference_map"])
    source.run(0.1)
    target = simulation(passive=["reference_map", "F_tot"])
    done = nv.transfer(source, target)
    assert target.t == source.t and abs(done.scaled - 1) < 1e-14
    assert abs(done.lost) < 1e-13 * done.energy_before
    for name in ("velocity", "density", "F", "J", "F_tot", "reference_map"):
        assert gap(source, target, name) < 1e-12
    source.solver.reset()  # a transferred run has no earlier step to extrapolate from
    reached, again = source.run(0.14), target.run(0.14)
    assert again.column("kinetic")[-1] == pytest.approx(reached.column("kinetic")[-1], rel=1e-9)
    assert again.column("step").tolist() == [0, 1, 2] and again.column("time")[-1] == pytest.approx(0.14)


def test_another_mesh_keeps_the_mass_and_notes_the_lost_energy():
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
    newton = nv.NewtonOptions(tolerance=1e-12)  # what closes to rounding
    return swirling(maxh, bodies=bodies[::-1] if reverse else bodies, observers=observers, newton=newton)


def amounts(run):
    """Masses of the bodies, and their density at the points."""
    u, quadrature = run.rothe_step.now, run.rothe_step.quadrature
    parts = [(body.density, u.z_tensors[f"n_{body.name}"]) for body in run.model.bodies]
    masses = [density * quadrature.integrate_cells(n) for density, n in parts]
    return np.array(masses), sum(density * n for density, n in parts)


def test_another_mesh_keeps_the_mass_of_each_body():
    """And the density that of the amounts."""
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


def test_a_curved_domain_is_carried_over():
    source = simulation(mesh=disc(1, 0.6), velocity=(-y, x))
    source.run(0.02)
    target = simulation(mesh=disc(1, 0.4))
    nv.transfer(source, target)
    ledger = target.run(0.04)
    assert ledger.column("mass_drift") == pytest.approx(0, abs=1e-13)
    assert abs(ledger.column("closure_relative")).max() < 1e-12


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: simulation(mesh=box((2, 0.5), 0.4)), nv.MeshError, "is not in the old one"),
        (lambda: simulation(mesh=box((1, 0.5), 0.4)), nv.MeshError, "volume"),
        (lambda: simulation(passive=["F_tot"]), nv.ParameterError, "F_tot.*the source carries too"),
        (
            lambda: nv.Simulation(
                box((1, 1), 0.5), nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=1.0)), dt=0.1
            ),
            nv.ParameterError,
            "the variables E.*those of the source, F, J",
        ),
    ],
)
def test_what_cannot_be_carried_over_is_refused(make, error, message):
    source = simulation(0.5)
    with pytest.raises(error, match=message):
        nv.transfer(source, make())


def test_a_run_goes_on_with_another_step_and_another_load(tmp_path):
    path = tmp_path / "run.h5"
    first = simulation(observers=[nv.Checkpoints(path, every=1)])
    first.run(0.06)
    second = simulation(dt=0.01, g=-2.0, load="pull", observers=[nv.Checkpoints(path, every=1)])
    with pytest.raises(nv.ParameterError, match=r"a multiple of dt"):
        second.run(0.065)
    assert nv.resume_changed(second, path) == pytest.approx(0, abs=1e-12)
    ledger = second.run(0.08)
    assert ledger.column("time")[-3:] == pytest.approx([0.06, 0.07, 0.08])
    assert ledger.column("step").tolist() == [0, 1, 2, 3, 4, 5]
    assert ledger.column("power_gravity")[3] != 0 and ledger.column("power_gravity")[4] == 0
    assert ledger.column("power_pull")[3] == 0 and ledger.column("power_pull")[4] != 0
    assert abs(ledger.column("closure_relative")).max() < 1e-12
    # and on, by a plain restart: bit for bit as the uninterrupted one
    third = simulation(dt=0.01, g=-2.0, load="pull")
    third.restore(path)
    assert set(third.ledger.columns) == set(ledger.columns)
    again, whole = third.run(0.1), second.run(0.1)
    assert again.rows[-1] == whole.rows[-1] and again.column("time")[-1] == pytest.approx(0.1)


def test_another_modulus_changes_the_energy_by_an_entry_of_the_ledger(tmp_path):
    path = tmp_path / "run.h5"
    simulation(observers=[nv.Checkpoints(path)]).run(0.06)
    stiffer = simulation(G_e=7.0)
    lost = nv.resume_changed(stiffer, path)
    assert lost < -5  # 2 Pa more of |F|^2 = 3 over the unit square
    ledger = stiffer.run(0.08)
    assert ledger.column("transfer").tolist() == [0, 0, 0, 0, lost]
    assert abs(ledger.column("closure_relative")).max() < 1e-12


def test_a_change_keeps_the_bodies_densities(tmp_path):
    """The amounts in the state are volumes: with another density they would not add up to rho."""
    path = tmp_path / "run.h5"
    with_bodies(observers=[nv.Checkpoints(path)]).run(0.02)
    with pytest.raises(nv.CheckpointError, match=r"bodies are 'disc of 2.0 kg.* run's are 'disc of 3.0"):
        nv.resume_changed(with_bodies(density=3.0), path)
    with pytest.raises(nv.CheckpointError, match=r"run's are 'rest of 1.0 kg.*, disc of 2.0"):
        nv.resume_changed(with_bodies(reverse=True), path)


def test_other_spaces_are_not_the_same_run(tmp_path):
    path = tmp_path / "run.h5"
    simulation(observers=[nv.Checkpoints(path)]).run(0.02)
    with pytest.raises(nv.CheckpointError, match="its mesh is"):
        nv.resume_changed(simulation(0.25), path)
    with pytest.raises(nv.CheckpointError, match="its spaces is"):
        nv.resume_changed(simulation(discretisation=nv.Discretisation(k=3)), path)


def test_fields_of_python_functions_and_of_grids_are_those_functions():
    mesh = box((1, 2), 0.4)
    f = nv.function_field(mesh, lambda x, y: np.exp(x) * y, order=3)
    assert Integrate((f - exp(x) * y) ** 2, mesh) ** 0.5 < 1e-5
    xs, ys = np.linspace(-0.1, 1.1, 13), np.linspace(0, 2, 5)
    X, Y = np.meshgrid(xs, ys, indexing="ij")
    g = nv.grid_field(mesh, (xs, ys), 1 + 2 * X - Y, order=1)  # linear: exact
    assert Integrate((g - (1 + 2 * x - y)) ** 2, mesh) < 1e-26
    v = nv.grid_field(mesh, (xs, ys), np.stack([X, -Y], axis=-1), order=1)
    assert v.dim == 2 and Integrate((v - CF((x, -y))) ** 2, mesh) < 1e-26
    F = nv.function_field(mesh, lambda x, y: [[1 + x, y, 0], [0, 1, 0], [0, 0, 1]], order=1)
    assert tuple(F.dims) == (3, 3) and F(mesh(0.25, 0.5))[1] == pytest.approx(0.5)


def test_a_run_starts_from_fields_of_python_functions():
    mesh = box((1, 1), 0.4)
    density = nv.function_field(mesh, lambda x, y: 1 + 0.3 * x * y)
    velocity = nv.function_field(
        mesh,
        lambda x, y: (np.sin(np.pi * x) * np.cos(np.pi * y), -np.cos(np.pi * x) * np.sin(np.pi * y)),
        order=4,
    )
    model = nv.Model(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1))
    run = nv.Simulation(mesh, model, dt=0.02, initial=nv.Initial(density=density, velocity=velocity))
    ledger = run.run(0.02)
    assert ledger.column("mass")[0] == pytest.approx(1.075, rel=1e-12)
    exact = simulation(mesh=mesh).run(0).column("kinetic")[0]
    assert ledger.column("kinetic")[0] == pytest.approx(exact, rel=1e-3)
    assert abs(ledger.column("closure_relative")[-1]) < 1e-12


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda m: nv.function_field(m, 3), "a function of the arrays"),
        (lambda m: nv.function_field(m, lambda x, y: "a"), "finite numbers"),
        (lambda m: nv.function_field(m, lambda x, y: x[:3]), r"shape \(3,\)"),
        (lambda m: nv.function_field(m, lambda x, y: np.log(x - 2 * y + 0j).real / 0 * x), "finite"),
        (lambda m: nv.function_field(m, lambda x, y: x, order=9), "0 to 6"),
        (lambda m: nv.grid_field(m, ([0, 1],), [1, 2]), "2 axes"),
        (lambda m: nv.grid_field(m, ([0, 1], [0, 1]), [[1, 2]]), "increasing axes"),
        (lambda m: nv.grid_field(m, ([0, 1], [0, 0.5]), [[1, 2], [3, 4]]), r"axes, y.*\[0, 0.5\].*\[0.0"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*encountered")
def test_what_is_no_field_is_refused(make, message):
    with pytest.raises(nv.ParameterError, match=message):
        make(box((1, 1), 1.0))


def test_a_run_with_heat_goes_on_with_another_conductivity_and_its_entropy(tmp_path):
    def warm(conductivity, **options):
        solid = nv.LinearElastic(K_e=10.0, G_e=5.0)
        model = nv.Model(
            material=nv.Thermal(material=solid, c=1.0, theta_R=1.0, expansion=0.1),
            heat=nv.Heat(conductivity=conductivity),
        )
        start = nv.Initial(temperature=1 + 0.2 * x)
        return nv.Simulation(box((1, 1), maxh=0.7), model, dt=0.02, initial=start, **options)

    path = tmp_path / "run.h5"
    before = warm(0.1, observers=[nv.Checkpoints(path)]).run(0.04)
    after = warm(0.5)
    assert nv.resume_changed(after, path) == pytest.approx(0, abs=1e-14)
    ledger = after.run(0.06)
    assert ledger.column("entropy")[2] == before.column("entropy")[2]
    made, name = ledger.column("entropy"), "entropy_production_conduction"
    assert np.diff(made)[-1] == pytest.approx(0.02 * ledger.column(name)[-1], rel=1e-10)
    assert ledger.column(name)[-1] > 3 * before.column(name)[-1]
