"""The velocity of a momentum functional, and projections of velocities to those that the walls admit.

The velocity of a momentum functional satisfies int rho v . w = <m, w> for all w that the walls admit.  Among
these w, the velocity maximises <m, w> - 1/2 int rho |w|^2, and the maximum is E(rho, m).  Prescribed
coefficients are kept. On oblique and curved walls (v . n, mu) = 0 for all multipliers mu (paper:
Euler-small-BC-hyper).  One scalar mass matrix serves all components. Conjugate gradients, preconditioned with
its diagonal D, take 30 to 60 iterations on any mesh.  With multipliers, the iterations run in the null space
of the walls' condition C v = 0.  The projection onto this space in the inner product of D
(``WallProjection``) is

    I - D^-1 C^T (C D^-1 C^T)^-1 C.

C D^-1 C^T is not a sum over ranks, since walls of two ranks share vertices and edges.  Therefore y = D^-1 C^T
lambda is kept as an unknown at shared coefficients.  C_s are the columns of C at shared coefficients, and C_i
all others.  The condition C y = g is then the system

    D y - C_s^T lambda = 0,   C_s y + C_i D_i^-1 C_i^T lambda = g.

On one process this system is the Schur complement C D^-1 C^T of lambda.  The system is factorised in units
in which D and the rows of C have length one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import scipy.sparse as sp
from ngsolve import CF, BilinearForm, CoefficientFunction, FESpace, GridFunction, LinearForm

from ngvisco.algebra.factorised import DirectSolver
from ngvisco.algebra.krylov import conjugate_gradients
from ngvisco.errors import StepError
from ngvisco.forms.boundary.wall_terms import Impenetrability
from ngvisco.forms.context import StepLayout
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.petsc import SumInverse
from ngvisco.physics.tensors import inner

_REDUCTION, _CORRECTIONS, _ITERATIONS = 1e-9, 4, 1000
_ROUNDING, _ENOUGH = 3e-16, 1e-13
"""Two residuals relative to <m, .>: the residual at which the iteration ends, and the largest one that is
accepted. The residual enters the closure of the energy."""


class WallProjection:
    """Projection of free coefficients of v onto the walls' null space; collective, for summed vectors of v.

    ``term`` has the multipliers; each multiplier belongs to one rank, since a wall's facet has one cell.
    ``free`` is the mask of coefficients of v that are not prescribed.
    """

    def __init__(
        self, layout: StepLayout, term: Impenetrability, quadrature: Quadrature, free: np.ndarray
    ) -> None:
        names = ("v", "wall_stress")
        space = FESpace([layout.blocks[name] for name in names])
        trial, test = space.TnT()
        u, w = (Fields(layout, dict(zip(names, parts, strict=True))) for parts in (trial, test))
        form = BilinearForm(space)
        for part in term.form(u, w):
            form += quadrature.facets(part.facets)
        of_v, multipliers = (np.arange(r.start, r.stop) for r in (space.Range(0), space.Range(1)))
        constraint = csr(form.Assemble().mat)[multipliers][:, of_v].tocsc()
        self.free = free
        self._constraint, self.prescribed = constraint[:, free].tocsr(), constraint[:, ~free].tocsr()
        multiplier = layout.blocks["wall_stress"]
        self._given = LinearForm(multiplier)
        for piston in term.pistons:
            self._given += quadrature.facets(piston.prescribed(multiplier.TestFunction()))
        self._of = {
            piston.name: np.array(
                [number for facet in piston.region.Elements() for number in multiplier.GetDofNrs(facet)],
                dtype=int,
            )
            for piston in term.pistons
        }
        exchange = Exchange.of(space, Communicator.of(layout.mesh))
        exchange = exchange.part(np.concatenate([of_v[free], multipliers]))
        self._shared = exchange.places  # places among the free coefficients of v
        last = np.count_nonzero(free) + np.arange(len(multipliers))
        exchange = exchange.part(np.concatenate([self._shared, last]))
        self._owned = exchange.owned[: len(self._shared)].astype(float)
        coupled = np.ones(exchange.count)
        coupled[: len(self._shared)] = abs(self._constraint[:, self._shared]).sum(axis=0)
        solved = exchange.sum(coupled) > 0
        self._solver = (
            SumInverse(solved, exchange) if exchange.is_distributed else DirectSolver(solved, symmetric=True)
        )

    def update(self, diagonal: np.ndarray) -> None:
        """Set the diagonal D of the free coefficients; raises StepError if C does not have full rank."""
        self._root = np.sqrt(diagonal)
        scaled = self._constraint @ sp.diags(1 / self._root)
        self._length = np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel())
        scaled = (sp.diags(1 / self._length) @ scaled).tocsc()
        across, is_inner = scaled[:, self._shared], np.ones(len(diagonal))
        is_inner[self._shared] = 0.0
        inner = (scaled @ sp.diags(is_inner)).tocsr()
        self._transposed = inner.T.tocsr()
        blocks = [[sp.diags(self._owned), -across.T], [across, inner @ self._transposed]]
        self._solver.factorise(sp.bmat(blocks, format="csr"))

    def _taken(self, g: np.ndarray) -> np.ndarray:
        """D^(1/2) y for the y with C y = g that minimises y . D y."""
        count = len(self._shared)
        solution = self._solver(np.concatenate([np.zeros(count), g / self._length]))
        result: np.ndarray = self._transposed @ solution[count:]
        result[self._shared] = solution[:count]
        return result

    def __call__(self, v: np.ndarray) -> np.ndarray:
        """Project free coefficients."""
        return v - self._taken(self._constraint @ v) / self._root

    def transposed(self, rows: np.ndarray) -> np.ndarray:
        """Apply the transposed projection to rows of free coefficients."""
        return rows - self._root * self._taken(self._constraint @ (rows / self._root**2))

    def _normal_velocity(self, v: np.ndarray) -> np.ndarray:
        """Values (v . n, mu) for all coefficients of v, (multipliers,)."""
        return self._constraint @ v[self.free] + self.prescribed @ v[~self.free]

    def completed(self, v: np.ndarray) -> np.ndarray:
        """The free coefficients nearest to those of v with which v satisfies the walls' condition."""
        rows = self._normal_velocity(v)
        if self._of:  # the pistons' v.n at the present time is subtracted
            rows -= self._given.Assemble().vec.FV().NumPy()
        return v[self.free] - self._taken(rows) / self._root

    def multipliers(self, rows: np.ndarray) -> np.ndarray:
        """The multipliers lambda with C^T lambda equal to the free rows of an impulse, (multipliers,)."""
        count, shares = len(self._shared), self._constraint @ (rows / self._root**2)
        return self._solver(np.concatenate([np.zeros(count), shares / self._length]))[count:] / self._length

    def works(self, multipliers: np.ndarray, v: np.ndarray) -> dict[str, float]:
        """Work of each piston's multipliers on v, J, by walls."""
        corrections = multipliers * self._normal_velocity(v)
        return {name: float(corrections[numbers].sum()) for name, numbers in self._of.items()}


class VelocityOfMomentum:
    """Solver that computes the velocity in a state from rho > 0, kg/m^3, and m, kg/(m^2 s).

    The state's v is the start value of the iteration, and has the prescribed coefficients.  m has values at
    the points of ``quadrature``; ``term`` is None without multipliers.
    """

    def __init__(
        self,
        layout: StepLayout,
        state: GridFunction,
        density: CoefficientFunction,
        momentum: CoefficientFunction,
        term: Impenetrability | None,
        quadrature: Quadrature,
    ) -> None:
        self.v = state.vec.FV().NumPy()[layout.ranges["v"]]
        scalar, space = layout.scalar_space("v"), layout.blocks["v"]
        trial, test = scalar.TnT()
        self._mass = BilinearForm(scalar, symmetric=True)
        self._mass += quadrature.cells((density * trial * test).Compile())
        self._load = LinearForm(space)
        self._load += quadrature.cells(inner(momentum, space.TestFunction()))
        self.free = mask_of(space.FreeDofs())
        self._exchange = Exchange.of(space, Communicator.of(layout.mesh))
        # a shared coefficient counts once in products
        several = self._exchange.communicator.is_distributed
        self._own = self._exchange.owned if several else slice(None)
        self._own_free = self._exchange.owned[self.free] if several else slice(None)
        self._dim = layout.mesh.dim
        self._walls = None if term is None else WallProjection(layout, term, quadrature, self.free)

    def works(
        self, rows: np.ndarray, v: np.ndarray, moving: Mapping[str, tuple[CoefficientFunction, np.ndarray]]
    ) -> dict[str, float]:
        """Works, J, of an impulse of the walls on the velocity v, by walls; ``rows`` is of ``__call__``.

        ``moving`` has the walls that prescribe v with the masks of their coefficients.  The part of the
        multipliers in the rows of a moving wall is no work of this wall.
        """
        ranks, of_pistons = self._exchange.communicator, dict[str, float]()
        if self._walls is not None:
            multipliers = self._walls.multipliers(self._exchange.sum(rows)[self.free])
            of_pistons = self._walls.works(multipliers, v)
            rows = rows.copy()
            rows[~self.free] -= self._walls.prescribed.T @ multipliers
        works = {name: ranks.dot(rows[mask], v[mask]) for name, (_, mask) in moving.items()}
        return works | {name: float(ranks.total(work)) for name, work in of_pistons.items()}

    def multiplied(self, moving: Mapping[str, tuple[CoefficientFunction, np.ndarray]]) -> list[str]:
        """Names of the ``moving`` walls, as in ``works``, whose coefficients of v multipliers constrain."""
        if self._walls is None:
            return []
        # a facet's cell also has coefficients that vanish on the facet, up to rounding
        sizes = abs(self._walls.prescribed).sum(axis=0).A1
        is_bound = sizes > _ENOUGH * sizes.max(initial=0.0)
        return [name for name, (_, mask) in moving.items() if is_bound[mask[~self.free]].any()]

    def functional(self) -> np.ndarray:
        """Functional <m, .> in this rank's cells, (unknowns of v,)."""
        return self._load.Assemble().vec.FV().NumPy().copy()

    def __call__(self, keeps_walls: bool = False) -> np.ndarray:
        """Solve; return the rows int rho v . w - <m, w>, (unknowns of v,), which are zero except at walls.

        On walls with multipliers v.n is the value prescribed at the present time. If ``keeps_walls`` is True,
        v.n is the value of the state instead.

        The rows are summed over this rank's cells only.  Raises StepError if the linear system is not solved
        to rounding.
        """
        self._mass.Assemble()
        mass = sp.block_diag([csr(self._mass.mat)] * self._dim, format="csr")
        rows = self.functional()
        free, v, exchange, ranks = self.free, self.v, self._exchange, self._exchange.communicator
        momentum, diagonal = exchange.sum(rows), exchange.sum(mass.diagonal())[free]
        project: Callable[[np.ndarray], np.ndarray] = _same
        project_back = project
        if self._walls is not None:
            self._walls.update(diagonal)
            project, project_back = self._walls, self._walls.transposed
            if not keeps_walls:
                v[free] = self._walls.completed(v)  # an admissible start value
        full = np.zeros_like(v)

        def product(x: np.ndarray, y: np.ndarray) -> float:
            return ranks.dot(x[self._own_free], y[self._own_free])

        def operator(x: np.ndarray) -> np.ndarray:
            full[free] = project(x)
            return project_back(exchange.sum(mass @ full)[free])

        def inverse(x: np.ndarray) -> np.ndarray:
            return project(project_back(x) / diagonal)

        size = ranks.norm(momentum[self._own]) or 1.0
        left = np.inf
        for _ in range(_CORRECTIONS):
            # projected twice: large rows at walls leave rounding that is not in the operator's range
            residual = project_back(project_back((momentum - exchange.sum(mass @ v))[free]))
            last, left = left, ranks.norm(residual[self._own_free])
            if left <= _ROUNDING * size or not left < 0.5 * last:
                break
            change = conjugate_gradients(operator, residual, inverse, product, _REDUCTION, _ITERATIONS)
            v[free] += project(change)
        if not left <= _ENOUGH * size:
            raise StepError(
                "the velocity was found from the momentum with a relative error of "
                f"{left / size:.1e}, which is too large"
            )
        return mass @ v - rows


def _same(x: np.ndarray) -> np.ndarray:
    return x


def project_velocity(
    layout: StepLayout,
    state: GridFunction,
    v_0: CoefficientFunction,
    term: Impenetrability | None,
    quadrature: Quadrature,
) -> None:
    """Set v to the L2 projection of v_0 onto the velocities that the walls admit."""
    VelocityOfMomentum(layout, state, CF(1.0), CF(v_0), term, quadrature)()
