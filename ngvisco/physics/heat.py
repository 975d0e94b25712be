"""Heat of a body: conduction, exchange through walls, and sources.

A material with a temperature (``ngvisco.physics.materials.thermal``) is heated by the dissipation of all its
mechanisms.  ``Heat`` adds conduction and sources, ``WallHeat`` adds the exchange through a wall. By default
nothing is conducted, and walls are insulated.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Annotated, Any, TypeAlias

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.errors import Declared, ParameterError, Quantity, as_number
from ngvisco.physics.parameters import Checked
from ngvisco.physics.tensors import as_array, linear_map
from ngvisco.physics.variables import Values

Function: TypeAlias = float | CoefficientFunction
"""A number, or a function of the place and the run's time."""

Conductivity: TypeAlias = float | Callable[[Any], Any] | Sequence[Sequence[float]]


def require_together(law: object, *names: str) -> None:
    """Raise ParameterError if some, but not all, of a law's fields ``names`` are None."""
    missing = [name for name in names if getattr(law, name) is None]
    if 0 < len(missing) < len(names):
        expected = f"a value, since {' and '.join(names)} have to be given together"
        raise ParameterError(f"{type(law).__name__}.{missing[0]}", None, expected)


@dataclass(frozen=True, kw_only=True)
class WallHeat(Checked):
    """The heat flux into the body through a wall: flux + coefficient (temperature - theta) (Robin, Newton's
    cooling), and the share of the wall's friction heat that the body gets.

    A large coefficient holds the wall at the temperature.  A wall without ``WallHeat`` is insulated.  Raises
    ParameterError if a parameter is out of its range, one of temperature and coefficient is given without the
    other, or no parameter is given.

    Parameters
    ----------
    temperature : float, optional
        Temperature of the surroundings, which needs a coefficient; a function of the place and the run's
        time.
    coefficient : float, optional
        Heat transfer coefficient; a function of the place and the run's time.
    flux : float, optional
        Further flux inwards, independent of the temperature; a function of the place and the run's time.
    friction_share : float
        Share of the wall's friction heat that heats the body, by default all.  The rest of the friction heat
        goes into the wall.
    """

    temperature: Annotated[Function | None, Quantity("K", "> 0", 300.0)] = None
    coefficient: Annotated[Function | None, Quantity("W/(m^2 K)", ">= 0", 10.0)] = None
    flux: Annotated[Function | None, Quantity("W/m^2", example=100.0)] = None
    friction_share: Annotated[float, Quantity("1", "in [0, 1]", 0.5)] = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_together(self, "temperature", "coefficient")
        if self.temperature is None and self.flux is None and self.friction_share == 1:
            expected = "a flux, or a temperature together with a coefficient, or a share of the friction"
            raise ParameterError("WallHeat.flux", None, expected)


@dataclass(frozen=True, kw_only=True)
class Heat(Checked):
    """Conduction of heat in a body, and sources besides its dissipation.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    conductivity : float
        Thermal conductivity kappa: a number, a 3x3 matrix, symmetric and positive semidefinite, or a function
        of the temperature, theta -> kappa, written with the functions of ``ngvisco.physics.tensors``; in case
        files an expression of theta.
    source : float, optional
        Rate of heat production; a function of the place and the run's time.
    numerical_heating : bool
        Whether the dissipation of the time scheme heats the body too, so that the total energy is kept to
        rounding. This is available with the backward Euler scheme only.
    """

    conductivity: Annotated[Conductivity, Quantity("W/(m K)", example="0.5*(theta/300)**0.7")] = 0.0
    source: Annotated[Function | None, Quantity("W/m^3", example=100.0)] = None
    numerical_heating: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        conductivity, owner = self.conductivity, "Heat.conductivity"
        if as_number(conductivity) is not None:
            number = Declared(">= 0", (float,)).taken(owner, conductivity)
            object.__setattr__(self, "conductivity", number)
        elif callable(conductivity) and not isinstance(conductivity, CoefficientFunction):
            values = np.array([conductivity(np.float64(theta)) for theta in _TEMPERATURES])
            refused = ~(np.isfinite(values) & (values >= 0))
            if refused.any():
                at = int(np.argmax(refused))
                given = f"a function with the value {values[at]:.4g} at {_TEMPERATURES[at]:g} K"
                raise ParameterError(owner, given, "a function of the temperature with finite values >= 0")
        else:
            object.__setattr__(self, "conductivity", _matrix(owner, conductivity))

    @property
    def conducts(self) -> bool:
        """Whether any heat is conducted."""
        return callable(self.conductivity) or bool(np.any(np.asarray(self.conductivity)))

    def size(self, theta: CoefficientFunction) -> Any:
        """The conductivity kappa, or its largest eigenvalue for a matrix, W/(m K)."""
        if callable(self.conductivity):
            return self.conductivity(theta)
        if isinstance(self.conductivity, tuple):
            return float(np.linalg.eigvalsh(np.array(self.conductivity))[-1])
        return self.conductivity

    def flux(self, theta: CoefficientFunction, slope: CoefficientFunction, dim: int) -> CoefficientFunction:
        """The heat flux kappa grad theta, W/m^2."""
        if isinstance(self.conductivity, tuple):
            return linear_map(np.array(self.conductivity)[:dim, :dim], slope, (dim,))
        return self.size(theta) * slope


def _matrix(owner: str, value: object) -> tuple[tuple[float, ...], ...]:
    """The rows of a conductivity matrix; raises ParameterError for any other value."""
    expected = "a number >= 0, or a function of the temperature, or a 3x3 matrix"
    if (matrix := as_array(value)).shape != (3, 3):
        raise ParameterError(owner, value, expected)
    size = abs(matrix).max()
    if abs(matrix - matrix.T).max() > 1e-12 * size:
        raise ParameterError(owner, value, "a symmetric 3x3 matrix")
    if (least := np.linalg.eigvalsh(matrix)[0]) < -1e-12 * size:
        expected = f"a positive semidefinite 3x3 matrix; this matrix has the eigenvalue {least:.4g}"
        raise ParameterError(owner, value, expected)
    return tuple(map(tuple, matrix.tolist()))


_TEMPERATURES = 10.0 ** np.arange(-3, 5)
"""Temperatures, K, at which a conductivity function is checked."""


@dataclass(frozen=True)
class HeatLaw:
    """The conduction kappa = kappa_0 + sum theta_i kappa_i and the heat sources of a model and its bodies,
    weighted by the bodies' fractions."""

    parts: Mapping[str | None, Heat]
    """Laws by the bodies' names; the key is None for all matter."""
    fractions: Any = None
    """Volume fractions of the bodies, ``ngvisco.physics.bodies.Fractions``; None without bodies."""

    @property
    def conducts(self) -> bool:
        """Whether any heat is conducted."""
        return any(law.conducts for law in self.parts.values())

    @property
    def numerical_heating(self) -> bool:
        return any(law.numerical_heating for law in self.parts.values())

    @property
    def sources(self) -> list[tuple[str | None, Function]]:
        """Pairs of a body's name, None for all matter, and its rate of heat production, W/m^3."""
        return [(name, law.source) for name, law in self.parts.items() if law.source is not None]

    def share(self, body: str | None, z: Values) -> Any:
        """The fraction of a body at a point with the values ``z``; 1 without a name."""
        return 1.0 if body is None else self.fractions.not_negative(z)[body]

    def size(self, theta: Any, z: Values) -> Any:
        """The conductivity kappa, or its largest eigenvalue for a matrix, W/(m K)."""
        return self._sum(z, lambda law: law.size(theta))

    def flux(self, theta: Any, slope: Any, z: Values, dim: int) -> Any:
        """The heat flux kappa grad theta, W/m^2."""
        return self._sum(z, lambda law: law.flux(theta, slope, dim))

    def _sum(self, z: Values, quantity: Callable[[Heat], Any]) -> Any:
        conducting = {name: law for name, law in self.parts.items() if law.conducts or name is None}
        return reduce(add, (self.share(name, z) * quantity(law) for name, law in conducting.items()))
