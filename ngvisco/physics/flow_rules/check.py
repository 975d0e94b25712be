"""Sampling checks of flow rules and viscosities: power, symmetry, monotonicity, potential of the rate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from ngvisco.errors import ParameterError
from ngvisco.physics.arrays import Array
from ngvisco.physics.flow_rules.rule import FlowRule
from ngvisco.physics.material import Material, part_of
from ngvisco.physics.materials.thermal import Thermal, entropy_in
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.parameters import moduli_in
from ngvisco.physics.pointwise import rest_state
from ngvisco.physics.rheology import Viscosity
from ngvisco.physics.tensors import trace_free_tensors
from ngvisco.physics.variables import CONFORMATION, HARDENING, INTERFACE, PRESSURE, TEMPERATURE, Values
from ngvisco.words import call

_SIZES = 10.0 ** np.arange(-9, 13)
"""Sizes |M|, Pa, of the samples; the scale of a rule is not known."""
_ROUNDING = 1e-10
_INVERSE = 1e-3
"""Accepted relative difference between psi'(rate(M)) and M. psi' and rate are both smoothed near zero."""


def values_at_rest(material: Material, parameters: Mapping[str, float] | None = None) -> Values:
    """Values of a material's variables at F = I, as arrays of one point, with the values ``parameters``.

    Pressure and hardening are zero; a material with heat has its reference temperature.
    """
    states, components = material.states(3), rest_state(material, 3)[:, None]
    for name in states.slices.keys() & (parameters or {}).keys():
        components[states.slices[name]] = (parameters or {})[name]
    values = {name: states.tensor(name, Array(components, None)) for name in states.slices}
    values[PRESSURE] = values[HARDENING] = Array(np.zeros(1), None)
    values[INTERFACE] = Array(np.zeros((3, 3, 1)), None)
    values[CONFORMATION] = Array(np.eye(3)[:, :, None], None)
    thermal = part_of(material.bodies[0].material if isinstance(material, Mixture) else material, Thermal)
    if thermal is not None:
        values[TEMPERATURE] = values[PRESSURE].like(float(thermal.theta_R))
    return values


def _readable(name: str, law: FlowRule | Viscosity, material: Material) -> dict[str, Any]:
    """``values_at_rest`` for a law; raises ParameterError if the law reads a temperature that the material
    lacks."""
    z = dict(values_at_rest(material))
    if TEMPERATURE in law.reads and entropy_in(material) is None:
        expected = (
            "a number, a function of the initial place or an expression, since the material has no "
            "temperature; "
        )
        remedy = (call("Thermal", material=...), " gives a material a temperature")
        raise ParameterError(f"{name}.temperature", None, expected, *remedy)
    return z


def check_viscosity(law: Viscosity, material: Material) -> None:
    """Raise ParameterError for a viscosity whose stress has a negative power, or falls with the strain rate.

    The samples are states at rest with eps of 22 sizes in 8 directions, each with an eps a thousandth larger.
    """
    name = type(law).__name__
    z = _readable(name, law, material)
    directions = np.random.default_rng(1).standard_normal((3, 3, 8))
    directions = directions + directions.swapaxes(0, 1)
    directions /= np.sqrt((directions**2).sum(axis=(0, 1)))
    eps = (directions[..., None] * _SIZES).reshape(3, 3, -1)
    sizes = np.tile(_SIZES, 8)
    with np.errstate(all="ignore"):
        with _naming(f"{name}.stress", law):
            unshaped = [law.stress(Array(e, None), z).value for e in (eps, 1.001 * eps)]
            stresses = [np.broadcast_to(stress, eps.shape) for stress in unshaped]
        power, risen = (((stress * eps).sum(axis=(0, 1)) / sizes) for stress in stresses)
        tested, large = np.isfinite(power) & np.isfinite(risen), np.sqrt((stresses[0] ** 2).sum(axis=(0, 1)))
        expected = "a stress with D(eps) : eps/|eps| >= 0"
        _refuse(f"{name}.stress", power < -_ROUNDING * large, tested, power, sizes, expected, "eps")
        falls = risen - power < -_ROUNDING * large
        expected = "a rise >= 0 of the stress along eps from eps to 1.001 eps, as a convex potential requires"
        _refuse(f"{name}.stress", falls, tested, risen - power, sizes, expected, "eps")


def check_rule(rule: FlowRule, material: Material) -> None:
    """Raise ParameterError for a rule that creates energy, or whose rate or potential makes no sense.

    The samples are M of 22 sizes in 8 directions, at rest; samples at which the rule overflows do not count.
    """
    name = type(rule).__name__
    z = _readable(name, rule, material)
    directions = np.random.default_rng(0).standard_normal((8, 5))
    components = directions.T[:, :, None] / np.linalg.norm(directions, axis=1)[None, :, None] * _SIZES
    sizes = np.tile(_SIZES, len(directions))
    if PRESSURE in rule.reads:
        z[PRESSURE] = Array(np.resize([0.0, 1.0, -1.0], sizes.size) * sizes, None)
    M = trace_free_tensors(3).tensor(Array(components.reshape(5, -1), None))
    with np.errstate(all="ignore"):
        with _naming(f"{name}.rate", rule):
            value: Any = rule.rate(M, 0.5 * M if rule.reads_conjugate else None, z).value
        if value.shape[:2] != (3, 3):
            raise ParameterError(f"{name}.rate", f"an array of shape {value.shape[:-1]}", "a 3x3 tensor")
        Pi = np.broadcast_to(value, M.value.shape)
        size = np.sqrt((Pi * Pi).sum(axis=(0, 1)))
        power = (Pi * M.value).sum(axis=(0, 1))
        tested = np.isfinite(power) & np.isfinite(size)
        if not tested.any():
            raise ParameterError(f"{name}.rate", rule, "finite rates for some M between 1e-9 and 1e12 Pa")
        wrong = power < -_ROUNDING * size * sizes
        _refuse(f"{name}.rate", wrong, tested, power, sizes, "a power M : Pi >= 0")
        skew = abs(Pi - Pi.swapaxes(0, 1)).max(axis=(0, 1))
        expected = "0 for the largest entry of Pi - Pi^T"
        _refuse(f"{name}.rate", skew > _ROUNDING * size, tested, skew, sizes, expected)
        if not rule.has_trace:
            trace = abs(np.einsum("iip->p", Pi))
            _refuse(f"{name}.rate", trace > _ROUNDING * size, tested, trace, sizes, "0 for the trace of Pi")
        if rule.is_local:
            return
        force = rule.force(Array(Pi, None), z).value
        force = force - np.eye(3)[:, :, None] * np.einsum("iip->p", force) / 3
        gap = np.sqrt(((force - M.value) ** 2).sum(axis=(0, 1))) / sizes
        tested &= (size > 1e3 * rule.rate_floor) & np.isfinite(gap)
        expected = "0 for the relative difference of psi'(rate(M)) and M"
        _refuse(f"{name}.psi", gap > _INVERSE, tested, gap, sizes, expected)


@contextmanager
def _naming(field: str, law: object) -> Iterator[None]:
    """Context in which any error of a user's function is turned into a ParameterError."""
    try:
        yield
    except Exception as error:
        moduli = [name.rpartition(".")[2] for name, *_ in moduli_in(law)]
        reads = "".join(f", which reads {name} by value_at(self.{name}, z)" for name in moduli)
        expected = (
            f"a function written with ngvisco.physics.tensors{reads}; "
            f"this function raises {type(error).__name__}: {error}"
        )
        raise ParameterError(field, law, expected) from error


def _refuse(
    field: str,
    wrong: np.ndarray,
    tested: np.ndarray,
    value: np.ndarray,
    sizes: np.ndarray,
    expected: str,
    argument: str = "M",
) -> None:
    if (at := np.flatnonzero(wrong & tested)).size:
        unit = "Pa" if argument == "M" else "1/s"
        where = f"{expected}; this value was found at |{argument}| = {sizes[at[0]]:g} {unit}"
        raise ParameterError(field, float(value[at[0]]), where)
