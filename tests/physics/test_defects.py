"""Relative defects: zero for variables of one distortion, the perturbation's size for others."""

import numpy as np
import pytest
from materials import examples
from support import tensor, tensors, value, values

from ngvisco.physics.defects import relative_defects

EXAMPLES = {e.constructor: e.material for e in examples()}
PAIRED = {
    name: material
    for name, material in EXAMPLES.items()
    if not name.startswith(("LinearElastic", "Hardening", "IsotropicStrain", "Barotropic"))
}
F = np.eye(3) + 0.3 * np.random.default_rng(0).uniform(-1, 1, (3, 3))


def state(material):
    return values({v.name: v.from_distortion(tensor(F)) for v in material.variables})


def defects(material, z, traced=()):
    return {name: float(value(d)) for name, d in relative_defects(material, tensors(z), traced).items()}


@pytest.mark.parametrize("name", PAIRED)
def test_variables_of_one_distortion_have_no_defect(name):
    found = defects(PAIRED[name], state(PAIRED[name]))
    assert found and max(map(abs, found.values())) < 1e-12


@pytest.mark.parametrize("name", PAIRED)
def test_a_change_of_any_single_variable_is_a_defect(name):
    """Each variable in turn is wrong by 5 %. J cannot be compared with tensors of determinant one, which do
    not contain J."""
    z = state(PAIRED[name])
    ratios = [v.volume_ratio(tensor(z[v.name])) for v in PAIRED[name].variables if v.creeps]
    isochoric = all(abs(n) < 1e-12 for _, n in ratios)
    for variable in PAIRED[name].variables:
        if isochoric and not variable.creeps:
            continue
        changed = z | {variable.name: 1.05 * z[variable.name]}
        if variable.name == "K":
            changed["K"] = z["K"] + 0.05 * z["A"]
        assert 0.02 < max(map(abs, defects(PAIRED[name], changed).values())) < 0.5, variable.name


def test_a_relaxing_determinant_is_not_a_defect():
    z = state(EXAMPLES["OldroydB"])
    assert "det B and 1" in defects(EXAMPLES["OldroydB"], z)
    assert defects(EXAMPLES["OldroydB"], z, ["B"]) == {}
