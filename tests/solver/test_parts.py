"""Parts of the mesh: their number changes results by rounding only, and the number of threads changes no
bit."""

from itertools import pairwise
from weakref import ref

import numpy as np
import pytest
from support import SWIRL, by_ci
from test_split_agrees import model

import ngvisco as nv
from ngvisco.forms.fields import Fields
from ngvisco.geometries import box
from ngvisco.reduced import residual
from ngvisco.reduced.residual import parts_of


def solved(threads=1, points=None, monkeypatch=None, **parts):
    """The state after two steps, with parts of the mesh that have ``points`` points each."""
    if monkeypatch is not None:
        monkeypatch.setattr(residual, "TOGETHER", points)
    newton = nv.NewtonOptions(threads=threads)
    run = nv.Simulation(
        box((1, 1), maxh=0.4),
        model(**parts),
        walls={"top": nv.Traction(f=(1.0, 0.0), friction=0.2)},
        dt=0.02,
        initial=nv.Initial(velocity=SWIRL),
        solver="split",
        newton=newton,
    )
    for _ in range(2):
        run.advance()
    return run, run.solver.newton.step.state.vec.FV().NumPy().copy()


@pytest.mark.parametrize(
    "parts", [pytest.param({}, id="elastic"), by_ci({"creep": nv.Creep(G_m=5.0)}, id="creeping")]
)
def test_parts_of_the_mesh_change_only_rounding_and_threads_change_no_bit(parts, monkeypatch):
    _, whole = solved(**parts)
    run, serial = solved(1, 40, monkeypatch, **parts)
    assert len(run.solver.newton.residual.parts) >= 6
    _, shared = solved(3, 40, monkeypatch, **parts)
    assert np.array_equal(serial, shared)
    assert np.abs(serial - whole).max() <= 1e-11 * np.abs(whole).max()


@pytest.mark.parametrize("points", [40, 10_000], ids=["parts", "whole"])
def test_programs_that_keep_no_data_give_the_same_bits_as_the_terms(points, monkeypatch):
    """Programs of large meshes read the data of a step at each evaluation."""
    monkeypatch.setattr(residual, "RECORDED", 0)
    run, by_programs = solved(1, points, monkeypatch)
    of_run = run.solver.newton.residual
    of_run.start(records=True)
    names = of_run.programs.names
    assert {("loads", part.cells.start) for part in of_run.parts} < set(names)
    assert len(of_run.parts) > 1 or names == [("loads", 0), "derived"]
    assert not of_run.programs.varying
    monkeypatch.setattr(residual, "PROGRAMMED", 0)
    run, by_terms = solved(1, points, monkeypatch)
    assert not run.solver.newton.residual.programs.names
    assert np.array_equal(by_programs, by_terms)


def test_forces_on_sides_are_summed_part_by_part(monkeypatch):
    """Values at the points of all sides at once would need the most memory in a step."""
    run, _ = solved(1, 40, monkeypatch)
    impulses, solver = run.ledger.momentum.impulses, run.solver
    counts = []
    solver.on_sides(lambda u, _: counts.append(u.parts["z"].value.shape[1]) or {})
    assert len(counts) == len(solver.newton.residual.parts) >= 6
    assert sum(counts) == solver.newton.residual.side_op.points.count
    by_arrays = impulses()
    # without arrays on sides, forms of NGSolve are evaluated on the whole mesh
    impulses.on_sides = lambda _: {}
    by_forms = impulses()
    assert np.abs(by_forms["facets"]).max() > 1e-6
    largest = max(np.abs(force).max() for force in by_forms.values())
    for name, force in by_forms.items():
        assert np.abs(by_arrays[name] - force).max() <= 1e-12 * largest, name


def test_values_at_points_are_freed_with_their_fields():
    """With a cycle of references, the values would remain in memory until Python's garbage collector runs."""
    mesh, what = box((1, 1), maxh=0.9), model()
    fields = Fields(nv.Simulation(mesh, what, dt=0.1, solver="split").rothe_step.layout, {})
    alive = ref(fields)
    del fields
    assert alive() is None


@pytest.mark.parametrize("cells", [0, 1, 7, 1000, 1001, 50_552])
def test_parts_of_the_mesh_contain_each_cell_once(cells):
    parts = parts_of(cells, 24)
    assert parts[0].start == 0 and parts[-1].stop == cells
    assert all(one.stop == other.start for one, other in pairwise(parts))
    assert len(parts) == 1 or len(parts) % 2 == 0
    assert max(part.stop - part.start for part in parts) <= 1001


def test_zero_threads_are_refused():
    with pytest.raises(nv.ParameterError, match=r"threads.*0"):
        nv.NewtonOptions(threads=0)
