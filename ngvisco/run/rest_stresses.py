"""Bodies whose stresses at rest, F = I, differ push each other where they meet: that is said once.

An energy per actual volume has the stress phi(I) I at rest, on top of what its derivatives give: a
``NeoHookean`` body is under tension there, a ``BarotropicFluid`` under pressure.  Alone in its box a body
does not feel it; a drop of it in another body is pulled together or driven apart from the first step on.
"""

from itertools import combinations

import numpy as np
from ngsolve import H1, CoefficientFunction, Id

from ngvisco.errors import InputWarning
from ngvisco.forms.mesh.mesh_arrays import vertices
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.start.initial import Initial
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.bodies import Body
from ngvisco.physics.material import cauchy_stress
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.parameters import substituted
from ngvisco.physics.tensors import tr
from ngvisco.physics.variables import Values

_PROBE = 1.01
"""Stretch at which an energy shows its stiffness."""
_ROUNDING = 1e-9
"""Of that change of stress: less is rounding of the energies' constants."""
_MEETS = 0.3
"""Fraction of a body at a point of a cell from which on it is there: projections leave less beside it."""


def warn_of_rest_stresses(step: Step, sampler: Sampler, initial: Initial) -> None:
    """Say which bodies that meet have different stresses at rest; nothing where the start is not F = I."""
    material = step.model.material
    if not isinstance(material, Mixture) or step.sources is not None:
        return
    if initial.F is not None or any(v.name in initial.values for v in material.variables if v.is_strain):
        return  # a state of stress of the user's own
    z = step.now.z_tensors
    theta = {name: sampler.values(value) for name, value in material.fractions.at(z).items()}
    at_rest, stiffness, ranks = {}, 0.0, sampler.ranks
    for body in material.bodies:
        there = theta[body.name] >= 0.5 * ranks.most(theta[body.name])
        rest, probed = (sampler.values(_mean_stress(body, z, s))[there] for s in (1.0, _PROBE))
        total, count = ranks.totals(np.array([rest.sum(), len(rest)]))
        at_rest[body.name] = float(total / count)
        stiffness = max(stiffness, ranks.most(np.abs(probed - rest)))
    presence = {name: _at_vertices(step, sampler, values) for name, values in theta.items()}
    for a, b in combinations(at_rest, 2):
        difference = at_rest[a] - at_rest[b]
        if abs(difference) <= _ROUNDING * stiffness or not ranks.any((presence[a] & presence[b]).any()):
            continue
        ranks.warn(
            f"bodies {a!r} and {b!r} meet with different stresses at rest, T(I) = {at_rest[a]:.4g} Pa and "
            f"{at_rest[b]:.4g} Pa (mean normal stress): they move from the first step on until they balance. "
            f"Take energies without stress at rest (ReferentialNeoHookean, OldroydB, ...), subtract the "
            f"constant T(I) from an energy of your own, or start where the stresses agree (Initial.F, or "
            f"Initial.values of J)",
            InputWarning,
            stacklevel=5,
        )


def _mean_stress(body: Body, z: Values, stretch: float) -> CoefficientFunction:
    """tr T/3 of a body at F = stretch I, Pa, with the moduli of the points where it is evaluated."""
    material = substituted(body.material, lambda expression: expression.at(z))
    strained = {
        v.name: v.from_distortion(stretch * Id(3)) if v.is_strain else z[v.name] for v in material.variables
    }
    return tr(cauchy_stress(material, strained)) / 3


def _at_vertices(step: Step, sampler: Sampler, fraction: np.ndarray) -> np.ndarray:
    """Whether a body is in one of the cells, also of other ranks, at a vertex of the mesh, (vertices,)."""
    mesh, cells = step.mesh, vertices(step.mesh)
    found = np.zeros(mesh.nv)
    if len(cells):
        there = fraction.reshape(len(cells), -1).max(axis=1) > _MEETS
        found[cells[there].ravel()] = 1.0
    return Exchange.of(H1(mesh, order=1), Communicator.of(mesh)).sum(found) > 0
