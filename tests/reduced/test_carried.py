"""Terms that are polynomials in a cell have the same rows with fewer quadrature points."""

import numpy as np
import pytest
from ngsolve.meshes import MakeStructured3DMesh

import ngvisco as nv
from ngvisco.geometries import box, disc
from tests.support import each_once, small_run


def residual(mesh, k=2, m=1, creep=None, **options):
    """The split solver's residual of a network of two branches, the first of which creeps."""
    first = nv.Branch(material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0), creep=creep or nv.Creep(G_m=2.0))
    second = nv.Branch(material=nv.ReferentialNeoHookean(K_e=0.0, G_e=2.0))
    material = nv.Network(branches={"first": first, "second": second})
    options |= {
        "discretisation": nv.Discretisation(k=k, m=m),
        "viscosity": nv.StokesViscosity(K_v=1.0, G_v=1.0),
    }
    return small_run(mesh, material=material, solver="split", **options).solver.newton.residual


def rows_by_both_rules(r):
    """Rows of the carried terms at random fields, by the rule of fewer points and by the forms' rule."""
    random = np.random.default_rng(0)
    for terms in (r.cell_terms, r.carried_terms):
        terms.context.sampled.start()
    c = {
        name: random.standard_normal(values.shape)
        for name, values in r.unknowns.coefficients(r.unknowns.pack()).items()
    }
    c["zeta"] = random.standard_normal(c["z"].shape)
    return [terms.rows(r.carried, terms.fields(c)) for terms in (r.carried_terms, r.cell_terms)]


@pytest.mark.parametrize(("dim", "orders"), each_once([2, 3], [(1, 0), (2, 1), (3, 2)]))
def test_polynomial_rows_are_the_same_with_fewer_points(dim, orders):
    mesh = box((1, 1), 0.5) if dim == 2 else MakeStructured3DMesh(hexes=False, nx=1, ny=1, nz=1)
    r = residual(mesh, *orders)
    assert [type(term).__name__ for term in r.carried] == ["ElasticForce", "Kinematics"]
    assert r.carried_terms.op.z.per_cell < r.op.z.per_cell
    few, all_points = rows_by_both_rules(r)
    assert few.keys() == all_points.keys() == {"v", "z"}
    for name, rows in all_points.items():
        assert np.abs(few[name] - rows).max() <= 1e-12 * np.abs(rows).max()


def test_rows_differ_with_fewer_points_than_their_degree_needs(monkeypatch):
    r = residual(box((1, 1), 0.5))
    monkeypatch.setattr(r, "carried_terms", None)
    monkeypatch.setattr(type(r.carried[1]), "degree", lambda *_: 2)
    monkeypatch.setattr(type(r.carried[0]), "degree", lambda *_: 2)
    r._divide(r.step)
    few, all_points = rows_by_both_rules(r)
    assert np.abs(few["z"] - all_points["z"]).max() > 1e-3 * np.abs(all_points["z"]).max()


def test_rows_that_are_no_polynomials_keep_all_points():
    """Exceptions are bodies of revolution and curved cells, whose weights are no polynomials, and orders
    whose rule has no fewer points."""
    around = residual(box((1, 1), 0.5), symmetry="axisymmetric")
    for r in (around, residual(disc(1.0, 0.8)), residual(box((1, 1), 0.5), k=1, m=1)):
        kept = {type(term).__name__ for term in r.others}
        assert "Kinematics" in kept
    assert not around.carried and around.others == around.at_points
