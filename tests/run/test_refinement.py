"""Meshes that follow a field: quantities that a new mesh keeps, and the ledger over all meshes."""

import numpy as np
import pytest
from ngsolve import CF, Integrate, Mesh, exp, x, y
from support import assert_balanced, by_ci

import ngvisco as nv
from ngvisco.forms.mesh.mesh_arrays import coordinates, vertices
from ngvisco.geometries import box, disc
from ngvisco.physics.variables import Jacobian

FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 10 * (J - 1) * (J - 1) / J)


class Cells(nv.Observer):
    """The number of cells in every step."""

    def start(self, simulation):
        self.counts = [*getattr(self, "counts", []), simulation.mesh.ne]


def pulse(*observers, **options):
    strain = 1e-3 * exp(-(((x - 0.5) / 0.15) ** 2))
    initial = nv.Initial(velocity=(-2 * strain, 0), values={"E": CF((strain, *8 * [0]), dims=(3, 3))})
    model = nv.Model(material=nv.LinearElastic(K_e=4.0, G_e=0.01))
    return nv.Simulation(
        box((3, 0.5), 0.5), model, dt=0.05, scheme="midpoint", initial=initial, observers=observers, **options
    )


def bodies(*observers):
    what = {"material": FLUID, "viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1)}
    disc = nv.Body(name="disc", where=nv.Ball((0.4, 0.5), 0.2), density=2.0, **what)
    model = nv.Model(bodies=[nv.Body(name="medium", density=1.0, **what), disc], loads=[nv.Gravity((0, -1))])
    return nv.Simulation(box((1, 1), 0.3), model, dt=0.02, observers=observers)


@pytest.mark.parametrize("solver", [by_ci("split"), "coupled"])
def test_the_mesh_follows_a_pulse(solver):
    cells = Cells()
    start = pulse(cells, solver=solver)
    run = nv.run_refined(start, nv.Refinement(field="pressure", above=0.05, levels=1, every=0.2), 0.8)
    ledger = run.ledger
    assert len(set(cells.counts)) >= 2 and run.mesh.ne < 4 * start.mesh.ne  # some cells stay coarse
    assert np.allclose(ledger.column("time"), 0.05 * np.arange(17))
    assert_balanced(ledger, 1e-11, 1e-13)
    energy = ledger.column("kinetic") + ledger.column("stored")
    assert 0 < ledger.column("transfer").sum() < 0.01 * energy[0]
    centre = Integrate(x * run.fields["velocity"][0], run.mesh) / Integrate(
        run.fields["velocity"][0], run.mesh
    )
    assert abs(centre - 0.5 - 2 * 0.8) < 0.1


def test_bodies_keep_their_masses_and_tables_continue_over_refinement(tmp_path):
    table = nv.Bodies(tmp_path / "bodies.csv")
    start = bodies(table, nv.VTKSeries(tmp_path / "vtk", every=5))
    run = nv.run_refined(start, nv.Refinement(field="disc_fraction", every=0.06), 0.2)
    assert run.mesh.ne > start.mesh.ne
    assert [row[0] for row in table.rows] == list(range(11))
    for name in ("disc", "medium"):
        masses = table.column(f"{name}_mass")
        assert abs(masses / masses[0] - 1).max() < 1e-13
    assert abs(run.ledger.column("closure_relative")).max() < 1e-11
    assert sorted(path.name for path in (tmp_path / "vtk").glob("*.vtu")) == [
        f"fields_{number:06d}.vtu" for number in (0, 5, 10)
    ]


@pytest.mark.parametrize("interrupted", [by_ci(0.04), by_ci(0.12)])
def test_a_run_resumed_from_a_checkpoint_equals_the_uninterrupted_run_bit_for_bit(tmp_path, interrupted):
    refinement = nv.Refinement(field="disc_fraction", every=0.06)
    whole = nv.run_refined(bodies(nv.Checkpoints(tmp_path / "whole.h5")), refinement, 0.16)
    half = nv.run_refined(bodies(nv.Checkpoints(tmp_path / "half.h5")), refinement, interrupted)
    assert half.mesh.ne != bodies().mesh.ne
    later = bodies(nv.Checkpoints(tmp_path / "half.h5"))
    later = nv.run_refined(later, refinement, 0.16, checkpoint=tmp_path / "half.h5")
    assert later.number == whole.number == 8
    assert np.array_equal(coordinates(later.mesh), coordinates(whole.mesh))
    assert (
        later.rothe_step.state.vec.FV().NumPy().tobytes() == whole.rothe_step.state.vec.FV().NumPy().tobytes()
    )
    for name in ("kinetic", "stored", "transfer", "closure", "step"):
        assert np.array_equal(later.ledger.column(name), whole.ledger.column(name)), name


def test_a_run_that_has_made_steps_is_refused():
    refinement = nv.Refinement(field="J", every=0.04)
    begun = bodies()
    begun.run(0.02)
    with pytest.raises(nv.ParameterError, match="that has made no step"):
        nv.run_refined(begun, refinement, 0.08)
    carried = bodies()
    nv.transfer(bodies(), carried)
    with pytest.raises(nv.ParameterError, match="that has made no step"):
        nv.run_refined(carried, refinement, 0.08)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_displacement_of_a_wall_on_springs_is_carried_over(dim):
    """Finer cells have exactly the same displacement. Coarser cells of another mesh get its L2 projection on
    the wall."""
    model = nv.Model(material=nv.LinearElastic(K_e=4.0, G_e=1.0))
    walls = {"right": nv.Open(density=1.0, stiffness=(9.0, 4.0))}
    shape = CF((y * y, y - 0.5 * x, x * y)[:dim])
    initial = nv.Initial(values={"displacement_right": shape})
    coarse = box((1,) * dim, 0.6)
    source = nv.Simulation(coarse, model, dt=0.05, walls=walls, initial=initial)
    finer = Mesh(coarse.ngmesh.Copy())
    finer.Refine()
    fine, other = source.on(finer), source.on(box((1,) * dim, 0.4))
    plain = nv.Initial(values={"displacement_right": CF((0,) * dim)})
    target = nv.Simulation(finer, model, dt=0.05, walls=walls, initial=plain)
    moved = nv.transfer(source, target)
    energies = [run.ledger.rows[0]["stored_springs_right"] for run in (target,)]
    displacement = dict(zip(fine.rothe_step.layout.names, fine.rothe_step.state.components, strict=True))
    carried = dict(zip(target.rothe_step.layout.names, target.rothe_step.state.components, strict=True))
    names = "displacement_right"
    wanted, found = (one[names].vec.FV().NumPy() for one in (displacement, carried))
    assert abs(found - wanted).max() < 1e-8 * abs(wanted).max()
    assert energies[0] > 0.01 and abs(moved.lost) < 1e-8 * energies[0]
    nv.transfer(target, other)
    assert other.ledger.rows[0]["stored_springs_right"] == pytest.approx(energies[0], rel=1e-8)


@pytest.mark.parametrize(
    ("size", "periodic"), [((1, 1), "x"), by_ci((1, 1), "xy"), by_ci((0.5, 0.5, 0.5), "x")]
)
def test_both_of_two_identified_walls_are_divided_in_the_same_way(size, periodic):
    """A disc, or a ball, is carried through identified walls."""
    dim, length = len(size), size[0]
    what = {"material": FLUID, "viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.1)}
    ball = nv.Ball((0.85 * length, *(0.5 * length,) * (dim - 1)), 0.15 * length)
    model = nv.Model(
        bodies=[
            nv.Body(name="medium", density=1.0, **what),
            nv.Body(name="disc", where=ball, density=2.0, **what),
        ]
    )
    initial = nv.Initial(velocity=(length, *(0.0,) * (dim - 1)))
    start = nv.Simulation(box(size, 0.3, periodic=periodic), model, dt=0.05, initial=initial)
    run = nv.run_refined(start, nv.Refinement(field="disc_fraction", every=0.1), 0.2)
    assert run.mesh.ne > start.mesh.ne
    places = coordinates(run.mesh)
    for axis in range(len(periodic)):
        both = [places[abs(places[:, axis] - at) < 1e-12] for at in (0.0, length)]
        left, right = ({tuple(np.delete(p, axis).round(9)) for p in side} for side in both)
        assert left == right
    assert_balanced(run.ledger, 1e-11, 1e-13)


@pytest.mark.long
@pytest.mark.ci
def test_curved_cells_are_divided_and_curved_anew():
    model = nv.Model(material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0))
    bump = exp(-20 * ((x - 0.6) ** 2 + y * y))
    start = nv.Simulation(disc(1.0, maxh=0.5), model, dt=0.02, initial=nv.Initial(velocity=(0, bump)))
    run = nv.run_refined(start, nv.Refinement(field="pressure", above=0.3, every=0.04), 0.12)
    assert run.mesh.ne > start.mesh.ne and run.mesh.GetCurveOrder() == start.mesh.GetCurveOrder()
    # straight cells would have 8e-3 less area
    assert Integrate(CF(1.0), run.mesh) == pytest.approx(np.pi, rel=2e-4)
    assert_balanced(run.ledger, 1e-11, 1e-13)


def test_cells_are_divided_where_the_norm_of_a_tensor_is_steep():
    start = pulse()
    marked = nv.Refinement(field="cauchy_stress", above=0.3, every=0.2).steep(start)
    centres = coordinates(start.mesh)[vertices(start.mesh)].mean(axis=1)[:, 0]
    assert marked[abs(centres - 0.5) < 0.2].all() and not marked[centres > 1.6].any()


def test_no_cell_of_a_body_at_rest_is_marked_as_steep():
    """At rest rates and stresses are rounding errors."""
    material = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
    run = nv.Simulation(box((1, 1), 0.3), nv.Model(material=material, creep=nv.Creep(G_m=5.0)), dt=0.02)
    run.run(0.04)
    for field in ("creep_rate", "velocity", "von_mises"):
        assert run.sampler.rows(run.fields[field]).any(), field
        assert not nv.Refinement(field=field, every=0.02).steep(run).any(), field
