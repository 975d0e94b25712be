"""The energy of a body per reference volume, as a material: psi(B, J) = J phi(z).

phi(z) is an energy per actual volume of tensors and of functions of J.  Where one of its tensors has a power
of J that makes it a density, such as J^{-5/3} F F^T, psi is that of J times the tensor.  Bodies share a point
by n psi(X/n, alpha/n) (``ngvisco.physics.mixture``), which is convex where psi is: energies that are not
convex in (B, J) are no energies of bodies.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError
from ngvisco.physics.convexity import StateSampling, check_convexity
from ngvisco.physics.material import Material
from ngvisco.physics.materials.thermal import Thermal
from ngvisco.physics.parameters import Parameter, distinct, parameters_in, substituted
from ngvisco.physics.pointwise import respond
from ngvisco.physics.tensors import IDENTITY, log
from ngvisco.physics.variables import (
    DistortionTensor,
    Jacobian,
    LogJacobian,
    ReciprocalJacobian,
    SmallStrain,
    Values,
    Variable,
)

_ROUNDING = 1e-9
"""Of a second derivative, over the largest one."""
_VOLUMES = np.linspace(0.5, 2.0, 31)
"""J at which volumetric energies are compared."""


@dataclass(frozen=True, kw_only=True)
class ReferenceEnergy(Material):
    """psi(B, J) of a material, Pa.

    Raises ParameterError for variables other than J, 1/J, ln J/J, tensors of F times powers of J and
    parameters, without one of the first three, and for a material without an expression.

    Parameters
    ----------
    material : Material
    owner : str
        What messages call it.
    is_gas : bool
        Whether it is heat that makes it strictly convex in J, as of a gas and a stiffened one.
    """

    material: Material
    owner: str = field(compare=False)
    is_gas: bool = False

    @classmethod
    def of(cls, material: Material, owner: str) -> ReferenceEnergy:
        """That of a body's material, without what heat adds to it."""
        if not isinstance(material, Thermal):
            return cls(material=material, owner=owner)
        return cls(material=material.cold, owner=owner, is_gas=material.material is None)

    def __post_init__(self) -> None:
        of_volume = (Jacobian, ReciprocalJacobian, LogJacobian)
        for v in self.material.variables:
            if not isinstance(v, (DistortionTensor, *of_volume, Parameter)):
                of = "a material of J and of F, Cof F, F F^T, Cof(F F^T) times powers of J"
                expected = f"{of}, not of {v.name!r}"
                if isinstance(v, SmallStrain):
                    expected += "; ReferentialNeoHookean of half the G_e is LinearElastic at small strains"
                raise ParameterError(self.owner, self.material, expected)
        if not any(isinstance(v, of_volume) for v in self.material.variables):
            raise ParameterError(self.owner, self.material, "a material with J or 1/J: bodies share a volume")
        if self.material.response(3) is not None:
            expected = "a material whose energy is an expression; a Yosida approximation has none"
            raise ParameterError(self.owner, self.material, expected)

    @property
    def tensors(self) -> tuple[DistortionTensor, ...]:
        """Those of psi, by the names that the material has for them."""
        found = (v for v in self.material.variables if isinstance(v, DistortionTensor))
        return tuple(replace(v, exponent=v.exponent + 1) if _is_density(v) else v for v in found)

    @property
    def variables(self) -> tuple[Variable, ...]:
        own = tuple(v for v in self.material.variables if isinstance(v, Parameter))
        return (*self.tensors, Jacobian("J"), *distinct((*own, *parameters_in((self.material,)))))

    def energy(self, z: Values) -> CoefficientFunction:
        J, own = z["J"], {}
        for v in self.material.variables:
            if isinstance(v, Jacobian):
                own[v.name] = J
            elif isinstance(v, ReciprocalJacobian):
                own[v.name] = 1 / J
            elif isinstance(v, LogJacobian):
                own[v.name] = log(J) / J
            else:
                own[v.name] = (1 / J) * z[v.name] if _is_density(v) else z[v.name]
        return J * substituted(self.material, lambda expression: expression.at(z)).energy(own)

    def volumetric(self, z: Values) -> CoefficientFunction:
        """U(J) = psi(I, J), Pa."""
        J: Any = z["J"]
        identity = J.constant(np.eye(3)) if hasattr(J, "constant") else IDENTITY
        return self.energy({**z, **{v.name: identity for v in self.tensors}})

    @cached_property
    def _sampled(self) -> tuple[np.ndarray, np.ndarray]:
        """Second derivatives at states, (states, n, n), and which components are those of tensors."""
        sampling, rng = StateSampling(self, 3), np.random.default_rng(0)
        states = sampling.changed(sampling.fitting_states(rng, 0.3), rng, 0.3)[:64]
        hessian = respond(self, 3)(states).hessian
        tensors = np.zeros(hessian.shape[1], dtype=bool)
        for v in self.tensors:
            tensors[self.states(3).slices[v.name]] = True
        return hessian[np.isfinite(hessian).all(axis=(1, 2))], tensors

    @cached_property
    def is_linear(self) -> bool:
        """Whether psi = C : B + U(J)."""
        hessian, tensors = self._sampled
        hessian = hessian[:, :, self.states(3).strains]
        return bool(abs(hessian[:, tensors]).max(initial=0.0) <= _ROUNDING * abs(hessian).max())

    @cached_property
    def pressures(self) -> np.ndarray:
        """U'(J) at ``_VOLUMES``, Pa; parameters have their typical values."""
        rest = StateSampling(self, 3).rest()
        states, at = np.tile(rest, (len(_VOLUMES), 1)), self.states(3).slices["J"].start
        states[:, at] = _VOLUMES
        return respond(self, 3)(states).slope[:, at]

    @cached_property
    def stiffness(self) -> float:
        """U''(1), Pa; parameters have their typical values."""
        return float(np.interp(1.0, _VOLUMES, np.gradient(self.pressures, _VOLUMES)))

    @cached_property
    def reads_parameters_in_volume(self) -> bool:
        """Whether U' changes with a parameter."""
        hessian, _ = self._sampled
        mixed = hessian[:, self.states(3).slices["J"].start] * ~self.states(3).strains
        return bool(abs(mixed).max(initial=0.0) > _ROUNDING * abs(hessian).max())

    def require(self) -> None:
        """Raise ParameterError unless psi = f(B) + U(J) is convex."""
        hessian, tensors = self._sampled
        volume = self.states(3).slices["J"].start
        coupled = abs(hessian[:, volume] * tensors).max(initial=0.0)
        if not len(hessian) or not coupled <= _ROUNDING * abs(hessian).max():
            expected = (
                "an energy f(B) + U(J) per reference volume: one per actual volume is not convex there; "
                "ReferentialNeoHookean, ReferentialMooneyRivlin, PerReferentialVolume(material=...) by "
                'elastic_state="B" have it'
            )
            raise ParameterError(self.owner, self.material, expected)
        if not (hessian[:, volume, volume] > 0).all() and not self.is_gas:
            expected = "an energy whose second derivative by J, per reference volume, is positive"
            raise ParameterError(self.owner, self.material, expected)
        report = check_convexity(self, warn=False)
        if not report.passed:
            raise ParameterError(
                self.owner, self.material, f"an energy convex per reference volume; J phi is {report}"
            )


def _is_density(variable: Variable) -> bool:
    """Whether it is a tensor of which a power of J makes one per actual volume."""
    return isinstance(variable, DistortionTensor) and variable.exponent <= -1.0
