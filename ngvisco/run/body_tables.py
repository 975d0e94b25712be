"""Table of each body over time: mass, place, motion, energies, shape, stress, width of its interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, get_args

import numpy as np
from ngsolve import CF, H1, L2, CoefficientFunction, Grad, GridFunction, Periodic

from ngvisco.errors import NgviscoWarning, ParameterError, Quantity, require_names, require_some_names
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import inner, sym
from ngvisco.run.files import AnyPath
from ngvisco.run.fraction_samples import HALF, FractionSamples
from ngvisco.run.frames import Lattice
from ngvisco.run.outlines import Moments, distance
from ngvisco.run.series import Every, Series
from ngvisco.words import Mention

if TYPE_CHECKING:
    from ngvisco.forms.fields import Fields
    from ngvisco.forms.system import Step
    from ngvisco.run.simulation import Simulation

_WIDE = 3.0
"""Width of the interface in cells, above which a run warns that the body dissolves."""


class SmearedWarning(NgviscoWarning):
    """The interface of a body is several cells wide: the body dissolves in the matter around it."""


class Tractions:
    """Mean stress of bodies, and the force and torque that other bodies exert on them.

    The stress sigma is the sum of elastic and viscous stress.  chi is the fraction averaged at the vertices,
    a continuous function.  The force is -int sigma grad chi, which is int chi div sigma without the tractions
    of walls.
    """

    def __init__(self, simulation: Simulation, fractions: FractionSamples) -> None:
        step, fields, names = simulation.rothe_step, simulation.fields, fractions.names
        self._step, self._dim, self._positions = step, step.mesh.dim, fractions.positions
        space = H1(step.mesh, order=1)
        space = Periodic(space) if step.walls.periodic else space
        self.chi = {name: GridFunction(space) for name in names}
        self._lattice, self._projected = Lattice(step.mesh, 1), GridFunction(L2(step.mesh, order=1))
        self._exchange = Exchange.of(space, Communicator.of(step.mesh))
        numbers = GridFunction(space)
        numbers.vec.FV().NumPy()[:] = np.arange(space.ndof)
        self._numbers = np.rint(self._lattice.values(numbers)[:, 0]).astype(int)
        """The number of the unknown of chi at each corner of each cell.

        Two corners of a cell have one number if the cell meets its own image across a periodic boundary.
        """
        self._counts = self._sums(np.ones(len(self._numbers)))
        pairs = [(0, 0), (1, 1), (2, 2), (0, 1), *([(0, 2), (1, 2)] if self._dim == 3 else [])]
        self.of_stress = {f"stress_{i + 1}{j + 1}": (i, j) for i, j in pairs}
        axes = "xyz"[: self._dim]
        torques = ["torque"] if self._dim == 2 else [f"torque_{axis}" for axis in axes]
        self.of_traction = [*(f"force_{axis}" for axis in axes), *torques]
        self._theta = {name: fields[f"{name}_fraction"] for name in names}
        shares = (share for name in names for share in self.shares(name, fields).values())
        self._stresses = CF((*self._theta.values(), *shares)).Compile()
        chis = self.chi.items()
        parts = (part for name, chi in chis for part in self.densities(name, fields, Grad(chi)).values())
        self._forces = CF(tuple(parts)).Compile()

    @staticmethod
    def _stress(fields: Mapping[str, CoefficientFunction]) -> CoefficientFunction:
        stress = fields["cauchy_stress"]
        return stress + fields["viscous_stress"] if "viscous_stress" in fields else stress

    def shares(self, name: str, fields: Mapping[str, CoefficientFunction]) -> dict[str, CoefficientFunction]:
        """A body's shares theta sigma_ij in the stress, Pa, by the names of their columns, from the fields of
        a state."""
        stress, theta = self._stress(fields), fields[f"{name}_fraction"]
        return {column: theta * stress[i, j] for column, (i, j) in self.of_stress.items()}

    def densities(
        self, name: str, fields: Mapping[str, CoefficientFunction], slope: CoefficientFunction
    ) -> dict[str, CoefficientFunction]:
        """Densities of force on a body and of torque about the origin, by the names of their columns, for a
        slope grad chi."""
        place, stress, dim = self._positions[name], self._stress(fields), self._dim
        f = [-sum((stress[i, j] * slope[j] for j in range(dim)), CF(0.0)) for i in range(dim)]
        axes = [(0, 1)] if dim == 2 else [(1, 2), (2, 0), (0, 1)]
        torques = [place[i] * f[j] - place[j] * f[i] for i, j in axes]
        return dict(zip(self.of_traction, (*f, *torques), strict=True))

    def stresses(self) -> np.ndarray:
        """Mean stresses, Pa, (bodies, components); NaN for a body without volume."""
        integrals = np.asarray(self._step.quadrature.integrate_cells(self._stresses), dtype=float)
        volumes, sums = integrals[: len(self._theta), None], integrals[len(self._theta) :]
        return sums.reshape(len(volumes), -1) / np.where(volumes > 0, volumes, np.nan)

    def average(self) -> None:
        """Set chi at each vertex to the mean of the fraction's cellwise P1 projections over the cells at the
        vertex."""
        for name, chi in self.chi.items():
            self._projected.Set(self._theta[name])
            sums = self._sums(self._lattice.values(self._projected)[:, 0])
            chi.vec.FV().NumPy()[:] = sums / np.maximum(self._counts, 1)

    def _sums(self, at_corners: np.ndarray) -> np.ndarray:
        """For each unknown of chi, the sum of the values ``at_corners`` over the cells' corners at the
        unknown's vertex."""
        return self._exchange.sum(np.bincount(self._numbers, at_corners, self._exchange.count))

    def forces(self, centres: np.ndarray) -> np.ndarray:
        """Forces, N, and torques, N m, about the bodies' ``centres``, (bodies, dim): (bodies, components)."""
        self.average()
        integrals = np.asarray(self._step.quadrature.integrate_cells(self._forces), dtype=float)
        integrals = integrals.reshape(len(self.chi), -1)
        force, torque = integrals[:, : self._dim], integrals[:, self._dim :]
        arm = np.pad(centres, ((0, 0), (0, 3 - self._dim)))
        about = np.cross(arm, np.pad(force, ((0, 0), (0, 3 - self._dim))))
        return np.hstack([force, torque - about[:, -torque.shape[1] :]])


Measure: TypeAlias = Literal["deformation", "outline", "turning", "stress", "traction", "gap"]
"""Optional measures of bodies."""
_PLANE = ("deformation", "outline", "turning", "gap")
"""Measures that need an outline, and hence a domain of two dimensions."""


class Bodies(Series):
    """Table of each body of a model over time.

    The columns are ``step``, ``time`` (s), and for each body, with theta its volume fraction and n its amount
    per volume, in SI units, per metre of thickness in plane strain:

    | column | meaning |
    |---|---|
    | ``NAME_mass`` | int rho_R n, kg; constant to rounding |
    | ``NAME_volume`` | int theta, m^d |
    | ``NAME_x``, ``_y``, ``_z`` | centroid int theta x over the volume, m |
    | ``NAME_momentum_x``, ... | int rho_R n v, kg m/s |
    | ``NAME_kinetic`` | kinetic energy, J |
    | ``NAME_stored`` | shear energy, n U(1), and the share theta of all other stored energy, J |
    | ``NAME_dissipation`` | dissipation by viscosity and creep in the present (limited) state, W |
    | ``NAME_x_min``, ``NAME_x_max``, ... | extent of points with theta >= 1/2, m; NaN without such points |
    | ``NAME_smeared`` | width of the interface in cells: the volume where 0.05 < theta < 0.95 over |
    |  | the volume of an interface one cell wide; NaN without an interface |

    The argument ``measures`` adds the following columns. The first four measures are those of the region with
    theta >= 1/2 in two dimensions; their columns are NaN if there is no such region.

    | measure | columns |
    |---|---|
    | ``deformation`` | ``NAME_L``, ``NAME_B``, length and breadth of the region's ellipse of inertia, m |
    |  | ``NAME_D``, (L - B)/(L + B), ``NAME_angle`` from x to L, rad from -pi/2 to pi/2 |
    | ``outline`` | ``NAME_perimeter``, m, and ``NAME_inside``, the area within the outline, m^2 |
    | ``turning`` | ``NAME_turning``, rate at which matter goes round (tank-treading), 2 pi/period, rad/s |
    | ``gap`` | ``gap_NAME_OTHER``, least distance of the outlines of two bodies that have a place, m |
    | ``stress`` | ``NAME_stress_11``, ..., mean of the elastic and viscous stress, Pa |
    | ``traction`` | ``NAME_force_x``, ..., force of the other bodies by that stress, N, and its torque |
    |  | about the centroid, ``NAME_torque``, in 3D ``NAME_torque_x``, ..., N m |

    Centroids, outlines, ellipses and gaps are those of whole bodies across periodic boundaries.  A centroid
    is within the domain.  Along a period in which a body meets its own image, the centroid is that of the
    body's part in the domain.  Extents are those of the body's parts in the domain. A ``SmearedWarning`` is
    issued, once, for a body with a place whose interface is more than three cells wide.  A run's HDF5 file
    (``Checkpoints``) holds the columns in the group ``bodies``. A run raises ParameterError for a model
    without bodies, for a measure that needs an outline in three dimensions, and for ``gap`` of fewer than two
    bodies that have a place.

    Parameters
    ----------
    measures : sequence of str
        Further columns: length, breadth and angle (deformation), perimeter and area (outline), tank-treading
        (turning), mean stress (stress), force and torque by other bodies (traction), least distances (gap).
    """

    group = "bodies"

    def __init__(
        self,
        path: AnyPath | None = None,
        every: Every = 1,
        measures: Annotated[Sequence[Measure], Quantity(example=["deformation", "gap"])] = (),
    ) -> None:
        super().__init__(path, every)
        some = len(require_names("Bodies.measures", measures)) > 0
        self.measures = require_some_names("Bodies.measures", measures) if some else []
        for name in self.measures:
            if name not in get_args(Measure):
                raise ParameterError("Bodies.measures", name, f"one of {', '.join(get_args(Measure))}")
        self._is_said: set[str] = set()

    def prepare(self, simulation: Simulation) -> list[str]:
        step, material, dim = simulation.rothe_step, simulation.model.material, simulation.mesh.dim
        self._step = step
        bodies = require_bodies("Bodies", material)
        needs = [name for name in self.measures if name in _PLANE]
        if dim != 2 and needs:
            expected = "only stress and traction in 3D, since the other measures need an outline in the plane"
            raise ParameterError("Bodies.measures", needs[0], expected)
        axes = "xyz"[:dim]
        units = {"mass": "kg", "volume": "m^d", **dict.fromkeys(axes, "m")}
        units |= {f"momentum_{axis}": "kg m/s" for axis in axes}
        units |= {"kinetic": "J", "stored": "J", "dissipation": "W"}
        units |= {f"{axis}_{end}": "m" for axis in axes for end in ("min", "max")}
        units |= {"smeared": "1"}
        self.names = names = [body.name for body in bodies]
        self._placed = [body.name for body in bodies if body.where is not None]
        self.fractions = FractionSamples(simulation.rothe_step, simulation.ranks, names)
        has_stress = bool({"stress", "traction"} & {*self.measures})
        self.tractions = Tractions(simulation, self.fractions) if has_stress else None
        for measure in self.measures:
            units |= self._units_of(measure)
        self._units = {f"{name}_{quantity}": unit for name in names for quantity, unit in units.items()}
        if "gap" in self.measures:
            if len(self._placed) < 2:
                expected = "no gap in a model with fewer than two bodies that have a place (where)"
                raise ParameterError("Bodies.measures", "gap", expected)
            self.pairs = {f"gap_{one}_{other}": (one, other) for one, other in combinations(self._placed, 2)}
            self._units |= dict.fromkeys(self.pairs, "m")
        parts = (part for name in names for part in self.densities(name, step.now).values())
        self._integrand = CF(tuple(parts)).Compile()
        theta = material.fractions.at(step.now.z_tensors)  # type: ignore[attr-defined]
        self._theta = CF(tuple(theta[name] for name in names))
        sampler = simulation.sampler
        self._places = sampler.coordinates(np.arange(len(sampler.points)))
        return list(self._units)

    def _units_of(self, measure: str) -> dict[str, str]:
        """Units of a measure's columns, by the columns' names without the body's name."""
        if measure == "stress" and self.tractions is not None:
            return dict.fromkeys(self.tractions.of_stress, "Pa")
        if measure == "traction" and self.tractions is not None:
            return {name: "N" if name.startswith("force") else "N m" for name in self.tractions.of_traction}
        return {
            "deformation": {"L": "m", "B": "m", "D": "1", "angle": "rad"},
            "outline": {"perimeter": "m", "inside": "m^2"},
            "turning": {"turning": "rad/s"},
        }.get(measure, {})

    def densities(self, name: str, u: Fields) -> dict[str, CoefficientFunction]:
        """Densities of the integrals of a body at ``u``, by the names of columns."""
        return densities(self._step, name, u, self.fractions.positions[name])

    def unit(self, column: str) -> str:
        """SI unit of a column (per metre of thickness in plane strain)."""
        return self._units.get(column) or super().unit(column)

    @property
    def jumping(self) -> dict[str, str]:
        """Columns without a derivative with respect to the state, and the reason."""
        extents = [f"{axis}_{end}" for axis in "xyz"[: self.fractions.dim] for end in ("min", "max")]
        reasons = dict.fromkeys(extents, "an extent jumps between points of the quadrature")
        reasons["smeared"] = "the width of an interface counts parts of cells"
        return {f"{name}_{column}": why for name in self.names for column, why in reasons.items()}

    def may_be_nan(self, column: str) -> bool:
        # the outline is empty for a body that is thinner than a cell or has left the domain
        return column not in ("step", "time")

    def _sample(self, simulation: Simulation) -> Any:
        dim = simulation.mesh.dim
        simulation.rothe_step.local_unknowns.update_stored()
        self.fractions.read()
        totals = np.asarray(simulation.rothe_step.quadrature.integrate_cells(self._integrand), dtype=float)
        values = totals.reshape(self._theta.dim, -1)
        values[:, 2 : 2 + dim] /= np.where(values[:, 1:2] > 0, values[:, 1:2], np.nan)
        there = simulation.sampler.rows(self._theta).T[:, :, None] >= HALF
        # least values are computed as largest values of -x, because the point set of a rank may be empty
        ends = np.stack([-self._places, self._places], axis=-1).reshape(-1, 2 * dim)
        extents = np.where(there, ends, -np.inf).max(axis=1, initial=-np.inf)
        extents = simulation.ranks.largest(extents) * np.tile([-1, 1], dim)
        extents[np.isinf(extents)] = np.nan
        smeared = np.array([[self.fractions.smeared(name)] for name in self.names])
        self._look(simulation, smeared[:, 0])
        centres = values[:, 2 : 2 + dim].copy()
        values[:, 2 : 2 + dim] = self.fractions.folded(centres)
        blocks = [values, extents, smeared]
        blocks += [self._measured(measure, centres) for measure in self.measures if measure != "gap"]
        row = np.hstack(blocks).ravel()
        if "gap" in self.measures:
            outlines = {name: self.fractions.cut(name).ends for name in self._placed}
            images = self.fractions.periods.images
            gaps = np.array(
                [distance(outlines[one], outlines[other], images) for one, other in self.pairs.values()]
            )
            row = np.append(row, np.where(np.isinf(gaps), np.nan, gaps))
        return [row]

    def _measured(self, measure: str, centres: np.ndarray) -> np.ndarray:
        """Values of a measure, (bodies, columns)."""
        if self.tractions is not None and measure in ("stress", "traction"):
            return self.tractions.stresses() if measure == "stress" else self.tractions.forces(centres)
        if measure == "outline":
            cuts = [self.fractions.cut(name) for name in self.names]
            areas = [moments.area if (moments := Moments.of(cut.inside)) else 0.0 for cut in cuts]
            return np.array([[cut.length, area] for cut, area in zip(cuts, areas, strict=True)])
        every = [Moments.of(self.fractions.whole(name).inside) for name in self.names]
        if measure == "turning":
            return np.array([[np.nan if moments is None else moments.turning()] for moments in every])
        rows = []
        for moments in every:
            L, B, angle = (np.nan,) * 3 if moments is None else moments.ellipse()
            rows.append([L, B, (L - B) / (L + B), angle])
        return np.array(rows)

    def _look(self, simulation: Simulation, smeared: np.ndarray) -> None:
        """Warn, once for each body, of a wide interface."""
        for name, width in zip(self.names, smeared, strict=True):
            if name in self._placed and width > _WIDE and name not in self._is_said:
                self._is_said.add(name)
                message = (
                    f"at t = {simulation.t:.4g} s the interface of the body {name!r} is {width:.2g} cells "
                    "wide and widens further; take smaller cells, discretisation.m = 2, or an earlier end of "
                    "the run"
                )
                simulation.ranks.warn(message, SmearedWarning, stacklevel=4)


def require_bodies(owner: str, material: Any) -> tuple[Any, ...]:
    """The bodies of a model's material; raises ParameterError for a material without bodies."""
    if not isinstance(material, Mixture):
        expected = ("a model with ", Mention("Model.bodies"), ", since the table is of bodies")
        raise ParameterError(f"{owner}.model", type(material).__name__, *expected)
    return material.bodies


def densities(
    step: Step, name: str, u: Fields, position: CoefficientFunction
) -> dict[str, CoefficientFunction]:
    """Densities of a body's mass, volume, first moments, momentum, energies and dissipation at ``u``.

    The keys are the names of columns.  The first moments, ``x``, ``y``, ``z``, are integrals of ``position``
    over the volume.
    """
    material, rates = step.model.material, u.context.rates
    assert isinstance(material, Mixture)
    body = next(body for body in material.bodies if body.name == name)
    values, theta = u.z_tensors, material.fractions.at(u.z_tensors)[name]
    mass = (body.density or 0.0) * values[AMOUNT + name]
    axes, v = "xyz"[: step.mesh.dim], u.v
    loss = CF(0.0)
    if body.viscosity is not None:
        eps, read = sym(u.L), rates.read_values(body.viscosity, u)
        share = material.fractions.not_negative(values)[name]
        loss = loss + share * body.viscosity.bulk_dissipation(eps, read)
        loss = loss + share * body.viscosity.shear_dissipation(eps, read)
    for mechanism in rates.mechanisms:
        if mechanism.body == name:
            loss = loss + rates.power_of_creep(mechanism, rates.local_creep(mechanism, u), u)
    shears, volumes = material.shears(values), material.volumes(values, CF(1.0))
    of_volume = rates.stored_near(u) - sum((*shears.values(), *volumes.values()), CF(0.0))
    return {
        "mass": mass,
        "volume": theta,
        **{axis: theta * position[i] for i, axis in enumerate(axes)},
        **{f"momentum_{axis}": mass * v[i] for i, axis in enumerate(axes)},
        "kinetic": 0.5 * mass * inner(v, v),
        "stored": shears.get(name, CF(0.0)) + volumes[name] + theta * of_volume,
        "dissipation": loss,
    }
