"""Warnings of laws that read a negative pressure: strengths and viscosities do not hold in tension."""

from __future__ import annotations

import numpy as np
from ngsolve import CF

from ngvisco.errors import InputWarning
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.physics.loads import force_of
from ngvisco.physics.model import Model
from ngvisco.physics.variables import PRESSURE

_SHARE = 0.02
"""Largest tension, as a share of the largest pressure, that may come from a surface and its cells."""
_BORNE = 0.5
"""Share of the weight that pressure differences must bear at the start."""


def readers(model: Model) -> list[str]:
    """Names of a model's laws that read the pressure."""
    laws = [model.creep, model.viscosity, *(mechanism.rule for mechanism in model.mechanisms)]
    laws += [law for body in model.bodies for law in (body.creep, body.viscosity)]
    return sorted({type(law).__name__ for law in laws if law is not None and PRESSURE in law.reads})


class Tension:
    """Warning, once in a run, of a law that reads a negative pressure."""

    def __init__(self, step: Step, sampler: Sampler) -> None:
        self.step, self.sampler = step, sampler
        self.laws, self.is_said = readers(step.model), False
        self._pressure = step.context.rates.pressure(step.now).Compile() if self.laws else None

    def __call__(self, t: float) -> None:
        """Check the present state at the time ``t``, s."""
        if self._pressure is None or self.is_said:
            return
        ranks, p = self.sampler.ranks, self.sampler.values(self._pressure)
        least, largest = ranks.least(p), ranks.most(abs(p))
        if least >= -_SHARE * largest:
            return
        self.is_said = True
        place = self.sampler.largest_in_words(-p, {})
        weighs = any(load.is_weight for load in self.step.model.loads)
        balanced = '. With [initial] equilibrium = "hydrostatic" the initial pressure balances the weight'
        remedy = balanced if weighs else ""
        message = (
            f"at t = {t:.4g} s {_subject(self.laws)} a negative pressure, "
            f"{least:.4g} Pa {place}. In tension, only cohesion gives strength{remedy}"
        )
        ranks.warn(message, InputWarning, stacklevel=4)


def unborne_weight(step: Step, sampler: Sampler) -> str | None:
    """Message about a start whose pressure does not bear the weight; None unless a law reads this
    pressure."""
    laws, ranks, dim = readers(step.model), sampler.ranks, step.mesh.dim
    loads = (load for load in step.model.loads if load.is_weight)
    weight = sum((step.now.rho * force_of(load, dim) for load in loads), CF((0.0,) * dim))
    heaviest = ranks.most(np.linalg.norm(sampler.rows(weight), axis=1))
    if not laws or not heaviest > 0:
        return None
    p = sampler.values(step.context.rates.pressure(step.now))
    places = sampler.coordinates(np.arange(len(sampler.points)))
    ends = ranks.largest(np.concatenate([places.max(axis=0), -places.min(axis=0)]))
    size = float(np.min(ends[:dim] + ends[dim:]))
    if ranks.most(p) - ranks.least(p) > _BORNE * heaviest * size:
        return None
    return (
        f"{_subject(laws)} the pressure, but the pressure at the start does not balance the weight, "
        f"{heaviest * size:.3g} Pa over {size:.3g} m. The body sags until the pressure balances the weight, "
        "and the upper part of the body comes into tension. "
        'Take [initial] equilibrium = "hydrostatic"'
    )


def _subject(laws: list[str]) -> str:
    return f"{' and '.join(laws)} read{'s' * (len(laws) == 1)}"
