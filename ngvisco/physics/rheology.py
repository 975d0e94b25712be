"""Dissipative mechanisms of the velocity: viscosities and hyperviscosity.

A viscosity is a stress D(eps; z), the derivative of a convex potential by eps (paper: dissipation-pot).  An
isotropic viscosity has a shear viscosity G_v(s), where s = 2 |dev eps|^2 is the squared shear rate, and
G_v(s) sqrt(s) rises with s.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ngvisco.errors import ParameterError, Quantity, require_effect
from ngvisco.physics.parameters import Checked, Modulus, value_at
from ngvisco.physics.tensors import (
    Scalar,
    Tensor,
    as_array,
    dev,
    identity_like,
    inner,
    is_even,
    linear_map,
    power_of_square,
    sph,
    square,
    symmetric_tensors,
    tr,
)
from ngvisco.physics.variables import Values

ValueOfModulus: TypeAlias = float | Tensor
"""The value of a modulus: a number, or the values of an expression of parameters at points."""


class Viscosity(Checked, ABC):
    """A viscous stress D(eps), the derivative of a convex potential of the strain rate, with D(0) = 0.

    ``Model`` samples a viscosity and refuses it if its power is negative or its stress is not monotone.
    Raises ParameterError for a parameter of a dataclass outside the range of its annotation.
    """

    reads: frozenset[str] = frozenset()
    """Names among ``PRESSURE`` and ``TEMPERATURE`` that the law reads from the values ``z``."""
    is_linear: bool = False
    """Whether D is linear in eps."""

    @abstractmethod
    def stress(self, eps: Tensor, z: Values) -> Tensor:
        """The stress D(eps), 3x3, Pa, for the strain rate eps, 3x3, 1/s, at a point with the values ``z``."""

    def bulk_dissipation(self, eps: Tensor, z: Values) -> Tensor:
        """The power of the viscous pressure, D(eps) : sph eps, W/m^3."""
        return inner(self.stress(eps, z), sph(eps))

    def shear_dissipation(self, eps: Tensor, z: Values) -> Tensor:
        """The power in shear, D(eps) : dev eps, W/m^3.

        The sum with ``bulk_dissipation`` is D(eps) : eps >= 0."""
        return inner(self.stress(eps, z), dev(eps))

    @abstractmethod
    def shear_viscosity(self, z: Values) -> ValueOfModulus:
        """The shear viscosity G_v, Pa s, at eps = 0 and a point with the values ``z``."""

    def require_dimension(self, dim: int) -> None:
        """Raise ParameterError if ``dim`` is 2 and the stress of a plane flow is not one of plane strain."""
        return None


class IsotropicViscosity(Viscosity):
    """D(eps) = K_v (tr eps) I + 2 G_v(s) dev eps with the squared shear rate s = 2 |dev eps|^2.

    The potential K_v (tr eps)^2/2 + int_0^s G_v/2 ds is convex where G_v(s) sqrt(s) rises.
    """

    @abstractmethod
    def moduli(self, s: Any, z: Values) -> tuple[ValueOfModulus, ValueOfModulus]:
        """K_v and G_v, Pa s, at a squared shear rate s, 1/s^2, and a point with the values ``z``."""

    def stress(self, eps: Tensor, z: Values) -> Tensor:
        shear = dev(eps)
        K_v, G_v = self.moduli(2 * square(shear), z)
        return (K_v * tr(eps)) * identity_like(eps) + (2 * G_v) * shear

    def bulk_dissipation(self, eps: Tensor, z: Values) -> Tensor:
        """The power K_v (tr eps)^2, W/m^3."""
        return self.moduli(2 * square(dev(eps)), z)[0] * tr(eps) * tr(eps)

    def shear_dissipation(self, eps: Tensor, z: Values) -> Tensor:
        """The power 2 G_v |dev eps|^2, W/m^3."""
        s = 2 * square(dev(eps))
        return self.moduli(s, z)[1] * s

    def shear_viscosity(self, z: Values) -> ValueOfModulus:
        return self.moduli(0.0, z)[1]


@dataclass(frozen=True, kw_only=True)
class StokesViscosity(IsotropicViscosity):
    """Stokes viscosity D eps = K_v (tr eps) I + 2 G_v dev eps (paper: dissipation-pot, Euler-small-ass-D).

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    K_v : float
        Bulk viscosity: stress K_v (div v) I.
    G_v : float
        Shear viscosity: stress 2 G_v dev eps(v), the usual dynamic viscosity.
    """

    K_v: Annotated[Modulus, Quantity("Pa s", ">= 0", 0.01)]
    G_v: Annotated[Modulus, Quantity("Pa s", ">= 0", 0.01)]

    is_linear = True

    def moduli(self, s: Any, z: Values) -> tuple[ValueOfModulus, ValueOfModulus]:
        return value_at(self.K_v, z), value_at(self.G_v, z)


@dataclass(frozen=True, kw_only=True)
class PowerLaw(IsotropicViscosity):
    """The power law G_v = consistency (s + floor^2)^{(n-1)/2} (Ostwald 1925, de Waele 1923).

    The fluid thins for n < 1 and thickens for n > 1; at rest G_v = consistency floor^{n-1}.  Raises
    ParameterError if a parameter is out of its range.

    Parameters
    ----------
    K_v : float
        Bulk viscosity.
    consistency : float
        Shear stress at a shear rate of 1/s.
    n : float
        Exponent of the shear rate in the shear stress.
    floor : float
        Shear rate below which the fluid is Newtonian.
    """

    K_v: Annotated[Modulus, Quantity("Pa s", ">= 0", 0.01)]
    consistency: Annotated[Modulus, Quantity("Pa s^n", "> 0", 0.01)]
    n: Annotated[float, Quantity("1", "in (0, 5]", 0.5)]
    floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-3

    def moduli(self, s: Any, z: Values) -> tuple[ValueOfModulus, ValueOfModulus]:
        thinning = (self.floor**2 + s) ** (0.5 * (float(self.n) - 1))
        return value_at(self.K_v, z), value_at(self.consistency, z) * thinning


@dataclass(frozen=True, kw_only=True)
class _BetweenPlateaus(IsotropicViscosity):
    """G_v = G_inf + (G_0 - G_inf) share(s) with share(0) = 1.

    Parameters
    ----------
    K_v : float
        Bulk viscosity.
    G_0 : float
        Shear viscosity at rest.
    G_inf : float
        Shear viscosity at large shear rates.
    relaxation : float
        Inverse of the shear rate at which the viscosity begins to change.
    """

    K_v: Annotated[Modulus, Quantity("Pa s", ">= 0", 0.01)]
    G_0: Annotated[Modulus, Quantity("Pa s", "> 0", 1.0)]
    G_inf: Annotated[Modulus, Quantity("Pa s", ">= 0")] = 0.0
    relaxation: Annotated[float, Quantity("s", "> 0", 1.0)]

    @abstractmethod
    def share(self, s: Any) -> Any:
        """The share of G_0 - G_inf in G_v at the squared shear rate s."""

    def moduli(self, s: Any, z: Values) -> tuple[ValueOfModulus, ValueOfModulus]:
        least = value_at(self.G_inf, z)
        return value_at(self.K_v, z), least + (value_at(self.G_0, z) - least) * self.share(s)


@dataclass(frozen=True, kw_only=True)
class Carreau(_BetweenPlateaus):
    """G_v = G_inf + (G_0 - G_inf) (1 + relaxation^2 s)^{(n-1)/2} (Carreau 1972).

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    G_inf : float
        Shear viscosity at large shear rates, for n < 1; for n > 1 the viscosity grows without bound.
    n : float
        Exponent of the power law between the plateaus.
    """

    n: Annotated[float, Quantity("1", "in (0, 5]", 0.5)]

    def share(self, s: Any) -> Any:
        return (1.0 + self.relaxation**2 * s) ** (0.5 * (float(self.n) - 1))


@dataclass(frozen=True, kw_only=True)
class Cross(_BetweenPlateaus):
    """G_v = G_inf + (G_0 - G_inf)/(1 + (relaxation sqrt(s))^m) (Cross 1965).

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    relaxation : float
        Inverse of the shear rate at which the viscosity is (G_0 + G_inf)/2.
    m : float
        Exponent of the fall; above 1 the shear stress would fall with the shear rate.
    floor : float
        Shear rate below which powers of the shear rate are smoothed.
    """

    m: Annotated[float, Quantity("1", "in (0, 1]", 0.8)]
    floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-9

    def share(self, s: Any) -> Any:
        x = self.relaxation ** float(self.m) * power_of_square(s, 0.5 * self.m, self.floor)
        return 1.0 / (1.0 + x)


@dataclass(frozen=True, kw_only=True)
class LinearViscosity(Viscosity):
    """Any linear viscosity D eps, with D symmetric, positive semidefinite (paper: Euler-small-ass-D).

    Preferred directions of D are fixed in space and do not turn with the matter.  Where D couples sph eps
    with dev eps, both parts of the ledger's viscous dissipation can have either sign; their sum is D eps :
    eps >= 0.  Raises ParameterError for a D of another shape, with entries that are not finite, or
    that is not symmetric and positive semidefinite. The message has the entries or the strain rate that show
    it.

    Example::

        import ngvisco as nv

        # slow along x_1: a fluid with layers across it
        D = [[3, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0],
             [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]
        law = nv.LinearViscosity(D=D, notation="mandel")
        print(law.K_v, law.G_v)

    Parameters
    ----------
    D : array_like
        Tensor of the viscous stress D eps(v): 6x6 or 3x3x3x3, symmetric and positive semidefinite.
    notation : str
        Notation of D, with the entries in the order 11, 22, 33, 23, 13, 12: "voigt" has the D_ijkl
        themselves, "mandel" the entries in an orthonormal basis, "tensor" is 3x3x3x3.  An isotropic D has
        D_11 = K_v + 4/3 G_v in both 6x6 notations, and D_44 = G_v in Voigt's, 2 G_v in Mandel's.
    """

    D: Annotated[ArrayLike, Quantity("Pa s", example=np.eye(6).tolist())]
    notation: Annotated[Literal["mandel", "voigt", "tensor"], Quantity(example="mandel")]

    is_linear = True

    def __post_init__(self) -> None:
        super().__post_init__()
        eigenvalues, modes = np.linalg.eigh(self.mandel)
        if eigenvalues[0] < -_TOLERANCE * max(abs(eigenvalues[-1]), abs(eigenvalues[0])):
            entries = zip(modes[:, 0] / _WEIGHTS, PAIRS, strict=True)
            shown = ", ".join(f"e_{i + 1}{j + 1} = {e:.3g}" for e, (i, j) in entries)
            expected = (
                f"a D with e : D e >= 0 for every strain rate e, but the value is {eigenvalues[0]:.3g} for "
                f"{shown}"
            )
            raise ParameterError("LinearViscosity.D", self.D, expected)
        object.__setattr__(self, "D", _as_tuples(np.asarray(self.D, dtype=float)))

    @cached_property
    def mandel(self) -> np.ndarray:
        """D in Mandel's notation, (6, 6), Pa s. The basis is orthonormal, so that this matrix has the
        eigenvalues of D."""
        shape = (3, 3, 3, 3) if self.notation == "tensor" else (6, 6)
        expected = f"{'x'.join(map(str, shape))} finite numbers in the notation {self.notation!r}"
        if (array := as_array(self.D)).shape != shape:
            given = f"an array of shape {array.shape}" if array.size else self.D
            raise ParameterError("LinearViscosity.D", given, expected)
        if self.notation == "tensor":
            for axes, names in (((1, 0, 2, 3), "jikl"), ((0, 1, 3, 2), "ijlk"), ((2, 3, 0, 1), "klij")):
                _require_equal(array, array.transpose(axes), f"D_ijkl = D_{names}")
            return _BASIS.T @ array.reshape(9, 9) @ _BASIS
        _require_equal(array, array.T, "a symmetric D")
        weights = _WEIGHTS if self.notation == "voigt" else np.ones(6)
        return weights[:, None] * (0.5 * (array + array.T)) * weights

    @property
    def K_v(self) -> float:
        """Bulk viscosity of the isotropic part, Pa s: the mean normal stress of eps = I divided by tr eps."""
        return float(self.mandel[:3, :3].sum()) / 9

    @property
    def G_v(self) -> float:
        """Shear viscosity of the isotropic part, Pa s: half the mean of e : D e over e = dev e of size 1."""
        return (float(np.trace(self.mandel)) - 3 * self.K_v) / 10

    def shear_viscosity(self, z: Values) -> ValueOfModulus:
        return self.G_v

    def stress(self, eps: Tensor, z: Values) -> Tensor:
        return linear_map(full_tensor(self.mandel).reshape(9, 9), eps, (3, 3))

    def require_dimension(self, dim: int) -> None:
        if dim == 2 and np.abs(full_tensor(self.mandel)[:2, 2, :2, :2]).max() > 0:
            expected = "entries D_13kl = D_23kl = 0 for plane strain rates, since the mesh has two dimensions"
            raise ParameterError("LinearViscosity.D", self.D, expected)


PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Entries in the order of the 6x6 notations: 11, 22, 33, 23, 13, 12."""

_WEIGHTS = np.array([1.0, 1.0, 1.0, *(3 * [2**0.5])])
"""Weights of a strain's entries in Mandel's notation."""

_BASIS = symmetric_tensors(3).columns[:, [0, 3, 5, 4, 2, 1]]
"""Mandel's orthonormal basis of symmetric tensors, (9, 6): 11, 22, 33, 23, 13, 12."""

_TOLERANCE = 1e-12
"""Tolerance for symmetry and eigenvalues, relative to the largest entry; it admits rounding in the input."""


def full_tensor(mandel: np.ndarray) -> np.ndarray:
    """The tensor D_ijkl, (3, 3, 3, 3), of a matrix in Mandel's notation."""
    return (_BASIS @ mandel @ _BASIS.T).reshape(3, 3, 3, 3)


def _require_equal(first: np.ndarray, second: np.ndarray, expected: str) -> None:
    difference = np.abs(first - second)
    worst = np.unravel_index(int(np.argmax(difference)), first.shape)
    if difference[worst] > _TOLERANCE * np.abs(first).max():
        value = f"{float(first[worst])!r} at {''.join(str(int(i) + 1) for i in worst)}"
        opposite = f"{expected}, but the opposite entry is {float(second[worst])!r}"
        raise ParameterError("LinearViscosity.D", value, opposite)


def _as_tuples(array: np.ndarray) -> Any:
    return tuple(map(_as_tuples, array)) if array.ndim else float(array)


@dataclass(frozen=True, kw_only=True)
class HyperViscosity(Checked):
    """Hyperviscosity, the stress (mu_1 + mu |hess v|^{p-2}) hess v (paper: Euler-small-viscoelastodyn+1).

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    mu : float
        Hyperviscosity, which dissipates mu |hess v|^p.
    p : float
        Exponent; the paper's analysis has p > 3.
    mu_1 : float
        Coefficient of the quadratic part (the paper's mu_1 + mu_2 |.|^{p-2}).
    penalty : float
        Weight of the interior penalty in the lifted form.
    floor : float
        |hess v| below which powers other than even integers are smoothed.
    """

    mu: Annotated[Modulus, Quantity("W/m^3 (m s)^p", "> 0", 1e-5)]
    p: Annotated[float, Quantity("1", "> 1", 4.0)] = 4.0
    mu_1: Annotated[Modulus, Quantity("Pa s m^2", ">= 0", 1e-4)] = 0.0
    penalty: Annotated[float, Quantity("1", "> 0")] = 1.0
    floor: Annotated[float, Quantity("1/(m s)", "> 0")] = 1e-10

    def __post_init__(self) -> None:
        super().__post_init__()
        require_effect(self, not is_even(self.p), "with p an even integer", "floor")

    @property
    def is_linear(self) -> bool:
        """Whether the hyperstress is linear in hess v (p = 2)."""
        return self.p == 2

    def moduli(self, z: Values) -> tuple[ValueOfModulus, ValueOfModulus]:
        """mu and mu_1 at a point with the values ``z``."""
        return value_at(self.mu, z), value_at(self.mu_1, z)

    def linear(self, z: Values) -> ValueOfModulus:
        """The coefficient c = mu + mu_1 for p = 2, Pa s m^2."""
        mu, mu_1 = self.moduli(z)
        return mu + mu_1

    def coefficient(self, s: Scalar, z: Values) -> Scalar:
        """The coefficient c(s) = mu_1 + mu s^{(p-2)/2}, s = |hess v|^2 a coefficient function or an array."""
        mu, mu_1 = self.moduli(z)
        power = mu * power_of_square(s, 0.5 * (self.p - 2), self.floor)
        return power if isinstance(mu_1, (int, float)) and mu_1 == 0 else power + mu_1

    def slope(self, s: Scalar, z: Values) -> Scalar:
        """The derivative c'(s) = mu (p-2)/2 s^{(p-4)/2}."""
        return 0.5 * (self.p - 2) * self.moduli(z)[0] * power_of_square(s, 0.5 * (self.p - 4), self.floor)
