"""Where bodies are at the start: amounts and density, from their places."""

from collections.abc import Sequence

import numpy as np
from ngsolve import VOL, CoefficientFunction, Integrate, Mesh, x, y, z

from ngvisco.errors import ParameterError
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.bodies import Body
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
