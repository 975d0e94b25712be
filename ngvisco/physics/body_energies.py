"""The energy of bodies of different volumetric energies, for arrays of states.

At each point the bodies have one pressure, which determines the volumes J_i
(``ngvisco.physics.equilibrium``). If bodies break, the volumes can be held while damages grow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ngvisco.physics.arrays import Array
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.body_damage import BodyDamage
from ngvisco.physics.equilibrium import Energies, MixedHeat, equilibrium
from ngvisco.physics.material import Material, StateSpace
from ngvisco.physics.parameters import Parameter
from ngvisco.physics.pointwise import respond
from ngvisco.physics.response import Response
from ngvisco.physics.tensors import Tensor
from ngvisco.physics.variables import Values, Variable


@dataclass(frozen=True)
class EnergyPart(Material):
    """A part of an energy, as a material. The function ``of`` gives this part from the values of the
    variables ``transported``."""

    of: Callable[[Values], Any]
    transported: tuple[Variable, ...]
    linear: tuple[str, ...] = ()

    @property
    def variables(self) -> tuple[Variable, ...]:
        return self.transported

    def energy(self, z: Values) -> Tensor:
        return self.of(z)


class InEquilibrium:
    """The response of bodies with different U_i: energy and derivatives for arrays of states.

    Lagged variables are the damages. For a material with lagged variables, ``seen`` are the states with the
    damages of the step's start. The states ``seen`` determine the volumes J_i, and the slopes by all
    variables but the damages.
    """

    def __init__(
        self,
        space: StateSpace,
        bodies: Sequence[str],
        shear: EnergyPart,
        volumetric: Sequence[EnergyPart],
        parameters: Sequence[Parameter],
        heat: MixedHeat | None,
        damages: Mapping[str, BodyDamage],
        driving: Callable[[str, Values, Any], Any],
    ) -> None:
        """``shear`` is the energy of the tensors, ``volumetric`` are the energies by J, S and the
        ``parameters``; ``driving`` gives the energy that a body's damage degrades (``Mixture.driving``)."""
        self.space, self.heat, self._driving = space, heat, driving
        self.parameters = [space.slices[v.name].start for v in parameters]
        self.amounts = {name: space.slices[AMOUNT + name].start for name in bodies}
        self.shared = [] if heat is None else [space.slices[heat.entropy.name].start]
        self.shears = respond(shear, space.dim)
        self.volumes = [respond(part, space.dim) for part in volumetric]
        self.damages = {name: space.slices[of.damage.name].start for name, of in damages.items()}
        """Numbers of the damages' components by the bodies' names."""
        self.lagged = np.zeros(space.size, dtype=bool)
        """Mask of the components of lagged variables, the damages and their gradients."""
        for of in damages.values():
            self.lagged[space.slices[of.damage.name]] = self.lagged[space.slices[of.slope.name]] = True

    def __call__(self, states: np.ndarray, seen: np.ndarray | None = None) -> Response:
        value, slope, hessian, y = self._equilibrium(states if seen is None else seen)
        failure = self._failure(self._amounts(states)[~np.isfinite(value)])
        result = self.shears(states)
        if self.lagged.any():
            changed = np.flatnonzero(np.zeros(len(states)) if seen is None else (states != seen).any(axis=1))
            self._lag(result, states, seen, changed, y, hessian)
            if len(changed):
                own, *_ = self._equilibrium(states[changed])
                failure = failure or self._failure(self._amounts(states[changed])[~np.isfinite(own)])
                value[changed] = own
        where = [*self.amounts.values(), *self.shared]
        result.slope[:, where] += slope
        result.hessian[np.ix_(range(len(states)), where, where)] += hessian
        return Response(result.energy + value, result.slope, result.hessian, failure)

    def volumes_of(self, states: np.ndarray) -> np.ndarray:
        """The volumes J_i of all bodies at the given states, (points, bodies)."""
        return self._equilibrium(states)[3][..., 0]

    def held_energy(self, states: np.ndarray, J: np.ndarray) -> np.ndarray:
        """The energy, Pa, at given volumes J_i, (points, bodies), for bodies without heat."""
        psi, _, _ = self._of_volumes(states)(J[..., None], np.arange(len(states)))
        return self.shears(states).energy + (self._amounts(states) * psi).sum(axis=1)

    def driving(self, body: str, states: np.ndarray, J: np.ndarray) -> np.ndarray:
        """The energy of a body that its damage degrades, Pa, with given volumes J_i, (points, bodies)."""
        z = self.space.tensors(lambda: Array(np.ascontiguousarray(states.T), None))
        return self._driving(body, z, Array(J[:, list(self.amounts).index(body)], None)).value

    def _amounts(self, states: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(states[:, list(self.amounts.values())])

    def _of_volumes(self, states: np.ndarray) -> Energies:
        """psi_i with its first and second derivatives by J_i and, with heat, by S_i."""
        size = 1 + len(self.shared)

        def energies(y: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, ...]:
            parameters = states[np.ix_(points, self.parameters)]
            responses = [
                volume(np.column_stack([y[:, i], parameters])) for i, volume in enumerate(self.volumes)
            ]
            psi, slope = (
                np.stack([getattr(f, name) for f in responses], axis=1) for name in ("energy", "slope")
            )
            return psi, slope[..., :size], np.stack([f.hessian[:, :size, :size] for f in responses], axis=1)

        return energies

    def _equilibrium(self, states: np.ndarray) -> tuple[np.ndarray, ...]:
        """V or W, its slope and second derivative by the amounts and the entropy, and all J_i and S_i."""
        n = self._amounts(states)
        total = np.column_stack([np.ones(len(n)), states[:, self.shared]])
        return equilibrium(self._of_volumes(states), n, total, self._start(n, total))

    def _lag(
        self,
        result: Response,
        states: np.ndarray,
        seen: np.ndarray | None,
        changed: np.ndarray,
        y: np.ndarray,
        hessian: np.ndarray,
    ) -> None:
        """Correct the response ``result`` of the shears for lagged variables.

        Slopes by variables that do not lag become the slopes at the states ``seen``. The volumes' slopes by
        the damages are added. ``changed`` are the points at which ``states`` and ``seen`` differ, ``y`` are
        the volumes at the states ``seen``, and ``hessian`` is the second derivative of V there.
        """
        lagged, others = np.flatnonzero(self.lagged), np.flatnonzero(~self.lagged)
        if seen is not None:
            if len(changed):
                of_seen, rows = self.shears(seen[changed]), np.ix_(changed, others)
                result.slope[rows] = of_seen.slope[:, others]
                result.hessian[rows] = of_seen.hessian[:, others]
            result.hessian[:, others[:, None], lagged] = 0.0
        amounts, J = list(self.amounts.values()), y[..., 0]
        of_pressure = -hessian[:, 0, 0, None] / J[:, :1] ** 2 * J  # dU_i' / dn_k, equal for all bodies i
        for i, name in enumerate(self.amounts):
            if (d := self.damages.get(name)) is None:
                continue
            own = 1 + self.parameters.index(d)
            volume = self.volumes[i](np.column_stack([J[:, i], states[:, self.parameters]]))
            n, stiffness = states[:, amounts[i]], volume.hessian[:, 0, 0].copy()
            if seen is not None and len(changed):
                at_seen = np.column_stack([J[changed, i], seen[np.ix_(changed, self.parameters)]])
                stiffness[changed] = self.volumes[i](at_seen).hessian[:, 0, 0]
            by_amounts = (n * volume.hessian[:, own, 0] / stiffness)[:, None] * of_pressure
            by_amounts[:, i] += volume.slope[:, own]
            result.slope[:, d] += n * volume.slope[:, own]
            result.hessian[:, d, d] += n * volume.hessian[:, own, own]
            result.hessian[:, d, amounts] += by_amounts
            if seen is None:
                result.hessian[:, amounts, d] += by_amounts

    def _start(self, n: np.ndarray, total: np.ndarray) -> np.ndarray:
        """J_i, and S_i with heat, for bodies of one volume and one temperature; NaN if they do not exist."""
        with np.errstate(all="ignore"):
            N = n.sum(axis=1)
            J = np.where(N > 0, 1 / N, np.nan)
            if self.heat is None:
                return np.repeat(J[:, None, None], n.shape[1], axis=1)
            amounts = dict(zip(self.amounts, n.T, strict=True))
            J = np.where(self.heat.capacity(amounts) > 0, J, np.nan)
            S = self.heat.entropies(amounts, total[:, 1], J)
            return np.stack([np.stack([J, S[name]], axis=1) for name in amounts], axis=1)

    def _failure(self, n: np.ndarray) -> str | None:
        """The message about points without a common pressure, with the amounts ``n``; None if there are no
        such points."""
        if not len(n):
            return None
        common = "pressure" if self.heat is None else "pressure and temperature"
        remedy = "a gas without p_infinity has no common pressure with matter in tension"
        if (n < 0).any():
            remedy = (
                "some amounts are negative; with the orders k = 1 and m = 0 fewer amounts become negative"
            )
        points = f"{len(n)} points, e.g. for the amounts {', '.join(f'{amount:.3g}' for amount in n[0])}"
        return f"bodies have no common {common} at {points}; {remedy}"
