"""The arguments and messages of the command ``ngvisco``.

A fault that a user can cause gives a message and an exit code of ``ngvisco.cli.streams``, never a traceback.
"""

import argparse
import os
import re
import sys
import time as clock
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import Any

from ngvisco import interrupts
from ngvisco.cli import streams
from ngvisco.cli.streams import BAD_FILE, BAD_INPUT, FAILED, INTERRUPTED
from ngvisco.words import Words, words_of

_EPILOG = """exit codes: 0 done; 1 a step could not be solved; 2 wrong input; 3 a file could not be read
or written; 4 the energy ledger does not close; 130 or 143 stopped by a signal (a checkpoint was written:
resume).

examples:
  ngvisco new swirl > case.toml
  ngvisco explain material.G_e
  ngvisco check demos/swirl/swirl.toml
  ngvisco run demos/swirl/swirl.toml -o results/swirl --set time.until=0.5 --set domain.maxh=0.2
  ngvisco resume results/swirl --until 1.0
  ngvisco resume results/swirl --set time.dt=0.01 --set 'loads=[]'
  ngvisco run finer.toml -o results/finer --from results/swirl
  ngvisco sweep demos/swirl/swirl.toml --vary material.G_e=1,2,5 --vary time.dt=0.02,0.01
  ngvisco gradient demos/swirl/swirl.toml --of "kinetic at 1" --by material.G_e,material.K_e
  ngvisco plot results/swirl && ngvisco scene results/swirl
  ngvisco plot results/swirl results/finer   # or the directory of a sweep: compared in one picture each"""

_RESUME = """Go on from a directory's last checkpoint, bit for bit.  --set changes parameters: of title, time,
loads, walls, solver and output, and the numbers of the material and the mechanisms.  For another mesh, other
orders or unknowns see ngvisco run CASE -o NEW --from DIR."""

_SWEEP = """Run a case for all combinations of the values of some keys: one run directory each in DIR, and the
table DIR/sweep.csv.  All cases are checked before anything is written.  The same command goes on where it was
stopped: finished runs are not run again.  Needs dask.distributed: pip install "ngvisco[sweep]"."""

_FIT = """Find numbers of a case from measured data, by bounded least squares with exact derivatives.  The
columns of DATA are those of the case's ledger, probes, forces, integrals and bodies, e.g. "kinetic [mJ]",
"tip.velocity_1 [mm/s]", "integral of tip.velocity_1 [mm]" (a displacement), over "time [s]".  The results are
a report, a table with the covariance, and a picture of data, fit and residuals."""

_FEW_THREADS = 8
"""Number of threads allowed on any machine.  There is a limit because NGSolve's threads wait actively: a run
with hundreds of them never ends."""


def parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    from ngvisco import __version__

    top = argparse.ArgumentParser(
        prog="ngvisco",
        description="Compressible viscoelastic bodies at large strains: runs described by case files.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"ngvisco {__version__}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    a_case, settings, running = (argparse.ArgumentParser(add_help=False) for _ in range(3))
    a_case.add_argument("case", metavar="CASE", help="case file, TOML")
    text = "override a key of the case, e.g. --set material.G_e=8 (repeatable)"
    settings.add_argument(
        "--set", dest="settings", metavar="KEY=VALUE", action="append", default=[], help=text
    )
    text = "threads of assembly; with 1 (default) a resumed run is the uninterrupted one bit for bit"
    running.add_argument("--threads", type=_threads, default=1, metavar="N", help=text)
    running.add_argument("--quiet", action="store_true", help="no progress on the terminal (log.txt has it)")
    # a study starts its runs with this option, so that no run outlives the study
    running.add_argument("--ends-with-stdin", action="store_true", help=argparse.SUPPRESS)

    run = commands.add_parser(
        "run", help="run a case into a new directory", parents=[a_case, settings, running]
    )
    text = "run directory (default results/<name of the case>)"
    run.add_argument("-o", "--output", type=_directory, metavar="DIR", help=text)
    run.add_argument("--force", action="store_true", help="replace the results of an earlier run in DIR")
    text = "start from the last state of the run directory OLD, also on another mesh or in other spaces"
    run.add_argument("--from", dest="source", metavar="OLD", help=text)

    text = "go on from a directory's last checkpoint"
    resume = commands.add_parser("resume", help=text, description=_RESUME, parents=[settings, running])
    resume.add_argument("directory", metavar="DIR", help="run directory")
    text = "end time in s, or with a unit, as in '140 kyr' (default: the case's)"
    resume.add_argument("--until", metavar="T", help=text)

    text = "run a case with some of its keys varied"
    sweep = commands.add_parser("sweep", help=text, description=_SWEEP, parents=[a_case, settings, running])
    text = "values of a key, e.g. --vary material.G_e=1,2,5 (repeatable: all combinations are run)"
    sweep.add_argument("--vary", metavar="KEY=V1,V2,...", action="append", default=[], help=text)
    text = "directory of the sweep (default results/<name of the case>-sweep)"
    sweep.add_argument("-o", "--output", type=_directory, metavar="DIR", help=text)
    sweep.add_argument("--force", action="store_true", help="run all runs of the sweep anew")
    text = "number of runs at once on this machine (default: its processors over a run's threads)"
    sweep.add_argument("--workers", type=_threads, metavar="N", help=text)
    text = "dask scheduler whose workers do the runs, e.g. tcp://host:8786; they must see the same files"
    sweep.add_argument("--scheduler", metavar="ADDRESS", help=text)

    _add_sensitivities(commands, [a_case, settings, running])

    text = "validate and mesh a case; report sizes, scales and advice, memory and time; writes nothing"
    commands.add_parser("check", help=text, parents=[a_case, settings])
    text = "what a run directory holds, and how far the run got"
    info = commands.add_parser("info", help=text, description=text)
    info.add_argument("directory", metavar="DIR", help="run directory", nargs="?")
    text = "MPI, PETSc and its packages, which distributed runs need, and a test of them"
    info.add_argument("--parallel", action="store_true", help=text)

    drawn = argparse.ArgumentParser(add_help=False)
    drawn.add_argument("--fields", type=_names, metavar="NAMES", help="fields to draw, separated by commas")
    drawn.add_argument("--step", type=int, metavar="N", help="checkpoint's step (default: the last)")
    text = "energies, dissipations, closure, extrema, iterations and fields as pictures; animations"
    plot = commands.add_parser("plot", help=text, description=text, parents=[drawn])
    text = "run directory; several directories, or the directory of a sweep, are compared"
    plot.add_argument("directory", metavar="DIR", help=text, nargs="+")
    text = "format of the pictures (default png)"
    plot.add_argument("--format", choices=("png", "pdf", "svg"), default="png", help=text)
    text = "directory for the pictures (default: the run's or the sweep's; . for several runs)"
    plot.add_argument("-o", "--output", type=_directory, metavar="DIR", help=text)
    text = "cutting plane in 3D: z=0.5, or x for the plane in the middle, normal to x (default z)"
    plot.add_argument("--section", metavar="PLANE", help=text)
    text = "animate the VTK series instead, as .gif or .mp4 (needs ffmpeg; default DIR/movie.gif)"
    plot.add_argument("--movie", metavar="FILE", nargs="?", const="", help=text)
    text = "frames a second of the animation (--movie; default 10)"
    plot.add_argument("--fps", type=float, metavar="N", help=text)
    text = "the states of the VTK series as one HTML file that opens offline, with time and cuts"
    scene = commands.add_parser("scene", help=text, description=text, parents=[drawn])
    scene.add_argument("directory", metavar="DIR", help="run directory")

    text = "materials, mechanisms, loads, walls, geometries and outputs of case files"
    forms = commands.add_parser("list", help=text).add_mutually_exclusive_group()
    for option, text in (
        ("keys", "every key with its type, unit, default and meaning"),
        ("markdown", "every key as a Markdown page with examples"),
        ("schema", "the JSON Schema of case files, with which editors complete and check them"),
    ):
        forms.add_argument(f"--{option}", dest="form", action="store_const", const=option, help=text)
    explain = commands.add_parser("explain", help="what a key of a case file means, e.g. time.dt")
    explain.add_argument("key", metavar="KEY", help="a key, a table or a kind: time.dt, material, NeoHookean")
    new = commands.add_parser("new", help="print an annotated case file to start from")
    new.add_argument("name", metavar="NAME", nargs="?", help="a demo, e.g. swirl; default: list the demos")
    return top


def _add_sensitivities(commands: Any, parents: list[argparse.ArgumentParser]) -> None:
    """Add the commands ``gradient`` and ``fit``."""
    text = "derivatives of a case's results by numbers of the case, exact for the time scheme"
    gradient = commands.add_parser("gradient", help=text, description=text, parents=parents)
    text = 'a number, e.g. --of "kinetic at 0.5" or "PROBE.velocity_1 until 0.5", its integral (repeatable)'
    gradient.add_argument("--of", metavar="TEXT", action="append", required=True, help=text)
    text = "tangent (default), whose cost grows with the number of keys, or adjoint, with the number of --of"
    gradient.add_argument("--method", choices=("tangent", "adjoint"), default="tangent", help=text)
    text = "find numbers of a case from measured data, by bounded least squares"
    fit = commands.add_parser("fit", help=text, description=_FIT, parents=parents)
    text = "CSV file: time and columns as of the case's tables or ledger, with units in brackets"
    fit.add_argument("data", metavar="DATA", help=text)
    text = "standard deviation of the data, or COLUMN=NUMBER,...; else it is estimated"
    fit.add_argument("--sigma", metavar="NUMBER", help=text)
    text = "bounds of a key (default: 1/1000 and 1000 times its start value; repeatable)"
    fit.add_argument("--bounds", metavar="KEY=LOW,HIGH", action="append", default=[], help=text)
    fit.add_argument("--format", choices=("png", "pdf", "svg"), default="png", help="format of the picture")
    for subcommand, kind in ((gradient, "gradient"), (fit, "fit")):
        text = "keys of the case, e.g. material.G_e,rheology.creep.G_m"
        subcommand.add_argument("--by", type=_names, metavar="KEYS", required=True, help=text)
        text = f"directory of the results (default results/<name of the case>-{kind})"
        subcommand.add_argument("-o", "--output", type=_directory, metavar="DIR", help=text)
        subcommand.add_argument("--force", action="store_true", help="replace earlier results")


def _threads(text: str) -> int:
    try:
        value = int(text)
    except ValueError:  # Python also refuses thousands of digits
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: expected a whole number >= 1")
    if value > (most := max(os.cpu_count() or 1, _FEW_THREADS)):
        raise argparse.ArgumentTypeError(
            f"{text}: expected at most {most}, the larger of {_FEW_THREADS} and the number of processors of "
            f"this machine, {os.cpu_count()}"
        )
    return value


def _directory(text: str) -> str:
    if not text or (os.path.exists(text) and not os.path.isdir(text)):
        what = "this is a file" if text else "the name is empty"
        message = f"{text!r}: {what}; expected a directory (a missing directory is created)"
        raise argparse.ArgumentTypeError(message)
    return text


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    # the sparse solver is slow with more BLAS threads than processors; rounding depends on the number of
    # threads
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    options = parser().parse_args(arguments)
    # processor time of the imports: a process started for this command has only imported NGSolve and this
    # package; the process of a Python caller has done other work too
    options.imports = clock.process_time() if arguments is None else 0.0
    streams.make_safe()
    with warnings.catch_warnings():
        warnings.showwarning = _notices()
        return _on_ranks(options)


_DISTRIBUTED = ("run", "resume")
"""Commands that mpirun may start on several processes, beside ``info --parallel``."""


def _on_ranks(options: argparse.Namespace) -> int:
    """Run the command on all processes of mpirun; only the first one prints, and all return the same exit
    code."""
    from ngvisco.parallel.communicator import Communicator, MPIError

    try:
        ranks = Communicator.world()
    except MPIError as error:
        return _say(str(error), BAD_INPUT)
    if not ranks.is_distributed:
        return _ended(options)
    if not ranks.is_first:
        streams.be_silent()
    if options.command not in _DISTRIBUTED and not getattr(options, "parallel", False):
        code = _say(
            f"ngvisco {options.command} runs in one process; start the command without mpirun", BAD_INPUT
        )
    else:
        try:
            code = _ended(options)
        except Exception as error:  # a fault of the program: a report needs the traceback
            traceback.print_exception(error)
            code = FAILED
    sys.stdout.flush()
    return ranks.settled(code)


def _ended(options: argparse.Namespace) -> int:
    """Run the chosen command; turn an exception into a message and an exit code."""
    interrupts.end()
    try:
        code = _command(options.command)(options)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return _say(
            "the command was interrupted before a step was finished; written files are kept", INTERRUPTED
        )
    except BrokenPipeError:  # no process reads the output any more
        streams.give_up(sys.stdout)
        return BAD_FILE
    except MemoryError:
        return _say(
            "there is not enough memory; take a coarser mesh (ngvisco check measures the memory)", FAILED
        )
    except OSError as error:
        streams.give_up(sys.stdout)  # unwritten output would fail again when Python ends
        where = f"{error.filename}: " if error.filename else ""
        return _say(f"{where}{error.strerror or error}", BAD_FILE)
    except Exception as error:
        from ngvisco.case.faults import in_case
        from ngvisco.errors import CheckpointError, MeshError, NgviscoError, StepError

        if not isinstance(error, NgviscoError):
            raise  # a fault of the program: a report needs the traceback
        code = BAD_FILE if isinstance(error, (CheckpointError, MeshError)) else BAD_INPUT
        message = "\n".join([in_case(_in_options(error, options)), *getattr(error, "__notes__", [])])
        return _say(message, FAILED if isinstance(error, StepError) else code)


_OPTIONS = {"frames_per_second": "fps", "path": "movie"}
"""Options whose names differ from the names of their parameters."""
_SPELLED = {"source": "from"}
"""Spelling of options whose names are reserved words of Python."""


def _in_options(error: Any, options: argparse.Namespace) -> object:
    """The message of an error about a parameter, beginning with the command-line option and the value that
    the user gave; the error itself if no option gave the parameter."""
    match = re.match(r"(?:fit\.|write_movie\.)?([a-z_]+)\b", error.key)
    name = "" if match is None else _OPTIONS.get(match[1], match[1])
    given = getattr(options, name, None)
    if given in (None, []):
        return error
    members = given if isinstance(given, list) else [given]
    value = getattr(error, "value", None)
    text = ", ".join(map(repr, [value] if value in members else members))
    message = ("expected ", error.expected) if hasattr(error, "expected") else (words_of(error),)
    return Words(f"--{_SPELLED.get(name, name)} = {text}: ", *message)


def _command(name: str) -> Callable[[argparse.Namespace], int]:
    # a late import: NGSolve takes a second, and --help does not need it
    from ngvisco.cli import parallel, pictures, report, run, sensitivity

    table: dict[str, Callable[[argparse.Namespace], int]] = {
        **{"run": run.run, "resume": run.resume, "sweep": run.sweep},
        **{"gradient": sensitivity.gradient, "fit": sensitivity.fit},
        **{"plot": pictures.plot, "scene": pictures.scene},
        **{"list": report.listing, "explain": report.explain, "new": report.new, "check": report.check},
        "info": lambda options: (parallel.info if options.parallel else report.info)(options),
    }
    return table[name]


def _notices() -> Callable[..., None]:
    """Print warnings as messages of the command: the line of code does not help a user of case files."""
    from ngvisco.notices import Notices

    def say(message: object, *where: object, **options: object) -> None:
        from ngvisco.case.faults import in_case  # a late import, as for the commands

        streams.complain(f"warning: {in_case(message)}")

    return Notices(say, say)


def _say(message: str, code: int) -> int:
    streams.complain(message)
    return code
