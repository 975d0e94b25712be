"""Fields of a run that are written only where they are asked for by name: further stresses and rates.

| name                 | what                                                                  | unit |
|----------------------|-----------------------------------------------------------------------|------|
| creep_rate           | Pi, 3x3, where there is creep                                         | 1/s  |
| mandel_stress        | M, 3x3, of materials with tensors                                     | Pa   |
| viscous_stress       | D eps(v), 3x3                                                         | Pa   |
| hyperstress_i        | (mu_1 + mu |hess v|^{p-2}) d_j d_k v_i at jk, 3x3, for each i         | Pa m |
| principal_stresses   | eigenvalues of the Cauchy stress, the largest first                   | Pa   |
| principal_stretches  | singular values of the elastic F, the largest first; 1 + those of E   | 1    |
"""

import math
from collections.abc import Iterable

import numpy as np
from ngsolve import CF, CoefficientFunction, acos, cos, sqrt

from ngvisco.forms.fields import Fields, hessian_basis
from ngvisco.forms.system import Step
from ngvisco.physics.material import mandel_stress, volume_ratio
from ngvisco.physics.tensors import IDENTITY, constant, det, dev, if_positive, square, sym, tr
from ngvisco.physics.variables import Distortion, LeftCauchyGreen, SmallStrain

NAMES = (
    "creep_rate",
    "mandel_stress",
    "viscous_stress",
    *(f"hyperstress_{i}" for i in (1, 2, 3)),
    "principal_stresses",
    "principal_stretches",
)


def usual(names: Iterable[str]) -> list[str]:
    """Of the names of a run's fields those that are written where none are asked for."""
    return [name for name in names if name not in NAMES]


def further_fields(step: Step, cauchy: CoefficientFunction) -> dict[str, CoefficientFunction]:
    """The fields above, as far as the model has them, at the new state; ``cauchy`` is its Cauchy stress."""
    u, model, dim = step.now, step.model, step.mesh.dim
    found: dict[str, CoefficientFunction] = {}
    Pi = step.context.rates.mean_creep(u)
    if Pi is not None:
        found["creep_rate"] = Pi
    if any(variable.creeps for variable in model.material.variables):
        found["mandel_stress"] = mandel_stress(model.material, u.z_tensors, u.zeta_tensors, dim)
    if model.viscosity is not None:
        found["viscous_stress"] = model.viscosity.stress(
            sym(u.L), step.context.rates.read_values(model.viscosity, u)
        )
    if model.hyperviscosity is not None:
        found |= {f"hyperstress_{i + 1}": _hyperstress(u, i) for i in range(dim)}
    found["principal_stresses"] = eigenvalues(cauchy)
    stretches = principal_stretches(step)
    if stretches is not None:
        found["principal_stretches"] = stretches
    return found


def eigenvalues(A: CoefficientFunction) -> CoefficientFunction:
    """Eigenvalues of a symmetric 3x3 tensor, the largest first, a vector of three.

    With A = q I + p B, tr B = 0, |B|^2 = 6 they are q + 2 p cos(phi + 2 pi k/3), cos 3 phi = det B/2.
    """
    q, deviator = (1 / 3) * tr(A), dev(A)
    s = square(deviator) / 6
    p = sqrt(if_positive(s, s, 0.0))
    # of a spherical tensor every direction is a principal one: any phi will do
    cosine = 0.5 * det(deviator) / if_positive(s, s * p, 1.0)
    cosine = if_positive(cosine - 1, 1.0, if_positive(cosine + 1, cosine, -1.0))  # rounding
    phi = acos(cosine) / 3
    return CF(tuple(q + 2 * p * cos(phi + 2 * math.pi * k / 3) for k in (0, 2, 1)))


def principal_stretches(step: Step) -> CoefficientFunction | None:
    """Singular values of the elastic distortion; None for a material without a tensor that has them."""
    values, variables = step.now.z_tensors, step.model.material.variables
    for variable in variables:
        value = values[variable.name]
        if isinstance(variable, SmallStrain):
            return eigenvalues(IDENTITY + value)
        if isinstance(variable, (Distortion, LeftCauchyGreen)):
            by_F = isinstance(variable, Distortion)
            power = (2 if by_F else 1) * variable.exponent
            squares = eigenvalues(value * value.trans if by_F else value)
            if power:
                squares = squares * volume_ratio(step.model.material, values) ** (-power)
            return CF(tuple(sqrt(if_positive(squares[i], squares[i], 0.0)) for i in range(3)))
    return None


def _hyperstress(u: Fields, i: int) -> CoefficientFunction:
    """S_ijk at jk, 3x3."""
    dim, basis = u.dim, hessian_basis(u.dim)
    size = basis.shape[1]
    matrix = np.zeros((3, 3, dim, size))
    matrix[:dim, :dim, i] = basis.reshape(dim, dim, size)
    return (constant(matrix.reshape(9, dim * size)) * u.parts["hyperstress"]).Reshape((3, 3))
