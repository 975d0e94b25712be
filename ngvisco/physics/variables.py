"""Transported variables and their kinematic rates.

A variable z obeys  dt z + (v . grad) z = rate(z; L, Pi)  with L = grad v, L_ij = d_j v_i, and the inelastic
distortion rate Pi (symmetric, tr Pi = 0).  Every rate is affine in z and linear in (L, Pi); the
discretisation and the derived stresses use nothing else.

| variable      | rate                                  | paper                          |
|---------------|---------------------------------------|--------------------------------|
| E             | eps(v) + W E - E W - Pi               | Euler-small-flow-rule, ZJ      |
| F             | L F - F Pi                            | ED-Euler-large2                |
| J = det F     | (tr L) J                              | DT-det-extended                |
| H = Cof F     | (tr L) H - L^T H + H Pi^T             | H-flow-rule                    |
| H = J^a F     | a (tr L) H + L H - H Pi               | rem-behind-polyconvexity       |
| H = J^b Cof F | (1 + b)(tr L) H - L^T H + H Pi^T      | exa-Mooney–Rivlin-ref          |
| A = 1/J       | -(tr L) A                             | DT-det-inverse                 |
| c             | -(tr L) c                             | none: ``Concentration`` |
| K = ln J / J  | (tr L)(A - K)                         | exa-neo-Hookean-ref            |
| J^a F F^T     | L B + B L^T + a (tr L) B - 2 sym(Pi B) | none, see ``LeftCauchyGreen``  |
| J^b Cof F F^T | (2 + b)(tr L) N - 2 sym(N L) + 2 sym(Pi N) | none, see ``CofactorLeftCauchyGreen`` |

The last two are for isotropic energies, as they do not contain the rotation of F. The Pi of the last two is
the creep rate in the actual frame; the Pi of F is in the relaxed frame.  All variables of a material are of
one frame.

The cofactor rows are the paper's (Cof' F)(L F - F Pi) written out, d/dt (J F^-T) with tr Pi = 0.  For
Mooney-Rivlin the paper prints (Cof' F)((grad v)H - H Pi) - (7/6)(div v)H, a misprint: the derivative of H =
J^{-7/6} Cof F is in the table's row for J^b Cof F, with b = -7/6.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias

from ngsolve import CF, Cof, Det, log

from ngvisco.errors import ParameterError, require_numbers
from ngvisco.physics.tensors import IDENTITY, Tensor, skw, sym, tr

Values = Mapping[str, Tensor]

CreepFrame: TypeAlias = Literal["relaxed", "actual"]

PRESSURE, TEMPERATURE, HARDENING, CONFORMATION = "pressure", "temperature", "hardening", "conformation"
"""Names of values that laws may read, in ``Values``: the pressure -tr T/3, Pa; the temperature, K; the growth
of the yield stress by hardening, Pa; and the conformation tensor of the flow."""

INTERFACE = "interface"
"""Name, in ``Values`` for the viscosity of several bodies, of n x n, 3x3. n is the normal of the bodies'
interface at a step's start; n x n is zero away from interfaces."""
PARTED = "parted"
"""Name, in ``Values`` for rates, of the shares from ``Material.parted`` at a step's start."""
STEP = "step"
"""Name, in ``Values`` for laws of several bodies, of one over the step's length, 1/s."""


@dataclass(frozen=True)
class Variable(ABC):
    """A transported variable."""

    name: str
    """Key of the variable in ``Values``, e.g. ``"F"``."""
    kind: str
    """``"scalar"``, ``"symmetric"`` or ``"full"`` (3x3), or ``"vector"``, the first column of a tensor."""

    is_strain = True
    """Whether the energy has to be convex in the variable, jointly with all strains. False for parameters."""
    is_conserved = False
    """Whether rate(z; L, Pi) = -(tr L) z, without a production, so that int z is conserved."""
    density = 0.0
    """Mass density per unit of the variable, kg/m^3; 0 for a variable that is no amount of matter."""
    own_scale: ClassVar[float | None] = None
    """None for a variable whose increments count together with those of the strains. A number for a variable
    that may have another unit and counts by itself, with the size that ``Step.sizes_apart`` makes of it."""

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name.isidentifier()):
            raise ParameterError("Variable.name", self.name, "a Python identifier")
        if self.kind not in ("scalar", "vector", "symmetric", "full"):
            raise ParameterError("Variable.kind", self.kind, "'scalar', 'vector', 'symmetric' or 'full'")

    @abstractmethod
    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        """The rate dt z + (v . grad) z, in 1/s, for the values ``z`` of all variables, L and Pi (3x3)."""

    @abstractmethod
    def from_distortion(self, F: Tensor) -> Tensor:
        """The variable's value for an elastic distortion F (3x3, det F > 0)."""

    @property
    def requires(self) -> tuple[str, ...]:
        """Names of other variables that the rate reads."""
        return ()

    def positive(self, value: Tensor) -> Values:
        """Scalars of the variable's value that must stay > 0, by their names in messages (``"det F"``).

        The implicit equations of a long step also have solutions of the wrong sign; a step that ends in such
        a solution is refused (paper: the local non-interpenetration of Euler-large-ass-phi).
        """
        return {}

    @property
    def by_flux(self) -> bool:
        """Whether the variable is a density, whose flux contains the part -(tr L) z of its rate."""
        return self.is_conserved

    @property
    def is_positive_definite(self) -> bool:
        """Whether the variable is a tensor with eigenvalues > 0; False for densities, which may vanish."""
        return False

    @property
    def creeps(self) -> bool:
        """Whether the rate depends on Pi; rates of functions of J do not, since tr Pi = 0."""
        return self.kind != "scalar"

    @property
    def frame(self) -> CreepFrame | None:
        """The frame of the rate's Pi; None if the variable does not creep.

        The Pi of F is in the relaxed configuration. The Pi of E and of F F^T is in the actual frame: it is Q
        Pi Q^T with the polar factor Q of F.
        """
        return "actual" if self.creeps else None

    def turned(self, value: Tensor, Q: Tensor) -> Tensor:
        """The value as an observer turned by the rotation Q (3x3) sees it."""
        return Q * value * Q.trans if self.creeps else value

    def volume_ratio(self, value: Tensor) -> tuple[Tensor, float] | None:
        """The pair (d, n) with d = J^n, where J is the determinant of the distortion; None for variables that
        do not determine J."""
        return None


@dataclass(frozen=True)
class SmallStrain(Variable):
    """Small elastic strain E with the Zaremba-Jaumann rate (paper: ZJ, Euler-small-flow-rule).

    The energy balance needs E_ZJ = eps(v) - Pi with G_m Pi = + dev S.  The paper prints G_m Pi = - dev T in
    Euler-small-flow-rule, but E_ZJ = eps(v) - R dev T, with the right sign, after eliminating Pi.
    """

    name: str = "E"
    kind: str = "symmetric"

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        E, W = z[self.name], skw(L)
        return sym(L) + W * E - E * W - Pi

    def from_distortion(self, F: Tensor) -> Tensor:
        return sym(F) - IDENTITY


@dataclass(frozen=True)
class DistortionTensor(Variable):
    """J^exponent times a tensor of the elastic distortion F; symmetric tensors are positive definite.

    Raises ParameterError if the exponent is not a finite number.
    """

    exponent: float = 0.0

    degree = 1
    """Exponent n for which J^n is the determinant of ``tensor``, that is without the factor J^exponent."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_numbers(type(self).__name__, "", float, exponent=self.exponent)

    @staticmethod
    @abstractmethod
    def tensor(F: Tensor) -> Tensor:
        """The tensor of F, without J^exponent."""

    def from_distortion(self, F: Tensor) -> Tensor:
        return Det(F) ** float(self.exponent) * self.tensor(F) if self.exponent else self.tensor(F)

    def positive(self, value: Tensor) -> Values:
        name, A = self.name, value
        plane = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
        minors = {f"{name}_11": A[0, 0], f"{name}_11 {name}_22 - {name}_12^2": plane}
        return (minors if self.kind == "symmetric" else {}) | {f"det {name}": Det(A)}

    @property
    def is_positive_definite(self) -> bool:
        return self.kind == "symmetric" and not self.by_flux

    @property
    def frame(self) -> CreepFrame | None:
        return "actual" if self.kind == "symmetric" else "relaxed"

    def turned(self, value: Tensor, Q: Tensor) -> Tensor:
        return super().turned(value, Q) if self.kind == "symmetric" else Q * value

    def volume_ratio(self, value: Tensor) -> tuple[Tensor, float] | None:
        return Det(value), 3 * self.exponent + self.degree


@dataclass(frozen=True)
class Distortion(DistortionTensor):
    """J^exponent F for the elastic distortion F (paper: ED-Euler-large2, rem-behind-polyconvexity)."""

    name: str = "F"
    kind: str = "full"

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        H = z[self.name]
        convected = L * H - H * Pi
        return convected + self.exponent * tr(L) * H if self.exponent else convected

    @staticmethod
    def tensor(F: Tensor) -> Tensor:
        return F


@dataclass(frozen=True)
class Cofactor(DistortionTensor):
    """J^exponent Cof F (paper: H-flow-rule; exa-Mooney–Rivlin-ref has the exponent -7/6, see the module)."""

    name: str = "H"
    kind: str = "full"

    degree = 2

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        H = z[self.name]
        return (1 + self.exponent) * tr(L) * H - L.trans * H + H * Pi.trans

    @staticmethod
    def tensor(F: Tensor) -> Tensor:
        return Cof(F)


@dataclass(frozen=True)
class LeftCauchyGreen(DistortionTensor):
    """B = J^exponent F F^T, the left Cauchy-Green tensor of the elastic distortion F.

    From dF/dt = L F - F Pi_R and dJ/dt = (tr L) J,

        dB/dt = L B + B L^T + a (tr L) B - 2 J^a F Pi_R F^T,   a = exponent.

    If the energy is isotropic, Pi_R is coaxial with F^T F, because M = G_m Pi_R is.  With the polar
    decomposition F = V Q, Pi = Q Pi_R Q^T is then coaxial with V, and F Pi_R F^T = V Pi V = Pi V^2.  The
    creep term is -Pi B - B Pi, where Pi is symmetric and trace-free with |Pi| = |Pi_R|, and G_m Pi = dev 2
    sym(zeta B).

    B is positive definite and det B = J^(3a + 2); |J^(a/2) F|^2 = tr B.
    """

    name: str = "B"
    kind: str = "symmetric"

    degree = 2

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        B = z[self.name]
        half = (L - Pi) * B
        rate = half + half.trans
        return rate + self.exponent * tr(L) * B if self.exponent else rate

    @staticmethod
    def tensor(F: Tensor) -> Tensor:
        return F * F.trans


@dataclass(frozen=True)
class CofactorLeftCauchyGreen(DistortionTensor):
    """N = J^exponent Cof(F F^T), which replaces the cofactor of F as ``LeftCauchyGreen`` replaces F.

    Cof(F F^T) = J^2 (F F^T)^-1, and from dB/dt = (L - Pi) B + B (L - Pi)^T follows
    dB^-1/dt = -B^-1 (L - Pi) - (L - Pi)^T B^-1, so that with b = exponent

        dN/dt = (2 + b)(tr L) N - L^T N - N L + Pi N + N Pi.

    N is positive definite, det N = J^(3b + 4), and |J^(b/2) Cof F|^2 = tr N.
    """

    name: str = "N"
    kind: str = "symmetric"

    degree = 4

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        N = z[self.name]
        half = (L.trans - Pi) * N
        return (2 + self.exponent) * tr(L) * N - half - half.trans

    @staticmethod
    def tensor(F: Tensor) -> Tensor:
        return Cof(F) * Cof(F).trans


@dataclass(frozen=True)
class Jacobian(Variable):
    """J = det F (paper: DT-det-extended); creep does not change it because tr Pi = 0."""

    name: str = "J"
    kind: str = "scalar"

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        return tr(L) * z[self.name]

    def from_distortion(self, F: Tensor) -> Tensor:
        return Det(F)

    def positive(self, value: Tensor) -> Values:
        return {self.name: value}

    def volume_ratio(self, value: Tensor) -> tuple[Tensor, float] | None:
        return value, 1.0


@dataclass(frozen=True)
class PerVolume(Variable):
    """An amount y per actual volume: dy/dt = -(tr L) y; by default zero at the start."""

    name: str
    kind: str = "scalar"

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        return -tr(L) * z[self.name]

    def from_distortion(self, F: Tensor) -> Tensor:
        return CF(0.0)


@dataclass(frozen=True)
class ReciprocalJacobian(PerVolume):
    """A = 1/J (paper: DT-det-inverse), the reference volume per actual volume."""

    name: str = "A"

    def from_distortion(self, F: Tensor) -> Tensor:
        return 1 / Det(F)

    def positive(self, value: Tensor) -> Values:
        return {self.name: value}

    def volume_ratio(self, value: Tensor) -> tuple[Tensor, float] | None:
        return value, -1.0


@dataclass(frozen=True)
class Concentration(PerVolume):
    """An amount per actual volume, such as a solute's: dc/dt = -(tr L) c, conserved; zero at the start."""

    name: str = "c"

    is_conserved = True
    own_scale = 1.0


@dataclass(frozen=True)
class LogJacobian(Variable):
    """K = ln J / J (paper: exa-neo-Hookean-ref); its rate reads A = 1/J."""

    name: str = "K"
    kind: str = "scalar"
    reciprocal: str = "A"

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        return tr(L) * (z[self.reciprocal] - z[self.name])

    def from_distortion(self, F: Tensor) -> Tensor:
        return log(Det(F)) / Det(F)

    @property
    def requires(self) -> tuple[str, ...]:
        return (self.reciprocal,)
