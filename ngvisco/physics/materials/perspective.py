"""Energies per referential volume or per mass, as convex energies per actual volume: perspectives.

With A = 1/J = rho/rho_R an energy psi per referential volume, J/m^3, is phi = A psi per actual one, and an
energy per mass, J/kg, is phi = rho psi = rho_R A psi (paper: rem-referential, and the remark after
ED-Euler-large that T = rho psi'(F) F^T then).  Written in F, Cof F and J a polyconvex psi makes no convex phi
(paper: exa-neo-Hookean-ref).  Written in A and A F, A Cof F it does:

    phi(A, G, N) = A psi(G/A, N/A, 1/A),   G = A F,  N = A Cof F,

is the perspective of psi, which is convex where psi is; J = 1/A is the perspective of the constant 1.  The
rates of G = J^{-1} F and N = J^{-1} Cof F are those of ``Distortion`` and ``Cofactor`` with the exponent -1.
So every polyconvex energy of the Lagrangian theory is an energy of this one, with all that follows from
convexity, without a growth or a volumetric part of its own.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Self

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.material import ElasticState, Material
from ngvisco.physics.parameters import Modulus, require_ranges
from ngvisco.physics.variables import (
    Cofactor,
    CofactorLeftCauchyGreen,
    Distortion,
    Jacobian,
    LeftCauchyGreen,
    ReciprocalJacobian,
    Values,
    Variable,
)

_TENSORS = (Distortion, Cofactor, LeftCauchyGreen, CofactorLeftCauchyGreen)


@dataclass(frozen=True, kw_only=True)
class PerReferentialVolume(Material):
    """phi = psi/J with the energy psi of another material per referential volume (paper: rem-referential).

    T = psi'(F) F^T/J, so that a body at rest is free of stress where psi is stationary there.  Jointly convex
    in A = 1/J and in A times the material's tensors where psi is convex in these and J.  Raises
    ParameterError for a material with other variables, or one whose energy is not an expression (``Yosida``,
    which goes around this one).

    Example::

        import ngvisco as nv

        psi = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)  # the usual neo-Hookean energy
        material = nv.PerReferentialVolume(material=psi, rho_R=2.0)
        model = nv.Model(material=material)
        print([variable.name for variable in model.material.variables])

    Parameters
    ----------
    material : Material
        psi, of J = det F and tensors J^a F, J^a Cof F, J^a F F^T, J^a Cof(F F^T); of what is carried the
        tensor X becomes AX = X/J.
    rho_R : float, optional
        Density where J = 1; with it the initial density and J follow from one another.
    """

    material: Material
    rho_R: Annotated[Modulus | None, Quantity("kg/m^3", "> 0", 1000.0)] = None

    def __post_init__(self) -> None:
        owner = type(self).__name__
        if not isinstance(self.material, Material):
            raise ParameterError(f"{owner}.material", self.material, "a Material")
        require_ranges(self)
        if self.material.response(3) is not None:
            expected = "a material whose energy is an expression; a Yosida approximation goes around this one"
            raise ParameterError(f"{owner}.material", self.material, expected)
        for variable in self.material.variables:
            if variable.is_strain and not isinstance(variable, (Jacobian, *_TENSORS)):
                expected = "a material of J = det F and of F, Cof F, F F^T, Cof(F F^T) times powers of J"
                raise ParameterError(
                    f"{owner}.material", self.material, f"{expected}, not of {variable.name!r}"
                )

    def with_elastic_state(self, state: ElasticState) -> Self:
        return replace(self, material=self.material.with_elastic_state(state))

    @property
    def variables(self) -> tuple[Variable, ...]:
        tensors = (v for v in self.material.variables if isinstance(v, _TENSORS))
        return (
            *(replace(v, name=f"A{v.name}", exponent=v.exponent - 1) for v in tensors),
            ReciprocalJacobian(),
            *(v for v in self.material.variables if not v.is_strain),
        )

    @property
    def referential_density(self) -> Modulus | None:
        return self.rho_R

    def energy(self, z: Values) -> CoefficientFunction:
        A = z["A"]
        J = 1 / A
        own = {v.name: z[v.name] for v in self.material.variables if not v.is_strain}
        for v in self.material.variables:
            if v.is_strain:
                own[v.name] = z[f"A{v.name}"] * J if isinstance(v, _TENSORS) else J
        return A * self.material.energy(own)


@dataclass(frozen=True, kw_only=True)
class PerMass(PerReferentialVolume):
    """phi = rho psi with the energy psi of another material, taken per mass (paper: T = rho psi'(F) F^T).

    Its moduli and its energy are read as J/kg.  rho = rho_R A, A being carried by the continuity equation.
    Convexity, variables and errors are those of ``PerReferentialVolume``.
    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    material : Material
        psi, J/kg.
    rho_R : float
        Density where J = 1; with it the initial density and J follow from one another.
    """

    rho_R: Annotated[Modulus, Quantity("kg/m^3", "> 0", 1000.0)]

    def energy(self, z: Values) -> CoefficientFunction:
        return self.rho_R * super().energy(z)
