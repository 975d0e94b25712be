"""Runs as processes of their own, handed out by dask.distributed.

Each run is ``ngvisco run`` or ``ngvisco resume`` in a process of its own: NGSolve's time, threads and memory
belong to a process, one run's crash is its failure alone, and a run that is stopped leaves a checkpoint.
Dask's workers only wait for them, so that those of the local cluster are threads.
"""

import atexit
import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from ngvisco.run.checkpoint import version
from ngvisco.sweep.variations import SweepError

_POLL, _ASK = 0.2, 5
"""Seconds between looks at a process, and looks between questions to the scheduler whether to stop."""
_CONNECT = "10s"
_running: set[subprocess.Popen[str]] = set()


@contextlib.contextmanager
def connected(scheduler: str | None, workers: int) -> Iterator[Any]:
    """A client of a local cluster with so many workers, or of the dask scheduler at an address.

    Raises SweepError if dask.distributed is missing, the scheduler is not reached, has no workers, or these
    have another version of ngvisco or none.
    """
    try:
        import distributed
    except ImportError as error:
        raise SweepError('dask.distributed is missing: pip install "ngvisco[sweep]"') from error
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
            # before there is a client: one that does not connect raises again when it is collected
            distributed.comm.parse_host_port(place)
        client = distributed.Client(scheduler, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        message = f"--scheduler {scheduler}: expected the address of a dask scheduler, as tcp://host:8786"
        raise SweepError(f"{message} ({error})") from error
    with client:
        _check_workers(client, scheduler)
        yield client


def _check_workers(client: Any, scheduler: str) -> None:
    own = version()
    try:
        found = client.run(version)
    except Exception as error:  # whatever importing raises there
        message = f"its workers cannot import ngvisco ({type(error).__name__}: {error})"
        raise SweepError(f"--scheduler {scheduler}: {message}") from error
    if not found:
        raise SweepError(f"--scheduler {scheduler}: expected workers, but it has none; start dask worker")
    others = {address: there for address, there in found.items() if there != own}
    if others:
        address, there = next(iter(others.items()))
        own, there = (one or "one of a clone that is not installed" for one in (own, there))
        message = f"expected ngvisco {own} on its workers, but {address} has {there}"
        raise SweepError(f"--scheduler {scheduler}: {message}")


def run_or_resume(case: str, directory: str, threads: int, stop: str) -> tuple[int | None, str]:
    """Go on with the run in a directory, or begin it with a case file; waits for its end.

    Decided where it is done: a run whose worker was lost is given to another, and goes on there.

    Parameters
    ----------
    case, directory : str
        Absolute paths, the same on every machine.
    stop : str
        Name of the dask event by which all runs are stopped.

    Returns
    -------
    code, message : int or None, str
        Exit code of ``ngvisco``, negative for a signal that killed it, None if the run was not begun; what it
        wrote to standard error.
    """
    from distributed import Event, get_client

    event = Event(stop, client=get_client())
    if event.is_set():
        return None, ""
    begun = os.path.exists(os.path.join(directory, "case.toml"))
    what = ["resume", directory] if begun else ["run", case, "-o", directory]
    options = ["--threads", str(threads), "--quiet", "--ends-with-stdin"]
    command = [sys.executable, "-m", "ngvisco", *what, *options]
    # held open until the run has ended, or this process is killed: then the run ends its step too
    read, held = os.pipe()
    process = subprocess.Popen(
        command,
        stdin=read,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="backslashreplace",
        env=os.environ | {"NGVISCO_THREADS": str(threads)},
        start_new_session=True,  # the terminal's Ctrl-C is for the study, which lets steps end
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
    """A study or worker that ends before its runs: these end their step, and leave a checkpoint."""
    for process in list(_running):
        process.terminate()


def _waited(process: subprocess.Popen[str], event: Any) -> tuple[int, str]:
    looks, asked = 0, False
    try:
        while True:
            try:
                _, said = process.communicate(timeout=_POLL)
                return process.returncode, said
            except subprocess.TimeoutExpired:
                looks += 1
            if not asked and looks % _ASK == 0 and event.is_set():
                process.terminate()  # it ends its step, writes a checkpoint and ends with 143
                asked = True
    except BaseException:  # the scheduler is gone, or this worker is told to go
        process.terminate()
        raise


def message_of(said: str) -> str:
    """The standard error of a process as one line, without its warnings, which are in its log.txt."""
    lines = [line.removeprefix("ngvisco: ") for line in said.splitlines()]
    if any(line.startswith("Traceback") for line in lines):
        lines = lines[-1:]
    return "; ".join(line.strip() for line in lines if line.strip() and not line.startswith("warning: "))
