"""The fields of a run under their names, for output, plots and users."""

from __future__ import annotations

from ngsolve import CoefficientFunction, sqrt

from ngvisco.forms.system import Step
from ngvisco.physics.material import cauchy_stress
from ngvisco.physics.tensors import dev, square, tr


def output_fields(step: Step) -> dict[str, CoefficientFunction]:
    """Velocity, density, variables, Cauchy stress, pressure and von Mises stress at the new state."""
    u, material = step.now, step.model.material
    T = cauchy_stress(material, u.z_tensors, u.zeta_tensors)
    return {
        "velocity": u.v,
        "density": u.rho,
        **u.z_tensors,
        "cauchy_stress": T,
        "pressure": (-1 / 3) * tr(T),
        "von_mises": sqrt(1.5 * square(dev(T))),
    }
