"""Meshes that follow a field: what is kept from one to the next, and one ledger over all of them."""

import numpy as np
import pytest
from ngsolve import CF, Integrate, Mesh, exp, x

import ngvisco as nv
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.geometries import box
from ngvisco.physics.variables import Jacobian

FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 10 * (J + 1 / J - 2))


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


@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_a_pulse_is_followed(solver):
    cells = Cells()
    start = pulse(cells, solver=solver)
    run = nv.run_refined(start, nv.Refinement(field="pressure", above=0.05, levels=1, every=0.2), 0.8)
    ledger = run.ledger
    assert len(set(cells.counts)) >= 2 and run.mesh.ne < 4 * start.mesh.ne  # it is not refined everywhere
    assert np.allclose(ledger.column("time"), 0.05 * np.arange(17))
    assert abs(ledger.column("closure_relative")).max() < 1e-11
    assert abs(ledger.column("mass_drift")).max() < 1e-13
    energy = ledger.column("kinetic") + ledger.column("stored")
    assert 0 < ledger.column("transfer").sum() < 0.01 * energy[0]
    centre = Integrate(x * run.fields["velocity"][0], run.mesh) / Integrate(
        run.fields["velocity"][0], run.mesh
    )
    assert abs(centre - 0.5 - 2 * 0.8) < 0.1


def test_bodies_keep_their_masses_and_tables_have_no_seam(tmp_path):
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


def test_a_union_of_cells_has_what_its_parts_had():
    source = bodies()
    coarse = source.mesh
    finer = Mesh(coarse.ngmesh.Copy())
    finer.Refine()
    fine = source.on(finer)
    fine.run(0.1)
    target = source.on(coarse)
    nv.transfer(fine, target)
    parents = coarse(*np.array([[sum(c) / 3 for c in zip(*(finer[v].point for v in e.vertices), strict=True)]
                                for e in finer.Elements()]).T)["nr"]  # fmt: skip
    for name in ("disc_fraction", "medium_fraction"):
        amount = "n_" + name.removesuffix("_fraction")
        parts = np.array(Integrate(fine.rothe_step.now.z_tensors[amount], finer, element_wise=True))
        found = np.array(Integrate(target.rothe_step.now.z_tensors[amount], coarse, element_wise=True))
        wanted = np.bincount(np.asarray(parents, dtype=int), parts, coarse.ne)
        assert abs(found - wanted).max() < 1e-13


@pytest.mark.parametrize("interrupted", [0.04, 0.12])
def test_a_run_goes_on_from_a_checkpoint_to_the_bit(tmp_path, interrupted):
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


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"field": "vorticity"}, "vorticity"),
        ({"field": "velocity"}, "scalar"),
        ({"field": "J", "above": 1.5}, "Refinement.above"),
        ({"field": "J", "levels": 0}, "Refinement.levels"),
        ({"field": "J", "every": 0.03}, "Refinement.every"),
    ],
)
def test_what_does_not_fit_is_named(options, named):
    with pytest.raises(nv.NgviscoError, match=named):
        nv.run_refined(bodies(), nv.Refinement(**{"every": 0.04} | options), 0.08)


def test_a_periodic_mesh_and_a_run_under_way_are_refused():
    refinement = nv.Refinement(field="J", every=0.04)
    begun = bodies()
    begun.run(0.02)
    with pytest.raises(nv.ParameterError, match="before its first step"):
        nv.run_refined(begun, refinement, 0.08)
    carried = bodies()
    nv.transfer(bodies(), carried)
    with pytest.raises(nv.ParameterError, match="before its first step"):
        nv.run_refined(carried, refinement, 0.08)
    foundation = {"right": nv.Open(density=1.0, stiffness=(1.0, 0.0))}
    with pytest.raises(nv.ParameterError, match="displacements of walls"):
        nv.run_refined(pulse(walls=foundation), nv.Refinement(field="pressure", every=0.1), 0.2)
    periodic = begun.on(box((1, 1), 0.3, periodic="x"))
    with pytest.raises(nv.MeshError, match="periodic"):
        nv.run_refined(periodic, refinement, 0.08)
