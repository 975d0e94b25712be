"""Energies per referential volume or per mass, as convex energies per actual volume: perspectives.

Let A = 1/J = rho/rho_R. An energy psi per referential volume, J/m^3, gives phi = A psi per actual volume. An
energy psi per mass, J/kg, gives phi = rho psi = rho_R A psi (paper: rem-referential, and the remark after
ED-Euler-large that then T = rho psi'(F) F^T).  A polyconvex psi gives a phi that is not convex in F, Cof F
and J (paper: exa-neo-Hookean-ref). But phi is convex in A, A F and A Cof F:

    phi(A, G, N) = A psi(G/A, N/A, 1/A),   G = A F,  N = A Cof F,

is the perspective of psi, which is convex if psi is.  Therefore every polyconvex energy of the Lagrangian
theory can be used here.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.energy_checks import StateSampling, check_convexity
from ngvisco.physics.material import ElasticState, Material, part_of
from ngvisco.physics.materials.damaged import DAMAGE, Damaged, WithoutCracks
from ngvisco.physics.materials.network import Network
from ngvisco.physics.materials.thermal import Thermal
from ngvisco.physics.parameters import Modulus, Parameter, distinct, parameters_in, substituted
from ngvisco.physics.pointwise import respond, rest_state, slope_at, states_of
from ngvisco.physics.tensors import IDENTITY, Tensor, log
from ngvisco.physics.variables import (
    DistortionTensor,
    Jacobian,
    LogJacobian,
    ReciprocalJacobian,
    SmallStrain,
    Values,
    Variable,
)
from ngvisco.words import Words, call


@dataclass(frozen=True, kw_only=True)
class PerReferentialVolume(Material):
    """phi = psi/J with the energy psi of another material per referential volume (paper: rem-referential).

    T = psi'(F) F^T/J, so that there is no stress at rest if psi is stationary at rest. If psi is convex in
    the tensors and J, phi is jointly convex in A = 1/J and A times these tensors. Raises ParameterError for a
    material with other variables, and for an energy without an expression (wrap this material into
    ``Yosida`` instead).

    Example::

        import ngvisco as nv

        psi = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)  # the usual neo-Hookean energy
        material = nv.PerReferentialVolume(material=psi, rho_R=2.0)
        model = nv.Model(material=material)
        print([variable.name for variable in model.material.variables])

    Parameters
    ----------
    material : Material
        Material of psi, with variables J = det F and tensors J^a F, J^a Cof F, J^a F F^T, J^a Cof(F F^T).
        In place of a tensor X, this material carries AX = X/J.
    rho_R : float, optional
        Density where J = 1, which determines the initial density from J, or J from the density.
    """

    material: Material
    rho_R: Annotated[Modulus | None, Quantity("kg/m^3", "> 0", 1000.0, "arithmetic")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        field_name = f"{type(self).__name__}.material"
        if self.material.response(3) is not None:
            expected = (
                "a material whose energy is an expression; put the Yosida approximation around this material"
            )
            raise ParameterError(field_name, self.material, expected)
        if part_of(self.material, Network) is not None:
            expected = "a material without branches; wrap the material of each branch"
            raise ParameterError(field_name, self.material, expected)
        for v in self.material.variables:
            if v.is_strain and not isinstance(v, (Jacobian, DistortionTensor)):
                expected = (
                    "a material whose variables are J = det F, or powers of J times F, Cof F, F F^T or "
                    f"Cof(F F^T); {v.name!r} is none of these"
                )
                raise ParameterError(field_name, self.material, expected)

    def with_elastic_state(self, state: ElasticState) -> Self:
        return replace(self, material=self.material.with_elastic_state(state))

    @property
    def variables(self) -> tuple[Variable, ...]:
        tensors = (v for v in self.material.variables if isinstance(v, DistortionTensor))
        scaled = (replace(v, name=f"A{v.name}", exponent=v.exponent - 1) for v in tensors)
        return (*scaled, ReciprocalJacobian(), *(v for v in self.material.variables if not v.is_strain))

    @property
    def referential_density(self) -> Modulus | None:
        return self.rho_R

    def _own(self, z: Values) -> Values:
        """The values of psi's variables, by name."""
        J = 1 / z["A"]
        values = {v.name: z[v.name] for v in self.material.variables if not v.is_strain}
        for v in self.material.variables:
            if v.is_strain:
                values[v.name] = z[f"A{v.name}"] * J if isinstance(v, DistortionTensor) else J
        return values

    def domain(self, z: Values) -> Values:
        # perspectives of psi's bounds; a perspective of a concave function is concave
        return {name: z["A"] * value for name, value in self.material.domain(self._own(z)).items()}

    def energy(self, z: Values) -> Tensor:
        return z["A"] * self.material.energy(self._own(z))


@dataclass(frozen=True, kw_only=True)
class PerMass(PerReferentialVolume):
    """phi = rho psi with the energy psi of another material per mass (paper: T = rho psi'(F) F^T).

    The moduli and the energy of psi are in J/kg.  rho = rho_R A, and A obeys the continuity equation.
    Convexity, variables and errors are as for ``PerReferentialVolume``. Raises ParameterError if a parameter
    is out of its range.

    Parameters
    ----------
    material : Material
        Material of psi, J/kg.
    rho_R : float
        Density where J = 1, which determines the initial density from J, or J from the density.
    """

    rho_R: Annotated[Modulus, Quantity("kg/m^3", "> 0", 1000.0, "arithmetic")]

    def energy(self, z: Values) -> Tensor:
        return self.rho_R * super().energy(z)


_ROUNDING = 1e-9
"""Size, relative to the largest second derivative, up to which a second derivative is rounding."""
_SHEAR = 1e-3
"""Size of the simple shear whose energy gives a shear modulus."""
_VOLUMES = np.linspace(0.5, 2.0, 31)
"""The values of J at which volumetric energies are compared."""


@dataclass(frozen=True, kw_only=True)
class ReferenceEnergy(Material):
    """The energy psi(B, J) = J phi(z) of a body's material, Pa per reference volume.

    If a tensor of phi is a density by its power of J, such as J^{-5/3} F F^T, psi reads J times the tensor.
    Bodies share a point by n psi(X/n, alpha/n) (``ngvisco.physics.mixture``), which is convex if psi is
    convex.  Admissible variables are J, 1/J, ln J/J, tensors of F times powers of J, and parameters.  Raises
    ParameterError for other variables, for a material without J, 1/J and ln J/J, and for an energy without an
    expression.
    """

    material: Material
    owner: str = field(compare=False)
    """Name of the material's key in messages."""
    is_gas: bool = False
    """Whether only heat makes the energy strictly convex in J, as for a gas and a stiffened gas."""

    @classmethod
    def of(cls, material: Material, owner: str) -> ReferenceEnergy:
        """The energy of a body's material, without its thermal part and without the energy of cracks."""
        if isinstance(material, Damaged):
            return cls(material=WithoutCracks(material=material), owner=owner)
        if not isinstance(material, Thermal):
            return cls(material=material, owner=owner)
        return cls(material=material.isothermal_material, owner=owner, is_gas=material.material is None)

    def __post_init__(self) -> None:
        of_volume = (Jacobian, ReciprocalJacobian, LogJacobian)
        for v in self.material.variables:
            if not isinstance(v, (DistortionTensor, *of_volume, Parameter)):
                admitted = (
                    "a material whose variables are J, or powers of J times F, Cof F, F F^T or Cof(F F^T)"
                )
                expected = f"{admitted}; {v.name!r} is none of these"
                if isinstance(v, SmallStrain):
                    expected += (
                        ". At small strains ReferentialNeoHookean with half of the G_e equals LinearElastic"
                    )
                raise ParameterError(self.owner, self.material, expected)
        if not any(isinstance(v, of_volume) for v in self.material.variables):
            expected = "a material with J or 1/J, since bodies share the volume of a point"
            raise ParameterError(self.owner, self.material, expected)
        if self.material.response(3) is not None:
            expected = "a material whose energy is an expression f(B) + U(J), and not a Yosida approximation"
            raise ParameterError(self.owner, self.material, expected)
        values_at_rest = {v.name: v.from_distortion(IDENTITY) for v in self.material.variables}
        if domain := self.material.domain(values_at_rest):
            bounds = ", ".join(f"{name} > 0" for name in domain)
            expected = (
                "a material whose energy has a value for every strain, but the energy of this material has a "
                f"value only for {bounds}"
            )
            raise ParameterError(self.owner, self.material, expected)

    @property
    def tensors(self) -> tuple[DistortionTensor, ...]:
        """The tensors that psi reads, with the names of the material's variables."""
        tensors = (v for v in self.material.variables if isinstance(v, DistortionTensor))
        return tuple(replace(v, exponent=v.exponent + 1) if _is_density(v) else v for v in tensors)

    @property
    def variables(self) -> tuple[Variable, ...]:
        parameters = tuple(v for v in self.material.variables if isinstance(v, Parameter))
        return (*self.tensors, Jacobian("J"), *distinct((*parameters, *parameters_in((self.material,)))))

    def energy(self, z: Values) -> Tensor:
        J, values = z["J"], {}
        for v in self.material.variables:
            if isinstance(v, ReciprocalJacobian):
                values[v.name] = 1 / J
            elif isinstance(v, LogJacobian):
                values[v.name] = log(J) / J
            elif isinstance(v, Jacobian):
                values[v.name] = J
            else:
                values[v.name] = (1 / J) * z[v.name] if _is_density(v) else z[v.name]
        return J * substituted(self.material, lambda expression: expression.at(z)).energy(values)

    def volumetric(self, z: Values) -> Tensor:
        """The volumetric energy U(J) = psi(I, J), Pa."""
        J: Any = z["J"]
        identity = J.constant(np.eye(3)) if hasattr(J, "constant") else IDENTITY
        return self.energy({**z, **{v.name: identity for v in self.tensors}})

    @cached_property
    def _sampled(self) -> tuple[np.ndarray, np.ndarray]:
        """Second derivatives at sampled states, (states, n, n), and the mask of tensors' components."""
        sampling = StateSampling(self, 3, 0.3, np.random.default_rng(0))
        hessian = respond(self, 3)(sampling.changed(sampling.fitting())[:64]).hessian
        tensors = np.zeros(hessian.shape[1], dtype=bool)
        for v in self.tensors:
            tensors[self.states(3).slices[v.name]] = True
        return hessian[np.isfinite(hessian).all(axis=(1, 2))], tensors

    @cached_property
    def is_linear(self) -> bool:
        """Whether psi is linear in its tensors, psi = C : B + U(J)."""
        hessian, tensors = self._sampled
        hessian = hessian[:, :, self.states(3).strains]
        return bool(abs(hessian[:, tensors]).max(initial=0.0) <= _ROUNDING * abs(hessian).max())

    @cached_property
    def pressures(self) -> np.ndarray:
        """U'(J) at ``_VOLUMES``, Pa, for the parameters' typical values."""
        at = self.states(3).slices["J"].start
        states = np.tile(rest_state(self, 3), (len(_VOLUMES), 1))
        states[:, at] = _VOLUMES
        return slope_at(respond(self, 3), states.T)[at]

    @cached_property
    def stiffness(self) -> float:
        """U''(1), Pa, for the parameters' typical values."""
        return float(np.interp(1.0, _VOLUMES, np.gradient(self.pressures, _VOLUMES)))

    @cached_property
    def shear_stiffness(self) -> float:
        """The second derivative of psi by simple shear at rest, Pa, for the parameters' typical values."""
        F = np.tile(np.eye(3), (3, 1, 1))
        F[:, 0, 1] = -_SHEAR, 0.0, _SHEAR
        return float(np.diff(respond(self, 3)(states_of(self, F, 3)).energy, 2)[0]) / _SHEAR**2

    @cached_property
    def reads_parameters_in_volume(self) -> bool:
        """Whether U' depends on a parameter other than the damage."""
        hessian, _ = self._sampled
        others = ~self.states(3).strains
        if DAMAGE in self.variables:
            others[self.states(3).slices[DAMAGE.name]] = False
        mixed = hessian[:, self.states(3).slices["J"].start] * others
        return bool(abs(mixed).max(initial=0.0) > _ROUNDING * abs(hessian).max())

    def require(self) -> None:
        """Raise ParameterError unless psi = f(B) + U(J) is convex."""
        hessian, tensors = self._sampled
        volume = self.states(3).slices["J"].start
        coupled = abs(hessian[:, volume] * tensors).max(initial=0.0)
        if not len(hessian) or not coupled <= _ROUNDING * abs(hessian).max():
            expected: str = Words(
                "a material with an energy f(B) + U(J) per reference volume, since an energy per actual "
                "volume is not convex per reference volume; IsochoricNeoHookean, ReferentialNeoHookean, "
                "ReferentialMooneyRivlin, ",
                call("PerReferentialVolume", material=...),
                ' with elastic_state = "B" have such an energy, also around WithQuadratic',
            )
            raise ParameterError(self.owner, self.material, expected)
        if not (hessian[:, volume, volume] > 0).all() and not self.is_gas:
            expected = "a material whose energy per reference volume has a positive second derivative by J"
            raise ParameterError(self.owner, self.material, expected)
        report = check_convexity(self, warn=False)
        if not report.passed:
            expected = f"a material whose energy is convex per reference volume, but J phi is {report}"
            raise ParameterError(self.owner, self.material, expected)


def _is_density(variable: Variable) -> bool:
    """Whether a variable is a tensor times a power of J that makes it a density per actual volume."""
    return isinstance(variable, DistortionTensor) and variable.exponent <= -1.0
