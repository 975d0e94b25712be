"""The part of a material's energy that damage degrades, at a point."""

import numpy as np
import pytest
from support import tensor, value

import ngvisco as nv

MATERIALS = {
    "small strain": nv.LinearElastic(K_e=10.0, G_e=5.0),
    "finite strain": nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0),
}


@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("stretch", [0.8, 1.2])
def test_damage_degrades_the_energy_of_expansion_but_not_of_compression(name, stretch):
    """The energy of a spherical strain, minus the energy at rest."""
    material = nv.Damaged(material=MATERIALS[name], G_c=1.0, length=0.5)
    z = {v.name: v.from_distortion(tensor(stretch * np.eye(3))) for v in material.variables}
    taken, kept = (float(value(part)) for part in material.parts(z))
    assert max(taken, kept) > 0.1
    assert abs(kept if stretch > 1 else taken) < 1e-12
