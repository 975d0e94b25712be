"""Parameters of a run by name, and runs with other values of the parameters.

A name is a path of attributes, keys and numbers, separated by dots, that begins at a part of the run:
``material``, ``viscosity``, ``hyperviscosity``, ``creep``, ``heat``, ``regularisation``, ``loads`` and
``bodies`` of the model, ``initial`` or ``walls``.  A member of ``loads`` or ``bodies`` is named by its name
or its number: ``material.G_e``, ``loads.gravity.g.1``, ``bodies.disc.material.G_e``,
``walls.top.velocity.0``.  The path may begin with the tables ``rheology`` or ``model`` of case files.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ngvisco.errors import NgviscoError, ParameterError, UnknownNameError, as_number, require_known
from ngvisco.run.simulation import Observer, Simulation

_OF_MODEL = ("material", "viscosity", "hyperviscosity", "creep", "heat", "regularisation", "loads", "bodies")
_OF_RUN = ("initial", "walls")
_IN_FRONT = ("rheology", "model")
PART = "part of a run"
"""Words with which messages denote the first key of a path."""
_START = "initial"

STEP, AT_FIXED_STATES = 1e-4, 1e-3
"""Spacing h of the differences by a parameter p, relative to p, for a tangent and for an adjoint.

The spacing of an adjoint is larger: its differences do not change states, and laws are smoother in their
parameters than in the state."""
OFFSETS = {4: (-2.0, -1.0, 1.0, 2.0), 2: (-0.1, 0.1)}
"""Offsets o of the evaluations at p + o h, by the order of the differences."""


def differenced(values: Sequence[np.ndarray], h: float) -> np.ndarray:
    """Derivative by p, from values at p + o h for the four or two ``OFFSETS`` o."""
    if len(values) == 2:
        return np.asarray((values[1] - values[0]) / ((OFFSETS[2][1] - OFFSETS[2][0]) * h))
    far_below, below, above, far_above = values
    return np.asarray((8 * (above - below) - (far_above - far_below)) / (12 * h))


@dataclass(frozen=True)
class Named:
    """A parameter of a run, given by a path as described in this module.

    Raises ParameterError for a path that leads to no number, UnknownNameError for an unknown part.

    Attributes
    ----------
    name : str
        The path as the user gave it.
    value : float
        Value of the parameter in the run, in SI units.
    spacing : float
        Spacing h > 0 of the differences by the parameter.
    """

    name: str
    value: float
    spacing: float
    keys: tuple[str, ...]

    @classmethod
    def of(cls, name: str, simulation: Simulation, step: float = STEP) -> Named:
        """The parameter ``name`` of a run.  ``step`` is the spacing relative to the parameter's size."""
        if not isinstance(name, str):
            raise ParameterError("by", name, 'names of parameters, e.g. "material.G_e"')
        keys = tuple(name.split("."))
        keys = keys[1:] if keys[0] in _IN_FRONT else keys
        require_known(PART, keys[:1], (*_OF_MODEL, *_OF_RUN), "by")
        part = _found(_root(simulation, keys[0]), keys[1:], name)
        value = as_number(part)
        if value is None:
            expected = "the name of one number, and not of a function or a table"
            raise ParameterError(f"by: {name}", part, expected)
        parent = _found(_root(simulation, keys[0]), keys[1:-1], name)
        beside = parent if isinstance(parent, (tuple, list)) else ()
        size = max([abs(value), *(abs(as_number(neighbour) or 0.0) for neighbour in beside)])
        return cls(name, value, step * (size or 1.0), keys)

    @property
    def is_of_start(self) -> bool:
        """Whether the parameter is a start value, on which no equation of a step depends."""
        return self.keys[0] == _START

    def varied(self, simulation: Simulation, value: float) -> Simulation:
        """A new run at its start, without observers, with another value of the parameter.

        Raises ParameterError for a value outside the parameter's range.
        """
        try:
            return varied(simulation, {self: value})
        except NgviscoError as error:
            least = f"at least {2 * self.spacing:.2g}"
            expected = f"a value at a distance of {least} from the ends of its range ({error})"
            raise ParameterError(f"by: {self.name}", self.value, expected) from error


def varied(
    simulation: Simulation, values: Mapping[Named, float], observers: Sequence[Observer] = ()
) -> Simulation:
    """A new run at its start with other values of parameters.

    The run's velocity scale is kept.  Raises ParameterError for a value outside a parameter's range.
    """
    steps = dataclasses.replace(simulation.arguments["time"], velocity_scale=simulation.velocity_scale)
    model, parts = simulation.model, {name: simulation.arguments[name] for name in _OF_RUN}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the original run has shown its warnings
        for parameter, value in values.items():
            root, inner_keys = parameter.keys[0], parameter.keys[1:]
            if root in _OF_RUN:
                parts[root] = _changed(parts[root], inner_keys, value)
            else:
                changed = {root: _changed(getattr(model, root), inner_keys, value)}
                model = dataclasses.replace(model, **changed)
        given: dict[str, Any] = {"model": model, "time": steps, "passive": (), "observers": observers}
        changed_run = simulation.on(simulation.mesh, **parts, **given)
    if len(changed_run.rothe_step.state.vec) != len(simulation.rothe_step.state.vec):
        names = ", ".join(parameter.name for parameter in values)
        raise ParameterError("by", names, "parameters that do not change the number of unknowns")
    return changed_run


def _root(simulation: Simulation, name: str) -> Any:
    return simulation.arguments[name] if name in _OF_RUN else getattr(simulation.model, name)


def _member(owner: Any, key: str) -> Any:
    """Key, index or field that ``key`` denotes in its owner; None if the owner has none."""
    if isinstance(owner, Mapping):
        names = [k for k in owner if key in ((k,) if isinstance(k, str) else k)]
        return names[0] if names else None
    if isinstance(owner, Sequence) and not isinstance(owner, str):
        if key.lstrip("-").isdigit() and -len(owner) <= int(key) < len(owner):
            return int(key)
        named = [i for i, member in enumerate(owner) if getattr(member, "name", None) == key]
        return named[0] if named else None
    if dataclasses.is_dataclass(owner):
        names = [field.name for field in dataclasses.fields(owner)]
        return key if key in names else "material" if "material" in names else None
    return None


def _known(owner: Any) -> list[str]:
    """Keys of the parts of ``owner``: keys of a mapping, names or numbers of members, or fields of a
    dataclass."""
    if isinstance(owner, Mapping):
        return [str(key) for key in owner]
    if isinstance(owner, Sequence) and not isinstance(owner, str):
        return [getattr(member, "name", str(i)) for i, member in enumerate(owner)]
    return [field.name for field in dataclasses.fields(owner)] if dataclasses.is_dataclass(owner) else []


def _get(owner: Any, place: Any) -> Any:
    return getattr(owner, place) if dataclasses.is_dataclass(owner) else owner[place]


def _found(owner: Any, keys: Sequence[str], name: str) -> Any:
    if not keys:
        return owner
    place = _member(owner, keys[0])
    if place is None:
        raise UnknownNameError(f"part in {name!r}:", keys[0], _known(owner), "by")
    is_within = dataclasses.is_dataclass(owner) and place != keys[0]  # the key belongs to a wrapped material
    return _found(_get(owner, place), keys if is_within else keys[1:], name)


def _changed(owner: Any, keys: Sequence[str], value: float) -> Any:
    """A copy of the owner with another value at the end of the path."""
    if not keys:
        return value
    place = _member(owner, keys[0])
    is_within = dataclasses.is_dataclass(owner) and place != keys[0]
    part = _changed(_get(owner, place), keys if is_within else keys[1:], value)
    if dataclasses.is_dataclass(owner):
        return dataclasses.replace(owner, **{place: part})  # type: ignore[type-var]
    if isinstance(owner, Mapping):
        return {**owner, place: part}
    return tuple(part if i == place % len(owner) else member for i, member in enumerate(owner))
