"""Runs as separate processes, distributed by dask.distributed.

Each run is a separate process ``ngvisco run`` or ``ngvisco resume``: NGSolve's threads and memory belong to a
process, a crash fails one run alone, and a stopped run leaves a checkpoint.  Dask's workers only wait for the
processes, so the workers of a local cluster are threads.
"""

import atexit
import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from ngvisco.run.snapshot import version
from ngvisco.sweep.variations import SweepError

_POLL, _ASK = 0.2, 5
"""Seconds between polls of a process, and number of polls between queries of the stop event."""
_CONNECT = "10s"
_running: set[subprocess.Popen[str]] = set()


@contextlib.contextmanager
def connected(scheduler: str | None, workers: int) -> Iterator[Any]:
    """Context with a client of a local cluster with ``workers`` threads, or of the scheduler at an address.

    Raises SweepError if dask.distributed is missing, if the scheduler is not reached or has no workers, or if
    a worker has another version of ngvisco or none.
    """
    try:
        import distributed
    except ImportError as error:
        raise SweepError('dask.distributed is missing; run pip install "ngvisco[sweep]"') from error
    if scheduler is None:
        cluster = distributed.LocalCluster(
            processes=False, n_workers=1, threads_per_worker=workers, dashboard_address=None, memory_limit=0
        )
        with cluster, distributed.Client(cluster, set_as_default=False) as client:
            yield client
        return
    try:
        protocol, place = distributed.comm.parse_address(scheduler)
        if protocol in ("tcp", "tls"):
            # the address is checked first, because a client that does not connect raises a second error when
            # Python deletes the client
            distributed.comm.parse_host_port(place)
        client = distributed.Client(scheduler, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        message = (
            f"--scheduler {scheduler}: expected the address of a dask scheduler, such as tcp://host:8786"
        )
        raise SweepError(f"{message} ({error})") from error
    with client:
        _check_workers(client, scheduler)
        yield client


def _check_workers(client: Any, scheduler: str) -> None:
    expected = version()
    try:
        versions = client.run(version)
    except Exception as error:  # the import on a worker may raise any error
        message = f"the workers cannot import ngvisco ({type(error).__name__}: {error})"
        raise SweepError(f"--scheduler {scheduler}: {message}") from error
    if not versions:
        message = f"--scheduler {scheduler}: expected a scheduler with workers; start workers by dask worker"
        raise SweepError(message)
    different = {address: there for address, there in versions.items() if there != expected}
    if different:
        address, there = next(iter(different.items()))
        expected, there = (
            version or "a version of a clone that is not installed" for version in (expected, there)
        )
        message = f"expected ngvisco {expected} on the workers, but {address} has {there}"
        raise SweepError(f"--scheduler {scheduler}: {message}")


def run_or_resume(case: str, directory: str, threads: int, stop: str) -> tuple[int | None, str]:
    """Resume the run in a directory, or start it with a case file, and wait for its end.

    The worker decides between the two, because a run of a lost worker is resumed by another one.

    Parameters
    ----------
    case, directory : str
        Absolute paths, valid on every machine.
    stop : str
        Name of the dask event by which all runs are stopped.

    Returns
    -------
    code, message : int or None, str
        Exit code of ``ngvisco``, negative for a signal that killed it, None if the run was not begun; and its
        standard error.
    """
    from distributed import Event, get_client

    event = Event(stop, client=get_client())
    if event.is_set():
        return None, ""
    begun = os.path.exists(os.path.join(directory, "case.toml"))
    action = ["resume", directory] if begun else ["run", case, "-o", directory]
    options = ["--threads", str(threads), "--quiet", "--ends-with-stdin"]
    command = [sys.executable, "-m", "ngvisco", *action, *options]
    # the pipe closes if this process is killed, which makes the run give up its step
    read, held = os.pipe()
    process = subprocess.Popen(
        command,
        stdin=read,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="backslashreplace",
        env=os.environ | {"NGVISCO_THREADS": str(threads)},
        start_new_session=True,  # Ctrl-C must reach the study alone: the study lets steps end
    )
    os.close(read)
    _running.add(process)
    try:
        return _waited(process, event)
    finally:
        _running.discard(process)
        os.close(held)


@atexit.register
def _end_all() -> None:
    """Terminate the runs when their study or worker ends; each gives up its step and leaves a checkpoint."""
    for process in list(_running):
        process.terminate()


def _waited(process: subprocess.Popen[str], event: Any) -> tuple[int, str]:
    looks, is_asked = 0, False
    try:
        while True:
            try:
                _, output = process.communicate(timeout=_POLL)
                return process.returncode, output
            except subprocess.TimeoutExpired:
                looks += 1
            if not is_asked and looks % _ASK == 0 and event.is_set():
                process.terminate()  # the run gives up its step, writes a checkpoint and exits with 143
                is_asked = True
    except BaseException:  # the scheduler is gone, or this worker is closed
        process.terminate()
        raise


def message_of(output: str) -> str:
    """Standard error of a process as one line, without warnings, which are in the run's log.txt."""
    lines = [line.removeprefix("ngvisco: ") for line in output.splitlines()]
    if any(line.startswith("Traceback") for line in lines):
        lines = lines[-1:]
    return "; ".join(line.strip() for line in lines if line.strip() and not line.startswith("warning: "))
