"""The transport of the fields for a given velocity, and its approximate inverse by sweeps over the cells.

Each component of z, and rho, has a scalar matrix T = M/tau + convection + fluxes through facets, with the
traces eliminated. The dense blocks of T multiply a cell's own values and the values across its sides
(``FacetCoupling``). The flux through a facet depends on the cell's values and on the facet's trace, a
weighted mean of both sides' values. Sweeps over the cells (block Jacobi) solve each cell with the last values
of its neighbours; sweeps converge more slowly at larger Courant numbers. ``update`` fixes the number of
sweeps for the present velocity, from the error of sweeps for a random field, so that the approximate inverse
is a linear map. T is factorised for components that diffuse, because sweeps do not resolve diffusion, and for
components that cells exchange across facets (``Exchanged``). A nonlinear density equation has its own
Jacobian.

Kernels compute the blocks, since ``FacetTangent`` of the same terms takes 30 to 170 times as long
(``tests/benchmarks/kernels.py``); ``tests/solver/test_flow_operator.py`` compares the blocks with the
rows.
"""

from __future__ import annotations

import numpy as np

from ngvisco.algebra import precision
from ngvisco.algebra.factorised import Direct, direct_solver
from ngvisco.algebra.sparse import of_blocks
from ngvisco.forms.upwinding import mean_share
from ngvisco.parallel.exchange import HaloUnknowns
from ngvisco.reduced.coupling import FacetCoupling
from ngvisco.reduced.facet_tangent import FacetTangent
from ngvisco.reduced.residual import Evaluation, ReducedResidual

LEAST, MOST = 3, 30
"""Smallest and largest number of sweeps over the cells."""
SHARE = 0.05
"""Relative error of a random field after the sweeps."""


class CellBlocks:
    """A matrix in single precision, whose blocks multiply values of the cell and of its neighbours."""

    def __init__(self, diagonal: np.ndarray, across: np.ndarray, coupling: FacetCoupling) -> None:
        """``diagonal`` and ``across`` are blocks as ``FacetCoupling.blocks`` returns, or rectangular ones."""
        self._coupling = coupling
        self._rows = np.concatenate([diagonal, _side_by_side(across)], axis=2).astype(precision.SINGLE)

    def product(self, values: np.ndarray) -> np.ndarray:
        """The matrix times ``values`` (cells, q, n)."""
        return np.matmul(self._rows, np.concatenate([values, self._beside(values)], axis=1))

    def _beside(self, x: np.ndarray) -> np.ndarray:
        """The neighbours' values side by side, (cells, sides q, n), from values (cells, q, n)."""
        neighbours = self._coupling.neighbours
        beside = np.take(self._coupling.halo.with_others(x), neighbours, axis=0)
        return beside.reshape(len(neighbours), neighbours.shape[1] * x.shape[1], x.shape[2])


class SweptMatrix(CellBlocks):
    """A matrix of cells' square blocks, and an approximate inverse by sweeps over the cells.

    Raises LinAlgError if a cell's own block is singular.
    """

    def __init__(self, diagonal: np.ndarray, across: np.ndarray, coupling: FacetCoupling) -> None:
        super().__init__(diagonal, across, coupling)
        inverse = np.linalg.inv(diagonal)
        self.cells = inverse.astype(precision.SINGLE)
        self._carried = (-np.matmul(inverse, _side_by_side(across))).astype(precision.SINGLE)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The matrix times coefficients x, both (cells' unknowns, n) or (cells' unknowns,)."""
        return self.product(self._by_cells(x)).reshape(x.shape)

    def swept(self, r: np.ndarray, sweeps: int) -> np.ndarray:
        """Approximate solution for the right-hand side r by a number of sweeps; r is (cells' unknowns, n) or
        (cells' unknowns,)."""
        x = start = np.matmul(self.cells, self._by_cells(r))
        for _ in range(sweeps - 1):
            x = start + self.carried(x)
        return x.reshape(r.shape)

    def carried(self, x: np.ndarray) -> np.ndarray:
        """The contribution of the neighbours' values to a sweep, (cells, q, n)."""
        return np.matmul(self._carried, self._beside(x))

    def _by_cells(self, x: np.ndarray) -> np.ndarray:
        values = x.astype(precision.SINGLE, copy=False)
        return values.reshape(*self.cells.shape[:2], x.shape[1] if x.ndim == 2 else 1)


def _side_by_side(across: np.ndarray) -> np.ndarray:
    """Blocks (cells, sides, q, n) as (cells, q, sides n)."""
    cells, sides, q, n = across.shape
    return across.transpose(0, 2, 1, 3).reshape(cells, q, sides * n)


class Exchanged:
    """The exchange of some components of z between cells across facets, by other terms than transport.

    A factorisation for each exchanged component includes the component's transport.  The equations of all
    other components are solved first.
    """

    def __init__(self, tangent: FacetTangent) -> None:
        self.rows, self.tangent, coupling = tangent.rows, tangent, tangent.coupling
        self._coupling, self._unknowns = coupling, HaloUnknowns(coupling.halo, coupling.functions)
        free = np.ones(self._unknowns.count, dtype=bool)
        self._solvers = [direct_solver(free, self._unknowns) for _ in self.rows]

    def update(self, at: Evaluation, diagonal: np.ndarray, across: np.ndarray) -> None:
        """Linearise and factorise; ``diagonal`` and ``across`` are the blocks of transport."""
        (here, there), coupling = self.tangent(at), self._coupling
        q = coupling.functions
        self._columns = self.tangent.columns
        for n, (i, solver) in enumerate(zip(self.rows, self._solvers, strict=True)):
            row, column = (slice(q * k, q * (k + 1)) for k in (n, self._columns.index(i)))
            whole = diagonal + here[:, row, column], across + there[:, :, row, column]
            solver.factorise(of_blocks(*whole, coupling.neighbours, coupling.halo.count))
        self._blocks = CellBlocks(here, there, coupling)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The exchange's rows, (cells' unknowns, rows), of coefficients x (cells' unknowns, n)."""
        coupling, q = self._coupling, self._coupling.functions
        by_cells = x[:, self._columns].astype(precision.SINGLE).reshape(coupling.cells, q, len(self._columns))
        values = by_cells.swapaxes(1, 2).reshape(coupling.cells, q * len(self._columns), 1)
        increments = self._blocks.product(values).reshape(coupling.cells, len(self.rows), q)
        return increments.swapaxes(1, 2).reshape(len(x), len(self.rows))

    def solve(self, r: np.ndarray, result: np.ndarray) -> None:
        """Solve for the exchanged components from rows r, and put them into ``result``.

        ``result`` has the increments of the other components, by transport alone."""
        result[:, self.rows] = 0.0
        remaining = r[:, self.rows] - self(result)
        for n, (i, solver) in enumerate(zip(self.rows, self._solvers, strict=True)):
            result[:, i] = _solved(solver, self._unknowns, remaining[:, n])


class TransportSweeps:
    """Approximate inverses of the scalar transport of z and of the density equation."""

    def __init__(self, residual: ReducedResidual) -> None:
        self.residual, self.sweeps = residual, LEAST
        self.coupling = FacetCoupling(residual.side_op, residual.trace_mass)
        op = residual.op
        self._shape = (self.coupling.cells, op.z.per_cell, 1)
        self._mass = np.matmul(np.ascontiguousarray(op.tests()), op.z.blocks)
        self._flat: np.ndarray | None = None
        """A cell's basis functions without their slopes, at the points of the cell's sides, for matter that
        flows in through walls."""
        self._whole: Direct | None = None
        """A direct solver for the components of z that diffuse."""
        if residual.diffusion is not None:
            self._laplacian = residual.diffusion.laplacian(residual.inverse_mass)
            self._unknowns = residual.diffusion.unknowns
            self._whole = direct_solver(np.ones(self._unknowns.count, dtype=bool), self._unknowns)
        self.exchange: Exchanged | None = None
        if terms := residual.couplings.across_facets:
            rows = residual.couplings.components_across_facets()
            self.exchange = Exchanged(FacetTangent(residual, terms, rows, self.coupling))
        self.of_rho: SweptMatrix | None = None
        self._density: Direct | None = None
        """A direct solver of a nonlinear density equation, used instead of ``of_rho``."""
        if residual.density is not None:
            u = residual.unknowns
            shared = residual.exchange.part(np.arange(u.size)[u.density_slice])
            self._density = direct_solver(residual.density.free, shared)

    def update(self, at: Evaluation) -> None:
        """Form the matrices and invert at an evaluation."""
        r, coupling = self.residual, self.coupling
        diagonal, across = self.blocks("z", at)
        if self._whole is not None:
            transport = of_blocks(diagonal, across, coupling.neighbours, coupling.halo.count)
            self._whole.factorise((transport + self._laplacian).tocsr())
        if self.exchange is not None:
            self.exchange.update(at, diagonal, across)
        with r.ranks.together(np.linalg.LinAlgError):
            self.of_z = SweptMatrix(diagonal, across, coupling)
        self._count_sweeps()
        if self._density is None and r.unknowns.density:
            with r.ranks.together(np.linalg.LinAlgError):
                self.of_rho = SweptMatrix(*self.blocks("rho", at), coupling)

    def blocks(self, name: str, at: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        """The blocks of the transport of ``"z"`` or ``"rho"``, see ``FacetCoupling.blocks``."""
        r = self.residual
        share = mean_share(r.side_op.inner)
        normal_velocity = r.side_op.crossed * (r.side_op.points.normals * at.facets.v.value).sum(axis=0)
        inward, convection = normal_velocity - abs(normal_velocity), self._convection(at)
        direct = -inward
        if name == "rho":
            direct, convection = abs(normal_velocity), -convection.transpose(0, 2, 1)
        diagonal, across = self.coupling.blocks(direct, share, inward)
        diagonal += self._entering(name, at, inward)
        return diagonal + r.step.context.rate(self._mass) + convection, across

    def _entering(self, name: str, at: Evaluation, inward: np.ndarray) -> np.ndarray | float:
        """The contribution to the rows of ``"rho"`` or ``"z"`` of matter that flows in through walls."""
        given, passages = at.facets.context.given, self.residual.step.context.passages
        if not passages:
            return 0.0
        none = np.zeros_like(inward)
        result = np.zeros_like(self._mass)
        for wall in passages:
            flow = -0.5 * inward * given(wall.indicator).value
            result = result + self.coupling.blocks(flow, none, none)[0]
            if wall.continues(name):
                result = result - self.coupling.blocks(flow, none, none, self._without_slopes(at))[0]
        return result

    def _without_slopes(self, at: Evaluation) -> np.ndarray:
        """Basis functions at the points of the sides, less their slopes times the distance ``reach`` from the
        cell's middle; unchanged if ``reach`` is None."""
        reach = at.facets.context.reach
        if self._flat is None:
            self._flat = flat = self.residual.side_op.z.blocks.copy()
            if reach is not None:
                points, lengths = flat.reshape(-1, flat.shape[-1]), at.facets.context.given(reach).value
                for length, D in zip(lengths, self.residual.side_op.slopes("z"), strict=True):
                    entries = D.matrix.tocoo()
                    slopes = length[entries.row] * entries.data
                    np.subtract.at(points, (entries.row, entries.col % flat.shape[-1]), slopes)
        return self._flat

    def _count_sweeps(self) -> None:
        """Set the number of sweeps for the present transport, from the error of sweeps for a random field."""
        count, q = self._mass.shape[:2]
        x = np.random.default_rng(0).standard_normal((count, q, 1)).astype(precision.SINGLE)
        norm = self.residual.ranks.norm
        size, number = SHARE * norm(x.ravel()), 0
        # n sweeps multiply the error by the n-th power of the map from neighbours' values to a cell's values
        while number < MOST and (number < LEAST or norm(x.ravel()) > size):
            x = self.of_z.carried(x)
            number += 1
        self.sweeps = number

    def _convection(self, at: Evaluation) -> np.ndarray:
        """int (v . grad z) q in cells, (cells, q, q)."""
        v, derivatives = at.cells.v.value, self.residual.op.slopes("z")
        along = sum(v_j.reshape(self._shape) * D.blocks for v_j, D in zip(v, derivatives, strict=True))
        return np.matmul(np.ascontiguousarray(self.residual.op.tests()), along)

    def linearise(self) -> None:
        """Factorise a nonlinear density equation at the present state."""
        if self._density is not None and self.residual.density is not None:
            self._density.factorise(self.residual.density.jacobian())

    def fields(self, r: np.ndarray) -> np.ndarray:
        """Increments of z by transport, without rates and creep, from rows r, both (cells' unknowns, n)."""
        result = self.of_z.swept(r, self.sweeps)
        if self._whole is not None and self.residual.diffusion is not None:
            for i in np.flatnonzero(self.residual.diffusion.strains):
                result[:, i] = _solved(self._whole, self._unknowns, r[:, i])
        if self.exchange is not None:
            self.exchange.solve(r, result)
        return result

    def in_cells(self, rows: np.ndarray, cells: slice) -> np.ndarray:
        """The inverses of some cells' own blocks times ``rows``, (cells, q n, .), without sweeps and
        diffusion."""
        inverses = self.of_z.cells[cells]
        q = self._mass.shape[1]
        # a length -1 would fail on a rank without cells
        by_functions = rows.reshape(len(rows), q, rows.shape[1] * rows.shape[2] // q)
        return np.matmul(inverses, by_functions).reshape(rows.shape)

    def density(self, r: np.ndarray) -> np.ndarray:
        """Increments of the density's unknowns from rows. The shape is (unknowns,), or for sweeps (cells'
        unknowns, .)."""
        if self._density is not None:
            return self._density(r)
        assert self.of_rho is not None
        return self.of_rho.swept(r, self.sweeps)

    def rows(self, x: np.ndarray) -> np.ndarray:
        """T x for coefficients x of the fields, both (cells' unknowns, n)."""
        rows = self.of_z(x)
        if self.residual.diffusion is not None:
            strains = self.residual.diffusion.strains
            beyond = self._unknowns.with_others(x[:, strains].T)
            rows[:, strains] += self._unknowns.added((self._laplacian @ beyond.T).T).T
        if self.exchange is not None:
            rows[:, self.exchange.rows] += self.exchange(x)
        return rows


def _solved(solver: Direct, unknowns: HaloUnknowns, rows: np.ndarray) -> np.ndarray:
    """Solve for this rank's rows by a factorisation over all ranks."""
    return solver(unknowns.of_cells_alone(rows))[: unknowns.of_cells]
