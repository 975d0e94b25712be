"""Warns if two parts of a body's surface transmit forces before they touch."""

from __future__ import annotations

from ngvisco.errors import NgviscoWarning
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.run.fraction_samples import FractionSamples

_MOVED = 0.25
"""Distance, in cells, that matter may move between two examinations of the surfaces."""


class SelfContactWarning(NgviscoWarning):
    """Two parts of a body's surface are less than 1.5 cells apart, and transmit forces before they touch."""


class SelfContact:
    """Warning, once for each body that has a place, that parts of the body's surface face each other within
    1.5 cells.

    Surfaces are examined after the first step, and whenever matter may have moved by a quarter of a cell, so
    that the examinations cost little beside the steps.
    """

    def __init__(self, step: Step, ranks: Communicator) -> None:
        self._step, self._ranks, self._moved = step, ranks, _MOVED
        self._left = [body.name for body in step.model.bodies if body.where is not None]
        """Names of bodies without a warning."""
        self._samples: FractionSamples | None = None

    def __call__(self, t: float, courant: float) -> None:
        """Examine the state at the time ``t``, s, after a step with the Courant number ``courant``."""
        self._moved += courant
        if not self._left or self._moved < _MOVED:
            return
        if self._samples is None:
            self._samples = FractionSamples(self._step, self._ranks, self._left)
        self._moved, samples = 0.0, self._samples
        self._step.local_unknowns.update_stored()
        samples.read()
        widths = {name: samples.facing(name) for name in self._left}
        self._left = [name for name, cells in widths.items() if cells is None]
        for name, cells in widths.items():
            if cells is None:
                continue
            message = (
                f"at t = {t:.4g} s parts of the surface of the body {name!r} face each other at a "
                f"distance of {cells:.2g} cells. Such parts push each other before they touch, and may "
                "stick; take smaller cells there"
            )
            self._ranks.warn(message, SelfContactWarning, stacklevel=5)
