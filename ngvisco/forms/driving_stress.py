"""The stress at which a nonlinear flow rule is linearised, kept at the points: an unknown of its own.

Newton's method for z alone takes rate(M(z)) (paper: ED-Euler-large3) along the rule's tangent at M(z).  That
of yield at next to no viscosity is right within |M| G_m of the solution only: an increment that turns M by an
angle a lengthens it by a^2/2, which the rule answers by |M| a^2/(2 G_m).  With the stress M* as an unknown
beside M(z), by

    M* + c rate(M*) = Y,   M(z) = M*,   Pi = (Y - M*)/c,

M* is a function of Y that is no steeper than one and as curved as the rule's level sets, however steep the
rule is (Yosida).  Newton's method for (z, Y) has in the equations of z, with S = rate'(M*),

    Pi = rate(M*) + S (M(z) - M*),

and follows its increment dz by Y = (M + M' dz) + c (Pi + S M' dz), of which the new M* is found point by
point.  The solution is that of Pi = rate(M(z)) for any c > 0, in Pa s: what creep within a step takes of a
stress at rest.  What Pi is multiplied by is taken at the iterate where it multiplies S (M(z) - M*): the
matrix of (z, Y) has rate(M*) times its change only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, VectorValued
from ngsolve.comp import IntegrationRuleSpace

from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.rates import Conjugate, Rates, TabulatedRates
from ngvisco.forms.spaces import Layout
from ngvisco.physics.arrays import TINY, Array
from ngvisco.physics.flow_rules.resolvent import PointRate, resolved, slope_of
from ngvisco.physics.model import Flow
from ngvisco.physics.pointwise import respond, rest_state

_OfRate: TypeAlias = Callable[[Flow, CoefficientFunction, Fields], CoefficientFunction]
STRESS = "stress_"
"""What names of the stresses begin with in a checkpoint."""


class DrivingStress:
    """The stress of one flow at the nodes, in components, and its rule's slope."""

    def __init__(self, flow: Flow, layout: Layout, rates: TabulatedRates, quadrature: Quadrature) -> None:
        self.flow, self.layout, self.rates, self.space = flow, layout, rates, rates.creep_space
        p = self.space.size
        self._stiffness = _stiffness(flow, rates)
        self.stress, self.slope = (at_nodes(quadrature, size) for size in (p, p * p))
        """For forms."""
        self._last: np.ndarray | None = None
        self._slope = np.zeros((0, p, p))
        self._frozen: _State | None = None
        """What the slope is of."""
        self._given: np.ndarray | None = None
        """The stress of the state that it is moved to next."""
        self.start()

    def begin(self, z: np.ndarray, zeta: np.ndarray) -> None:
        """A step begins at a state with these values at the nodes."""
        M = self._driven(z, zeta)
        with np.errstate(all="ignore"):
            taken = self.softness * self._rate_at(z, zeta)(M)
            share = np.linalg.norm(M, axis=1) / np.linalg.norm(taken, axis=1)
        # a scheme's end that is off the graph, as the midpoint rule's, has a rate that means nothing
        self._last = np.nan_to_num(np.minimum(share, 1.0)[:, None] * taken / self.softness)

    def start(self) -> None:
        """Begin anew at the state that it is moved to next: with the rate that the step began with.

        With rate(M(z)) of values that are no solution a steep rule would begin far off.
        """
        self._begins = self._last is not None
        self._at: _State | None = None
        self._target: np.ndarray | None = None

    def move(self, key: np.ndarray, sampled: Callable[[], tuple[np.ndarray, np.ndarray]]) -> None:
        """Make the stress that of a state: where ``follow`` has led, or M(z) itself, with its slope then.

        ``key`` are the coefficients of z; ``sampled`` gives z and zeta at the nodes.
        """
        if self._at is not None and np.array_equal(key, self._at.key):
            return
        z, zeta = sampled()
        M, rate = self._driven(z, zeta), self._rate_at(z, zeta)
        target, self._target, anew = self._target, None, self._target is None
        if self._begins and self._last is not None:
            target = M + self.softness * self._last
        self._begins = False
        start = None if self._at is None else np.linalg.norm(self._at.stress, axis=1)
        if self._given is not None:
            stress, self._given = self._given, None
            Pi = rate(stress)
        elif target is None:
            stress, Pi = M, rate(M)
        else:
            stress, Pi = resolved(rate, target, self.softness, start)
        self._before = self._at
        self._take(_State(key.copy(), z, zeta, M, stress, Pi))
        if anew:
            self.linearise()

    def linearise(self) -> bool:
        """Make the slope that of the present stress; whether it is another one."""
        assert self._at is not None
        at, before = self._at, self._slope
        if at is self._frozen:
            return False
        self._frozen, self._slope = at, slope_of(self._rate_at(at.z, at.zeta), at.stress)
        if np.array_equal(self._slope, before):
            return False
        _array(self.slope)[:] = self._slope.reshape(len(self._slope), -1).T
        return True

    def follow(self, dz: np.ndarray, dzeta: np.ndarray, length: float) -> None:
        """Let the next state be the present one with ``length`` times an increment of z and zeta."""
        at, old, c = self._at, self._frozen, self.softness
        assert at is not None and old is not None
        z, zeta = old.z + (TINY * 1j) * dz, old.zeta + (TINY * 1j) * dzeta
        off = at.M + self._driven(z, zeta).imag / TINY - at.stress
        read = self._rate_at(z, zeta)(old.stress).imag / TINY
        through = off + c * (np.einsum("nij,nj->ni", self._slope, off) + read)
        self._target = at.stress + c * at.rate + length * through

    @property
    def frozen(self) -> np.ndarray:
        """The stress that the slope is of, the coefficients of ``stress``."""
        return np.zeros(0) if self._frozen is None else self._frozen.stress.T.ravel()

    def give(self, values: np.ndarray) -> None:
        """Let the next state have this stress, coefficients of ``stress``."""
        self.start()
        self._given = values.reshape(self.space.size, -1).T.copy()

    def undo(self) -> None:
        """The state is again that before the last increment."""
        assert self._before is not None
        self._target = None
        self._take(self._before)

    def driven(self, u: Fields, rates: Rates) -> Any:
        """Components of the stress M(z) that drives the flow."""
        M = self.space.components(rates.mandel(u, self.flow))
        return M if self.flow.body is None else (1 / self.flow.share(u.z_tensors)) * M

    @property
    def at_iterate(self) -> tuple[np.ndarray, np.ndarray]:
        """The stress, (p, points), and the slope, (points, p, p)."""
        assert self._at is not None
        return self._at.stress.T, self._slope

    @property
    def is_stiff(self) -> bool:
        """Whether the rule, along the slope, takes nine tenths of a stress in a step somewhere."""
        return bool(self.softness * abs(self._slope).max(initial=0.0) > 9)

    @property
    def softness(self) -> float:
        """c, Pa s."""
        return self._stiffness * self.layout.context.tau.Get()

    def _take(self, state: _State) -> None:
        self._at = state
        _array(self.stress)[:] = state.stress.T

    def _fields(self, z: np.ndarray, zeta: np.ndarray) -> Fields:
        dim = self.rates.dim
        parts = {"z": Array(z, None), "zeta": Array(zeta, None)}
        return Fields(self.layout, parts, gradient=lambda name: Array(np.zeros((dim, dim, 1)), None))

    def _driven(self, z: np.ndarray, zeta: np.ndarray) -> np.ndarray:
        """(points, p)."""
        return self.driven(self._fields(z, zeta), self.rates).value.T

    def _rate_at(self, z: np.ndarray, zeta: np.ndarray) -> PointRate:
        u = self._fields(z, zeta)
        read = self.rates.read_values(self.flow.rule, u, self.flow)

        def rate(M: np.ndarray) -> np.ndarray:
            Pi = self.flow.rule.rate(self.space.tensor(Array(M.T, None)), None, read)
            return np.broadcast_to(self.space.components(Pi).value, M.T.shape).T

        return rate


@dataclass
class _State:
    """Coefficients of z; z and zeta at the nodes, M(z), the stress in its place, and the rate there."""

    key: np.ndarray
    z: np.ndarray
    zeta: np.ndarray
    M: np.ndarray
    stress: np.ndarray
    rate: np.ndarray


class Stresses:
    """Those of a model whose creep is at nodes, of the state of a step; false where none is."""

    def __init__(
        self, rates: TabulatedRates, layout: Layout, quadrature: Quadrature, state: GridFunction
    ) -> None:
        self.of = {
            flow: DrivingStress(flow, layout, rates, quadrature)
            for flow in rates.flows
            if rates.creeps_at_nodes and not flow.rule.reads_conjugate
        }
        self.state, self._own = state, layout.ranges["z"]
        self._increment = GridFunction(layout.space)
        parts = (dict(zip(layout.names, each.components, strict=True)) for each in (state, self._increment))
        self._now, self._along = ([each["z"], each["zeta"]] for each in parts)
        self._sampled = at_nodes(quadrature, layout.states.size)

    def __bool__(self) -> bool:
        return bool(self.of)

    def begin(self) -> None:
        """A step begins at the present state."""
        for stress in self.of.values():
            stress.begin(*self._values(self._now))

    def start(self) -> None:
        """An iteration begins."""
        for stress in self.of.values():
            stress.start()

    def refresh(self, sampled: Callable[[], tuple[np.ndarray, np.ndarray]] | None = None) -> None:
        """Make them those of the present state, whose z and zeta at the nodes ``sampled`` gives."""
        key = self.state.vec.FV().NumPy()[self._own]
        for stress in self.of.values():
            stress.move(key, sampled or self._sample)

    def linearise(self) -> bool:
        """Make their slopes those of the stresses; whether any is another one."""
        return any([stress.linearise() for stress in self.of.values()])

    def follow(self, increment: Any, length: float) -> None:
        """Let the next state be the present one without ``length`` times ``increment``, of all unknowns."""
        if self:
            self._increment.vec.data = -1.0 * increment
            dz, dzeta = self._values(self._along)
            self.follow_fields(dz, dzeta, length)

    def follow_fields(self, dz: np.ndarray, dzeta: np.ndarray, length: float) -> None:
        """The same by what is added to z and zeta at the nodes."""
        for stress in self.of.values():
            stress.follow(dz, dzeta, length)

    @property
    def are_stiff(self) -> bool:
        """Whether any is, on this rank."""
        return any(stress.is_stiff for stress in self.of.values())

    def frozen(self) -> dict[str, np.ndarray]:
        """The stresses that the slopes are of, by name, coefficients of ``functions``."""
        return {name: stress.frozen for name, stress in zip(self.functions, self.of.values(), strict=True)}

    @property
    def functions(self) -> dict[str, GridFunction]:
        """The grid functions that they are in, by names for a checkpoint."""
        return {f"{STRESS}{i}": stress.stress for i, stress in enumerate(self.of.values())}

    def give(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Let the next state have these ``frozen`` ones, M(z) where there are none."""
        for name, stress in zip(self.functions, self.of.values(), strict=True):
            if name in arrays:
                stress.give(arrays[name])

    def undo(self) -> None:
        for stress in self.of.values():
            stress.undo()

    def _sample(self) -> tuple[np.ndarray, np.ndarray]:
        """z and zeta of the present state."""
        return self._values(self._now)

    def _values(self, parts: Sequence[GridFunction]) -> tuple[np.ndarray, np.ndarray]:
        found = []
        for part in parts:
            self._sampled.Interpolate(part)
            found.append(_array(self._sampled).copy())
        return found[0], found[1]


class KeptRates(Rates):
    """``Rates`` by the stresses that are kept, at the nodes: of a solved state, to its last digit.

    One of z is one of M(z), which a steep rule multiplies.
    """

    def __init__(self, rates: Rates, stresses: Stresses) -> None:
        super().__init__(rates.model, rates.dim)
        self.stresses: Mapping[Flow, DrivingStress] = stresses.of

    def local_creep(self, flow: Flow, u: Fields) -> CoefficientFunction:
        if flow not in self.stresses:
            return super().local_creep(flow, u)
        read = self.read_values(flow.rule, u, flow)
        return flow.rule.rate(self.stresses[flow].space.tensor(self._stress(flow, u)), None, read)

    def _stress(self, flow: Flow, u: Fields) -> Any:
        """Its components, at the points of u."""
        return self.stresses[flow].stress


class LinearisedRates(KeptRates):
    """The same with what it takes to M(z), along the slopes: that of an iteration for (z, Y)."""

    def __init__(self, rates: Rates, stresses: Stresses, now: Fields | None = None) -> None:
        """``now`` are the fields of the iterate; None for those of arrays."""
        super().__init__(rates, stresses)
        self._iterate = now

    def creep_power(
        self, z: Fields, Pi: Sequence[CoefficientFunction], G: Fields, name: Conjugate
    ) -> Sequence[CoefficientFunction]:
        off = [
            self._off(flow, z) if flow in self.stresses else 0 * rate
            for flow, rate in zip(self.flows, Pi, strict=True)
        ]
        return [*super().creep_power(z, Pi, G, name), *super().creep_power(self._now(z), off, G, name)]

    def power_of_creep(self, flow: Flow, Pi: CoefficientFunction, u: Fields) -> CoefficientFunction:
        return self._along(super().power_of_creep, flow, Pi, u)

    def hardening_rate(self, flow: Flow, Pi: CoefficientFunction, u: Fields) -> CoefficientFunction:
        return self._along(super().hardening_rate, flow, Pi, u)

    def _along(self, of: _OfRate, flow: Flow, Pi: CoefficientFunction, u: Fields) -> CoefficientFunction:
        """A function of Pi, with its derivative."""
        now = self._now(u)
        if flow not in self.stresses or u is now:
            return of(flow, Pi, u)
        return of(flow, Pi, u) + self._derivative(lambda rate: of(flow, rate, now), Pi, self._off(flow, u))

    def _now(self, u: Fields) -> Fields:
        """The iterate."""
        assert self._iterate is not None
        return self._iterate

    def _off(self, flow: Flow, u: Fields) -> CoefficientFunction:
        """What the rate changes by from the stress to M(z)."""
        stress, p = self.stresses[flow], self.stresses[flow].space.size
        return stress.space.tensor(stress.slope.Reshape((p, p)) * (stress.driven(u, self) - stress.stress))

    @staticmethod
    def _derivative(of: Callable[[Any], Any], Pi: Any, off: Any) -> Any:
        """That of a function of Pi in the direction ``off``."""
        variable = Pi.MakeVariable()
        return of(variable).Diff(variable, off)


class LinearisedTabulatedRates(LinearisedRates, TabulatedRates):
    """The same by arrays, in one or several directions of an increment at each node."""

    def _stress(self, flow: Flow, u: Fields) -> Array:
        return Array(np.tile(self.stresses[flow].at_iterate[0], self._times(flow, u)), None)

    def _times(self, flow: Flow, u: Fields) -> int:
        """How often the nodes are there, for as many directions."""
        return u.z.value.shape[-1] // max(self.stresses[flow].at_iterate[0].shape[1], 1)

    def _now(self, u: Fields) -> Fields:
        """The same values without the imaginary parts of an increment."""
        parts = {name: Array(u.parts[name].value.real, None) for name in ("z", "zeta")}
        return Fields(u.layout, parts, u.context, lambda name: Array(u.gradient(name).value.real, None))

    def _off(self, flow: Flow, u: Fields) -> Array:
        stress, times = self.stresses[flow], self._times(flow, u)
        M, slope = stress.at_iterate
        off = stress.driven(u, self).value.reshape(len(M), times, M.shape[1]) - M[:, None]
        changed = np.einsum("nij,jtn->itn", slope, off, optimize=True)
        return stress.space.tensor(Array(changed.reshape(len(M), times * M.shape[1]), None))

    @staticmethod
    def _derivative(of: Callable[[Any], Any], Pi: Any, off: Any) -> Any:
        at, parts = Pi.value.real, [off.value.real]
        if np.iscomplexobj(off.value):
            parts.append(off.value.imag)
        found = [of(Array(at + (TINY * 1j) * part, None)).value.imag / TINY for part in parts]
        return Array(found[0] + 1j * found[1] if len(found) > 1 else found[0], None)


def _stiffness(flow: Flow, rates: TabulatedRates) -> float:
    """How much stress a creep strain takes at rest, Pa, in the mean of its components."""
    rest = rest_state(rates.material, rates.dim)[None]
    response, first = respond(rates.material, rates.dim)(rest), rates.tensors.gradients
    first += rates.creep_space.size * rates.flows.index(flow)
    own = slice(first, first + rates.creep_space.size)
    columns = rates.columns(rest.T)[0]
    _, of_stress = rates.slopes(rest.T, np.zeros((columns.shape[1], 1)), response.slope.T)
    force = of_stress[own, :, 0] + columns[:, own].T @ response.hessian[0]
    return float(np.trace(force @ columns[:, own])) / rates.creep_space.size


def at_nodes(quadrature: Quadrature, size: int) -> GridFunction:
    """A grid function of vectors at the points of ``Quadrature.nodes``."""
    points = IntegrationRuleSpace(quadrature.mesh, order=quadrature.field_order)
    return GridFunction(VectorValued(points, size))


def _array(function: GridFunction) -> np.ndarray:
    """Values of a grid function of points, (components, points)."""
    values = function.vec.FV().NumPy()
    return values.reshape(len(function.components) or 1, -1)
