"""What may be chosen of the solver, and a line of its history."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from ngvisco.errors import ParameterError, require_choice, require_count, require_positive

METHODS = ("auto", "coupled", "split")
INVERSES = ("umfpack", "pardiso", "mumps")
_ROUNDING = 1e-14


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Tolerances of the iteration, in the norm of ``ngvisco.solver.norm``.

    Parameters
    ----------
    tolerance : float
        The iteration ends when an increment is below it; that increment is still added.
    max_iterations : int
        Residual evaluations a Rothe step may take, over which the typed error is raised.
    refresh : float
        Contraction above which the Jacobian is assembled anew, in (0, 1).
    min_damping : float
        Smallest step length tried.
    inverse : str
        NGSolve's name of a sparse direct solver for nonsymmetric matrices: ``"umfpack"``, and ``"pardiso"``
        (``pip install mkl``) or ``"mumps"`` where the installation has them.
    method : str
        ``"coupled"``: all unknowns at once; ``"split"``: one problem for the velocity, with the fields as
        functions of it, whose cost grows like the mesh; ``"auto"`` (default): the faster one for the
        mesh's dimension and size.  Both solve the same equations.
    """

    tolerance: float = 1e-10
    max_iterations: int = 60
    refresh: float = 0.25
    min_damping: float = 1e-3
    inverse: str = "umfpack"
    method: str = "auto"

    def __post_init__(self) -> None:
        require_positive(
            self,
            tolerance=self.tolerance,
            refresh=self.refresh,
            min_damping=self.min_damping,
        )
        require_count(self, max_iterations=self.max_iterations)
        if self.tolerance < _ROUNDING:
            raise ParameterError(
                "NewtonOptions.tolerance", self.tolerance, f"at least {_ROUNDING:g}, which rounding leaves"
            )
        for name in ("tolerance", "refresh", "min_damping"):
            if getattr(self, name) >= 1:
                raise ParameterError(f"NewtonOptions.{name}", getattr(self, name), "a number in (0, 1)")
        # sparsecholesky returns nonsense for nonsymmetric matrices, silently
        require_choice(self, INVERSES, inverse=self.inverse)
        if not is_available(self.inverse):
            have = ", ".join(filter(is_available, INVERSES))
            expected = f"{have}: this installation of NGSolve has no other one ready"
            raise ParameterError("NewtonOptions.inverse", self.inverse, expected)
        require_choice(self, METHODS, method=self.method)


@cache
def is_available(inverse: str) -> bool:
    """Whether NGSolve, as it is installed, has this sparse direct solver: found by asking it for one."""
    if inverse == "umfpack":
        return True
    from ngsolve.la import SparseMatrixd

    try:
        SparseMatrixd.CreateFromCOO([0, 1], [0, 1], [1.0, 1.0], 2, 2).Inverse(inverse=inverse)
    except Exception:  # NGSolve raises NgException and RuntimeError
        return False
    return True


@dataclass(frozen=True)
class NewtonIteration:
    """One line of a solver's history: increment and contraction in the norm of ``ngvisco.solver.norm``."""

    increment: float
    contraction: float
    damping: float
    fresh_jacobian: bool
