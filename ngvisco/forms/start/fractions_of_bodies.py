"""Fractions of bodies at the start, from their places."""

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import add

import numpy as np
from ngsolve import CF, VOL, CoefficientFunction, Det, ElementId, Integrate, Mesh

from ngvisco.errors import InitialDataError, ParameterError
from ngvisco.forms.boundary.wall_terms import Carried
from ngvisco.forms.given_values import Given, StartValues, as_shape
from ngvisco.forms.mesh.mesh_arrays import values_on
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.bodies import AMOUNT, TRACE, Body
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import square
from ngvisco.shapes.fractions import MISSED, fractions, volumes
from ngvisco.shapes.shape import Shape
from ngvisco.shapes.shape import as_shape as as_place

_OVERLAP = 1e-3
"""Largest overlap of two bodies that only touch, relative to the volume of the smaller body."""
_COVERED = 1e-10
"""Share of the volume of the domain, or of a cell, below which uncovered volume is rounding."""
_OFF = 1e-4
"""Largest admitted difference of a given tensor's determinant from its right value, relative to the largest
right value."""
_DEGREE = 6
"""Degree of the rule whose points on walls are checked."""


def starting_fractions(mesh: Mesh, bodies: Sequence[Body], order: int) -> StartValues:
    """Volume fractions of the bodies by name, in discontinuous P_order with the sum one, from their places.

    Raises ParameterError for bodies of one order that overlap, an empty body, and points that no body covers.
    """
    names = [body.name for body in bodies]
    placed = sorted((body for body in bodies if body.where is not None), key=lambda body: body.order)
    shapes = {body.name: as_place(f"bodies[{body.name!r}].where", body.where) for body in placed}
    filler = next((body for body in bodies if body.where is None), None)
    _require_order(mesh, placed, shapes)
    *of_placed, of_rest = volumes(mesh, list(shapes.values()))
    total = sum(of_placed) + of_rest
    for i, (body, volume) in enumerate(zip(placed, of_placed, strict=True)):
        if volume <= _COVERED * total:
            above = [later.name for later in placed[i + 1 :] if later.order > body.order]
            is_seen = volumes(mesh, [shapes[body.name]])[0] > _COVERED * total
            hidden = f"a place that bodies of higher order ({', '.join(above)}) do not cover"
            raise ParameterError(f"bodies[{body.name!r}].where", body.where, hidden if is_seen else MISSED)
    if filler is None and of_rest > _OVERLAP * total:
        expected = (
            f"one body without a place, for the rest, since {of_rest / total:.2%} of the domain is in no body"
        )
        raise ParameterError("Model.bodies", names, expected)
    if filler is not None and of_rest <= _COVERED * total:
        body, _ = max(zip(placed, of_placed, strict=True), key=lambda pair: pair[1])
        expected = (
            f"a smaller place, since this place leaves no part of the domain to {filler.name!r}, "
            "the body without a place"
        )
        raise ParameterError(f"bodies[{body.name!r}].where", body.where, expected)
    *fractions_of, of_none = fractions(mesh, list(shapes.values()), order)
    result: StartValues = dict(zip(shapes, fractions_of, strict=True))
    if filler is not None:
        result[filler.name] = of_none
    else:  # distribute uncovered volume, below ``_OVERLAP``, by the fractions
        _require_some_body_in_each_cell(mesh, names, of_none)
        covered = reduce(add, fractions_of)
        result = {name: part / covered for name, part in result.items()}
    return {name: result[name] for name in names}


def values_of_bodies(
    step: Step, material: Mixture, shares: StartValues, distortions: Given, given: Given, sampler: Sampler
) -> StartValues:
    """Amounts and tensors of bodies that follow from ``distortions``; those in ``given`` are left out.

    Raises InitialDataError for a given tensor in cells without its body. With sharp interfaces it is raised
    also for a given tensor whose determinant does not follow from the distortion.
    """
    filled = material.filled(shares, distortions)
    of_cells, bodies = step.quadrature.each_cell, {X.name: n for n in shares for X in material.contents(n)}
    for name in bodies.keys() & given.keys():
        field = f"Initial.values[{name!r}]"
        tensor = as_shape(field, given[name], (3, 3))
        sizes = of_cells(square(tensor))
        absent = of_cells(shares[bodies[name]]) <= TRACE * of_cells(CF(1.0))
        if sampler.ranks.most(absent * sizes) > TRACE * sampler.ranks.most(sizes):
            expected = "the body's tensor times the body's amount, which is 0 without the body"
            value = f"the value is not 0 in cells without the body {bodies[name]!r}"
            raise InitialDataError(f"{name}_0", value, expected, field)
        if step.layout.discretisation.sharp:
            determinant = Det(filled[name])
            off, sizes = of_cells(square(Det(tensor) - determinant)), of_cells(square(determinant))
            if sampler.ranks.most(off) > _OFF**2 * sampler.ranks.most(sizes):
                expected = "a tensor with the determinant that follows from F, which sharp interfaces restore"
                raise InitialDataError(f"{name}_0", "the value has another determinant", expected, field)
    return {name: value for name, value in filled.items() if name not in given}


def check_incoming_tensors(step: Step, material: Mixture, term: Carried) -> None:
    """Raise ParameterError for a body's incoming tensor, if sharp interfaces would change its determinant."""
    given, ranks, wall = term.given.values, Communicator.of(step.mesh), step.walls.region([term.name])
    tensors = [(body, X) for body in material.energies for X in material.contents(body)]
    for body, X in tensors:
        if X.name not in given or X.power is None:
            continue
        field, value, n = f"walls[{term.name!r}].values[{X.name!r}]", given[X.name], AMOUNT + body
        if n not in given:
            expected = (
                " without amounts, since sharp interfaces restore the determinant that follows from them"
            )
            raise ParameterError(field, value, None, expected)
        right = given[n] ** 3 * reduce(add, material.amounts(given).values()) ** -X.power
        squares = square(Det(value) - right), square(right)
        off, size = (ranks.most(values_on(wall, of, _DEGREE).max(initial=0.0)) for of in squares)
        if off > _OFF**2 * size:
            expected = (
                "a tensor with the determinant that follows from the amounts, which sharp interfaces restore"
            )
            raise ParameterError(field, value, expected)


def _require_some_body_in_each_cell(mesh: Mesh, names: Sequence[str], remainder: CoefficientFunction) -> None:
    """Raise ParameterError for a cell without a body, which no fractions can fill."""
    size, covered = (np.array(Integrate(f, mesh, VOL, element_wise=True)) for f in (CF(1.0), 1 - remainder))
    with Communicator.of(mesh).together(ParameterError):
        if np.any(empty := covered <= _COVERED * size):
            corners = mesh[ElementId(VOL, int(np.argmax(empty)))].vertices
            middle = np.mean([mesh[vertex].point for vertex in corners], axis=0)
            place = ", ".join(f"{c:.4g}" for c in middle)
            expected = f"one body without a place, for the rest, since a cell at ({place}) is in no body"
            raise ParameterError("Model.bodies", list(names), expected)


def _require_order(mesh: Mesh, placed: Sequence[Body], shapes: Mapping[str, Shape]) -> None:
    """Raise ParameterError if two bodies of the same order overlap."""
    for i, first in enumerate(placed):
        for second in (later for later in placed[i + 1 :] if later.order == first.order):
            a, b = shapes[first.name], shapes[second.name]
            common, size = volumes(mesh, [a & b])[0], min(volumes(mesh, [s])[0] for s in (a, b))
            if common > _OVERLAP * size:
                expected = (
                    f"an order other than {first.order}, the order of {first.name!r}, since "
                    f"{common / size:.1%} of the smaller body is in both bodies; this part then belongs to "
                    "the body of higher order"
                )
                raise ParameterError(f"bodies[{second.name!r}].order", second.order, expected)
