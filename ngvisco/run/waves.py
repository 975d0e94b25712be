"""Waves of small amplitude about a state, and the stress that a material has at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.forms.system import Step
from ngvisco.physics.material import Material, cauchy_stress
from ngvisco.physics.pointwise import evaluated, rest_state, squares
from ngvisco.physics.tensors import constant

_STEP = 1e-5
"""Strain of the finite differences that give moduli."""


def moduli(
    material: Material, dim: int, parameters: Mapping[str, float] | None = None
) -> tuple[float, float]:
    """Moduli of longitudinal and of shear waves, dT_11/dF_11 and dT_12/dF_12 at F = I, Pa.

    Carried parameters take values from ``parameters``, by default typical values.
    """
    state = _rest(material, dim, parameters or {})
    longitudinal, shear = (acoustic_tensor(material, state, dim, j)[0, 0] for j in (0, 1))
    return float(longitudinal), float(shear)


def _rest(material: Material, dim: int, parameters: Mapping[str, float]) -> np.ndarray:
    state, slices = rest_state(material, dim), material.states(dim).slices
    for name in slices.keys() & parameters.keys():
        state[slices[name]] = parameters[name]
    return state


def stress_of(material: Material, state: np.ndarray, dim: int) -> np.ndarray:
    """The Cauchy stress, 3x3, Pa, at a state, whose components are (n,)."""
    # each variable is a constant of its own, so that a derivative by one variable leaves the others fixed
    at, state = squares(1)[1], state.reshape(1, -1)
    z = material.states(dim).tensors(lambda: CF(tuple(float(c) for c in state[0])))
    respond, phi, zeta = material.response(dim), None, None
    if respond is not None:
        answer = respond(state)
        phi = CF(float(answer.energy[0]))
        zeta = material.states(dim).tensors(lambda: CF(tuple(float(c) for c in answer.slope[0])))
    return np.asarray(cauchy_stress(material, z, zeta, phi)(at)).reshape(3, 3)


def acoustic_tensor(material: Material, state: np.ndarray, dim: int, j: int) -> np.ndarray:
    """Acoustic tensor Q, Pa, of plane waves along e_j about a state: Q a = (dT/dz : rate(a x e_j; z)) e_j.

    ``state`` has the components of the material's variables, (n,).
    """
    states, zero, Q = material.states(dim), constant(np.zeros((3, 3))), np.empty((dim, dim))
    for i in range(dim):
        unit = np.zeros((3, 3))
        unit[i, j] = 1.0
        a_n = constant(unit)

        def rates(c: CoefficientFunction, L: CoefficientFunction = a_n) -> CoefficientFunction:
            z = states.tensors(lambda: c)
            return states.components({v.name: v.rate(z, L, zero) for v in material.variables})

        change = _STEP * evaluated(rates, state[None])[0]
        ends = [stress_of(material, state + sign * change, dim)[:dim, j] for sign in (1, -1)]
        Q[:, i] = (ends[0] - ends[1]) / (2 * _STEP)
    return Q


def wave_speed(step: Step, state: np.ndarray, density: float) -> float:
    """Speed of the fastest plane wave of small amplitude about a state along an axis, m/s; 0 without waves.

    ``state`` holds the components of the material's variables, (n,); ``density`` is in kg/m^3.
    """
    dim, fastest = step.mesh.dim, 0.0
    for j in range(dim):
        Q = acoustic_tensor(step.model.material, state, dim, j)
        if np.isfinite(Q).all():
            fastest = max(fastest, float(np.linalg.eigvals(Q).real.max()))
    return math.sqrt(fastest / density)


def rest_pressure(material: Material, dim: int) -> float:
    """The pressure -tr T/3 of the material at F = I, Pa."""
    return -float(np.trace(stress_of(material, _rest(material, dim, {}), dim))) / 3
