"""Programs of array operations, recorded from one evaluation of a function and run for other arguments.

A function is called once with ``Recorded`` arrays, which note each operation of NumPy on them.  A program
repeats these operations without the function's own code, which takes longer than the arithmetic if arrays
are small.  Operations on constants alone are not noted, because their results are stored. Equal operations
are noted once, and operations that no result needs are left out.  A program's results equal the function's
results to the bit.

Arrays that the function uses are constants of the program, unless they are arguments or read by ``datum``.
After each ``begin`` a program reads the data of ``datum`` again, and repeats once the operations that depend
on these data alone.

The operations must not depend on values: a decision by a value raises TypeError, and so does code other than
NumPy's.  Such code may be called by ``called``, if it is a function of arrays that does not change its
arguments.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Hashable, Mapping
from contextvars import ContextVar
from functools import lru_cache, partial
from typing import Any, Self, TypeAlias

import numpy as np

Arrays = Mapping[Any, np.ndarray]
"""Arrays by name."""


def called(function: Callable[..., Any], *arguments: Any) -> Any:
    """``function`` of the arguments; if an argument is recorded, the call is noted as one operation.

    The function must not change its arguments.
    """
    for argument in arguments:
        if isinstance(argument, Recorded):
            return argument.program.note(function, arguments)
    return function(*arguments)


def datum(read: Callable[[], np.ndarray], *key: Hashable) -> Any:
    """The array that ``read`` returns; a program that is being recorded reads it again after each ``begin``.

    Equal keys belong to the same array.
    """
    program = _RECORDING.get()
    return read() if program is None else program.datum(read, key)


Operation: TypeAlias = tuple[Callable[..., Any], tuple[int, ...], int]
"""An operation, the places of its arguments, and the place of its result."""


class Operations:
    """Operations in their order, and the values that each of them reads last."""

    def __init__(self, steps: list[Operation], kept: set[int]) -> None:
        """Results are freed after their last use, unless they are ``kept``."""
        made, freed = {place for *_, place in steps} - kept, list[list[int]]()
        for _, places, place in reversed(steps):
            last = made.intersection((*places, place))
            made -= last
            freed.append(sorted(last))
        self._steps = list(zip(steps, freed[::-1], strict=True))

    def __call__(self, values: list[Any]) -> None:
        """Carry out the operations on the values at their places."""
        for (function, places, place), freed in self._steps:
            values[place] = function(*[values[i] for i in places])
            for i in freed:
                values[i] = None


class Program:
    """The operations that a function of named arrays performs.  ``of`` makes a program."""

    def __init__(self, keeps: bool = True) -> None:
        """If ``keeps`` is True, the program reads its data once after each ``begin``, otherwise at each
        call."""
        self._keeps = keeps
        self._values: list[Any] = []
        self._steps: list[Operation] = []
        self._known: dict[Any, Recorded] = {}
        self._data: dict[Any, tuple[int, Callable[[], np.ndarray]]] = {}
        self._places = self._results = dict[Any, int]()
        self._left = list[int]()
        self._has_begun = True

    @classmethod
    def of(
        cls, function: Callable[[dict[Any, Any]], Arrays], arguments: Arrays, keeps: bool = True
    ) -> tuple[Self, Arrays]:
        """Record ``function`` at ``arguments``; return the program and the results.

        Raises TypeError, or the error that the function raises for arrays of an unknown class.
        """
        program = cls(keeps)
        program._places = {name: program._put(value) for name, value in arguments.items()}
        token = _RECORDING.set(program)
        try:
            found = function({name: Recorded(program, place) for name, place in program._places.items()})
        finally:
            _RECORDING.reset(token)
        results = {
            name: value.place if isinstance(value, Recorded) else program._put(value)
            for name, value in found.items()
        }
        program._results = results
        made = {name: program._values[place] for name, place in results.items()}
        program._finish()
        return program, made

    def _put(self, value: Any) -> int:
        self._values.append(value)
        return len(self._values) - 1

    def value(self, place: int) -> Any:
        """The value at a place; for use while the program is recorded."""
        return self._values[place]

    def note(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Recorded:
        """Note an operation, and return its result."""
        key = function, tuple(_key(argument) for argument in arguments)
        if key not in self._known:
            places = tuple(a.place if isinstance(a, Recorded) else self._put(a) for a in arguments)
            result = function(*(self._values[place] for place in places))
            if not isinstance(result, (np.ndarray, np.generic)):
                raise TypeError(f"an operation returns {type(result).__name__}, not an array")
            self._known[key] = Recorded(self, self._put(result))
            self._steps.append((function, places, self._known[key].place))
        return self._known[key]

    def datum(self, read: Callable[[], np.ndarray], key: Hashable) -> Recorded:
        """The array of a datum, see the function ``datum`` of this module."""
        if key not in self._data:
            self._data[key] = self._put(read()), read
        return Recorded(self, self._data[key][0])

    def begin(self) -> None:
        """Declare that data may have changed, so that the next call reads them."""
        self._has_begun = False

    def _finish(self) -> None:
        """Leave out the steps that no result needs. Divide the others into steps that depend on data alone,
        and steps that depend on arguments."""
        results = set(self._results.values())
        needed, steps = set(results), list[Operation]()
        for step in reversed(self._steps):
            if step[2] in needed:
                needed.update(step[1])
                steps.append(step)
        steps.reverse()
        self._places = {name: place for name, place in self._places.items() if place in needed}
        self._data = {key: datum for key, datum in self._data.items() if datum[0] in needed}
        of_arguments, of_data = set(self._places.values()), {place for place, _ in self._data.values()}
        for _, places, place in steps:
            if of_arguments.intersection(places):
                of_arguments.add(place)
            elif of_data.intersection(places):
                of_data.add(place)
        later = [step for step in steps if step[2] in of_arguments]
        seen = results.union(*(places for _, places, _ in later))
        self._at_begin = Operations([step for step in steps if step[2] in of_data], seen)
        self._at_call = Operations(later, results)
        self._steps, self._known = [], {}
        self._left = sorted((of_arguments & results).union(self._places.values()))
        self._of_data = sorted(of_data)
        for place in range(len(self._values)):
            if place in of_arguments or place not in needed or (place in of_data and place not in seen):
                self._values[place] = None
        if not self._keeps:
            self._forget()

    def _forget(self) -> None:
        """Free the data; the next call reads the data again."""
        for place in self._of_data:
            self._values[place] = None
        self._has_begun = False

    def __call__(self, arguments: Arrays) -> Arrays:
        """Results for other arguments of the same shapes."""
        values = self._values
        if not self._has_begun:
            for place, read in self._data.values():
                values[place] = read()
            self._at_begin(values)
            self._has_begun = True
        for name, place in self._places.items():
            values[place] = arguments[name]
        self._at_call(values)
        results = {name: values[place] for name, place in self._results.items()}
        for place in self._left:
            values[place] = None
        if not self._keeps:
            self._forget()
        return results


_RECORDING: ContextVar[Program | None] = ContextVar("_RECORDING", default=None)
"""The program that is being recorded."""


def _key(argument: Any) -> Any:
    """A key that only equal arguments share. The program keeps the argument alive while its key is in use."""
    if isinstance(argument, Recorded):
        return Recorded, argument.place
    if isinstance(argument, (tuple, list)):
        return type(argument), tuple(_key(part) for part in argument)
    if argument is None or isinstance(argument, (bool, int, float, str)):
        return type(argument), repr(argument)
    if isinstance(argument, slice):
        return slice, argument.start, argument.stop, argument.step
    return id(argument)


@lru_cache(maxsize=1024)
def _method(name: str, arguments: tuple[Any, ...], named: tuple[tuple[str, Any], ...]) -> Callable[..., Any]:
    return operator.methodcaller(name, *arguments, **dict(named))


@lru_cache(maxsize=1024)
def _with(function: Callable[..., Any], named: tuple[tuple[str, Any], ...]) -> Callable[..., Any]:
    return partial(function, **dict(named)) if named else function


@lru_cache(maxsize=1024)
def _of_list(function: Callable[..., Any], count: int, rest: tuple[Any, ...]) -> Callable[..., Any]:
    """A function whose first arguments are ``count`` arrays, in place of a function of their list."""
    return lambda *arrays: function(arrays[:count], *rest)


class Recorded(np.lib.mixins.NDArrayOperatorsMixin):
    """An array whose operations are noted in a program."""

    __slots__ = ("place", "program")

    def __init__(self, program: Program, place: int) -> None:
        self.program, self.place = program, place

    @property
    def _array(self) -> np.ndarray:
        return self.program.value(self.place)

    @property
    def shape(self) -> tuple[int, ...]:
        """The array's shape; a program is for arguments of the same shapes."""
        return self._array.shape

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return self._array.ndim

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the entries."""
        return self._array.dtype

    @property
    def T(self) -> Recorded:
        """The array with its axes reversed."""
        return self.transpose()

    def __len__(self) -> int:
        return len(self._array)

    def __getitem__(self, index: Any) -> Recorded:
        return self.program.note(operator.getitem, (self, index))

    def _called(self, name: str, *arguments: Any, **named: Any) -> Recorded:
        return self.program.note(_method(name, arguments, tuple(named.items())), (self,))

    def reshape(self, *shape: Any) -> Recorded:
        """See NumPy's array."""
        return self._called("reshape", *shape)

    def transpose(self, *axes: Any) -> Recorded:
        """See NumPy's array."""
        return self._called("transpose", *axes)

    def swapaxes(self, first: int, second: int) -> Recorded:
        """See NumPy's array."""
        return self._called("swapaxes", first, second)

    def sum(self, axis: Any = None) -> Recorded:
        """See NumPy's array."""
        return self._called("sum", axis=axis)

    @property
    def real(self) -> Recorded:
        """The array itself, which is real."""
        if self.dtype.kind == "c":
            self._refuse()
        return self

    def __array_ufunc__(self, function: Any, method: str, *arguments: Any, **named: Any) -> Recorded:
        if method != "__call__" or "out" in named:
            self._refuse()
        return self.program.note(_with(function, tuple(named.items())), arguments)

    def __array_function__(self, function: Any, types: Any, arguments: Any, named: Any) -> Any:
        if function is np.iscomplexobj:
            return self.dtype.kind == "c"
        function = _with(function, tuple(named.items()))
        if isinstance(arguments[0], (list, tuple)):
            first, *rest = arguments
            return self.program.note(_of_list(function, len(first), tuple(rest)), tuple(first))
        return self.program.note(function, arguments)

    def _refuse(self, *arguments: Any, **named: Any) -> Any:
        raise TypeError("a recorded function cannot depend on values, and cannot write into arrays")

    __array__ = __bool__ = __float__ = __int__ = __index__ = __iter__ = __setitem__ = _refuse
