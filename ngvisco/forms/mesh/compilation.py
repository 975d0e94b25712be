"""Integrands as straight-line programs, interpreted by NGSolve or, where asked, compiled to machine code.

Machine code takes minutes to be made (about 15 s for each of some 40 integrands) and a C++ compiler.
NGSolve's compiler script takes ccache where that is at /usr/bin: a second process that needed the same
integrands was ready after 135 s instead of 455 s (230 triangles, coupled; half of the compiler's calls were
hits).
"""

import os
import shutil
import sys
from pathlib import Path

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError

VARIABLE = "NGVISCO_COMPILE"
"""Environment variable: "1" asks for machine code."""

SCRIPT = "ngscxx"
"""NGSolve's compiler script, beside the interpreter where pip has put it."""


def compiled(integrand: CoefficientFunction) -> CoefficientFunction:
    """The integrand as a program.

    Raises ParameterError when machine code is asked for by something else than "0" or "1", or without a
    compiler.
    """
    if not _wanted():
        return integrand.Compile()
    return integrand.Compile(realcompile=True, wait=True)


def _wanted() -> bool:
    value = os.environ.get(VARIABLE, "0")
    if value not in ("", "0", "1"):
        raise ParameterError(VARIABLE, value, '"1" for machine code, "0" for none')
    if value != "1":
        return False
    beside = str(Path(sys.executable).parent)
    if shutil.which(SCRIPT) is None and shutil.which(SCRIPT, path=beside) is not None:
        os.environ["PATH"] = os.pathsep.join([beside, os.environ.get("PATH", "")])
    if shutil.which(SCRIPT) is None or shutil.which("c++") is None:
        raise ParameterError(VARIABLE, value, f"{SCRIPT} (of NGSolve) and c++ on the path")
    return True
