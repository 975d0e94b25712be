"""Meshes that follow a field: at times during a run, cells are divided where the field is steep.

Every mesh of a run is a bisection of the first one, so that a cell of one mesh is a cell, a part of a cell or
a union of cells of another.  Where the field has become flat, cells are coarse again.
``ngvisco.run.transfer`` carries a state over, without loss onto finer cells if these are straight, and by L2
projection onto coarser cells; the ledger's column ``transfer`` is the energy that the projection takes.
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
    as_number,
    require_fields,
    require_known,
    require_type,
)
from ngvisco.forms.mesh.mesh_arrays import coordinates, is_simplicial, vertices
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import of_whole, whole_of
from ngvisco.run.checkpoint import Checkpoints
from ngvisco.run.fields import field_unit
from ngvisco.run.files import AnyPath, mesh_image, mesh_of
from ngvisco.run.scales import ExtremePlace, diameter, extreme_places
from ngvisco.run.simulation import Simulation
from ngvisco.run.snapshot import ChosenMesh, mesh_of_checkpoints
from ngvisco.run.transfer import go_on, require_fit, transfer

_TOO_LARGE = 1.5
"""A cell is divided if the ratio of its volume to the wanted volume is above this number; bisection gives
powers of two."""
_SAME_TIME = 1e-9
"""Tolerance of the times at which the mesh is chosen, as a share of ``every``."""
_FLAT, _ROUNDING = 1e-9, 1e-12
"""Least variation of a field that counts as steep, relative to the field's largest value and to the run's
usual value."""
_LEVELS = 8


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """Criterion and depth of the division of cells.

    Raises ParameterError for a number out of its range.

    Parameters
    ----------
    field : str
        Name of one of the run's ``fields``, e.g. ``"disc_fraction"`` or ``"creep_rate"``.  If the field is a
        vector or a tensor, its norm counts.
    above : float
        Share of the field's range over the domain.  A cell is divided if the field varies by more than this
        share of the range in the cell and its neighbours.
    levels : int
        Largest number of times that the edges of a cell of the first mesh are halved.
    every : float
        Time after which the mesh is chosen anew, a multiple of dt.
    """

    field: Annotated[str, Quantity(example="pressure")]
    above: Annotated[float, Quantity("1", "in (0, 1)", 0.1)] = 0.1
    levels: Annotated[int, Quantity("1", f"from 1 to {_LEVELS}")] = 1
    every: Annotated[float, Quantity("s", "> 0", 0.1)]

    def __post_init__(self) -> None:
        require_fields(self)

    def check(self, simulation: Simulation) -> None:
        """Raise MeshError, ParameterError or UnknownNameError unless meshes of a run can follow the field."""
        if not simulation.ranks.all(is_simplicial(simulation.mesh)):
            message = "expected a mesh of triangles or tetrahedra, since other cells cannot be bisected"
            raise MeshError(message)
        simulation.stepper.check("Refinement.every", self.every)
        self.steep(simulation)
        require_fit(simulation, simulation)  # a state has to fit the later meshes too

    def steep(self, simulation: Simulation) -> np.ndarray:
        """Whether each cell of the whole mesh is to be divided, (cells,), on the first rank; collective."""
        fields = simulation.fields
        require_known("Refinement.field", [self.field], fields, "Refinement.field")
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
        """Usual size of a velocity, a rate or a stress; 0 for other fields, because these do not vanish at
        rest."""
        step, length = simulation.rothe_step, diameter(simulation.mesh, simulation.ranks)
        places = extreme_places(step, simulation.sampler) or [ExtremePlace(step.model, {}, 1.0, np.empty(0))]
        stress = max(place.density * place.scales(simulation.mesh.dim)[0] ** 2 for place in places)
        velocity = simulation.velocity_scale
        return {"m/s": velocity, "1/s": velocity / length, "Pa": stress}.get(field_unit(self.field), 0.0)


def run_refined(
    simulation: Simulation, refinement: Refinement, until: float, checkpoint: AnyPath | None = None
) -> Simulation:
    """Run on meshes that follow a field, refined from the mesh of ``simulation``; return the last mesh's run.

    The last run has the ledger of all meshes.  Observers get a call of ``start`` on every mesh, as in a
    resumed run.  Raises ParameterError, UnknownNameError, MeshError or CheckpointError for arguments that do
    not fit, before a step is made; StepError as ``Simulation.run``.

    Parameters
    ----------
    simulation : Simulation
        Simulation at its own start, on the coarsest mesh, of triangles or tetrahedra.
    until : float
        End of the run, s.
    checkpoint : path, optional
        The HDF5 file of an earlier part of the run, which then goes on from its last state.
    """
    require_type("run_refined.simulation", simulation, Simulation)
    require_type("run_refined.refinement", refinement, Refinement)
    # a run that has begun, or was carried over from another mesh, is refused
    if simulation.number or simulation.ledger.balance is not None:
        expected = "a simulation that has made no step, and was not carried over from another mesh"
        raise ParameterError("run_refined.simulation", f"a simulation at step {simulation.number}", expected)
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
    """Yield the run on each of its meshes, with the time until which it goes on there, s.

    ``simulation`` is at its start on the ``first`` mesh, of which all meshes are refinements, or at a later
    state on a later mesh, ``chosen``.
    """
    cells, every = _First(first, simulation.ranks, refinement), refinement.every
    origin = simulation.stepper.origin
    if simulation.number == 0 and simulation.ledger.balance is None:
        for _ in range(refinement.levels):  # each finer mesh resolves the start values better
            if (finer := cells.under(simulation)) is None:
                break
            simulation, chosen = finer
        _tell_checkpoints(simulation, chosen)
    else:
        _tell_checkpoints(simulation, chosen)
        periods = (simulation.t - origin) / every
        at_choice = abs(periods - round(periods)) < _SAME_TIME
        if at_choice and (chosen is None or chosen.step != simulation.number) and simulation.t < until:
            simulation = _moved(simulation, cells)
    while True:
        stop = min(origin + (math.floor((simulation.t - origin) / every + _SAME_TIME) + 1) * every, until)
        stop = until if stop > until * (1 - _SAME_TIME) else stop
        yield simulation, stop
        if simulation.stop_requested or stop == until:
            return
        simulation = _moved(simulation, cells)


def _moved(simulation: Simulation, cells: _First) -> Simulation:
    """The run on the mesh that the present state needs, or ``simulation`` itself if it is on this mesh."""
    if (refined := cells.under(simulation)) is None:
        return simulation
    target, chosen = refined
    transfer(simulation, target)
    go_on(simulation, target)
    _tell_checkpoints(target, chosen)
    return target


def _tell_checkpoints(simulation: Simulation, chosen: ChosenMesh | None) -> None:
    for observer in simulation.observers:
        if isinstance(observer, Checkpoints):
            observer.chosen = chosen


class _First:
    """The first mesh, of which all later meshes are refinements; the first rank has the mesh and divides
    it."""

    def __init__(self, mesh: Mesh, ranks: Communicator, refinement: Refinement) -> None:
        self._ranks, self._refinement = ranks, refinement
        whole = whole_of(mesh) if ranks.is_first else None
        if whole is not None:
            self._image, self._order = mesh_image(whole), whole.GetCurveOrder()
            # bisection halves the volumes of straight cells exactly
            self._straight = Mesh(whole.ngmesh.Copy())
            self._volumes = _volumes(self._straight)

    def under(self, simulation: Simulation) -> tuple[Simulation, ChosenMesh] | None:
        """A new run on the mesh that a simulation's state needs, and this mesh; None if the simulation is on
        this mesh.

        The mesh is read from its file, as in a resumed run.  Collective."""
        marked = self._refinement.steep(simulation)
        image = self._ranks.on_first(lambda: self._refined(whole_of(simulation.mesh), marked))
        if image is None:
            return None
        with warnings.catch_warnings():
            # warnings about start values were given on the first mesh
            warnings.simplefilter("ignore", NgviscoWarning)
            return simulation.on(mesh_of(image)), ChosenMesh(image, simulation.number)

    def _refined(self, present: Mesh | None, marked: np.ndarray) -> bytes | None:
        """File of the next mesh; None if the next mesh is ``present``.

        In the next mesh those cells of the first mesh are divided that lie in a marked cell of ``present``,
        or contain one.
        """
        assert present is not None
        mesh = mesh_of(self._image)  # Netgen's ``Copy`` forgets identified walls
        straight = Mesh(present.ngmesh.Copy())
        places, times = _centres(straight)[marked], mesh.dim * self._refinement.levels
        for _ in range(times):
            centres = _centres(mesh)
            is_split = marked[_cells_at(straight, centres)]
            is_split[_cells_at(mesh, places)] = True
            target_volumes = self._volumes[_cells_at(self._straight, centres)] / 2**times
            is_split &= _volumes(mesh) > _TOO_LARGE * target_volumes
            if not is_split.any():
                break
            for cell in mesh.Elements(VOL):
                mesh.SetRefinementFlag(cell, bool(is_split[cell.nr]))
            mesh.Refine()
        if mesh.ne == present.ne and np.array_equal(_centres(mesh), _centres(present)):
            return None
        if self._order == 1:
            return mesh_image(mesh)
        # Netgen writes curved edges by edge numbers, which a mesh has only after it was read from a file
        mesh.Curve(1)
        curved = mesh_of(mesh_image(mesh))
        curved.Curve(self._order)
        return mesh_image(curved)


def _centres(mesh: Mesh) -> np.ndarray:
    return coordinates(mesh)[vertices(mesh)].mean(axis=1)


def _volumes(mesh: Mesh) -> np.ndarray:
    return np.array(Integrate(CF(1.0), mesh, element_wise=True))


def _cells_at(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Cells that contain the points; for a point in no cell, beside a curved wall, the nearest cell."""
    if not len(points):
        return np.zeros(0, dtype=int)
    cells = np.asarray(mesh(*points.T)["nr"], dtype=int)
    outside = cells < 0
    cells[outside] = cKDTree(_centres(mesh)).query(points[outside])[1]
    return cells
