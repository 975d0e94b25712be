"""Unfelt motion, to which no variable of the state responds: the ledger's column, and its warning."""

import warnings

import numpy as np
import pytest
from ngsolve import pi, sin, x, y
from support import small_run

import ngvisco as nv
from ngvisco.forms.unfelt import UNFELT
from ngvisco.geometries import structured_box

SMOOTH = {"velocity": (0.1 * sin(pi * x) * y, -0.1 * sin(pi * y) * x), "density": 2.0}
SOLID = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0)
FAINT = nv.StokesViscosity(K_v=0.0, G_v=1e-9)
"""A viscosity that hardly damps the unfelt motion."""


def run_of(k, m, cells=(4, 4), solver="coupled", **start):
    space, mesh = nv.Discretisation(k=k, m=m), structured_box((1, 1), cells)
    return small_run(mesh, discretisation=space, solver=solver, **(SMOOTH | {"viscosity": FAINT} | start))


@pytest.mark.parametrize(("k", "m"), [(2, 0), (3, 0), (3, 1), (2, 1), (3, 2)])
def test_the_ledger_has_the_column_unfelt_only_if_m_is_below_k_minus_1(k, m):
    run = run_of(k, m)
    with warnings.catch_warnings():
        warnings.simplefilter("error", nv.InputWarning)
        run.advance()
    assert (UNFELT in run.ledger.columns) == (m < k - 1)
    if m < k - 1:
        unfelt, kinetic = run.ledger.column(UNFELT), run.ledger.column("kinetic")
        assert (unfelt > 0).all() and (unfelt < 0.02 * kinetic).all()


def test_unfelt_energy_of_smooth_motion_is_of_fourth_order():
    sizes = [run_of(2, 0, (n, n)).ledger.start(0.0)[UNFELT] for n in (4, 8)]
    assert 12 < sizes[0] / sizes[1] < 20


def test_motion_within_cells_is_measured_and_warned_of_once():
    """The start velocity is a random sum of edge functions alone."""
    run = run_of(2, 0)
    v = run.rothe_step.state.components[run.rothe_step.layout.names.index("v")]
    values = v.vec.FV().NumPy()
    vertices, count = run.mesh.nv, len(values) // 2
    for i in range(2):
        values[i * count : i * count + vertices] = 0.0
    values[:] += np.random.default_rng(0).uniform(-1, 1, len(values)) * (
        np.arange(len(values)) % count >= vertices
    )
    with pytest.warns(
        nv.InputWarning, match="of the kinetic energy is motion within cells that no stress resists"
    ) as said:
        row = run.ledger.start(0.0)
        run.ledger.state()
    assert len(said) == 1 and 0.1 * row["kinetic"] < row[UNFELT] < row["kinetic"]


def bodies(of_disc, of_rest):
    disc = nv.Body(
        name="disc", where=nv.Ball((0.5, 0.5), 0.3), material=SOLID, density=1.0, viscosity=of_disc
    )
    return {"bodies": [disc, nv.Body(name="rest", material=SOLID, density=1.0, viscosity=of_rest)]}


@pytest.mark.parametrize(("k", "m"), [(2, 0), (3, 0), (3, 1)])
@pytest.mark.parametrize(
    ("laws", "whose"),
    [
        ({}, "a shear viscosity, since with"),
        ({"viscosity": nv.StokesViscosity(K_v=1.0, G_v=0.0)}, "a shear viscosity, since with"),
        ({"creep": nv.Creep(G_m=1.0)}, "a shear viscosity, since with"),
        (bodies(FAINT, None), "a shear viscosity of the body 'rest', since with"),
    ],
)
def test_unfelt_motion_without_viscosity_is_refused_with_the_remedy(k, m, laws, whose):
    expected = (
        rf"Discretisation.m = {m}: expected {k - 1}, or nv.Discretisation\(k={m + 1}, m={m}\), or {whose}"
    )
    with pytest.raises(nv.ParameterError, match=expected):
        small_run(discretisation=nv.Discretisation(k=k, m=m), **laws)


@pytest.mark.parametrize(
    "laws", [{"hyperviscosity": nv.HyperViscosity(mu=1e-4)}, {"viscosity": FAINT}, bodies(FAINT, FAINT)]
)
def test_unfelt_motion_with_viscosity_is_accepted(laws):
    small_run(discretisation=nv.Discretisation(m=0), **laws)


def test_orders_without_unfelt_motion_need_no_viscosity():
    small_run(discretisation=nv.Discretisation(k=1, m=0))
