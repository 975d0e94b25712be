"""The quadrature rule of the forms and of the ledger's integrals, compiled integrands, and upwinding."""

import shutil
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from ngsolve import CF, BitArray, IfPos, Integrate, Mesh, sin, specialcf, unit_square, x, y, z

import ngvisco as nv
from ngvisco.errors import ParameterError
from ngvisco.forms.mesh.points import SidePoints
from ngvisco.forms.mesh.quadrature import SCRIPT, VARIABLE, Quadrature, Sampler, compiled
from ngvisco.forms.mesh.symmetry import NO_SYMMETRY
from ngvisco.forms.start.initial import set_initial
from ngvisco.forms.system import Step
from ngvisco.forms.terms import momentum
from ngvisco.geometries import box
from tests.support import uncondensed

DEGREES = [3, 6, 9]


@pytest.mark.parametrize("degree", DEGREES)
def test_polynomials_of_the_degree_are_exact(degree: int) -> None:
    quadrature = Quadrature(box((1, 1), 0.5), degree, degree)
    assert quadrature.integrate_cells(x**degree) == pytest.approx(1 / (degree + 1), rel=1e-13)
    # the divergence theorem over all cells' boundaries
    flux = x**degree * specialcf.normal(2)[0]
    assert quadrature.integrate_facets(flux) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(("k", "m"), [(2, 1), (2, 2), (3, 2)])
def test_both_sides_of_a_face_have_the_same_quadrature_points(k: int, m: int) -> None:
    """From degree 8 on NGSolve's rules for triangles have no symmetry, and cells number their faces
    differently."""
    mesh = box((1, 0.7, 0.8), 1.0)
    points = SidePoints(mesh, Quadrature.for_orders(mesh, k, m).facet_degree, NO_SYMMETRY)
    places = np.stack([points.sample(c) for c in (x, y, z)], axis=1).reshape(-1, points.per_side, 3)
    order = [side[np.lexsort(np.round(side, 9).T)] for side in places]
    found = np.unique(np.round(np.stack(order).reshape(len(places), -1), 9), axis=0)
    assert len(found) == mesh.nface


def test_integrands_are_interpreted_by_default(monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("PATH", "/nowhere")  # there is no compiler, so that nothing is compiled
    mesh = Mesh(unit_square.GenerateMesh(maxh=0.5))
    assert Integrate(compiled(x * y), mesh) == pytest.approx(0.25)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.skipif(
    not (shutil.which("c++") and shutil.which(SCRIPT, path=str(Path(sys.executable).parent))),
    reason="no compiler",
)
def test_compiled_integrands_have_the_same_values(monkeypatch):
    monkeypatch.setenv(VARIABLE, "1")
    mesh = Mesh(unit_square.GenerateMesh(maxh=0.5))
    f = CF((sin(3 * x) * y, IfPos(x - y, x, -y)))
    machine, given = (np.array(Integrate(g, mesh, order=6)) for g in (compiled(f), f))
    assert machine == pytest.approx(given, rel=1e-14)


def test_an_unknown_option_of_compilation_is_refused(monkeypatch):
    monkeypatch.setenv(VARIABLE, "yes")
    with pytest.raises(ParameterError, match="NGVISCO_COMPILE = 'yes'"):
        compiled(x)


def test_compilation_without_a_compiler_is_refused(monkeypatch, tmp_path):
    monkeypatch.setenv(VARIABLE, "1")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ParameterError, match=r"c\+\+"):
        compiled(x)


def density_of_a_long_step():
    """Least density after a step in which a wild velocity carries matter through many cells."""
    step = Step(
        box((1, 1), 0.3), nv.Model(material=nv.BarotropicFluid(B=1.0, gamma=1.4)), nv.Discretisation(m=0)
    )
    set_initial(step, nv.Initial(), Sampler(step.mesh, step.quadrature))
    rng, ranges = np.random.default_rng(2), step.layout.ranges
    for state in (step.state, step.state_old):
        state.vec.FV().NumPy()[ranges["v"]] = np.random.default_rng(3).uniform(
            -1, 1, step.layout.blocks["v"].ndof
        )
        state.vec.FV().NumPy()[ranges["v"]][~np.array(list(step.layout.blocks["v"].FreeDofs()))] = 0.0
    step.state_old.vec.FV().NumPy()[ranges["rho"]] = 10 ** rng.uniform(-3, 0, step.mesh.ne)
    step.context.tau.Set(1.0)
    (term,) = (term for term in step.terms if type(term).__name__ == "Continuity")
    u = step.linearised_fields(step.layout.space.TrialFunction())
    form = uncondensed(step, term.form(u, step.tests()))
    form.AssembleLinearization(step.state.vec)
    free = BitArray(step.layout.space.ndof)
    free.Clear()
    for name in ("rho", "rho_hat"):
        free[ranges[name]] = True
    residual = step.state.vec.CreateVector()
    form.Apply(step.state.vec, residual)
    step.state.vec.data -= form.mat.Inverse(free, inverse="umfpack") * residual
    return step.state.vec.FV().NumPy()[ranges["rho"]].min()


def test_an_implicit_step_of_order_zero_keeps_densities_positive_however_long_it_is():
    """A control: the same step without upwinding does not keep them positive."""
    assert density_of_a_long_step() > 0
    with patch.object(momentum, "speed", lambda u: 0.0 * (u.v * u.context.normal)):
        assert density_of_a_long_step() < 0
