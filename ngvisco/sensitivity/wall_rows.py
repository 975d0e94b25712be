"""Columns with rows of the residual: forces on walls, impulses of walls, and powers of moving walls."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from ngsolve import BilinearForm

from ngvisco.run.probes import WallForces
from ngvisco.sensitivity.follower import Follower


class WallRows:
    """Columns that are weighted sums c . R(u; .) of the residual's rows: the weights c, and the slopes
    R_u^T c.

    The weights c, (numbers, unknowns), have a row for each differentiated number.  They follow from the
    weights of the columns in the numbers, (numbers, columns).  A force has constant c; the power of a moving
    wall has c = v on the wall. At a stage the densities of impulses contain the walls' multipliers. The
    equation of a combined end has no multipliers, so that all of its rows are the walls' impulse.
    """

    def __init__(self, follower: Follower) -> None:
        self.follower, step, self.names = follower, follower.step, follower.columns.names
        rows_of_v = step.layout.ranges["v"]
        self.forces: dict[str, np.ndarray] = {}
        """Constant weights of the rows of a force or an impulse, (unknowns,)."""
        self.ends: dict[str, np.ndarray] = {}
        """Constant weights at a combined end, if they differ from the weights at a stage, (unknowns,)."""
        self.powers: dict[str, np.ndarray] = {}
        """Masks of a moving wall's rows, (unknowns,)."""
        for table in follower.columns.tables:
            if isinstance(table, WallForces):
                table.prepare(follower.simulation)
                for wall in table.reactions.names:
                    for motion in table.reactions.motions:
                        if (name := f"{wall}.{motion}") in self.names:
                            self.forces[name] = np.zeros(step.layout.space.ndof)
                            self.forces[name][rows_of_v] = table.reactions.weights(wall, motion)
        momentum = follower.simulation.ledger.momentum
        for name, number in momentum.held.items():
            if name in self.names:
                for of_names, velocities in (
                    (self.forces, momentum.impulses.held_velocities),
                    (self.ends, momentum.impulses.velocities),
                ):
                    of_names[name] = np.zeros(step.layout.space.ndof)
                    of_names[name][rows_of_v] = velocities[number]
        for wall, (_, mask) in step.moving_walls.moving.items():
            if (name := f"power_wall_{wall}") in self.names:
                self.powers[name] = np.zeros(step.layout.space.ndof, dtype=bool)
                self.powers[name][rows_of_v] = mask

    @cached_property
    def _form(self) -> BilinearForm:
        rows = self.follower.step.layout.ranges["v"]
        parts = [weights != 0 for weights in (*self.forces.values(), *self.powers.values())]
        return self.follower.step.residual_at(np.logical_or.reduce(parts)[rows], condense=False)

    def weights(self, of_columns: np.ndarray, v: np.ndarray | None, at_end: bool = False) -> np.ndarray:
        """Weights c of the residual's rows in each number, at a stage, or with ``at_end`` at a combined end.

        For the power of a moving wall the weights are the velocities ``v`` of a state; without ``v`` these
        weights are zero.
        """
        result = np.zeros((len(of_columns), self.follower.step.layout.space.ndof))
        for name, c in (self.forces | self.ends if at_end else self.forces).items():
            result += np.outer(of_columns[:, self.names.index(name)], c)
        if v is not None:
            result += self.of_velocity(of_columns, v)
        return result

    def of_velocity(self, of_columns: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Products of moving walls' rows with ``values``.

        If ``values`` are coefficients of v, the result has weights of the rows; if ``values`` are rows of the
        residual, the result has slopes by v.
        """
        result = np.zeros((len(of_columns), len(values)))
        for name, mask in self.powers.items():
            result += np.outer(of_columns[:, self.names.index(name)], np.where(mask, values, 0.0))
        return result

    def slopes(self, of_columns: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Slopes of c . R by the present state, which has to be the solution of the posed stage."""
        if not c.any():
            return np.zeros_like(c)
        state = self.follower.step.state.vec
        rows, product = (state.CreateVector() for _ in range(2))
        self._form.AssembleLinearization(state)
        result = np.zeros_like(c)
        for slope, weights in zip(result, c, strict=True):
            rows.FV().NumPy()[:] = weights
            product.data = self._form.mat.T * rows
            slope[:] = product.FV().NumPy()
        if self.powers:
            self._form.Apply(state, rows)
            result += self.of_velocity(of_columns, rows.FV().NumPy())
        return result
