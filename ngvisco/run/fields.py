"""The fields of a run under their names, for output, plots and users."""

from collections.abc import Mapping, Sequence

from ngsolve import CF, CoefficientFunction, sqrt

from ngvisco.errors import ParameterError, UnknownNameError
from ngvisco.forms.system import Step
from ngvisco.physics.material import Material, cauchy_stress
from ngvisco.physics.materials.thermal import temperature
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import dev, if_positive, square, tr
from ngvisco.run.further_fields import NAMES, further_fields, usual
from ngvisco.run.passive import CARRIED
from ngvisco.run.scales import rest_pressure

USUAL = ("density", "J", "velocity", "pressure", "von_mises", "temperature")
"""What is drawn where nothing is said, as far as a run has it."""


_OWN = ("velocity", "density", "cauchy_stress", "pressure", "pressure_from_rest", "von_mises", "temperature")
"""Fields of every run, and of those with heat."""

_TAKEN = "another name: a field of the run has this one"


def require_names_of_their_own(material: Material, further: Sequence[str] = ()) -> None:
    """Raise ParameterError for a variable or a further unknown that has the name of a field of the run."""
    bodies = material.bodies if isinstance(material, Mixture) else ()
    taken = (*_OWN, *NAMES, *(body.name + _FRACTION for body in bodies), *(["body"] if bodies else []))
    for variable in material.variables:
        if variable.name in taken:
            raise ParameterError("Variable.name", variable.name, _TAKEN)
    for name in further:
        if name in (*taken, *CARRIED):
            raise ParameterError("Unknown.name", name, _TAKEN)


def output_fields(step: Step) -> dict[str, CoefficientFunction]:
    """Velocity, density, variables, Cauchy stress, pressure, von Mises stress, further unknowns that evolve.

    ``pressure_from_rest`` is the pressure less that of the material at rest, F = I, whose stress phi(I) I
    a body of a fixed shape does not feel.  Those of ``ngvisco.run.further_fields`` follow.
    """
    u, material = step.now, step.model.material
    T = cauchy_stress(material, u.z_tensors, u.zeta_tensors, step.energy.anywhere(u))
    return {
        "velocity": u.v,
        "density": u.rho,
        **_variables(step),
        "cauchy_stress": T,
        "pressure": (-1 / 3) * tr(T),
        "pressure_from_rest": (-1 / 3) * tr(T) - rest_pressure(material, step.mesh.dim),
        "von_mises": sqrt(1.5 * square(dev(T))),
        **_temperature(step),
        **{name: u.parts[name] for name in step.layout.further},
        **_body_fields(step),
        **further_fields(step, T),
    }


def _variables(step: Step) -> dict[str, CoefficientFunction]:
    """The material's, vectors as such."""
    z, dim = step.now.z_tensors, step.mesh.dim
    vectors = [v.name for v in step.model.material.variables if v.kind == "vector"]
    return {**z, **{name: CF(tuple(z[name][i, 0] for i in range(dim))) for name in vectors}}


def _temperature(step: Step) -> dict[str, CoefficientFunction]:
    """K, by the projected conjugate of the entropy, of a material with heat."""
    theta = temperature(step.model.material, step.now.zeta_tensors)
    return {} if theta is None else {"temperature": theta}


_FRACTION = "_fraction"
"""What the name of a body's volume fraction ends in."""


def _body_fields(step: Step) -> dict[str, CoefficientFunction]:
    """Volume fractions of the bodies, ``NAME_fraction``, and ``body``, the number, from 1, of the largest."""
    material = step.model.material
    if not isinstance(material, Mixture):
        return {}
    theta = material.fractions.at(step.now.z_tensors)
    fields = {name + _FRACTION: CF(value) for name, value in theta.items()}
    number, largest = CF(1.0), next(iter(fields.values()))
    for i, value in enumerate(list(fields.values())[1:], start=2):
        number = if_positive(value - largest, CF(float(i)), number)
        largest = if_positive(value - largest, value, largest)
    return {**fields, "body": number}


def scalar_fields(
    fields: Mapping[str, CoefficientFunction], names: Sequence[str] | None = None
) -> dict[str, CoefficientFunction]:
    """Scalars to be drawn: of a vector or a tensor its norm, or a component ``NAME_i``, ``NAME_ij``.

    Parameters
    ----------
    fields : mapping
        As ``simulation.fields``.
    names : sequence of str, optional
        Default: density, J, modulus of the velocity, pressure and von Mises stress, where there are such.
    """
    known = {}
    for name, value in fields.items():
        if value.dim > 1:
            known[name] = sqrt(square(value))
    known |= components(fields)
    if names is None:
        return {name: known[name] for name in USUAL if name in known}
    for name in names:
        if name not in known:
            raise UnknownNameError("field", name, known)
    return {name: known[name] for name in names}


def components(fields: Mapping[str, CoefficientFunction]) -> dict[str, CoefficientFunction]:
    """Every component of every field as a scalar: ``J``, ``velocity_1``, ``F_12``."""
    return {part: value for name, field in fields.items() for part, value in _parts(name, field).items()}


def component_fields(
    fields: Mapping[str, CoefficientFunction], names: Sequence[str] | None = None
) -> dict[str, CoefficientFunction]:
    """The components of the named fields, or single components by their names; default the usual fields.

    Raises UnknownNameError for a name that is neither.
    """
    every = components(fields)
    chosen: dict[str, CoefficientFunction] = {}
    for name in usual(fields) if names is None else names:
        if name in fields:
            chosen |= _parts(name, fields[name])
        elif name in every:
            chosen[name] = every[name]
        else:
            raise UnknownNameError("field", name, [*fields, *every])
    return chosen


def _parts(name: str, value: CoefficientFunction) -> dict[str, CoefficientFunction]:
    if value.dim == 1:
        return {name: value}
    if len(value.dims) == 1:
        return {f"{name}_{i + 1}": value[i] for i in range(value.dim)}
    return {f"{name}_{i + 1}{j + 1}": value[i, j] for i in range(3) for j in range(3)}


def field_unit(name: str) -> str:
    """The SI unit of a field that is drawn, empty for a pure number."""
    units = {
        "velocity": "m/s",
        "density": "kg/m³",
        "temperature": "K",
        "pressure": "Pa",
        "pressure_from_rest": "Pa",
        "von_mises": "Pa",
        "cauchy_stress": "Pa",
        "creep_rate": "1/s",
        "mandel_stress": "Pa",
        "viscous_stress": "Pa",
        **dict.fromkeys(("hyperstress", "hyperstress_1", "hyperstress_2", "hyperstress_3"), "Pa m"),
        "principal_stresses": "Pa",
        "displacement": "m",
        "reference_map": "m",
    }
    whole = name.rpartition("_")[0] if name.rpartition("_")[2].isdigit() else name
    return units.get(whole, "")


def title_of(name: str) -> str:
    """A field's name in words, with its unit."""
    title, unit = name.replace("_", " "), field_unit(name)
    return f"{title}, {unit}" if unit else title
