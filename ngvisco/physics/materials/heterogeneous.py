"""Materials whose moduli are functions of carried parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ngsolve import CoefficientFunction

from ngvisco.physics.material import Material, Wrapper
from ngvisco.physics.materials.regularised import WithQuadratic
from ngvisco.physics.materials.yosida import Yosida
from ngvisco.physics.parameters import Parameter, distinct, substituted
from ngvisco.physics.variables import Values, Variable


@dataclass(frozen=True, kw_only=True)
class Heterogeneous(Wrapper):
    """A material and the parameters that it carries: phi(z, theta) with its moduli at theta.

    A ``Model`` makes it where a modulus of one of its laws is no number; its variables are those of the
    material and the parameters, whose conjugates are the energy's derivatives by them.

    Parameters
    ----------
    material : Material
        Its own moduli may be expressions of the parameters.
    carried : tuple of Parameter
        Parameters that its own variables do not have: those of its moduli and of the model's other laws.
    """

    carried: tuple[Parameter, ...]

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (*self.material.variables, *self.carried)

    @property
    def lagged(self) -> frozenset[str]:
        return self.material.lagged

    def energy(self, z: Values) -> CoefficientFunction:
        at_this_point = substituted(self.material, lambda expression: expression.at(z))
        return at_this_point.energy({v.name: z[v.name] for v in self.material.variables})


def carrying(material: Material, parameters: Sequence[Parameter]) -> Material:
    """The material with these among its variables; what wraps a material as regularised wraps that one.

    Raises ParameterError for a parameter of the name of another one that the material has.
    """
    if isinstance(material, (WithQuadratic, Yosida)):
        return replace(material, material=carrying(material.material, parameters))
    own = tuple(v for v in material.variables if isinstance(v, Parameter))
    carried = distinct((*own, *parameters))[len(own) :]
    return Heterogeneous(material=material, carried=carried) if parameters else material
