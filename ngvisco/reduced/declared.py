"""Sorts a step's terms by the part of the split solver that evaluates them, as each term declares.

A term with a ``kernel`` is evaluated by the matrices of this name.  A term with ``couples = "flow"`` is
evaluated by its form, every other term by its integrands at points.  A form may read all fields, but it has
rows only for the flow's unknowns: v, the walls' unknowns, the creep rate field.  Newton's matrix contains the
form's derivatives by the flow's unknowns, but not those by rho, z and other unknowns.  The residual is exact
in spite of this. The more strongly a form depends on rho and z, the more iterations a step takes.  A term
that contradicts its declaration raises an error with the term's name.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np

from ngvisco.errors import ParameterError
from ngvisco.forms.context import AskedContext
from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.system import Step
from ngvisco.forms.term import ANOTHER, GivenParts, PointTerm, Term, refused_by_name
from ngvisco.physics.arrays import Array
from ngvisco.reduced.one_point import OnePoint, TermRows, why
from ngvisco.reduced.point_fields import NotAtPointsError
from ngvisco.reduced.unknowns import Unknowns, density_by_forms, in_cells

_FIELDS = {"rho", "grad rho", "z", "grad z"}
"""Tests of the fields; all other tests are those of the flow's unknowns."""


class Couplings:
    """The step's terms, sorted by the way in which they are evaluated, with the rows of terms at points.

    Raises ParameterError for a term that contradicts its declaration, for a term that only the coupled solver
    accepts, and for a variable whose rate is not linear in the variables.
    """

    def __init__(self, step: Step) -> None:
        if names := step.tabulated_rates.tensors.nonlinear_variables:
            reason = f"the rate of {names[0]!r} is not linear in the variables"
            raise ParameterError("Variable.rate", names[0], "a linear rate, since ", reason)
        self.at_points: list[PointTerm] = []  # evaluated by arrays
        self.by_forms: list[Term] = []  # with rows of the flow, evaluated by forms
        self.of_kernel = defaultdict[str, list[Any]](list)  # by the name of the matrices that evaluate them
        self.forms_ask_for: set[str] = set()  # names of attributes of ``Context`` that the forms read
        self._is_bent, self._rows = density_by_forms(step), dict[int, TermRows]()
        for term in step.terms:
            if term is not step.sources:
                self._take(step, term)

    def _take(self, step: Step, term: Any) -> None:
        if reason := getattr(term, "coupled_only", None):
            raise _refused(term, reason)
        kernel, couples = getattr(term, "kernel", None), getattr(term, "couples", "flow")
        if kernel == "hyperviscosity":
            _require_arrays(step, term)
        if kernel is not None:
            self.of_kernel[kernel].append(term)
        elif couples == "flow":
            self.forms_ask_for |= _require_flow_rows(step, term)
            self.by_forms.append(term)
        else:
            self._rows[id(term)] = _rows_at_points(step, term)
            self.at_points.append(term)

    @property
    def continuity(self) -> list[PointTerm]:
        """The continuity equation if it is linear in rho. Arrays evaluate the equation, and its terms on
        facets determine rho_hat, the trace of rho."""
        return [] if self._is_bent else self.of_kernel["density"]

    @property
    def density(self) -> list[Term]:
        """The continuity equation if it is not linear in rho, evaluated by forms."""
        return self.of_kernel["density"] if self._is_bent else []

    def beside_the_points(self) -> list[Term]:
        """Terms with rows of the flow whose forms give the linearisation in v, wall stress and Pi."""
        at_coarse_points = {id(term) for term in self.of_gradients()}  # by id: a user's class may define ==
        linearised = (term for term in self.at_points if term.linearised and id(term) not in at_coarse_points)
        return [*self.by_forms, *(term for term in linearised if self._of_flow(term))]

    def of_gradients(self) -> list[PointTerm]:
        """Terms whose only tests of the flow are grad w, or w and grad w.

        A coarse quadrature rule suffices for the linearisation of these terms in v.
        """
        alone = ({"grad v"}, {"v", "grad v"})
        return [term for term in self.at_points if term.linearised and self._of_flow(term) in alone]

    def _of_flow(self, term: PointTerm) -> set[str]:
        """Names of the tests in a term's rows, except the tests of the fields."""
        return set(self._rows[id(term)].names) - _FIELDS

    @property
    def across_facets(self) -> list[PointTerm]:
        """Terms other than transport by which a cell acts on its neighbours' fields across facets."""
        return [term for term in self.at_points if term.couples == "facet"]

    def components_across_facets(self) -> list[int]:
        """Components of z in the rows of the terms ``across_facets``."""
        return sorted(set().union(*(self._rows[id(term)].components for term in self.across_facets)))

    def of_inertia(self) -> list[PointTerm]:
        """Terms whose derivative by v is the mass matrix."""
        return [term for term in self.at_points if term.is_mass]

    def of_state(self) -> list[PointTerm]:
        """Terms that the tangent linearises in z.

        Such a term has rows of z or stresses that depend on z or zeta, or it has rows of v that contain the
        density. Terms that are not ``linearised``, such as transport and the elastic force, are left out. A
        term whose rows of v contain the density is never left out.
        """
        stresses, terms = {id(term) for term in self.of_gradients()}, []
        for term in self.at_points:
            reads = self._rows[id(term)].names
            is_stress = id(term) in stresses and any(reads.values())
            of_increments = term.linearised and (reads.get("z") or is_stress)
            if of_increments or (term.weighs and reads.get("v")):
                terms.append(term)
        return terms

    def collocated(self) -> list[PointTerm]:
        """Terms that are integrated by a collocated rule: one point per coefficient of a field."""
        return [term for term in self.at_points if self._rows[id(term)].collocated]


def term_obstacle(step: Step) -> str | None:
    """The reason why the split solver refuses a term, with the term's name; None if it refuses no term."""
    try:
        Couplings(step)
    except ParameterError as error:
        return str(error.expected.parts[-1])
    return None


def _refused(term: object, reason: str) -> ParameterError:
    name = type(term).__name__
    reason = f"the split solver cannot take the term {name} ({reason})"
    return ParameterError("Simulation.terms", name, ANOTHER, reason)


def _rows_at_points(step: Step, term: PointTerm) -> TermRows:
    """Rows of a term at points; raises ParameterError if the term cannot be evaluated by arrays."""
    try:
        rows = OnePoint(step).rows(term)
    except NotAtPointsError as error:
        how = f"{error}; if the term has rows of v alone, declare couples = 'flow', so that its form is used"
        raise _refused(term, how) from error
    names = in_cells(step.layout)
    if unknown := set(rows.names) - {*names, *(f"grad {name}" for name in names)}:
        rows_of = f"the rows of {', '.join(sorted(unknown))}"
        raise _refused(term, f"{rows_of} are evaluated only by the term's form; declare couples = 'flow'")
    return rows


def _require_arrays(step: Step, term: Any) -> None:
    """Raise ParameterError if a hyperviscosity's coefficients are not functions of the values at a point."""
    law, one = term.law, Array(np.ones(1), None)
    z = step.layout.states.tensors(lambda: Array(np.ones((step.layout.states.size, 1)), None))
    try:
        with np.errstate(all="ignore"):  # the law may not be defined where all values are one
            moduli = [*law.moduli(z)]
            moduli += [law.linear(z)] if law.is_linear else [law.coefficient(one, z), law.slope(one, z)]
    except Exception as error:  # a user's law may raise anything
        raise _refused(term, f"its law cannot be evaluated with arrays: {why(error)}") from error
    if not all(isinstance(value, (int, float, Array)) for value in moduli):
        raise _refused(term, "its coefficients depend on more than the variables' values")


def _require_flow_rows(step: Step, term: Term) -> set[str]:
    """Names of the attributes of the context that a term's form reads.

    Raises ParameterError if the form tests an unknown that does not belong to the flow.
    """
    layout, names = step.layout, Unknowns(step).velocity_block
    trial, test = layout.space.TnT()
    tests = {name: part for name, part in zip(layout.names, test, strict=True) if name in names}
    reason = "has a row of {name}, but the split solver takes forms with rows of v alone"
    context: Any = AskedContext(layout.context)
    u = Fields(layout, dict(zip(layout.names, trial, strict=True)), context)
    with refused_by_name(term):
        term.form(u, Tests(layout, GivenParts(tests, reason), context))
    return context.names
