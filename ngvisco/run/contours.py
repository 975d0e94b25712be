"""Outlines of bodies over time, as a table and as lines for ParaView."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ngvisco.errors import ParameterError, Quantity, require_known, require_path, require_some_names
from ngvisco.run.body_tables import require_bodies
from ngvisco.run.files import AnyPath
from ngvisco.run.fraction_samples import FractionSamples
from ngvisco.run.series import Every, Series
from ngvisco.run.vtu import StateFiles, write_lines

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation


class Contours(Series):
    """The lines where the volume fraction of a body is one half, over time, in two dimensions.

    Each row is a point of a line.  The columns are ``step``, ``time`` (s), ``body`` (number of the body from
    1, as in the field ``body``), ``line`` (number from 1 of the line of this body), ``x`` and ``y`` (m). The
    rows follow the line with the body on the left; a closed line ends with its first point.  In the .vtu
    files cells are segments, with the numbers ``body`` and ``line`` at their points.
    A run raises ParameterError for a model without bodies and in three dimensions, UnknownNameError for an
    unknown body.

    Parameters
    ----------
    directory : path, optional
        Directory of ``contours.csv``, and of ``contours.pvd`` with its ``.vtu`` files for ParaView, made if
        missing; without a directory the rows are kept in memory only.
    bodies : sequence of str, optional
        Names of bodies; default all bodies that have a place.
    """

    def __init__(
        self,
        directory: AnyPath | None = None,
        bodies: Annotated[Sequence[str] | None, Quantity(example=["disc"])] = None,
        every: Every = 1,
    ) -> None:
        place = None if directory is None else require_path("Contours.directory", directory)
        super().__init__(None if place is None else place / "contours.csv", every)
        self.files = None if place is None else StateFiles(place, "contours")
        self.bodies = None if bodies is None else require_some_names("Contours.bodies", bodies)

    def prepare(self, simulation: Simulation) -> list[str]:
        bodies = require_bodies("Contours", simulation.model.material)
        if simulation.mesh.dim != 2:
            expected = "no contours in 3D; ParaView can draw the surfaces"
            raise ParameterError("Contours.bodies", self.bodies, expected)
        numbers = {body.name: number for number, body in enumerate(bodies, start=1)}
        require_known("body", self.bodies or (), numbers, "Contours.bodies")
        chosen = self.bodies or [body.name for body in bodies if body.where is not None]
        self._numbers = {name: numbers[name] for name in chosen}
        self._fractions = FractionSamples(simulation.rothe_step, simulation.ranks, chosen)
        return ["body", "line", "x", "y"]

    def start(self, simulation: Simulation) -> None:
        if self.files is not None:
            self.files.begin(simulation.t * (1 + 1e-12) if simulation.number else None, simulation.ranks)
        super().start(simulation)

    def _sample(self, simulation: Simulation) -> Any:
        self._fractions.read()
        rows, segments = [np.zeros((0, 4))], [np.zeros((0, 2), dtype=int)]
        for name, number in self._numbers.items():
            for i, line in enumerate(self._fractions.cut(name).lines(), start=1):
                first = sum(map(len, rows))
                rows.append(np.column_stack([np.tile([number, i], (len(line), 1)), line[:, :2]]))
                segments.append(first + np.arange(len(line) - 1)[:, None] + [0, 1])
        table = np.concatenate(rows)
        if (files := self.files) is not None:
            path, columns = files.path(simulation.number), {"body": table[:, :1], "line": table[:, 1:2]}
            points = np.pad(table[:, 2:], ((0, 0), (0, 1)))
            simulation.ranks.on_first(lambda: write_lines(path, points, np.concatenate(segments), columns))
            files.add(simulation.t, path.name, simulation.ranks)
        return table
