"""Runs the command as a user does, in this process, or in a new process if a test needs one."""

import contextlib
import io
import os
import subprocess
import sys
import time
from pathlib import Path

from support import A_BODY, A_SWIRL

from ngvisco.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
COMMAND = [sys.executable, "-m", "ngvisco"]

CASE = f"""\
title = "a small swirl"
{A_BODY}[rheology.viscosity]
K_v = 0.01
G_v = 0.01
[[loads]]
kind = "Gravity"
g = [0, "-1 - sin(t)"]
{A_SWIRL}[time]
dt = 0.02
until = 0.08
[output.checkpoint]
every = 1
"""


def environment():
    return os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}


def start(*arguments, **options):
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def command(*arguments):
    """Run the command in this process; no user input may raise an exception."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as refused:  # the command line's parser exits
            code = refused.code
    return code, out.getvalue(), err.getvalue()


def wait_for(condition, process, seconds=60):
    """Wait until ``condition()`` holds; fail if the process ends before."""
    for _ in range(seconds * 50):
        if condition():
            return
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    raise AssertionError("waited in vain")


def rows(directory):
    path = directory / "ledger.csv"
    return len(path.read_text().splitlines()) - 1 if path.exists() else 0
