"""Passive fields: they follow the flow, do not act on it, and survive a restart bit for bit."""

import numpy as np
import pytest
from ngsolve import CF, Grad, Id, InnerProduct, Integrate, pi, sin, x
from support import small_run, state, swirling

import ngvisco as nv
from ngvisco.geometries import box, disc

ALL = ("F_tot", "reference_map", "creep_strain")


def simulation(passive=ALL, creep=2.0, dt=0.02, maxh=0.4, observers=()):
    creep = nv.Creep(G_m=creep) if creep else None
    viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.1)
    return swirling(maxh, dt, viscosity=viscosity, creep=creep, passive=passive, observers=observers)


def test_passive_fields_do_not_act_on_the_run():
    with_them, without = simulation(), simulation(passive=())
    rows = [run.run(0.06).rows[-1] for run in (with_them, without)]
    for name, value in rows[1].items():
        assert rows[0][name] == value or np.isnan(value)


def test_F_tot_is_the_inverse_gradient_of_the_reference_map():
    """Both are transported independently: F_tot grad xi = I up to the discretisation error, which is smaller
    on a finer mesh."""
    gaps = []
    for maxh, dt in ((0.4, 0.02), (0.2, 0.01)):
        run = simulation(maxh=maxh, dt=dt)
        run.run(0.1)
        F, parts = run.fields["F_tot"], run.passive.parts
        columns = [CF((1 - i, i)) - Grad(parts[f"displacement_{i + 1}"]) for i in range(2)]
        total = 0.0
        for i in range(2):
            for j in range(2):
                product = sum(columns[i][k] * F[k, j] for k in range(2)) - float(i == j)
                total += Integrate(product * product, run.mesh)
        gaps.append(total**0.5)
    assert gaps[1] < 0.75 * gaps[0]
    assert gaps[1] < 0.03


def through_a_periodic_cell(maxh=0.3, dt=0.02):
    """A shear wave that is carried through the cell's ends."""
    mesh, viscosity = box((1, 1), maxh, periodic="x"), nv.StokesViscosity(K_v=0.1, G_v=0.1)
    velocity = (1.0, 0.3 * sin(2 * pi * x))
    return swirling(mesh, dt, velocity=velocity, viscosity=viscosity, passive=ALL[:2])


def test_passive_fields_enter_a_periodic_cell_where_they_leave_it():
    """F_tot is F without creep, and the mean displacement is the integral of the mean velocity."""
    run = through_a_periodic_cell()
    run.run(0.4)
    gap = run.fields["F"] - run.fields["F_tot"]
    assert Integrate(InnerProduct(gap, gap), run.mesh) ** 0.5 < 0.02
    moved = x - run.fields["reference_map"][0]
    assert Integrate(moved, run.mesh) == pytest.approx(0.4, rel=1e-3)
    assert run.sampler.extrema(moved)[1] < 0.41


def test_passive_fields_do_not_grow_in_curved_cells_at_rest():
    """The old value and the matrix are integrated by the same rule. With different rules, constants would
    grow exponentially."""
    run = small_run(disc(1.0, maxh=0.7), passive=("F_tot", "reference_map"))
    for _ in range(200):
        run.rothe_step.context.tau.Set(0.02)
        run.passive.begin()
        run.passive.stage(np.array([1.0]))
        run.passive.end(np.array([0.0, 1.0]))
    gap = run.fields["F_tot"] - Id(3)
    assert Integrate(InnerProduct(gap, gap), run.mesh) ** 0.5 < 1e-11
    assert run.sampler.extrema(run.fields["reference_map"][0] - x)[1] < 1e-11


def test_checkpoint_without_the_passive_fields_is_refused(tmp_path):
    path = tmp_path / "run.h5"
    simulation(passive=(), observers=[nv.Checkpoints(path, every=1)]).run(0.02)
    with pytest.raises(nv.CheckpointError, match="passive field"):
        simulation().restore(path)


def test_a_passive_field_without_a_solution_changes_neither_state_nor_step(monkeypatch):
    """States and steps equal those of a run without the field. A column counts the components that were not
    solved."""
    monkeypatch.setattr("ngvisco.forms.carrier.ITERATIONS", 1)
    run, without = simulation(), simulation(passive=())
    with pytest.warns(
        nv.InputWarning, match="no solution .* in 1 iterations for the components .*F_tot.* of passive fields"
    ):
        ledger = run.run(0.04)
    without.run(0.04)
    assert ledger.column("passive_unsolved")[1:].min() > 0
    assert not without.ledger.column("passive_unsolved").any()
    assert ledger.column("rejections").sum() == 0
    assert state(run).tobytes() == state(without).tobytes()
