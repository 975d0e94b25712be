"""The velocity of a momentum functional: int rho v . w = <m, w> for all admissible w.

v attains the maximum in E(rho, m) = max_w <m, w> - 1/2 int rho |w|^2 over the velocities that the walls
admit: prescribed coefficients are kept, and on oblique and curved walls (v . n, mu) = 0 for all multipliers
mu (paper: Euler-small-BC-hyper).  The mass matrix is that of one scalar component; conjugate gradients with
its diagonal take 30 to 60 iterations whatever the mesh.  With multipliers they run in the null space of the
walls' condition, by the projection onto it in the inner product of that diagonal (``WallProjection``).
"""

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from ngsolve import CF, BilinearForm, CoefficientFunction, GridFunction, LinearForm

from ngvisco.algebra.krylov import conjugate_gradients
from ngvisco.errors import StepError
from ngvisco.forms.boundary.wall_projection import WallProjection
from ngvisco.forms.boundary.wall_terms import Impenetrability
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.spaces import Layout
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.tensors import inner

_REDUCTION, _CORRECTIONS, _ITERATIONS = 1e-9, 4, 1000
_ROUNDING, _ENOUGH = 3e-16, 1e-13
"""Residual that is aimed at and accepted, relative to <m, .>; it enters the energy's closure."""


class VelocityOfMomentum:
    """Solves for the velocity in the state of a layout.

    Parameters
    ----------
    state : GridFunction
        Of the layout; its v is both the start value and, where it is prescribed, given.
    density : CoefficientFunction
        rho > 0, kg/m^3.
    momentum : CoefficientFunction
        Values of m, kg/(m^2 s), at the points of ``quadrature``.
    term : Impenetrability or None
        None where there are no multipliers.
    """

    def __init__(
        self,
        layout: Layout,
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
        self._mass += (density * trial * test).Compile() * quadrature.cells
        self._load = LinearForm(space)
        self._load += inner(momentum, space.TestFunction()) * quadrature.cells
        self.free = mask_of(space.FreeDofs())
        self._exchange = Exchange.of(space, Communicator.of(layout.mesh))
        # what ranks share counts once in products
        several = self._exchange.communicator.is_distributed
        self._own = self._exchange.owned if several else slice(None)
        self._own_free = self._exchange.owned[self.free] if several else slice(None)
        self._dim = layout.mesh.dim
        self._walls = None if term is None else WallProjection(layout, term, quadrature, self.free)

    def functional(self) -> np.ndarray:
        """<m, .> in this rank's cells, (unknowns of v,)."""
        return self._load.Assemble().vec.FV().NumPy().copy()

    def __call__(self) -> np.ndarray:
        """Solve; returns the rows of int rho v . w - <m, w>, which only walls leave, (unknowns of v,).

        The rows are those of this rank's cells: what ranks share is their sum.  Raises StepError when the
        linear system is not solved to rounding.
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
            v[free] = self._walls.completed(v)  # a start value that the walls admit
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
            # twice: beside the walls' share of the rows a small rest is rounding, not in the operator's range
            residual = project_back(project_back((momentum - exchange.sum(mass @ v))[free]))
            last, left = left, ranks.norm(residual[self._own_free])
            if left <= _ROUNDING * size or not left < 0.5 * last:
                break
            change = conjugate_gradients(operator, residual, inverse, product, _REDUCTION, _ITERATIONS)
            v[free] += project(change)
        if not left <= _ENOUGH * size:
            raise StepError(f"the velocity of a momentum was solved to {left / size:.1e} only")
        return mass @ v - rows


def _same(x: np.ndarray) -> np.ndarray:
    return x


def project_velocity(
    layout: Layout,
    state: GridFunction,
    v_0: CoefficientFunction,
    term: Impenetrability | None,
    quadrature: Quadrature,
) -> None:
    """v as the L2 projection of v_0 on the velocities with (v.n, mu) = 0 for all multipliers mu.

    Prescribed coefficients of v are kept as they are; ``term`` is None where there are no multipliers.
    """
    VelocityOfMomentum(layout, state, CF(1.0), CF(v_0), term, quadrature)()
