"""Work shared among threads gives the same bits, and work within work does not wait for itself."""

import numpy as np
import pytest
from ngsolve import CF, SetNumThreads

import ngvisco as nv
from ngvisco import threads
from ngvisco.geometries import box


@pytest.fixture
def two_threads(monkeypatch):
    """As many threads as a machine with two cores has, products of any size shared."""
    monkeypatch.setattr(threads, "GetNumThreads", lambda: 2)
    monkeypatch.setattr(threads, "SMALL", 0)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_shares_cover_everything_once(two_threads, count):
    touched = np.zeros(count)

    def work(s):
        touched[s] += 1

    threads.shared(work, count, 1.0)
    assert (touched == 1).all()


def test_products_are_those_of_numpy(two_threads):
    rng = np.random.default_rng(0)
    A, B = rng.standard_normal((5, 3, 4)), rng.standard_normal((5, 4, 2))
    assert (threads.product(A, B) == A @ B).all()


def test_an_error_of_a_share_is_raised(two_threads):
    def work(s):
        if s.start > 0:
            raise ValueError("second share")

    with pytest.raises(ValueError, match="second share"):
        threads.shared(work, 4, 1.0)


def test_two_pieces_share_nothing_further(two_threads):
    """The pool has one thread beside the caller's: a share of a share would wait for itself."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((6, 3, 3))
    first, second = threads.concurrently(lambda: threads.product(A, A), lambda: threads.product(A, A), 1.0)
    assert (first == A @ A).all() and (second == A @ A).all()


@pytest.mark.parametrize("fails", ["first", "second"])
def test_an_error_of_a_piece_is_raised_and_sharing_goes_on(two_threads, fails):
    def piece(name):
        if name == fails:
            raise ValueError(name)

    with pytest.raises(ValueError, match=fails):
        threads.concurrently(lambda: piece("first"), lambda: piece("second"), 1.0)
    shares = []
    threads.shared(shares.append, 2, 1.0)
    assert len(shares) == 2


def test_a_split_step_has_the_same_bits_with_two_threads(monkeypatch):
    def state():
        model = nv.Model(
            material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
            viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.2),
            hyperviscosity=nv.HyperViscosity(mu=1e-4, p=4),
            loads=[nv.Gravity((0.0, -1.0))],
        )
        run = nv.Simulation(
            box((1, 1), maxh=0.3), model, dt=0.02, initial=nv.Initial(velocity=CF((0.0, 0.0))), solver="split"
        )
        run.advance()
        return run.rothe_step.state.vec.FV().NumPy().copy()

    monkeypatch.setattr(threads, "SMALL", 0)
    SetNumThreads(1)
    alone = state()
    SetNumThreads(2)
    try:
        together = state()
    finally:
        SetNumThreads(1)
    assert (together == alone).all()


def test_within_array_work_ngsolve_has_no_workers_and_arrays_have_the_threads():
    SetNumThreads(2)
    try:
        with threads.computing():
            assert threads.GetNumThreads() == 2
            with threads.on_arrays():
                assert threads.GetNumThreads() == 1 and threads._count() == 2
                with threads.computing(), threads.on_arrays():
                    assert threads._count() == 2
            assert threads.GetNumThreads() == 2
        assert threads.GetNumThreads() == 1
    finally:
        SetNumThreads(1)
