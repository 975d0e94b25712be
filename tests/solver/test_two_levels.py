"""The two-level solver's smoother, factors in single precision, and ``NewtonOptions.coarse``."""

import sys

import numpy as np
import pytest
import scipy.sparse as sp

import ngvisco as nv
from ngvisco.algebra import factorised
from ngvisco.algebra.banded import Band
from ngvisco.algebra.factorised import MANY, SMOOTHED, DirectSolver, TwoLevelSolver, largest_eigenvalue
from ngvisco.errors import InputWarning, ParameterError
from ngvisco.geometries import box, disc
from ngvisco.parallel import petsc
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.solver import options
from ngvisco.solver.options import SplitOptions


@pytest.mark.parametrize("size", [MANY // 2, 5 * MANY])
def test_the_largest_eigenvalue_of_a_single_cell_is_found(size):
    """The power method from a random vector would return the eigenvalue of all other cells, 2."""
    rng = np.random.default_rng(2)
    scale = np.exp(rng.standard_normal(size))
    A = sp.diags([np.full(size - 1, -0.5), np.ones(size), np.full(size - 1, -0.5)], [-1, 0, 1]).tolil()
    for i in range(4):  # a block of larger coupling: its eigenvalue is 1 + 3 * 0.9
        for j in range(4):
            A[20 + i, 20 + j] = 1.0 if i == j else 0.9
    A = (sp.diags(scale) @ A.tocsr() @ sp.diags(scale)).tocsr()
    D = np.sqrt(A.diagonal())
    exact = np.linalg.eigvalsh(A.toarray() / np.outer(D, D)).max()
    assert exact > 3.7
    assert largest_eigenvalue(A) == pytest.approx(exact, rel=0.03)
    with_zeros = sp.block_diag([A, sp.csr_matrix((3, 3))]).tocsr()
    assert largest_eigenvalue(with_zeros) == pytest.approx(exact, rel=0.03)


def test_smoothing_sweeps_reduce_errors_by_the_chebyshev_polynomial():
    """The smoother leaves at most 1/T_3(9/7) of errors with eigenvalues of D^{-1} A in [largest/8, largest],
    and of one error exactly this part."""
    size = MANY // 2
    turned = np.linalg.qr(np.random.default_rng(3).standard_normal((size, size)))[0]
    A = turned @ np.diag(np.linspace(1.0, SMOOTHED, size)) @ turned.T
    scale = 1 / np.sqrt(A.diagonal())
    A = scale[:, None] * A * scale
    eigenvalues, vectors = np.linalg.eigh(A)
    none = np.zeros(size, dtype=bool)
    solver = TwoLevelSolver(
        ~none, none, none, lambda *_: DirectSolver(none), Exchange(size, {}, Communicator())
    )
    solver.factorise(sp.csr_matrix(A))
    left = np.array([abs(e @ (e - solver._smoothed(A @ e))) for e in vectors.T])
    reduced = eigenvalues > eigenvalues[-1] / SMOOTHED
    bound = 1 / np.polynomial.chebyshev.chebval((SMOOTHED + 1) / (SMOOTHED - 1), [0, 0, 0, 1])
    assert 0.95 * bound < left[reduced].max() < 1.05 * bound


def test_vertices_and_edges_are_solved_together():
    """The spaces of vertices and edges meet at an angle with the cosine 1/2. Exact solutions of both blocks
    then leave 1/4 of an error in the energy norm. The polynomial adds at most 1/T_3(9/7) = 0.215."""
    fine, coarse, rng = 40, 10, np.random.default_rng(4)
    turned = np.linalg.qr(rng.standard_normal((fine, fine)))[0]
    among_fine = turned @ np.diag(np.linspace(1.0, SMOOTHED, fine)) @ turned.T
    root = np.linalg.cholesky(among_fine)
    coupling = root @ np.linalg.qr(rng.standard_normal((fine, coarse)))[0] * 0.5
    A = np.block([[np.eye(coarse), coupling.T], [coupling, among_fine]])
    every, vertices = np.ones(fine + coarse, dtype=bool), np.arange(fine + coarse) < coarse

    def factorised_coarse(mask, matrix, symmetric):
        solver = DirectSolver(mask)
        solver.factorise(matrix)
        return solver

    solver = TwoLevelSolver(
        every, vertices, ~every, factorised_coarse, Exchange(len(every), {}, Communicator())
    )
    solver.factorise(sp.csr_matrix(A))
    product = np.eye(len(A)) - np.array([solver(column) for column in A.T]).T
    energy = np.linalg.cholesky(A).T
    left = np.linalg.norm(energy @ product @ np.linalg.inv(energy), 2)
    assert left < 0.25 + 0.215


@pytest.mark.parametrize(("shift", "sizes"), [(1e-2, [4]), (1e-7, [4, 8])], ids=["single", "double"])
@pytest.mark.parametrize("unit", [1e-50, 1.0, 1e50])
@pytest.mark.parametrize("largest", [0, 100], ids=["sparse", "band"])
def test_a_preconditioner_has_single_precision_factors_if_they_suffice(
    shift, sizes, unit, largest, monkeypatch
):
    """Units may exceed single precision; next to a singular matrix factors are in double precision."""
    count, made, factorise, of_band = 50, [], factorised.splu, Band.factorise

    def counted(matrix, **options):
        made.append(matrix.dtype.itemsize)
        return factorise(matrix, **options)

    def counted_band(band, dtype):
        assert largest
        made.append(np.dtype(dtype).itemsize)
        return of_band(band, dtype)

    monkeypatch.setattr(factorised, "splu", counted)
    monkeypatch.setattr(Band, "factorise", counted_band)
    monkeypatch.setattr(factorised, "LARGEST_BAND", largest)
    A = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], (count, count)).tolil()
    A[0, 0] = A[-1, -1] = 1.0  # constants are in the kernel
    A = unit * (A + shift * sp.identity(count)).tocsr()
    solver = DirectSolver(np.ones(count, dtype=bool), symmetric=True, approximate=True)
    solver.factorise(A)
    right = np.random.default_rng(1).standard_normal(count)
    assert np.linalg.norm(A @ solver(right) - right) < 1e-3 * np.linalg.norm(right)
    assert made == sizes


def test_a_band_solves_in_any_numbering_and_refuses_an_indefinite_matrix():
    rng = np.random.default_rng(3)
    count, order = 60, rng.permutation(60)
    A = sp.diags([-1.0, 0.3, 3.0, 0.3, -1.0], [-7, -1, 0, 1, 7], (count, count)).tocsr()[order][:, order]
    band, right = Band(A), rng.standard_normal(count)
    assert band.entries <= 20 * count
    assert band.factorise(np.float64)
    assert np.allclose(A @ band.solve(right), right, rtol=0, atol=1e-13)
    assert not Band(A - 3.0 * sp.identity(count)).factorise(np.float64)


def test_multigrid_without_petsc_is_refused_by_name(monkeypatch):
    monkeypatch.setattr(petsc, "_loaded", [])
    monkeypatch.setitem(sys.modules, "petsc4py", None)  # as if petsc4py were not installed
    with pytest.raises(ParameterError, match="coarse = 'gamg': expected 'direct', since petsc4py is missing"):
        nv.NewtonOptions(coarse="gamg")
    with pytest.raises(ParameterError, match="coarse = 'amg': expected one of direct, gamg, hypre"):
        nv.NewtonOptions(coarse="amg")
    with pytest.raises(ParameterError, match="coarse = 'gamg': expected 'direct' with the method 'coupled'"):
        nv.NewtonOptions(coarse="gamg", method="coupled")


@pytest.mark.parametrize(
    ("domain", "solver", "reason"),
    [
        (lambda: box((1, 1), maxh=1.0), "auto", "the coupled solver, which takes the steps, factorises all"),
        (
            lambda: box((1, 1), maxh=0.5),
            "split",
            "the .* unknowns of v are factorised as a whole, like all systems of up to 10000",
        ),
        (
            lambda: disc(1.0, maxh=0.9),
            "split",
            "the matrix with stresses of oblique or curved walls",
        ),
    ],
)
def test_a_multigrid_option_without_effect_is_warned_of(monkeypatch, domain, solver, reason):
    monkeypatch.setattr(options, "obstacle", lambda method: None)  # the test also runs without PETSc
    limit = 0 if "walls" in reason else 10_000
    newton = nv.NewtonOptions(coarse="gamg", split=SplitOptions(direct_up_to=(limit, limit)))
    model = nv.Model(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1))
    with pytest.warns(InputWarning, match=f"coarse = 'gamg' of the solver has no effect, since {reason}"):
        assert nv.Simulation(domain(), model, dt=0.02, newton=newton, solver=solver).solver.newton
