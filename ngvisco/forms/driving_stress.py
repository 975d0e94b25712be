"""The stress at which a nonlinear flow rule is linearised, an unknown that is stored at the nodal points.

Newton's method for z alone linearises rate(M(z)) (paper: ED-Euler-large3) at M(z).  For yield with a small
viscosity G_m this tangent is right only within |M| G_m of the solution. An increment that turns M by an angle
a increases |M| by |M| a^2/2, and the rate by |M| a^2/(2 G_m).  Here M* is a further unknown beside M(z):

    M* + c rate(M*) = Y,   M(z) = M*,   Pi = (Y - M*)/c.

The slope of M* as a function of Y is at most one, and its curvature is that of the rule's level sets, however
steep the rule is (Yosida).  In the equations of z, the rate in Newton's method for (z, Y) is

    Pi = rate(M*) + S (M(z) - M*),   S = rate'(M*).

The increment dz gives Y = (M + M' dz) + c (Pi + S M' dz), from which M* follows point by point. The solution
satisfies Pi = rate(M(z)) for any c > 0, in Pa s; c is tau times the stress per creep strain at rest. If a
factor of Pi multiplies S (M(z) - M*), the factor is evaluated at the iterate. In the matrix of (z, Y) the
change of the factor then multiplies rate(M*) only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from ngsolve import CoefficientFunction, GridFunction

from ngvisco.forms.context import StepLayout
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.quadrature import Quadrature, values_of
from ngvisco.forms.rates import Conjugate, Rates, TabulatedRates
from ngvisco.forms.unknown_values import UnknownValues
from ngvisco.physics.arrays import TINY, Array
from ngvisco.physics.flow_rules.resolvent import PointRate, resolved, slope_of
from ngvisco.physics.model import CreepMechanism
from ngvisco.physics.pointwise import rest_state

_OfRate: TypeAlias = Callable[[CreepMechanism, CoefficientFunction, UnknownValues], CoefficientFunction]
_Sampled: TypeAlias = tuple[np.ndarray, np.ndarray]
STRESS = "stress_"
"""Prefix of the stresses' names in a checkpoint."""


@dataclass(frozen=True)
class _State:
    """An iterate: the coefficients of z; and, at collocation points, z, zeta, M(z), the stress M* and the
    rate at M*."""

    key: np.ndarray
    z: np.ndarray
    zeta: np.ndarray
    M: np.ndarray
    stress: np.ndarray
    rate: np.ndarray


class LinearisationStress:
    """The stresses M* of a step's state for a model with collocated creep.

    The object is false if no flow rule needs such a stress. Arrays are (mechanisms, points, components);
    arrays of z and zeta are (components, points).
    """

    def __init__(
        self, rates: TabulatedRates, layout: StepLayout, quadrature: Quadrature, state: GridFunction
    ) -> None:
        self.rates, self.layout, self.space = rates, layout, rates.creep_space
        self.mechanisms = tuple(
            mechanism
            for mechanism in rates.mechanisms
            if rates.creep_is_collocated and not mechanism.rule.reads_conjugate
        )
        p = self.space.size
        self.stress, self.slope = (
            {mechanism: quadrature.vectors(size, collocated=True) for mechanism in self.mechanisms}
            for size in (p, p * p)
        )
        """Grid functions of M* and S by mechanism, read by forms."""
        stiffness = [_stiffness(mechanism, rates) for mechanism in self.mechanisms]
        self._stiffness = np.array(stiffness).reshape(-1, 1, 1)
        self._last: np.ndarray | None = None
        self._slopes = np.zeros((len(self.mechanisms), 0, p, p))
        self._frozen: _State | None = None  # the iterate at which the slopes were computed
        self._given: np.ndarray | None = None  # stresses of the next state
        self.start()
        self.state, self._own = state, layout.ranges["z"]
        self._now = self._parts(state)
        self._sampled = quadrature.vectors(layout.states.size, collocated=True)

    def __bool__(self) -> bool:
        return bool(self.mechanisms)

    def _parts(self, state: GridFunction) -> list[GridFunction]:
        """z and zeta of a state."""
        parts = dict(zip(self.layout.names, state.components, strict=True))
        return [parts["z"], parts["zeta"]]

    @cached_property
    def _increment(self) -> GridFunction:
        return GridFunction(self.layout.space)

    def begin(self) -> None:
        """Begin a step at the present state."""
        if self:
            M, rules = self._driven(*self._values(self._now))
            with np.errstate(all="ignore"):
                strain = self._softness * _rates(rules, M)
                share = np.linalg.norm(M, axis=2) / np.linalg.norm(strain, axis=2)
            # the creep rate is bounded, since the stress can violate the flow rule after a midpoint step
            self._last = np.nan_to_num(np.minimum(share, 1.0)[..., None] * strain / self._softness)

    def start(self) -> None:
        """Begin an iteration at the next state, with the rates of the step's start.

        At values that are not a solution, a steep rule's rate(M(z)) would be far from the rate of the
        solution.
        """
        self._begins = self._last is not None
        self._at: _State | None = None
        self._target: np.ndarray | None = None

    def refresh(self, sampled: Callable[[], _Sampled] | None = None) -> None:
        """Compute the stresses M* of the present state, from the target Y of ``follow``. Without a target,
        the stresses are M(z), and the slopes are computed anew.

        ``sampled`` returns z and zeta at the collocation points.
        """
        if not self:
            return
        key = self.state.vec.FV().NumPy()[self._own]
        if self._at is not None and np.array_equal(key, self._at.key):
            return
        z, zeta = self._values(self._now) if sampled is None else sampled()
        M, rules = self._driven(z, zeta)
        target, self._target, anew = self._target, None, self._target is None
        if self._begins and self._last is not None:
            target = M + self._softness * self._last
        self._begins = False
        if self._given is not None:
            stress, self._given = self._given, None
            rate = _rates(rules, stress)
        elif target is None:
            stress, rate = M, _rates(rules, M)
        else:
            sizes = [None] * len(rules) if self._at is None else np.linalg.norm(self._at.stress, axis=2)
            each = zip(rules, target, self._softness.ravel(), sizes, strict=True)
            stress, rate = map(np.stack, zip(*(resolved(*arguments) for arguments in each), strict=True))
        self._before = self._at
        self._take(_State(key.copy(), z, zeta, M, stress, rate))
        if anew:
            self.linearise()

    def linearise(self) -> bool:
        """Compute the slopes at the present stresses; return whether any has changed."""
        at, before = self._at, self._slopes
        if at is None or at is self._frozen or not self:
            return False
        _, rules = self._driven(at.z, at.zeta)
        self._frozen = at
        self._slopes = np.stack([slope_of(rule, M) for rule, M in zip(rules, at.stress, strict=True)])
        if np.array_equal(self._slopes, before):
            return False
        for function, slope in zip(self.slope.values(), self._slopes, strict=True):
            values_of(function)[:] = slope.reshape(len(slope), -1).T
        return True

    def follow(self, increment: Any, length: float) -> None:
        """Prepare the stresses for a next state, the present state minus ``length`` times ``increment``."""
        if self:
            self._increment.vec.data = -1.0 * increment
            self.follow_fields(*self._values(self._parts(self._increment)), length)

    def follow_fields(self, dz: np.ndarray, dzeta: np.ndarray, length: float) -> None:
        """Compute the target Y after ``length`` times the increments ``dz`` and ``dzeta`` at collocation
        points."""
        if self:
            at, old, c = self._at, self._frozen, self._softness
            assert at is not None and old is not None
            M, rules = self._driven(old.z + (TINY * 1j) * dz, old.zeta + (TINY * 1j) * dzeta)
            off = at.M + M.imag / TINY - at.stress
            read = _rates(rules, old.stress).imag / TINY
            increment = off + c * (np.einsum("fnij,fnj->fni", self._slopes, off) + read)
            self._target = at.stress + c * at.rate + length * increment

    def undo(self) -> None:
        """Return to the state before the last increment."""
        if self:
            assert self._before is not None
            self._target = None
            self._take(self._before)

    @property
    def are_stiff(self) -> bool:
        """Whether the slope of a rule relaxes nine tenths of a stress in a step, somewhere on this rank."""
        return bool((self._softness[..., None] * abs(self._slopes)).max(initial=0.0) > 9)

    @property
    def functions(self) -> dict[str, GridFunction]:
        """The grid functions of the stresses by their names in a checkpoint."""
        return {f"{STRESS}{i}": function for i, function in enumerate(self.stress.values())}

    def frozen(self) -> dict[str, np.ndarray]:
        """The stresses at which the slopes are evaluated: the coefficients of ``functions`` by name."""
        at = self._frozen
        return {
            name: np.zeros(0) if at is None else at.stress[i].T.ravel()
            for i, name in enumerate(self.functions)
        }

    def give(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Set the next state's stresses: to the ``arrays`` of ``frozen``, or to M(z) if there are none."""
        if self and arrays.keys() >= self.functions.keys():
            self.start()
            self._given = np.stack([arrays[name].reshape(self.space.size, -1).T for name in self.functions])

    def components(self, mechanism: CreepMechanism, u: UnknownValues, rates: Rates) -> Any:
        """Components of the stress M(z) that drives a mechanism."""
        return self.space.components(rates.driving(mechanism, u))

    def of(self, mechanism: CreepMechanism) -> tuple[np.ndarray, np.ndarray]:
        """The stress of a mechanism, (p, points), and the slope of its rate, (points, p, p)."""
        assert self._at is not None
        number = self.mechanisms.index(mechanism)
        return self._at.stress[number].T, self._slopes[number]

    @property
    def _softness(self) -> np.ndarray:
        """The coefficients c, Pa s, (mechanisms, 1, 1)."""
        return self._stiffness * self.layout.context.tau.Get()

    def _take(self, state: _State) -> None:
        self._at = state
        for function, stress in zip(self.stress.values(), state.stress, strict=True):
            values_of(function)[:] = stress.T

    def _driven(self, z: np.ndarray, zeta: np.ndarray) -> tuple[np.ndarray, list[PointRate]]:
        """The stresses M(z) at the collocation points, and the flow rules as functions of the stress at
        these points."""
        dim = self.rates.dim
        parts = {"z": Array(z, None), "zeta": Array(zeta, None)}
        u = Fields(self.layout, parts, gradient=lambda name: Array(np.zeros((dim, dim, 1)), None))
        M = np.stack([self.components(mechanism, u, self.rates).value.T for mechanism in self.mechanisms])
        return M, [self._rule(mechanism, u) for mechanism in self.mechanisms]

    def _rule(self, mechanism: CreepMechanism, u: UnknownValues) -> PointRate:
        read = self.rates.read_values(mechanism.rule, u, mechanism)

        def rate(M: np.ndarray) -> np.ndarray:
            Pi = mechanism.rule.rate(self.space.tensor(Array(M.T, None)), None, read)
            return np.broadcast_to(self.space.components(Pi).value, M.T.shape).T

        return rate

    def _values(self, parts: Sequence[GridFunction]) -> _Sampled:
        fields = []
        for part in parts:
            self._sampled.Interpolate(part)
            fields.append(values_of(self._sampled).copy())
        return fields[0], fields[1]


def _rates(rules: Sequence[PointRate], M: np.ndarray) -> np.ndarray:
    return np.stack([rule(of_flow) for rule, of_flow in zip(rules, M, strict=True)])


class KeptRates(Rates):
    """Rates of a solved state from its stored stresses at collocation points.

    M(z) is not used, because a steep rule would multiply its rounding, which comes from rounding of z.
    """

    def __init__(self, rates: Rates, stresses: LinearisationStress) -> None:
        super().__init__(rates.model, rates.dim, rates.hoop)
        self.stresses = stresses

    def local_creep(self, mechanism: CreepMechanism, u: UnknownValues) -> CoefficientFunction:
        if mechanism not in self.stresses.stress:
            return super().local_creep(mechanism, u)
        read = self.read_values(mechanism.rule, u, mechanism)
        return mechanism.rule.rate(self.stresses.space.tensor(self._stress(mechanism, u)), None, read)

    def _stress(self, mechanism: CreepMechanism, u: UnknownValues) -> Any:
        """The components of the stress at the points of u."""
        return self.stresses.stress[mechanism]


class LinearisedRates(KeptRates):
    """Rates with the linearised correction S (M(z) - M*), used in the Newton iteration for (z, Y)."""

    def __init__(self, rates: Rates, stresses: LinearisationStress, now: UnknownValues | None = None) -> None:
        """``now`` are the fields of the iterate; None for arrays of values."""
        super().__init__(rates, stresses)
        self._iterate = now

    def creep_power(
        self, z: UnknownValues, Pi: Sequence[CoefficientFunction], G: UnknownValues, name: Conjugate
    ) -> Sequence[CoefficientFunction]:
        off = [
            self._off(mechanism, z) if mechanism in self.stresses.stress else 0 * rate
            for mechanism, rate in zip(self.mechanisms, Pi, strict=True)
        ]
        return [*super().creep_power(z, Pi, G, name), *super().creep_power(self._now(z), off, G, name)]

    def power_of_creep(
        self, mechanism: CreepMechanism, Pi: CoefficientFunction, u: UnknownValues
    ) -> CoefficientFunction:
        return self._along(super().power_of_creep, mechanism, Pi, u)

    def hardening_rate(
        self, mechanism: CreepMechanism, Pi: CoefficientFunction, u: UnknownValues
    ) -> CoefficientFunction:
        return self._along(super().hardening_rate, mechanism, Pi, u)

    def _along(
        self, function: _OfRate, mechanism: CreepMechanism, Pi: CoefficientFunction, u: UnknownValues
    ) -> CoefficientFunction:
        """A ``function`` of Pi at the iterate's rate, plus its derivative in the direction of the rate's
        correction."""
        now = self._now(u)
        if mechanism not in self.stresses.stress or u is now:
            return function(mechanism, Pi, u)
        return function(mechanism, Pi, u) + self._derivative(
            lambda rate: function(mechanism, rate, now), Pi, self._off(mechanism, u)
        )

    def _now(self, u: UnknownValues) -> UnknownValues:
        """The fields of the iterate."""
        assert self._iterate is not None
        return self._iterate

    def _off(self, mechanism: CreepMechanism, u: UnknownValues) -> CoefficientFunction:
        """The linearised correction S (M(z) - M*) of the rate."""
        kept, p = self.stresses, self.stresses.space.size
        off = kept.components(mechanism, u, self) - kept.stress[mechanism]
        return kept.space.tensor(kept.slope[mechanism].Reshape((p, p)) * off)

    @staticmethod
    def _derivative(function: Callable[[Any], Any], Pi: Any, off: Any) -> Any:
        """The derivative of a function of Pi in the direction ``off``."""
        variable = Pi.MakeVariable()
        return function(variable).Diff(variable, off)


class LinearisedTabulatedRates(LinearisedRates, TabulatedRates):
    """Linearised rates for arrays of values, for one or several directions of an increment at each
    collocation point."""

    def _stress(self, mechanism: CreepMechanism, u: UnknownValues) -> Array:
        stress, _ = self.stresses.of(mechanism)
        return Array(np.tile(stress, u.z.value.shape[-1] // max(stress.shape[1], 1)), None)

    def _now(self, u: UnknownValues) -> UnknownValues:
        """The values without their imaginary parts, which belong to an increment."""
        parts = {name: Array(u.parts[name].value.real, None) for name in ("z", "zeta")}
        return Fields(
            self.stresses.layout, parts, u.context, lambda name: Array(u.gradient(name).value.real, None)
        )

    def _off(self, mechanism: CreepMechanism, u: UnknownValues) -> Array:
        stress, slope = self.stresses.of(mechanism)
        M = self.stresses.components(mechanism, u, self).value
        off = M.reshape(len(stress), -1, max(stress.shape[1], 1)) - stress[:, None]
        changed = np.einsum("nij,jtn->itn", slope, off, optimize=True)
        return self.stresses.space.tensor(Array(changed.reshape(M.shape), None))

    @staticmethod
    def _derivative(function: Callable[[Any], Any], Pi: Any, off: Any) -> Any:
        at, parts = Pi.value.real, [off.value.real]
        if np.iscomplexobj(off.value):
            parts.append(off.value.imag)
        derivatives = [function(Array(at + (TINY * 1j) * part, None)).value.imag / TINY for part in parts]
        return Array(derivatives[0] + 1j * derivatives[1] if len(derivatives) > 1 else derivatives[0], None)


def _stiffness(mechanism: CreepMechanism, rates: TabulatedRates) -> float:
    """Stress per creep strain at rest, Pa, the mean over the components."""
    values_at_rest = rest_state(rates.material, rates.dim)[None]
    response, first = rates.response(values_at_rest), rates.tensors.gradients
    first += rates.creep_space.size * rates.mechanisms.index(mechanism)
    creep = slice(first, first + rates.creep_space.size)
    columns = rates.columns(values_at_rest.T)[0]
    _, of_stress = rates.slopes(values_at_rest.T, np.zeros((columns.shape[1], 1)), response.slope.T)
    force = of_stress[0, creep] + columns[:, creep].T @ response.hessian[0]
    return float(np.trace(force @ columns[:, creep])) / rates.creep_space.size
