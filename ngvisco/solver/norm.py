"""The norm of an increment.

|d| = max over the unknowns u that evolve of |d_u|_2 / scale_u, in coefficients, with scale_v = |v|_2 + f
sqrt(n) h/tau and scale_u = |u|_2 + f sqrt(n) s_u, where n is the number of the block's coefficients and h the
smallest cell size: a velocity counts by the strain that it makes in the step; s_u is the unknown's scale, 0
of rho and 1 of z.  The other unknowns are functions of these; the trace of a density that diffuses by an
r-Laplacian, a nonlinear one, counts like rho. A creep rate field Pi changes z by tau Pi only, which leaves it
open in a short step: with nu > 0 it counts by s |dPi|_2/(|Pi|_2 + |dPi|_2 + f sqrt(n)/tau).  A variable
with an ``own_scale``, as the entropy, counts once more by itself.  The floor f and
the share s are below; the floor lets small strains and velocities converge relatively to
themselves, and a stalled iteration is asked about with a larger one, but for Pi.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from ngsolve import BaseVector

from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange

FLOOR = 1e-9
"""Small strains and velocities converge relatively to themselves, as the ledger needs."""
COARSE_FLOOR = 1e-3
"""By it a stalled iteration is asked: near a state of rest the other floor is below rounding."""
SHARE = 1e-4
"""What the relative increment of a creep rate field counts; steps stall where it is 1.  Left out, Pi was
4 % off in a step of 1e-8 s.  In steps in which its strain is below the floor it still is left open: 3e-5
off in 1e-11 s, 4 % in 1e-13 s, with a relaxation time of 2 s."""


class BlockNorm:
    """The norm of the module's docstring.

    Parameters
    ----------
    ranges : mapping of block names to slices of the coefficient vector
    units : mapping of the counted blocks' names to the size that one unit of the floor f has there
    shared : collection of str
        Those of them that count by ``SHARE`` of their relative increment.
    exchange : Exchange, optional
        Of the vectors' space, where it may be distributed.
    """

    def __init__(
        self,
        ranges: Mapping[str, slice],
        units: dict[str, float],
        exchange: Exchange | None = None,
        shared: Collection[str] = (),
    ) -> None:
        self.ranges, self.units = ranges, units
        self.shared = tuple(shared)
        self._ranks = Communicator() if exchange is None else exchange.communicator
        self._own: dict[str, slice | np.ndarray] = {name: ranges[name] for name in units}
        if exchange is not None and self._ranks.is_distributed:  # what ranks share counts once
            for name in units:
                self._own[name] = np.flatnonzero(exchange.owned[ranges[name]]) + ranges[name].start
        self._counts = {name: self._ranks.total(_length(own)) for name, own in self._own.items()}

    def __call__(self, increment: BaseVector, *states: BaseVector, coarse: bool = False) -> float:
        """|increment| with the scales of the largest of ``states`` in each block."""
        return self.sizes(increment, *states, coarse=coarse)[0]

    def sizes(self, increment: BaseVector, *states: BaseVector, coarse: bool = False) -> tuple[float, float]:
        """|increment|, and the relative increment of the shared blocks, in [0, 1]; 0 where there is none."""
        sizes, turned, floor = [], 0.0, COARSE_FLOOR if coarse else FLOOR
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate is inf or NaN here
            vectors = [u.FV().NumPy() for u in (increment, *states)]
            parts = ([vector[own] for vector in vectors] for own in self._own.values())
            squares = np.array([[part @ part for part in of_block] for of_block in parts])
            norms = np.sqrt(self._ranks.totals(squares))  # of all blocks in one reduction
            for (name, unit), (own, *of_states) in zip(self.units.items(), norms, strict=True):
                one = unit * np.sqrt(self._counts[name])
                if name in self.shared:
                    turned = own / (max(of_states) + FLOOR * one + own) if own != 0 else 0.0
                    sizes.append(SHARE * turned)
                else:
                    scale = max(of_states) + floor * one
                    sizes.append(own / scale if scale != 0 else 0.0)
        # numpy's maximum passes NaN on, Python's may drop it
        return float(np.max(sizes)), float(turned)


def _length(own: slice | np.ndarray) -> int:
    return own.stop - own.start if isinstance(own, slice) else len(own)
