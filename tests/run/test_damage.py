"""Damage: the ledger of both halves of a step, exact curves of stress, bounds, heat, restart, refusals."""

import numpy as np
import pytest
from ngsolve import CF, GridFunction, IfPos, Integrate, cos, exp, pi, sin, sqrt, x, y
from support import each_once

import ngvisco as nv
from ngvisco.geometries import box, channel, structured_box
from ngvisco.run.simulation import Simulation
from tests.support import assert_same

RUBBER = nv.ReferentialNeoHookean(K_e=20.0, G_e=5.0)
SEED = 0.3 * exp(-20 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))
VORTEX = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))


def damaged(**parameters):
    given = {"material": RUBBER, "G_c": 0.1, "length": 0.6, "viscosity": 0.01}
    return nv.Damaged(**{**given, **parameters})


def swirl(material, dim=2, seed=SEED, **options):
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1))
    initial = nv.Initial(velocity=CF((*VORTEX, 0)[:dim]), values={"damage": seed})
    return Simulation(box((1,) * dim, maxh=0.5), model, dt=0.02, initial=initial, **options)


def assert_signs(run, until=0.04, is_euler=True):
    """Assert that the ledger closes, that every entry has its sign in every step, and that damage is within
    [0, 1] up to its slack."""
    ledger = run.run(until)
    assert abs(ledger.column("closure_relative")).max() < 1e-11
    names = ["dissipation_damage", "bregman_damage", *(["bregman"] if is_euler else [])]
    for name in names:
        assert ledger.column(name)[1:].min() > 0, name
    values = run.sampler.values(run.fields["damage"])
    assert values.min() > -1e-9 and values.max() < 1 + 1e-9
    return ledger


@pytest.mark.parametrize(
    ("kind", "area"),
    [("AT2", "actual"), ("AT2", "reference"), pytest.param("AT1", "actual", marks=pytest.mark.long)],
)
def test_both_halves_of_a_step_dissipate_and_both_solvers_agree(kind, area):
    material = damaged(law=kind, G_c=0.1 if kind == "AT2" else 0.01, area=area)
    runs = [swirl(material, solver=solver) for solver in ("coupled", "split")]
    for run in runs:
        assert_signs(run)
    assert_same(*runs)


@pytest.mark.long
@pytest.mark.parametrize(
    ("parameters", "dim", "scheme"),
    [
        ({"part": "all", "material": nv.LinearElastic(K_e=20.0, G_e=5.0)}, 2, "backward-euler"),
        ({"material": nv.LinearElastic(K_e=20.0, G_e=5.0)}, 2, "backward-euler"),
        ({"material": nv.LogarithmicNeoHookean(K_e=20.0, G_e=5.0, epsilon=1.0)}, 2, "backward-euler"),
        ({"material": nv.ReferentialNeoHookean(K_e=20.0, G_e=5.0 + x, elastic_state="B")}, 2, "sdirk2"),
        ({}, 2, "midpoint"),
        pytest.param({}, 3, "backward-euler", marks=pytest.mark.ci),
    ],
)
def test_ledger_closes_for_materials_dimensions_and_schemes(parameters, dim, scheme):
    is_euler = scheme == "backward-euler"
    assert_signs(swirl(damaged(**parameters), dim, solver="split", scheme=scheme), is_euler=is_euler)


RATE, FLOOR = 0.5, 1e-3


def exact(kind, gamma, G_c, length, G=5.0):
    """d and T_12 of a homogeneous simple shear gamma: phi'_d = 0 with a = G gamma^2."""
    psi = (1 - FLOOR) * G * gamma**2
    d = 2 * psi / (2 * psi + G_c / length) if kind == "AT2" else max(0, 1 - 3 * G_c / (16 * length * psi))
    return d, ((1 - FLOOR) * (1 - d) ** 2 + FLOOR) * 2 * G * gamma


def sheared(kind, part="tensile", G_c=0.1, **options):
    law = damaged(law=kind, part=part, G_c=G_c, length=1.0, viscosity=0.0, floor=FLOOR)
    walls = {"top": nv.PrescribedTangential((RATE / 2, 0)), "bottom": nv.PrescribedTangential((-RATE / 2, 0))}
    initial = nv.Initial(velocity=(RATE * (y - 0.5), 0))
    mesh, model = channel(1, 1, maxh=0.9), nv.Model(material=law)
    return Simulation(mesh, model, dt=0.1, walls=walls, initial=initial, solver="coupled", **options)


@pytest.mark.parametrize(("kind", "part"), [("AT1", "tensile"), ("AT2", "all")])
def test_a_bar_with_homogeneous_damage_follows_its_exact_stress_curve(kind, part):
    """The damage is homogeneous. The bar follows the exact curve to rounding at every step, below the
    threshold of AT1 and above it."""
    run = sheared(kind, part)
    for _ in range(4):
        row = run.advance()
        d, stress = exact(kind, RATE * row["time"], 0.1, 1.0)
        found = run.sampler.values(CF((run.fields["damage"], run.fields["cauchy_stress"][0, 1])))
        assert np.allclose(found, [d, stress], rtol=1e-11, atol=1e-13)
    assert 0.1 < d < 0.99
    assert abs(run.sampler.values(run.fields["grad_damage"])).max() < 1e-12


G, G_C, LENGTH = 5.0, 0.02, 0.1


def band(law, n):
    """The cost over G_c, the integral of d over l, and the largest stress, Pa, of a strip of n rows of cells
    and 1 m height that is sheared and breaks.  The shear gamma of the rows has a given mean, and the stress
    is the same in all rows. Shear and damage are computed in turn until nothing changes; damage may heal
    without delay.
    """
    mesh = structured_box((1 / n, 1.0), (1, n), periodic="x")
    rubber = nv.ReferentialNeoHookean(K_e=20.0, G_e=G, elastic_state="F")
    material = nv.Damaged(material=rubber, G_c=G_C, length=LENGTH, law=law, healing_viscosity=1e-9)
    seed = 0.9 * IfPos(0.5 / n - sqrt((y - 0.5) ** 2), 1.0, 0.0)
    initial = nv.Initial(values={"damage": seed})
    run = Simulation(mesh, nv.Model(material=material), dt=0.1, initial=initial, solver="coupled")
    step, grow = run.rothe_step, run.rothe_step.damage
    H_12, d = grow._z()[step.layout.states.slices["H"].start + 1], step.now.z_tensors["damage"]
    one = GridFunction(step.layout.blocks["rho"])
    one.Set(1.0)
    volume = Integrate(CF(1.0), mesh, element_wise=True).NumPy().copy()
    found, before = 0.0, -1.0
    for mean in np.array([1.0, 4.0, 16.0]) * np.sqrt(3 * G_C / (16 * LENGTH * G)):
        while abs(found - before) > 1e-9:
            g = Integrate(material.degradation(d), mesh, element_wise=True).NumPy() / volume
            gamma = mean / n / (g * (volume / g).sum())
            H_12[:] = one.vec.FV().NumPy() * np.repeat(gamma, len(H_12) // mesh.ne)
            grow(1e-3)
            before, found = found, n * Integrate(d, mesh)
        before = -1.0
    cost = n * Integrate(material.surface_energy(step.now.z_tensors), mesh)
    return cost / G_C, found / LENGTH, 2 * G * (gamma * g).max()


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize(
    ("law", "of_row", "width", "rows"), [("AT1", 3 / 8, 4 / 3, (11, 21, 41)), ("AT2", 1 / 2, 2.0, (21, 41))]
)
def test_damage_localises_to_a_band_with_the_width_and_energy_of_the_crack_profile(law, of_row, width, rows):
    """Across a crack d is (1 - |x|/2l)^2 or exp(-|x|/l) beside the broken row of cells.

    The height h of this row adds of_row h/l to the crack's cost (Bourdin, Francfort and Marigo, J.
    Elasticity 91, 2008) and h to the integral of d. The bounds are in proportion to h/l, like the error of
    the linear profile between vertices: 3 % where l = 2 h.
    """
    for n in rows:
        row = 1 / (n * LENGTH)
        cost, integral, stress = band(law, n)
        assert cost == pytest.approx(1 + of_row * row, rel=0.06 * row)
        assert integral == pytest.approx(width + row, rel=0.06 * row)
        assert stress < 1e-2


def test_damage_stays_without_healing_and_falls_at_its_rate_with_healing():
    """The body is at rest without elastic energy. If d may heal, w'(d) lowers d by d' = -G_c d/(l eta) (AT2);
    otherwise d stays."""
    for healing in (None, 2.0):
        law = damaged(length=1.0, healing_viscosity=healing)
        model = nv.Model(material=law)
        initial = nv.Initial(values={"damage": 0.5})
        run = Simulation(box((1, 1), maxh=0.9), model, dt=0.1, initial=initial, solver="coupled")
        run.run(0.3)
        expected = 0.5 if healing is None else 0.5 / (1 + 0.1 * 0.1 / healing) ** 3
        assert np.allclose(run.sampler.values(run.fields["damage"]), expected, rtol=1e-12)
        assert (run.ledger.column("dissipation_damage")[1:] > 0).all() == (healing is not None)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize(("scheme", "kept"), [("backward-euler", 0.72), ("midpoint", 0.95)])
def test_a_crack_that_moves_by_four_cells_keeps_the_stated_share_of_its_energy(scheme, kept):
    """MATERIALS.md has these shares.  Backward Euler diffuses carried fields; its share would be 0.95 without
    this diffusion."""
    distance = sqrt((x - 1) ** 2 + 1e-14) - 0.125
    crack = IfPos(distance, exp(-distance / 0.25), 1.0)
    initial = nv.Initial(velocity=(1.0, 0.0), values={"damage": crack})
    model = nv.Model(material=damaged(G_c=1e-3, length=0.25, viscosity=0.0))
    strip = structured_box((2, 0.125), (16, 1), periodic="x")
    run = Simulation(strip, model, dt=0.0625, scheme=scheme, initial=initial)
    surface = run.run(0.5).column("stored_surface")
    assert surface[-1] / surface[0] == pytest.approx(kept, abs=0.02)


def test_damage_that_heals_to_zero_loses_its_surface_energy():
    """The slope 3 G_c/(8 l) of AT1's surface energy holds d at 0. In a step, viscosity dissipates eta d^2/dt,
    and the scheme the rest of the surface energy."""
    law = damaged(length=1.0, law="AT1", healing_viscosity=0.01)
    model, initial = nv.Model(material=law), nv.Initial(values={"damage": 0.2})
    run = Simulation(box((1, 1), maxh=0.9), model, dt=0.1, initial=initial, solver="coupled")
    run.run(0.1)
    assert np.abs(run.sampler.values(run.fields["damage"])).max() < 1e-14
    surface, viscous = 3 / 8 * 0.1 * 0.2, 0.01 * 0.2**2 / 0.1
    for name, expected in (("dissipation_damage", viscous / 0.1), ("bregman_damage", surface - viscous)):
        assert run.ledger.column(name)[1] == pytest.approx(expected, rel=1e-9)


CROSS = 0.2
"""Length l of the damage law for the cracks that are stretched, m."""


def across(X):
    """AT1's damage across a crack at X = 0."""
    return IfPos(2 * CROSS - sqrt(X * X), (1 - sqrt(X * X) / (2 * CROSS)) ** 2, 0.0)


def left_of_a_crack(area, stretch):
    """The remaining share of a crack's energy: (1 + 1/stretch^2)/2 per actual area, 1 per reference area."""
    return (1 + stretch**-2) / 2 if area == "actual" else 1.0


@pytest.mark.parametrize(
    ("stretched", "area"),
    each_once([(1.0, 0.0), (1.5, 0.0), (2.0, 0.0), (1.25, 0.25)], ["reference", "actual"]),
    ids=str,
)
def test_a_crack_in_a_body_that_starts_stretched_has_the_energy_per_given_area(stretched, area):
    """The damage is a function of X = (x - shear y)/stretch, for F = ((stretch, shear), (0, 1)). F is not
    symmetric, so that its transpose would give another result."""
    stretch, shear = stretched
    mesh = structured_box((3.0, 0.2), (60, 2))
    law = damaged(law="AT1", G_c=1.0, length=CROSS, area=area, viscosity=1e6)
    F = CF((stretch, shear, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    damage = across((x - 1.5 - shear * (y - 0.1)) / stretch)
    initial = nv.Initial(F=F, values={"damage": damage})
    run = Simulation(mesh, nv.Model(material=law), dt=0.1, initial=initial)
    surface = run.model.material.surface_energy(run.rothe_step.now.z_tensors)
    cost = Integrate(surface, mesh, order=4) / 0.2
    assert cost == pytest.approx(left_of_a_crack(area, stretch / (1 + shear**2) ** 0.5), rel=0.01)


@pytest.mark.long
def test_crack_that_is_stretched_keeps_its_energy_per_reference_area():
    """Matter flies apart at v = X, so that the stretch is 1 + t; the energy of a crack stays within 2 %."""
    mesh = structured_box((2.4, 0.1), (48, 1), periodic="y")
    rubber = nv.ReferentialNeoHookean(K_e=1e-4, G_e=1e-4)
    initial = nv.Initial(density=1e3, velocity=(x - 1.2, 0), values={"damage": across(x - 1.2)})
    walls = dict.fromkeys(("left", "right"), nv.Open(density=1e3))
    for area in ("actual", "reference"):
        law = nv.Damaged(material=rubber, G_c=0.02, length=CROSS, law="AT1", area=area, viscosity=1e6)
        run = Simulation(mesh, nv.Model(material=law), dt=0.05, initial=initial, walls=walls, solver="split")
        for stretch in (1.25, 1.5, 2.0):
            ledger = run.run(stretch - 1)
            surface = ledger.column("stored_surface")
            assert surface[-1] / surface[0] == pytest.approx(
                left_of_a_crack(area, stretch), rel=0.02 if area == "reference" else 0.03
            )
        assert abs(ledger.column("closure_relative")).max() < 1e-11


def test_damage_growth_per_step_is_a_column_and_fast_growth_is_warned_of():
    """If the damage is homogeneous, the crack areas made in the steps add up to the stored area."""
    run = sheared("AT2")
    with pytest.warns(
        nv.DamageWarning,
        match=r"damage grew by 0\.\d+ at a point, and new cracks have .* times Damaged.length. The",
    ):
        ledger = run.run(0.3)
    d = [exact("AT2", RATE * t, 0.1, 1.0)[0] for t in ledger.column("time")]
    assert ledger.column("damage_growth")[1:] == pytest.approx(np.diff(d), rel=1e-9)
    made = 0.1 * np.cumsum(ledger.column("crack_growth"))  # the factor 0.1 is G_c
    assert ledger.column("stored_surface") == pytest.approx(made, rel=1e-9, abs=1e-15)
    assert made[-1] > 0.01


def test_adaptive_steps_are_chosen_by_the_growth_of_the_damage():
    most = 0.04
    adaptive = nv.AdaptiveSteps(dt_min=1e-3, dt_max=0.1, damage_growth=most)
    ledger = sheared("AT2", adaptive=adaptive).run(0.3)
    grown, dt = ledger.column("damage_growth")[1:], ledger.column("dt")[1:]
    assert grown.max() <= most and np.median(grown) > 0.5 * most
    assert ledger.column("rejections").any() and dt.min() < 0.02 < dt.max()
    # the crack runs in steps of any length, so that the shortest step is accepted
    shortest = nv.AdaptiveSteps(dt_min=0.1, dt_max=0.1, damage_growth=most)
    with pytest.warns(nv.DamageWarning):
        ledger = sheared("AT2", adaptive=shortest).run(0.3)
    assert np.allclose(ledger.column("dt")[1:], 0.1) and ledger.column("damage_growth").max() > most
    with pytest.raises(nv.NgviscoError, match=r"AdaptiveSteps\.damage_growth.*a material without damage"):
        Simulation(box((1, 1), maxh=0.9), nv.Model(material=RUBBER), dt=0.1, adaptive=adaptive)


def test_a_crack_energy_per_reference_area_is_refused_at_small_strains():
    with pytest.raises(nv.ParameterError, match=r"Damaged\.area.*'actual'.*small strain"):
        damaged(material=nv.LinearElastic(K_e=20.0, G_e=5.0), area="reference")


def test_a_damage_length_below_the_size_of_the_cells_is_warned_of():
    with pytest.warns(nv.InputWarning, match="below the size of the smallest cell"):
        Simulation(box((1, 1), maxh=0.9), nv.Model(material=damaged(length=0.1)), dt=0.1)
    law = damaged(material=nv.IsochoricNeoHookean(K_e=20.0, G_e=5.0), length=0.1)
    parts = [
        nv.Body(name="bar", where=0.5 - x, material=law, density=1.0),
        nv.Body(name="rest", material=law.material, density=1.0),
    ]
    with pytest.warns(nv.InputWarning, match="length = 0.1 m of the body 'bar' is below the size"):
        Simulation(box((1, 1), maxh=0.9), nv.Model(bodies=parts), dt=0.1)
