"""Initial data on the spaces of a step, and start values of the unknowns that follow from them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import add
from typing import Annotated, Literal, TypeAlias

import numpy as np
from ngsolve import CF, CoefficientFunction, Det, Id, TaskManager, specialcf

from ngvisco.errors import InitialDataError, ParameterError, Quantity, planar, require_fields
from ngvisco.forms.boundary.wall_projections import project_velocity
from ngvisco.forms.bounds import Bounds
from ngvisco.forms.fields import Fields
from ngvisco.forms.given_values import (
    Given,
    StartValues,
    as_shape,
    carried_of,
    entropy_at,
    parameter_values,
    starting_values,
    temperature_for,
)
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.projections import LocalProjection, project, set_traces
from ngvisco.forms.start.data_checks import distortion_of, warn_of_doubts, warn_of_own_energy
from ngvisco.forms.start.equilibrium import Column, require_open
from ngvisco.forms.start.fractions_of_bodies import starting_fractions, values_of_bodies
from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand, tested
from ngvisco.forms.terms.hyperviscosity import Hyperviscosity
from ngvisco.parallel.exchange import Interpolation
from ngvisco.physics.bodies import Body
from ngvisco.physics.loads import VectorLike, as_vector
from ngvisco.physics.material import Material, conjugates, volume_ratio
from ngvisco.physics.materials.thermal import temperature
from ngvisco.physics.mixture import AMOUNT, Mixture
from ngvisco.physics.parameters import Parameter, moduli_in, value_at
from ngvisco.physics.signals import reads_time
from ngvisco.physics.tensors import inner, square, tensor_space, trace_free_tensors

ScalarLike: TypeAlias = float | CoefficientFunction

_CONTRADICTION = 1e-6  # largest |rho_0 J_0/rho_R - 1|: values may be rounded to seven digits
_LEAST_DENSITY = 1e-30  # kg/m^3; the largest density is its inverse; domains may be 1e-30 to 1e30 m large


@dataclass(frozen=True, kw_only=True)
class Initial:
    """Initial conditions (paper: Euler-small-IC-hyper, IC-large-disc).

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    density : number or coefficient function, optional
        Initial density rho_0; by default 1, or rho_R/J_0 for a material with a referential density rho_R.
    velocity : vector of the mesh's dimension, optional
        Initial velocity; by default 0.  The initial velocity is projected so that v.n = 0 on walls and v = 0
        on walls without slip; the tangential part on moving walls stays.
    F : 3x3 coefficient function or array, optional
        Initial elastic distortion, 3x3, det F > 0, from which the start values of all variables are derived
        (J_0 = det F_0, E_0 = sym F_0 - I, ...); by default the identity, or (rho_R/rho_0)^{1/3} I with a
        referential density. In 2D the entries 13, 23, 31, 32 of F are 0.
    temperature : number or coefficient function, optional
        Initial temperature of a material with heat; by default the reference temperature.  If bodies have
        different thermal pressures, each body alone has the initial temperature; in shared cells the bodies
        reach one pressure and a slightly different temperature.
    equilibrium : str, optional
        "hydrostatic": the volume J_0, one for each body, bears the loads at the start (F_0 = J_0^{1/3} I).
        J_0 is the inverse of the bulk law at the pressure of the weight above and the local temperature. The
        density is rho_R/J_0 for a material with a referential density and for bodies, and the given density
        for all others. With k > 1 an equilibrium needs m >= 1.
    datum : str, optional
        With an equilibrium, the wall at which the mean pressure is ``datum_pressure``. If neither a wall nor
        a point is given, the datum is the place of the least pressure.
    datum_point : sequence of numbers, optional
        Point of the domain at which the pressure is ``datum_pressure``, m.
    datum_pressure : float
        Pressure at the datum, less the pressure at J = 1 and the reference temperature. The subtracted
        pressure is zero except for gases and materials with stress at rest.
    values : mapping of names to coefficient functions, optional
        Initial values by name. Values of the material's variables replace the values that follow from F.
        Values of further terms' evolving unknowns are zero by default.  For a body's tensor, give the
        tensor times the body's amount, which is the body's volume fraction over det F.
    """

    density: Annotated[ScalarLike | None, Quantity("kg/m^3", "> 0", 1.0)] = None
    velocity: Annotated[
        VectorLike | None, Quantity("m/s", example=["sin(pi*x)*cos(pi*y)", "-cos(pi*x)*sin(pi*y)"])
    ] = None
    F: Annotated[CoefficientFunction | None, Quantity("1", example=[[1.1, 0, 0], [0, 1, 0], [0, 0, 1]])] = (
        None
    )
    temperature: Annotated[ScalarLike | None, Quantity("K", "> 0", 300.0)] = None
    equilibrium: Annotated[Literal["hydrostatic"] | None, Quantity(example="hydrostatic")] = None
    datum: Annotated[str | None, Quantity(example="top")] = None
    datum_point: Annotated[Sequence[float] | None, Quantity("m", example=[0.5, 1.0])] = None
    datum_pressure: Annotated[float, Quantity("Pa", example=1e5)] = 0.0
    values: Annotated[Mapping[str, CoefficientFunction], Quantity("1", example={"J": "1 + 0.1*x"})] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        if not isinstance(self.datum, str | None):
            raise ParameterError("Initial.datum", self.datum, "the name of a wall; datum_point takes a point")
        require_fields(self)
        if self.datum is not None and self.datum_point is not None:
            raise ParameterError("Initial.datum_point", self.datum_point, None, ", since datum is given")
        without = {"datum": None, "datum_point": None, "datum_pressure": 0.0}
        for name, value in without.items() if self.equilibrium is None else ():
            if getattr(self, name) != value:
                expected = 'no such value without equilibrium = "hydrostatic"'
                raise ParameterError(f"Initial.{name}", getattr(self, name), expected)


def set_initial(step: Step, initial: Initial, sampler: Sampler) -> CoefficientFunction:
    """Put the initial data into ``step.state`` and ``step.state_old``, and warn of doubtful data.

    Raises InitialDataError in three cases: rho_0, det F_0 or a positive variable is <= 0, or a value or the
    stored energy is not finite, at a sampling point; a tensor does not fit its variable (in plane strain: 13,
    23, 31, 32 entries; E not symmetric); density and J contradict the material's rho_R.  Raises
    ParameterError if a value has the wrong type or shape, and UnknownNameError if ``initial.values`` names
    neither a variable of the material nor a further unknown that evolves.

    Returns
    -------
    CoefficientFunction
        The initial elastic distortion F_0, 3x3, from the data or from a start value that determines it.
    """
    if step.sources is None:  # a manufactured state may read the time
        _require_place(initial, step.mesh.dim)
    try:
        values, density, F = _data(step, initial, sampler)
        _project(step, initial, sampler, values, density)
    except InitialDataError:
        warn_of_own_energy(step, None)  # a non-convex energy may be the reason
        raise
    warn_of_own_energy(step, sampler.rows(step.now.z))
    strains = {v.name for v in step.model.material.variables if v.is_strain}
    is_at_rest = initial.F is None and initial.equilibrium is None and not strains & {*initial.values}
    warn_of_doubts(step, sampler, values, initial.velocity, is_at_rest)
    distortion = distortion_of(step.model.material, values)
    return F if distortion is None else distortion


def _data(
    step: Step, initial: Initial, sampler: Sampler
) -> tuple[StartValues, CoefficientFunction, CoefficientFunction]:
    """Start values of the material's variables, the density and the elastic distortion."""
    material = step.model.material
    F = Id(3) if initial.F is None else as_shape("Initial.F", initial.F, (3, 3))
    sampler.require(Det(F), "det F_0", "Initial.F", minimum=0.0)
    told = parameter_values(material, initial.values)
    parameters = carried_of(material, told)
    shares: StartValues = {}
    if isinstance(material, Mixture):
        shares = starting_fractions(step.mesh, material.bodies, step.discretisation.m)
    distortions: Mapping[str, CoefficientFunction] = dict.fromkeys(shares, F)
    if initial.equilibrium is not None:
        distortions = _at_rest(step, initial, sampler, parameters, shares)
        F = distortions.get("", F)
    of_bodies = _of_bodies(step, initial, shares, distortions, sampler)
    rho_R = material.referential_density
    rho_R = None if rho_R is None else CF(value_at(rho_R, parameters))
    _check_moduli(step, told, parameters, sampler)
    density: CoefficientFunction | None = None
    if not of_bodies and initial.density is not None:
        density = as_shape("Initial.density", initial.density, ())
        sampler.require(density, "density rho_0", "Initial.density", minimum=0.0)
        is_open = initial.F is None and initial.equilibrium is None
        if rho_R is not None and is_open and set(initial.values) <= set(parameters):
            F = (rho_R / density) ** (1 / 3) * Id(3)
    values = starting_values(material, initial.values, F, step.layout.further) | of_bodies
    if of_bodies:
        density = reduce(add, (body.density * values[AMOUNT + body.name] for body in step.model.bodies))
    elif density is None:
        density = CF(1.0) if rho_R is None else rho_R / volume_ratio(material, values)
        sampler.require(density, "density rho_0", "Initial.density", minimum=0.0)
    elif rho_R is not None:
        _check_density(rho_R, density, volume_ratio(material, values), sampler)
    theta = temperature_for(material, initial.temperature, initial.values, "Initial")
    if theta is not None:
        sampler.require(theta, "temperature theta_0", "Initial.temperature", minimum=0.0)
        values |= entropy_at(material, theta, values)
    _check_spaces(step, initial.values, values, sampler)
    low, high = sampler.extrema(density)  # products of densities in this range do not overflow
    if not _LEAST_DENSITY <= low <= high <= 1 / _LEAST_DENSITY:
        expected = f"values from {_LEAST_DENSITY:g} to {1 / _LEAST_DENSITY:g} kg/m^3"
        values_are = f"the values are from {low:.6g} to {high:.6g}"
        raise InitialDataError("density rho_0", values_are, expected, "Initial.density")
    _check_continuation(material, values, sampler)
    step.ranges = _ranges(step, parameters, sampler)
    return values, density, F


def _project(
    step: Step, initial: Initial, sampler: Sampler, values: StartValues, density: CoefficientFunction
) -> None:
    """Project the data into the step's state, and start all unknowns that follow from them."""
    material, dim = step.model.material, step.mesh.dim
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    further = _further(step, initial, sampler)
    with TaskManager():
        step.state.vec[:] = 0.0
        if not step.model.bodies:
            LocalProjection(parts["rho"], step.quadrature, tested(density))()
        LocalProjection(parts["z"], step.quadrature, tested(material.states(dim).components(values)))()
        for name, value in further.items():
            project(step.layout.unknowns[name], parts[name], step.quadrature, value)
        bounds = Bounds(step, sampler)
        (bounds if step.model.bodies else bounds.ranges).limit()
        if step.damage is not None:
            step.damage.start()  # sets the slope of damage too
        step.freeze()
        if initial.velocity is not None:
            v_0 = as_vector(initial.velocity, dim, "Initial.velocity")
            sampler.require(inner(v_0, v_0), "|v_0|^2", "Initial.velocity")
            Interpolation(step.layout.blocks["v"])(parts["v"], v_0)
            _impose_walls(step, v_0)
        z = step.now.z_tensors
        sampler.require(inner(step.now.z, step.now.z), "material variables", "Initial.values")
        sampler.require(step.now.rho, "projected density rho_0", "Initial.density", minimum=0.0)
        signs = [*(v.positive(z[v.name]) for v in material.variables), material.domain(z)]
        if step.model.bodies:  # a body's variables vanish outside of the body
            signs = list(material.positive(z).values())
        for name, value in ((name, value) for positive in signs for name, value in positive.items()):
            sampler.require(value, f"projected {name}_0", f"Initial.values[{name!r}]", minimum=0.0)
        if not np.isfinite(step.energy.samples(z, sampler)).all():
            failure = step.energy.last_failure or "the value is not finite somewhere"
            is_at_rest = initial.F is None and not initial.values and not step.model.bodies
            key, subject = ("Model.material", "parameters") if is_at_rest else ("Initial", "start values")
            raise InitialDataError("stored energy", failure, f"{subject} that give a finite energy", key)
        complete(step)
    theta = temperature(material, step.now.zeta_tensors)
    if theta is not None:
        sampler.require(theta, "projected temperature theta_0", "Initial.temperature", minimum=0.0)
    step.state_old.vec.data = step.state.vec
    step.start_from_old()


def _ranges(step: Step, parameters: Given, sampler: Sampler) -> dict[str, tuple[float, float]]:
    """Ranges of the material's parameters by name: a parameter's limits, or the range of its start values.

    Raises InitialDataError for a start value outside its limits.
    """
    ranges = {name: sampler.extrema(value) for name, value in parameters.items()}
    for variable in step.model.material.variables:
        if isinstance(variable, Parameter) and variable.limits is not None:
            (least, most), (low, high) = ranges[variable.name], variable.limits
            if not low <= least <= most <= high:
                key, expected = f"Initial.values[{variable.name!r}]", f"values from {low:g} to {high:g}"
                range_ = f"the values are from {least:.6g} to {most:.6g}"
                raise InitialDataError(f"parameter {variable.name}", range_, expected, key)
            ranges[variable.name] = variable.limits
    return ranges


def _at_rest(
    step: Step, initial: Initial, sampler: Sampler, parameters: StartValues, shares: StartValues
) -> dict[str, CoefficientFunction]:
    """Distortions in equilibrium with the loads, by bodies' names, "" for a single material."""
    material = step.model.material
    require_open(step, initial.F, initial.values)
    if initial.density is not None and material.referential_density is not None:
        expected = (None, ", since the density rho_R/J follows from the equilibrium")
        raise ParameterError("Initial.density", initial.density, *expected)
    density = None
    if initial.density is not None:
        density = as_shape("Initial.density", initial.density, ())
        sampler.require(density, "density rho_0", "Initial.density", minimum=0.0)
    given = {v.name: initial.values[v.name] for v in material.variables if v.name in initial.values}
    theta = temperature_for(material, initial.temperature, initial.values, "Initial")
    column = Column(step, sampler, {**given, **parameters}, theta, shares, density)
    with TaskManager():
        J = column.solve(initial.datum or initial.datum_point, initial.datum_pressure)
    return {name: volume ** (1 / 3) * Id(3) for name, volume in J.items()}


def _of_bodies(
    step: Step, initial: Initial, shares: StartValues, distortions: Given, sampler: Sampler
) -> StartValues:
    """Start amounts and tensors of the model's bodies, without the variables in ``initial.values``."""
    material = step.model.material
    if not isinstance(material, Mixture):
        return {}
    if initial.density is not None:
        raise ParameterError("Initial.density", initial.density, None, ", since each body has a density")
    for name in sorted(set(initial.values) & {AMOUNT + name for name in shares}):
        raise ParameterError("Initial.values", name, "no amounts, since the bodies' places give them")
    return values_of_bodies(step, material, shares, distortions, initial.values, sampler)


def _check_moduli(step: Step, told: StartValues, parameters: Given, sampler: Sampler) -> None:
    """Raise InitialDataError if a modulus of a law has the wrong sign somewhere at the start.

    ``told`` has the parameters' start values, and ``parameters`` the numbers that the state carries for them.
    """
    model = step.model
    laws: list[tuple[str, object]] = [
        (f"bodies[{body.name!r}].", (body.material, body.viscosity, body.creep)) for body in model.bodies
    ]
    laws.append(("", (() if laws else (model.material, model.viscosity, model.creep), model.hyperviscosity)))
    of_laws = [(owner + name, value, sign) for owner, law in laws for name, value, sign in moduli_in(law)]
    for name, expression, is_positive in of_laws:
        value = told[expression.name] if isinstance(expression, Parameter) else expression.at(parameters)
        sampler.require(value, name, name, 0.0 if is_positive else None)
        if (least := sampler.extrema(value)[0]) < 0:
            raise InitialDataError(name, f"the minimum is {least:.6g}", "values >= 0", name)


def _require_place(initial: Initial, dim: int) -> None:
    """Raise ParameterError for a start value that is a function of the time, or of z in the plane."""
    given = {name: getattr(initial, name) for name in ("density", "velocity", "F", "temperature")}
    given |= {f"values[{name!r}]": value for name, value in initial.values.items()}
    for name, value in given.items():
        for part in _functions_in(value):
            if reads_time(planar(f"Initial.{name}", part, dim)):
                expected = "a function of the place alone, but the given function reads the time"
                raise ParameterError(f"Initial.{name}", value, expected)


def _functions_in(value: object) -> Iterator[CoefficientFunction]:
    if isinstance(value, CoefficientFunction):
        yield value
    elif isinstance(value, (list, tuple)):
        for part in value:
            yield from _functions_in(part)


def _check_continuation(material: Material, values: Given, sampler: Sampler) -> None:
    """Raise ParameterError if J at the start is below ``J_min``, where an energy is continued."""
    for part in () if isinstance(material, Mixture) else _materials_in(material):
        J_min = getattr(part, "J_min", None)
        if J_min is None:
            continue
        J = volume_ratio(part, {v.name: values[v.name] for v in part.variables})
        if (least := sampler.extrema(J)[0]) < J_min:
            expected = f"less than {least:.4g}, the least J at the start; below J_min there is no barrier"
            raise ParameterError(f"{type(part).__name__}.J_min", J_min, expected)


def _materials_in(part: object) -> Iterator[Material]:
    """Yield a material and the materials that it contains."""
    if isinstance(part, (tuple, Material, Body)):
        if isinstance(part, Material):
            yield part
        for member in part if isinstance(part, tuple) else vars(part).values():
            yield from _materials_in(member)


def _further(step: Step, initial: Initial, sampler: Sampler) -> StartValues:
    """Given start values of the evolving unknowns other than v, rho and z."""
    values = {}
    for name in (name for name in step.layout.further if name in initial.values):
        shape, field_name = step.layout.unknowns[name].shape, f"Initial.values[{name!r}]"
        values[name] = value = as_shape(field_name, initial.values[name], shape)
        sampler.require(inner(value, value), f"|{name}_0|^2", field_name)
    return values


def _check_density(
    rho_R: CoefficientFunction, density: CoefficientFunction, J: CoefficientFunction, sampler: Sampler
) -> None:
    """Raise InitialDataError unless rho_0 J_0 = rho_R."""
    sampler.require(J, "J_0 of the material variables", "Initial.values", minimum=0.0)
    least, most = sampler.extrema(density * J / rho_R)
    if max(abs(least - 1), abs(most - 1)) > _CONTRADICTION:
        low, high = sampler.extrema(density * J)
        range_ = f"rho_0 J_0 is from {low:.7g} to {high:.7g} kg/m^3"
        low, high = sampler.extrema(rho_R)
        referential = f"{low:.7g}" if low == high else f"from {low:.7g} to {high:.7g}"
        expected = f"rho_0 J_0 = rho_R, which is {referential} kg/m^3; or give only the density, or only J"
        raise InitialDataError("density rho_0", range_, expected, "Initial.density")


def _check_spaces(step: Step, given: Given, values: Given, sampler: Sampler) -> None:
    """Raise InitialDataError if a tensor has entries outside the space of its variable.

    Variables without a value in ``given`` follow from F.
    """
    for variable in step.model.material.variables:
        space = tensor_space(variable.kind, step.mesh.dim)
        if space.is_scalar:
            continue
        value, is_given = values[variable.name], variable.name in given
        key = f"Initial.values[{variable.name!r}]" if is_given else "Initial.F"
        difference = value - space.tensor(space.components(value))
        sampler.require(square(value), f"{variable.name}_0", key)
        if sampler.extrema(square(difference))[1] > 1e-20 * (1 + sampler.extrema(square(value))[1]):
            shape = "a symmetric tensor" if variable.kind == "symmetric" else "a 3x3 tensor"
            if step.mesh.dim == 2:
                shape += " whose entries 13, 23, 31, 32 are 0 (plane strain)"
            raise InitialDataError(f"{variable.name}_0", "the tensor does not fit its variable", shape, key)


def _impose_walls(step: Step, v_0: CoefficientFunction) -> None:
    """Impose the walls' discrete conditions: v = 0 without slip, the tangential part of v_0 on moving walls,
    and on oblique or curved walls v.n = 0 by the L2 projection with their multiplier.
    """
    # interpolation leaves a small v.n in constrained coefficients, which would appear in the ledger
    step.state.vec.FV().NumPy()[~mask_of(step.layout.space.FreeDofs())] = 0.0
    v = step.state.vec.FV().NumPy()[step.layout.ranges["v"]]
    n = specialcf.normal(step.mesh.dim)
    for name, (_, mask) in step.moving_walls.moving.items():
        normal_part = 0.0 if name in step.walls.crossed else v_0 * n
        v[mask] = step.moving_walls.interpolate(name, v_0 - normal_part * n)[mask]
    term = step.impenetrability
    # on a periodic mesh ``Set`` counts a vertex twice if a cell meets its own image
    if term is not None or step.layout.periodic:
        project_velocity(step.layout, step.state, v_0, term, step.quadrature)


def complete(step: Step) -> None:
    """Set traces, conjugates, creep rates and the hyperviscosity's unknowns from v, rho and z."""
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    u, material, dim = step.now, step.model.material, step.mesh.dim
    if step.energy.projected is None:
        parts["zeta"].Set(material.states(dim).components(conjugates(material, u.z_tensors)))
    else:
        step.local_unknowns.update_stored()
        step.local_unknowns.projections["zeta"]()
    rates = step.context.rates
    if "Pi" in parts:  # the start value is the local rate, because psi' may be infinitely steep at zero
        rate = trace_free_tensors(dim).components(rates.local_creep(rates.mechanisms[0], u))
        Interpolation(step.layout.blocks["Pi"])(parts["Pi"], rate)
    set_traces(step.layout, step.state, step.context, step.quadrature)
    if (law := step.model.hyperviscosity) is None:
        return
    _recover_hessian(step, Hyperviscosity(law))
    coefficient = CF(1.0) * law.linear(u.z_tensors)
    if not law.is_linear:
        parts["hess_square"].Set(square(u.hess))
        parts["hyper_coefficient"].Set(law.coefficient(u.hess_square, u.z_tensors))
        coefficient = u.hyper_coefficient
    parts["hyperstress"].Set(coefficient * parts["hess"])


def _recover_hessian(step: Step, term: Hyperviscosity) -> None:
    """Set the recovered Hessian Hs by its local projection, int Hs : X = lifting of (v, a)."""
    hess = step.state.components[step.layout.names.index("hess")]

    def lifted(test: CoefficientFunction) -> Sequence[Integrand]:
        # the lifting's test is hyperstress, whose local space is the space of hess
        return term.lifting(step.now, Fields(step.layout, {"hyperstress": test}))

    LocalProjection(hess, step.quadrature, lifted)()
