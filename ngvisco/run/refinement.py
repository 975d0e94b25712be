"""Meshes that follow what happens: cells of a first mesh divided where a field is steep, time and again.

Every mesh of a run is the first one, bisected by need, so that a cell of one is the same, a part or a union
of cells of another, and what has moved on leaves coarse cells behind.  A state is carried over by
``ngvisco.run.transfer``, without loss onto finer cells if these are straight, and by L2 projection onto
coarser ones; the energy that this takes is the ledger's column ``transfer``.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import CF, VOL, Integrate, Mesh
from scipy.spatial import cKDTree

from ngvisco.errors import (
    MeshError,
    NgviscoWarning,
    ParameterError,
    Quantity,
    UnknownNameError,
    as_number,
    require_fields,
    require_type,
)
from ngvisco.forms.mesh.mesh_arrays import coordinates, is_simplicial, vertices
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import of_whole, whole_of
from ngvisco.run.checkpoint import Checkpoints, ChosenMesh, mesh_of_checkpoints
from ngvisco.run.fields import field_unit
from ngvisco.run.files import AnyPath, mesh_image, mesh_of
from ngvisco.run.scales import Place, diameter, extreme_places
from ngvisco.run.simulation import Simulation
from ngvisco.run.transfer import go_on, require_fit, transfer

_TOO_LARGE = 1.5
"""Volume of a cell over that asked for from which it is divided: bisection gives powers of two."""
_SAME_TIME = 1e-9
"""The share of ``every`` within which a time is one at which the mesh is chosen."""
_FLAT, _ROUNDING = 1e-9, 1e-12
"""The variation below which a field is steep nowhere, over its largest value and over the usual one of the
run."""
_LEVELS = 8


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """Where and how far cells are divided.

    Raises ParameterError for a number out of its range.

    Parameters
    ----------
    field : str
        Among the run's ``fields``, e.g. ``"disc_fraction"`` or ``"creep_rate"``, whose norm counts.
    above : float
        Divided are cells in which, with those around them, the field varies by more than this share of its
        range over the domain.
    levels : int
        How often the edges of a cell of the first mesh are halved at most.
    every : float
        The mesh is chosen anew after so long, a multiple of dt.
    """

    field: Annotated[str, Quantity(example="pressure")]
    above: Annotated[float, Quantity("1", "in (0, 1)", 0.1)] = 0.1
    levels: Annotated[int, Quantity("1", f"from 1 to {_LEVELS}")] = 1
    every: Annotated[float, Quantity("s", "> 0", 0.1)]

    def __post_init__(self) -> None:
        require_fields(self)

    def check(self, simulation: Simulation) -> None:
        """Raise MeshError, ParameterError or UnknownNameError unless a run can follow its field."""
        mesh = simulation.mesh
        if not simulation.ranks.all(is_simplicial(mesh)):
            raise MeshError("only triangles and tetrahedra are bisected; this mesh has other cells")
        simulation.stepper.check("Refinement.every", self.every)
        self.steep(simulation)
        require_fit(simulation, simulation)  # as it will have to on the first other mesh

    def steep(self, simulation: Simulation) -> np.ndarray:
        """Which cells of the whole mesh are to be divided, (cells,), on the first rank; collective."""
        fields = simulation.fields
        if self.field not in fields:
            raise UnknownNameError("Refinement.field", self.field, fields, "Refinement.field")
        mesh, sampler, usual = simulation.mesh, simulation.sampler, self._usual(simulation)
        cells, rows = sampler.points["nr"], sampler.rows(fields[self.field])
        values = rows[:, 0] if rows.shape[1] == 1 else np.linalg.norm(rows, axis=1)
        low, high = np.full(mesh.ne, math.inf), np.full(mesh.ne, -math.inf)
        np.minimum.at(low, cells, values)
        np.maximum.at(high, cells, values)
        whole, low, high = whole_of(mesh), of_whole(mesh, low), of_whole(mesh, high)
        if whole is None:
            return np.zeros(0, dtype=bool)
        extent = high.max() - low.min()
        if extent <= max(_FLAT * max(abs(low).max(), abs(high).max()), _ROUNDING * usual):
            return np.zeros(whole.ne, dtype=bool)
        corners = vertices(whole)
        least, most = np.full(whole.nv, math.inf), np.full(whole.nv, -math.inf)
        np.minimum.at(least, corners, low[:, None])
        np.maximum.at(most, corners, high[:, None])
        return most[corners].max(axis=1) - least[corners].min(axis=1) > self.above * extent

    def _usual(self, simulation: Simulation) -> float:
        """How large velocities, rates and stresses may be; 0 of other fields, which are not small at rest."""
        step, length = simulation.rothe_step, diameter(simulation.mesh, simulation.ranks)
        places = extreme_places(step, simulation.sampler) or [Place(step.model, {}, 1.0, np.empty(0))]
        stress = max(place.density * place.scales(simulation.mesh.dim)[0] ** 2 for place in places)
        velocity = simulation.velocity_scale
        return {"m/s": velocity, "1/s": velocity / length, "Pa": stress}.get(field_unit(self.field), 0.0)


def run_refined(
    simulation: Simulation, refinement: Refinement, until: float, checkpoint: AnyPath | None = None
) -> Simulation:
    """Run on meshes that follow a field, refined from that of ``simulation``; the run on the last mesh.

    It has the ledger of the whole.  Its observers are told of every mesh by ``start``, as of a run that is
    resumed, and the ledger goes on. Raises ParameterError, UnknownNameError, MeshError or CheckpointError for
    what does not fit, before a step is made; StepError as ``Simulation.run``.

    Parameters
    ----------
    simulation : Simulation
        At its own start, on the coarsest mesh, of triangles or tetrahedra.
    until : float
        End of the run, s.
    checkpoint : path, optional
        The HDF5 file of such a run, which then goes on from its last state.
    """
    require_type("run_refined.simulation", simulation, Simulation)
    require_type("run_refined.refinement", refinement, Refinement)
    if simulation.number or simulation.ledger.balance is not None:  # begun, or carried over
        expected = "before its first step"
        raise ParameterError("run_refined.simulation", f"at step {simulation.number}", expected)
    refinement.check(simulation)
    first, chosen = simulation.mesh, None
    if checkpoint is not None:
        chosen = simulation.ranks.on_first(lambda: mesh_of_checkpoints(checkpoint))
        simulation = simulation if chosen is None else simulation.on(mesh_of(chosen.image))
        simulation.restore(checkpoint)
    end = as_number(until)
    if end is None or end < simulation.t:
        raise ParameterError("until", until, f"a finite number >= {simulation.t:g}")
    for simulation, stop in stretches(simulation, refinement, end, first, chosen):  # noqa: B020
        simulation.run(stop)
    return simulation


def stretches(
    simulation: Simulation, refinement: Refinement, until: float, first: Mesh, chosen: ChosenMesh | None
) -> Iterator[tuple[Simulation, float]]:
    """A run on each of its meshes, and until when it is to go on there, s.

    ``simulation`` is at its start on the ``first`` mesh, of which all are refinements, or at a later state on
    a later one, ``chosen``.
    """
    cells, every = _First(first, simulation.ranks, refinement), refinement.every
    if simulation.number == 0 and simulation.ledger.balance is None:
        for _ in range(refinement.levels):  # the start values anew, as sharp as the mesh
            if (finer := cells.under(simulation)) is None:
                break
            simulation, chosen = finer
        _tell_checkpoints(simulation, chosen)
    else:
        _tell_checkpoints(simulation, chosen)
        periods = simulation.t / every
        at_choice = abs(periods - round(periods)) < _SAME_TIME
        if at_choice and (chosen is None or chosen.step != simulation.number) and simulation.t < until:
            simulation = _moved(simulation, cells)
    while True:
        stop = min((math.floor(simulation.t / every + _SAME_TIME) + 1) * every, until)
        stop = until if stop > until * (1 - _SAME_TIME) else stop
        yield simulation, stop
        if simulation.stop_requested or stop == until:
            return
        simulation = _moved(simulation, cells)


def _moved(simulation: Simulation, cells: _First) -> Simulation:
    """The run on the mesh that its present state wants; the same one where that is the one it has."""
    if (found := cells.under(simulation)) is None:
        return simulation
    target, chosen = found
    transfer(simulation, target)
    go_on(simulation, target)
    _tell_checkpoints(target, chosen)
    return target


def _tell_checkpoints(simulation: Simulation, chosen: ChosenMesh | None) -> None:
    for observer in simulation.observers:
        if isinstance(observer, Checkpoints):
            observer.chosen = chosen


class _First:
    """The first mesh, of which all others are refinements; over ranks the first one has it and divides it."""

    def __init__(self, mesh: Mesh, ranks: Communicator, refinement: Refinement) -> None:
        self._ranks, self._refinement = ranks, refinement
        whole = whole_of(mesh) if ranks.is_first else None
        if whole is not None:
            self._image, self._order = mesh_image(whole), whole.GetCurveOrder()
            self._straight = Mesh(whole.ngmesh.Copy())  # volumes of straight cells are halved exactly
            self._volumes = _volumes(self._straight)

    def under(self, simulation: Simulation) -> tuple[Simulation, ChosenMesh] | None:
        """The run at its start on the mesh that a state wants, and that mesh, read from its file as when the
        run is resumed; None where the state is on it.  Collective."""
        marked = self._refinement.steep(simulation)
        image = self._ranks.on_first(lambda: self._refined(whole_of(simulation.mesh), marked))
        if image is None:
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NgviscoWarning)  # of the start values, given on the first mesh
            return simulation.on(mesh_of(image)), ChosenMesh(image, simulation.number)

    def _refined(self, present: Mesh | None, marked: np.ndarray) -> bytes | None:
        """The file of the first mesh with cells divided that lie in marked ones of ``present``, or have such
        in them; None where that is ``present``."""
        assert present is not None
        mesh = mesh_of(self._image)  # Netgen's ``Copy`` forgets which walls are identified
        straight = Mesh(present.ngmesh.Copy())
        places, times = _centres(straight)[marked], mesh.dim * self._refinement.levels
        for _ in range(times):
            centres = _centres(mesh)
            wanted = marked[_cells_at(straight, centres)]
            wanted[_cells_at(mesh, places)] = True
            asked = self._volumes[_cells_at(self._straight, centres)] / 2**times
            wanted &= _volumes(mesh) > _TOO_LARGE * asked
            if not wanted.any():
                break
            for cell in mesh.Elements(VOL):
                mesh.SetRefinementFlag(cell, bool(wanted[cell.nr]))
            mesh.Refine()
        if mesh.ne == present.ne and np.array_equal(_centres(mesh), _centres(present)):
            return None
        if self._order == 1:
            return mesh_image(mesh)
        mesh.Curve(1)  # Netgen writes what is curved by numbers of edges that only a mesh read anew has
        curved = mesh_of(mesh_image(mesh))
        curved.Curve(self._order)
        return mesh_image(curved)


def _centres(mesh: Mesh) -> np.ndarray:
    return coordinates(mesh)[vertices(mesh)].mean(axis=1)


def _volumes(mesh: Mesh) -> np.ndarray:
    return np.array(Integrate(CF(1.0), mesh, element_wise=True))


def _cells_at(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Cells that points are in; beside a curved wall, where one may be in none, the nearest."""
    if not len(points):
        return np.zeros(0, dtype=int)
    found = np.asarray(mesh(*points.T)["nr"], dtype=int)
    outside = found < 0
    found[outside] = cKDTree(_centres(mesh)).query(points[outside])[1]
    return found
