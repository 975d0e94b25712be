"""Flow rules of conformation tensors: polymer fluids of Giesekus, and of Phan-Thien and Tanner.

B is the conformation tensor of a material such as ``OldroydB``, and zeta is its conjugate.  With the energy
of ``OldroydB``, zeta = G_e (I - B^-1) and lambda = G_m/(4 G_e), the relaxation of B is

| rule                | Pi G_m/2                        | relaxation of B                              |
|---------------------|---------------------------------|----------------------------------------------|
| ``Creep``           | zeta                            | -(B - I)/lambda                              |
| ``Giesekus``        | (1 - alpha) zeta + alpha B zeta | -(B - I + alpha (B - I)^2)/lambda            |
| ``PTT``             | f(tr B) zeta                    | -f(tr B) (B - I)/lambda                      |

The power 2 sym(zeta B) : Pi of each rule is >= 0 for every symmetric zeta and every positive definite B. It
is a sum of tr(zeta B zeta), |B zeta|^2 and tr((B^{1/2} zeta B^{1/2})^2) with factors >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.flow_rules.rule import FlowRule
from ngvisco.physics.parameters import Modulus, value_at
from ngvisco.physics.tensors import Tensor, exp, sym, tr
from ngvisco.physics.variables import CONFORMATION, Values


@dataclass(frozen=True, kw_only=True)
class _OfConformation(FlowRule):
    """A local rule that reads a conformation tensor and its conjugate.

    Parameters
    ----------
    G_m : float
        Creep modulus: twice the viscosity of the polymer at vanishing rates.
    """

    G_m: Annotated[Modulus, Quantity("Pa s", "> 0", 5.0)]

    reads = frozenset({CONFORMATION})
    reads_conjugate = True
    has_trace = True


@dataclass(frozen=True, kw_only=True)
class Giesekus(_OfConformation):
    """Pi = 2/G_m ((1 - alpha) zeta + alpha sym(B zeta)), the fluid of Giesekus (1982).

    The drag depends on the direction: the viscosity falls with the shear rate, and the second normal stress
    difference has N_2/N_1 -> -alpha/2 at vanishing rates.  alpha = 0 is ``Creep(law="conformation")``. Raises
    ParameterError if a parameter is out of its range.

    Parameters
    ----------
    G_m : float
        Creep modulus: twice the viscosity of the polymer at vanishing rates.
    alpha : float
        Mobility factor; 0.1 to 0.4 are usual, and up to 0.5 the shear stress has no maximum.
    """

    alpha: Annotated[float, Quantity("1", "in [0, 1]", 0.2)]

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        assert zeta is not None
        driving = (1 - self.alpha) * zeta + self.alpha * sym(z[CONFORMATION] * zeta)
        return 2 / value_at(self.G_m, z) * driving


@dataclass(frozen=True, kw_only=True)
class PTT(_OfConformation):
    """Pi = 2/G_m f(tr B) zeta, the fluid of Phan-Thien and Tanner (1977) without slip of its network.

    f = 1 + epsilon (tr B - 3), linear, or exp(epsilon (tr B - 3)).  Stretched chains leave the network
    faster, so that the shear viscosity falls with the shear rate and the extensional viscosity stays finite.
    The slip parameter xi of the published law is 0: the velocity carries B like all other tensors.  Raises
    ParameterError if a parameter is out of its range.

    Parameters
    ----------
    G_m : float
        Creep modulus: twice the viscosity of the polymer at vanishing rates.
    epsilon : float
        Growth of f with the chains' stretch; < 1/3 for the linear form, so that f > 0.
    form : str
        Form of f, "linear" or "exponential".
    """

    epsilon: Annotated[float, Quantity("1", ">= 0", 0.25)]
    form: Literal["linear", "exponential"] = "linear"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.form == "linear" and not self.epsilon < 1 / 3:
            expected = (
                "a number < 1/3 with form = 'linear', since the rate has the wrong sign at tr B < 3 - "
                "1/epsilon"
            )
            raise ParameterError("PTT.epsilon", self.epsilon, expected)

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        assert zeta is not None
        stretch = self.epsilon * (tr(z[CONFORMATION]) - 3)
        f = 1 + stretch if self.form == "linear" else exp(stretch)
        return 2 / value_at(self.G_m, z) * f * zeta
