"""The fields of a run by name, for output, plots and users, besides the material's variables.

| name                 | what                                                                  | unit |
|----------------------|-----------------------------------------------------------------------|------|
| velocity             | v                                                                     | m/s  |
| density              | rho                                                                   | kg/m^3 |
| cauchy_stress        | T, 3x3: elastic stress, without the viscous stress                    | Pa   |
| pressure             | -tr T/3                                                               | Pa   |
| pressure_from_rest   | pressure less its value at F = I, which a body of fixed shape does not feel | Pa |
| von_mises            | sqrt(3/2) |dev T|                                                     | Pa   |
| temperature          | theta, for materials with heat                                        | K    |
| plastic_strain       | k of a flow rule that hardens; for a body plastic_strain_NAME         | 1    |
| body                 | the number, from 1, of the body with the largest fraction             | 1    |

Further stresses and rates are written only if they are named:

| name                 | what                                                                  | unit |
|----------------------|-----------------------------------------------------------------------|------|
| creep_rate           | Pi, 3x3, with creep; for a network ``creep_rate_BRANCH``              | 1/s  |
| mandel_stress        | M, 3x3, for materials with tensors; ``mandel_stress_BRANCH``          | Pa   |
| viscous_stress       | D eps(v), 3x3                                                         | Pa   |
| hyperstress_i        | (mu_1 + mu |hess v|^{p-2}) d_j d_k v_i at jk, 3x3, for each i         | Pa m |
| principal_stresses   | eigenvalues of the Cauchy stress, the largest first                   | Pa   |
| principal_stretches  | singular values of the elastic F, the largest first; 1 + those of E   | 1    |
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import takewhile

import numpy as np
from ngsolve import CF, CoefficientFunction, acos, cos, sqrt

from ngvisco.errors import ParameterError, UnknownNameError, require_known
from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Step
from ngvisco.forms.unknown_values import hessian_basis
from ngvisco.physics.flow_rules.rule import PlasticContent
from ngvisco.physics.material import Material, cauchy_stress, mandel_stress, part_of, volume_ratio
from ngvisco.physics.materials.network import Network
from ngvisco.physics.materials.thermal import entropy_in, temperature
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.parameters import Parameter
from ngvisco.physics.tensors import IDENTITY, constant, det, dev, if_positive, square, sym, tr
from ngvisco.physics.variables import TEMPERATURE, Distortion, LeftCauchyGreen, SmallStrain
from ngvisco.run.waves import rest_pressure


class FieldsByName(dict[str, CoefficientFunction]):
    """Fields by name; an unknown name raises UnknownNameError."""

    def __missing__(self, name: str) -> CoefficientFunction:
        raise UnknownNameError("field", name, self)


USUAL = ("density", "J", "velocity", "pressure", "von_mises", "temperature")
"""Fields that are drawn by default if a run has them."""


_OWN = ("velocity", "density", "cauchy_stress", "pressure", "pressure_from_rest", "von_mises")
"""Fields of every run."""

_TAKEN = "another name, since a field of the run has this name"


def require_names_of_their_own(material: Material, further: Sequence[str], carried: Sequence[str]) -> None:
    """Raise ParameterError for a variable or a further unknown that has the name of a field of the run.

    ``carried`` are names of passive fields.
    """
    bodies = material.bodies if isinstance(material, Mixture) else ()
    reserved = (*_OWN, *NAMES, *(body.name + _FRACTION for body in bodies), *(["body"] if bodies else []))
    reserved = (*reserved, *(v.strain for v in material.variables if isinstance(v, PlasticContent)))
    if entropy_in(material) is not None:  # without an entropy, the name is free for a given temperature
        reserved = (*reserved, TEMPERATURE)
    for variable in material.variables:
        if variable.name in reserved:
            raise ParameterError("Variable.name", variable.name, _TAKEN)
    for name in further:
        if name in (*reserved, *carried):
            raise ParameterError("Unknown.name", name, _TAKEN)


def output_fields(step: Step, fields: Fields | None = None) -> dict[str, CoefficientFunction]:
    """The fields of the module's docstring, the material's variables, and further unknowns that evolve.

    All fields are evaluated at the state ``fields``, by default the present state.
    """
    u, material = step.now if fields is None else fields, step.model.material
    T = cauchy_stress(material, step.context.rates.parted(u), u.zeta_tensors, step.energy.anywhere(u))
    theta = temperature(material, u.zeta_tensors)
    vectors = [v.name for v in material.variables if v.kind == "vector"]
    return {
        "velocity": u.v,
        "density": u.rho,
        **u.z_tensors,
        **{v.name: v.at(u.z_tensors) for v in material.variables if isinstance(v, Parameter)},
        **{name: CF(tuple(u.z_tensors[name][i, 0] for i in range(step.mesh.dim))) for name in vectors},
        "cauchy_stress": T,
        "pressure": (-1 / 3) * tr(T),
        "pressure_from_rest": (-1 / 3) * tr(T) - rest_pressure(material, step.mesh.dim),
        "von_mises": sqrt(1.5 * square(dev(T))),
        **({} if theta is None else {TEMPERATURE: theta}),
        **{name: u.parts[name] for name in step.layout.further},
        **dict(f.plastic_strain(u.z_tensors) for f in step.model.mechanisms if f.rule.hardening is not None),
        **_body_fields(step, u),
        **further_fields(step, T, u),
    }


_FRACTION = "_fraction"
"""Ending of the field name of a body's volume fraction."""


def _body_fields(step: Step, u: Fields) -> dict[str, CoefficientFunction]:
    """Fractions of bodies, ``NAME_fraction``, and ``body``, the number, from 1, of the largest fraction."""
    material = step.model.material
    if not isinstance(material, Mixture):
        return {}
    fields = {name + _FRACTION: CF(value) for name, value in material.fractions.at(u.z_tensors).items()}
    number, largest = CF(1.0), next(iter(fields.values()))
    for i, value in enumerate(list(fields.values())[1:], start=2):
        number = if_positive(value - largest, CF(float(i)), number)
        largest = if_positive(value - largest, value, largest)
    return {**fields, "body": number}


def scalar_fields(
    fields: Mapping[str, CoefficientFunction], names: Sequence[str] | None = None
) -> dict[str, CoefficientFunction]:
    """Scalars to be drawn: fields, norms of vectors and tensors, or components ``NAME_i``, ``NAME_ij``.

    Without ``names`` these are the fields of ``USUAL`` that the run has.
    """
    norms = {name: sqrt(square(value)) for name, value in fields.items() if value.dim > 1}
    scalars = norms | components(fields)
    chosen = [name for name in USUAL if name in scalars] if names is None else names
    require_known("field", chosen, scalars, "fields")
    return {name: scalars[name] for name in chosen}


def components(fields: Mapping[str, CoefficientFunction]) -> dict[str, CoefficientFunction]:
    """All components of all fields as scalars: ``J``, ``velocity_1``, ``F_12``."""
    return {part: value for name, field in fields.items() for part, value in _parts(name, field).items()}


def component_fields(
    fields: Mapping[str, CoefficientFunction], names: Sequence[str] | None = None, key: str = ""
) -> dict[str, CoefficientFunction]:
    """Components of the named fields, and named single components; default the usual fields.

    Raises UnknownNameError, with the ``key`` of the names, for a name that neither a field nor a component
    has.
    """
    every = components(fields)
    chosen: dict[str, CoefficientFunction] = {}
    for name in usual(fields) if names is None else names:
        if name in fields:
            chosen |= _parts(name, fields[name])
        elif name in every:
            chosen[name] = every[name]
        else:
            raise UnknownNameError("field", name, [*fields, *every], key)
    return chosen


def _parts(name: str, value: CoefficientFunction) -> dict[str, CoefficientFunction]:
    if value.dim == 1:
        return {name: value}
    if len(value.dims) == 1:
        return {f"{name}_{i + 1}": value[i] for i in range(value.dim)}
    return {f"{name}_{i + 1}{j + 1}": value[i, j] for i in range(3) for j in range(3)}


_UNITS = {
    **{"velocity": "m/s", "density": "kg/m³", "temperature": "K", "creep_rate": "1/s"},
    **dict.fromkeys(("pressure", "pressure_from_rest", "von_mises", "cauchy_stress"), "Pa"),
    **dict.fromkeys(("mandel_stress", "viscous_stress", "principal_stresses"), "Pa"),
    **dict.fromkeys(("hyperstress", *(f"hyperstress_{i}" for i in (1, 2, 3))), "Pa m"),
    **{"displacement": "m", "reference_map": "m"},
}


def field_unit(name: str) -> str:
    """The SI unit of a drawn field or of its component; empty for a pure number."""
    whole, _, index = name.rpartition("_")
    return _UNITS.get(whole if index.isdigit() else name, "")


def title_of(name: str) -> str:
    """A field's name in words, with its unit."""
    title, unit = name.replace("_", " "), field_unit(name)
    return f"{title}, {unit}" if unit else title


NAMES = (
    "creep_rate",
    "mandel_stress",
    "viscous_stress",
    *(f"hyperstress_{i}" for i in (1, 2, 3)),
    "principal_stresses",
    "principal_stretches",
)


CONTINUOUS = frozenset({"velocity"})
"""Fields that are continuous across cells; all others may jump between cells."""


def with_outlines(names: Sequence[str], available: Iterable[str]) -> list[str]:
    """The ``names`` of fields, and those ``available`` fractions that outline the bodies of a run.

    The fractions stand together before ``body``, by which ``frames.outlined`` finds them.
    """
    names_of_run = list(available)
    if "body" not in names_of_run:
        return list(names)
    before = reversed(names_of_run[: names_of_run.index("body")])
    outlines = list(takewhile(lambda name: name.endswith(_FRACTION), before))[::-1]
    return [*(name for name in names if name not in (*outlines, "body")), *outlines, "body"]


def usual(names: Iterable[str]) -> list[str]:
    """The fields among ``names`` that are written by default."""
    of_branches = ("creep_rate_", "mandel_stress_")
    return [name for name in names if name not in NAMES and not name.startswith(of_branches)]


def further_fields(step: Step, cauchy: CoefficientFunction, u: Fields) -> dict[str, CoefficientFunction]:
    """The module's further fields that the model has, at ``u``; ``cauchy`` is the Cauchy stress there."""
    model, dim = step.model, step.mesh.dim
    result: dict[str, CoefficientFunction] = {}
    rates = step.context.rates.mean_creep(u)
    result |= {f"creep_rate{suffix}": Pi for suffix, Pi in rates.items()}
    if part_of(model.material, Network) is not None:
        for branch, names in model.material.distortions.items():
            driving = mandel_stress(model.material, u.z_tensors, u.zeta_tensors, dim, names)
            result[f"mandel_stress_{branch}"] = driving
    elif any(variable.creeps for variable in model.material.variables):
        result["mandel_stress"] = mandel_stress(model.material, u.z_tensors, u.zeta_tensors, dim)
    if model.viscosity is not None:
        result["viscous_stress"] = model.viscosity.stress(
            sym(u.L), step.context.rates.read_values(model.viscosity, u)
        )
    if model.hyperviscosity is not None:
        result |= {f"hyperstress_{i + 1}": _hyperstress(u, i) for i in range(dim)}
    result["principal_stresses"] = eigenvalues(cauchy)
    stretches = principal_stretches(step, u)
    if stretches is not None:
        result["principal_stretches"] = stretches
    return result


def eigenvalues(A: CoefficientFunction) -> CoefficientFunction:
    """Vector of the eigenvalues of a symmetric 3x3 tensor, the largest first.

    For A = q I + p B with tr B = 0 and |B|^2 = 6 the eigenvalues are q + 2 p cos(phi + 2 pi k/3), where cos 3
    phi = det B/2.
    """
    q, deviator = (1 / 3) * tr(A), dev(A)
    s = square(deviator) / 6
    p = sqrt(if_positive(s, s, 0.0))
    # every direction is a principal direction of a spherical tensor, so that any angle phi is right
    cosine = 0.5 * det(deviator) / if_positive(s, s * p, 1.0)
    # rounding may take the cosine beyond -1 or 1
    cosine = if_positive(cosine - 1, 1.0, if_positive(cosine + 1, cosine, -1.0))
    phi = acos(cosine) / 3
    return CF(tuple(q + 2 * p * cos(phi + 2 * math.pi * k / 3) for k in (0, 2, 1)))


def principal_stretches(step: Step, u: Fields) -> CoefficientFunction | None:
    """Singular values of the elastic distortion; None for a material without such a tensor."""
    values, variables = u.z_tensors, step.model.material.variables
    for variable in variables:
        value = values[variable.name]
        if isinstance(variable, SmallStrain):
            return eigenvalues(IDENTITY + value)
        if isinstance(variable, (Distortion, LeftCauchyGreen)):
            by_F = isinstance(variable, Distortion)
            power = (2 if by_F else 1) * variable.exponent
            squares = eigenvalues(value * value.trans if by_F else value)
            if power:
                squares = squares * volume_ratio(step.model.material, values) ** (-power)
            return CF(tuple(sqrt(if_positive(squares[i], squares[i], 0.0)) for i in range(3)))
    return None


def _hyperstress(u: Fields, i: int) -> CoefficientFunction:
    """The 3x3 matrix of the hyperstress S_ijk for one i, with rows j and columns k."""
    dim, basis = u.dim, hessian_basis(u.dim)
    size = basis.shape[1]
    matrix = np.zeros((3, 3, dim, size))
    matrix[:dim, :dim, i] = basis.reshape(dim, dim, size)
    return (constant(matrix.reshape(9, dim * size)) * u.parts["hyperstress"]).Reshape((3, 3))
