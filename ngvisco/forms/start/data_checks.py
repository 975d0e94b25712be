"""Checks of loads, walls and initial data at the points and times at which the forms read them.

Impossible data raise an error.  Data that the model does not use, or that are probably a mistake, give an
``InputWarning``.
"""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from ngsolve import (
    BND,
    CF,
    ET,
    H1,
    VOL,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    Det,
    Grad,
    GridFunction,
    HCurl,
    Integrate,
    IntegrationRule,
    specialcf,
    x,
    y,
    z,
)

from ngvisco.errors import InputWarning, ParameterError, planar
from ngvisco.forms.boundary.wall_terms import Carried
from ngvisco.forms.boundary.walls import OPEN, velocity_of
from ngvisco.forms.given_values import Given
from ngvisco.forms.mesh.mesh_arrays import VERTICES, mask_of, values_on
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.start.fractions_of_bodies import check_incoming_tensors
from ngvisco.forms.start.stresses_at_rest import on_open_walls, where_bodies_meet
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import cell_numbers
from ngvisco.physics.energy_checks import ConvexityWarning, check_convexity
from ngvisco.physics.loads import VectorLike, as_vector, force_of
from ngvisco.physics.material import Material, part_of
from ngvisco.physics.materials import CustomMaterial, IsotropicStrainEnergy, Network
from ngvisco.physics.mixture import AMOUNT, Mixture
from ngvisco.physics.signals import breaking, sampled, time
from ngvisco.physics.tensors import square, tr
from ngvisco.physics.variables import Distortion
from ngvisco.physics.walls import PrescribedNormal, Traction
from ngvisco.words import Mention, Words, call

_FLAT = 1e-12  # largest |a.n|^2/|a|^2 of a tangential vector a; normals of axis-parallel walls are exact
_ROUNDING = 1e-20  # |a|^2 that is rounding, relative to its mean in the domain; sin(pi x) at x = 1 is 1e-16
_MATCH = 1e-8
_DEGREE = 6  # degree of the rule whose points on walls are checked
_STIFFER = 10.0
"""Ratio of bulk moduli above which a run warns.  At a ratio of 20 steps have to be divided
(``demos/collision``). At ratios above 5 an overshoot of a quarter may make the compliance negative."""

_VECTORS = ("velocity", "f", "traction")
_SIGNS = dict.fromkeys((*_VECTORS, "pressure", "heat.flux"), "")
_SIGNS |= {"coefficient": ">= 0", "heat.coefficient": ">= 0", "heat.temperature": "> 0"}
"""Values of wall conditions that are checked, with the sign that they must have; all must be finite."""


def check_loads(step: Step, sampler: Sampler, times: Iterable[float]) -> None:
    """Raise ParameterError for a load or heat source that is not finite at a sampling point and time (s)."""
    given: list[tuple[str, object, CoefficientFunction]] = []
    for body, source in step.model.heat_law.sources:
        owner = "Heat.source" if body is None else f"bodies[{body!r}].heat.source"
        given.append((owner, source, CF(source)))
    for load in step.model.loads:
        name = "g" if load.is_weight else "force"
        field = f"loads[{load.name!r}]" + f".{name}" * (name in vars(load))
        given.append((field, getattr(load, name), force_of(load, step.mesh.dim)))
    times = list(times)
    for field, value, function in given:
        planar(field, function, step.mesh.dim)
        _warn_of_late(step, field, function, times)
        for t in _at(times):
            if not sampler.ranks.all(np.isfinite(sampler.values(function)).all()):
                expected = f"finite values; at t = {t:g} s the value is not finite somewhere"
                raise ParameterError(field, value, expected)


def _warn_of_late(step: Step, field: str, function: CoefficientFunction, times: Sequence[float]) -> None:
    """Warn of a function that changes only after the last of the ``times``, s, and of a table that ends by
    t = 0."""
    (begin, end), breaks = (times[0], times[-1]), list[float]()
    for argument in breaking(function)[0] if end > begin else ():
        a, b, c = (sampled(argument)[0] for _ in _at((begin, (begin + end) / 2, end)))
        if a != c and abs(a - 2 * b + c) < 1e-9 * abs(a - c):  # linear in time
            breaks.append(begin + (end - begin) * a / (a - c))
    if not breaks or len({tuple(sampled(function)) for _ in _at(times)}) > 1:
        return
    if min(breaks) >= end or (max(breaks) <= 0 and "bspline" in str(function)):
        when = f"from {min(breaks):g} s on" if min(breaks) >= end else f"until {max(breaks):g} s"
        remedy = f"the run is from {begin:g} to {end:g} s; give times in the run, unless it goes on later"
        Communicator.of(step.mesh).warn(f"{field} changes only {when}, but {remedy}", InputWarning, 5)


def check_walls(step: Step, times: Iterable[float]) -> None:
    """Check the data of walls at the times (s).

    Raises ParameterError for a value that is not finite, a friction or heat transfer coefficient < 0, a
    temperature <= 0, a prescribed velocity with a normal part, and an inflow whose density, J, ... are not
    positive.
    """
    times = list(times)
    for name, wall in step.walls.conditions.items():
        for key, sign in _SIGNS.items():
            part = wall.heat if key.startswith("heat.") else wall
            value, field = getattr(part, key.removeprefix("heat."), None), f"walls[{name!r}].{key}"
            if value is None:
                continue
            is_vector = key in _VECTORS and not isinstance(wall, PrescribedNormal)
            function = as_vector(value, step.mesh.dim, field) if is_vector else CF(value)
            _warn_of_late(step, field, function, times)
            for t in _at(times):
                _look(step, name, function, field, t, sign, value=value)
                if key == "velocity":
                    step.moving_walls.interpolate(name, velocity_of(wall, step.mesh.dim, f"walls[{name!r}]"))
    for passage in step.passages:
        for t in _at(times):
            _check_incoming(step, passage, t)


def _check_incoming(step: Step, term: Carried, t: float) -> None:
    """Raise ParameterError if an inflow is not finite, or its density, J, ... are not positive."""
    material, owner, given = step.model.material, f"walls[{term.name!r}]", term.given
    positive = {}
    if given.temperature is not None:
        _look(step, term.name, given.temperature, f"{owner}.temperature", t, "> 0", "temperature")
    if given.density is not None:
        positive[f"{owner}.density"] = {"density": given.density}
    for variable in material.variables:
        if variable.name in given.values:
            where, value = f"{owner}.values[{variable.name!r}]", given.values[variable.name]
            _look(step, term.name, value, where, t)
            if not step.model.bodies:  # variables of a body vanish outside of the body
                positive[where] = dict(variable.positive(value))
    if {variable.name for variable in material.variables} <= given.values.keys():
        positive[f"{owner}.values"] = dict(material.domain(given.values))
    amounts = {body.name: AMOUNT + body.name for body in step.model.bodies}
    if amounts and set(amounts.values()) <= given.values.keys():
        positive[f"{owner}.amounts"] = dict(material.positive(given.values)[""])
        for body, name in amounts.items():
            _look(step, term.name, given.values[name], f"{owner}.amounts[{body!r}]", t, ">= 0", "an amount")
    for where, of_field in positive.items():
        for name, function in of_field.items():
            _look(step, term.name, function, where, t, "> 0", name)
    if isinstance(material, Mixture) and step.layout.discretisation.sharp:
        check_incoming_tensors(step, material, term)


def _look(
    step: Step,
    wall: str,
    function: CoefficientFunction,
    field: str,
    t: float,
    sign: str = "",
    name: str = "a function",
    value: object = None,
) -> None:
    """Raise ParameterError unless a function is finite and has the required ``sign`` on a wall at the time
    ``t``."""
    planar(field, function, step.mesh.dim)
    values = values_on(step.walls.region([wall]), function, _DEGREE)
    ranks = Communicator.of(step.mesh)
    if not ranks.all(np.isfinite(values).all()):
        expected = f"finite values; at t = {t:g} s the value is not finite on the wall"
        raise ParameterError(field, function if value is None else value, expected)
    least = ranks.least(values.min(initial=np.inf))
    if sign and (least < 0 or (least == 0 and sign == "> 0")):
        expected = f"{name} {sign}; at t = {t:g} s the value is {least:.3g} somewhere on the wall"
        raise ParameterError(field, f"{name} = {least:.4g}" if value is None else value, expected)


def _at(times: Iterable[float]) -> Iterator[float]:
    """Set the run's time to each of the times in turn; restore it at the end."""
    present = time.Get()
    try:
        for t in times:
            time.Set(t)
            yield t
    finally:
        time.Set(present)


def warn_of_own_energy(step: Step, states: np.ndarray | None) -> None:
    """Warn if a user-defined energy is not convex. The warning says how far from the states, (points, .), the
    energy loses convexity.

    In a network each user-defined branch is checked by itself, and then the sum of all branches.
    """
    material, ranks = step.model.material, Communicator.of(step.mesh)
    network = part_of(material, Network)
    branches = {} if network is None else network.parts
    users = {name: branch.material for name, branch in branches.items() if _is_own(branch.material)}
    if users or _is_own(material):
        near = None if states is None else np.concatenate(ranks.gathered(states))
        ranks.on_first(partial(_warn_of_branches, users, step.mesh.dim))
        ranks.on_first(partial(check_convexity, material, dim=step.mesh.dim, states=near))


def _is_own(material: Material | None) -> bool:
    """Whether a material is user-defined or wraps a user-defined one."""
    return any(part_of(material, kind) is not None for kind in (CustomMaterial, IsotropicStrainEnergy))


def _warn_of_branches(branches: Mapping[str, Material], dim: int) -> None:
    for name, material in branches.items():
        report = check_convexity(material, dim=dim, warn=False)
        if not report.passed:
            text = f": the stored energy of this branch alone is {report}"
            warnings.warn(Words(Mention(f"Network.branches[{name!r}]"), text), ConvexityWarning, stacklevel=2)


def warn_of_doubts(
    step: Step, sampler: Sampler, values: Given, velocity: VectorLike | None, is_at_rest: bool
) -> None:
    """Warn of doubtful start values of variables, by name, and of doubtful velocities, bodies and walls.

    ``is_at_rest`` states that all strains start at rest.
    """
    messages = [*_moduli(step), *_heat_at_walls(step)]
    if step.sources is None:  # manufactured states need not satisfy these conditions
        messages += [*_mismatches(step, sampler, values), *_normal_parts(step, velocity)]
        messages += on_open_walls(step)
        if is_at_rest:
            messages += where_bodies_meet(step)
    for message in messages:
        sampler.ranks.warn(message, InputWarning, stacklevel=5)


def _normal_parts(step: Step, velocity: VectorLike | None) -> Iterator[str]:
    """Yield warnings of unused normal parts of tractions and of the start velocity, at the present time."""
    conditions, dim = step.walls.conditions, step.mesh.dim
    for name, wall in conditions.items():
        share = 0.0
        if isinstance(wall, Traction):
            share, _ = _normal_share(step, name, as_vector(wall.f, dim, "Traction.f"))
        if share > 0:
            yield Words(
                Mention(f"walls[{name!r}].f"),
                f": {share:.0%} of the traction (in L2) is normal to the wall. This part has no power at an "
                "impenetrable wall and is left out; only the tangential part acts",
            )
    if velocity is None:
        return
    v_0 = as_vector(velocity, dim, "Initial.velocity")
    # a function defined in cells, such as one from an array, has no boundary values by itself
    on_wall = BoundaryFromVolumeCF(v_0)
    closed = [name for name in conditions if name not in step.walls.crossed]
    shares = {name: _normal_share(step, name, v_0, on_wall) for name in closed}
    listed = [
        f"{name} ({share:.0%} of the velocity there, {of_inside:.1g} times the mean inside)"
        for name, (share, of_inside) in shares.items()
        if share > 0
    ]
    if listed:
        yield (
            "initial velocity: parts of the velocity (in L2) are normal to the impenetrable walls "
            f"{', '.join(listed)}; the run starts with the projection of the velocity to v.n = 0"
        )


def _normal_share(
    step: Step, name: str, a: CoefficientFunction, on_wall: CoefficientFunction | None = None
) -> tuple[float, float]:
    """Ratios of |a.n| on a wall to |a| on the wall and to |a| in the domain, in root mean squares; 0 within
    the error of the geometry's approximation."""
    b = a if on_wall is None else on_wall
    n = specialcf.normal(step.mesh.dim)
    squares = CF((CF(1.0), b * b, (b * n) * (b * n)))
    area, size, normal_part = Integrate(squares, step.mesh, BND, definedon=step.walls.region([name]))
    volume, inside = Integrate(CF((CF(1.0), a * a)), step.mesh)
    is_flat = any(name in names for names in step.walls.axis)
    is_rounding = normal_part * volume <= _ROUNDING * inside * area
    if is_rounding or normal_part <= (_FLAT if is_flat else OPEN) * size:
        return 0.0, 0.0
    of_inside = normal_part * volume / (inside * area) if inside > 0 else np.inf
    return float(np.sqrt(normal_part / size)), float(np.sqrt(of_inside))


def _heat_at_walls(step: Step) -> Iterator[str]:
    """Yield warnings of walls with inflowing heat that nothing conducts."""
    for name, wall in step.walls.conditions.items():
        heat = wall.heat
        comes_in = heat is not None and (heat.flux is not None or heat.temperature is not None)
        if comes_in and not step.model.heat_law.conducts:
            yield Words(
                Mention(f"walls[{name!r}].heat"),
                ": without a conductivity the incoming heat stays in the cells beside the wall, and the "
                "temperature depends on the size of these cells; give a conductivity, ",
                Mention("Heat.conductivity"),
            )


def _mismatches(step: Step, sampler: Sampler, values: Given) -> Iterator[str]:
    """Yield warnings of start values that contradict the elastic distortion."""
    F = distortion_of(step.model.material, values)
    if F is None:
        return
    # amounts, such as a solute's, are independent of the distortion
    variables = [v for v in step.model.material.variables if v.is_strain and not v.is_conserved]
    distortion = next(v for v in variables if isinstance(v, Distortion))
    for variable in variables:
        expected = variable.from_distortion(F)
        scale = 1 + sampler.extrema(square(expected))[1]
        gap = square(values[variable.name] - expected)
        worst = sampler.extrema(gap)[1]
        if worst > _MATCH**2 * scale:
            place = sampler.largest_in_words(sampler.values(gap), {})
            yield (
                f"initial values: {variable.name} does not follow from {distortion.name} (the difference is "
                f"{worst**0.5:.3g}, {place}); {variable.name} and {distortion.name} are transported "
                "as independent variables, with the given values"
            )


def distortion_of(material: Material, values: Given) -> CoefficientFunction | None:
    """The elastic distortion F, if one of the variables' values, by name, determines it; else None."""
    variable = next((v for v in material.variables if isinstance(v, Distortion)), None)
    if variable is None:
        return None
    H, exponent = values[variable.name], variable.exponent  # H = (det F)^exponent F
    power = 3 * exponent + 1  # det H = (det F)^power
    if exponent == 0:
        return H
    return None if abs(power) < 1e-12 else Det(H) ** (-exponent / power) * H


def _moduli(step: Step) -> Iterator[str]:
    """Yield a warning if the bulk moduli of two bodies differ so much that the bodies may have no common
    pressure where an amount is negative (``Mixture.positive``)."""
    material, m = step.model.material, step.discretisation.m
    if isinstance(material, Mixture) and m and not material.has_one_volume:
        (soft, least), *_, (stiff, most) = sorted(material.stiffnesses.items(), key=lambda item: item[1])
        if most > _STIFFER * least:
            yield Words(
                f"bodies {stiff!r} and {soft!r} have bulk moduli of {most:.4g} and {least:.4g} Pa. Where "
                f"the amount of {soft!r}, a polynomial of order m = {m}, is negative, the bodies may have "
                "no common pressure, so that the run divides steps. Take ",
                call("Discretisation", k=1, m=0),
                "; in the plane these orders need crossed rectangles (structured_box, crossed = true), "
                "since other cells of order one lock. If the difference does not matter, give all bodies "
                "one volumetric energy",
            )


_CORNERS = {et: IntegrationRule(VERTICES[et], [0.0] * len(VERTICES[et])) for et in (ET.TRIG, ET.QUAD, ET.TET)}


def warn_of_corners(step: Step, times: Sequence[float]) -> None:
    """Warn if walls' velocities alone change a volume by more than a factor e between the first and the last
    of ``times``, s; collective.

    If all edges of a cell at a vertex lie on walls that prescribe v, these edges determine the cell's grad v
    at the vertex, for any order of v: no pressure can control div v.  Under a lid of speed U that meets a
    wall at rest, div v = +-U/h at the corner.  v is zero there, so that the matter stays, and J and rho
    change by exp(+-U t/h).  If a cell is divided at its midpoint, every vertex has an edge into the interior,
    and div v is free (``ngvisco.geometries.split_corner_cells``).  All ranks give the same warning.
    """
    cells, ranks = _corner_cells(step), Communicator.of(step.mesh)
    duration = times[-1] - times[0]
    if not ranks.any(bool(cells)) or not duration > 0:
        return
    places, rates = _divergences(step, cells, times)
    number = cell_numbers(step.mesh)
    mine = [
        (int(number[cell]), vertex, tuple(place), of_times)
        for (cell, vertex), place, of_times in zip(cells, places, rates.T, strict=True)
    ]
    # the order is that of one process, since ranks number vertices as in the undistributed mesh
    every = sorted((row for of_rank in ranks.gathered(mine) for row in of_rank), key=lambda row: row[:2])
    rates = np.array([row[3] for row in every]).T
    strains = rates.mean(axis=0) * duration
    worst = int(np.argmax(np.abs(strains)))
    if abs(strains[worst]) > 1:
        at = ", ".join(f"{coordinate:.4g}" for coordinate in every[worst][2])
        rate = rates[np.argmax(np.abs(rates[:, worst])), worst]
        count = f"there are {len(every)} such cells" if len(every) > 1 else "there is one such cell"
        message = (
            f"the velocities of the walls alone determine div v = {rate:.3g} 1/s at ({at}) m, a vertex at "
            "which all edges of a cell lie on walls. No pressure can prevent this change of volume; "
            f"{count}. Mesh with split_corners = true, or divide these cells by "
            "geometries.split_corner_cells(mesh)"
        )
        ranks.warn(message, InputWarning, stacklevel=4)


def _corner_cells(step: Step) -> list[tuple[int, int]]:
    """Pairs of a cell and its vertex on a moving wall whose edges all lie on walls that prescribe v."""
    mesh, conditions = step.mesh, step.walls.conditions
    held = step.walls.held
    moving = [name for name in held if conditions[name].moves]
    if not moving:
        return []
    # all walls' facets at an edge or a vertex may belong to other ranks; these spaces know such facets too
    on_walls = ~mask_of(HCurl(mesh, order=0, dirichlet=step.walls.region(held)).FreeDofs())
    moved = ~mask_of(H1(mesh, order=1, dirichlet=step.walls.region(moving)).FreeDofs())
    pairs = set()
    for vertex in (mesh.vertices[int(number)] for number in np.flatnonzero(moved)):
        around = {edge.nr for edge in vertex.edges}
        for cell in vertex.elements:
            if on_walls[list(around.intersection(edge.nr for edge in mesh[cell].edges))].all():
                pairs.add((cell.nr, vertex.nr))
    return sorted(pairs)


def _divergences(
    step: Step, cells: Sequence[tuple[int, int]], times: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the cells' vertices, (cells, dim), m, and div v at the vertices, (times, cells), 1/s."""
    mesh, walls = step.mesh, step.moving_walls
    points = mesh.MapToAllElements(_CORNERS, VOL)
    points = points[np.isin(points["nr"], [cell for cell, _ in cells])]
    at = np.asarray(CF((x, y, z)[: mesh.dim])(points))
    places = np.array([mesh.vertices[vertex].point for _, vertex in cells])
    numbers = []
    for (cell, _), place in zip(cells, places, strict=True):
        corners = np.flatnonzero(points["nr"] == cell)
        numbers.append(corners[np.argmin(np.linalg.norm(at[corners] - place, axis=1))])
    v, rates = GridFunction(step.layout.blocks["v"]), []
    for _ in _at(times):
        for name, values in walls.velocities().items():
            v.vec.FV().NumPy()[walls.moving[name][1]] = values
        rates.append(np.asarray(tr(Grad(v))(points)).ravel()[numbers])
    return places, np.array(rates)
