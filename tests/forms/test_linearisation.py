"""The Jacobian of all terms, as NGSolve assembles it, against central differences of the residual."""

import numpy as np
import pytest
from support import (
    Case,
    by_ci,
    difference_times,
    jacobian_times,
    random_direction,
    randomise,
    residual,
    step_of,
    uncondensed,
)

from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand, Term

CASES = [
    Case(),
    Case(k=3, m=2, p=3.5, mu_1=0.3),
    Case(m=0, p=2.0, creep=False),
    Case(material="linear", mu_1=0.3),
    Case(material="linear", k=3, p=2.0, mu_1=0.1),
    Case(material="hardening", m=2, p=3.5),
    Case(dim=3),
    Case(dim=3, material="linear", m=0, p=3.5, mu_1=0.3),
    Case(dim=3, material="linear", k=3, p=4.0, creep=False),
]
TOLERANCE = 1e-8


def integrands(step: Step, term: Term) -> list[Integrand]:
    trial, test = step.layout.space.TnT()
    return term.form(Fields.of(step.layout, trial), Fields.of(step.layout, test))


def mismatch(step: Step, parts: list[Integrand], seed: int) -> float:
    """Largest error of Jacobian times direction relative to its largest entry."""
    randomise(step, seed)
    direction = random_direction(step, seed + 100)
    form = uncondensed(step, parts)
    assembled = jacobian_times(form, step.state.vec, direction)
    difference = difference_times(form, step.state.vec, direction)
    scale = np.abs(difference).max()
    assert scale > 0 and np.all(np.isfinite(assembled))
    return float(np.abs(assembled - difference).max() / scale)


@pytest.mark.parametrize("case", [*CASES[:-1], by_ci(CASES[-1])], ids=str)
def test_linearisation_of_the_whole_residual_equals_its_central_difference(case: Case) -> None:
    step = step_of(case)
    parts = [part for term in step.terms for part in integrands(step, term)]
    # some differences may extend over a kink of |v . n|
    assert min(mismatch(step, parts, seed) for seed in range(6)) < TOLERANCE


@pytest.mark.parametrize("case", CASES[:4], ids=str)
def test_rows_by_blocks_of_variables_equal_rows_by_vectors(case: Case) -> None:
    """Rows and free unknowns of the step's form equal those of a form with z and zeta as vectors."""
    step = step_of(case)
    randomise(step, 1)
    assert list(step.residual.space.FreeDofs(True)) == list(step.layout.space.FreeDofs(True))
    u, w = step.linearised_fields(step.layout.space.TrialFunction()), step.tests()
    forms = step.residual, uncondensed(step, [part for term in step.terms for part in term.form(u, w)])
    by_blocks, whole = (residual(form, step.state.vec) for form in forms)
    for rows in step.layout.ranges.values():
        assert np.allclose(by_blocks[rows], whole[rows], rtol=0, atol=1e-13 * np.abs(whole).max())


@pytest.mark.parametrize("case", CASES, ids=str)
def test_linearisation_at_rest_is_finite(case: Case) -> None:
    """Velocity and Hessian are zero; powers and roots of zero must not give NaN."""
    step = step_of(case)
    randomise(step, size=0.0)
    step.local_unknowns.update()  # |Hs|^2 becomes exactly 0
    applied = jacobian_times(uncondensed(step), step.state.vec, random_direction(step))
    assert np.all(np.isfinite(applied)) and np.abs(applied).max() > 0
