"""The size of rounding in the energy ledger of a step; a closure below this size is no error."""

from __future__ import annotations

import numpy as np
from ngsolve import sqrt

from ngvisco.forms.entry_integrals import EntryIntegrals
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.forms.term import Entry
from ngvisco.physics.materials.thermal import entropy_in

_STRETCH, _OPERATIONS = 1e-4, 30
"""Relative change of the variables in the second difference that estimates the size of an energy density's
terms; and the rounding of the density, as a multiple of the machine epsilon times this size."""


def rounding(step: Step, sampler: Sampler, tau: float) -> float:
    """The size of rounding in the energy balance of a step of length tau, s, at the present state, J.

    An energy that is zero at rest, such as tr B - ln det B - 3, is a difference of larger terms.  The terms'
    size is int |phi''(z)[z, z]|; the size of the heat above theta_R is int c theta.  The heat that a wall
    exchanges by a large coefficient is a small difference of two temperatures; a change of the entropy in its
    last digit changes this heat by eps tau int coefficient theta.
    """
    z = step.now.z_tensors
    factors = (1 - _STRETCH, 1.0, 1 + _STRETCH)
    stretched = ({name: factor * value for name, value in z.items()} for factor in factors)
    less, here, more = (step.energy.samples(state, sampler) for state in stretched)
    terms = sampler.integral(np.nan_to_num(abs(less - 2 * here + more), posinf=0.0) / _STRETCH**2)
    differences = {entry.name: entry.difference_of for entry in step.entries()}
    larger = {name: Entry(name, "power", size) for name, size in differences.items() if size is not None}
    exchanged = sum(map(abs, EntryIntegrals(step.quadrature, larger)().values()))
    return _OPERATIONS * float(np.finfo(float).eps) * (terms + heat(step, 1.0) + tau * exchanged)


def heat(step: Step, s: float | None = None) -> float:
    """int theta |s|, the size of the heat above the reference temperature, J; 0 without heat.

    The heat of warm places and the heat of cold places cancel in the energy, while errors of an iteration do
    not cancel. ``s`` is a constant entropy, by default the present field.
    """
    entropy = entropy_in(step.model.material)
    if entropy is None:
        return 0.0
    density = step.now.zeta_tensors[entropy.name] * (step.now.z_tensors[entropy.name] if s is None else s)
    return float(step.quadrature.integrate_cells(sqrt(density * density)))
