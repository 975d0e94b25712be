"""phi''(z) of a material: the directions in which its energy is linear, and its size at rest.

Some energies are linear in some variables (in K = ln J / J the one with -epsilon ln J, many in B = F F^T):
phi'' vanishes there at every state, and the conjugate is a constant.  In the other directions phi'' is
positive definite, with ``WithQuadratic`` for every convex energy.  Parameters are no strains: phi'' is that
by the strains.
"""

from dataclasses import dataclass

import numpy as np

from ngvisco.errors import ParameterError
from ngvisco.physics.energy_checks import StateSampling
from ngvisco.physics.material import Material

_SPREAD = 0.2
"""Of the states at which an energy is asked whether it is linear."""

_ZERO = 1e-10
"""What counts as zero of phi'', over its largest entry."""


@dataclass(frozen=True)
class Curvature:
    """What of phi'' does not depend on the state.

    Attributes
    ----------
    linear : (N, N) array
        The orthogonal projection on the directions n of strains with phi''(z) n = 0 for all z.
    strains : (N,) array of bool
        Which components are those of strains.
    compliance : (N, N) array
        Of the strains, the inverse of phi''(rest) + ``linear`` (in Pa), symmetric and positive definite; it
        commutes with ``linear``.
    """

    linear: np.ndarray
    strains: np.ndarray
    compliance: np.ndarray

    @property
    def of_itself(self) -> np.ndarray:
        """The projection on ``linear`` directions and parameters, (N, N)."""
        return self.linear + np.diag(np.where(self.strains, 0.0, 1.0))


def curvature_of(material: Material, dim: int) -> Curvature:
    """That of a material on meshes of dimension ``dim``.

    Raises ParameterError where phi'' at rest is not positive definite in the directions that it has at all.
    """
    sampling, rng = StateSampling(material, dim), np.random.default_rng(0)
    rest = sampling.rest()[None]
    fitting = sampling.fitting_states(rng, _SPREAD)
    response = sampling.response(np.concatenate([rest, fitting, sampling.changed(fitting, rng, _SPREAD)]))
    strains = sampling.strains
    of_strains = np.ix_(strains, strains)
    hessians = response.hessian[:, strains][:, :, strains]
    at_rest = hessians[0]
    hessians = hessians[np.isfinite(hessians).all(axis=(1, 2))]
    sizes = np.abs(hessians).max(axis=(1, 2), keepdims=True)
    scaled = hessians / np.where(sizes > 0, sizes, 1.0)
    # the kernel of the sum of non-negative matrices is that of all of them; others are looked at
    values, vectors = np.linalg.eigh(scaled.mean(axis=0))
    kernel = vectors[:, np.abs(values) <= _ZERO]
    if np.abs(scaled @ kernel).max(initial=0.0) > _ZERO:
        kernel = kernel[:, :0]
    linear = kernel @ kernel.T
    linear[np.abs(linear) < 1e-12] = 0.0
    scale = float(np.abs(at_rest).max())
    least = np.linalg.eigvalsh(at_rest / scale + linear)[0] if scale > 0 and np.isfinite(scale) else 0.0
    if not least > _ZERO:
        raise ParameterError(
            "Regularisation.delta_fields",
            f"{type(material).__name__}, whose phi'' at rest has the least eigenvalue {least * scale:.3g} Pa",
            "an energy with a positive definite phi'' in the variables that it is not linear in; "
            "WithQuadratic makes it so",
        )
    inverse = np.linalg.inv(at_rest + linear)
    projection, compliance = np.zeros((2, sampling.size, sampling.size))
    projection[of_strains] = linear
    compliance[of_strains] = 0.5 * (inverse + inverse.T)
    return Curvature(projection, strains, compliance)
