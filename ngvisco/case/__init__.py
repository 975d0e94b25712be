"""Case files: descriptions of runs in TOML, validated completely before anything is computed."""

from ngvisco.case.build import Case, load_case
from ngvisco.case.directory import RunDirectory, RunDirectoryError
from ngvisco.case.faults import CaseError, Fault
from ngvisco.case.runs import Results, load, resume, run

__all__ = ["Case", "CaseError", "Fault", "Results", "RunDirectory", "RunDirectoryError", "load", "load_case"]
__all__ += ["resume", "run"]
