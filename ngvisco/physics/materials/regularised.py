"""Materials whose energy is another one's, regularised as in the paper's discrete scheme."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Annotated

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity, UnknownNameError, require_names
from ngvisco.physics.material import ElasticState, Material, Wrapper
from ngvisco.physics.pointwise import Respond, Response
from ngvisco.physics.tensors import inner
from ngvisco.physics.variables import Values


@dataclass(frozen=True, kw_only=True)
class WithQuadratic(Wrapper):
    """phi + sqrt(delta)/2 sum_i |z_i|^2 (paper: varphi-regularized).

    Makes a convex energy strongly convex.  At rest it adds a stress of the order of sqrt(delta).  The
    ledger has the added energy within ``stored``, and alone as ``stored_quadratic``.  Raises ParameterError
    or UnknownNameError for a delta that is not positive, or a name that the material does not have.

    Parameters
    ----------
    material : Material
        The material that is regularised.
    delta : float
        sqrt(delta)/2 |z|^2 is added to the energy.
    only : tuple of str, optional
        Variables for which it is added, no parameters; all strains where nothing is said (paper:
        rem-neo-Hookean-ref omits those in which phi is strongly convex already).
    """

    delta: Annotated[float, Quantity("Pa^2", "> 0", 1e-6)]
    only: Annotated[tuple[str, ...] | None, Quantity(example=["J"])] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.only is not None:
            require_names("WithQuadratic.only", self.only)
        known = {v.name for form in self._forms() for v in form.variables if v.is_strain}
        for name in self.only or ():
            if name not in known:
                raise UnknownNameError("material variable", name, known)

    def _forms(self) -> list[Material]:
        """The material in the forms that it may still take."""
        return [self.material.with_elastic_state("F"), self.material.with_elastic_state("B")]

    def with_elastic_state(self, state: ElasticState) -> WithQuadratic:
        material = self.material.with_elastic_state(state)
        names = [v.name for v in material.variables]
        for name in self.only or ():
            if name not in names:
                raise UnknownNameError(f"material variable for elastic_state = {state!r}", name, names)
        return replace(self, material=material)

    @property
    def _regularised(self) -> list[str]:
        """Names of the variables that the energy is added for."""
        return list(self.only or (v.name for v in self.variables if v.is_strain))

    @property
    def conformation(self) -> str | None:
        return None  # at rest there is a stress of the added energy

    def energy(self, z: Values) -> CoefficientFunction:
        return self.material.energy(z) + self.added_energy(z)

    def response(self, dim: int) -> Respond | None:
        inner_response = self.material.response(dim)
        if inner_response is None:
            return None
        slices, weights = self.states(dim).slices, np.zeros(self.states(dim).size)
        for name in self._regularised:
            weights[slices[name]] = self.delta**0.5

        def respond(states: np.ndarray) -> Response:
            part = inner_response(states)
            energy = part.energy + 0.5 * (states * states) @ weights
            hessian = part.hessian + np.diag(weights)
            return Response(energy, part.slope + weights * states, hessian, part.failure)

        return respond

    def added_energy(self, z: Values) -> CoefficientFunction:
        """sqrt(delta)/2 sum_i |z_i|^2, Pa."""
        squares = [inner(z[name], z[name]) for name in self._regularised]
        return 0.5 * self.delta**0.5 * reduce(add, squares)
