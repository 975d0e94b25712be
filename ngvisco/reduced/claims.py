"""Which part of the split solver takes which term of the system: every term is taken by exactly one.

The package's own terms are known by their class, not by inheritance: a class derived from one of them is
another equation.  Every term that is a function of the values at a point is taken by its arrays, whatever it
is (``ngvisco.reduced.evaluation``).  Any other term is taken by its own form where it has rows of
the flow's unknowns only (v, the wall stress, the creep rate field); it may read all fields.  Its derivative
by the flow's unknowns is in Newton's increments, that by rho, z and the others is not: it acts exactly, and
takes more iterations the more it changes with these.  A term with other rows is none for this solver, which
says so by the term's name.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ngvisco.errors import ParameterError
from ngvisco.forms.context import Context
from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.system import Step
from ngvisco.forms.term import CellMean, GivenParts, PointTerm, Term, refused_by_name
from ngvisco.forms.terms.heat import Heating
from ngvisco.forms.terms.hyperviscosity import Hyperviscosity
from ngvisco.forms.terms.momentum import Continuity, Inertia, Loading
from ngvisco.forms.terms.regularisation import CutOffVolume, DensityDiffusion, FieldDiffusion
from ngvisco.forms.terms.transport import Conjugates, ElasticForce, Kinematics
from ngvisco.forms.upwinding import SideMean
from ngvisco.physics.arrays import Array
from ngvisco.reduced.evaluation import NotAtPointsError
from ngvisco.reduced.one_point import OnePoint, why
from ngvisco.reduced.unknowns import Unknowns, density_by_forms, in_cells

_FIELDS = {"rho", "grad rho", "z", "grad z"}
"""Tests whose rows are those of the fields, and not of the flow."""

_PARTS: dict[type, str] = {
    Continuity: "continuity",
    Hyperviscosity: "hyperviscosity",
    FieldDiffusion: "diffusion",
    Conjugates: "conjugates",
    CutOffVolume: "without_rows",
}
"""Classes of terms that are neither at points nor by forms as they are."""


@dataclass
class Claims:
    """Terms by the part of the solver that takes them."""

    traces: list[SideMean] = field(default_factory=list)
    """Equations of means of both sides, as the trace of z, solved for these."""
    means: list[CellMean] = field(default_factory=list)
    """Means over cells, solved for these."""
    conjugates: list[Term] = field(default_factory=list)
    """The projection of phi'(z)."""
    at_points: list[PointTerm] = field(default_factory=list)
    """Terms that are evaluated by arrays."""
    continuity: list[Continuity] = field(default_factory=list)
    """The continuity equation where it is linear in rho, by arrays; solved for the trace of rho."""
    density: list[Term] = field(default_factory=list)
    """The continuity equation where it is not linear in rho, by forms."""
    by_forms: list[Term] = field(default_factory=list)
    """Rows of the flow by forms."""
    forms_ask_for: set[str] = field(default_factory=set)
    """Names of what these take of the step's ``Context``."""
    diffusion: list[FieldDiffusion] = field(default_factory=list)
    hyperviscosity: list[Hyperviscosity] = field(default_factory=list)
    sources: list[Term] = field(default_factory=list)
    """Known before the iteration."""
    rows: dict[int, dict[str, bool]] = field(default_factory=dict)
    """Names of the tests that a term at points has rows of, by its id; whether these read z or zeta."""
    components: dict[int, frozenset[int]] = field(default_factory=dict)
    """Components of z that a term at points has rows of, by its id."""
    at_nodes: set[int] = field(default_factory=set)
    """Ids of those of them with rows by as many points as a field has values in a cell."""
    without_rows: list[Term] = field(default_factory=list)
    """Columns of the ledger only."""

    @classmethod
    def of(cls, step: Step) -> Claims:
        """Every term of the step in exactly one part.

        Raises
        ------
        ParameterError
            For a term that no part takes, a variable whose rate is not linear in the variables, or heat that
            the diffusion of the fields makes.
        """
        if bent := step.tabulated_rates.tensors.bent:
            expected = f"the rate of {bent[0]!r} is not linear in the variables, as the split solver needs it"
            raise ParameterError("Variable.rate", bent[0], expected)
        diffusing = [term for term in step.terms if isinstance(term, FieldDiffusion)]
        if diffusing and any(isinstance(term, Heating) for term in step.terms):
            expected = "Regularisation.delta_fields with heat: what it dissipates is made of phi'' by forms"
            raise ParameterError("Regularisation.delta_fields", diffusing[0].law.delta_fields, expected)
        claims = cls()
        for term in step.terms:
            claims._claim(step, term)
        return claims

    def beside_the_points(self) -> list[Term]:
        """Terms of the flow whose linearisation by v, wall stress and Pi is taken from their forms."""
        own = (Inertia, ElasticForce, Loading, Kinematics)
        at_coarse_points = {id(term) for term in self.of_gradients()}  # not by ==, which is the user's
        others = [
            term
            for term in self.at_points
            if type(term) not in own
            and term.linearised
            and id(term) not in at_coarse_points
            and self._of_flow(term)
        ]
        return [*self.by_forms, *others]

    def of_gradients(self) -> list[PointTerm]:
        """Terms with rows of grad w, whose linearisation by v a coarse rule will do for; not the elastic
        force, which changes with the fields, nor what couples v with another unknown of the flow."""
        alone = ({"grad v"}, {"v", "grad v"})
        terms = (term for term in self.at_points if self._of_flow(term) in alone)
        return [term for term in terms if term.linearised and not isinstance(term, ElasticForce)]

    def _of_flow(self, term: Term) -> set[str]:
        """Tests of the flow that a term at points has rows of."""
        return set(self.rows[id(term)]) - _FIELDS

    @property
    def across_facets(self) -> list[PointTerm]:
        """Terms by which cells change each other's fields across facets, beside transport."""
        return [term for term in self.at_points if term.couples == "facet"]

    def components_across_facets(self) -> list[int]:
        """Components of z whose rows these have."""
        found = [self.components[id(term)] for term in self.across_facets]
        return sorted(set().union(*found))

    def of_inertia(self) -> list[PointTerm]:
        """Terms of dv/dt, whose matrix is that of the whole rule: a coarse one makes it singular."""
        return [term for term in self.at_points if type(term) is Inertia]

    def of_state(self) -> list[PointTerm]:
        """Terms with rows of z, and stresses, that read z or zeta: not the rates and the elastic force."""
        stresses, found = {id(term) for term in self.of_gradients()}, []
        for term in self.at_points:
            reads = self.rows[id(term)]
            is_stress = id(term) in stresses and any(reads.values())
            if type(term) is not Kinematics and term.linearised and (reads.get("z") or is_stress):
                found.append(term)
        return found

    def of_nodes(self) -> list[PointTerm]:
        """Terms with rows by as many points as a field has values in a cell."""
        return [term for term in self.at_points if id(term) in self.at_nodes]

    def _claim(self, step: Step, term: Term) -> None:
        kind, obstacle = type(term), None
        if kind is Hyperviscosity:
            _require_arrays(step, term)
        if term is step.sources:
            part = "sources"
        elif kind in (Continuity, DensityDiffusion) and density_by_forms(step):
            part = "density"
        elif kind in _PARTS:
            part = _PARTS[kind]
        elif isinstance(term, SideMean) and type(term).facets is SideMean.facets:
            part = "traces"
        elif isinstance(term, CellMean) and type(term).cells is CellMean.cells:
            part = "means"
        else:
            obstacle = self._obstacle_at_points(step, term)
            part = "at_points" if obstacle is None else "by_forms"
        if obstacle is not None:
            self.forms_ask_for |= _require_flow_rows(step, term, obstacle)
        getattr(self, part).append(term)

    def _obstacle_at_points(self, step: Step, term: Term) -> str | None:
        """Why a term is not taken by its arrays, or None; notes its rows."""
        if not isinstance(term, PointTerm) or type(term).form is not PointTerm.form:
            return "it states its form itself"  # which may say more than ``cells`` and ``facets``
        try:
            found = OnePoint(step).slots(term)
        except NotAtPointsError as error:
            return str(error)
        rows, at_nodes = found.names, found.at_nodes
        self.rows[id(term)], self.components[id(term)] = rows, found.components
        if at_nodes:
            self.at_nodes.add(id(term))
        names = in_cells(step.layout)
        others = set(rows) - {*names, *(f"grad {name}" for name in names)}
        return f"no array takes its rows of {', '.join(sorted(others))}" if others else None


def term_obstacle(step: Step) -> str | None:
    """Why a term of the step cannot be taken, by its name, or None."""
    try:
        Claims.of(step)
    except ParameterError as error:
        return str(error.expected)
    return None


def _require_arrays(step: Step, term: Any) -> None:
    """Raise ParameterError if a hyperviscosity's coefficients are not functions of the values at a point."""
    law, one = term.law, Array(np.ones(1), None)
    z = step.layout.states.tensors(lambda: Array(np.ones((step.layout.states.size, 1)), None))
    reason = None
    try:
        with np.errstate(all="ignore"):  # all values one need not be in the law's domain
            found = [*law.moduli(z)]
            found += [law.linear(z)] if law.is_linear else [law.coefficient(one, z), law.slope(one, z)]
        if not all(isinstance(value, (int, float, Array)) for value in found):
            reason = "its coefficients are not made of the variables' values alone"
    except Exception as error:  # whatever a law raises at values that it does not know
        reason = f"its law does not take arrays: {why(error)}"
    if reason is not None:
        name = type(term).__name__
        raise ParameterError("Simulation.terms", name, f"{name}: {reason}")


class _Asked:
    """A context that remembers what was asked for."""

    def __init__(self, context: Context) -> None:
        self._context, self.names = context, set[str]()

    def __getattr__(self, name: str) -> Any:
        self.names.add(name)
        return getattr(self._context, name)


def _require_flow_rows(step: Step, term: Term, obstacle: str | None) -> set[str]:
    """Names of what a term by its form takes of the context.

    ``obstacle`` is why it has to be taken by its form.

    Raises
    ------
    ParameterError
        If it has rows of anything but the flow's unknowns.
    """
    layout, names = step.layout, Unknowns(step).flow
    trial, test = layout.space.TnT()
    tests = {name: part for name, part in zip(layout.names, test, strict=True) if name in names}
    reason = "it has a row of {name}, and the split solver takes forms with rows of the flow only"
    if obstacle is not None:
        reason += f"; as arrays it cannot be taken: {obstacle}".replace("{", "{{").replace("}", "}}")
    context: Any = _Asked(layout.context)
    u = Fields(layout, dict(zip(layout.names, trial, strict=True)), context)
    with refused_by_name(term):
        term.form(u, Tests(layout, GivenParts(tests, reason), context))
    return context.names
