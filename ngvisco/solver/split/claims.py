"""Which part of the split solver takes which term of the system: every term is taken by exactly one.

The package's own terms are known by their class, not by inheritance: a class derived from one of them is
another equation.  Any other term is taken by its own form where it has rows of the flow's unknowns only (v,
the wall stress, the creep rate field); it may read all fields.  Its derivative by the flow's unknowns is in
Newton's increments, that by rho, z and the others is not: it acts exactly, and takes more iterations the
more it changes with these. A term with other rows is none for this solver, which says so by the term's
name.
"""

from __future__ import annotations

from ngvisco.forms.context import Term
from ngvisco.forms.creep import CreepRate
from ngvisco.forms.hyperviscosity import Hyperviscosity
from ngvisco.forms.momentum import Continuity, Convection, Inertia, Loading, Stokes
from ngvisco.forms.regularisation import CutOffVolume, DensityDiffusion, FieldDiffusion, VelocityDamping
from ngvisco.forms.spaces import Fields
from ngvisco.forms.system import Step
from ngvisco.forms.transport import Conjugates, ElasticForce, Kinematics, UpwindTrace
from ngvisco.forms.wall_terms import Impenetrability, TangentialStress
from ngvisco.solver.split.unknowns import Unknowns
from ngvisco.solver.split.withheld import GivenParts, WithheldError

DENSITY = (Continuity, DensityDiffusion)
"""The continuity equation: at the points, or by forms where it is not linear (``Transport``)."""

FIELDS = (Kinematics, Conjugates, UpwindTrace, FieldDiffusion)
"""The equations of z, its traces and conjugates (``Transport``)."""

AT_POINTS = (Inertia, Convection, Stokes, Loading, ElasticForce)
"""Rows of v that ``Momentum`` evaluates at the points."""

HYPERVISCOSITY = (Hyperviscosity,)
"""``MatrixHyperviscosity``."""

BY_FORMS = (Impenetrability, TangentialStress, VelocityDamping, CreepRate)
"""Rows of the flow that ``Momentum`` evaluates by the terms' own forms, as those of foreign terms."""

WITHOUT_ROWS = (CutOffVolume,)
"""Columns of the ledger only."""

_OWN = (*DENSITY, *FIELDS, *AT_POINTS, *HYPERVISCOSITY, *BY_FORMS, *WITHOUT_ROWS)


def flow_terms(step: Step) -> list[Term]:
    """The terms whose rows of the flow are evaluated by their forms."""
    return [term for term in step.terms if type(term) in BY_FORMS or _is_foreign(step, term)]


def term_obstacle(step: Step) -> str | None:
    """Why a term of the step cannot be taken, by its name, or None."""
    for term in step.terms:
        if _is_foreign(step, term):
            try:
                _require_flow_rows(step, term)
            except WithheldError as error:
                return f"{type(term).__name__}: {error}"
    return None


def _is_foreign(step: Step, term: Term) -> bool:
    return type(term) not in _OWN and term is not step.sources


def _require_flow_rows(step: Step, term: Term) -> None:
    """Raise WithheldError if the term has rows of anything but the flow's unknowns."""
    layout, names = step.layout, Unknowns(step).flow
    trial, test = layout.space.TnT()
    tests = {name: part for name, part in zip(layout.names, test, strict=True) if name in names}
    reason = "it has a row of {name}, and the split solver takes terms with rows of the flow only"
    term.form(layout.fields(trial), Fields(layout, GivenParts(tests, reason)))
