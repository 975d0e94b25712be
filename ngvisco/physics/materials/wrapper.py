"""Materials that are another one with something added to it or done to it."""

from dataclasses import dataclass, replace
from typing import Self

from ngvisco.errors import ParameterError
from ngvisco.physics.material import ElasticState, Material
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.variables import Variable


@dataclass(frozen=True, kw_only=True)
class Wrapper(Material):
    """A material of another one: what it does not say otherwise is that one's.

    Raises ParameterError if ``material`` is none, or a parameter is out of its range.

    Parameters
    ----------
    material : Material
    """

    material: Material

    def __post_init__(self) -> None:
        if not isinstance(self.material, Material):
            raise ParameterError(f"{type(self).__name__}.material", self.material, "a Material")
        super().__post_init__()

    def with_elastic_state(self, state: ElasticState) -> Self:
        return replace(self, material=self.material.with_elastic_state(state))

    @property
    def variables(self) -> tuple[Variable, ...]:
        return self.material.variables

    @property
    def referential_density(self) -> Modulus | None:
        return self.material.referential_density

    @property
    def conformation(self) -> str | None:
        return self.material.conformation

    @property
    def continued(self) -> frozenset[str]:
        return self.material.continued
