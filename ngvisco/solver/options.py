"""Options of the solvers; numbers that no run chooses stand where they act.

Pairs are values in 2D and in 3D.  Measurements behind the defaults are in ``ngvisco/solver/NOTES.md``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Literal, TypeAlias, get_args

from ngsolve.la import SparseMatrixd

from ngvisco.errors import (
    ParameterError,
    Quantity,
    require_effect,
    require_fields,
)
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
    """The split solver's choice, iteration and linear systems."""

    chosen_from: Pair = (60, 10)
    """Cells from which ``method = "auto"`` takes it: from there it is the faster one (tests/benchmarks)."""
    margin: Positive = 0.1
    """The error that may be left, in tolerances, when the last increment, which is below one, has been added:
    by the contraction of the last iterations."""
    slow: Count = 24
    """Iterations after which Newton-Krylov takes over."""
    growth: Positive = 4.0
    """The ratio of an increment to the smallest one above which the iterate is given up for one half as far
    from the best one."""
    halvings: Count = 5
    """The largest number of such steps."""
    renewed_after: Count = 20
    """Iterations for the flow's linear system after which operator and preconditioner are made anew, which
    takes as long as 30 to 65 of them."""
    renewed_above: Positive = 0.05
    """Increment after which they are; below, only hyperviscosity, which changes suddenly, is followed."""
    stale_above: Positive = 0.2
    """Share of the increment before, above which they are too.  For a steep flow rule, whose operator is made
    anew by itself, ten times the one and half of the other."""
    bends_above: Positive = 0.03
    """Relative increment of a creep rate field after which it is, where the one before was not three times as
    large."""
    rounding: Positive = 1e-8
    """Increment, relative to the smallest velocities, from which a stall may be rounding."""
    flow_iterations: Count = 30
    """Iterations for the flow's linear system at most."""
    direct_up_to: Pair = (3_000, 3_000)
    """Unknowns of v up to which its tangent is factorised as a whole; above, two levels are faster."""
    direct_at_most: Pair = (100_000, 15_000)
    """Unknowns of v up to which it is so in what is left of a step, where ``flow_iterations`` by two levels
    do not solve the flow's system."""
    krylov_below: Positive = 0.05
    """Increment up to which Newton-Krylov takes over: farther off half of the step is solved at once."""
    penalty_degree: Count = 4
    """The degree of the rule for the derivative of the hyperviscosity's penalty, for k = 2 on straight cells:
    right for p = 4, where it takes (P_1 jumps)^4.  For k = 3 and on curved cells the rule is that of the
    forms."""

    def __post_init__(self) -> None:
        require_fields(self)


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Tolerances of the iteration, in the norm of ``ngvisco.solver.problem``, and the parts of the solvers.

    Parameters
    ----------
    tolerance : float
        The iteration ends when a relative increment is below it; that increment is still added.
    max_iterations : int
        Residual evaluations of one attempt to solve a step, after which it has failed.
    refresh : float
        Contraction above which the Jacobian is made anew.
    min_damping : float
        Smallest damping of a Newton step that is tried.
    inverse : str
        Sparse direct solver of the coupled solver, "umfpack", and "pardiso" (``pip install mkl``) or "mumps"
        where the installation has them.
    coarse : str
        What solves for the velocities of the vertices in the split solver's two levels: "direct", or for more
        vertices than can be factorised PETSc's multigrid, "gamg" or "hypre". A warning says where it has no
        part in a run.
    method : str
        "coupled", all unknowns at once (small meshes), "split", the fields as functions of the velocity
        (large ones), or "auto", which chooses one by the mesh and asks the other one where a step is not
        solved; both solve the same equations.
    threads : int or None
        Threads that share the cells in the split solver, by default the environment's NGVISCO_THREADS, or all
        processors, of which ranks have equal parts. A state's bits do not depend on them.

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
            expected = f"at least {_ROUNDING:g}, which rounding leaves"
            raise ParameterError("NewtonOptions.tolerance", self.tolerance, expected)
        # sparsecholesky returns nonsense for nonsymmetric matrices, silently
        if not is_available(self.inverse):
            have = ", ".join(filter(is_available, get_args(Inverse)))
            expected = f"{have}: this installation of NGSolve has no other one ready"
            raise ParameterError("NewtonOptions.inverse", self.inverse, expected)
        is_split, where = self.method == "split", "with the method 'split'"
        require_effect(self, not is_split, where, "refresh", "min_damping", "inverse")
        require_effect(self, self.method != "coupled", "with the method 'coupled'", "split", "threads")
        if self.coarse != "direct":
            if self.method == "coupled":
                expected = "'direct' with the method 'coupled', which factorises one system of all unknowns"
                raise ParameterError("NewtonOptions.coarse", self.coarse, expected)
            if (missing := obstacle(self.coarse)) is not None:
                raise ParameterError("NewtonOptions.coarse", self.coarse, f"'direct': {missing}")


@cache
def is_available(inverse: str) -> bool:
    """Whether NGSolve, as it is installed, has this sparse direct solver: found by asking it for one."""
    if inverse == "umfpack":
        return True
    try:
        SparseMatrixd.CreateFromCOO([0, 1], [0, 1], [1.0, 1.0], 2, 2).Inverse(inverse=inverse)
    except Exception:  # NGSolve raises NgException and RuntimeError
        return False
    return True
