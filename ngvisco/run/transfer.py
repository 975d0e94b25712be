"""Transfer of a state to another mesh or to other parameters, and the energy lost in the transfer.

On another mesh, density, transported variables and further unknowns that evolve are projected in L2, and the
velocity is projected on the new mesh's velocities that the walls allow.  The projection uses values at the
new quadrature points; in a new cell that is a union of old cells the projection uses the old points, so that
each integral is kept.  The density is then scaled by one factor, so that the mass is kept to rounding; with
bodies each amount is scaled, and the density is the sum over bodies.  With other parameters the state is
unchanged.

The energy before less the energy after is the ledger's column ``transfer`` (J): in row 0 of a new ledger, or
in the next row of a ledger that goes on, whose closure includes it.  The column is positive if energy was
lost.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from ngsolve import CF, L2, CoefficientFunction, GridFunction, Integrate, Mesh

from ngvisco.errors import InitialDataError, MeshError, ParameterError
from ngvisco.forms.boundary.wall_projections import project_velocity
from ngvisco.forms.mesh.locating import Located
from ngvisco.forms.projections import project
from ngvisco.forms.start.given import QuadraturePoints
from ngvisco.forms.start.initial import complete
from ngvisco.physics.bodies import AMOUNT, Amount
from ngvisco.run import snapshot
from ngvisco.run.files import AnyPath
from ngvisco.run.ledger import TRANSFER, energy_of
from ngvisco.run.state import RunState
from ngvisco.threads import computing

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

_VOLUME = 0.02
"""Largest relative difference of the volumes of two meshes of one curved domain."""
_WHOLE = 1e-9
"""Relative tolerance of a new cell's volume and the sum of its old cells' volumes."""


@dataclasses.dataclass(frozen=True)
class Transfer:
    """The result of the transfer of a state.

    Attributes
    ----------
    mass : float
        Mass, kg; the transfer keeps it, and each body's.
    scaled : float
        Factor by which the density was scaled to keep the mass; with bodies the factor farthest from one.
    energy_before, energy_after : float
        Energies before and after the transfer, J.
    """

    mass: float
    scaled: float
    energy_before: float
    energy_after: float

    @property
    def lost(self) -> float:
        """Energy that is lost, J; negative if the projection adds energy."""
        return self.energy_before - self.energy_after


@computing()
def transfer(source: Simulation, target: Simulation) -> Transfer:
    """Carry the state of one simulation over to another simulation, on another mesh or in other spaces.

    Raises ParameterError if the materials' variables or the passive fields do not fit, or ``target`` has made
    steps; MeshError if the domains differ; InitialDataError if a projected density or Jacobian is not
    admissible, even with a limiter, or a body vanishes: take a finer mesh.

    Parameters
    ----------
    source : Simulation
        Simulation at the state to be carried over, e.g. ``nv.load("results/swirl").simulation``.
    target : Simulation
        Simulation before its first step, with the same transported variables, on a mesh of the same domain.
        The target takes the source's time and counts steps from there, and its ledger begins with the new
        state.
    """
    for name, run in (("source", source), ("target", target)):
        if not isinstance(run, RunState):
            raise ParameterError(f"transfer.{name}", run, "a ngvisco.Simulation")
    old, new = source.rothe_step, target.rothe_step
    require_fit(source, target)
    points = QuadraturePoints(new.quadrature)
    at = _located(old.mesh, points)
    before = source.ledger.energy() if source.ledger.balance is None else source.ledger.balance.energy
    scaled = _set_fields(source, target, points, at)
    if (defect := target.bounds.defect()) is not None:
        raise InitialDataError("transferred state", defect, "an admissible state; take a finer mesh")
    if target.bounds.limits:
        target.bounds.limit()
    new.state.vec.FV().NumPy()[new.layout.ranges["v"]] = 0.0
    target.set_time(source.t, 0)
    new.moving_walls.set_present_values()
    v = CF(tuple(points.function(column) for column in at.values(old.now.v).T))
    project_velocity(new.layout, new.state, v, new.impenetrability, new.quadrature)
    for name, part in target.passive.parts.items():
        space = L2(target.mesh, order=new.discretisation.k)
        single, columns = GridFunction(space), at.values(source.passive.parts[name]).T
        for component, column in zip(part.vec.FV().NumPy().reshape(len(columns), -1), columns, strict=True):
            points.project(column, space, single)
            component[:] = single.vec.FV().NumPy()
    complete(new)
    new.state_old.vec.data = new.state.vec
    new.start_from_old()
    target.stepper.begin(source.t, 0)
    target.set_velocity_scale(source.velocity_scale)
    ledger = target.ledger
    ledger.rows, ledger.balance = [], None
    ledger.keep([TRANSFER])
    row = ledger.start(source.t)
    result = Transfer(row["mass"], scaled, before, energy_of(row))
    row[TRANSFER] = result.lost
    return result


def go_on(source: Simulation, target: Simulation) -> None:
    """Give the step numbers, step lengths and ledger of ``source`` to ``target``; both have one state."""
    target.set_time(source.t, source.number)
    # the arrays of the error estimate belong to the old mesh and are left out
    numbers, _ = source.stepper.state_dict()
    target.stepper.load_state_dict(target, numbers, {})
    had, ledger = source.ledger, target.ledger
    assert had.balance is not None
    ledger.add_once(TRANSFER, ledger.rows[0][TRANSFER])
    for name, impulse in ledger.momentum.transferred(had.rows[-1], ledger.rows[0]).items():
        ledger.add_once(name, impulse)
    rows = [{name: row.get(name, 0.0) for name in ledger.columns} for row in had.rows]
    ledger.resume(had.balance, rows, had.limits)


def require_fit(source: Simulation, target: Simulation) -> None:
    """Raise ParameterError or MeshError unless a state of ``source`` can be carried over to ``target``."""
    had, has = (run.model.material.variables for run in (source, target))
    densities = {v.name: v.density for v in had if isinstance(v, Amount)}
    for v in has:
        if isinstance(v, Amount) and densities.get(v.name, v.density) != v.density:
            name = f"bodies[{v.name.removeprefix(AMOUNT)!r}].density"
            expected = f"{densities[v.name]:.6g} kg/m^3, as in the source of the state"
            # with another density either the mass or the volume of the body would change
            raise ParameterError(name, v.density, expected)
    if [(v.name, repr(v)) for v in had] != [(v.name, repr(v)) for v in has]:
        names = [", ".join(v.name for v in side) for side in (had, has)]
        expected = (
            f"the variables of the source, {names[0]}; take the material and the elastic_state of the source"
        )
        raise ParameterError("transfer.target", f"the variables {names[1]}", expected)
    unknowns = source.rothe_step.layout.unknowns
    for name in target.rothe_step.layout.evolving:
        if name not in unknowns or unknowns[name].size != target.rothe_step.layout.unknowns[name].size:
            expected = f"a run with terms that have the evolving unknown {name}"
            raise ParameterError("transfer.source", f"a run without {name}", expected)
    if (had := source.arguments["symmetry"]) != (has := target.arguments["symmetry"]):
        raise ParameterError("transfer.target", f"symmetry {has!r}", f"{had!r}, the symmetry of the source")
    if source.mesh.dim != target.mesh.dim:
        expected = f"dimension {source.mesh.dim}, as in the source"
        raise ParameterError("transfer.target", f"dimension {target.mesh.dim}", expected)
    if target.number or len(target.ledger.rows) > 1:
        expected = "a run before its first step"
        raise ParameterError("transfer.target", f"a run at step {target.number}", expected)
    carried, wanted = ({*run.passive.names, *run.passive.distances.parts} for run in (source, target))
    missing = sorted(wanted - carried)
    if missing:
        raise ParameterError("transfer.target", missing, "passive fields that the source carries too")
    volumes = [Integrate(CF(1.0), run.mesh) for run in (source, target)]
    if abs(volumes[1] / volumes[0] - 1) > _VOLUME:
        raise MeshError(
            f"the new mesh has the volume {volumes[1]:.6g}, but the old mesh has {volumes[0]:.6g}"
        )


def _located(mesh: Mesh, points: QuadraturePoints) -> Located:
    where = points.coordinates
    try:
        return Located(mesh, where, ["target"] * len(where))
    except ParameterError as error:
        raise MeshError(f"a point of the new mesh, {error.value}, is not in the old mesh") from error


def _set_fields(source: Simulation, target: Simulation, points: QuadraturePoints, at: Located) -> float:
    """Project density, variables and further unknowns that evolve.

    Returns the factor that keeps the mass, with bodies the factor farthest from 1.
    """
    old, new = source.rothe_step, target.rothe_step
    parts = dict(zip(new.layout.names, new.state.components, strict=True))
    unions = _Unions(source, target, points)
    for name in new.layout.evolving:
        if name == "v":
            continue
        unknown, function = new.layout.unknowns[name], old.now.parts[name]
        if unknown.on is None:
            targets, columns = points, at.values(function).T
            unions.put_in(columns, function)
        else:
            targets = QuadraturePoints(new.quadrature, unknown.on)
            columns = _located(old.mesh, targets).values(function).T
        value = CF(tuple(targets.function(column) for column in columns))
        project(unknown, parts[name], new.quadrature, value)
    if new.model.bodies:
        z, slices = parts["z"].vec.FV().NumPy().reshape(new.layout.states.size, -1), new.layout.states.slices
        names = [v.name for v in target.model.material.variables if isinstance(v, Amount)]
        tensors = (old.now.z_tensors, new.now.z_tensors)
        kept = {name: (tensors[0][name], tensors[1][name], z[slices[name].start]) for name in names}
    else:
        kept = {"mass": (old.now.rho, new.now.rho, parts["rho"].vec.FV().NumPy())}
    factors = []
    for name, (had, has, coefficients) in kept.items():
        before, after = float(old.quadrature.integrate_cells(had)), float(new.quadrature.integrate_cells(has))
        if not after > 0:
            amount, integral = name.removeprefix(AMOUNT), f"the integral is {after:.3g}"
            expected = "an integral > 0 on the new mesh; take a finer mesh"
            raise InitialDataError(f"transferred amount of {amount}", integral, expected)
        factors.append(before / after)
        coefficients *= factors[-1]
    return max(factors, key=lambda factor: abs(factor - 1))


class _Unions:
    """New cells that are unions of old cells: fields are projected onto them by a rule at the old points.

    With the new points alone the projection of a jump between old cells would depend on the positions of the
    points.  Each rank gets the old points of all ranks and uses the points in its own new cells.
    """

    def __init__(self, source: Simulation, target: Simulation, points: QuadraturePoints) -> None:
        old = QuadraturePoints(source.rothe_step.quadrature)
        self._ranks, self._old, self._degree = source.ranks, old, target.rothe_step.discretisation.m
        x_old, weights, x_new = self._of_all(old.coordinates), self._of_all(old.weights), points.coordinates
        count, of_new = target.mesh.ne, points.cells
        of_old = np.asarray(target.mesh(*x_old.T)["nr"], dtype=int) if count else np.full(len(x_old), -1)
        here = of_old >= 0
        volumes = np.bincount(of_new, points.weights, count)
        filled = np.bincount(of_old[here], weights[here], count)
        has_parts = np.bincount(of_old[here], minlength=count) > np.bincount(of_new, minlength=count)
        # points outside this rank's new cells have the number -1, and read the last entry, False
        unions = np.append(has_parts & (abs(filled - volumes) <= _WHOLE * volumes), False)
        self._count = int(unions.sum())
        number = np.where(unions, np.cumsum(unions) - 1, -1)
        self._from, self._to = here & unions[of_old], unions[of_new]
        self._cell_from, self._cell_to = number[of_old[self._from]], number[of_new[self._to]]
        self._weights = weights[self._from]
        total = np.bincount(self._cell_from, self._weights, self._count)
        first = [np.bincount(self._cell_from, self._weights * c, self._count) for c in x_old[self._from].T]
        self._middle, self._size = np.array(first).T / total[:, None], total ** (1 / target.mesh.dim)
        self._basis_from = self._monomials(x_old[self._from], self._cell_from)
        self._basis_to = self._monomials(x_new[self._to], self._cell_to)
        self._mass = self._moments(self._basis_from)

    def put_in(self, columns: np.ndarray, function: CoefficientFunction) -> None:
        """Replace ``columns``, (components, points), at the points of these cells; collective."""
        for i, column in enumerate(columns):
            component = function if function.dim == 1 else function[i]
            values = self._of_all(self._old.values(component))[self._from]
            if not self._count:
                continue
            fitted = np.linalg.solve(self._mass, self._moments(values[:, None]))[:, :, 0]
            column[self._to] = (self._basis_to * fitted[self._cell_to]).sum(axis=1)

    def _of_all(self, values: np.ndarray) -> np.ndarray:
        return np.concatenate(self._ranks.gathered(values))

    def _monomials(self, x: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """Monomials up to the fields' degree about the cells' centres, (points, functions)."""
        local = (x - self._middle[cells]) / self._size[cells, None]
        powers = itertools.product(range(self._degree + 1), repeat=x.shape[1])
        return np.stack([(local**p).prod(axis=1) for p in powers if sum(p) <= self._degree], axis=1)

    def _moments(self, values: np.ndarray) -> np.ndarray:
        """Integrals int b_i values_j over the cells, (cells, functions, columns)."""
        products = self._weights[:, None, None] * self._basis_from[:, :, None] * values[:, None, :]
        moments = np.zeros((self._count, *products.shape[1:]))
        np.add.at(moments, self._cell_from, products)
        return moments


@computing()
def resume_changed(
    simulation: Simulation, path: AnyPath, attributes: Mapping[str, str] | None = None
) -> float:
    """Go on from a run's last checkpoint with other parameters, on the same mesh and in the same spaces.

    Step length, loads, walls, viscosities and the material's numbers may differ from the run's; mesh, orders
    and the list of unknowns must not.  A column of the ledger that only one of the two runs has is 0 in the
    other run's rows.  Raises CheckpointError as ``Simulation.restore``.

    Returns
    -------
    float
        Energy lost by the change of the stored energy, J: the column ``transfer`` of the next row.
    """
    checkpoint, rows, limits = snapshot.take_up(
        simulation, path, attributes=attributes, may_differ=("material", "energies", "scheme")
    )
    (numbers, _), step = checkpoint.part(""), simulation.rothe_step
    complete(step)
    step.state_old.vec.data = step.state.vec
    step.start_from_old()
    simulation.set_time(numbers["time"], int(numbers["step"]))
    if not simulation.is_adaptive:  # adaptive steps begin with the new dt
        simulation.stepper.load_state_dict(simulation, *checkpoint.part("stepping"))
    ledger, balance = simulation.ledger, checkpoint.balance
    loss = balance.energy - ledger.energy()
    ledger.add_once(TRANSFER, loss)
    ledger.resume(balance, [{name: row.get(name, 0.0) for name in ledger.columns} for row in rows], limits)
    return loss
