"""Bounds of a state and their limiter: rho > 0, positive functions of the variables, a cut-off's bound.

A discontinuous polynomial may be negative at a point of a cell whose mean is positive.  Such a state is
corrected by scaling towards the cell's mean (Zhang and Shu, J. Comput. Phys. 229, 2010),

    rho <- rho_K + s (rho - rho_K),     z <- z_K + s (z - z_K),     0 <= s < 1,

where z are the strains. rho and z have a factor s each. For rho it is the largest s, found by bisection, with
which rho is at least ``SHARE`` of its mean. For z each bound has to be at least ``SHARE`` of its value for
the means. Means are taken by the rule of the forms, so that mass is kept to rounding. One s for all of z
reduces a convex stored energy, by Jensen's inequality for this rule:

    int_K phi(z_K + s (z - z_K)) <= s int_K phi(z) + (1 - s) |K| phi(z_K) <= int_K phi(z).

With bodies rho = sum rho_i n_i is a function of z, and a bound of rho is a bound of z.  Parameters are
limited to their ranges (``ngvisco.forms.cell_means``) before all else.

Variables of one distortion may drift apart, so that J differs from det F of a tensor.  phi(F, J) at det F < J
is below its value at rest, and rest energy would become motion.  A state is refused if |det F/J - 1| is above
``TimeSteps.drift`` in the mean of a cell.

The momentum density p = rho v is scaled by the factor s of rho (``limit_momentum``). |p|^2/(2 rho) is jointly
convex, so that the limiter also lowers the kinetic energy if rho was not negative.  The limiter does not
change the motion of a body in translation; limiting rho at a fixed momentum would change this motion.

A mean out of bounds cannot be corrected, and the step is then given up.  Two kinds of bounds do not count.
The first are bounds of variables for which the material's energy is continued (``Material.continued``: a
Yosida approximation, J_min). The second are bounds of the variable z in a cell where phi'_z = 0.  Bounds in
``Material.where_means_do`` count only in cells whose means satisfy them, so that they end no step.

A cut-off adds the bound rho_max + width - rho > 0 (paper: Euler-small-est3+++), if the start of the run
satisfies this bound.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import CF, L2, CoefficientFunction, GridFunction

from ngvisco.errors import ParameterError, UnknownNameError
from ngvisco.forms.cell_means import SHARE, CellMeans, Ranges, Stretches, least_of
from ngvisco.forms.mesh.locating import nearest_wall
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.sharpening import Sharpening
from ngvisco.forms.system import Step
from ngvisco.parallel.mesh import number_of
from ngvisco.physics.defects import DRIFT, drifts, remedy
from ngvisco.physics.material import Material
from ngvisco.physics.materials.thermal import temperature
from ngvisco.physics.variables import Values

OF_CUT_OFF = "rho_max + width - rho"
"""Name of a cut-off's bound."""

SMALLER = "a smaller step or a finer mesh"
"""Advice in messages about a state out of bounds."""

_HALVINGS = 45
"""Number of halvings of the interval of s. It determines s to rounding, so that a limited state depends
continuously on the state before limiting."""

_ON_WALL = 1e-9  # distance below which a point is on a wall, divided by the size of its cell
_UNREAD = 1e-14  # size of phi' by a variable that counts as zero, divided by the median size of phi'


@dataclass(frozen=True)
class Violation:
    """The place and value of the worst violation of a bound."""

    quantity: str
    """Name of the bounded quantity: ``"rho"``, ``"J"``, ``"det F"``, ..."""
    value: float
    """Least value of the quantity: in kg/m^3 for rho, without unit for all other quantities."""
    is_mean: bool
    """Whether the value is a cell's mean, and not a value at a point."""
    cell: int | None
    """Number of the cell in the undistributed mesh; None if ``Simulation`` did not distribute the mesh."""
    point: tuple[float, ...]
    """Point of the value, m, or the midpoint of the cell for a mean."""
    wall: str | None
    """Nearest boundary, whose distance is ``distance``, m, 0 on it; None in a domain without boundary."""
    distance: float
    cells: int
    """Number of cells out of bounds."""

    @property
    def where(self) -> str:
        """Words for the place."""
        at = ", ".join(f"{round(coordinate, 12) + 0.0:.4g}" for coordinate in self.point)
        where = f"at ({at}) m" if self.cell is None else f"in cell {self.cell} at ({at}) m"
        if self.wall is None:
            return where
        near = f"{self.distance:.2g} m from" if self.distance else "on"
        return f"{where}, {near} the boundary {self.wall!r}"

    def __str__(self) -> str:
        least = "least mean of a cell" if self.is_mean else "least value"
        further = f"; cells out of bounds: {self.cells}" if self.cells > 1 else ""
        return f"{self.quantity} is not positive (the {least} is {self.value:.3e}, {self.where}{further})"


@dataclass(frozen=True)
class _Outside:
    """Cells that are out of bounds at a point: their numbers, and arrays (cells, bounds).

    ``points`` are the sampler's points in these cells, ``owner`` the index of each point's cell.
    """

    cells: np.ndarray
    broken: np.ndarray
    required: np.ndarray
    means: np.ndarray
    least: np.ndarray
    points: np.ndarray
    owner: np.ndarray


class Bounds:
    """Finds violations of bounds by a step's present state, at the sampler's points, and limits the state.

    If ``limits`` is True, only means out of bounds are a ``violation``; without a limiter all values count.
    """

    def __init__(self, step: Step, sampler: Sampler, limits: bool = True, most: float = DRIFT) -> None:
        self.step, self.sampler, self.limits, self.most = step, sampler, limits, most
        self._ranks = sampler.ranks
        law = step.model.regularisation
        self._densest: float | None = None  # a cut-off's upper bound of the density, kg/m^3
        if law is not None and law.rho_max is not None:
            densest = law.rho_max + law.width
            self._densest = densest if sampler.extrema(step.now.rho)[1] < densest else None
        _check_names(step.model.material, step.now.z_tensors)
        bounds = self._bounds(step.now.rho, step.now.z_tensors)
        self.names = tuple(name for _, name, _ in bounds)
        self._variables = tuple(variable for variable, *_ in bounds)
        """Variable of each bound; None for rho, "" for several variables."""
        material, values = step.model.material, [value for *_, value in bounds]
        parted = drifts(material, step.now.z_tensors, step.model.traced)
        self._drifts = {pair: drift.Compile() for pair, drift in parted.items()}
        self._volumes = step.quadrature.each_cell(CF(1.0))
        self._present = CF(tuple(values)).Compile()
        self._with_drifts = CF((*values, *parted.values())).Compile()
        self._sound: np.ndarray | None = None  # rho and z of the last state within its bounds at all points
        self._farthest = 0.0  # this rank's largest drift in the last call of ``_outside``
        self._where_means_do = np.array([name in material.where_means_do for name in self.names])
        self._share = GridFunction(L2(step.mesh, order=0))  # s of rho in the last limited state
        self.sharpening = Sharpening(step) if step.layout.discretisation.sharp else None
        if self.sharpening is not None and not limits:
            expected = (False, " if time.limiter is off, since the limiter sharpens interfaces")
            raise ParameterError("Discretisation.sharp", True, *expected)
        self.refused: tuple[Violation, np.ndarray] | None = None
        """Violation and coefficients of the last solution with a ``defect``."""
        self.parted: str | None = None
        """Message of the last ``drift``, or None."""
        self.takes_energy = False
        """Whether the last ``limit`` changed anything but tensors of linear energies."""

    def _bounds(
        self, rho: CoefficientFunction, z: Values
    ) -> list[tuple[str | None, str, CoefficientFunction]]:
        """Functions that have to be positive: tuples of variable, name and value."""
        of_rho = {"rho": rho} if self._densest is None else {"rho": rho, OF_CUT_OFF: self._densest - rho}
        groups = [(None, of_rho), *self.step.model.material.positive(z).items()]
        return [(variable, name, value) for variable, parts in groups for name, value in parts.items()]

    @cached_property
    def _means(self) -> CellMeans:
        return CellMeans(self.step)

    @cached_property
    def ranges(self) -> Ranges:
        """Limiter of the parameters to their ranges."""
        return Ranges(self.step, self.sampler, self._means)

    @cached_property
    def stretches(self) -> Stretches:
        """Limiter of the tensors of bodies with linear energies."""
        return Stretches(self.step, self.sampler, self._means)

    @cached_property
    def _of_means(self) -> CoefficientFunction:
        z = self.step.layout.states.tensors(lambda: self._means.z)
        return CF(tuple(value for *_, value in self._bounds(self._means.rho, z))).Compile()

    @cached_property
    def _slope(self) -> CoefficientFunction:
        return self.step.energy.slope(self.step.now).Compile()

    def violation(self, everywhere: bool = False) -> Violation | None:
        """The first violation of a bound by the present state, or None.

        If ``everywhere`` is True, violations at points count too, although the limiter would correct them.
        """
        outside = self._outside()
        if outside is None:
            return None
        if everywhere or not self.limits:
            return self._worst(outside, outside.broken, outside.least, is_mean=False)
        broken = outside.required & ~(outside.means > 0)
        some = self._ranks.any(broken.any())
        return self._worst(outside, broken, outside.means, is_mean=True) if some else None

    def defect(self, is_solved: bool = True) -> str | None:
        """Message that the present state is not admissible; None if it is.

        A state is not admissible if rho, J, ... or the temperature is not positive, or if a value is not a
        number.  A state out of bounds is kept as ``refused``.  If ``is_solved`` is True, the state must have
        a stored energy. The extrapolated end of a step may have no energy before it is limited, so that
        ``lack`` checks its energy after the limiter.
        """
        violation = self.violation()
        if violation is not None:
            self.refused = violation, self.step.state.vec.FV().NumPy().copy()
            return str(violation)
        theta = temperature(self.step.model.material, self.step.now.zeta_tensors)
        if theta is not None and not (least := self.sampler.extrema(theta)[0]) > 0:
            return f"the temperature is not positive (the least value is {least:.4g} K)"
        return self.lack() or self.drift() if is_solved else None

    def refusal(self) -> str | None:
        """The ``defect`` of a solved state with its remedy, or None."""
        if (defect := self.defect()) is None:
            return None
        better = remedy(self.step.model.material) if defect == self.parted else SMALLER
        return f"{defect}; take {better}"

    def lack(self) -> str | None:
        """Message about the place where the present state, or its stored energy, is not a number; else None.

        The check of the energy covers density and variables, because their NaN makes the energy NaN.
        """
        where = self.step.without_energy()
        if self._ranks.any(len(where) > 0):
            return f"the stored energy is not a number {self.sampler.place_of_cells(where)}"
        state, ranges = self.step.state.vec.FV().NumPy(), self.step.layout.ranges
        bad = [name for name, block in ranges.items() if not np.isfinite(state[block]).all()]
        bad = [name for names in self._ranks.gathered(bad) for name in names]
        return f"the unknown {bad[0]!r} of the state is not a number somewhere" if bad else None

    def drift(self) -> str | None:
        """Message that variables of one distortion differ by more than ``most`` in the mean of a cell.

        The result is None if no variables do. It is None also in a run with sources, where variables may
        differ."""
        self._outside()
        if self.step.sources is not None or not self._ranks.any(not self._farthest <= self.most):
            return None  # the mean of a cell has no larger drift than the cell's points
        for pair, drift in self._drifts.items():
            means = abs(self.step.quadrature.each_cell(drift)) / self._volumes
            far = np.flatnonzero(means > self.most)
            if self._ranks.any(len(far) > 0):
                worst = self._ranks.most(means)
                where = self.sampler.place_of_cells(far[np.argsort(-means[far], kind="stable")])
                self.parted = (
                    f"the volume ratios from {pair} differ by {worst:.0%} in the mean {where}; more than "
                    f"{self.most:.0%} is refused, since the stress can be wrong by as much"
                )
                return self.parted
        return None

    def nearest(self) -> str | None:
        """The nearest bound of the energy's domain in words, with its least value and the place.

        Nearness is relative to the value at rest.  The result is None for an energy without bounds of its
        own.
        """
        material, z, points = self.step.model.material, self.step.now.z_tensors, self.sampler
        domain = material.domain(z)
        if not domain:
            return None
        at_rest = material.domain(material.at_rest(z))
        values, of_rest = (points.rows(CF(tuple(part.values()))) for part in (domain, at_rest))
        mine = None
        if len(values):
            at, bound = np.unravel_index(np.argmin(values / of_rest), values.shape)
            value, value_at_rest = float(values[at, bound]), float(of_rest[at, bound])
            where = points.coordinates(np.array([at]))[0]
            violation = self._violation(list(domain)[bound], value, int(points.cells[at]), where)
            mine = value / value_at_rest, value_at_rest, violation
        every = [entry for entry in self._ranks.gathered(mine) if entry is not None]
        _, value_at_rest, violation = min(every, key=lambda entry: entry[0])
        nearest = self._beside_wall(*violation)
        return f"{nearest.quantity} is {nearest.value:.3g} {nearest.where}, and {value_at_rest:.3g} at rest"

    def cells_outside(self) -> np.ndarray:
        """Numbers of the cells in which the present state is out of bounds at a point."""
        outside = self._outside()
        return np.zeros(0, dtype=int) if outside is None else outside.cells

    def is_exceeded(self) -> bool:
        """Whether ``limit`` would change the present state."""
        return (
            self.sharpening is not None
            or self.ranges.is_exceeded()
            or self._outside() is not None
            or self.stretches.is_exceeded()
        )

    def limit(self, tau: float = 0.0) -> int:
        """Limit the present state, whose means are within their bounds; return the number of limited cells.

        Only rho and z change, and only in cells that are out of bounds at a point.  ``tau`` is the length, s,
        of the step that ends in the state; for a state that no step ends in, it is 0.  If ``tau`` is not 0,
        ``Discretisation.sharp`` first separates the bodies.
        """
        if self.sharpening is not None and tau > 0:
            self.sharpening.put_apart(tau)
        self._share.vec[:] = 1.0
        changed, outside = self.ranges.limit(), self._outside()
        if outside is not None:
            _ = self._means.owner  # all ranks make this array together
            of_density = np.array([variable is None for variable in self._variables])
            if self.step.model.bodies:  # rho is a function of z
                self._scale("z", outside, np.ones_like(of_density))
            else:
                self._scale("rho", outside, of_density)
                self._scale("z", outside, ~of_density)
            changed = np.union1d(changed, outside.cells)
        self.takes_energy = self._ranks.total(len(changed)) > 0
        return int(self._ranks.total(len(np.union1d(changed, self.stretches.limit()))))

    def limit_momentum(self) -> None:
        """Scale the step's start momentum density by the factors with which ``limit`` scaled rho."""
        momentum, mean = self.step.momentum_old, self._means.momentum()
        momentum.Interpolate(mean + self._share * (momentum - mean))

    def _scale(self, name: str, found: _Outside, group: np.ndarray) -> None:
        """Scale rho or z in the cells with broken bounds of the ``group``, until the bounds hold."""
        required, outside = found.required & group, (found.broken & group).any(axis=1)
        place = np.full(self.step.mesh.ne, -1)
        place[found.cells[outside]] = np.flatnonzero(outside)
        dofs, owners = self._means.functions(place >= 0)
        cells, values = place[owners], self._means.coefficients(name)
        scaled = np.ones(1, dtype=bool) if name == "rho" else self.step.layout.states.strains
        centre = self._means.of_cells(name)[:, owners] * self._means.one[dofs]
        centre = np.where(scaled[:, None], centre, values[:, dofs])  # ``ranges`` limits parameters
        variation = values[:, dofs] - centre
        low, high = np.zeros(len(found.cells)), np.ones(len(found.cells))
        for _ in range(_HALVINGS if outside.any() else 0):
            middle = 0.5 * (low + high)
            values[:, dofs] = centre + middle[cells] * variation
            least = least_of(self.sampler.rows(self._present, found.points), found.owner, len(found.cells))
            holds = (~required | (least >= SHARE * found.means)).all(axis=1)
            low, high = np.where(holds, middle, low), np.where(holds, high, middle)
        values[:, dofs] = centre + low[cells] * variation
        if name == "rho" or self.step.model.bodies:
            self._share.vec.FV().NumPy()[found.cells[outside]] = low[outside]

    def _outside(self) -> _Outside | None:
        """The cells that are out of bounds, or NaN, at one of the sampler's points; None without any."""
        state, ranges = self.step.state.vec.FV().NumPy(), self.step.layout.ranges
        here = np.concatenate([state[ranges[name]] for name in ("rho", "z") if name in ranges])
        if not self._ranks.any(self._sound is None or not np.array_equal(self._sound, here)):
            return None
        values, off = np.split(self.sampler.rows(self._with_drifts), [len(self.names)], axis=1)
        self._farthest, bad = abs(off).max(initial=0.0), ~(values > 0)
        self._sound = None if self._ranks.any(bad.any()) else here
        if self._sound is not None:  # all ranks continue together, even without cells
            return None
        numbers = self.sampler.cells
        cells = np.unique(numbers[bad.any(axis=1)])
        points = np.flatnonzero(np.isin(numbers, cells))
        owner = np.searchsorted(cells, numbers[points])
        self._means.project()
        means = self.sampler.rows(self._of_means, points[np.unique(owner, return_index=True)[1]])
        required = self._required(len(cells), points, owner) & (~self._where_means_do | (means > 0))
        least = least_of(values[points], owner, len(cells))
        broken = required & ~(least > 0)
        kept: np.ndarray = np.any(broken, axis=1)
        if not self._ranks.any(kept.any()):
            return None
        inside = kept[owner]
        owner = (np.cumsum(kept) - 1)[owner[inside]]
        return _Outside(
            cells[kept], broken[kept], required[kept], means[kept], least[kept], points[inside], owner
        )

    def _required(self, count: int, points: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Mask of the bounds that count in each cell, (cells, bounds). Bounds of a variable z with phi'_z = 0
        do not count."""
        required = np.ones((count, len(self.names)), dtype=bool)
        if self.step.energy.projected is not None:  # the energy has values at the quadrature points only
            return required
        sizes = np.nan_to_num(np.abs(self.sampler.rows(self._slope)), nan=np.inf)
        every = np.concatenate(self._ranks.gathered(sizes.max(axis=1, initial=0.0)))
        unread = _UNREAD * float(np.median(every))
        for i, name in enumerate(self._variables):
            if name:
                of_variable = sizes[points][:, self.step.layout.states.slices[name]].max(axis=1)
                largest = -least_of(-of_variable[:, None], owner, count)[:, 0]
                required[:, i] = largest > unread
        return required

    def _worst(self, outside: _Outside, broken: np.ndarray, values: np.ndarray, is_mean: bool) -> Violation:
        """The violation of the first broken bound over all ranks, with its least value and place."""
        mine = self._worst_here(outside, broken, values, is_mean) if broken.any() else None
        named = [entry for entry in self._ranks.gathered(mine) if entry is not None]

        def order(entry: tuple[Violation, float]) -> tuple[int, float, int]:
            value, cell = entry[0].value, entry[0].cell
            return self.names.index(entry[0].quantity), _or_least(value), -1 if cell is None else cell

        worst = self._beside_wall(*min(named, key=order))
        return replace(worst, cells=int(self._ranks.total(int(broken.any(axis=1).sum()))))

    def _beside_wall(self, violation: Violation, size: float) -> Violation:
        """The violation in a cell of this size, m, with its nearest wall."""
        wall, distance = nearest_wall(self.step.mesh, np.array(violation.point))
        return replace(violation, wall=wall, distance=0.0 if distance < _ON_WALL * size else distance)

    def _worst_here(
        self, outside: _Outside, broken: np.ndarray, values: np.ndarray, is_mean: bool
    ) -> tuple[Violation, float]:
        """The worst violation on this rank, as ``_violation`` gives it."""
        bound = int(np.flatnonzero(broken.any(axis=0))[0])
        where = np.flatnonzero(broken[:, bound])
        i = int(where[np.argmin(_or_least(values[where, bound]))])
        points = outside.points[outside.owner == i]
        places = self.sampler.coordinates(points)
        place = places.mean(axis=0)
        if not is_mean:
            place = places[int(np.argmin(_or_least(self.sampler.rows(self._present, points)[:, bound])))]
        return self._violation(
            self.names[bound], float(values[i, bound]), int(outside.cells[i]), place, is_mean
        )

    def _violation(
        self, quantity: str, value: float, cell: int, place: np.ndarray, is_mean: bool = False
    ) -> tuple[Violation, float]:
        """A violation on this rank, and the size of its cell, m. Wall and number of cells are not known
        yet."""
        point, number = tuple(float(c) for c in place), number_of(self.step.mesh, cell)
        violation = Violation(quantity, value, is_mean, number, point, wall=None, distance=np.inf, cells=0)
        return violation, float(self.step.context.h.vec[cell])


def _check_names(material: Material, z: Values) -> None:
    """Raise UnknownNameError if ``Material.positive`` names a variable that the material lacks."""
    names = [variable.name for variable in material.variables]
    for name in material.positive(z):
        if name and name not in names:
            owner, known = type(material).__name__, [*names, "'' for a bound of several variables"]
            raise UnknownNameError(f"variable of {owner}.positive", name, known)


def _or_least(values: Any) -> Any:
    """The values, with -inf in place of NaN."""
    return np.where(np.isnan(values), -np.inf, values)
