"""Where bodies are at the start: fractions, from their places; what they do to each other there."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from ngsolve import H1, VOL, CoefficientFunction, Id, Integrate, Mesh, x, y, z

from ngvisco.errors import InputWarning, ParameterError
from ngvisco.forms.mesh.mesh_arrays import vertices
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.bodies import Body
from ngvisco.physics.material import cauchy_stress
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.parameters import substituted
from ngvisco.physics.tensors import tr
from ngvisco.physics.variables import Values
from ngvisco.shapes.fractions import MISSED, fractions, volumes
from ngvisco.shapes.shape import Shape, as_shape

_OVERLAP = 1e-3
"""Of the volume of the smaller of two bodies: less of it in both is what touching surfaces leave."""

_COVERED = 1e-10
"""Of the volume of the domain or of a cell: what is left of it by rounding where all of it is taken."""


def starting_fractions(mesh: Mesh, bodies: Sequence[Body], order: int) -> dict[str, CoefficientFunction]:
    """Volume fractions of the bodies, discontinuous P_order that sum to one, by name.

    Raises ParameterError for bodies of one order that overlap, an empty body, and points that no body covers.
    """
    placed = sorted((body for body in bodies if body.where is not None), key=lambda body: body.order)
    shapes = {body.name: as_shape(f"bodies[{body.name!r}].where", body.where) for body in placed}
    rest = next((body for body in bodies if body.where is None), None)
    _require_order(mesh, placed, shapes)
    *of_placed, of_rest = volumes(mesh, list(shapes.values()))
    total = sum(of_placed) + of_rest
    for i, (body, volume) in enumerate(zip(placed, of_placed, strict=True)):
        if volume <= _COVERED * total:
            above = [other.name for other in placed[i + 1 :] if other.order > body.order]
            is_seen = volumes(mesh, [shapes[body.name]])[0] > _COVERED * total
            hidden = f"a place that {', '.join(above)}, of higher order, does not cover"
            raise ParameterError(f"bodies[{body.name!r}].where", body.where, hidden if is_seen else MISSED)
    if rest is None and of_rest > _OVERLAP * total:
        expected = f"one without a place, for the rest: {of_rest / total:.2%} of the domain is in no body"
        raise ParameterError("Model.bodies", [body.name for body in bodies], expected)
    if rest is not None and of_rest <= _COVERED * total:
        body, _ = max(zip(placed, of_placed, strict=True), key=lambda one: one[1])
        expected = f"a place that leaves something of the domain to {rest.name!r}, the rest"
        raise ParameterError(f"bodies[{body.name!r}].where", body.where, expected)
    found = fractions(mesh, list(shapes.values()), order)
    result: dict[str, CoefficientFunction] = dict(zip(shapes, found, strict=False))
    if rest is not None:
        result[rest.name] = found[-1]
    else:  # what is in no body, less than ``_OVERLAP`` of all, is of all in their shares
        _require_some_body_in_each_cell(mesh, bodies, found[-1])
        known = sum(found[1:-1], found[0])
        result = {name: part / known for name, part in result.items()}
    return {body.name: result[body.name] for body in bodies}


def _require_some_body_in_each_cell(mesh: Mesh, bodies: Sequence[Body], rest: CoefficientFunction) -> None:
    """Raise ParameterError for a cell that is in no body at all: there are no shares to fill it by."""

    def of_cells(f: CoefficientFunction) -> np.ndarray:
        return np.array(Integrate(f, mesh, VOL, element_wise=True))

    size, free = of_cells(CoefficientFunction(1.0)), of_cells(rest)
    moments = [of_cells(coordinate) for coordinate in (x, y, z)[: mesh.dim]]
    with Communicator.of(mesh).together(ParameterError):
        if np.any(empty := free >= (1 - _COVERED) * size):
            first = int(np.argmax(empty))
            place = ", ".join(f"{moment[first] / size[first]:.4g}" for moment in moments)
            expected = f"one without a place, for the rest: a cell at ({place}) is in no body"
            raise ParameterError("Model.bodies", [body.name for body in bodies], expected)


def _require_order(mesh: Mesh, placed: Sequence[Body], shapes: dict[str, Shape]) -> None:
    for i, first in enumerate(placed):
        for second in placed[i + 1 :]:
            if first.order != second.order:
                continue
            a, b = shapes[first.name], shapes[second.name]
            common, size = volumes(mesh, [a & b])[0], min(volumes(mesh, [s])[0] for s in (a, b))
            if common > _OVERLAP * size:
                expected = (
                    f"an order other than {first.order}, that of {first.name!r}: {common / size:.1%} of the "
                    "smaller of the two is in both, and there is the one of higher order"
                )
                raise ParameterError(f"bodies[{second.name!r}].order", second.order, expected)


_PROBE = 1.01
"""Stretch at which an energy shows its stiffness."""
_ROUNDING = 1e-9
"""Of that change of stress: less is rounding of the energies' constants."""
_STIFFER = 10.0
"""Ratio of bulk moduli above which a run is warned: at 20 steps are divided (``demos/collision``); with
overshoots of a quarter the compliance may be negative from 5 on."""
_MEETS = 0.3
"""Fraction of a body at a point of a cell from which on it is there: projections leave less beside it."""


def warn_of_rest_stresses(step: Step, sampler: Sampler) -> None:
    """Say which bodies that meet have different stresses at rest, F = I, and so push each other.

    An energy per actual volume has the stress phi(I) I at rest, on top of what its derivatives give: a
    ``NeoHookean`` body is under tension there, a ``BarotropicFluid`` under pressure.  Alone in its box a body
    does not feel it; a drop of it in another body is pulled together or driven apart from the first step on.
    """
    material, z = step.model.material, step.now.z_tensors
    if not isinstance(material, Mixture) or step.sources is not None:
        return
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


def warn_of_moduli(step: Step, ranks: Communicator) -> None:
    """Say which bodies' bulk moduli are too different for amounts that overshoot (``Mixture.bounds``)."""
    material = step.model.material
    if not isinstance(material, Mixture) or material.has_one_volume or not step.discretisation.m:
        return
    (soft, least), *_, (stiff, most) = sorted(material.stiffnesses.items(), key=lambda one: one[1])
    if most > _STIFFER * least:
        ranks.warn(
            f"bodies {stiff!r} and {soft!r} have bulk moduli of {most:.4g} and {least:.4g} Pa: where "
            f"polynomials of order m = {step.discretisation.m} have less than nothing of {soft!r} there may "
            f"be no common pressure, and steps are divided. Take Discretisation(m=0), or one volumetric "
            f"energy for all where it does not matter",
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
