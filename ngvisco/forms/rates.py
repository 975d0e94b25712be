"""Rates of the transported variables and their power, as read by the terms of a step.

``Rates`` evaluates the rates with coefficient functions. ``TabulatedRates`` evaluates them with arrays of
values and constant tensors.  A term reads ``u.context.rates`` and works with either class.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, reduce
from operator import add
from typing import Literal, TypeAlias

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.forms.unknown_values import UnknownValues
from ngvisco.physics.arrays import Array, Linear, derivatives
from ngvisco.physics.bodies import AMOUNT, NO_INTERFACE, Interface
from ngvisco.physics.flow_rules.films import Films
from ngvisco.physics.flow_rules.rule import FlowRule
from ngvisco.physics.material import StateSpace, mandel_stress, rate_power
from ngvisco.physics.materials.thermal import temperature
from ngvisco.physics.mixed_viscosity import MixedViscosity
from ngvisco.physics.model import CreepMechanism, Model
from ngvisco.physics.pointwise import ArrayResponse, respond
from ngvisco.physics.rate_tensors import Openings, RateTensors
from ngvisco.physics.response import Respond
from ngvisco.physics.rheology import Viscosity
from ngvisco.physics.tensors import (
    dev,
    embed_gradient,
    identity_like,
    inner,
    linear_map,
    square,
    sym,
    symmetric_tensors,
    trace_free_tensors,
)
from ngvisco.physics.variables import (
    CONFORMATION,
    HARDENING,
    INTERFACE,
    PARTED,
    PRESSURE,
    STEP,
    TEMPERATURE,
    Values,
)

Conjugate: TypeAlias = Literal["z", "zeta"]
"""Factor of a rate: tests of z, or conjugates zeta."""


class Rates:
    """Rates of one model and their products rate(z; L, Pi) : G."""

    def __init__(self, model: Model, dim: int, hoop: bool = False) -> None:
        """With ``hoop``, for a body of revolution, L has an entry 33."""
        self.model, self.material, self.dim, self.hoop = model, model.material, dim, hoop
        self.mechanisms = model.mechanisms
        """The flow rules with the variables that they relax."""
        self.is_local = all(mechanism.rule.is_local for mechanism in self.mechanisms)
        """Whether all flow rules give the rate as a function of the values at the point."""
        self._has_trace = any(mechanism.rule.has_trace for mechanism in self.mechanisms)

    def power(
        self, z: UnknownValues, along: UnknownValues, G: UnknownValues, name: Conjugate
    ) -> Sequence[CoefficientFunction]:
        """Summands of rate(z; grad w, 0) : G; w is the velocity of ``along``, G the part ``name`` of ``G``.

        For a density (``Variable.by_flux``) only the production counts here, because the density's flux
        contains the other part of the rate, -(tr L) z.
        """
        zero, tensors, values = 0 * along.L, _tensors(G, name), self.parted(z)
        parts = []
        for variable in self.material.variables:
            if not variable.is_conserved:
                rate = self.material.rate(variable, values, along.L, zero)
                parts.append(inner(rate, tensors[variable.name]))
        return parts

    @cached_property
    def creep_is_collocated(self) -> bool:
        """Whether creep is integrated by the nodal rule, one point per field coefficient in a cell.

        The nodal rule is used if a local rule is nonlinear, or relaxes F or its cofactor: a field can follow
        the rotation of these at no more points than it has coefficients. If rates are not affine in the
        variables, there is no nodal rule, because constant tensors do not give the stress of such rates.
        """
        turns = {variable.name for variable in self.material.variables if variable.kind == "full"}
        asked = any(f.rule.degree != 1 or turns.intersection(f.names) for f in self.mechanisms)
        return self.is_local and asked and not self.constants.nonlinear_variables

    @cached_property
    def constants(self) -> RateTensors:
        """Constant tensors of the variables' rates, with one Pi for all variables."""
        return RateTensors.of(tuple(self.material.variables), self.dim, self._has_trace, self.hoop)

    def creep_power(
        self, z: UnknownValues, Pi: Sequence[CoefficientFunction], G: UnknownValues, name: Conjugate
    ) -> Sequence[CoefficientFunction]:
        """Summands of rate(z; 0, Pi) : G; each mechanism has one Pi, 3x3. At L = 0 rates have no affine
        part."""
        tensors = _tensors(G, name)
        return [
            inner(self.material.rate(variable, z.z_tensors, 0 * rate, rate), tensors[variable.name])
            for mechanism, rate in zip(self.mechanisms, Pi, strict=True)
            for variable in self.material.variables
            if variable.name in mechanism.names
        ]

    def mandel(self, u: UnknownValues, mechanism: CreepMechanism | None = None) -> CoefficientFunction:
        """Mandel stress of the projected conjugates, 3x3, Pa, of the variables of a mechanism, or of all."""
        return u.once(f"M of {mechanism and mechanism.names}", lambda: self._mandel(u, mechanism))

    def _mandel(self, u: UnknownValues, mechanism: CreepMechanism | None) -> CoefficientFunction:
        names = None if mechanism is None else mechanism.names
        return mandel_stress(self.material, u.z_tensors, u.zeta_tensors, self.dim, names)

    def creep(self, u: UnknownValues) -> list[CoefficientFunction]:
        """Rate Pi of every mechanism, 3x3, 1/s: from a local rule, or the unknown Pi."""
        return [
            self.local_creep(mechanism, u) if mechanism.rule.is_local else u.Pi
            for mechanism in self.mechanisms
        ]

    def mean_creep(self, u: UnknownValues) -> dict[str, CoefficientFunction]:
        """Creep rate Pi, or its mean sum theta_i Pi_i over the bodies, 3x3, 1/s, by the branch's suffix."""
        pairs = zip(self.mechanisms, self.creep(u), strict=True)
        return self._summed(mechanism.share(u.z_tensors) * Pi for mechanism, Pi in pairs)

    def _summed(self, values: Iterable[CoefficientFunction]) -> dict[str, CoefficientFunction]:
        """Sums over the bodies of values of every mechanism, by the branch's suffix."""
        sums: dict[str, CoefficientFunction] = {}
        for mechanism, value in zip(self.mechanisms, values, strict=True):
            total = sums.get(mechanism.suffix)
            sums[mechanism.suffix] = value if total is None else total + value
        return sums

    def local_creep(self, mechanism: CreepMechanism, u: UnknownValues) -> CoefficientFunction:
        """Rate Pi of a mechanism from the values at the point, 3x3, 1/s."""
        return self.creep_by(mechanism, self.driving(mechanism, u), u)

    def creep_by(
        self, mechanism: CreepMechanism, M: CoefficientFunction, u: UnknownValues
    ) -> CoefficientFunction:
        """Rate Pi of a mechanism that the stress M, 3x3, Pa, drives, 3x3, 1/s."""
        zeta = None if mechanism.conformation is None else u.zeta_tensors[mechanism.conformation]
        return mechanism.rule.rate(M, zeta, self.read_values(mechanism.rule, u, mechanism))

    def driving(self, mechanism: CreepMechanism, u: UnknownValues) -> CoefficientFunction:
        """Mandel stress that drives a mechanism, per volume of its body, 3x3, Pa."""
        return self.of_body(mechanism, self.mandel(u, mechanism), u)

    def of_body(
        self, mechanism: CreepMechanism, M: CoefficientFunction, u: UnknownValues
    ) -> CoefficientFunction:
        """The Mandel stress M of a mechanism per volume of its body, 3x3, Pa."""
        return M if mechanism.body is None else (1 / mechanism.share(u.z_tensors)) * M

    def read_values(
        self, law: FlowRule | Viscosity, u: UnknownValues, mechanism: CreepMechanism | None = None
    ) -> Values:
        """Values that a law may read: z, and the quantities in ``law.reads``, such as the pressure. For the
        rule of a ``mechanism`` these may include the growth of the yield stress."""
        tensors = {**u.z_tensors}
        if PRESSURE in law.reads:
            tensors[PRESSURE] = self.pressure(u)
        if isinstance(law, (Films, MixedViscosity)) and law.interface is not None:
            tensors[INTERFACE] = self._normals(law.interface, u)
            tensors[STEP] = u.context.rate(1.0)
        if TEMPERATURE in law.reads:  # from the projected conjugates, K
            tensors[TEMPERATURE] = temperature(self.material, u.zeta_tensors)
        if CONFORMATION in law.reads and mechanism is not None and mechanism.conformation is not None:
            tensors[CONFORMATION] = u.z_tensors[mechanism.conformation]
        if HARDENING in law.reads and mechanism is not None:  # A phi_h'(k), Pa, per volume of the body
            tensors[HARDENING] = (
                mechanism.matter(u.z_tensors) * u.zeta_tensors[mechanism.plastic_content.name]
            )
        return tensors

    def parted(self, u: UnknownValues) -> Values:
        """z; for a material with a law of interfaces also the normals and shares at the step's start."""
        if (law := self.material.at_interfaces) is None:
            return u.z_tensors
        shares = self.material.parted(u.context.old.z_tensors)
        return {**u.z_tensors, INTERFACE: self._normals(law.interface, u), PARTED: shares}

    def _normals(self, interface: Interface, u: UnknownValues) -> CoefficientFunction:
        """Projection n x n, 3x3, on the slope n of the interface's quantity at the step's start.

        The projection tends to zero where the mean changes by less than ``NO_INTERFACE`` in a cell: the slope
        is then rounding, and its direction has no meaning.
        """
        if interface in u.context.recovered_slopes:
            slope = u.context.given(u.context.recovered_slopes[interface])
        else:
            slope = self.slope_of_mean(interface, u.context.old)
        column = linear_map(np.kron(np.eye(3, u.dim), np.eye(3)[:, :1]), slope, (3, 3))
        least = NO_INTERFACE / u.context.h
        return (1 / (square(column) + least * least)) * (column * column.trans)

    def slope_of_mean(self, interface: Interface, old: UnknownValues) -> CoefficientFunction:
        """Slope of the mean of an interface's quantity, in cells, times the amount of matter, 1/m."""
        states, mean, parts = old.layout.states, interface.mean(old.z_tensors), []
        for name, value in interface.values:
            row = np.zeros((1, states.size))
            row[0, states.slices[AMOUNT + name]] = 1.0
            parts.append((value - mean) * linear_map(np.kron(row, np.eye(old.dim)), old.grad_z, (old.dim,)))
        return reduce(add, parts)

    def pressure(self, u: UnknownValues) -> CoefficientFunction:
        """Pressure -tr T/3 from the projected conjugates, Pa."""
        zero = 0 * embed_gradient(u.grad_v, u.dim)
        power = rate_power(self.material, u.z_tensors, u.zeta_tensors, identity_like(zero) + zero, zero)
        return (-1 / 3) * power - self.stored(u)

    def hardening_rate(
        self, mechanism: CreepMechanism, Pi: CoefficientFunction, u: UnknownValues
    ) -> CoefficientFunction:
        """Growth rate of the mechanism's plastic content K at the creep rate Pi, 1/s."""
        return mechanism.amount(u.z_tensors) * mechanism.rule.hardening_rate(Pi)

    def stored(self, u: UnknownValues) -> CoefficientFunction:
        """phi(z), Pa."""
        return u.context.energy.density(u)

    def stored_on_sides(self, u: UnknownValues) -> CoefficientFunction:
        """Energy phi(z), Pa, or its mean over a cell's side, for integrals over sides."""
        return u.context.energy.on_sides(u)

    def stored_near(self, u: UnknownValues) -> CoefficientFunction:
        """Energy phi(z), Pa, in cells, with its derivative by z, even if the stored values belong to one
        state."""
        return u.context.energy.near(u)

    def dissipation(self, u: UnknownValues) -> dict[str, CoefficientFunction]:
        """Power of creep, W/m^3, without the gradient term, summed over bodies, by the branch's suffix."""
        return self._summed(self.powers_of_creep(u))

    def powers_of_creep(self, u: UnknownValues) -> list[CoefficientFunction]:
        """Power of creep of every mechanism, W/m^3."""
        return [
            self.power_of_creep(mechanism, Pi, u)
            for mechanism, Pi in zip(self.mechanisms, self.creep(u), strict=True)
        ]

    def power_of_creep(
        self, mechanism: CreepMechanism, Pi: CoefficientFunction, u: UnknownValues
    ) -> CoefficientFunction:
        """Power of one mechanism with the rate Pi, W/m^3, without the power that hardening stores."""
        if not mechanism.rule.is_local:
            power = inner(mechanism.rule.force(Pi, self.read_values(mechanism.rule, u, mechanism)), Pi)
        elif mechanism.rule.has_trace:
            power = -rate_power(self.material, u.z_tensors, u.zeta_tensors, 0 * Pi, Pi, mechanism.names)
        else:
            power = inner(Pi, self.mandel(u, mechanism))
        if mechanism.rule.hardening is None:
            return power
        return power - u.zeta_tensors[mechanism.plastic_content.name] * self.hardening_rate(mechanism, Pi, u)


def _tensors(G: UnknownValues, name: Conjugate) -> Values:
    return G.z_tensors if name == "z" else G.zeta_tensors


_ROUNDING = 1e-12


class TabulatedRates(Rates):
    """Rates for arrays of values and tests; ``Rates`` is the counterpart for coefficient functions."""

    def __init__(self, model: Model, dim: int, hoop: bool = False) -> None:
        super().__init__(model, dim, hoop)
        self.creep_space = symmetric_tensors(dim) if self._has_trace else trace_free_tensors(dim)
        """Space of the tensors Pi and of their driving forces."""
        self.tensors, variables = self.constants, tuple(model.material.variables)
        creeping = tuple(v.name for v in variables if v.creeps)
        if any(mechanism.names != creeping for mechanism in self.mechanisms):
            names = (mechanism.names for mechanism in self.mechanisms)
            self.tensors = self.tensors.by_groups(tuple(names), StateSpace.of(variables, dim))
        self._states = states = model.material.states(dim)
        flux = np.zeros_like(self.tensors.linear)
        for i in self.tensors.trace:
            flux[i][np.diag_indices(states.size)] = -1.0 * states.by_flux
        production = self.tensors.linear - flux
        production[abs(production) < _ROUNDING] = 0.0
        self.production = replace(self.tensors, linear=production)
        """Rates without the part that the densities' flux contains."""
        shared = model.material.taking_part(states.tensors(lambda: Array(np.ones((states.size, 1)), None)))
        self._shared = {name: states.slices[name] for name in shared}
        self.weighed: RateTensors | None = None
        """Part of the rates that a variable's weight multiplies (``Material.taking_part``)."""
        if shared:
            self.weighed = self.production - self.production.turning()
            self.tensors, self.production = self.tensors - self.weighed, self.production.turning()

    @cached_property
    def response(self) -> Respond:
        """Energies and their first two derivatives for arrays of states."""
        return respond(self.material, self.dim)

    def weights(self, z: np.ndarray) -> np.ndarray:
        """Weights of the components' rates, (n, points)."""
        weights = np.ones(z.shape, z.dtype)
        for name, share in self._shares(Array(z, None)).items():
            weights[self._shared[name]] = share.value
        return weights

    def _shares(self, z: Array) -> Mapping[str, Array]:
        """Weights of rates by names."""
        return self.material.taking_part(self._states.tensors(lambda: z))

    def openings(self, u: UnknownValues) -> Openings | None:
        """The motion at interfaces that bodies do not share, for a material with a law of interfaces."""
        if (law := self.material.at_interfaces) is None:
            return None
        P, units = self._normals(law.interface, u), np.eye(9).reshape(9, 3, 3, 1)
        columns = [law.motion(sym(Array(unit, None)), P).value for unit in units]
        entries = [(i, j) for i in range(self.dim) for j in range(self.dim)]
        rows, of_L = [3 * i + j for i, j in entries], [*(3 * i + j for i, j in entries), *[8] * self.hoop]
        matrix = np.stack(columns, axis=2).reshape(9, 9, -1)[np.ix_(rows, of_L)]
        shares = np.zeros((self._states.size, matrix.shape[-1]))
        for name, share in self.material.parted(u.context.old.z_tensors).items():
            shares[self._states.slices[name]] = share.value
        return Openings(matrix, shares)

    def columns(self, z: np.ndarray, openings: Openings | None = None) -> np.ndarray:
        """Derivative d rate/dX, (points, n, X), including the part in the densities' flux."""
        columns = self.tensors.columns(z)
        if self.weighed is not None:
            shared = self.weighed.columns(z)
            if openings is not None:
                shared = shared - openings.shares.T[:, :, None] * openings.stress(shared.T).T
            columns += self.weights(z).T[:, :, None] * shared
        return columns

    def slopes(
        self, z: np.ndarray, X: np.ndarray, zeta: np.ndarray, openings: Openings | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives d rate/dz, (points, n, n), and d^2(zeta : rate)/dX dz, (points, X, n)."""
        of_rate, of_stress = self.tensors.rate_slope(X), self.tensors.stress_slope(zeta)
        if self.weighed is not None:
            weights = self.weights(z)
            rates, slope = self.weighed.rate_beside(openings, z, X, 0), self.weighed.rate_slope(X)
            if openings is not None:
                opened = self.weighed.rate_slope(openings.motion(X))
                slope -= openings.shares.T[:, :, None] * opened
                slopes = self.weighed.stress_slope(openings.shares * weights * zeta).transpose(1, 2, 0)
                of_stress -= openings.stress(slopes).transpose(2, 0, 1)
            of_rate += weights.T[:, :, None] * slope
            of_stress += self.weighed.stress_slope(weights * zeta)
            for name, share in self._shares(values := Array(z)).items():
                where, of_name = self._shared[name], np.zeros_like(zeta)
                of_name[where] = zeta[where]
                stress = self.weighed.stress_beside(openings, z, of_name, 0, len(X))
                (by_z,) = derivatives(share, [values])
                X_read, read = np.flatnonzero(stress.any(axis=1)), np.flatnonzero(by_z.any(axis=1))
                for m in read:  # one column at a time, as a view: copies would take most of the time
                    of_rate[:, where, m] += (rates[where] * by_z[m]).T
                    of_stress[:, X_read, m] += (stress[X_read] * by_z[m]).T
        return of_rate, of_stress

    def rate(self, z: UnknownValues, X: np.ndarray, first: int = 0) -> np.ndarray:
        """Rates rate(z; X), (n, points), for the X from ``first`` on; for densities the production."""
        rates, values = self.production.rate(z.z.value, X, first), z.z.value
        if self.weighed is not None:
            openings = None if first else self.openings(z)
            rates = rates + self.weights(values) * self.weighed.rate_beside(openings, values, X, first)
        return rates

    def stress(self, z: UnknownValues, zeta: np.ndarray, first: int, stop: int) -> np.ndarray:
        """Derivatives d(zeta : rate)/dX for X = first ... stop - 1, (X, points). If ``first`` is 0, the
        range must contain all entries of L."""
        slopes, values = self.production.stress(z.z.value, zeta, first, stop), z.z.value
        if self.weighed is not None:
            openings, weighed = None if first else self.openings(z), self.weights(values) * zeta
            slopes = slopes + self.weighed.stress_beside(openings, values, weighed, first, stop)
        return slopes

    def power(
        self, z: UnknownValues, along: UnknownValues, G: UnknownValues, name: Conjugate
    ) -> Sequence[Linear]:
        """Products rate(z; grad w, 0) : G, with w or G a test."""
        tests = G.parts[name]
        if isinstance(tests, Linear):
            return [tests.InnerProduct(Array(self.rate(z, self.entries_of_L(along)), None))]
        stress, plane = self.stress(z, tests.value, 0, self.tensors.gradients), self.dim**2
        parts = [along.grad_v.InnerProduct(Array(stress[:plane].reshape(*along.grad_v.shape, -1), None))]
        return parts if along.hoop is None else [*parts, along.hoop * Array(stress[plane], None)]

    def entries_of_L(self, along: UnknownValues) -> np.ndarray:
        """Entries of L, which are the first entries of X = (L, Pi), (gradients, points)."""
        entries = along.grad_v.value.reshape(self.dim**2, -1)
        return entries if along.hoop is None else np.concatenate([entries, along.hoop.value[None]])

    def creep_power(
        self, z: UnknownValues, Pi: Sequence[Array], G: UnknownValues, name: Conjugate
    ) -> Sequence[Linear]:
        """Product rate(z; 0, Pi) : G, with a test G and one Pi per mechanism."""
        rate = self.rate(z, self._components(Pi), self.tensors.gradients)
        return [G.parts[name].InnerProduct(Array(rate, None))]

    def _mandel(self, u: UnknownValues, mechanism: CreepMechanism | None) -> Array:
        """Mandel stress of the projected conjugates, 3x3, Pa, of a mechanism, by default of the first."""
        where = self.components_of(0 if mechanism is None else self.mechanisms.index(mechanism))
        return self.mandel_of(self.stress(u, u.zeta.value, where.start, where.stop))

    def components_of(self, mechanism: int) -> slice:
        """The range of a mechanism's Pi among the X."""
        size, first = self.creep_space.size, self.tensors.gradients
        return slice(first + size * mechanism, first + size * (mechanism + 1))

    def mandel_of(self, stress: np.ndarray) -> Array:
        """Mandel stress, 3x3, from derivatives d(zeta : rate)/dPi by a mechanism's Pi, (p, points)."""
        tensor = -self.creep_space.tensor(Array(stress, None))
        return dev(tensor) if self._has_trace else tensor

    def stored(self, u: UnknownValues) -> Array:
        """phi(z), Pa."""
        return u.once("phi", lambda: self._stored(u))

    def _stored(self, u: UnknownValues) -> Array:
        if isinstance(self.response, ArrayResponse):
            with np.errstate(all="ignore"):  # NaN outside the energy's domain
                return self.material.energy(u.z_tensors)
        z = u.z.value
        response = self.response(np.ascontiguousarray(z.real.T))
        along = 1j * (response.slope.T * z.imag).sum(axis=0) if np.iscomplexobj(z) else 0.0
        return Array(response.energy + along, None)

    stored_near = stored_on_sides = stored

    def creep_components(self, u: UnknownValues) -> np.ndarray:
        """Components of the rates Pi of all local rules, (mechanisms p, points)."""
        return self._components(self.creep(u))

    def _components(self, Pi: Sequence[Array]) -> np.ndarray:
        return np.concatenate([self.creep_space.components(rate).value for rate in Pi])
