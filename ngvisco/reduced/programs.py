"""Programs of the terms' integrals over the cells, recorded at the first iterate of a step.

Fields are functions of the unknowns' coefficients.  Between the iterates of a step only these change: data
of the step are constants of a program.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable

import numpy as np

from ngvisco.physics.recording import Arrays, Program


class Programs:
    """Programs by the names of their functions; a function that cannot be recorded is evaluated each time."""

    def __init__(self) -> None:
        self._programs: dict[Hashable, Program] | None = None
        self._others: set[Hashable] = set()
        """Names of functions that cannot be recorded."""

    def start(self, records: bool) -> None:
        """Forget all programs, whose data may have changed; record new ones if ``records``."""
        self._programs = {} if records else None

    @property
    def names(self) -> list[Hashable]:
        """Names of the functions that have programs."""
        return sorted(self._programs or {}, key=str)

    def __call__(self, name: Hashable, function: Callable[[Arrays], Arrays], c: Arrays) -> Arrays:
        """``function(c)`` for coefficients ``c``."""
        programs = self._programs
        if programs is None or name in self._others or any(map(np.iscomplexobj, c.values())):
            return function(c)
        if name in programs:
            return programs[name](c)
        try:
            programs[name], results = Program.of(function, c)
        except Exception:  # whatever a function of arrays does with arrays of another class
            self._others.add(name)
            return function(c)
        return results
