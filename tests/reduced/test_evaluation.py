"""Rows by arrays are those of the same term's form, term by term; derivatives are those of the forms too."""

import numpy as np
import pytest
from ngsolve import CF, BilinearForm, cos, pi, sin, x, y, z

import ngvisco as nv
from ngvisco.geometries import box, disc
from ngvisco.physics.increments import TINY
from ngvisco.reduced.claims import Claims
from ngvisco.reduced.evaluation import NotAtPointsError, asked_slots

MESHES = {
    "2D": lambda: box((1, 1), maxh=0.5),
    "3D": lambda: box((1, 1, 1), maxh=1),
    "periodic": lambda: box((1, 1), maxh=0.4, periodic="x"),
    "curved": lambda: disc(1.0, maxh=0.7),
}


def step_of(mesh, m=1, **parts):
    """A step with all mechanisms that act at points, away from rest."""
    d = mesh.dim
    settings = {
        "material": nv.MooneyRivlin(K_e=10.0, G_e=5.0, G_mr=1.0, epsilon=0.1),
        "viscosity": nv.StokesViscosity(K_v=0.1, G_v=0.2),
        "creep": nv.Creep(G_m=0.5, nu=1e-3),
        "loads": [nv.Gravity((0.0,) * (d - 1) + (-1.0,)), nv.BodyForce(CF((y, x, 1.0)[:d]))],
        "regularisation": nv.Regularisation(epsilon=0.1),
    }
    velocity = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y), 0.1 * z)[:d]
    run = nv.Simulation(
        mesh,
        nv.Model(**(settings | parts)),
        dt=0.02,
        initial=nv.Initial(velocity=velocity, density=1 + 0.1 * x),
        solver="split",
        discretisation=nv.Discretisation(m=m),
    )
    step = run.rothe_step
    step.state_old.vec.data = step.state.vec
    step.start_from_old()
    step.context.set_step(0.02, 0.02, 0.0, 0.02)
    step.context.eta.Set(0.05)
    return run.solver.newton.residual


def noisy(residual, size=1e-2):
    """Unknowns near the start, and a direction."""
    rng = np.random.default_rng(3)
    at = residual.unknowns.pack()
    free = np.concatenate([_free(residual, name) for name in residual.unknowns.names])
    scale = size * residual.unknowns.scales(at, residual.exchange) / np.sqrt(len(at)) * free
    return at + scale * rng.standard_normal(len(at)), scale * rng.standard_normal(len(at))


def _free(residual, name):
    return np.array(list(residual.step.layout.blocks[name].FreeDofs()), dtype=float)


def rows_of_form(residual, term):
    """All rows of the term's own form at the step's state."""
    step = residual.step
    trial, test = step.layout.space.TnT()
    form = BilinearForm(step.layout.space, check_unused=False)
    step.quadrature.add(form, term.form(step.layout.fields(trial), step.layout.fields(test)))
    rows = step.state.vec.CreateVector()
    form.Apply(step.state.vec, rows)
    return {name: rows.FV().NumPy()[where] for name, where in step.layout.ranges.items()}, form


def rows_of_arrays(residual, term, at):
    rows = residual.cell_terms.rows([term], at.cells)
    for name, values in residual.facet_terms.rows([term], at.facets).items():
        rows[name] = rows[name] + values if name in rows else values
    return rows


LINEAR = {
    "material": nv.LinearElastic(K_e=10.0, G_e=5.0)
}  # the rate of E is affine, those of the others linear
SETTINGS = [*((mesh, 1, {}) for mesh in MESHES), ("2D", 0, {}), ("2D", 2, {}), ("2D", 1, LINEAR)]


@pytest.mark.parametrize(("mesh", "m", "parts"), SETTINGS)
def test_rows_of_every_term_are_those_of_its_form(mesh, m, parts):
    residual = step_of(MESHES[mesh](), m, **parts)
    residual.start()
    at = residual(noisy(residual)[0])
    terms = [*residual.claims.at_points, *residual.claims.continuity]
    assert {type(term).__name__ for term in terms} == {
        *("Inertia", "Convection", "ElasticForce", "Stokes", "Loading", "Kinematics", "CreepRate"),
        *("VelocityDamping", "Continuity"),
    }
    for term in terms:
        found = rows_of_arrays(residual, term, at)
        assert found, term
        expected, _ = rows_of_form(residual, term)
        for name, values in found.items():
            free = _free(residual, name).astype(bool)
            difference = np.abs(values.ravel() - expected[name])[free].max()
            assert difference <= 1e-12 * np.abs(expected[name]).max(), (term, name)


@pytest.mark.parametrize("mesh", ["2D", "3D"])
def test_complex_increments_are_the_form_s_linearisation(mesh):
    """In v, of terms that do not read what follows from v (traces, conjugates)."""
    residual = step_of(MESHES[mesh]())
    residual.start()
    x_at, _ = noisy(residual)
    at = residual(x_at)
    where = residual.unknowns.slices["v"]
    direction = np.zeros_like(x_at)
    direction[where] = np.random.default_rng(1).standard_normal(where.stop - where.start)
    direction[where] *= _free(residual, "v")
    others = ("Inertia", "Convection", "Stokes", "VelocityDamping")
    forms = {t: rows_of_form(residual, t)[1] for t in residual.claims.at_points if type(t).__name__ in others}
    step = residual.step
    full, product = step.state.vec.CreateVector(), step.state.vec.CreateVector()
    full[:] = 0.0
    full.FV().NumPy()[step.layout.ranges["v"]] = direction[where]
    for term, form in forms.items():
        form.AssembleLinearization(step.state.vec)
        product.data = form.mat * full
        expected = product.FV().NumPy()[step.layout.ranges["v"]]
        changed = residual(x_at + (TINY * 1j) * direction)
        found = rows_of_arrays(residual, term, changed)["v"].ravel().imag / TINY
        free = _free(residual, "v").astype(bool)
        assert np.abs(found - expected)[free].max() <= 1e-12 * np.abs(expected).max(), term
    assert len(forms) == 4
    assert at.residual.is_finite


def test_what_a_term_asks_for_is_found_without_values():
    residual = step_of(MESHES["2D"]())
    step = residual.step
    asked = {type(t).__name__: asked_slots(step, t, step.tabulated_rates) for t in Claims.of(step).at_points}
    rows = {name: set(slots) for name, slots in asked.items()}
    assert rows["Convection"] == {"v", "grad v"}
    assert rows["Kinematics"] == {"z"}
    assert rows["ElasticForce"] == {"v", "grad v"}
    assert rows["CreepRate"] == {"Pi", "grad Pi"}
    reading = {name for name, slots in asked.items() if any(slots.values())}
    assert {"Kinematics", "ElasticForce"} <= reading and not {"Convection", "Inertia"} & reading
    walls = nv.Simulation(
        disc(1.0, maxh=0.7), nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=1.0)), dt=0.1
    ).rothe_step
    (term,) = (t for t in walls.terms if type(t).__name__ == "Impenetrability")
    with pytest.raises(NotAtPointsError, match="wall_stress"):
        asked_slots(walls, term, walls.tabulated_rates)
