"""``Model(material=...)`` and ``Model(bodies=[...])`` with one body give the same run."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from flow_rules import EXAMPLES as RULES
from materials import examples
from ngsolve import CF, log
from support import each_once, others_by_ci, tensor, tensors, value, values

import ngvisco as nv
from ngvisco.errors import ParameterError
from ngvisco.geometries import box
from ngvisco.physics.material import cauchy_stress
from ngvisco.physics.mixture import Mixture

STRETCH = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.1], [0.05, 0.0, 1.2]])
STRAIN, THETA = 0.4, 310.0
"""Plastic strain k, and temperature, K."""


def both(material, **parts):
    """The models of one material and of one body."""
    own = {name: part for name, part in parts.items() if name in ("creep", "viscosity")}
    body = nv.Body(name="one", material=material, density=1.0, **own)
    others = {name: part for name, part in parts.items() if name not in own}
    return nv.Model(material=material, **parts), nv.Model(bodies=[body], **others)


def takes_both(material):
    try:
        both(material)
    except ParameterError:
        return False
    return True


MATERIALS = {each.constructor: each.material for each in examples() if takes_both(each.material)}


def test_the_tests_of_one_body_have_materials_of_every_kind():
    """If a body were refused, the other tests would have no cases."""
    kinds = {type(material).__name__ for material in MATERIALS.values()}
    assert kinds >= {"ReferentialNeoHookean", "IsochoricNeoHookean", "ReferentialMooneyRivlin"}
    assert kinds >= {"LogarithmicNeoHookean", "BarotropicFluid"}


def state(model):
    """Values of all carried variables of a model, for one distortion, plastic strain and temperature."""
    material, volume = model.material, float(np.linalg.det(STRETCH))
    if isinstance(material, Mixture):
        z = material.filled({"one": 1.0}, tensor(STRETCH))
    else:
        z = {v.name: v.from_distortion(tensor(STRETCH)) for v in material.variables if v.name != "s"}
    z |= {name: CF(STRAIN / volume) for v in material.variables if (name := v.name).startswith("plastic")}
    if (thermal := getattr(material, "heat", None)) is not None:
        amounts = {"one": CF(1 / volume)}
        z["s"] = thermal.total(amounts, log(CF(THETA)), CF(volume))
    elif any(v.name == "s" for v in material.variables):
        z["s"] = nv.physics.material.part_of(material, nv.Thermal).start(CF(THETA), CF(1 / volume))
    return tensors(values({name: CF(each) for name, each in z.items()}))


def stress(model):
    return value(cauchy_stress(model.material, state(model)))


HARDENING = {"none": None, "linear": RULES["linear hardening"], "Voce": RULES["Voce"]}


@pytest.mark.parametrize(("name", "rule", "heat"), each_once(MATERIALS, HARDENING, [False, True]))
def test_one_body_has_the_stress_of_its_material(name, rule, heat):
    material = MATERIALS[name]
    if heat:
        material = nv.Thermal(material=material, c=2.0, theta_R=300.0, expansion=1e-3)
    one, other = (stress(model) for model in both(material, creep=HARDENING[rule]))
    assert np.abs(one - other).max() <= 1e-12 * np.abs(one).max()


@pytest.mark.parametrize("name", ["LinearElastic", "ReferentialNeoHookean"])
def test_hardening_causes_no_pressure(name):
    """The mean stress is the same with and without a plastic strain."""
    material = getattr(nv, name)(K_e=10.0, G_e=5.0)
    found = []
    for rule in (None, nv.Perzyna(sigma_Y=0.5, G_m=0.5, H=3.0)):
        model = nv.Model(material=material, creep=rule)
        found.append(np.trace(stress(model)) / 3)
    assert found[1] == pytest.approx(found[0], rel=1e-12)


BY_DEFAULT = ("Perzyna, n = 2.5", "split"), ("Drucker-Prager", "coupled"), ("composite", "coupled")


@pytest.mark.parametrize(
    ("name", "solver"),
    others_by_ci(product(RULES, ("split", "coupled")), *BY_DEFAULT),
)
def test_one_body_relaxes_like_a_material(name, solver):
    """A stretched body that cannot move has the same stress, plastic strain and heat after three steps."""
    material = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0, elastic_state="B")
    rule = RULES[name]
    if name != "activated":
        material = nv.Thermal(material=material, c=2.0, theta_R=300.0, expansion=1e-3)
    start = CF(tuple(np.diag([1.15, 0.95, 0.97]).ravel()), dims=(3, 3))
    found = []
    for model in both(material, creep=rule, viscosity=nv.StokesViscosity(K_v=1.0, G_v=1.0)):
        initial = nv.Initial(density=None if model.bodies else 1.0, F=start)
        if name != "activated":
            initial = replace(initial, temperature=300.0)
        run = nv.Simulation(box((1, 1), maxh=1.0), model, dt=0.02, initial=initial, solver=solver)
        run.run(0.06)
        at, fields = run.mesh(0.3, 0.4), run.fields
        kept = [np.ravel(fields["cauchy_stress"](at)), fields["temperature"](at) if "s" in fields else 0.0]
        kept += [fields[n](at) for n in fields if n.startswith("plastic_strain")]
        found.append(np.hstack(kept))
    assert len(found[0]) == len(found[1])
    # a single body has the fraction 1 + 1e-6
    assert found[0] == pytest.approx(found[1], rel=3e-6, abs=3e-6)
