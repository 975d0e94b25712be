"""Where bodies are at the start: fractions, from their places; what they do to each other there."""

from collections.abc import Sequence

import numpy as np
from ngsolve import VOL, CoefficientFunction, ElementId, Integrate, Mesh

from ngvisco.errors import InputWarning, ParameterError
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.bodies import Body
from ngvisco.physics.material import rest_stress_and_modulus
from ngvisco.physics.mixture import Mixture
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

    one = CoefficientFunction(1.0)
    size, covered = (np.array(Integrate(f, mesh, VOL, element_wise=True)) for f in (one, 1 - rest))
    with Communicator.of(mesh).together(ParameterError):
        if np.any(empty := covered <= _COVERED * size):
            corners = mesh[ElementId(VOL, int(np.argmax(empty)))].vertices
            middle = np.mean([mesh[vertex].point for vertex in corners], axis=0)
            place = ", ".join(f"{c:.4g}" for c in middle)
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


_ROUNDING = 1e-9
"""Of the stiffness: less of a stress is rounding of the energies' constants."""
_STIFFER = 10.0
"""Ratio of bulk moduli above which a run is warned: at 20 steps are divided (``demos/collision``); with
overshoots of a quarter the compliance may be negative from 5 on."""


def warn_of_rest_stresses(step: Step, ranks: Communicator) -> None:
    """Say where bodies have different stresses at rest, F = I, and so push each other.

    An energy per actual volume has the stress phi(I) I at rest, on top of what its derivatives give: a
    ``NeoHookean`` body is under tension there, a ``BarotropicFluid`` under pressure.  Alone in its box a body
    does not feel it; a drop of it in another body is pulled together or driven apart from the first step on.
    Of bodies that fill a domain some two with different stresses meet where not all have one.
    """
    if step.sources is not None or not step.model.bodies:
        return
    found = {body.name: rest_stress_and_modulus(body.material) for body in step.model.bodies}
    stresses, stiffnesses = zip(*found.values(), strict=True)
    if max(stresses) - min(stresses) > _ROUNDING * max(abs(K) for K in stiffnesses):
        names = ", ".join(repr(name) for name in found)
        values = ", ".join(f"{stress:.4g} Pa" for stress in stresses)
        ranks.warn(
            f"bodies {names} meet with different stresses at rest, T(I) = {values} (mean normal stress): "
            f"they move from the first step on until they balance. Take energies without stress at rest "
            f"(ReferentialNeoHookean, OldroydB, ...), subtract the constant T(I) from an energy of your own, "
            f"or start where the stresses agree (Initial.F, or Initial.values of J)",
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
