"""Columns of extrema over points of cells: least and largest densities, speeds, temperatures, ...

The derivative of an extremum is the derivative of the value at a fixed point, the extremal point.  The
derivative jumps where two points have the same value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from ngsolve import CF, CoefficientFunction, Det, sqrt

from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.unknown_values import UnknownValues
from ngvisco.physics.defects import relative_defects
from ngvisco.physics.material import Material
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian, ReciprocalJacobian, Values

Place: TypeAlias = tuple[int, int]
"""Number of a sampled point, and number of one of the values at this point; defects have one value for each
pair of variables and sign."""


@dataclass(frozen=True)
class Extremum:
    """A function whose largest or least value over points is a column.

    ``choices`` computes from the function's rows the values, (points, values), that are compared.
    """

    function: CoefficientFunction
    is_largest: bool
    choices: Callable[[np.ndarray], np.ndarray] = lambda rows: rows


def _eigenvalues(rows: np.ndarray) -> np.ndarray:
    """Least eigenvalues of symmetric tensors, (points, 1), from rows of their entries."""
    return np.linalg.eigvalsh(rows.reshape(-1, 3, 3))[:, :1]


def _of_both_signs(rows: np.ndarray) -> np.ndarray:
    """The values and their negatives, so that the largest entry is the largest absolute value."""
    return np.concatenate([rows, -rows], axis=1)


def volume(
    material: Material, u: UnknownValues
) -> tuple[CoefficientFunction | None, CoefficientFunction | None]:
    """J at ``u``, and J - det F if a material carries both; None without the quantity."""
    J, F = None, None
    for variable in material.variables:
        value = u.z_tensors[variable.name]
        if isinstance(variable, Jacobian):
            J = value
        elif isinstance(variable, ReciprocalJacobian) and J is None:
            J = 1 / value
        elif isinstance(variable, Distortion) and variable.exponent == 0:
            F = value
    if isinstance(material, Mixture):
        J = 1 / material.fractions.total(u.z_tensors)
    gap = None if J is None or F is None else J - Det(F)
    return (Det(F) if J is None and F is not None else J), gap


def defects_of(model: Model, u: UnknownValues) -> tuple[CoefficientFunction | None, Values]:
    """J - det F at ``u`` (None for a material without J or without F), and ``relative_defects``."""
    _, gap = volume(model.material, u)
    return gap, relative_defects(model.material, u.z_tensors, model.traced)


def extrema(
    u: UnknownValues,
    J: CoefficientFunction | None,
    watched: Mapping[str, CoefficientFunction],
    definite: Mapping[str, CoefficientFunction],
    defects: Mapping[str, CoefficientFunction],
) -> dict[str, Extremum]:
    """Extrema of rho, J, |v|, ``watched`` values, tensors and defects at ``u``, by the ledger's columns."""
    least = {"rho_min": u.rho, **({} if J is None else {"J_min": J})}
    most = {"rho_max": u.rho, "v_max": sqrt(square(u.v))}
    for name, value in watched.items():
        (most if name.endswith("_max") else least)[name] = value
    by_columns = {name: Extremum(value, False) for name, value in least.items()}
    by_columns |= {name: Extremum(value, True) for name, value in most.items()}
    by_columns |= {name: Extremum(value, False, _eigenvalues) for name, value in definite.items()}
    if defects:
        by_columns["defect_max"] = Extremum(CF(tuple(defects.values())), True, _of_both_signs)
    return by_columns


class Extrema:
    """Extrema at a sampler's points in the present state, by the names of the ledger's columns.

    Attributes
    ----------
    names : list of str
        Those of the given names that are extrema.
    places : dict of Place, or None
        Where ``values`` are read; None to read them at the extremal points.
    """

    def __init__(self, sampler: Sampler, extrema: Mapping[str, Extremum], names: Sequence[str]) -> None:
        self._sampler, self._of = sampler, extrema
        self.names = [name for name in names if name in self._of]
        self.places: dict[str, Place] | None = None

    def found(self) -> dict[str, Place]:
        """The extremal points of the present state."""
        return {name: self._found(name) for name in self.names}

    def _found(self, name: str) -> Place:
        values, extremum = self._values(name), self._of[name]
        number = np.nanargmax(values) if extremum.is_largest else np.nanargmin(values)
        point, choice = np.unravel_index(number, values.shape)
        return int(point), int(choice)

    def _values(self, name: str, some: np.ndarray | None = None) -> np.ndarray:
        extremum = self._of[name]
        return extremum.choices(self._sampler.rows(extremum.function, some))

    def values(self) -> dict[str, float]:
        """The columns' values at ``places``, or at the extremal points."""
        places = self.found() if self.places is None else self.places
        return {name: self.at(name, places[name]) for name in self.names}

    def at(self, name: str, place: Place) -> float:
        """The value of a column at a place, in the present state."""
        point, choice = place
        return float(self._values(name, np.array([point]))[0, choice])

    def cell(self, place: Place) -> int:
        """The number of a place's cell."""
        return int(self._sampler.cells[place[0]])
