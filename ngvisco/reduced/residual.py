"""The residual with everything derived put in: a function of (v, wall stress, Pi, a, rho, z) alone.

For a given v the kinematic equations are linear but for creep.  The upwind traces, the conjugates zeta, the
local creep rate, the hyperviscosity's local unknowns and those of the delta-regularised z are functions
of the iterated unknowns: they are evaluated, never iterated.  All rows follow from the terms themselves
(``ngvisco.reduced.evaluation``); with an infinitesimal imaginary part in the unknowns they are Newton's whole
matrix times a direction.

Over ranks each evaluates on its own cells: loads of traces are summed up before these are solved for, rows
of the flow, of the normal derivatives and of iterated traces at the end; all others are of cells alone.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from itertools import chain

import numpy as np

from ngvisco.algebra.blocks import BlockInverse
from ngvisco.algebra.sparse import mass_matrix
from ngvisco.forms.driving_stress import LinearisedTabulatedRates
from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Step
from ngvisco.forms.term import PointTerm
from ngvisco.forms.upwinding import mean_share
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.arrays import TINY, Array
from ngvisco.reduced.by_forms import RestrictedForm, RightHandSide
from ngvisco.reduced.claims import Claims
from ngvisco.reduced.diffusion import FieldDiffusionRows
from ngvisco.reduced.evaluation import CellTerms, FacetTerms
from ngvisco.reduced.hyperviscosity import HyperValues, MatrixHyperviscosity
from ngvisco.reduced.operators import FacetMass, Operators, SideOperators
from ngvisco.reduced.slope import PointwiseSlope
from ngvisco.reduced.unknowns import Unknowns
from ngvisco.reduced.values import with_values

Clock = Callable[[str], AbstractContextManager[None]]


@dataclass
class Residual:
    """Rows of the flow's unknowns, of the normal derivatives a (dim, .), of the density's and of z (n, .)."""

    flow: np.ndarray
    normals: np.ndarray | None
    density: np.ndarray
    z: np.ndarray

    def parts(self) -> list[np.ndarray]:
        """The blocks one after the other."""
        normals = [] if self.normals is None else [self.normals.ravel()]
        return [self.flow, *normals, self.density, self.z.ravel()]

    def mapped(self, function: Callable[[np.ndarray], np.ndarray]) -> Residual:
        """A function of every block."""
        normals = None if self.normals is None else function(self.normals)
        return Residual(function(self.flow), normals, function(self.density), function(self.z))

    @property
    def is_finite(self) -> bool:
        """On this rank."""
        return all(bool(np.isfinite(part).all()) for part in self.parts())


@dataclass
class Evaluation:
    """All that is known of one set of iterated unknowns.

    Attributes
    ----------
    x : (unknowns,) array
        Packed.
    coefficients : dict
        Of the iterated and of the derived unknowns by name, (components, functions).
    cells, facets : Fields
        Arrays of values at the points of cells and of sides.
    hyper : HyperValues or None
    residual : Residual
    """

    x: np.ndarray
    coefficients: dict[str, np.ndarray]
    cells: Fields
    facets: Fields
    hyper: HyperValues | None
    residual: Residual


class ReducedResidual:
    """R of one step at packed unknowns x, and its derivative."""

    def __init__(self, step: Step, exchange: Exchange, clock: Clock = lambda name: nullcontext()) -> None:
        """``clock(name)`` measures the time of a part; ``exchange`` is that of the step's space."""
        self.step, self.unknowns, self._clock = step, Unknowns(step), clock
        self.op = Operators(step, step.quadrature.volume_degree // 2)
        self.side_op = SideOperators(step)
        self.rates = step.tabulated_rates
        self.cell_terms = CellTerms(step, self.op, self.rates)
        self.facet_terms = FacetTerms(step, self.side_op)
        self.slope = PointwiseSlope(step, self.op.points)
        self.claims = claims = Claims.of(step)
        self.node_terms: CellTerms | None = None
        """Of what is integrated by as many points as a field has values in a cell."""
        if claims.of_nodes():
            rates = LinearisedTabulatedRates(self.rates, step.stresses)
            self.node_terms = CellTerms(step, Operators(step, step.quadrature.field_order), rates, "nodes")
        self.inverse_mass = BlockInverse.of(mass_matrix(self.op.z.matrix, self.op.weights))
        flow, density = self.unknowns.flow, self.unknowns.density
        self.by_forms = RestrictedForm(step, flow, claims.by_forms) if claims.by_forms else None
        self.density = RestrictedForm(step, density, claims.density) if claims.density else None
        self._density_of_all: RestrictedForm | None = None
        self.hyper: MatrixHyperviscosity | None = None
        if claims.hyperviscosity:
            points = self.op.points, self.side_op.points
            self.hyper = MatrixHyperviscosity(step, claims.hyperviscosity[0], *points)
        self.right_hand_side: RightHandSide | None = None
        if step.sources is not None:
            self.right_hand_side = RightHandSide(step, self.unknowns)
        u = self.unknowns
        self.ranks, self.exchange = exchange.communicator, exchange.part(u.places(u.names))
        """Of the packed unknowns."""
        self.shared_rows = exchange.part(u.places([*u.flow, *u.normals]))
        """Of the flow's unknowns and the normal derivatives."""
        self.shared_density = exchange.part(u.places(u.density))
        """Of the density's unknowns: its traces, where its equation is not linear, are iterated."""
        # of one component: those of rho, which bodies have not, lie alike
        self._traces = exchange.part(u.places(["z_hat"])[: self.side_op.hat.width])
        self.trace_mass = FacetMass(self.side_op.hat, self._traces)
        self.trace_mass.update(self.side_op.points.weights * mean_share(self.side_op.inner))
        self.diffusion: FieldDiffusionRows | None = None
        if claims.diffusion:
            term = claims.diffusion[0]
            self.diffusion = FieldDiffusionRows(step, self.op, self.slope, term, self.trace_mass)
        self._at_points = [*claims.at_points, *claims.continuity]
        self._of_traces: list[tuple[PointTerm, str]] = [(term, term.name) for term in claims.traces]
        self._of_traces += [(term, "rho_hat") for term in claims.continuity]
        shapes = {name: step.layout.unknowns[name].shape for _, name in self._of_traces}
        self._zeros = {name: np.zeros((*shape, 1)) for name, shape in shapes.items()}

    def start(self) -> None:
        """Evaluate what is known through the step."""
        self.cell_terms.context.start()
        if self.node_terms is not None:
            self.node_terms.context.start()
        self.facet_terms.context.start()
        if self.right_hand_side is not None:
            self.right_hand_side.start()

    def __call__(self, x: np.ndarray, anew: bool = False) -> Evaluation:
        """Evaluate at ``x``; where it is real, it and what is derived from it become the step's state.

        ``anew`` linearises flow rules there, ``DrivingStress``; else their slopes stay.  The forms of NGSolve
        read the state; with complex x they are taken as linear about it.
        """
        c, u, s, hyper = self._derived(x)
        with self._clock("rows"):
            rows = self.cell_terms.rows(self._at_points, u)
            others = [self.facet_terms.rows(self._at_points, s)]
            if self.node_terms is not None:
                n = self._at_nodes(self.node_terms, c, not np.iscomplexobj(x))
                if anew:
                    self.step.stresses.linearise()
                others.append(self.node_terms.rows(self._at_points, n))
            for name, values in chain(*(each.items() for each in others)):
                rows[name] = rows[name] + values if name in rows else values
            if self.diffusion is not None:
                rows["z"] = rows["z"] + self.diffusion.rows(c)
            if hyper is not None:
                rows["v"] = rows["v"] + hyper.rows[:, : c["v"].shape[1]]
                rows["a"] = hyper.rows[:, c["v"].shape[1] :]
        if not np.iscomplexobj(x) and "energy" in self.claims.forms_ask_for:
            self.step.eliminate.refresh()
        with self._clock("forms"):
            residual = self._joined(x, rows)
        return Evaluation(x, c, u, s, hyper, residual)

    def put(self, x: np.ndarray) -> None:
        """Make ``x``, real, and what is derived from it, the step's state."""
        c, *_ = self._derived(x)
        if self.node_terms is not None:
            self._at_nodes(self.node_terms, c, True)

    def _at_nodes(self, terms: CellTerms, c: dict[str, np.ndarray], is_real: bool) -> Fields:
        """Values at the nodes, where stresses follow those of the step's state."""
        n = terms.fields(c)
        if is_real:
            self.step.stresses.refresh(lambda: (n.z.value, n.zeta.value))
        return n

    def _derived(self, x: np.ndarray) -> tuple[dict[str, np.ndarray], Fields, Fields, HyperValues | None]:
        """Coefficients, values in cells and on sides, the hyperviscosity's; the state where x is real."""
        op, is_real = self.op, not np.iscomplexobj(x)
        c = self.unknowns.coefficients(x)
        u, s = self.cell_terms.fields(c), self.facet_terms.fields(c)
        with self._clock("projections"):
            c["zeta"] = self.inverse_mass(op.z.test(self.slope(u.z.value)))
        with self._clock("traces"):
            self._set_traces(c, s)
        with self._clock("diffusion"):
            if self.diffusion is not None:
                c |= self.diffusion.slopes(u.z.value, c)
        hyper = None
        with self._clock("hyperviscosity"):
            if self.hyper is not None:
                hyper = self.hyper(c["v"], c["a"], c["z"])
                c |= hyper.local
                s.__dict__["jump"] = Array(hyper.jumps, None)
        if is_real:
            self.unknowns.unpack(x)
            self.unknowns.put(c)
        return c, u, s, hyper

    def derivative(self, at: Evaluation) -> Callable[[np.ndarray], Residual]:
        """The map from directions d, packed, to rows of dR d at an evaluation, which the state has to be.

        By complex increments of all arrays; of the terms that only forms have, their linearisations.
        """
        self.step.stresses.linearise()
        self._flow_rows = None if self.by_forms is None else self.by_forms.jacobian()
        self._density_rows = None
        if self.density is not None:
            if self._density_of_all is None:
                names = ["v", *self.unknowns.density]
                self._density_of_all = RestrictedForm(self.step, names, self.claims.density)
            count = at.coefficients["v"].size
            self._density_rows = self._density_of_all.jacobian()[count:]

        def rows(d: np.ndarray) -> Residual:
            residual = self(at.x + (TINY * 1j) * d).residual
            return residual.mapped(lambda part: np.ascontiguousarray(part.imag) / TINY)

        return rows

    def _set_traces(self, c: dict[str, np.ndarray], s: Fields) -> None:
        """Solve for the upwind traces and other means of both sides, which may read those before them."""
        for term, name in self._of_traces:
            loads = self.facet_terms.slots([term], with_values(s, **{name: self._zeros[name]}))
            tested = self._traces.sum(self.side_op.hat.test(loads[name]))
            c[name] = -self.trace_mass.solve(tested)

    def _joined(self, x: np.ndarray, rows: dict[str, np.ndarray]) -> Residual:
        u, dtype, is_real = self.unknowns, x.dtype, not np.iscomplexobj(x)
        flow = np.zeros(u.flow_slice.stop, dtype)
        for name in u.flow:
            if name in rows:
                flow[u.slices[name]] += rows[name].ravel()
        if self.by_forms is not None and is_real:
            flow += self.by_forms.residual()
        elif self.by_forms is not None:
            flow += 1j * (self._flow_rows @ x[u.flow_slice].imag)
        if self.density is None:
            density = rows.get("rho", np.zeros(0, dtype))
        else:
            density = np.zeros(u.density_slice.stop - u.density_slice.start, dtype)
            if is_real:
                density += self.density.residual()
            else:
                direction = np.concatenate([x[u.slices["v"]].imag, x[u.density_slice].imag])
                density += 1j * (self._density_rows @ direction)
            if "rho" in rows:
                density[: rows["rho"].size] += rows["rho"]
        residual = Residual(flow, rows.get("a"), density, rows["z"])
        if self.right_hand_side is not None and is_real:
            names = (u.flow, u.normals, u.density, ["z"])
            for part, of in zip(vars(residual).values(), names, strict=True):
                if part is not None:
                    part += self.right_hand_side.of(of).reshape(part.shape)
        return self._summed(residual)

    def _summed(self, residual: Residual) -> Residual:
        """With what other ranks' cells have of the flow's, the normal derivatives' and the traces' rows."""
        flow, normals = residual.flow, residual.normals
        rows = self.shared_rows.sum(np.concatenate([flow, *([] if normals is None else [normals.ravel()])]))
        residual.flow = rows[: flow.size]
        if normals is not None:
            residual.normals = rows[flow.size :].reshape(normals.shape)
        residual.density = self.shared_density.sum(residual.density)
        return residual
