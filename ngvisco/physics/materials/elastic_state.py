"""Isotropic materials that know of the elastic state by F, as in the paper, or by B = F F^T.

F = V Q.  Creep relaxes the stretch V; the rotation Q stays, and in a flow that goes on neighbouring points
have turned by ever more different angles.  A space of fixed h cannot follow, upwinding averages, and the
mean of two rotations has a determinant below one: F and J part, and the stress with them, while the ledger
still closes.  B has no Q, and isotropic energies need nothing else.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Self

from ngvisco.errors import Quantity, require_choice
from ngvisco.physics.material import ElasticState, Material


@dataclass(frozen=True, kw_only=True)
class IsotropicElastic(Material):
    """An isotropic material with a choice of its tensor variables.

    Parameters
    ----------
    elastic_state : str, optional
        Variables of the distortion "F" or of "B" = F F^T, for a body that flows; B where there is creep.
    """

    elastic_state: Annotated[ElasticState | None, Quantity(example="B")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.elastic_state is not None:
            require_choice(self, ("F", "B"), elastic_state=self.elastic_state)

    def with_elastic_state(self, state: ElasticState) -> Self:
        return self if self.elastic_state is not None else replace(self, elastic_state=state)

    @property
    def is_by_B(self) -> bool:
        """Whether the variables are left Cauchy-Green tensors; not so as long as nothing is said."""
        return self.elastic_state == "B"
