"""What may be chosen of the solver, and a line of its history."""

from __future__ import annotations

from dataclasses import dataclass

from ngvisco.errors import ParameterError, require_choice, require_positive

METHODS = ("auto", "coupled", "split")


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
        NGSolve's name of a sparse direct solver for nonsymmetric matrices.
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
        if not isinstance(self.max_iterations, int) or self.max_iterations < 1:
            raise ParameterError("NewtonOptions.max_iterations", self.max_iterations, "an integer >= 1")
        for name, value in (("refresh", self.refresh), ("min_damping", self.min_damping)):
            if value >= 1:
                raise ParameterError(f"NewtonOptions.{name}", value, "a number in (0, 1)")
        # sparsecholesky returns nonsense for nonsymmetric matrices, silently
        require_choice(self, ("umfpack", "pardiso", "mumps"), inverse=self.inverse)
        require_choice(self, METHODS, method=self.method)


@dataclass(frozen=True)
class NewtonIteration:
    """One line of a solver's history: increment and contraction in the norm of ``ngvisco.solver.norm``."""

    increment: float
    contraction: float
    damping: float
    fresh_jacobian: bool
