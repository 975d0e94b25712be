"""Runs that were hard to solve: ``python -m tests.benchmarks.hard_starts [NAME ...]`` in the project's root.

Each row has the iterations of the first step, their median and maximum, the steps that were divided, the
steps for which the coupled solver was tried, the limited cells, and the ratio of the slowest step to the
median, in processor time. With ``--before CHECKOUT``, another clone, the runs are first measured with its
code, and entries are "before → after". A run that exceeds ``--seconds`` of processor time is stopped, and its
row has the steps until then. This program makes the table of ``ngvisco/timestepping/NOTES.md``.

Each run is a separate process, which uses only ngvisco's public names, as all versions have them.  Meshes are
passed in files.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from ngsolve import CF, IfPos, Mesh, cos, pi, sin, x, y

HERE = Path(__file__).resolve()
COLUMNS = (
    *("run", "cells", "steps", "iterations: first", "median", "most"),
    *("in parts", "coupled", "limited cells", "dearest/median"),
)

SOLID = {"K_e": 10.0, "G_e": 5.0, "epsilon": 0.1}


def _simulation(nv: Any, mesh: Mesh, material: dict[str, Any], p: float | None, **options: Any) -> Any:
    """A neo-Hookean body with a viscosity of 0.01 Pa s and a hyperviscosity of exponent p; dt = 0.02 s.

    F may drift from J: versions that end a run for this drift get the option that allows it.
    """
    creep = options.pop("creep", None)
    given = {"dt": 0.02} | {name: options.pop(name) for name in ("dt", "scheme") if name in options}
    may_part = {"drift": 1.0} if "drift" in signature(nv.TimeSteps).parameters else {}
    model = nv.Model(
        material=nv.NeoHookean(**{"elastic_state": "F"} | material),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=None if p is None else nv.HyperViscosity(mu=1e-5, p=p),
        creep=None if creep is None else nv.Creep(G_m=creep),
        loads=options.pop("loads", ()),
    )
    return nv.Simulation(mesh, model, time=nv.TimeSteps(**given, **may_part), **options)


def _cavity(nv: Any, mesh: Mesh, p: float, creep: float | None = None) -> Any:
    """The body of demos/cavity under a lid that suddenly has full speed."""
    others = tuple(sorted(set(mesh.GetBoundaries()) - {"top"}))
    lid = nv.PrescribedTangential((1.0, *(0.0,) * (mesh.dim - 1)))
    material = {"K_e": 20.0, "G_e": 0.05, "epsilon": 0.1, "elastic_state": "F" if creep is None else "B"}
    return _simulation(nv, mesh, material, p, creep=creep, walls={"top": lid, others: nv.NoSlip()})


def _released(nv: Any, mesh: Mesh, p: float) -> Any:
    F = CF((1, IfPos(x - 0.5, 0.3, 0.0), 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    return _simulation(nv, mesh, SOLID, p, initial=nv.Initial(values={"F": F}))


def _rough(nv: Any, mesh: Mesh, p: float) -> Any:
    """A body whose velocity jumps by 2 m/s, and whose density by a half, along lines."""
    inside = IfPos(x - 0.1, 1.0, 0.0) * IfPos(0.9 - x, 1.0, 0.0)
    velocity = CF((inside * IfPos(y - 0.5, 1.0, -1.0), 0.0))
    initial = nv.Initial(density=1 + 0.5 * IfPos(x - 0.5, 1.0, 0.0), velocity=velocity)
    return _simulation(nv, mesh, SOLID, p, initial=initial)


def _shear_wave(nv: Any, mesh: Mesh) -> Any:
    """A standing wave of 10 % strain."""
    initial = nv.Initial(velocity=CF((0.0, 0.1 * float(np.sqrt(5)) * cos(2 * pi * x), 0.0)))
    return _simulation(nv, mesh, SOLID, None, dt=0.01, scheme="midpoint", initial=initial)


def _impact(nv: Any, mesh: Mesh, scheme: str) -> Any:
    """Two halves of a bar that meet at a fifth of the speed of sound; c dt/h = 0.8."""
    speed = 0.2 * float(np.sqrt(50 / 3))
    material = nv.NeoHookean(**SOLID, elastic_state="F")
    nu = speed * 0.01
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=nu / 3, G_v=nu / 2))
    initial = nv.Initial(velocity=CF((IfPos(x - 0.5, -speed, speed), 0.0)))
    return nv.Simulation(mesh, model, dt=0.002, scheme=scheme, initial=initial)


def _recoil(nv: Any, mesh: Mesh, scheme: str) -> Any:
    """The swirl of demos/swirl."""
    swirl = CF((sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y)))
    gravity = (nv.Gravity((0.0, -1.0)),)
    return _simulation(nv, mesh, SOLID, 4.0, scheme=scheme, loads=gravity, initial=nv.Initial(velocity=swirl))


def _box(maxh: float) -> Mesh:
    from ngvisco.geometries import box

    return box((1, 1), maxh)


def _structured(size: Sequence[float], cells: Sequence[int], periodic: str = "") -> Mesh:
    from ngvisco.geometries import structured_box

    return structured_box(tuple(size), tuple(cells), periodic=periodic)


_COARSE, _CUBE = partial(_box, 0.1), partial(_structured, (1, 1, 1), (8, 8, 8))
Run = tuple[Callable[..., Any], Callable[[], Mesh], int]
RUNS: dict[str, Run] = {
    **{
        f"impulsive cavity, p = {p:g}{name}": (partial(_cavity, p=p), mesh, steps)
        for p in (4.0, 2.0)
        for name, mesh, steps in (
            ("", _COARSE, 20),
            (", cells of 0.05 m", partial(_box, 0.05), 2),
            (", cells of 0.025 m", partial(_box, 0.025), 2),
            (", a cube", _CUBE, 2),
        )
    },
    "cavity with stiff creep": (partial(_cavity, p=4.0, creep=1e-4), _COARSE, 20),
    "released load, p = 4": (partial(_released, p=4.0), _COARSE, 20),
    "released load, p = 2": (partial(_released, p=2.0), _COARSE, 20),
    "rough data, p = 4": (partial(_rough, p=4.0), _COARSE, 5),
    "rough data, p = 2": (partial(_rough, p=2.0), _COARSE, 5),
    "shear wave of 10 % strain": (_shear_wave, partial(_structured, (1, 1, 1), (4, 4, 4), "xyz"), 50),
    "impact at 0.2 c": (
        partial(_impact, scheme="backward-euler"),
        partial(_structured, (1, 0.02), (100, 2), "xy"),
        50,
    ),
    "recoil, backward Euler": (partial(_recoil, scheme="backward-euler"), partial(_box, 0.12), 20),
    "recoil, midpoint": (partial(_recoil, scheme="midpoint"), partial(_box, 0.12), 20),
}


def take_steps(name: str, mesh_file: str) -> None:
    """Print the costs of each step of the run, as a line of JSON."""
    import ngvisco as nv

    make, _, steps = RUNS[name]
    run = make(nv, Mesh(mesh_file))
    for number in range(1, steps + 1):
        rows, began = max(len(run.ledger.rows), 1), time.process_time()
        try:
            run.run(number * run.dt)
        except nv.StepError:
            break
        of_step = run.ledger.rows[rows:]
        found = {
            "seconds": time.process_time() - began,
            "iterations": int(sum(row["newton_iterations"] for row in of_step)),
            "parts": len(of_step) > 1,
            "retried": getattr(run.solver, "retried", 0),
            "limited": int(sum(row.get("limited_cells", 0) for row in of_step)),
        }
        print(json.dumps(found), flush=True)


def measured(name: str, checkout: Path, seconds: int) -> list[str]:
    """The row of a run with a checkout's code, without the run's name."""
    _, mesh_of, steps = RUNS[name]
    mesh = mesh_of()
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "mesh.vol")
        mesh.ngmesh.Save(file)
        ended = subprocess.run(
            [sys.executable, str(HERE), "--one", name, file],
            cwd=checkout,
            # NGSolve's further threads wait actively, and processor time counts this waiting
            env={**os.environ, "PYTHONPATH": str(checkout), "NGS_NUM_THREADS": "1", "NGVISCO_THREADS": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            check=False,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds)),
        )
    of_steps = [json.loads(line) for line in ended.stdout.splitlines() if line.startswith("{")]
    taken = str(len(of_steps))
    if len(of_steps) < steps:
        # the system ends a process that uses up its time by a signal
        why = f"more than {seconds} s" if ended.returncode < 0 else "fails"
        taken += f", then {why}"
    if not of_steps:
        return [str(mesh.ne), taken, *("–",) * 7]
    iterations, cost = ([one[key] for one in of_steps] for key in ("iterations", "seconds"))
    numbers = [iterations[0], f"{np.median(iterations):g}", max(iterations)]
    numbers += [sum(one["parts"] for one in of_steps), of_steps[-1]["retried"]]
    numbers += [sum(one["limited"] for one in of_steps), f"{max(cost) / float(np.median(cost)):.1f}"]
    return [str(mesh.ne), taken, *map(str, numbers)]


def main(arguments: Sequence[str]) -> None:
    """Print the table, each row when it is complete."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.hard_starts")
    parser.add_argument("names", nargs="*", metavar="NAME", help="beginnings of runs' names; default: all")
    parser.add_argument("--before", type=Path, metavar="CHECKOUT", help="a clone to be measured first")
    parser.add_argument("--seconds", type=int, default=60, help="of processor time that a run may take")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.one:
        return take_steps(*chosen.one)
    names = [name for name in RUNS if not chosen.names or name.startswith(tuple(chosen.names))]
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    for name in names:
        row = measured(name, HERE.parents[2], chosen.seconds)
        if chosen.before is not None:
            before = measured(name, chosen.before.resolve(), chosen.seconds)
            row = [old if old == new else f"{old} → {new}" for old, new in zip(before, row, strict=True)]
        print("| " + " | ".join([name, *row]) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
