"""Programs of the terms' integrals over the cells, recorded once and repeated in later iterates and steps.

Fields are functions of the unknowns' coefficients.  Between the iterates of a step only the coefficients
change.  The data of a step, which the contexts of ``evaluation`` provide, change from step to step
(``datum``).  All other data of a term stay constant through a run (``ngvisco.forms.term``).  The second step
compares the first results of each program with those of the program's function.  If a bit differs, the
function is recorded anew in each step.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable

import numpy as np

from ngvisco.physics.recording import Arrays, Program


class Programs:
    """Programs by the names of their functions; a function that cannot be recorded is evaluated each time."""

    def __init__(self, keeps: bool = True) -> None:
        """If ``keeps`` is True, a program reads the data of a step once and keeps them until the next step.
        Otherwise it reads them at each evaluation, since the data at the points of a large mesh would take
        much memory."""
        self._keeps = keeps
        self._programs: dict[Hashable, Program] = {}
        self._others: set[Hashable] = set()
        """Names of functions that cannot be recorded."""
        self.varying: set[Hashable] = set()
        """Names of functions that are recorded in each step."""
        self._compared: set[Hashable] = set()
        """Names of functions whose program has given the function's own bits in a second step."""
        self._numbers: tuple[float, ...] = ()
        self._runs, self._begun = False, set[Hashable]()
        """Two values: whether programs evaluate functions now, and the names of earlier steps' programs."""

    def start(self, runs: bool, *numbers: float) -> None:
        """Begin a step.  If ``runs`` is True, programs evaluate the functions until the next call.

        ``numbers``, such as the step's length, are constants of the recorded programs: if one of them
        changes, all programs are recorded anew.
        """
        self._runs = runs
        if not runs:
            return
        old = list(self._programs) if numbers != self._numbers else self.varying
        for name in old:
            self._programs.pop(name, None)
        self._numbers = numbers
        for program in self._programs.values():
            program.begin()
        self._begun = set(self._programs)

    @property
    def names(self) -> list[Hashable]:
        """Names of the functions that programs evaluate."""
        return sorted(self._programs, key=str) if self._runs else []

    def __call__(self, name: Hashable, function: Callable[[Arrays], Arrays], c: Arrays) -> Arrays:
        """``function(c)`` for coefficients ``c``."""
        if not self._runs or name in self._others or any(map(np.iscomplexobj, c.values())):
            return function(c)
        if name in self._programs:
            found = self._programs[name](c)
            if name not in self._begun or name in self._compared:
                return found
            expected = function(c)
            if all(np.array_equal(found[key], value, equal_nan=True) for key, value in expected.items()):
                self._compared.add(name)
                return found
            self.varying.add(name)
        try:
            self._programs[name], results = Program.of(function, c, self._keeps)
        except Exception:  # any function may raise any error for arrays of a class that it does not know
            self._others.add(name)
            return function(c)
        self._begun.discard(name)
        return results
