"""Initial data on the spaces of a step, and start values of the unknowns that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from ngsolve import (
    CF,
    BilinearForm,
    BitArray,
    CoefficientFunction,
    Det,
    GridFunction,
    Id,
    LinearForm,
    TaskManager,
    specialcf,
)

from ngvisco.errors import InitialDataError, ParameterError, UnknownNameError
from ngvisco.forms.hyperviscosity import Hyperviscosity
from ngvisco.forms.sampling import Sampler
from ngvisco.forms.system import Step
from ngvisco.forms.walls import Impenetrability
from ngvisco.physics.material import components_of, conjugates
from ngvisco.physics.model import VectorLike, as_vector
from ngvisco.physics.tensors import inner, square, tensor_space

ScalarLike: TypeAlias = float | CoefficientFunction


@dataclass(frozen=True, kw_only=True)
class Initial:
    """Initial conditions (paper: Euler-small-IC-hyper, IC-large-disc).

    Parameters
    ----------
    density : number or coefficient function
        rho_0 > 0, kg/m^3.
    velocity : vector of the mesh's dimension, optional
        v_0, m/s; default zero.  It is projected so that v.n = 0 holds on walls,
        and vanishes on walls without slip; on moving walls it keeps its tangential part.
    F : 3x3 coefficient function, optional
        Initial elastic distortion, det F_0 > 0, default I; every variable's start value is derived
        from it (J_0 = det F_0, E_0 = sym F_0 - I, ...).  In 2D its 13, 23, 31, 32 entries must be 0.
    values : mapping of variable names to coefficient functions, optional
        Start values that replace the derived ones, e.g. ``{"E": E_0}``.
    """

    density: ScalarLike = 1.0
    velocity: VectorLike | None = None
    F: CoefficientFunction | None = None
    values: Mapping[str, CoefficientFunction] = field(default_factory=dict)


def set_initial(step: Step, initial: Initial, sampler: Sampler) -> None:
    """Put the initial data into ``step.state`` and ``step.state_old``.

    Raises
    ------
    InitialDataError
        If rho_0 <= 0, det F_0 <= 0, a positive variable is not so, or a value or the stored energy
        is not finite at a sampling point; or if a tensor does not fit its variable (in plane strain:
        13, 23, 31, 32 entries; E not symmetric).
    ParameterError
        If a value has the wrong type or shape.
    UnknownNameError
        If ``initial.values`` names a variable that the material does not have.
    """
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    dim = step.mesh.dim
    density = _as_shape("Initial.density", initial.density, ())
    F = Id(3) if initial.F is None else _as_shape("Initial.F", initial.F, (3, 3))
    values = _initial_values(step, initial, F)
    sampler.require(density, "density rho_0", minimum=0.0)
    sampler.require(Det(F), "det F_0", minimum=0.0)
    _check_spaces(step, values, sampler)
    with TaskManager():
        step.state.vec[:] = 0.0
        parts["rho"].Set(density)
        parts["z"].Set(components_of(step.model.material, values, dim))
        if initial.velocity is not None:
            v_0 = as_vector(initial.velocity, dim, "Initial.velocity")
            sampler.require(inner(v_0, v_0), "|v_0|^2")
            parts["v"].Set(v_0)
            _impose_walls(step, v_0)
        sampler.require(inner(step.now.z, step.now.z), "material variables")
        sampler.require(step.now.rho, "projected density rho_0", minimum=0.0)
        for variable in step.model.material.variables:
            value = variable.positive(step.now.z_tensors[variable.name])
            if value is not None:
                name = variable.name if variable.kind == "scalar" else f"det {variable.name}"
                sampler.require(value, f"projected {name}_0", minimum=0.0)
        if not np.isfinite(step.energy.samples(step.now.z_tensors, sampler)).all():
            raise InitialDataError("stored energy", "not finite somewhere", "finite values")
        complete(step)
    step.state_old.vec.data = step.state.vec


def _initial_values(step: Step, initial: Initial, F: CoefficientFunction) -> dict[str, CoefficientFunction]:
    names = [variable.name for variable in step.model.material.variables]
    for name in initial.values:
        if name not in names:
            raise UnknownNameError("material variable", name, names)
    values = {v.name: v.from_distortion(F) for v in step.model.material.variables}
    for name, value in initial.values.items():
        values[name] = _as_shape(f"Initial.values[{name!r}]", value, tuple(values[name].dims))
    return values


def _as_shape(field_name: str, value: object, shape: tuple[int, ...]) -> CoefficientFunction:
    """A coefficient function of this shape, or ParameterError; a number will do for a scalar."""
    expected = (
        "a 3x3 coefficient function, also in 2D" if shape else "a number or a scalar coefficient function"
    )
    if isinstance(value, (int, float)) and not isinstance(value, bool) and not shape:
        return CF(float(value))
    if not isinstance(value, CoefficientFunction):
        raise ParameterError(field_name, value, expected)
    if tuple(value.dims) != shape:
        raise ParameterError(field_name, f"shape {tuple(value.dims)}", expected)
    return value


def _check_spaces(step: Step, values: Mapping[str, CoefficientFunction], sampler: Sampler) -> None:
    """Raise InitialDataError when a tensor loses something in the space of its variable."""
    for variable in step.model.material.variables:
        space = tensor_space(variable.kind, step.mesh.dim)
        if space.is_scalar:
            continue
        value = values[variable.name]
        lost = value - space.tensor(space.components(value))
        sampler.require(square(value), f"{variable.name}_0")
        if sampler.extrema(square(lost))[1] > 1e-20 * (1 + sampler.extrema(square(value))[1]):
            shape = "symmetric" if variable.kind == "symmetric" else "3x3"
            if step.mesh.dim == 2:
                shape += " with zero 13, 23, 31, 32 entries (plane strain)"
            raise InitialDataError(f"{variable.name}_0", "entries that its space does not hold", shape)


def remove_constrained(step: Step) -> None:
    """Zero the constrained coefficients: ``Set`` leaves a small v.n, which the ledger would show."""
    free = np.array(list(step.layout.space.FreeDofs()), dtype=bool)
    step.state.vec.FV().NumPy()[~free] = 0.0


def _impose_walls(step: Step, v_0: CoefficientFunction) -> None:
    """Make v.n = 0 hold in the walls' discrete sense: v = 0 where there is no slip, the given tangential
    part where a wall moves, and on oblique or curved walls the L2 projection with their multiplier."""
    remove_constrained(step)
    where = step.layout.ranges["v"]
    v = step.state.vec.FV().NumPy()[where]
    for name, (_, mask) in step.moving_walls.moving.items():
        n = specialcf.normal(step.mesh.dim)
        v[mask] = step.moving_walls.interpolate(name, v_0 - (v_0 * n) * n)[mask]
    for term in step.terms:
        if isinstance(term, Impenetrability):
            _project_velocity(step, v_0, term)


def _project_velocity(step: Step, v_0: CoefficientFunction, term: Impenetrability) -> None:
    trial, test = step.layout.space.TnT()
    u, w = step.layout.fields(trial), step.layout.fields(test)
    mass = BilinearForm(step.layout.space, check_unused=False)
    load = LinearForm(step.layout.space)
    mass += inner(u.v, w.v) * step.quadrature.cells
    load += inner(v_0, w.v) * step.quadrature.cells
    for part in term.form(u, w):
        mass += part.facets * step.quadrature.facets
    _solve_blocks(step, mass, load, ["v", "wall_stress"])
    step.state.vec[step.layout.ranges["wall_stress"]] = 0.0


def complete(step: Step) -> None:
    """Start values of traces, conjugates and the hyperviscosity's unknowns from v, rho and z."""
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    u, material, dim = step.now, step.model.material, step.mesh.dim
    if step.energy.projected is None:
        parts["zeta"].Set(components_of(material, conjugates(material, u.z_tensors), dim))
    else:
        step.eliminate.refresh()
        step.eliminate.conjugates()
    _mean_traces(step)
    law = step.model.hyperviscosity
    if law is None:
        return
    _recover_hessian(step, Hyperviscosity(law, step.context))
    coefficient = CF(law.mu + law.mu_1)
    if not law.is_linear:
        parts["hess_square"].Set(square(u.hess))
        parts["hyper_coefficient"].Set(law.coefficient(u.hess_square))
        coefficient = u.hyper_coefficient
    parts["hyperstress"].Set(coefficient * parts["hess"])


def _mean_traces(step: Step) -> None:
    """Facet unknowns as the means of both sides' values."""
    trial, test = step.layout.space.TnT()
    u, w, now = step.layout.fields(trial), step.layout.fields(test), step.now
    measure = step.quadrature.facets
    mass = BilinearForm(step.layout.space, check_unused=False)
    load = LinearForm(step.layout.space)
    mass += u.rho_hat * w.rho_hat * measure
    load += now.rho * w.rho_hat * measure
    mass += inner(u.z_hat, w.z_hat) * measure
    load += inner(now.z, w.z_hat) * measure
    names = ["rho_hat", "z_hat"]
    for name, value in (("rho_delta_hat", now.rho), ("z_delta_hat", now.z)):
        if name in step.layout.names:
            mass += inner(u.parts[name], w.parts[name]) * measure
            load += inner(value, w.parts[name]) * measure
            names.append(name)
    if step.model.hyperviscosity is not None:
        n = step.context.normal
        mass += inner(u.normal_derivative, w.normal_derivative) * measure
        load += inner(now.grad_v * n, w.normal_derivative) * measure
        names += [f"a_{i + 1}" for i in range(step.mesh.dim)]
    _solve_blocks(step, mass, load, names)


def _recover_hessian(step: Step, term: Hyperviscosity) -> None:
    """The local projection int Hs : X = lifting of (v, a)."""
    trial, test = step.layout.space.TnT()
    u, w = step.layout.fields(trial), step.layout.fields(test)
    mass = BilinearForm(step.layout.space, check_unused=False)
    load = LinearForm(step.layout.space)
    # the lifting is tested by hyperstress; its local space is the same as that of hess
    mass += inner(u.hyperstress, w.hyperstress) * step.quadrature.cells
    for part in term.lifting(step.now, w):
        if part.cells is not None:
            load += part.cells * step.quadrature.cells
        if part.facets is not None:
            load += part.facets * step.quadrature.facets
    _solve_blocks(step, mass, load, ["hyperstress"])
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    parts["hess"].vec.data = parts["hyperstress"].vec


def _solve_blocks(step: Step, mass: BilinearForm, load: LinearForm, names: list[str]) -> None:
    mass.Assemble()
    load.Assemble()
    free = BitArray(step.layout.space.ndof)
    free.Clear()
    for name in names:
        free[step.layout.ranges[name]] = True
    # neither facets of coarser meshes, nor identified copies, nor prescribed coefficients
    free &= step.layout.space.FreeDofs()
    solution = GridFunction(step.layout.space)
    if "v" in names:
        where = step.layout.ranges["v"]
        solution.vec[where] = step.state.vec[where]
        for i in range(where.start, where.stop):
            if free[i]:
                solution.vec[i] = 0.0
        load.vec.data -= mass.mat * solution.vec
    solution.vec.data += mass.mat.Inverse(free, inverse="umfpack") * load.vec
    for name in names:
        where = step.layout.ranges[name]
        step.state.vec[where] = solution.vec[where]
