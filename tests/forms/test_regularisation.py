"""The scheme's regularisations: the ledger closes with each, and each has its sign and its effect."""

import numpy as np
import pytest
from ngsolve import (
    CF,
    GridFunction,
    IfPos,
    InnerProduct,
    Integrate,
    Parameter,
    Trace,
    cos,
    exp,
    pi,
    sin,
    x,
    y,
)
from support import (
    assert_balanced,
    block,
    by_ci,
    difference_times,
    jacobian_times,
    parts_of,
    random_direction,
    residual,
    small_run,
    swirling,
    uncondensed,
)

import ngvisco as nv
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.mesh_arrays import facets_with_two_sides
from ngvisco.forms.system import Step
from ngvisco.forms.terms.momentum import Continuity, Convection
from ngvisco.geometries import box
from ngvisco.physics.regularisation import Regularisation

MATERIALS = {"linear": nv.LinearElastic(K_e=10, G_e=5), "finite": nv.ReferentialNeoHookean(K_e=10, G_e=5)}
CASES = {
    "delta_density r = 4": Regularisation(delta_density=0.05),
    "delta_density r = 3.5": Regularisation(delta_density=0.05, r=3.5),
    "delta_density r = 2": Regularisation(delta_density=0.05, r=2.0),
    "delta_fields": Regularisation(delta_fields=0.01),
    "epsilon p = 4": Regularisation(epsilon=0.1),
    "epsilon p = 3.5": Regularisation(epsilon=0.1, p=3.5),
    "cut-off": Regularisation(rho_max=1.1, width=0.3),
    "all": Regularisation(delta_density=0.05, delta_fields=0.01, epsilon=0.1, rho_max=1.1, width=0.3),
}

POINTS = box((1, 1), maxh=1)


def simulation(regularisation, material="finite", dim=2, maxh=0.5, dt=0.02, creep=None, m=1):
    return swirling(
        box((1,) * dim, maxh=maxh),
        dt,
        density=1 + 0.2 * cos(pi * x),
        material=MATERIALS[material] if isinstance(material, str) else material,
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        loads=[nv.Gravity((0.0,) * (dim - 1) + (-1.0,))],
        creep=creep,
        regularisation=regularisation,
        discretisation=nv.Discretisation(m=m),
    )


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("case", CASES)
def test_ledger_closes_with_each_regularisation(case, material):
    ledger = simulation(CASES[case], material).run(0.08)
    assert_balanced(ledger)
    assert ledger.column("rho_min").min() > 0
    law = CASES[case]
    if law.delta_density:
        assert ledger.column("density_diffusion")[1:].min() > 0
    if law.delta_fields:
        assert ledger.column("dissipation_delta_fields")[1:].min() > 0
    if law.epsilon:
        assert ledger.column("dissipation_epsilon")[1:].min() > 0
    if law.rho_max:
        assert 0 < ledger.column("cutoff_volume")[1:].min() < 1


@pytest.mark.parametrize("creep", [None, nv.Creep(G_m=2.0, nu=0.01), nv.Creep(G_m=2.0, nu=0.01, q=3.5)])
@pytest.mark.parametrize("case", ["all", "delta_density r = 3.5", "epsilon p = 3.5"])
def test_linearisation_agrees_with_central_differences(case, creep):
    """The state is random, and the rows of each unknown are compared by themselves."""
    step = simulation(CASES[case], creep=creep).rothe_step
    step.context.tau.Set(0.02)
    form, rng = uncondensed(step), np.random.default_rng(2)
    at = step.state.vec.CreateVector()
    at.FV().NumPy()[:] = step.state.vec.FV().NumPy() + 1e-2 * rng.uniform(-1, 1, len(at))
    d = random_direction(step)
    product, central = jacobian_times(form, at, d), difference_times(form, at, d, h=1e-5)
    for where in step.layout.ranges.values():
        error = np.linalg.norm(central[where] - product[where])
        assert error <= 1e-6 * max(np.linalg.norm(central[where]), 1e-3)


CONVECTED = {
    "none": (None, 1.2 + 0.3 * x + 0.2 * y),
    "delta_density": (Regularisation(delta_density=0.3, r=3.5), 1.2 + 0.3 * x + 0.2 * y),
    "cut-off": (Regularisation(rho_max=1.0, width=1.0), CF(1.6)),
}


@pytest.mark.parametrize("case", CONVECTED)
def test_skew_convection_is_the_paper_s_convection_minus_half_the_continuity_equation(case):
    """The force is div(m x v) + delta |grad rho|^(r-2) (grad v) grad rho - v/2 div(m - delta |grad
    rho|^(r-2) grad rho).

    m = K(rho) rho v, and tests are velocities that vanish on the walls; the form is exact for these
    polynomials, since grad rho and K(rho) are constant. Each part has no power, so that the ledger would not
    show a missing part.
    """
    law, rho = CONVECTED[case]
    step = simulation(law, maxh=0.3).rothe_step
    space, mesh = step.layout.space, step.mesh
    parts_of(step)["rho"].Set(rho)
    rng = np.random.default_rng(4)
    test = GridFunction(space)
    for target, inside in ((step.state, False), (test, True)):
        values = dict(zip(step.layout.names, target.components, strict=True))["v"]
        values.vec.FV().NumPy()[:] = rng.uniform(-1, 1, len(values.vec))
        if inside:
            for i, on_wall in enumerate(values.space.GetDofs(mesh.Boundaries(".*"))):
                if on_wall:
                    values.vec[i] = 0.0
    u, w = step.now, Fields.of(step.layout, test.components)
    carried = 1.2 + 0.3 * x + 0.2 * y if law is None or law.rho_max is None else law.cut_off(CF(1.6)) * 1.6
    slope = CF((0.3, 0.2)) if case != "cut-off" else CF((0.0, 0.0))
    diffusion = law.delta_density * (0.13**0.75) if case == "delta_density" else 0.0
    divergence = carried * Trace(u.grad_v) + slope * u.v
    expected = (
        carried * InnerProduct(u.grad_v * u.v, w.v)
        + 0.5 * divergence * InnerProduct(u.v, w.v)
        + diffusion * InnerProduct(u.grad_v * slope, w.v)
    )
    form = sum(Convection(law).cells(u, w))
    theirs, ours = Integrate(expected, mesh, order=8), Integrate(form, mesh, order=8)
    assert abs(theirs) > 1e-2
    assert ours == pytest.approx(theirs, rel=1e-11)


def diffuse(quantity, maxh, dt, until, m=1):
    """Pure diffusion of a density or of J in a heavy fluid at rest; its error against the exact solution."""
    D = 0.05
    exponent = {"r": 2.0} if quantity == "density" else {}
    law = Regularisation(**{f"delta_{quantity}": D}, **exponent)
    # stresses do not move the body: K_e is tiny compared with the viscosity
    profile = cos(pi * x) * cos(pi * y)
    mesh = box((1, 1), maxh=maxh)
    discretisation = nv.Discretisation(m=m)
    run = small_run(
        mesh,
        material=nv.BarotropicFluid(B=1e-8, gamma=2.0),
        viscosity=nv.StokesViscosity(K_v=1e4, G_v=1e4),
        regularisation=law,
        density=1 + 0.3 * profile if quantity == "density" else 1.0,
        values={"J": 1 + 0.3 * profile if quantity == "fields" else CF(1.0)},
        time=nv.TimeSteps(dt=dt, velocity_scale=1e-6),
        discretisation=discretisation,
    )
    run.run(until)
    steps = round(until / dt)
    decay = (1 / (1 + 2 * pi**2 * D * dt)) ** steps  # the mode decays by this factor in implicit Euler steps
    field = run.fields["density" if quantity == "density" else "J"]
    return Integrate((field - 1 - 0.3 * decay * profile) ** 2, mesh, order=8) ** 0.5


@pytest.mark.parametrize("quantity", ["density", by_ci("fields")])
def test_diffusion_has_the_right_speed_and_order_m_plus_1(quantity):
    """With r = 2 the cosine mode decays by the factor 1/(1 + 2 pi^2 delta tau) in a step."""
    coarse, fine = (diffuse(quantity, maxh, 0.1, 0.4) for maxh in (0.3, 0.15))
    assert fine < 4e-3
    assert np.log2(coarse / fine) > 1.7


def test_cut_off_is_c1_and_zero_beyond_its_width():
    law = Regularisation(rho_max=2.0, width=0.5)
    point = POINTS(0.2, 0.2)
    rho = Parameter(0.0)
    K, slope = law.cut_off(rho), law.cut_off(rho).Diff(rho)

    def at(value):
        rho.Set(value)
        return K(point), slope(point)

    assert at(-0.1)[0] == 0
    assert at(0.5) == (1, 0)
    assert at(2.25)[0] == pytest.approx(0.5)
    assert at(2.6) == (0, 0)
    for edge in (2.0, 2.5):
        inside, outside = at(edge - 1e-7), at(edge + 1e-7)
        assert inside == pytest.approx(outside, abs=1e-5)
    h = 1e-6
    assert at(2.2)[1] == pytest.approx((at(2.2 + h)[0] - at(2.2 - h)[0]) / (2 * h), rel=1e-6)


@pytest.mark.parametrize(("rho_max", "width"), [(1.0, 1.0), (0.2, 1.0), (3.0, 0.1)])
def test_the_flow_of_a_cut_off_density_is_split_into_a_rising_and_a_falling_function(rho_max, width):
    law, point, rho = Regularisation(rho_max=rho_max, width=width), POINTS(0.2, 0.2), Parameter(0.0)
    parts, found = (law.carried(rho), law.rising(rho), law.falling(rho)), []
    values = np.linspace(-0.1, rho_max + width + 0.1, 2001)
    for value in values:
        rho.Set(value)
        found.append([part(point) for part in parts])
    carried, rising, falling = np.array(found).T
    assert np.abs(carried - rising - falling).max() <= 1e-15 * carried.max()
    assert np.diff(rising).min() >= 0 >= np.diff(falling).max()
    assert np.diff(falling).min() < 0 < np.diff(rising).max()
    assert values[carried.argmax()] == pytest.approx(law.densest_flow, abs=2 * (values[1] - values[0]))


@pytest.mark.parametrize("flow", [1.0, -1.0])
def test_a_facet_has_one_upstream_side_also_with_a_cut_off_density(flow):
    """The flow through the facet between two triangles (m = 0) changes its sign along the facet."""
    law, at = Regularisation(rho_max=1.1, width=0.3), POINTS(0.5, 0.5)
    model = nv.Model(material=MATERIALS["linear"], regularisation=law)
    step = Step(box((1, 1), maxh=2.0), model, nv.Discretisation(m=0))
    parts, inner = parts_of(step), facets_with_two_sides(step.mesh)
    parts["rho"].Set(IfPos(y - x, 1.05, 1.3))  # the densities of the first and the second side
    parts["v"].Set(flow * CF((x - 0.3, 0.3 - x)))
    parts["mean_flux"].vec.FV().NumPy()[inner] = flow * 2**0.5 * 0.2
    (term,) = (term for term in step.terms if isinstance(term, Continuity))
    trial, test = (Fields.of(step.layout, f) for f in step.layout.space.TnT())
    form = uncondensed(step, term.form(trial, test))
    upstream, downstream = (1.05, 1.3) if flow > 0 else (1.3, 1.05)
    parts["rho_hat"].vec.FV().NumPy()[:] = law.rising(CF(upstream))(at) + law.falling(CF(downstream))(at)
    rows = block(step, residual(form, step.state.vec), "rho_hat")
    assert rows[inner] == pytest.approx([0.0], abs=1e-14)
    assert abs(rows).max() > 0.01  # rows on walls are not zero


def test_cut_off_stops_the_flow_of_dense_matter():
    """A blob above rho_max + width does not move at all, whereas without the cut-off it does.

    In the blob K(rho) = 0 exactly, so that rho = rho_old solves the equation: the blob moves only by the
    error of Newton's iteration (3e-11 with the default tolerance 1e-10, 5e-14 with 1e-13).
    """
    newton = nv.NewtonOptions(tolerance=1e-13)
    blob = 1 + exp(-10 * ((x - 0.5) ** 2 + (y - 0.35) ** 2))
    change = {}
    for name, law in (("off", None), ("on", Regularisation(rho_max=1e-3, width=1e-3))):
        v = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
        run = small_run(
            0.3,
            0.05,
            material=nv.LinearElastic(K_e=1e-3, G_e=1e-3),
            viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
            regularisation=law,
            velocity=v,
            density=blob,
            newton=newton,
        )
        before = run.sampler.values(run.fields["density"])
        ledger = run.run(0.1)
        assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
        change[name] = np.abs(run.sampler.values(run.fields["density"]) - before).max()
        if name == "on":
            assert ledger.column("cutoff_volume")[-1] == pytest.approx(1.0)
    assert change["on"] < 1e-12
    assert change["off"] > 0.05


def test_quadratic_regularisation_is_in_the_stored_energy():
    delta = 0.04
    run = simulation(None, nv.WithQuadratic(material=MATERIALS["finite"], delta=delta))
    ledger = run.run(0.04)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    z = run.fields
    size = InnerProduct(z["H"], z["H"]) + z["J"] * z["J"]
    added = 0.5 * delta**0.5 * Integrate(size, run.mesh, order=8)
    assert ledger.column("stored_quadratic")[-1] == pytest.approx(added, rel=1e-12)
    plain = Integrate(MATERIALS["finite"].energy({"H": z["H"], "J": z["J"]}), run.mesh, order=8)
    assert ledger.column("stored")[-1] == pytest.approx(plain + added, rel=1e-6)


def test_inactive_continuation_below_J_min_changes_nothing():
    """J stays above J_min, so that the two runs are the same to rounding."""
    ends = []
    for J_min in (None, 0.3):
        run = simulation(None, nv.ReferentialNeoHookean(K_e=10, G_e=5, J_min=J_min))
        run.run(0.04)
        ends.append(run.sampler.values(run.fields["H"]))
    assert np.abs(ends[0] - ends[1]).max() < 1e-10
