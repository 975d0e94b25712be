"""The linear rule of the paper, Maxwellian creep, and its kin for conformation tensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal, TypeAlias

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError, Quantity, require_choice
from ngvisco.physics.flow_rules.rule import GradientRule
from ngvisco.physics.parameters import Modulus, typical_value, value_at
from ngvisco.physics.tensors import dev, square
from ngvisco.physics.variables import Values

CreepLaw: TypeAlias = Literal["mandel", "conformation", "leonov"]


@dataclass(frozen=True, kw_only=True)
class Creep(GradientRule):
    """Maxwellian creep G_m Pi - div(nu |grad Pi|^{q-2} grad Pi) = M (paper: ED-Euler-large3).

    With nu = 0 (default) that is Pi = R M at every point, R = 1/G_m; with nu > 0, Pi is a continuous field
    with (n . grad) Pi = 0 on walls.

    ``law`` says what drives Pi at every point; the others than the paper's need a conformation tensor B with
    the conjugate zeta (``OldroydB``, ``FENEP``), are local (nu = 0), and agree with it at small elastic
    strains, where zeta = M/2 for incompressible ones:

    * ``"mandel"``: G_m Pi = M,
    * ``"conformation"``: G_m Pi = 2 zeta, with a trace, so that det B relaxes too (Oldroyd-B, FENE-P),
    * ``"leonov"``: G_m Pi = M/2 + dev zeta (Leonov).

    In the linearised model this is E_ZJ = eps(v) - R dev S (paper: Euler-small-viscoelastodyn+2).
    The sign is that of the energy balance; the paper's flow rules print G_m Pi = -M.

    G_m is twice the usual viscosity eta of the Maxwell dashpot, G_m = 2 eta: a steady flow with the strain
    rate eps has the deviatoric stress dev T = G_m dev eps, as a fluid's is 2 eta dev eps.  With the usual
    shear modulus G (G_e of the small-strain materials, 2 G_e of the neo-Hookean ones, 2 (G_e + G_mr) of the
    Mooney-Rivlin ones) the stress relaxes like exp(-t/lambda), with the Maxwell time
    lambda = G_m/(2 G) = eta/G.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    G_m : float
        Creep modulus: twice the usual viscosity eta of the Maxwell dashpot, G_m = 2 eta; with the usual shear
        modulus G the relaxation time of shear is G_m/(2 G). Infinite is no creep (Kelvin-Voigt).
    floor : float
        |grad Pi| below which powers that are no even integers are smoothed.
    law : str
        "mandel" (the paper), or "conformation" or "leonov" of a conformation tensor's fluid.
    """

    G_m: Annotated[Modulus, Quantity("Pa s", "> 0", 5.0)]
    floor: Annotated[float, Quantity("1/(m s)", "> 0")] = 1e-10
    law: CreepLaw = "mandel"

    degree = 1.0

    def __post_init__(self) -> None:
        require_choice(self, ("mandel", "conformation", "leonov"), law=self.law)
        if self.law != "mandel" and self.nu != 0:
            raise ParameterError("Creep.nu", self.nu, f"0 for law = {self.law!r}, which is local")
        if isinstance(self.G_m, float) and self.G_m == math.inf:
            replace(self, G_m=1.0)  # which looks at the others
        else:
            super().__post_init__()

    @property
    def R(self) -> float:
        """Reciprocal creep modulus 1/G_m, 1/(Pa s); where G_m is an expression, of its typical value."""
        return 1 / typical_value(self.G_m)

    def rate(
        self, M: CoefficientFunction, zeta: CoefficientFunction | None, z: Values
    ) -> CoefficientFunction:
        R = 1 / value_at(self.G_m, z)
        if self.law == "mandel":
            return R * M
        assert zeta is not None
        return R * (2 * zeta if self.law == "conformation" else 0.5 * M + dev(zeta))

    def psi(self, Pi: CoefficientFunction, z: Values) -> CoefficientFunction:
        """G_m |Pi|^2/2, W/m^3."""
        return (0.5 * value_at(self.G_m, z)) * square(Pi)

    @property
    def reads_conjugate(self) -> bool:  # type: ignore[override]
        return self.law != "mandel"

    @property
    def has_trace(self) -> bool:  # type: ignore[override]
        return self.law == "conformation"

    @property
    def flows(self) -> bool:
        return self.R > 0
