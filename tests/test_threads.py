"""A step has the same bits with any number of threads, and NGSolve's workers do not compete with arrays."""

import os
import subprocess
import sys

import pytest
from ngsolve import CF, SetNumThreads
from ngsolve.la import BaseMatrix
from support import small_run
from threadpoolctl import threadpool_info, threadpool_limits

import ngvisco as nv
from ngvisco import threads
from ngvisco.solver.newton import CondensedJacobian


@pytest.mark.long
@pytest.mark.ci
def test_a_split_step_has_the_same_bits_with_two_threads():
    def state():
        run = small_run(
            0.3,
            viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.2),
            hyperviscosity=nv.HyperViscosity(mu=1e-4, p=4),
            loads=[nv.Gravity((0.0, -1.0))],
            velocity=CF((0.0, 0.0)),
            solver="split",
        )
        run.advance()
        return run.rothe_step.state.vec.FV().NumPy().copy()

    SetNumThreads(1)
    alone = state()
    SetNumThreads(2)
    try:
        together = state()
    finally:
        SetNumThreads(1)
    assert (together == alone).all()


@pytest.mark.parametrize(("given", "number"), [({}, 1), ({"NGS_NUM_THREADS": "2"}, 2)])
def test_ngsolve_has_one_thread_unless_the_user_asks_for_more(given, number):
    program = "import ngvisco, ngsolve, pyngcore\nwith ngsolve.TaskManager(): print(pyngcore.GetNumThreads())"
    environment = {name: value for name, value in os.environ.items() if name != "NGS_NUM_THREADS"} | given
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    assert int(done.stdout) == number


def test_ngsolve_has_no_workers_during_array_work():
    SetNumThreads(2)
    try:
        with threads.computing():
            assert threads.GetNumThreads() == 2
            with threads.on_arrays():
                assert threads.GetNumThreads() == 1
                with threads.computing(), threads.on_arrays():
                    assert threads.GetNumThreads() == 1
            assert threads.GetNumThreads() == 2
        assert threads.GetNumThreads() == 1
    finally:
        SetNumThreads(1)


def test_the_blas_has_one_thread_in_every_factorisation_of_a_resumed_run(monkeypatch, tmp_path):
    """With some BLAS kernels, as Haswell's, the last bits of a factorisation by two threads differ from those
    by one thread."""
    numbers, factorise = [], CondensedJacobian.factorise

    def counted(*args):
        numbers.append({blas["num_threads"] for blas in threadpool_info() if blas["user_api"] == "blas"})
        factorise(*args)

    def made(*observers):
        return small_run(0.5, solver="coupled", observers=observers)

    monkeypatch.setattr(CondensedJacobian, "factorise", counted)
    with threadpool_limits(2, "blas"):
        made(nv.Checkpoints(tmp_path / "run.h5", every=1)).run(0.02)
        of_steps = len(numbers)
        made().restore(tmp_path / "run.h5")  # the restored run repeats the last factorisation
    assert of_steps >= 1
    assert numbers == (of_steps + 1) * [{1}]


def test_the_blas_has_one_thread_when_a_state_is_carried_over(monkeypatch, tmp_path):
    numbers, inverse = [], BaseMatrix.Inverse

    def counted(*args, **options):
        numbers.append({blas["num_threads"] for blas in threadpool_info() if blas["user_api"] == "blas"})
        return inverse(*args, **options)

    run = small_run(0.5, observers=[nv.Checkpoints(tmp_path / "run.h5", every=1)])
    run.run(0.02)
    finer, changed = run.on(nv.geometries.box((1, 1), 0.3)), run.on(run.mesh, dt=0.01)
    monkeypatch.setattr(BaseMatrix, "Inverse", counted)
    with threadpool_limits(2, "blas"):
        for carry in (
            lambda: nv.transfer(run, finer),
            lambda: nv.resume_changed(changed, tmp_path / "run.h5"),
        ):
            numbers.clear()
            carry()
            assert numbers and numbers == len(numbers) * [{1}]


@pytest.mark.parametrize("parts", (1, 2, 3, 9))
def test_workers_do_every_part_once_and_return_results_in_order(parts):
    """Parts may be done before all threads have begun."""
    workers = threads.Workers(4)
    for _ in range(100):
        assert workers.map(lambda part: part**2, range(parts)) == [part**2 for part in range(parts)]


def test_an_error_of_a_part_is_raised():
    def work(part):
        return 1 / (2 - part)

    with pytest.raises(ZeroDivisionError):
        threads.Workers(2).map(work, range(4))
