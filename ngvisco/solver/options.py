"""What may be chosen of the solvers: one frozen, checked dataclass for each part of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

from ngvisco.errors import (
    ParameterError,
    as_integer,
    require_choice,
    require_count,
    require_nonnegative,
    require_positive,
    require_type,
)

METHODS = ("auto", "coupled", "split")
INVERSES = ("umfpack", "pardiso", "mumps")
_ROUNDING = 1e-14


@dataclass(frozen=True, kw_only=True)
class NormOptions:
    """Floors of the scales that increments are measured by (``ngvisco.solver.norm``).

    Parameters
    ----------
    floor : float
        Small strains and velocities converge relatively to themselves, as the ledger needs.
    coarse_floor : float
        By it a stalled iteration is asked: near a state of rest the other one is below rounding.
    """

    floor: float = 1e-9
    coarse_floor: float = 1e-3

    def __post_init__(self) -> None:
        require_positive(self, floor=self.floor, coarse_floor=self.coarse_floor)


@dataclass(frozen=True, kw_only=True)
class CoupledOptions:
    """The coupled solver's acceptance of rounding, and its memory.

    Parameters
    ----------
    noise_samples : int
        Perturbations of the state by rounding that are tried; the largest change of the increment counts.
    noise_margin : float
        A stalled increment that is accepted, in units of that change: both are random, of a few modes.
    noise_cap : float
        The largest increment, in tolerances, that is accepted as rounding.
    near : float
        The same without a measurement: with long steps in a stiff fluid rounding of the pressure alone moves
        a slow velocity by 4e-10 of itself.
    heap_sizes : tuple of int
        NGSolve's memory for the matrix of a cell, bytes, tried where its own does not do: k = 3, m = 2 in 3D.
    """

    noise_samples: int = 2
    noise_margin: float = 10.0
    noise_cap: float = 100.0
    near: float = 10.0
    heap_sizes: tuple[int, ...] = (500_000_000, 2_000_000_000)

    def __post_init__(self) -> None:
        require_count(self, noise_samples=self.noise_samples)
        require_positive(self, noise_margin=self.noise_margin, noise_cap=self.noise_cap, near=self.near)
        for size in self.heap_sizes:
            require_count("CoupledOptions", heap_sizes=size)


@dataclass(frozen=True, kw_only=True)
class KrylovOptions:
    """Newton-Krylov iteration of the split solver, where its own is slow.

    Parameters
    ----------
    tolerance : float
        Of an increment's linear system.  With 0.1 a sixth of long steps failed.
    directions : int
        Derivatives taken for one increment at most.
    """

    tolerance: float = 0.01
    directions: int = 40

    def __post_init__(self) -> None:
        require_positive(self, tolerance=self.tolerance)
        require_count(self, directions=self.directions)


@dataclass(frozen=True, kw_only=True)
class TwoLevelOptions:
    """The smoother of ``TwoLevelSolver``.

    Parameters
    ----------
    sweeps : int
        Jacobi sweeps before and after the coarse problem.
    damping : float
        In units of 1/(largest eigenvalue of D^{-1} A), below 2.  The eigenvalue is 2.7 on Netgen's tetrahedra
        and 3.4 on these refined, where one damping for both made GMRES take 20 instead of 12 iterations.
    dropped : float
        Entries that a smoother does without, relative to the diagonal: two thirds of them, for one iteration
        of GMRES in a hundred (739 tetrahedra).
    """

    sweeps: int = 2
    damping: float = 1.65
    dropped: float = 1e-2

    def __post_init__(self) -> None:
        require_count(self, sweeps=self.sweeps)
        require_positive(self, damping=self.damping)
        if self.damping >= 2:
            raise ParameterError("TwoLevelOptions.damping", self.damping, "a number in (0, 2)")
        if not 0 <= self.dropped < 1:
            raise ParameterError("TwoLevelOptions.dropped", self.dropped, "a number in [0, 1)")


@dataclass(frozen=True, kw_only=True)
class SplitOptions:
    """The split solver's choice, iteration and linear systems.  Pairs are values in 2D and in 3D.

    Parameters
    ----------
    chosen_from : (int, int)
        Cells from which ``method = "auto"`` takes it: from there it is the faster one (tests/benchmarks).
    coupled_up_to : (int, int)
        Cells up to which the coupled solver is asked where this one fails: its factorisation has to fit a
        workstation.
    margin : float
        The increment wanted, in units of the tolerance: what is left is a contraction's share of it.
    slow : int
        Iterations after which the whole derivative is taken (Newton-Krylov).
    stall, window : float, int
        The same where so many iterations shorten the increment by less than this factor.  The transport's
        sweeps converge like the Courant number: above one the iteration does not.
    restarts : int
        New tangents within a step, after which the whole derivative is taken.
    renewed_after : (int, int)
        Iterations for the flow's linear system after which its preconditioner is made anew.
    renewed_above : float
        Increment after which the preconditioner is made anew: from rest it knows nothing of the curvature of
        v (268 iterations of GMRES instead of 106 in a first step of 739 tetrahedra).
    linearised_above : float
        Increment below which only what changes suddenly is linearised anew, hyperviscosity and upwinding;
        1e-3 and 1e-1 take as many iterations.
    rounding : float
        Increment, relative to the smallest velocities, from which a stall may be rounding.
    forcing : float
        Tolerance of the flow's linear system.  With 0.1 there are 28 iterations instead of 12 in a step of
        2,258 triangles, with 0.01 a fifth more of GMRES's and hardly fewer of Newton's.
    flow_iterations : int
        Iterations for the flow's linear system.
    direct_up_to : (int, int)
        Unknowns of v up to which its tangent is factorised as a whole; above, two levels do (2,639
        tetrahedra: 5.4 s for a factorisation, 0.1 s for two levels, and no more time for GMRES).
    krylov : KrylovOptions
    two_level : TwoLevelOptions
    """

    chosen_from: tuple[int, int] = (60, 10)
    coupled_up_to: tuple[int, int] = (20_000, 1_000)
    margin: float = 0.1
    slow: int = 24
    stall: float = 0.3
    window: int = 4
    restarts: int = 4
    renewed_after: tuple[int, int] = (8, 12)
    renewed_above: float = 0.5
    linearised_above: float = 1e-2
    rounding: float = 1e-8
    forcing: float = 0.03
    flow_iterations: int = 30
    direct_up_to: tuple[int, int] = (3_000, 3_000)
    krylov: KrylovOptions = field(default_factory=KrylovOptions)
    two_level: TwoLevelOptions = field(default_factory=TwoLevelOptions)

    def __post_init__(self) -> None:
        require_count(self, window=self.window, flow_iterations=self.flow_iterations)
        names = ("margin", "stall", "renewed_above", "linearised_above", "rounding", "forcing")
        require_positive(self, **{name: getattr(self, name) for name in names})
        require_nonnegative(self, slow=self.slow, restarts=self.restarts)
        for name in ("chosen_from", "coupled_up_to", "renewed_after", "direct_up_to"):
            pair = getattr(self, name)
            if len(pair) != 2 or any(as_integer(value) is None or value < 0 for value in pair):
                raise ParameterError(f"SplitOptions.{name}", pair, "two integers >= 0, for 2D and for 3D")
        require_type("SplitOptions.krylov", self.krylov, KrylovOptions)
        require_type("SplitOptions.two_level", self.two_level, TwoLevelOptions)


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Tolerances of the iteration, in the norm of ``ngvisco.solver.norm``, and the parts of the solvers.

    Parameters
    ----------
    tolerance : float
        The iteration ends when an increment is below it; that increment is still added.
    max_iterations : int
        Residual evaluations of one attempt to solve a Rothe step, after which it has failed.
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
    norm, coupled, split : NormOptions, CoupledOptions, SplitOptions
    """

    tolerance: float = 1e-10
    max_iterations: int = 60
    refresh: float = 0.25
    min_damping: float = 1e-3
    inverse: str = "umfpack"
    method: str = "auto"
    norm: NormOptions = field(default_factory=NormOptions)
    coupled: CoupledOptions = field(default_factory=CoupledOptions)
    split: SplitOptions = field(default_factory=SplitOptions)

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
        for name, kind in (("norm", NormOptions), ("coupled", CoupledOptions), ("split", SplitOptions)):
            require_type(f"NewtonOptions.{name}", getattr(self, name), kind)


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
