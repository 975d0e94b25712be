"""Bounds of a state, and the limiter: its changes, the quantities that it keeps, and the energy that it
takes."""

import numpy as np
import pytest
from ngsolve import CF, VOL, Det, GridFunction, Integrate, x, y, z

import ngvisco as nv
from ngvisco.forms.bounds import OF_CUT_OFF, SHARE, Bounds
from ngvisco.forms.mesh.locating import nearest_wall
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.start.initial import set_initial
from ngvisco.forms.system import Step
from ngvisco.geometries import box, disc
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Cofactor, Distortion, Jacobian, ReciprocalJacobian

CONVEX = nv.CustomMaterial(
    transported=(Distortion(), Jacobian()),
    stored_energy=lambda F, J: 3 * (J - 1) * (J - 1) + 2 * square(F) + 0.5 * square(F) * square(F),
)
"""An energy that is convex and finite for all (F, J), so that energies of states out of bounds can be
compared."""

BY_ALL = nv.CustomMaterial(
    transported=(Distortion(), Cofactor(), Jacobian(), ReciprocalJacobian()),
    stored_energy=lambda F, H, J, A: (
        3 * (J - 1) * (J - 1) + 3 * (A - 1) * (A - 1) + square(F) + square(H) + 0.5 * square(H) * square(H)
    ),
)
"""A convex energy of F, Cof F, J and 1/J that is finite for all values."""

MESHES = {
    "triangles": lambda: box((1, 1), 0.4),
    "tetrahedra": lambda: box((1, 1, 1), 0.8),
    "curved cells": lambda: disc(1, 0.6),
}


def step_of(mesh=None, material=CONVEX, m=1, regularisation=None):
    model = nv.Model(material=material, regularisation=regularisation)
    step = Step(mesh or box((1, 1), 0.4), model, nv.Discretisation(m=m))
    set_initial(step, nv.Initial(density=2.0), Sampler(step.mesh, step.quadrature))
    return step


def shaken(step, share=0.3, size=2.0, seed=0, variable=None):
    """Add random polynomials of mean zero to rho and z in a share of the cells, and return these cells.

    If ``variable`` is given, only this variable of z is changed.
    """
    rng = np.random.default_rng(seed)
    chosen_rows = {"rho": slice(None), "z": slice(None)}
    if variable is not None:
        chosen_rows = {"rho": slice(0), "z": step.layout.states.slices[variable]}
    layout, state = step.layout, step.state.vec.FV().NumPy()
    space = layout.blocks["rho"]
    chosen = np.flatnonzero(rng.uniform(size=step.mesh.ne) < share)
    before = means_of(step)
    for name in ("rho", "z"):
        values = state[layout.ranges[name]].reshape(-1, space.ndof)
        for cell in chosen:
            dofs = np.array(space.GetDofNrs(list(step.mesh.Elements(VOL))[cell]))
            rows = values[chosen_rows[name]]
            rows[:, dofs] += size * rng.uniform(-1, 1, (len(rows), len(dofs)))
    one = Bounds(step, Sampler(step.mesh, step.quadrature))._means.one
    volume = step.quadrature
    volumes = np.array(Integrate(CF(1.0), step.mesh, element_wise=True, order=volume.volume_degree))
    for (name, old), new in zip(before.items(), means_of(step).values(), strict=True):
        values = state[layout.ranges[name]].reshape(-1, space.ndof)
        for cell in chosen:
            dofs = np.array(space.GetDofNrs(list(step.mesh.Elements(VOL))[cell]))
            values[:, dofs] -= ((new - old) / volumes)[:, cell, None] * one[dofs]
    return chosen


def means_of(step):
    """Integrals of rho and of z's components over the cells, by the rule of the forms."""
    degree = step.quadrature.volume_degree

    def integrals(f):
        return np.array(Integrate(f, step.mesh, element_wise=True, order=degree))

    u = step.now
    return {"rho": integrals(u.rho)[None], "z": np.array([integrals(u.z[i]) for i in range(u.z.dim)])}


def bounds_of(step, **options):
    return Bounds(step, Sampler(step.mesh, step.quadrature), **options)


@pytest.mark.parametrize("m", [1, 2])
@pytest.mark.parametrize("name", MESHES)
def test_limiter_keeps_every_mean_and_restores_every_bound(name, m):
    step = step_of(MESHES[name](), m=m)
    chosen = shaken(step)
    bounds = bounds_of(step)
    assert bounds.violation(everywhere=True) is not None and bounds.violation() is None
    before, state, energy = means_of(step), step.state.vec.FV().NumPy().copy(), energies_of(step)
    assert 0 < bounds.limit() <= len(chosen)
    lost = energy - energies_of(step)  # the loss is >= 0 in every cell by Jensen's inequality
    assert lost.max() > 1e-6 and lost.min() >= -1e-14 * energy.max()
    assert bounds.violation(everywhere=True) is None and not bounds.is_exceeded()
    for name, means in means_of(step).items():
        assert np.abs(means - before[name]).max() <= 1e-13 * np.abs(before[name]).max()
    changed = np.flatnonzero(step.state.vec.FV().NumPy() != state)
    space, ranges = step.layout.blocks["rho"], step.layout.ranges
    dofs = {d for cell in chosen for d in space.GetDofNrs(list(step.mesh.Elements(VOL))[cell])}
    for i in changed:
        name = "rho" if ranges["rho"].start <= i < ranges["rho"].stop else "z"
        assert (i - ranges[name].start) % space.ndof in dofs
    values = Sampler(step.mesh, step.quadrature).values(CF((step.now.rho, step.now.z_tensors["J"])))
    assert values.min() >= SHARE * 0.9


def test_a_limited_density_is_at_least_the_stated_share_of_its_mean():
    """The slope of the density is scaled by the largest factor that keeps the bound, to the accuracy of the
    bisection."""
    step = step_of()
    shaken(step)
    sampler = Sampler(step.mesh, step.quadrature)
    broken = np.unique(sampler.cells[sampler.values(step.now.rho) <= 0])
    assert len(broken) and bounds_of(step).limit() > 0
    volumes = np.array(Integrate(CF(1.0), step.mesh, element_wise=True))
    rho, bound = sampler.values(step.now.rho), SHARE * means_of(step)["rho"][0] / volumes
    least = np.array([rho[sampler.cells == cell].min() for cell in broken])
    assert (least >= bound[broken] - 1e-14).all() and (least <= bound[broken] + 1e-6).all()


def test_momentum_is_scaled_with_its_density():
    """The momentum density of a constant velocity stays the limited density times this velocity."""
    step = step_of()
    shaken(step)
    bounds, of_density = bounds_of(step), step.now.rho * CF((0.3, -0.2))
    expected = GridFunction(step.momentum_old.space)
    step.momentum_old.Interpolate(of_density)
    before = step.momentum_old.vec.FV().NumPy().copy()
    assert bounds.limit() > 0
    bounds.limit_momentum()
    expected.Interpolate(of_density)
    found, wanted = (one.vec.FV().NumPy() for one in (step.momentum_old, expected))
    assert found == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    assert np.abs(found - before).max() > 0.1


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize(("quantity", "variable"), [("A", "A"), ("det H", "H"), ("det F", "F"), ("J", "J")])
def test_each_variable_is_held_to_its_own_bound(quantity, variable, mesh):
    """A single variable leaves its bounds. The limiter finds the cells, scales only this variable, and keeps
    means and rho."""
    step = step_of(MESHES[mesh](), material=BY_ALL)
    chosen = shaken(step, variable=variable)
    bounds, state = bounds_of(step), step.state.vec.FV().NumPy()
    found = bounds.violation(everywhere=True)
    assert found.quantity == quantity and not found.is_mean and bounds.violation() is None
    before, was, energy = means_of(step), state.copy(), energies_of(step)
    assert 0 < bounds.limit() <= len(chosen)
    value = step.now.z_tensors[variable]
    least = bounds.sampler.extrema(value if variable == quantity else Det(value))[0]
    assert least == pytest.approx(SHARE, rel=1e-6)  # the limiter takes no more than needed; the mean is 1
    for name, means in means_of(step).items():
        assert np.abs(means - before[name]).max() <= 1e-13 * np.abs(before[name]).max()
    rho = step.layout.ranges["rho"]
    assert (state[rho] == was[rho]).all()
    lost = energy - energies_of(step)
    assert lost.max() > 1e-6 and lost.min() >= -1e-14 * energy.max()


def energies_of(step):
    """Stored energies of the cells, J."""
    degree = step.quadrature.volume_degree
    return np.array(Integrate(step.energy.density(step.now), step.mesh, element_wise=True, order=degree))


def test_a_cell_mean_out_of_bounds_is_named_with_its_place():
    step = step_of(box((1, 1), 0.3))
    sampler = Sampler(step.mesh, step.quadrature)
    cell = mesh_cell(step.mesh, (0.95, 0.5))
    state, ranges = step.state.vec.FV().NumPy(), step.layout.ranges
    dofs = np.array(step.layout.blocks["rho"].GetDofNrs(list(step.mesh.Elements(VOL))[cell]))
    one = bounds_of(step)._means.one
    state[ranges["rho"]][dofs] -= 2.5 * one[dofs]
    found = Bounds(step, sampler).violation()
    assert (found.quantity, found.cell, found.wall, found.cells) == ("rho", cell, "right", 1)
    assert found.is_mean and found.value == pytest.approx(-0.5) and found.distance < 0.2
    for words in ("rho is not positive", "-5.000e-01", f"cell {cell}", "'right'"):
        assert words in str(found)


def mesh_cell(mesh, point):
    return int(mesh(*point).nr)


@pytest.mark.parametrize(
    "material, names",
    [
        (nv.Yosida(material=CONVEX, eps=1e-3), {"F", "J"}),
        (nv.WithQuadratic(material=nv.Yosida(material=CONVEX, eps=1e-3), delta=1e-3), {"F", "J"}),
        (nv.BarotropicFluid(B=1.0, gamma=1.4, J_min=0.1), {"J"}),
        (nv.NeoHookean(K_e=1, G_e=1, epsilon=1, J_min=0.1, elastic_state="B"), {"J"}),
        # J^(-2/3) |F|^2 has no value at J <= 0, whatever J_min is
        (nv.NeoHookean(K_e=1, G_e=1, epsilon=1, J_min=0.1, elastic_state="F"), set()),
        (nv.ReferentialNeoHookean(K_e=1, G_e=1, J_min=0.1, elastic_state="F"), {"J"}),
        (nv.IsochoricNeoHookean(K_e=1, G_e=1, J_min=0.1, elastic_state="F"), set()),
        (nv.OldroydB(K_e=1, G_e=1, J_min=0.1), {"J"}),
        (nv.OldroydB(K_e=1, G_e=1), set()),
        (CONVEX, set()),
    ],
)
def test_variables_of_a_continued_energy_have_no_bounds(material, names):
    from ngvisco.physics.pointwise import respond

    assert material.continued == names
    step = Step(box((1, 1), 1.0), nv.Model(material=material))
    set_initial(step, nv.Initial(), Sampler(step.mesh, step.quadrature))
    for bound in bounds_of(step).names:
        assert not any(bound in (name, f"det {name}") for name in names)
    if "J" in names:
        state = step.now.z(step.mesh(0.4, 0.4))
        J = np.array(state)[None].copy()
        J[0, -1] = -0.3  # the last variable is J
        assert respond(material, 2)(J).finite.all()


def test_the_nearest_wall_is_found_exactly_in_2d_and_3d():
    wall, distance = nearest_wall(box((1, 1), 0.4), np.array([0.3, 0.9]))
    assert wall == "top" and distance == pytest.approx(0.1)
    wall, distance = nearest_wall(box((1, 1, 1), 0.8), np.array([0.31, 0.55, 0.07]))
    assert wall == "bottom" and distance == pytest.approx(0.07)


def test_limiter_leaves_a_positive_linear_field_alone():
    """Positive fields of high contrast need no limiter."""
    step = step_of(box((1, 1, 1), 0.8), material=nv.NeoHookean(K_e=3, G_e=1, epsilon=0.2, elastic_state="F"))
    initial = nv.Initial(density=1e-4 + x + y + z)
    set_initial(step, initial, Sampler(step.mesh, step.quadrature))
    assert bounds_of(step).limit() == 0


BELOW_CUT_OFF = nv.Regularisation(rho_max=2.2, width=0.3)


def test_limiter_keeps_a_cut_off_s_bound_and_every_mean():
    """The limiter keeps rho <= rho_max + width in a run whose start satisfies this bound."""
    step = step_of(regularisation=BELOW_CUT_OFF)
    bounds = bounds_of(step)
    shaken(step, size=1.0)
    assert bounds.violation(everywhere=True).quantity == OF_CUT_OFF and bounds.violation() is None
    before, sampler = means_of(step), bounds.sampler
    assert sampler.extrema(step.now.rho)[1] > 2.5
    assert bounds.limit() > 0
    assert sampler.extrema(step.now.rho)[1] <= 2.5 - 0.9 * SHARE * 0.5
    for name, means in means_of(step).items():
        assert np.abs(means - before[name]).max() <= 1e-13 * np.abs(before[name]).max()


def test_mean_above_a_cut_off_s_bound_is_a_violation():
    step = step_of(regularisation=BELOW_CUT_OFF)
    bounds = bounds_of(step)
    step.state.vec.FV().NumPy()[step.layout.ranges["rho"]] *= 1.3
    violation = bounds.violation()
    assert violation is not None and violation.is_mean and violation.quantity == OF_CUT_OFF
    assert bounds_of(step).violation() is None  # if the start is above the bound, the run has no such bound
