"""``python -m tests.verification``: run verification cases and write one report.

Exit codes: 0 every case holds; 1 a case does not hold, or ended in an error; 2 the input is wrong; 3 a file
could not be read or written; 130 interrupted: results so far are kept, go on with ``--resume``.

examples:
  python -m tests.verification -o report/
  python -m tests.verification --reduced -o report/
  python -m tests.verification limit-tau dispersion -o limits/
  python -m tests.verification -o report/ --resume --jobs 2
  python -m tests.verification limit-tau -o limits/ --into tests/verification/kept
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

DONE, FAILED, BAD_INPUT, BAD_FILE, INTERRUPTED = 0, 1, 2, 3, 130


def parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    top = argparse.ArgumentParser(
        prog="python -m tests.verification",
        description="Measures what the paper proves and known exact solutions; writes one report.",
        epilog=(__doc__ or "").partition("\n\n")[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("names", nargs="*", metavar="NAME", help="cases, or beginnings of names (default: all)")
    top.add_argument("-o", "--output", metavar="DIR", default="report", help="default: report")
    top.add_argument("--list", action="store_true", help="name the cases and what they claim, run nothing")
    top.add_argument("--reduced", action="store_true", help="only the reduced set, of a few minutes")
    top.add_argument("--resume", action="store_true", help="go on with the report in DIR")
    at_once: dict[str, Any] = {"type": int, "choices": range(1, 65), "default": 1, "metavar": "N"}
    top.add_argument("--jobs", **at_once, help="so many cases at once (default: 1)")
    top.add_argument("--into", metavar="DIR", help="then put these cases into the kept report in DIR")
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    options = parser().parse_args(arguments)
    from ngvisco import __version__
    from ngvisco.errors import UnknownNameError
    from tests.verification import cases as package
    from tests.verification.bounds import VerificationError
    from tests.verification.report import headline, put_into, write_report
    from tests.verification.runner import ReportDirectory, run_cases

    try:
        cases = package.select(package.all_cases(), options.names, options.reduced)
        if not cases:
            return _say("none of these cases is in the reduced set", BAD_INPUT)
        if options.list:
            for case in cases:
                print(f"{case.name}\n    {case.statement}")
            return DONE
        directory = ReportDirectory(Path(options.output), cases, resume=options.resume)
        results = run_cases(cases, __version__, directory, jobs=options.jobs)
        path = write_report(directory.path, cases, results, __version__)
        if options.into:
            path = put_into(Path(options.into), directory.path, package.all_cases())
    except (UnknownNameError, VerificationError) as error:
        return _say(str(error), BAD_INPUT)
    except OSError as error:
        return _say(f"{error.filename or ''}: {error.strerror or error}", BAD_FILE)
    except KeyboardInterrupt:
        return _say(f"interrupted; go on with: -o {options.output} --resume", INTERRUPTED)
    print(f"{headline(results)}\n{path}")
    return DONE if all(result.status == "holds" for result in results) else FAILED


def _say(message: str, code: int) -> int:
    print(f"verification: {message}", file=sys.stderr, flush=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
