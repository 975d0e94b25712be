"""Options of the solvers.  Constants that no run changes are defined in the modules that use them.

An option that is a pair has one value for 2D and one for 3D.  ``ngvisco/solver/NOTES.md`` has the
measurements behind the defaults.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Literal, TypeAlias, get_args

from ngsolve.la import SparseMatrixd

from ngvisco.errors import ParameterError, Quantity, require_effect, require_fields
from ngvisco.parallel.petsc import obstacle

Method: TypeAlias = Literal["auto", "coupled", "split"]
Inverse: TypeAlias = Literal["umfpack", "pardiso", "mumps"]
_ROUNDING = 1e-14

Positive = Annotated[float, Quantity("1", "> 0")]
Count = Annotated[int, Quantity("1", ">= 1")]
Pair = Annotated[tuple[int, int], Quantity("1", ">= 0")]
Share = Annotated[float, Quantity("1", "in (0, 1)")]


@dataclass(frozen=True, kw_only=True)
class SplitOptions:
    """Options of the split solver: its choice, its iteration and its linear systems."""

    chosen_from: Pair = (60, 10)
    """Number of cells above which ``method = "auto"`` takes the split solver, because it is then the faster
    one (tests/benchmarks)."""
    margin: Positive = 0.1
    """Largest estimated error after the last increment has been added, in tolerances.

    The error is estimated by the contraction. The last increment, too, has to be below one tolerance.
    """
    slow: Count = 24
    """Number of iterations after which Newton-Krylov takes over."""
    growth: Positive = 4.0
    """Largest ratio of an increment to the smallest increment so far. An iterate whose increment is longer is
    given up, and the next iterate is half as far from the best iterate."""
    halvings: Count = 5
    """Number of iterates that one attempt may give up."""
    renewed_after: Count = 30
    """Cost of a new operator and preconditioner, in GMRES iterations for the flow.

    Operator and preconditioner are renewed when the old ones have cost this number of further iterations, or
    will cost it by the contractions so far. A renewal takes as long as 30 to 65 iterations.
    """
    renewed_above: Positive = 0.05
    """Increment above which operator and preconditioner are renewed. After a smaller increment only the
    hyperviscosity is linearised again, because it changes suddenly."""
    stale_above: Positive = 0.2
    """Ratio of an increment to the increment before it, above which operator and preconditioner are renewed.
    With a steep flow rule such a ratio renews the operator only; both are then renewed above ten times
    ``renewed_above``."""
    bends_above: Positive = 0.03
    """Relative increment of a creep rate field above which operator and preconditioner are renewed, unless
    the preceding increment was more than three times as large."""
    rounding: Positive = 1e-8
    """Increment below which Newton-Krylov does not stop for slow progress, because rounding may be the
    cause."""
    flow_iterations: Count = 30
    """Largest number of GMRES iterations for the flow's linear system."""
    direct_up_to: Pair = (3_000, 3_000)
    """Number of unknowns of v up to which the whole velocity tangent is factorised. With more unknowns two
    levels are faster.  For several bodies in 2D the limit is ``direct_at_most``."""
    direct_at_most: Pair = (100_000, 15_000)
    """Largest number of unknowns of v with which the whole tangent is factorised for the rest of a step, if
    ``flow_iterations`` with two levels do not solve the flow's system."""
    krylov_below: Positive = 0.05
    """Largest increment at which Newton-Krylov takes over.  An attempt with larger increments continues until
    it fails; then the time loop halves the step."""
    penalty_degree: Count = 4
    """Degree of the quadrature rule for the derivative of the hyperviscosity's penalty, for k = 2 on straight
    cells; for p = 4 the rule is exact, as jumps are in P_1.  For k = 3 and on curved cells the forms' rule is
    used."""

    def __post_init__(self) -> None:
        require_fields(self)


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Tolerances of the iteration, in the norm of ``ngvisco.solver.problem``, and the choice of solvers.

    Parameters
    ----------
    tolerance : float
        The iteration ends when a relative increment is below ``tolerance``, after this increment has been
        added.
    max_iterations : int
        Number of residual evaluations after which an attempt to solve a step has failed.
    refresh : float
        Contraction above which the Jacobian is renewed.
    min_damping : float
        Smallest damping of a Newton step that is tried.
    inverse : str
        Sparse direct solver of the coupled solver: "umfpack", or, if the installation has it, "pardiso"
        (``pip install mkl``) or "mumps".
    coarse : str
        Solver for the vertices' velocities in the two-level preconditioner of the split solver.  "direct"
        factorises the matrix of the vertices; "gamg" and "hypre" are PETSc's multigrids for more vertices
        than can be factorised.  A warning says if a run does not use the multigrid.
    method : str
        "coupled" solves for all unknowns at once (small meshes), "split" for the velocity, with the fields
        as functions of the velocity (large meshes).  "auto" chooses "coupled" or "split" by the mesh, and
        tries the other solver if a step is not solved.  The two solvers solve the same equations.
    threads : int or None
        Number of threads that share the cells in the split solver.  The default is the environment's
        NGVISCO_THREADS, or all processors, divided equally among the ranks.  The bits of a state do not
        depend on the number of threads.

    Raises
    ------
    ParameterError
        If a parameter is out of its range.
    """

    tolerance: Share = 1e-10
    max_iterations: Count = 60
    refresh: Share = 0.25
    min_damping: Share = 1e-3
    inverse: Inverse = "umfpack"
    coarse: Literal["direct", "gamg", "hypre"] = "direct"
    method: Method = "auto"
    threads: Annotated[int | None, Quantity("1", ">= 1")] = None
    split: SplitOptions = SplitOptions()

    def __post_init__(self) -> None:
        require_fields(self)
        if self.tolerance < _ROUNDING:
            expected = f"at least {_ROUNDING:g}, the size of rounding"
            raise ParameterError("NewtonOptions.tolerance", self.tolerance, expected)
        # sparsecholesky silently returns nonsense for nonsymmetric matrices
        if not is_available(self.inverse):
            have = " or ".join(filter(is_available, get_args(Inverse)))
            expected = f"{have}, since this installation of NGSolve has no other inverse"
            raise ParameterError("NewtonOptions.inverse", self.inverse, expected)
        is_split, where = self.method == "split", "with the method 'split'"
        require_effect(self, not is_split, where, "refresh", "min_damping", "inverse")
        require_effect(self, self.method != "coupled", "with the method 'coupled'", "split", "threads")
        if self.coarse != "direct":
            if self.method == "coupled":
                expected = (
                    "'direct' with the method 'coupled', since this method factorises one system of all "
                    "unknowns"
                )
                raise ParameterError("NewtonOptions.coarse", self.coarse, expected)
            if (missing := obstacle(self.coarse)) is not None:
                raise ParameterError("NewtonOptions.coarse", self.coarse, f"'direct', since {missing}")


@cache
def is_available(inverse: str) -> bool:
    """Whether the installed NGSolve has this sparse direct solver, found by trying it."""
    if inverse == "umfpack":
        return True
    try:
        SparseMatrixd.CreateFromCOO([0, 1], [0, 1], [1.0, 1.0], 2, 2).Inverse(inverse=inverse)
    except Exception:  # NGSolve raises NgException and RuntimeError
        return False
    return True
