"""The transport of the fields for a given velocity, and its approximate inverse by sweeps over the cells.

One component of z, and rho, have the scalar matrix T = M/tau + convection + facets with the trace
eliminated, in dense blocks: of a cell's own values, and of those across its sides (``FacetCoupling``).  A
flux through a facet sees its own cell's values and the facet's trace, a mean of both sides' values with
weights of its own.  Sweeps over the cells, each for itself with its neighbours' values (block Jacobi),
converge like the Courant number; their number is fixed by the velocity of the last ``update``, so that the
map stays linear, as what solves for rows drawn at random.  With diffusion of z, which cells do not resolve, T
is factorised, and so is that of the entropy where heat is conducted.  A density equation that is not linear
has a Jacobian of its own.
"""

from __future__ import annotations

import numpy as np

from ngvisco.algebra import precision
from ngvisco.algebra.factorised import Direct, direct_solver
from ngvisco.algebra.sparse import of_blocks
from ngvisco.forms.terms.heat import Heating, penalty_weight
from ngvisco.forms.upwinding import mean_share
from ngvisco.parallel.exchange import HaloUnknowns
from ngvisco.physics.arrays import Array
from ngvisco.reduced.operators import FacetMass, SideOperators
from ngvisco.reduced.residual import Evaluation, ReducedResidual

LEAST, MOST = 3, 30
"""Sweeps over the cells in which the fields' change is carried into the flow's system."""
SHARE = 0.05
"""What they may leave of a field."""


class FacetCoupling:
    """Builds the blocks for weights at the sides' points; the functions there are known once."""

    def __init__(self, sides: SideOperators, mass: FacetMass) -> None:
        z, per = sides.z, sides.points.per_side
        self.cells, self.functions = z.cells, z.local
        self.sides = z.per_cell // per
        count = self.cells * self.sides
        self._weights = sides.points.weights.reshape(count, per, 1)
        self._z = z.blocks.reshape(count, per, self.functions)
        self._z_t = self._z.transpose(0, 2, 1)
        self._hat = np.ascontiguousarray(mass.shapes.T).reshape(count, per, len(mass.shapes))
        self._hat_t = self._hat.transpose(0, 2, 1)
        self._facet = mass.facet[::per]
        self._mass, self.halo = mass, mass.halo
        order = np.argsort(self._facet, kind="stable")
        first = np.flatnonzero(np.diff(self._facet[order]) == 0)
        one, other = order[first], order[first + 1]
        self.across = np.arange(count)
        """The side of the other cell, (sides,); itself on the boundary; beyond all sides on another rank."""
        self.across[one], self.across[other] = other, one
        side_of = np.zeros(len(mass.unknowns), dtype=np.int64)
        side_of[self._facet] = np.arange(count)
        self._border = side_of[mass.of_facets.places]
        self.across[self._border] = count + np.arange(len(self._border))
        self._inner = (self.across != np.arange(count))[:, None, None]
        beyond = self.across - count
        cell = np.where(beyond < 0, self.across // max(self.sides, 1), self.cells + beyond)
        self.neighbours = cell.reshape(self.cells, self.sides)
        """The cell across each side, (cells, sides)."""

    def blocks(
        self,
        own: np.ndarray,
        to_trace: np.ndarray,
        from_trace: np.ndarray,
        values: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of int (own z + from_trace z_hat) q, where mass z_hat = int to_trace z t of both sides.

        Parameters
        ----------
        own, to_trace, from_trace : ndarray, shape (sides' points,)
        values : ndarray, shape (cells, points, functions), optional
            Of the functions in the place of z at the sides' points; default their own.

        Returns
        -------
        of the cell's own values, (cells, q, q), and of those across each side, (cells, sides, q, q)
        """
        shape, w = self._weights.shape, self._weights
        z = self._z if values is None else values.reshape(self._z.shape)
        to_hat = np.matmul(self._hat_t, (w * to_trace.reshape(shape)) * z)
        from_hat = np.matmul(self._z_t, (w * from_trace.reshape(shape)) * self._hat)
        from_hat = np.matmul(from_hat, self._mass.inverses[self._facet])
        here = np.matmul(self._z_t, (w * own.reshape(shape)) * z) + np.matmul(from_hat, to_hat)
        if len(self._border):
            to_hat = np.concatenate([to_hat, self.halo.swapped(to_hat[self._border])])
        there = np.matmul(from_hat, to_hat[self.across]) * self._inner
        by_cells = (self.cells, self.sides, self.functions, self.functions)
        return here.reshape(by_cells).sum(axis=1), there.reshape(by_cells)


class ConductionBlocks:
    """The conduction of heat in the transport of the entropy: its blocks at an evaluation.

    What dR_s/ds has of a(theta, q/zeta_s) and of walls (``ngvisco.forms.terms.heat``), with theta'(s)/zeta_s
    and kappa one number in each cell.
    """

    def __init__(self, residual: ReducedResidual, term: Heating, coupling: FacetCoupling) -> None:
        self.residual, self.term, self.coupling = residual, term, coupling
        op, sides = residual.op, residual.side_op
        self.component = residual.step.layout.states.slices[term.entropy.name].start
        weights = op.weights.reshape(coupling.cells, op.z.per_cell, 1)
        self._laplacian = sum(np.matmul((weights * D.blocks).transpose(0, 2, 1), D.blocks) for D in op.dz)
        self._outwards = np.zeros((sides.points.count, op.z.blocks.shape[2]))
        for n, D in zip(sides.points.normals, sides.dz, strict=True):
            entries = D.matrix.tocoo()
            functions = entries.col % self._outwards.shape[1]
            np.add.at(self._outwards, (entries.row, functions), n[entries.row] * entries.data)
        self._share = mean_share(sides.inner)

    def __call__(self, at: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        """(cells, q, q) and (cells, sides, q, q)."""
        r, coupling, i, z = self.residual, self.coupling, self.component, at.cells.z.value
        along = np.zeros_like(z)
        along[i] = 1.0
        slope = r.slope.derivative(z)(along)[i] / (self.term.entropy.unit * at.cells.zeta.value[i])  # K/Pa
        kappa = self.term.conductivity(at.cells)
        kappa = kappa.value if isinstance(kappa, Array) else np.full(z.shape[1], kappa)

        def mean(values: np.ndarray) -> np.ndarray:
            per = r.op.z.per_cell  # none on a rank without cells
            return values.reshape(coupling.cells, per).sum(axis=1) / max(per, 1)

        def on_sides(values: np.ndarray) -> np.ndarray:
            return np.repeat(values, r.side_op.points.count // max(coupling.cells, 1))

        slope = mean(slope)
        weight = slope * mean(kappa)
        inner, of_sides = r.side_op.inner, on_sides(weight)
        penalty = penalty_weight(r.step.discretisation.m) * of_sides / r.side_op.h
        # half of the sum of both sides' penalties times what is missing to the mean
        jump = 0.5 * inner * r.trace_mass.summed(penalty / r.side_op.points.per_side)
        through = sum((each.value for each in self.term.exchange(at.facets)), 0.0) * on_sides(slope)
        own, across = coupling.blocks(jump + through, self._share, -jump)
        flux = self._share * of_sides
        more, beyond = coupling.blocks(-inner * of_sides, flux, inner, self._outwards)
        return own + more + weight[:, None, None] * self._laplacian, across + beyond


class SweptMatrix:
    """A matrix of cells' blocks in single precision, and an approximate inverse by sweeps over the cells."""

    def __init__(self, own: np.ndarray, across: np.ndarray, coupling: FacetCoupling) -> None:
        """Blocks as of ``FacetCoupling.blocks``."""
        count, sides, q, _ = across.shape
        self._coupling, self._own = coupling, own
        self._across = across.transpose(0, 2, 1, 3).reshape(count, q, sides * q)
        self._rows = np.concatenate([own, self._across], axis=2).astype(precision.SINGLE)

    def invert(self) -> SweptMatrix:
        """The cells' own blocks; LinAlgError where one is singular."""
        inverse = np.linalg.inv(self._own)
        self.cells = inverse.astype(precision.SINGLE)
        self._carried = (-np.matmul(inverse, self._across)).astype(precision.SINGLE)
        return self

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Rows of coefficients x, both (cells' unknowns, n) or (cells' unknowns,)."""
        values = self._by_cells(x)
        return np.matmul(self._rows, np.concatenate([values, self._beside(values)], axis=1)).reshape(x.shape)

    def swept(self, r: np.ndarray, sweeps: int) -> np.ndarray:
        """Coefficients of rows r, (cells' unknowns, n) or (cells' unknowns,)."""
        x = start = np.matmul(self.cells, self._by_cells(r))
        for _ in range(sweeps - 1):
            x = start + self.carried(x)
        return x.reshape(r.shape)

    def carried(self, x: np.ndarray) -> np.ndarray:
        """What a sweep takes from the neighbours' values, (cells, q, n)."""
        return np.matmul(self._carried, self._beside(x))

    def _by_cells(self, x: np.ndarray) -> np.ndarray:
        values = x.astype(precision.SINGLE, copy=False)
        return values.reshape(*self._own.shape[:2], x.shape[1] if x.ndim == 2 else 1)

    def _beside(self, x: np.ndarray) -> np.ndarray:
        """The neighbours' values side by side, (cells, sides q, n), of values (cells, q, n)."""
        neighbours = self._coupling.neighbours
        beside = self._coupling.halo.with_others(x)[neighbours]
        return beside.reshape(len(neighbours), neighbours.shape[1] * x.shape[1], x.shape[2])


class TransportSweeps:
    """Approximate inverses of the scalar transport of z and of the density equation."""

    def __init__(self, residual: ReducedResidual) -> None:
        self.residual, self.sweeps = residual, LEAST
        self.coupling = FacetCoupling(residual.side_op, residual.trace_mass)
        op = residual.op
        self._shape = (self.coupling.cells, op.z.per_cell, 1)
        self._tests = np.ascontiguousarray((op.weights.reshape(self._shape) * op.z.blocks).transpose(0, 2, 1))
        self._mass = np.matmul(self._tests, op.z.blocks)
        self._flat: np.ndarray | None = None
        """Functions of a cell at its sides' points, without their slopes, as they flow in through walls."""
        self._whole: Direct | None = None
        """Of z where it diffuses."""
        if residual.diffusion is not None:
            self._laplacian = residual.diffusion.laplacian(residual.inverse_mass)
            self._unknowns = residual.diffusion.unknowns
            self._whole = direct_solver(np.ones(self._unknowns.count, dtype=bool), self._unknowns)
        self._conduction: ConductionBlocks | None = None
        for term in residual.claims.conducting:
            self._conduction = ConductionBlocks(residual, term, self.coupling)
            self._of_heat = HaloUnknowns(self.coupling.halo, op.z.blocks.shape[2])
            self._heat = direct_solver(np.ones(self._of_heat.count, dtype=bool), self._of_heat)
        self.of_rho: SweptMatrix | None = None
        self._density: Direct | None = None
        """Of a density equation that is not linear, in place of ``of_rho``."""
        if residual.density is not None:
            u = residual.unknowns
            shared = residual.exchange.part(np.arange(u.size)[u.density_slice])
            self._density = direct_solver(residual.density.free, shared)

    def update(self, at: Evaluation) -> None:
        """Form the matrices and invert at an evaluation."""
        r, coupling = self.residual, self.coupling
        storage, convection = r.step.context.rate(self._mass), self._convection(at)
        share = mean_share(r.side_op.inner)
        through = r.side_op.crossed * (r.side_op.points.normals * at.facets.v.value).sum(axis=0)
        inward = through - abs(through)
        own, across = coupling.blocks(-inward, share, inward)
        own += self._entering("z", at, inward)
        own += storage + convection
        if self._whole is not None:
            transport = of_blocks(own, across, coupling.neighbours, coupling.halo.count)
            self._whole.factorise((transport + self._laplacian).tocsr())
        if self._conduction is not None:
            here, there = self._conduction(at)
            self._heat.factorise(
                of_blocks(own + here, across + there, coupling.neighbours, coupling.halo.count)
            )
            self._conducted = SweptMatrix(here, there, coupling)
        with r.ranks.together(np.linalg.LinAlgError):
            self.of_z = SweptMatrix(own, across, coupling).invert()
        self._count_sweeps()
        if self._density is None and r.unknowns.density:
            own, across = coupling.blocks(abs(through), share, inward)
            own += self._entering("rho", at, inward)
            own += storage - convection.transpose(0, 2, 1)
            with r.ranks.together(np.linalg.LinAlgError):
                self.of_rho = SweptMatrix(own, across, coupling).invert()

    def _entering(self, name: str, at: Evaluation, inward: np.ndarray) -> np.ndarray | float:
        """What the rows of ``"rho"`` or ``"z"`` take from what flows in through walls."""
        known, passages = at.facets.context.given, self.residual.step.context.passages
        if not passages:
            return 0.0
        none = np.zeros_like(inward)
        result = np.zeros_like(self._mass)
        for wall in passages:
            flow = -0.5 * inward * known(wall.indicator).value
            result = result + self.coupling.blocks(flow, none, none)[0]
            if wall.continues(name):
                result = result - self.coupling.blocks(flow, none, none, self._without_slopes(at))[0]
        return result

    def _without_slopes(self, at: Evaluation) -> np.ndarray:
        """Functions of a cell at its sides' points, those of its middle."""
        reach = at.facets.context.reach
        if self._flat is None:
            self._flat = flat = self.residual.side_op.z.blocks.copy()
            if reach is not None:
                points, lengths = flat.reshape(-1, flat.shape[-1]), at.facets.context.given(reach).value
                for length, D in zip(lengths, self.residual.side_op.dz, strict=True):
                    entries = D.matrix.tocoo()
                    slopes = length[entries.row] * entries.data
                    np.subtract.at(points, (entries.row, entries.col % flat.shape[-1]), slopes)
        return self._flat

    def _count_sweeps(self) -> None:
        """How many sweeps the present transport takes, by what they leave of a field drawn at random."""
        count, q = self._mass.shape[:2]
        x = np.random.default_rng(0).standard_normal((count, q, 1)).astype(precision.SINGLE)
        norm = self.residual.ranks.norm
        size, number = SHARE * norm(x.ravel()), 0
        # the error of n sweeps is the n-th power of what carries from cell to cell
        while number < MOST and (number < LEAST or norm(x.ravel()) > size):
            x = self.of_z.carried(x)
            number += 1
        self.sweeps = number

    def _convection(self, at: Evaluation) -> np.ndarray:
        """int (v . grad z) q in cells, (cells, q, q)."""
        v, derivatives = at.cells.v.value, self.residual.op.dz
        along = sum(v_j.reshape(self._shape) * D.blocks for v_j, D in zip(v, derivatives, strict=True))
        return np.matmul(self._tests, along)

    def linearise(self) -> None:
        """Let a density equation that is not linear follow the present state."""
        if self._density is not None and self.residual.density is not None:
            self._density.factorise(self.residual.density.jacobian())

    def fields(self, r: np.ndarray) -> np.ndarray:
        """Increments of z before rates and creep, of rows r: both (cells' unknowns, n)."""
        result = self.of_z.swept(r, self.sweeps)
        if self._whole is not None and self.residual.diffusion is not None:
            for i in np.flatnonzero(self.residual.diffusion.strains):
                result[:, i] = _solved(self._whole, self._unknowns, r[:, i])
        if self._conduction is not None:
            i = self._conduction.component
            result[:, i] = _solved(self._heat, self._of_heat, r[:, i])
        return result

    def in_cells(self, rows: np.ndarray) -> np.ndarray:
        """The cells' own inverses times ``rows``, (cells' unknowns, .): no sweep, no diffusion."""
        return self.of_z.swept(rows, 1)

    def density(self, r: np.ndarray) -> np.ndarray:
        """Increments of the density's unknowns, of rows (unknowns,), or of (cells' unknowns, .) by sweeps."""
        if self._density is not None:
            return self._density(r)
        assert self.of_rho is not None
        return self.of_rho.swept(r, self.sweeps)

    def rows(self, x: np.ndarray) -> np.ndarray:
        """T x, of coefficients x of the fields: both (cells' unknowns, n)."""
        rows = self.of_z(x)
        if self.residual.diffusion is not None:
            strains = self.residual.diffusion.strains
            beyond = self._unknowns.with_others(x[:, strains].T)
            rows[:, strains] += self._unknowns.added((self._laplacian @ beyond.T).T).T
        if self._conduction is not None:
            i = self._conduction.component
            rows[:, [i]] += self._conducted(x[:, [i]])
        return rows


def _solved(solver: Direct, unknowns: HaloUnknowns, rows: np.ndarray) -> np.ndarray:
    """By a factorisation over ranks, of rows of this rank's cells."""
    return solver(unknowns.of_cells_alone(rows))[: unknowns.of_cells]
