"""Warnings of unbalanced stresses at rest (F = I), at interfaces of bodies and on open walls.

An energy per actual volume has the stress phi(I) I at rest, in addition to its derivatives' stress: a
``NeoHookean`` body is under tension at rest, a ``BarotropicFluid`` under pressure.  A body alone in its box
does not feel this stress; a drop in another body, and a body between open walls, move from the first step on.
"""

from __future__ import annotations

from collections.abc import Iterator

from ngsolve import BND, CF, BoundaryFromVolumeCF, Integrate, specialcf

from ngvisco.forms.boundary.wall_terms import GivenStress
from ngvisco.forms.system import Step
from ngvisco.physics.material import cauchy_stress, rest_stress_and_modulus
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.walls import Open
from ngvisco.words import Mention, Words

_ROUNDING = 1e-9
"""Share of the stiffness below which a stress counts as rounding."""
_MATTERS = 0.01
"""Share of a wall's stress at rest that may be unbalanced; and least share of the largest stress at rest that
a wall must have for a warning."""
_REMEDY = (
    "Take energies without stress at rest (ReferentialNeoHookean, OldroydB, ...), subtract the constant T(I) "
    "from an energy of your own, "
)


def where_bodies_meet(step: Step) -> Iterator[str]:
    """Yield a warning of bodies with different stresses at rest, which push each other."""
    stresses, rounding = _at_rest(step) if step.model.bodies else ({}, 0.0)
    if stresses and max(stresses.values()) - min(stresses.values()) > rounding:
        names = ", ".join(repr(name) for name in stresses)
        values = ", ".join(f"{stress:.4g} Pa" for stress in stresses.values())
        message = (
            f"bodies {names} meet with different stresses at rest (the mean normal stresses T(I) are "
            f"{values}). The bodies move from the first step on until their stresses balance. {_REMEDY}or "
            "start from states with equal stresses (by "
        )
        yield Words(message, Mention("Initial.F"), ", or by J in ", Mention("Initial.values"), ")")


def on_open_walls(step: Step) -> Iterator[str]:
    """Yield a warning of open walls whose stress does not balance the matter's stress at rest.

    T is the stress of the start state, and t the wall's stress. T(I) is the stress of matter at rest,
    weighted by the bodies' fractions.  T n - t is compared with T(I), both as roots of mean squares over the
    wall.  There is no warning if matter is under pressure at rest and the wall gives a pressure, as for a gas
    that flows in or out.
    """
    walls = [name for name, wall in step.walls.conditions.items() if isinstance(wall, Open)]
    material = step.model.material
    stresses, rounding = _at_rest(step) if walls else ({}, 0.0)
    largest = max((abs(stress) for stress in stresses.values()), default=0.0)
    if not largest > rounding:
        return
    u, dim = step.now, step.mesh.dim
    at_rest = CF(stresses.get("", 0.0))
    if isinstance(material, Mixture):
        shares = material.fractions.at(u.z_tensors)
        at_rest = sum((stresses[name] * share for name, share in shares.items()), CF(0.0))
    T = cauchy_stress(material, u.z_tensors, u.zeta_tensors, step.energy.anywhere(u))
    inside, rest_stress, n = BoundaryFromVolumeCF(T), BoundaryFromVolumeCF(CF(at_rest)), specialcf.normal(dim)
    unborne = []
    for name in walls:
        given = GivenStress(step.walls, name).at(u, n)
        load = CF(tuple(sum(inside[i, j] * n[j] for j in range(dim)) - given[i] for i in range(dim)))
        means = CF((CF(1.0), load * load, rest_stress * rest_stress, rest_stress, given * n))
        area, *sums = Integrate(means, step.mesh, BND, definedon=step.walls.region([name]))
        gap, size, mean, push = (total / area for total in sums)
        gap, size = gap**0.5, size**0.5
        is_pressed = mean < 0 and push < 0
        if size > _MATTERS * largest and gap > _MATTERS * size and not is_pressed:
            given_stress = f"the given stress {push:.6g} Pa, the difference {gap:.3g} Pa"
            unborne.append(f"at {name!r} T(I) is {mean:.6g} Pa, {given_stress}")
    if unborne:
        yield (
            "at open walls the mean normal stress of the matter at rest, T(I), is not the given stress, and "
            f"the difference loads the body from the first step on: {'; '.join(unborne)}. {_REMEDY}or give "
            "the walls a pressure of -T(I) in addition to other loads"
        )


def _at_rest(step: Step) -> tuple[dict[str, float], float]:
    """Mean normal stresses at rest, Pa, by the bodies' names, "" for a single material, and the stress up to
    which a stress counts as rounding, Pa."""
    laws = {body.name: body.material for body in step.model.bodies} or {"": step.model.material}
    of_laws = {name: rest_stress_and_modulus(law) for name, law in laws.items()}
    rounding = _ROUNDING * max(abs(modulus) for _, modulus in of_laws.values())
    return {name: stress for name, (stress, _) in of_laws.items()}, rounding
