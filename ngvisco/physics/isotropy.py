"""A sampling check that an energy does not change when the observer turns.

phi(z*) = phi(z) for the values z* that an observer turned by a rotation Q sees: Q F of F and its cofactor,
Q E Q^T of spatial tensors.  For these the same condition says that phi is an isotropic function, which is
what makes S E = E S, the Cauchy stress symmetric, and B = F F^T enough to know of F.
"""

from dataclasses import dataclass

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError
from ngvisco.physics.convexity import StateSampling, array_text
from ngvisco.physics.material import Material
from ngvisco.physics.pointwise import energies_at, evaluated
from ngvisco.physics.tensors import constant

_ROTATIONS = 4
_TOLERANCE = 1e-8
"""Of |phi(z*) - phi(z)| over the spread of phi among the samples; rounding is far below it."""


@dataclass(frozen=True)
class IsotropyReport:
    """What the sampling found.

    Attributes
    ----------
    samples : int
        Pairs of a state and a turned one with finite energies.
    worst : float
        Largest |phi(z*) - phi(z)| found, Pa; 0 when the energy passed.
    rotation : (3, 3) array or None
        Q of the worst pair; None when the energy passed.
    point : mapping of names to arrays, or None
        z of the worst pair, 3x3 or scalar.
    """

    samples: int
    worst: float
    rotation: np.ndarray | None
    point: dict[str, np.ndarray] | None

    @property
    def passed(self) -> bool:
        return self.rotation is None

    def __str__(self) -> str:
        if self.rotation is None or self.point is None:
            return f"no change under rotations in {self.samples} samples"
        at = ", ".join(f"{name} = {array_text(value)}" for name, value in self.point.items())
        return f"changes by {self.worst:.3g} Pa under the rotation {array_text(self.rotation)} of {at}"


def check_isotropy(material: Material, *, dim: int = 3, spread: float = 0.4, seed: int = 0) -> IsotropyReport:
    """Look for a rotation of the observer under which a material's energy changes.

    Raises ParameterError if an argument is not what is said of it.

    Parameters
    ----------
    material : Material
    dim : int
        Dimension of the mesh it is for; in 2 the rotations are those in the plane.
    spread : float
        Size of the sampled region, as for ``check_convexity``.
    seed : int
        Of the random states and rotations.

    Returns
    -------
    IsotropyReport
    """
    rng = np.random.default_rng(seed)
    sampling = StateSampling(material, dim)
    states = sampling.random_states(rng, spread)
    energy = energies_at(material, states, dim)
    worst, found, samples = 0.0, None, 0
    for _ in range(_ROTATIONS):
        Q = _rotation(rng, dim)
        turned = energies_at(material, evaluated(_turning(material, dim, Q), states), dim)
        with np.errstate(invalid="ignore"):  # infinite at both
            change = np.abs(turned - energy)
        finite = np.isfinite(change)
        samples += int(finite.sum())
        if not finite.any():
            continue
        known = energy[np.isfinite(energy)]
        # the spread, since a constant in the energy says nothing; and its rounding
        bound = _TOLERANCE * np.ptp(known) + 1e-13 * np.abs(known).max()
        change = np.where(finite & (change > bound), change, 0.0)
        i = int(np.argmax(change))
        if change[i] > worst:
            worst, found = float(change[i]), (Q, states[i])
    if found is None:
        return IsotropyReport(samples, 0.0, None, None)
    return IsotropyReport(samples, worst, found[0], sampling.named(found[1]))


def require_isotropy(material: Material, field: str, value: object, dim: int = 3) -> None:
    """Raise ParameterError with the rotation that shows that a material's energy depends on the observer."""
    report = check_isotropy(material, dim=dim)
    if not report.passed:
        raise ParameterError(field, value, f"an energy that no rotation of the observer changes: it {report}")


def _turning(material: Material, dim: int, Q: np.ndarray):  # type: ignore[no-untyped-def]
    """The map of components to those that the turned observer sees."""
    rotation = constant(Q)

    def turn(state: CoefficientFunction) -> CoefficientFunction:
        z = material.states(dim).tensors(lambda: state)
        turned = {v.name: v.turned(z[v.name], rotation) for v in material.variables}
        return material.states(dim).components(turned)

    return turn


def _rotation(rng: np.random.Generator, dim: int) -> np.ndarray:
    """A random rotation, in the plane for dim = 2."""
    Q = np.eye(3)
    Q[:dim, :dim], R = np.linalg.qr(rng.standard_normal((dim, dim)))
    Q[:dim, :dim] *= np.sign(np.diag(R))
    Q[:, 0] *= np.linalg.det(Q)
    return Q
