"""Defects of the relations between variables of one distortion.

Exact solutions have J = det F and H = Cof F.  The discrete variables are transported independently and drift
apart, slowly in a solid and without bound where F winds up (``materials.hyperelastic``).  The ledger does not
show the drift: the scheme's energy identity treats F, H and J as independent.
"""

from collections.abc import Collection

from ngsolve import Cof, Det, log, sqrt

from ngvisco.physics.material import Material, part_of
from ngvisco.physics.materials.hyperelastic import IsotropicElastic
from ngvisco.physics.tensors import Tensor, if_positive, square
from ngvisco.physics.variables import (
    Cofactor,
    CofactorLeftCauchyGreen,
    Distortion,
    DistortionTensor,
    Jacobian,
    LeftCauchyGreen,
    LogJacobian,
    ReciprocalJacobian,
    Values,
)

DRIFT = 0.1
"""Largest cell mean of |det F/J - 1| with which a step is accepted. The stress can then have an error of this
size."""


def parted(material: Material, pair: str, rms: float, largest: float, where: str) -> str:
    """The run's message about a ``pair`` of variables: their relative differences ``rms`` and ``largest``,
    and the place ``where`` of the largest one."""
    return (
        f"{pair} differ by {rms:.1%} in the mean square, and by {largest:.1%} {where}. The variables no "
        "longer belong to one distortion, so that the stress at a point can be wrong by as much, although "
        f"the ledger closes. Take {remedy(material)}"
    )


def relative_defects(material: Material, z: Values, traced: Collection[str] = ()) -> dict[str, Tensor]:
    """Relative defects of the variables' relations, by the names of the two sides; empty without relations.

    * ``"det F and J"``: det z |J|^-n - 1 for each tensor z, n from its exponent; ``"det B and 1"`` for n = 0,
    * ``"H and Cof F"``: |H - Cof F|/|Cof F| with the factors of J, likewise for N and B,
    * ``"A and J"``: A J - 1; and ``"K and A"``: K/A + ln A.

    The first relation omits ``traced`` variables. Their creep rate has a trace, so that J does not determine
    their determinant.
    """
    variables = {v.name: v for v in material.variables}
    defects: dict[str, Tensor] = {}
    volume = next((v for v in material.variables if isinstance(v, (Jacobian, ReciprocalJacobian))), None)
    for variable in material.variables:
        ratio = variable.volume_ratio(z[variable.name])
        if variable == volume or ratio is None or variable.name in traced:
            continue
        det, n = ratio
        if abs(n) < 1e-12:
            defects[f"det {variable.name} and 1"] = det - 1
        elif volume is not None:
            J = z[volume.name] if isinstance(volume, Jacobian) else 1 / z[volume.name]
            J = sqrt(J * J) if volume.name in material.continued else J  # a continued J may be negative
            name = f"det {variable.name}" if variable.creeps else variable.name
            defects[f"{name} and {volume.name}"] = det * J ** float(-n) - 1
    for name, variable in variables.items():
        if isinstance(variable, LogJacobian):
            A = z[variable.reciprocal]
            defects[f"{name} and {variable.reciprocal}"] = z[name] / A + log(A)
    for kind, partner_kind in ((Cofactor, Distortion), (CofactorLeftCauchyGreen, LeftCauchyGreen)):
        for name in [name for name, v in variables.items() if isinstance(v, kind)]:
            distortion = next(names for names in material.distortions.values() if name in names)
            partner = next((n for n in distortion if isinstance(variables[n], partner_kind)), None)
            if partner is not None:
                cofactor = Cof(z[partner])
                # J^b Cof F is a multiple of Cof z for z = J^a F; without J the multiple is unknown
                scale = sqrt(square(z[name]) / square(cofactor))
                gap = sqrt(square(z[name] - scale * cofactor) / square(z[name]))
                defects[f"{name} and Cof {partner}"] = gap
    return defects


def drifts(material: Material, z: Values, traced: Collection[str] = ()) -> dict[str, Tensor]:
    """The drift det F/J - 1 of each tensor that is carried beside J, by the names of both.

    F is the distortion of the tensor z.  det z = J^n (det F/J)^d, where d is 1 for F and 2 for F F^T and Cof
    F; without drift det z = J^n.  Variables in ``Material.continued`` have no drift, as their J may be <= 0.

    For F F^T only a loss of det F counts, so that the drift is at most zero. A mean of such tensors has a
    larger determinant than the tensors (Minkowski), and an energy above that at rest.  A mean of F over
    different rotations has a smaller determinant, so that energy at rest becomes motion.
    """
    volume = next((v for v in material.variables if isinstance(v, (Jacobian, ReciprocalJacobian))), None)
    if volume is None or volume.name in material.continued:
        return {}
    J = z[volume.name] if isinstance(volume, Jacobian) else 1 / z[volume.name]
    result = {}
    for v in material.variables:
        if isinstance(v, DistortionTensor) and not {v.name} & {*traced, *material.continued}:
            n, d = 3 * v.exponent + v.degree, 1 / v.degree
            drift = (Det(z[v.name]) * J ** float(-n)) ** d - 1
            is_lost = v.frame == "actual"
            result[f"det {v.name} and {volume.name}"] = if_positive(drift, 0.0, drift) if is_lost else drift
    return result


def may_part(material: Material, moves: bool) -> str | None:
    """The warning before a run whose variables may drift apart; None if they hardly drift.

    ``moves`` says whether walls move.
    """
    law = part_of(material, IsotropicElastic)  # type: ignore[type-abstract]
    if law is None or law.is_by_B or not moves:
        return None
    return (
        "this material carries F and J independently, and det F drifts from J where walls move. The run ends "
        f'if det F and J differ by {DRIFT:.0%} in the mean of a cell. Take elastic_state = "B" to avoid this'
    )


def remedy(material: Material) -> str:
    """The part of a message that says how to keep the variables of a material together."""
    better = "shorter steps and a finer mesh"
    if not any(v.frame == "relaxed" for v in material.variables):
        return better
    if isinstance(material, IsotropicElastic):
        return f'material.elastic_state = "B" for a body that flows, or {better}'
    return f"variables by B = F F^T for a body that flows and has an isotropic energy, or {better}"
