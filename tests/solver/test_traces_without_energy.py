"""Traces without an energy, although all points of the cells have one: det B <= 0 in an energy with ln det
B."""

import numpy as np
import pytest
from ngsolve import GridFunction, IfPos, x

import ngvisco as nv
from ngvisco.forms.reactions import WallReactions
from ngvisco.geometries import structured_box


def start(place, solver):
    """A run in which B_33 = |x - place| - 0.01 is negative on a row of facets and positive 0.03 m away; also
    the coefficients of B_33 in this state and at rest."""
    model = nv.Model(
        material=nv.OldroydB(K_e=20.0, G_e=1.0),
        viscosity=nv.StokesViscosity(K_v=1.0, G_v=1.0),
        creep=nv.Creep(G_m=2.0, law="conformation"),
    )
    mesh = structured_box((1, 1), (2, 2))
    run = nv.Simulation(mesh, model, dt=1e-3, initial=nv.Initial(density=1.0), solver=solver, halvings=0)
    step = run.ledger.step
    across = GridFunction(step.layout.scalar_space("z"))
    across.Set(IfPos(x - place, x - place, place - x) - 0.01)
    states = step.layout.states
    z = step.state.vec.FV().NumPy()[step.layout.ranges["z"]].reshape(states.size, -1)
    B_33 = z[states.slices["B"].stop - 1]
    at_rest = B_33.copy()
    B_33[:] = across.vec.FV().NumPy()
    assert not len(step.without_energy())
    return run, B_33, at_rest


@pytest.mark.parametrize("solver", ["coupled", "split"])
@pytest.mark.parametrize("place", [0.5, 1.0], ids=["between cells", "on a wall"])
# near the boundary of the energy's domain, projected conjugates are far from the traces' conjugates
@pytest.mark.filterwarnings("ignore::ngvisco.run.signs.DissipationWarning")
def test_a_step_with_traces_outside_the_energy_s_domain_is_solved(place, solver):
    run, *_ = start(place, solver)
    row = run.advance()
    assert row["rejections"] == 0 and abs(row["closure_relative"]) < 1e-10
    assert all(np.isfinite(value) for name, value in row.items() if "momentum" in name or "impulse" in name)
    forces = WallReactions(run.ledger.step, None, [0.0, 0.0])()
    assert np.isfinite(list(forces.values())).all()


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_a_facet_without_energy_in_one_iterate_counts_as_one_until_the_end_of_the_step(solver):
    """Otherwise the force of a facet at the edge of the energy's domain would alternate between iterates."""
    run, B_33, at_rest = start(0.5, solver)
    step, newton = run.ledger.step, run.solver.newton

    def facets():
        if solver == "coupled":
            step.local_unknowns.update()
        else:
            newton.residual(newton.unknowns.pack())
        return np.flatnonzero(step.state.vec.FV().NumPy()[step.layout.ranges["without_energy"]] > 0)

    if solver == "split":
        newton.residual.start()
    found = facets()
    B_33[:] = at_rest
    assert len(found) == 2 and np.array_equal(facets(), found)
    assert step.local_unknowns.largest.growths == 0
    step.local_unknowns.largest.begin()
    assert not len(facets())
