"""Upwinding across facets: the one place where a cell's outflow is told from its inflow.

With a = v . n, zero on walls, and the smooth modulus |a|_eta = sqrt(a^2 + eta^2),

    n^- = (1 - a/|a|_eta)/2     near 1 where v enters a cell, near 0 where it leaves; 0 on walls,
    a^+- = (|a|_eta +- a)/2     > 0.

The shares of both sides of a facet are 1 - n^- in (0, 1) and sum up to one, so that a trace weighted by them
is a convex combination whatever v . n.  With the weight (v . n)^+ smoothed as (v . n)(1 + sigma)/2 it is not:
that weight is negative for small v . n < 0, and the trace ~ [z] eta/(v . n) where the flow turns round.
"""

from __future__ import annotations

from ngsolve import CoefficientFunction

from ngvisco.physics.tensors import sqrt


def mean_share(inner: CoefficientFunction) -> CoefficientFunction:
    """1 - n^- for v = 0.  Both sides' shares sum up to the same whatever v, so that a trace's mass matrix is
    that of these: 1/2 between two cells, 1 on walls."""
    return 1.0 - 0.5 * inner


class Upwinding:
    """n^-, a^+ and a^- of coefficient functions or of arrays."""

    def __init__(
        self, through: CoefficientFunction, inner: CoefficientFunction, eta: CoefficientFunction | float
    ) -> None:
        """``through`` is v . n (m/s) also on walls, ``inner`` 1 between two cells and 0 on walls.

        ``eta`` is the width of the smoothed sign, m/s.
        """
        self.through = through
        self.normal_velocity = a = inner * through
        self.modulus = sqrt(a * a + eta * eta)
        self.inflow = 0.5 * (inner - a / self.modulus)

    @property
    def share(self) -> CoefficientFunction:
        """1 - n^-: what the cell's own value counts in the upwind trace."""
        return 1.0 - self.inflow

    @property
    def carried(self) -> CoefficientFunction:
        """(v . n) n^-, m/s."""
        return self.through * self.inflow

    @property
    def outward(self) -> CoefficientFunction:
        """a^+, m/s."""
        return 0.5 * (self.modulus + self.normal_velocity)

    @property
    def inward(self) -> CoefficientFunction:
        """a^-, m/s."""
        return 0.5 * (self.modulus - self.normal_velocity)
