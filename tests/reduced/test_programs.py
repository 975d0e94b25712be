"""Programs serve several steps if their functions read what changes as data."""

import numpy as np

from ngvisco.physics.recording import datum
from ngvisco.reduced.programs import Programs

C = {"a": np.arange(4.0)}


class Function:
    """A function that reads a number either as a datum, or directly, which the program does not notice."""

    def __init__(self, is_datum):
        self.is_datum, self.number, self.calls = is_datum, np.ones(1), 0

    def __call__(self, c):
        self.calls += 1
        number = datum(lambda: self.number, "number") if self.is_datum else self.number
        return {"product": c["a"] * number}


def run_steps(function, taus, keeps=True):
    """Evaluate five iterates in each step, and return the number of calls of the function in each step."""
    programs, calls = Programs(keeps), []
    for step, tau in enumerate(taus):
        function.calls, function.number = 0, np.array([step + 2.0])
        programs.start(True, tau)
        for _ in range(5):
            found = programs("product", function, C)
            assert np.array_equal(found["product"], C["a"] * function.number)
        calls.append(function.calls)
    return calls, programs


def test_a_recorded_program_is_used_in_later_steps_after_one_comparison():
    calls, programs = run_steps(Function(True), [0.1] * 4)
    assert calls == [1, 1, 0, 0]
    assert not programs.varying
    assert programs.names == ["product"]


def test_a_program_that_keeps_no_data_reads_them_at_each_call():
    function = Function(True)
    calls, programs = run_steps(function, [0.1] * 3, keeps=False)
    assert calls == [1, 1, 0]
    function.number = np.array([7.0])  # the number changes within a step
    assert np.array_equal(programs("product", function, C)["product"], 7.0 * C["a"])


def test_a_function_whose_constants_change_is_recorded_in_each_step():
    calls, programs = run_steps(Function(False), [0.1] * 4)
    assert calls == [1, 2, 1, 1]
    assert programs.varying == {"product"}


def test_steps_of_another_length_have_their_own_program():
    assert run_steps(Function(True), [0.1, 0.1, 0.2, 0.2, 0.2])[0] == [1, 1, 1, 0, 0]
