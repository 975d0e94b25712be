"""The Jacobian of the coupled solver enlarges NGSolve's heap if a cell's matrix needs more memory."""

import pytest

from ngvisco.errors import StepError
from ngvisco.parallel.communicator import Communicator
from ngvisco.solver import newton
from ngvisco.solver.newton import HEAP_SIZES, CondensedJacobian


class Form:
    """A form whose assembly fails once with each given message, and then succeeds."""

    def __init__(self, *messages):
        self.messages, self.space = list(messages), self

    def FreeDofs(self, coupling):
        return None

    def AssembleLinearization(self, state):
        if self.messages:
            raise RuntimeError(self.messages.pop(0))


def jacobian(form):
    return CondensedJacobian(form, "umfpack", Communicator())


@pytest.fixture
def sizes(monkeypatch):
    asked = []
    monkeypatch.setattr(newton, "SetHeapSize", asked.append)
    return asked


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_heap_overflow_is_retried_with_a_larger_heap(sizes, count):
    form = Form(*["Local Heap overflow"] * count)
    jacobian(form).assemble(None)
    assert sizes == list(HEAP_SIZES[:count])


def test_a_step_that_overflows_the_largest_heap_fails(sizes):
    form = Form(*["Local Heap overflow"] * 3)
    with pytest.raises(StepError, match="Local Heap overflow"):
        jacobian(form).factorise(None)
    assert sizes == list(HEAP_SIZES)


def test_a_matrix_that_is_singular_because_of_units_is_reported_with_the_remedy():
    """In SI units a slab in a weak medium, with 1e11 Pa and steps of 1 kyr, has such matrices; in km and kyr
    it has none."""
    form = Form("CalcLU: matrix singularin AssembleLinearization\n")
    with pytest.raises(StepError, match=r"matrix singular.*take units in which these numbers are near one"):
        jacobian(form).factorise(None)
    with pytest.raises(StepError, match="no factorisation") as other:
        jacobian(Form("something else")).factorise(None)
    assert "units" not in str(other.value)
