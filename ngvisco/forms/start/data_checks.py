"""What loads, walls and initial data must be, looked at where the forms look: at points and at times.

What cannot be right is refused.  What the model has no place for, a normal part of a traction or a start
velocity through a wall, is left out by the projections, and that is said by an ``InputWarning``.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import partial

import numpy as np
from ngsolve import (
    BND,
    CF,
    ET,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    Det,
    Integrate,
    IntegrationRule,
    specialcf,
)

from ngvisco.errors import InputWarning, ParameterError
from ngvisco.forms.boundary.moving_walls import OPEN
from ngvisco.forms.boundary.passages import Carried, GivenStress
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.energy_checks import check_convexity
from ngvisco.physics.loads import BodyForce, CentralGravity, VectorLike, as_vector, force_of
from ngvisco.physics.material import Material
from ngvisco.physics.materials import (
    CustomMaterial,
    Damaged,
    IsotropicStrainEnergy,
    Thermal,
    WithQuadratic,
    Yosida,
)
from ngvisco.physics.materials.wrapped import Carrying
from ngvisco.physics.mixture import AMOUNT
from ngvisco.physics.signals import time
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion
from ngvisco.physics.walls import MOVING, NavierFriction, Traction

_FLAT = 1e-12  # |a.n|^2/|a|^2 on walls parallel to the axes, whose normals are exact
_ROUNDING = 1e-20  # of the mean of |a|^2 in the domain: sin(pi x) at x = 1 is 1e-16
_MATCH = 1e-8
_DEGREE = 6  # of the rule whose points are looked at on walls


def check_loads(step: Step, sampler: Sampler, times: Iterable[float]) -> None:
    """Raise ParameterError for a load or source of heat not finite at a sampling point at a time (s)."""
    dim, times = step.mesh.dim, list(times)
    for body, source in step.model.heat_law.sources:
        owner = "Heat.source" if body is None else f"bodies[{body!r}].heat.source"
        for t in _at(times):
            if not sampler.ranks.all(np.isfinite(sampler.values(CF(source))).all()):
                expected = f"finite values; at t = {t:g} s it is not finite somewhere"
                raise ParameterError(owner, source, expected)
    for load in step.model.loads:
        name, value = ("force", load.force) if isinstance(load, BodyForce) else ("g", load.g)
        vector = force_of(load, dim)
        for t in _at(times):
            if not sampler.ranks.all(np.isfinite(sampler.values(vector)).all()):
                expected = f"finite values; at t = {t:g} s it is not finite somewhere"
                if isinstance(load, CentralGravity):
                    expected = f"centre, strength, radius and exponent that give {expected}"
                    raise ParameterError(f"loads[{load.name!r}]", load, expected)
                raise ParameterError(f"loads[{load.name!r}].{name}", value, expected)


def check_walls(step: Step, times: Iterable[float]) -> None:
    """Look at the data of walls at the times (s).

    Raises ParameterError for what is not finite, for a friction, a heat transfer coefficient or a
    temperature (0 too) that is negative somewhere, for a prescribed velocity with a normal part, and for
    what flows in where density, J, ... are not positive.
    """
    dim, times = step.mesh.dim, list(times)
    for name, wall in step.walls.conditions.items():
        owner, given = f"walls[{name!r}]", {}
        if isinstance(wall, MOVING):
            given["velocity"] = (wall.velocity, as_vector(wall.velocity, dim, f"{owner}.velocity"), "")
        if isinstance(wall, Traction):
            given["f"] = (wall.f, as_vector(wall.f, dim, f"{owner}.f"), "")
        if isinstance(wall, NavierFriction):
            given["coefficient"] = (wall.coefficient, wall.coefficient, ">= 0")
        if wall.heat is not None:
            ranges = {"temperature": "> 0", "coefficient": ">= 0", "flux": ""}
            of_heat = {key: getattr(wall.heat, key) for key in ranges}
            given |= {f"heat.{key}": (value, value, ranges[key]) for key, value in of_heat.items()}
        for key, (value, function, sign) in given.items():
            for t in _at(times if isinstance(function, CoefficientFunction) else ()):
                values = _require_finite(step, name, function, f"{owner}.{key}", value, t)
                if key == "velocity":
                    step.moving_walls.interpolate(name, function)
                least = Communicator.of(step.mesh).least(values.min(initial=np.inf))
                if sign and (least < 0 or (least == 0 and sign == "> 0")):
                    expected = f"a function {sign}; at t = {t:g} s it is {least:.3g} somewhere on the wall"
                    raise ParameterError(f"{owner}.{key}", value, expected)
    for term in step.terms:
        if isinstance(term, GivenStress):
            for field, stress in (("pressure", term.pressure), ("traction", term.f)):
                for t in _at(times if stress is not None else []):
                    _require_finite(step, term.name, stress, f"walls[{term.name!r}].{field}", stress, t)
        if isinstance(term, Carried):
            for t in _at(times):
                _check_incoming(step, term, t)


def _check_incoming(step: Step, term: Carried, t: float) -> None:
    """Raise ParameterError where what flows in is not finite, or its density, J, ... not positive."""
    owner, ranks = f"walls[{term.name!r}]", Communicator.of(step.mesh)
    z = step.layout.states.tensors(lambda: term.values["z"])
    if term.temperature is not None:  # before the entropy, which has its logarithm
        where = f"{owner}.temperature"
        _require_positive(step, term.name, "temperature", term.temperature, where, t)
    positive = {f"{owner}.density": {"density": term.values["rho"]}}
    for variable in step.model.material.variables:
        where = f"{owner}.values[{variable.name!r}]"
        _require_finite(step, term.name, z[variable.name], where, z[variable.name], t)
        if not step.model.bodies:  # whose variables vanish where they are not
            positive[where] = dict(variable.positive(z[variable.name]))
    if step.model.bodies:
        positive[f"{owner}.amounts"] = dict(step.model.material.bounds(z)[""])
        for body in step.model.bodies:
            where, n = f"{owner}.amounts[{body.name!r}]", z[AMOUNT + body.name]
            least = ranks.least(_require_finite(step, term.name, n, where, n, t).min(initial=np.inf))
            if least < 0:
                raise ParameterError(where, f"{least:.4g} at t = {t:g} s", ">= 0 everywhere on the wall")
    for where, of_field in positive.items():
        for name, function in of_field.items():
            _require_positive(step, term.name, name, function, where, t)


def _require_positive(
    step: Step, wall: str, name: str, function: CoefficientFunction, where: str, t: float
) -> None:
    values = _require_finite(step, wall, function, where, function, t)
    if (least := Communicator.of(step.mesh).least(values.min(initial=np.inf))) <= 0:
        found = f"{name} = {least:.4g} somewhere on the wall at t = {t:g} s"
        raise ParameterError(where, found, f"{name} > 0 of what flows in")


def warn_of_own_energy(step: Step, states: np.ndarray | None) -> None:
    """Warn where a user's own energy is not convex, and how far from these states, (points, .), that is."""
    material, ranks = step.model.material, Communicator.of(step.mesh)
    held: Material | None = material
    while isinstance(held, (WithQuadratic, Yosida, Carrying, Damaged, Thermal)):
        held = held.material
    if isinstance(held, (CustomMaterial, IsotropicStrainEnergy)):
        near = None if states is None else np.concatenate(ranks.gathered(states))
        ranks.on_first(partial(check_convexity, material, dim=step.mesh.dim, states=near))


def warn_of_normal_parts(step: Step, velocity: VectorLike | None) -> None:
    """Say which parts of tractions and of the start velocity are not used; at the present time."""
    if step.sources is not None:  # manufactured states need not fit
        return
    conditions = step.walls.conditions
    for name, wall in conditions.items():
        if isinstance(wall, Traction):
            share = _normal_share(step, name, as_vector(wall.f, step.mesh.dim, "Traction.f"))
            if share > 0:
                _warn(
                    step,
                    f"walls[{name!r}].f: {share:.0%} of the traction (in L2) is normal to the wall; walls "
                    "are impenetrable: this part has no power and is left out, only the tangential part acts",
                )
    if velocity is None:
        return
    v_0 = as_vector(velocity, step.mesh.dim, "Initial.velocity")
    # a function of the cells, such as one from an array, has no values on the boundary of its own
    closed = [name for name in conditions if name not in step.walls.crossed]
    shares = {name: _normal_share(step, name, v_0, BoundaryFromVolumeCF(v_0)) for name in closed}
    through = ", ".join(f"{name} ({share:.0%})" for name, share in shares.items() if share > 0)
    if through:
        _warn(
            step,
            f"initial velocity: parts of it (in L2) are normal to the walls {through}; walls are "
            "impenetrable: the run starts with its projection to v.n = 0",
        )


def warn_of_heat_at_walls(step: Step) -> None:
    """Say at which walls heat comes in that nothing conducts."""
    heats = {name: wall.heat for name, wall in step.walls.conditions.items() if wall.heat is not None}
    for name, heat in heats.items():
        comes_in = heat.flux is not None or heat.temperature is not None
        if comes_in and not step.model.heat_law.conducts:
            _warn(
                step,
                f"walls[{name!r}].heat: nothing conducts what comes in: it heats the cells beside the wall, "
                "the more the smaller they are; give a conductivity, Heat.conductivity",
            )


def _warn(step: Step, message: str) -> None:
    Communicator.of(step.mesh).warn(message, InputWarning, stacklevel=6)


def warn_of_mismatch(step: Step, sampler: Sampler, values: Mapping[str, CoefficientFunction]) -> None:
    """Say that start values of the variables, by name, are not those of one elastic distortion."""
    variables = step.model.material.variables
    F = distortion_of(step.model.material, values)
    if F is None or step.sources is not None:  # manufactured states need not fit
        return
    distortion = next(v for v in variables if isinstance(v, Distortion))
    for variable in variables:
        if not variable.is_strain:  # parameters and amounts: no distortion tells them
            continue
        expected = variable.from_distortion(F)
        scale = 1 + sampler.extrema(square(expected))[1]
        gap = square(values[variable.name] - expected)
        worst = sampler.extrema(gap)[1]
        if worst > _MATCH**2 * scale:
            place = ", ".join(f"{c:.4g}" for c in sampler.place_of_largest(gap))
            _warn(
                step,
                f"initial values: {variable.name} is not that of {distortion.name} (they differ by up to "
                f"{worst**0.5:.3g}, at ({place}) m); both are transported as they are given, as "
                "variables of their own",
            )


def distortion_of(
    material: Material, values: Mapping[str, CoefficientFunction]
) -> CoefficientFunction | None:
    """F of the variables' values, by name, where one of them tells it; None otherwise."""
    variable = next((v for v in material.variables if isinstance(v, Distortion)), None)
    if variable is None:
        return None
    H, exponent = values[variable.name], variable.exponent  # H = (det F)^exponent F
    power = 3 * exponent + 1  # det H = (det F)^power
    if exponent == 0:
        return H
    return None if abs(power) < 1e-12 else Det(H) ** (-exponent / power) * H


def _normal_share(
    step: Step, name: str, a: CoefficientFunction, on_wall: CoefficientFunction | None = None
) -> float:
    """|a.n| over |a| in L2 on a wall; 0 where it is not more than the geometry's approximation leaves."""
    b = a if on_wall is None else on_wall
    flat = any(name in names for names in step.walls.axis)
    n = specialcf.normal(step.mesh.dim)
    region = step.walls.region([name])
    squares = CF((CF(1.0), b * b, (b * n) * (b * n)))
    area, size, through = Integrate(squares, step.mesh, BND, definedon=region)
    volume, inside = Integrate(CF((CF(1.0), a * a)), step.mesh)
    is_rounding = through * volume <= _ROUNDING * inside * area
    if is_rounding or through <= (_FLAT if flat else OPEN) * size:
        return 0.0
    return float(np.sqrt(through / size))


def _require_finite(
    step: Step, name: str, f: CoefficientFunction, field: str, value: object, t: float
) -> np.ndarray:
    """Values at points of a wall; raises ParameterError unless all are finite."""
    facets = (ET.SEGM,) if step.mesh.dim == 2 else (ET.TRIG, ET.QUAD)
    rules = {et: IntegrationRule(et, _DEGREE) for et in facets}
    values = np.asarray(f(step.mesh.MapToAllElements(rules, step.walls.region([name]))))
    if not Communicator.of(step.mesh).all(np.isfinite(values).all()):
        raise ParameterError(field, value, f"finite values; at t = {t:g} s it is not finite on the wall")
    return values


def _at(times: Iterable[float]) -> Iterator[float]:
    """Set the run's time to each of the times, and back in the end."""
    present = time.Get()
    try:
        for t in times:
            time.Set(t)
            yield t
    finally:
        time.Set(present)
