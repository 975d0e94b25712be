"""The residual as a function of the iterated unknowns (v, wall stress, Pi, a, rho, z) alone.

For a given v the kinematic equations are linear except for creep.  Derived unknowns are functions of the
iterated unknowns, and are evaluated, never iterated: the traces, the conjugates zeta, the local creep rate,
the hyperviscosity's local unknowns, and the slopes of the delta-regularised z.  All rows follow from the
terms themselves (``ngvisco.reduced.evaluation``).  An infinitesimal imaginary part of the iterated unknowns
gives the product of Newton's whole matrix and a direction.

Each rank evaluates its own cells.  Ranks sum loads of traces before they solve for the traces.  At the end
ranks sum the rows of the flow, of the normal derivatives and of iterated traces.  All other rows belong to
one cell.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra.sparse import apply, inverse_of_blocks, mass_matrix
from ngvisco.forms.driving_stress import LinearisedTabulatedRates
from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Step
from ngvisco.forms.term import CellMean, PointTerm
from ngvisco.forms.upwinding import mean_share
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.arrays import TINY, Array
from ngvisco.physics.recording import Arrays, called
from ngvisco.reduced.declared import Couplings
from ngvisco.reduced.diffusion import FieldDiffusionRows
from ngvisco.reduced.evaluation import CellTerms, Coefficients, FacetTerms
from ngvisco.reduced.hyperviscosity import HyperValues, MatrixHyperviscosity
from ngvisco.reduced.operators import FacetMass, Operators, SideOperators
from ngvisco.reduced.point_fields import CELLS, FACETS
from ngvisco.reduced.programs import Programs
from ngvisco.reduced.restricted_form import RestrictedForm
from ngvisco.reduced.slope import PointwiseSlope
from ngvisco.reduced.source import RightHandSide
from ngvisco.reduced.unknowns import Unknowns
from ngvisco.threads import Workers

TOGETHER = 24_000
"""Largest number of points in cells that are evaluated together, as one part of the mesh."""

RECORDED = 8_000
"""Largest number of points in cells for which programs keep the data of a step."""
PROGRAMMED = 200_000
"""Largest number of points in cells for which programs evaluate the terms. On larger meshes programs save
hardly any time, and recording takes 3 kB of memory a tetrahedron."""


@dataclass
class Evaluation:
    """The residual at one set of iterated unknowns, and the quantities that it was computed from."""

    x: np.ndarray  # the iterated unknowns, packed
    coefficients: dict[str, np.ndarray]  # of all unknowns, (components, functions)
    hyper: HyperValues | None
    residual: np.ndarray  # the rows, packed like the unknowns
    terms: tuple[CellTerms, FacetTerms]  # evaluate unknowns at points by their method ``fields``

    @property
    def cells(self) -> Fields:
        """Values at the points of all cells, computed at each access and not stored."""
        return self.terms[0].fields(self.coefficients)

    @property
    def facets(self) -> Fields:
        """Values at the points of the cells' sides, computed at each access and not stored."""
        return self.terms[1].fields(self.coefficients)


PartFields: TypeAlias = tuple[Fields, Fields, Fields]
"""Values at three sets of points: of some cells, of their sides, and of the rule for
``ReducedResidual.carried``.  Each value is computed at its first access."""


class CellPart:
    """A range of cells and their sides, so small that the values at all points fit the processor's cache."""

    def __init__(self, residual: ReducedResidual, cells: slice) -> None:
        self.cells, self.residual = cells, residual
        self.inside, self.sides = residual.cell_terms.part(cells), residual.facet_terms.part(cells)
        self.carried = residual.carried_terms.part(cells)

    def fields(self, c: Coefficients) -> PartFields:
        """Fields with the coefficients ``c``: at the points of the cells, at the points of their sides, and
        at the points of the rule for polynomials."""
        return self.inside.fields(c), self.sides.fields(c), self.carried.fields(c)

    def mean(self, at: PartFields, term: CellMean) -> np.ndarray:
        """Means over the cells, (components, cells), or (cells,) for a scalar."""
        op, sides = self.inside.op, self.sides.op
        parts = [(term.value(at[0]), op.weights, op.z.per_cell)]
        if (on_sides := term.value_on_sides(at[1])) is not None:
            parts.append((on_sides, sides.weights, sides.z.per_cell))
        total = sum(
            (a.value * weights).reshape(*a.value.shape[:-1], op.z.cells, per).sum(axis=-1)
            for a, weights, per in parts
        )
        return total / op.weights.reshape(op.z.cells, op.z.per_cell).sum(axis=1)

    def loads_on_sides(self, at: PartFields, term: PointTerm, name: str) -> np.ndarray:
        """Loads in the equation of a facet mean, see ``FacetTerms.loads_of``."""
        return self.sides.loads_of(term, name, at[1])

    def loads(self, c: Coefficients) -> dict[tuple[str, str], np.ndarray]:
        """Loads of all terms that are evaluated at points; the keys are the place, cells or sides, and the
        unknown.

        ``c["jump"]`` has the hyperviscosity's jumps at the points of all sides."""
        residual, (inside, on_sides, carried) = self.residual, self.fields(c)
        if "jump" in c:
            on_sides.__dict__["jump"] = Array(c["jump"][:, self.sides.op.places], None)
        rows = self.inside.loads(residual.others, inside)
        for name, loads in self.carried.loads(residual.carried, carried).items():
            rows[name] = rows[name] + loads if name in rows else loads
        both = {CELLS: rows, FACETS: self.sides.loads(residual.at_points, on_sides)}
        return {(place, name): loads for place, rows in both.items() for name, loads in rows.items()}


def parts_of(cells: int, points: int, most: float = math.inf) -> list[slice]:
    """Divide the cells into ranges of nearly equal size: one range, or an even number of ranges.

    A range has up to ``most`` and up to ``TOGETHER`` points. ``points`` is the number of points in a cell.
    The ranges do not depend on the number of threads.
    """
    count = math.ceil(cells * points / min(TOGETHER, most))
    count = max(count + count % 2, 1) if count > 1 else 1
    ends = np.linspace(0, cells, count + 1).astype(int).tolist()
    return [slice(*ends_of) for ends_of in itertools.pairwise(ends)]


class ReducedResidual:
    """Evaluates the residual R of one step at packed unknowns x, and its derivative."""

    def __init__(self, step: Step, exchange: Exchange, workers: Workers) -> None:
        """``exchange`` belongs to the step's space; ``workers`` share the parts of the mesh."""
        self.step, self.workers = step, workers
        self.unknowns = u = Unknowns(step)
        self.op = Operators(step, step.quadrature.volume_degree // 2)
        self.side_op = SideOperators(step)
        self.rates = step.tabulated_rates
        self.cell_terms = CellTerms(step, self.op, self.rates)
        self.facet_terms = FacetTerms(step, self.side_op)
        self.slope = PointwiseSlope(step, self.op.points)
        self.couplings = couplings = Couplings(step)
        self.collocated_terms: CellTerms | None = None
        """Terms that are integrated by a collocated rule: one point per coefficient of a field."""
        if couplings.collocated():
            rates = LinearisedTabulatedRates(self.rates, step.stresses)
            operators = Operators(step, step.quadrature.collocation_order)
            self.collocated_terms = CellTerms(step, operators, rates, "collocated")
        self.inverse_mass = inverse_of_blocks(mass_matrix(self.op.z.matrix, self.op.weights))
        forms = couplings.by_forms
        self.by_forms = RestrictedForm(step, u.velocity_block, forms) if forms else None
        self.density = RestrictedForm(step, u.density, couplings.density) if couplings.density else None
        self._density_of_all: RestrictedForm | None = None
        self._of_forms: list[tuple[slice, sp.csr_matrix, np.ndarray]] = []
        """For each form: rows, matrix and columns of the derivative, from the last call of ``derivative``."""
        self.hyper: MatrixHyperviscosity | None = None
        if couplings.of_kernel["hyperviscosity"]:
            term = couplings.of_kernel["hyperviscosity"][0]
            self.hyper = MatrixHyperviscosity(step, term, self.op, self.side_op)
        self.right_hand_side = None if step.sources is None else RightHandSide(step)
        self.ranks, self.exchange = exchange.communicator, exchange.part(u.places(u.names))
        """Ranks and exchange of the packed unknowns."""
        # one matrix serves all components of z, and rho, because the trace of rho has the same layout
        self.trace_mass = self._mass_of_traces(exchange, "z_hat")
        self.diffusion: FieldDiffusionRows | None = None
        if couplings.of_kernel["diffusion"]:
            term = couplings.of_kernel["diffusion"][0]
            self.diffusion = FieldDiffusionRows(step, self.op, self.slope, term, self.trace_mass)
        self.at_points = [*couplings.at_points, *couplings.continuity]
        self._divide(step)
        means = couplings.of_kernel["facet means"]
        self.means_of_sides: list[tuple[PointTerm, str]] = [(term, term.name) for term in means]
        """The facet means that need equations at points: each equation and the name of its unknown, in the
        order of solution."""
        self.means_of_sides += [(term, "rho_hat") for term in couplings.continuity]
        orders = {step.layout.unknowns[name].order: name for _, name in self.means_of_sides}
        self._masses = {order: self._mass_of_traces(exchange, name) for order, name in orders.items()}
        self._masses[step.layout.unknowns["z_hat"].order] = self.trace_mass
        self._fixed_means = {
            name: of for term, name in self.means_of_sides if (of := self._mean_of(term, name))
        }
        """For each facet mean of one unknown, by the mean's name: the name of this unknown in cells, and the
        matrix of the mean's loads."""
        self.parts = self.divided()
        self.programs = Programs(keeps=self.op.points.count <= RECORDED)
        """Programs of the whole mesh, if it is one part, or of each part."""

    def divided(self, most: float = math.inf) -> list[CellPart]:
        """Parts of the mesh with up to ``most`` and ``TOGETHER`` points; one part if the slope of the energy
        at a point depends on other points."""
        cells, ranges = self.step.mesh.ne, [slice(0, self.step.mesh.ne)]
        if self.slope.is_local:
            ranges = parts_of(cells, self.op.points.per_cell, most)
        return [CellPart(self, cell_range) for cell_range in ranges]

    def _divide(self, step: Step) -> None:
        """Divide the terms at points into ``carried`` and ``others``. Terms of ``carried`` are polynomials,
        for which a rule of fewer points is exact."""
        k, m, whole = step.discretisation.k, step.discretisation.m, step.quadrature.volume_degree // 2
        self.carried, self.others, orders = list[PointTerm](), list[PointTerm](), [1]
        for term in self.at_points:
            degree = term.degree(k, m, self.rates) if step.quadrature.has_constant_weights else None
            if degree is not None and (order := -(-degree // 2)) < whole:
                self.carried.append(term)
                orders.append(order)
            else:
                self.others.append(term)
        self.carried_terms = CellTerms(step, Operators(step, max(orders), self.op), self.rates)

    def _mass_of_traces(self, exchange: Exchange, name: str) -> FacetMass:
        """The mass matrix of facet means with the polynomial order of the unknown ``name``."""
        values = self.side_op.of(name)
        mass = FacetMass(values, exchange.part(self.unknowns.places([name])[: values.width]))
        mass.update(self.side_op.weights * mean_share(self.side_op.inner))
        return mass

    def _mean_of(self, term: PointTerm, name: str) -> tuple[str, sp.csr_matrix] | None:
        """For an equation that determines an unknown's mean on facets: the unknown's name, and the matrix of
        the mean's loads. None for other equations."""
        if (of := term.mean_of) is None:
            return None
        op = self.side_op
        weights = sp.diags(op.weights * mean_share(op.inner))
        return of, (op.of(name).matrix.T @ weights @ op.of(of).matrix).tocsr()

    def start(self, records: bool = False) -> None:
        """Evaluate the data that are constant during the step.

        If ``records`` is True, all data have to stay as they are until the next call: on one process programs
        then evaluate the terms (``Programs``)."""
        # over ranks a function exchanges values, so that all ranks have to evaluate it equally often
        is_large, context = self.op.points.count > PROGRAMMED, self.step.context
        runs = records and not self.ranks.is_distributed and self.slope.is_local and not is_large
        self.programs.start(runs, context.tau.Get(), context.curvature.Get())
        self.cell_terms.context.sampled.start()
        self.carried_terms.context.sampled.start()
        if self.collocated_terms is not None:
            self.collocated_terms.context.sampled.start()
        self.facet_terms.context.start()
        if self.right_hand_side is not None:
            self.right_hand_side.start()

    def __call__(self, x: np.ndarray, anew: bool = False) -> Evaluation:
        """Evaluate R at ``x``.  A real ``x`` and the unknowns derived from it become the step's state.

        If ``anew`` is True, the flow rules are linearised at x (``LinearisationStress``); otherwise they keep
        the slopes of the last linearisation.  NGSolve's forms read the state; for a complex x, the forms'
        linearisation about the state takes their place.
        """
        c, hyper = self._derived(x)
        loads = self._joined("loads", CellPart.loads, c if hyper is None else c | {"jump": hyper.jumps})
        by_place = {
            name: {u: values for (at, u), values in loads.items() if at == name} for name in (CELLS, FACETS)
        }
        rows = [self.cell_terms.summed(by_place[CELLS]), self.facet_terms.summed(by_place[FACETS])]
        if self.collocated_terms is not None:
            n = self._at_collocation_points(self.collocated_terms, c, not np.iscomplexobj(x))
            if anew:
                self.step.stresses.linearise()
            rows.append(self.collocated_terms.rows(self.at_points, n))
        if self.diffusion is not None:
            rows.append({"z": self.diffusion.rows(c)})
        if hyper is not None:
            of_v, of_a = np.split(hyper.rows, [c["v"].shape[1]], axis=1)
            rows.append({"v": of_v, "a": of_a})
        if not np.iscomplexobj(x) and "energy" in self.couplings.forms_ask_for:
            self.step.local_unknowns.update_stored()
        return Evaluation(x, c, hyper, self._packed(x, rows), (self.cell_terms, self.facet_terms))

    def of_state(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Coefficients of unknowns in the step's state, see ``Coefficients``."""
        state, layout = self.unknowns.state, self.step.layout
        sizes = {name: layout.unknowns[name].size for name in names if name in layout.ranges}
        return {
            name: state[layout.ranges[name]].reshape(*(() if size is None else (size,)), -1)
            for name, size in sizes.items()
        }

    def share(self, work: Callable[[Any], Any], parts: Sequence[Any]) -> list[Any]:
        """Results of ``work`` on every part, in the order of the parts; threads share the parts if the energy
        is an array law."""
        return self.workers.map(work, parts) if self.slope.is_local else [work(part) for part in parts]

    def at_once(self, *works: Callable[[], Any]) -> list[Any]:
        """Results of ``works``, functions without arguments that work on arrays.

        Threads share the functions if the mesh has several parts; this thread calls the first one.
        """
        is_large = len(self.parts) > 1
        return self.workers.map(lambda work: work(), works) if is_large else [work() for work in works]

    def put(self, x: np.ndarray) -> None:
        """Make a real ``x``, and the unknowns derived from it, the step's state."""
        c, _ = self._derived(x)
        if self.collocated_terms is not None:
            self._at_collocation_points(self.collocated_terms, c, True)

    def _at_collocation_points(self, terms: CellTerms, c: dict[str, np.ndarray], is_real: bool) -> Fields:
        """Fields at the collocation points. If ``is_real`` is True, their values also become the
        linearisation stresses."""
        n = terms.fields(c)
        if is_real:
            self.step.stresses.refresh(lambda: (n.z.value, n.zeta.value))
        return n

    def _joined(self, name: str, work: Callable[[CellPart, Coefficients], Arrays], c: Coefficients) -> Arrays:
        """Arrays of all cells, computed part by part, by programs with the name ``name``."""

        def of_part(part: CellPart) -> Arrays:
            return self.programs((name, part.cells.start), partial(work, part), c)

        parts = self.share(of_part, self.parts)
        if len(parts) == 1:
            return parts[0]
        return {key: np.concatenate([of[key] for of in parts], axis=-1) for key in parts[0]}

    def _derived(self, x: np.ndarray) -> tuple[dict[str, np.ndarray], HyperValues | None]:
        """Coefficients of all unknowns at x, and the hyperviscosity's values; a real x also becomes the
        state."""
        c, hyper = self.unknowns.coefficients(x), None
        if self.diffusion is None and len(self.parts) == 1:
            c |= self.programs("derived", self._derived_unknowns, c)
        else:
            c |= self._derived_unknowns(c)
        if self.hyper is not None:
            hyper = self.hyper(c["v"], c["a"], c["z"])
            c |= hyper.local
        if not np.iscomplexobj(x):
            self.unknowns.unpack(x, c)
        return c, hyper

    def _derived_unknowns(self, of: Coefficients) -> dict[str, np.ndarray]:
        """Conjugates, traces and means from the coefficients of the iterated unknowns."""
        c = dict(of)
        # the fields of one part serve all equations; the fields of several parts would not fit the cache
        fields = self.parts[0].fields(c) if len(self.parts) == 1 else None

        def joined(name: str, loads: Callable[[CellPart, PartFields], np.ndarray]) -> np.ndarray:
            if fields is not None:
                return loads(self.parts[0], fields)
            return self._joined(name, lambda part, c: {name: loads(part, part.fields(c))}, c)[name]

        def slope(part: CellPart, u: PartFields) -> np.ndarray:
            of_part: np.ndarray = called(part.inside.op.z.loads, self.slope(u[0].z.value))
            return of_part

        c["zeta"] = called(apply, self.inverse_mass, joined("zeta", slope))
        for term, name in self.means_of_sides:
            mass = self.mass_of(name)
            if (means := self._fixed_means.get(name)) is not None:
                loads = called(apply, means[1], c[means[0]])
            else:
                of_sides = joined(name, partial(CellPart.loads_on_sides, term=term, name=name))
                loads = -called(self.side_op.of(name).summed, of_sides)
            c[name] = called(mass.solve, called(mass.exchange.sum, loads))
            if term.stays:
                c[name] = called(self.step.local_unknowns.largest, name, c[name].real)
        for mean in self.couplings.of_kernel["cell means"]:
            c[mean.name] = joined(mean.name, partial(CellPart.mean, term=mean))
        if self.diffusion is not None:
            c |= self.diffusion.slopes(self.op.z(c["z"]), c)
        return {name: values for name, values in c.items() if name not in of}

    def derivative(self, at: Evaluation) -> Callable[[np.ndarray], np.ndarray]:
        """The map from packed directions d to the rows dR d, at an evaluation. The step's state has to be the
        ``x`` of this evaluation.

        The derivative is taken by complex increments of all arrays.  NGSolve linearises the terms that exist
        only as forms.
        """
        u = self.unknowns
        self.step.stresses.linearise()
        self._of_forms = []
        if self.by_forms is not None:
            self._of_forms.append((u.flow_slice, self.by_forms.jacobian(), np.arange(u.flow_slice.stop)))
        if self.density is not None:
            if self._density_of_all is None:
                self._density_of_all = RestrictedForm(self.step, ["v", *u.density], self.couplings.density)
            columns = np.r_[u.slices["v"], u.density_slice]
            rows = self._density_of_all.jacobian()[at.coefficients["v"].size :]
            self._of_forms.append((u.density_slice, rows, columns))
        return lambda d: self(at.x + (TINY * 1j) * d).residual.imag / TINY

    def mass_of(self, name: str) -> FacetMass:
        """The mass matrix of the facet mean ``name``."""
        return self._masses[self.step.layout.unknowns[name].order]

    def _packed(self, x: np.ndarray, rows: list[dict[str, np.ndarray]]) -> np.ndarray:
        """Pack the sum over all ranks of three kinds of rows: ``rows``, by unknown, the forms' rows, and the
        source's rows."""
        u, is_real, result = self.unknowns, not np.iscomplexobj(x), np.zeros_like(x)
        for part in rows:
            for name, values in part.items():
                where = u.normal_slice if name == "a" else u.slices.get(name)
                if where is not None:
                    result[where] += values.ravel()
        if not is_real:
            for where, matrix, columns in self._of_forms:
                result[where] += 1j * (matrix @ x.imag[columns])
            return self.exchange.sum(result)
        for form, where in ((self.by_forms, u.flow_slice), (self.density, u.density_slice)):
            if form is not None:
                result[where] += form.residual()
        if self.right_hand_side is not None:
            result += self.right_hand_side.rows
        return self.exchange.sum(result)
