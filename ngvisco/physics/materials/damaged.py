"""Materials that break: a damage d, 0 for intact and 1 for broken matter, degrades the energy.

Per actual volume, with A = 1/J for a material at finite strain and A = 1 for a linearised one,

    phi = g(d) a(z) + c(z) + A G_c (w(d) + l^2 |q|^2) / (c_w l),     g(d) = (1 - k)(1 - d)^2 + k,

where q is the gradient of d, a is the degraded part of the energy and c the rest: c = 0, or the energy of
volumetric compression.  The last term of phi is G_c times the density of a crack's surface (Pham et al., Int.
J.  Damage Mech. 20, 2011).  ``AT2`` (Ambrosio and Tortorelli) has w = d^2, c_w = 2; ``AT1`` has w = d, c_w =
8/3, and is elastic up to a threshold.

The matter carries d and its gradient.  The actual gradient is q = grad d, with dq/dt + (v . grad) q = -L^T q;
its conjugate gives the stress of the gradient term.  The referential gradient is q = F^T grad d, with the
distortion F since the start, creep included. It is constant at a point of the matter, dq/dt + (v . grad) q =
0. Its term therefore has no stress, and a stretched crack keeps its energy.  phi is convex in z for given (d,
q) and in (d, q) for given z, but not jointly.  Therefore the conjugates of z use the damage at the step's
start (``Material.lagged``), and damage grows after the step, with z fixed (``ngvisco.forms.damage``; the
staggered scheme of Roubicek, arXiv:2510.10355).
"""

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from ngsolve import CF

from ngvisco.errors import ParameterError, Quantity, require_known, require_some_names
from ngvisco.physics.material import Material, Wrapper, part_of, rest_stress_and_modulus
from ngvisco.physics.materials.network import Branches, Network
from ngvisco.physics.materials.thermal import entropy_in
from ngvisco.physics.parameters import Parameter, expressions_in, parameters_in
from ngvisco.physics.pointwise import energies_at, rest_state
from ngvisco.physics.tensors import IDENTITY, Tensor, identity_like, if_positive, log, sph, square, tr
from ngvisco.physics.variables import Jacobian, LogJacobian, ReciprocalJacobian, SmallStrain, Values, Variable
from ngvisco.words import Words, call


@dataclass(frozen=True)
class DamageVariable(Parameter):
    """The damage d in [0, 1], carried by the matter: 0 intact, 1 broken.  Moduli may be expressions of d."""

    name: str = "damage"
    start: float = 0.0
    limits: ClassVar[tuple[float, float] | None] = (0.0, 1.0)


@dataclass(frozen=True)
class DamageSlope(Variable):
    """The gradient q = grad d, 1/m, as the first column of a tensor: dq/dt = -L^T q."""

    name: str = "grad_damage"
    kind: str = "vector"

    is_strain = False
    own_scale = 0.0
    creeps = False

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        return -L.trans * z[self.name]

    def from_distortion(self, F: Tensor) -> Tensor:
        """Zero; the run computes the gradient of the initial damage."""
        return 0 * F

    def turned(self, value: Tensor, Q: Tensor) -> Tensor:
        return Q * value


@dataclass(frozen=True)
class ReferentialDamageSlope(DamageSlope):
    """The gradient q = F^T grad d, 1/m, with the distortion F since the start: dq/dt = 0."""

    name: str = "referential_grad_damage"

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        return 0 * z[self.name]

    def turned(self, value: Tensor, Q: Tensor) -> Tensor:
        return value


@dataclass(frozen=True)
class WholeDistortion(Variable):
    """The distortion F since the start, elastic and creep together: dF/dt = L F.  No energy reads it."""

    name: str = "whole_F"
    kind: str = "full"

    is_strain = False
    creeps = False

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        return L * z[self.name]

    def from_distortion(self, F: Tensor) -> Tensor:
        return F

    def turned(self, value: Tensor, Q: Tensor) -> Tensor:
        return Q * value


DAMAGE, SLOPE = DamageVariable(), DamageSlope()
REFERENTIAL_SLOPE, WHOLE_F = ReferentialDamageSlope(), WholeDistortion()


@dataclass(frozen=True, kw_only=True)
class Damaged(Wrapper):
    """A material that breaks, by a phase field of its damage d in [0, 1] (module's docstring).

    The energy of the intact material is counted from rest, where its stress has to vanish.  A fully formed
    crack has the energy G_c times its area. Across the crack, d = exp(-|x|/l) (AT2) or (1 - |x|/2l)^2 (AT1).

    With ``area="actual"`` x and l are lengths in the actual place, and at J = 1 G_c is per deformed area of
    the crack.  In matter that is stretched by lambda across the crack, the crack's energy is G_c/lambda per
    reference area. A crack from before the stretch keeps (1 + 1/lambda^2)/2 of its energy.  With
    ``area="reference"`` x and l are lengths of the body at its start, G_c is per reference area, and the
    crack keeps its energy; the body then also carries its distortion since the start.  Without healing d
    falls only by errors of transport, where matter moves through the mesh.

    Raises ParameterError if a parameter is out of its range, or if the material has stress at rest, an energy
    without an expression, or a variable whose spherical part is unknown. A material of small strain has one
    area, so that ``"reference"`` is refused.

    Example::

        import ngvisco as nv

        rubber = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0)
        material = nv.Damaged(material=rubber, G_c=0.1, length=0.05)
        print([variable.name for variable in material.variables])

    Parameters
    ----------
    material : Material
        The intact material; at finite strain A = 1/J is carried beside its variables.
    G_c : float
        Energy of a crack per area of the actual or the reference state, as ``area`` says.
    length : float
        Width l of a smeared crack; cells of l/2 or less resolve it.
    law : str
        ``"AT2"``, with damage from the first load on, or ``"AT1"``, with damage above a threshold.
    area : str
        State in which G_c and l measure areas and lengths: ``"actual"``, the deformed body, or
        ``"reference"``, the body at its start.
    part : str
        Degraded energy: ``"all"``, or ``"tensile"``, all but the energy of volumetric compression.
    viscosity : float
        Coefficient eta of the dissipation eta (dd/dt)^2 of growing damage.
    healing_viscosity : float, optional
        Coefficient eta of falling damage; None (default) for no healing.
    floor : float
        Share k of the degraded energy that a broken material keeps.
    breaking : sequence of str, optional
        Names of the branches of a ``Network`` that break; None (default) for the whole material.
    """

    G_c: Annotated[float, Quantity("J/m^2", "> 0", 0.1)]
    length: Annotated[float, Quantity("m", "> 0", 0.05)]
    law: Annotated[Literal["AT1", "AT2"], Quantity(example="AT1")] = "AT2"
    area: Annotated[Literal["actual", "reference"], Quantity(example="reference")] = "actual"
    part: Annotated[Literal["all", "tensile"], Quantity(example="all")] = "tensile"
    viscosity: Annotated[float, Quantity("Pa s", ">= 0", 0.01)] = 0.0
    healing_viscosity: Annotated[float | None, Quantity("Pa s", "> 0", 1.0)] = None
    floor: Annotated[float, Quantity("1", "in (0, 1)", 1e-6)] = 1e-6
    breaking: Annotated[tuple[str, ...] | None, Quantity(example=["slow"])] = None
    _rest: float | None = field(init=False, repr=False, default=None)
    """Energy phi at rest without damage, Pa; None if moduli differ from place to place."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.area == "reference" and self.is_linearised:
            expected = (
                "'actual' with a material of small strain, since actual and reference areas are then equal"
            )
            raise ParameterError("Damaged.area", self.area, expected)
        expected = ""
        if part_of(self.material, Damaged) is not None:
            expected = "a material without damage"
        elif entropy_in(self.material) is not None:
            advice = "a material without heat; for heat and damage put "
            expected = Words(advice, call("Thermal", material=...), " around the damaged material")
        elif self.material.response(3) is not None:
            expected = "a material whose energy is an expression, not that of a Yosida approximation"
        elif any(parameter.name == DAMAGE.name for parameter in parameters_in((self.material,))):
            expected = (
                "a material whose moduli do not read the damage, since g(d) already degrades the energy"
            )
        if expected:
            raise ParameterError("Damaged.material", self.material, expected)
        self._check_branches()
        self._check_rest()

    def _check_branches(self) -> None:
        """Raise ParameterError or UnknownNameError for names of branches that the material does not have."""
        if self.breaking is None:
            return
        if not isinstance(self.material, Network):
            expected = ", since the material has no branches"
            raise ParameterError("Damaged.breaking", self.breaking, None, expected)
        object.__setattr__(self, "breaking", tuple(require_some_names("Damaged.breaking", self.breaking)))
        require_known("branch", self.breaking, self.material.parts, "Damaged.breaking")

    @property
    def _breaking(self) -> Material:
        """The part of the material that breaks."""
        if self.breaking is None or not isinstance(self.material, Network):
            return self.material
        return Branches(network=self.material, names=self.breaking)

    def _check_rest(self) -> None:
        """Raise ParameterError for a variable without known spherical states, or for stress at rest."""
        for v in self.material.variables:
            is_spherical = isinstance(v, (SmallStrain, Jacobian, ReciprocalJacobian, LogJacobian, Parameter))
            if not is_spherical and v.volume_ratio(CF((1, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))) is None:
                expected = f"a material without {v.name!r}, a variable whose spherical part is unknown"
                raise ParameterError("Damaged.material", self.material, expected)
        if any(True for _ in expressions_in(self.material)):
            return
        energy_at_rest = float(energies_at(self._breaking, rest_state(self.material, 3)[None], 3)[0])
        slope, stiffness = rest_stress_and_modulus(self._breaking)
        if not abs(slope) <= 1e-9 * max(abs(stiffness), abs(energy_at_rest)):
            expected = (
                "a material without stress at rest, such as ReferentialNeoHookean, but d phi/dJ at rest is "
                f"{slope:.4g} Pa"
            )
            raise ParameterError("Damaged.material", self.material, expected)
        object.__setattr__(self, "_rest", energy_at_rest)

    @property
    def is_linearised(self) -> bool:
        """Whether the material is of small strain, so that its volume does not change."""
        return all(isinstance(v, SmallStrain) for v in self.material.variables)

    @property
    def variables(self) -> tuple[Variable, ...]:
        carried = self.material.variables
        volume = () if self.is_linearised or ReciprocalJacobian() in carried else (ReciprocalJacobian(),)
        return (*carried, *volume, *(() if self.area == "actual" else (WHOLE_F,)), DAMAGE, self.slope)

    @property
    def slope(self) -> DamageSlope:
        """The damage gradient that the matter carries, actual or referential."""
        return SLOPE if self.area == "actual" else REFERENTIAL_SLOPE

    @property
    def lagged(self) -> frozenset[str]:
        return frozenset((DAMAGE.name, self.slope.name))

    @property
    def conformation(self) -> str | None:
        return None

    def conformation_of(self, branch: str) -> str | None:
        return None

    def degradation(self, d: Any) -> Any:
        """The degradation g(d)."""
        return (1 - self.floor) * (1 - d) * (1 - d) + self.floor

    @property
    def surface(self) -> tuple[float, float]:
        """The factors G_c/(c_w l) of w(d), Pa, and G_c l/c_w of |q|^2, Pa m^2."""
        weight = self.G_c / (2 if self.law == "AT2" else 8 / 3)
        return weight / self.length, weight * self.length

    def weight(self, z: Values) -> Any:
        """Reference volume per actual volume, A; 1 for a linearised material."""
        return 1.0 if self.is_linearised else z["A"]

    def parts(self, z: Values) -> tuple[Tensor, Tensor | None]:
        """The degraded part a(z) of the energy, Pa, and the rest c(z), Pa, or None without a rest."""
        values = {v.name: z[v.name] for v in self.material.variables}
        whole = self._breaking.energy(values)
        left = None if self.breaking is None else self.material.energy(values) - whole
        if self.is_linearised:
            if self.part == "all":
                return whole, left
            compressed = self._breaking.energy({name: sph(E) for name, E in values.items()})
            compression = -tr(next(iter(values.values())))  # one trace for all branches
        else:
            energy_at_rest = (
                self._spherical_energy(values, 1 + 0 * z["A"]) if self._rest is None else self._rest
            )
            whole = whole - energy_at_rest * z["A"]
            if self.part == "all":
                return whole, left
            J = values["J"] if "J" in values else 1 / z["A"]
            compressed, compression = self._spherical_energy(values, J) - energy_at_rest / J, 1 - J
        kept = if_positive(compression, compressed, 0 * compressed)
        return whole - kept, kept if left is None else kept + left

    def _spherical_energy(self, z: Values, J: Any) -> Any:
        """phi without damage at F = J^{1/3} I. ``z`` gives the parameters; J is an array or a function."""
        state: dict[str, Any] = {}
        for v in self.material.variables:
            if isinstance(v, Parameter):
                state[v.name] = z[v.name]
            elif isinstance(v, LogJacobian):
                state[v.name] = log(J) / J
            else:
                ratio = v.volume_ratio(CF(1.0) if v.kind == "scalar" else IDENTITY)
                assert ratio is not None  # ``_check_rest`` has checked it
                power = ratio[1] if v.kind == "scalar" else ratio[1] / 3
                size = J if power == 1 else J ** float(power)
                state[v.name] = size if v.kind == "scalar" else size * identity_like(z[v.name])
        return self._breaking.energy(state)

    def surface_energy(self, z: Values) -> Tensor:
        """The surface energy of cracks, per actual volume, Pa."""
        d, q = z[DAMAGE.name], z[self.slope.name]
        of_damage, of_slope = self.surface
        w = d * d if self.law == "AT2" else d
        return self.weight(z) * (of_damage * w + of_slope * square(q))

    def degraded_energy(self, z: Values) -> Tensor:
        """The energy without the energy of cracks, Pa, per actual volume."""
        degraded, kept = self.parts(z)
        phi = self.degradation(z[DAMAGE.name]) * degraded
        return phi if kept is None else phi + kept

    def energy(self, z: Values) -> Tensor:
        return self.degraded_energy(z) + self.surface_energy(z)


@dataclass(frozen=True, kw_only=True)
class WithoutCracks(Material):
    """A material that breaks, without the energy of its cracks and the gradient that this energy reads."""

    material: Damaged

    @property
    def variables(self) -> tuple[Variable, ...]:
        return tuple(v for v in self.material.variables if not isinstance(v, DamageSlope))

    def energy(self, z: Values) -> Tensor:
        return self.material.degraded_energy(z)
