"""Bodies that meet with different stresses at rest are warned of once, by name, with all stresses."""

import warnings

import pytest
from ngsolve import Id, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.variables import Jacobian

MESH = box((1, 1), 0.5)
FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 5 * (J + 1 / J - 2))


def tense(stress):
    """A fluid with this stress at rest, Pa, and no other energy then."""
    return nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 5 * (J + 1 / J - 2) + stress)


TENSE = tense(15.0005)


def warned(*materials, **options):
    """Messages of stresses at rest at the start of discs, one within the other, of these materials."""
    bodies = [
        nv.Body(
            name=f"b{i}", where=nv.Ball((0.5, 0.5), 0.4 / i) if i else None, density=1, order=i, material=m
        )
        for i, m in enumerate(materials)
    ]
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        nv.Simulation(MESH, nv.Model(bodies=bodies), dt=0.1, **options)
    messages = [str(warning.message) for warning in found if warning.category is nv.InputWarning]
    return [text for text in messages if "bulk moduli" not in text]  # what is said of these is another matter


def test_all_bodies_all_stresses_and_the_remedy_are_named():
    (message,) = warned(FLUID, TENSE, tense(6.0))
    for part in ("'b0', 'b1', 'b2'", " 0 Pa, 15 Pa, 6 Pa", "ReferentialNeoHookean", "Initial.F"):
        assert part in message


def test_the_stress_is_that_of_the_run():
    """In a box of its own a body under the tension T(I) has the pressure -T(I) everywhere."""
    run = nv.Simulation(MESH, nv.Model(material=TENSE), dt=0.1)
    pressure = run.sampler.values(run.fields["pressure"])
    assert pressure == pytest.approx(-15.0005, rel=1e-12)
    assert "15 Pa" in warned(FLUID, TENSE)[0]


@pytest.mark.parametrize(
    "drop",
    [
        nv.ReferentialNeoHookean(K_e=1e9, G_e=5e8),
        nv.PerReferentialVolume(material=nv.OldroydB(K_e=1e9, G_e=1.0)),
        nv.LogarithmicNeoHookean(K_e=1.0, G_e=1.0, epsilon=0.3),
        nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0 + x),
    ],
    ids=lambda m: type(m).__name__,
)
def test_bodies_without_stress_at_rest_are_not_warned_of(drop):
    assert warned(FLUID, drop) == []


def test_bodies_of_one_material_are_not_warned_of():
    assert warned(TENSE, TENSE) == []


def test_a_start_of_the_user_s_own_is_not_warned_of():
    assert warned(FLUID, TENSE, initial=nv.Initial(F=1.01 * Id(3))) == []
