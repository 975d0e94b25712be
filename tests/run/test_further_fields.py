"""Stresses, rates and stretches that are written on request agree with closed forms and the ledger."""

import numpy as np
import pytest
from ngsolve import CF, pi, sin, x, y
from scipy.linalg import sqrtm
from support import small_run, tensor, value

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.tensors import inner, sym
from ngvisco.run.fields import NAMES, eigenvalues, scalar_fields, usual
from ngvisco.run.frames import read_frame
from ngvisco.run.observers import VTKSeries

F_0 = np.array([[1.2, 0.3, 0], [-0.1, 0.9, 0], [0, 0, 1.1]])
STRETCHES = np.linalg.svd(F_0)[1]


def simulation(material, dim=2, F=None, passive=(), **model):
    size = (1.0,) * dim
    return small_run(
        box(size, maxh=0.6 if dim == 2 else 1.0),
        material=material,
        **model,
        F=F,
        velocity=(sin(pi * x), *(0.0,) * (dim - 1)),
        passive=passive,
    )


def at(run, name):
    f = run.fields[name]
    return np.array(f(run.mesh(*(0.3, 0.4, 0.2)[: run.mesh.dim]))).reshape(tuple(f.dims) or ())


@pytest.mark.parametrize("equal", [(2, 2, 2), (3, 1, 1), (3, 3, 1), (0, 0, 0), (1e6, 1e6, 1e6 + 1)])
def test_eigenvalues_are_right_also_if_they_are_equal(equal):
    Q = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    A = Q @ np.diag(np.array(equal, dtype=float)) @ Q.T
    found = value(eigenvalues(tensor(0.5 * (A + A.T))))
    assert found == pytest.approx(sorted(equal, reverse=True), abs=1e-7 * max(1, max(equal) ** 0.5))


MATERIALS = {
    "F": nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
    "B": nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="B"),
    "J^(-5/6) F": nv.LogarithmicNeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
    "J^(-5/3) F F^T": nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, elastic_state="B"),
    "J^(-1/3) F": nv.IsochoricNeoHookean(K_e=10.0, G_e=5.0, elastic_state="F"),
    "F/J": nv.PerReferentialVolume(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)),
}


@pytest.mark.parametrize("name", MATERIALS)
def test_principal_stretches_are_the_singular_values_of_F(name):
    run = simulation(MATERIALS[name], F=CF(tuple(F_0.ravel()), dims=(3, 3)))
    assert at(run, "principal_stretches") == pytest.approx(STRETCHES, rel=1e-10)
    T = at(run, "cauchy_stress")
    assert at(run, "principal_stresses") == pytest.approx(np.linalg.eigvalsh(T)[::-1], abs=1e-10)


def test_principal_stretches_exist_for_small_strains_and_not_for_fluids():
    stretch = sqrtm(F_0 @ F_0.T).real
    run = simulation(nv.LinearElastic(K_e=2.0, G_e=1.0), F=CF(tuple(stretch.ravel()), dims=(3, 3)))
    assert at(run, "principal_stretches") == pytest.approx(np.linalg.eigvalsh(stretch)[::-1], rel=1e-10)
    assert "principal_stretches" not in simulation(nv.BarotropicFluid(B=1.0, gamma=1.4)).fields


@pytest.mark.parametrize("solver", ["coupled", "split"])
@pytest.mark.parametrize("nu", [0.0, 1e-2])
def test_integrals_of_fields_equal_the_powers_of_the_ledger(nu, solver):
    """int Pi : M, int D eps : eps and int hyperstress : hess v are the dissipations of the last step."""
    swirl = (sin(pi * x) * sin(pi * y) ** 2, 0.0)
    run = small_run(
        viscosity=nv.StokesViscosity(K_v=0.3, G_v=0.2),
        hyperviscosity=nv.HyperViscosity(mu=1e-4, p=2.0),
        creep=nv.Creep(G_m=2.0, nu=nu),
        velocity=swirl,
        solver=solver,
    )
    row = run.run(0.04).rows[-1]
    step, fields = run.rothe_step, run.fields
    u, integral = step.now, step.quadrature.integrate_cells
    power = float(integral(inner(fields["creep_rate"], fields["mandel_stress"])))
    creep = sum(value for name, value in row.items() if name.startswith("dissipation_creep"))
    assert power == pytest.approx(creep, rel=1e-6 if nu else 1e-12) and creep > 1e-6
    eps = sym(u.L)
    viscous = row["dissipation_stokes_bulk"] + row["dissipation_stokes_shear"]
    assert float(integral(inner(fields["viscous_stress"], eps))) == pytest.approx(viscous, rel=1e-12)
    # for p = 2, S = mu Hs: |S|^2/mu is the dissipation without that of the penalty
    squares = sum(inner(fields[f"hyperstress_{i}"], fields[f"hyperstress_{i}"]) for i in (1, 2))
    assert 0 < float(integral(squares)) / 1e-4 <= row["dissipation_hyper"] * (1 + 1e-10)
    assert "hyperstress_3" not in fields


def test_a_model_has_no_fields_of_quantities_that_it_lacks():
    fields = simulation(nv.BarotropicFluid(B=1.0, gamma=1.4)).fields
    assert {name for name in NAMES if name in fields} == {"principal_stresses"}
    assert at(simulation(nv.BarotropicFluid(B=1.0, gamma=1.4)), "principal_stresses") == pytest.approx(-0.4)


def test_a_vtk_series_has_derived_fields_only_on_request(tmp_path):
    run = simulation(MATERIALS["F"], viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1), passive=["F_tot"])
    asked = ["mandel_stress", "viscous_stress", "principal_stretches", "F_tot"]
    for names, folder in ((None, "usual"), (asked, "asked")):
        series = VTKSeries(tmp_path / folder, fields=names)
        series.start(run)
        frame = read_frame(tmp_path / folder / "fields_000000.vtu")
        assert set(frame.fields) == set(usual(run.fields) if names is None else names)
    assert not set(usual(run.fields)) & set(NAMES) and "F_tot" in usual(run.fields)
    drawn = scalar_fields(run.fields, ["F_tot", "F_tot_12", "principal_stretches_1", "mandel_stress"])
    for name in drawn:
        if name != "mandel_stress":
            assert frame.scalar(name) == pytest.approx(drawn[name](run.mesh(0.3, 0.4)), abs=1e-12)
    assert b'ComponentName0="1"' in (tmp_path / "asked" / "fields_000000.vtu").read_bytes()


@pytest.mark.parametrize("start", ["F", "H and J"])
def test_F_tot_starts_from_the_variables_that_determine_F(start):
    J, F = np.linalg.det(F_0), CF(tuple(F_0.ravel()), dims=(3, 3))
    given = {"F": F} if start == "F" else {"values": {"H": J ** (-5 / 6) * F, "J": J}}
    material = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, elastic_state="F")
    run = small_run(0.6, material=material, passive=["F_tot"], **given)
    assert at(run, "F_tot") == pytest.approx(F_0, rel=1e-12)
