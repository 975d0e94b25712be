"""The derivative of the split solver's residual, against differences of the residual itself."""

import numpy as np
import pytest
from ngsolve import CF
from support import ALL_BY_CI, EXAMPLES, SWIRL, by_ci
from test_split_agrees import PARTS, REGULARISED, model

import ngvisco as nv
from ngvisco.geometries import box, disc
from ngvisco.physics.pointwise import ExpressionResponse

WALLS = {"top": nv.Traction(f=(1.0, 0.0), friction=0.2)}

LAWS = REGULARISED | {
    "r = 3": nv.Regularisation(delta_density=1e-3, r=3.0),
    "cut-off": nv.Regularisation(rho_max=0.9, width=0.5),  # the density is cut off everywhere
}
MECHANISMS = {"creep at points": {}, **PARTS, **{name: {"regularisation": law} for name, law in LAWS.items()}}


def simulation(mesh=None, discretisation=None, symmetry="none", **parts):
    mesh, walls = mesh or box((1, 1), maxh=0.5), WALLS if mesh is None else {}
    options = {"walls": walls, "discretisation": discretisation, "solver": "split", "symmetry": symmetry}
    initial = nv.Initial(velocity=(*SWIRL, CF(0))[: mesh.dim])
    return nv.Simulation(mesh, model(dim=mesh.dim, **parts), dt=0.02, initial=initial, **options)


def assert_programs_repeat_it(split, x, other):
    """Assert that programs recorded at x give the residual at another place, bit for bit."""
    residual = split.residual
    expected = residual(other)
    residual.start(records=True)
    residual(x)
    found = residual(other)
    if residual.slope.is_local:
        names = [("loads", 0)] if residual.diffusion is not None else [("loads", 0), "derived"]
        assert residual.programs.names == names
    assert np.array_equal(found.residual, expected.residual)
    assert all(
        np.array_equal(found.coefficients[name], values) for name, values in expected.coefficients.items()
    )
    # another step with other data and the same programs
    state_old = split.step.state_old.vec.FV().NumPy()
    kept = state_old.copy()
    state_old *= 1.01
    residual.start()
    assert not residual.programs.names
    expected = residual(other)
    residual.start(records=True)
    for _ in range(2):
        assert np.array_equal(residual(other).residual, expected.residual)
    assert not residual.programs.varying
    state_old[:] = kept
    residual.start()


def assert_is_the_derivative(run, bound=1e-8):
    """Assert that the derivative at a state that is no solution equals Richardson's differences, block by
    block. Rounding of the differences leaves an error of 1e-9."""
    split = run.solver.newton
    run.advance()
    run.rothe_step.context.set_step(0.02, 0.04, 0.02, 0.02)
    u, rng = split.unknowns, np.random.default_rng(2)
    at = u.pack()
    size = 1e-2 * u.scales(at, split.residual.exchange) / np.sqrt(len(at))
    at = at + size * rng.standard_normal(len(at))
    d = size * rng.standard_normal(len(at))
    split.residual.start()
    found = split.residual.derivative(split.residual(at))(d)
    assert_programs_repeat_it(split, at, at + 1e-3 * d)

    def quotient(length):
        ahead, behind = (split.residual(at + sign * length * d).residual for sign in (1, -1))
        return (ahead - behind) / (2 * length)

    expected = (4 * quotient(1e-4) - quotient(2e-4)) / 3
    for where in (u.flow_slice, u.normal_slice, u.density_slice, u.slices["z"]):
        assert np.linalg.norm((found - expected)[where]) <= bound * np.linalg.norm(expected[where])


@pytest.mark.parametrize("name", [by_ci(n) if n in ("r = 3", "p = 2") else n for n in MECHANISMS])
def test_derivatives_equal_differences_for_every_mechanism(name):
    # where grad rho is small, a power of 1/2 is not smooth enough for differences
    assert_is_the_derivative(simulation(**MECHANISMS[name]), bound=1e-6 if name == "r = 3" else 1e-8)


@pytest.mark.parametrize("name", ALL_BY_CI)
def test_derivatives_equal_differences_for_every_material(name):
    assert_is_the_derivative(simulation(material=EXAMPLES[name]))


@pytest.mark.parametrize("law", ["conformation", "leonov"])
def test_derivatives_equal_differences_for_laws_of_creep(law):
    creep = nv.Creep(G_m=2.0, law=law)
    assert_is_the_derivative(simulation(material=EXAMPLES["FENEP"], creep=creep))


@pytest.mark.parametrize("kind", ["by its response", "by an expression"])
def test_derivatives_equal_differences_for_energies_without_arrays(kind, monkeypatch):
    material = EXAMPLES["NeoHookean"]
    if kind == "by its response":
        material = nv.Yosida(material=material, eps=1e-3)
    else:
        monkeypatch.setattr("ngvisco.forms.rates.respond", ExpressionResponse)
    assert_is_the_derivative(simulation(material=material))


def test_derivatives_equal_differences_in_three_dimensions():
    assert_is_the_derivative(simulation(box((1, 1, 1), maxh=1)), bound=1e-8)


@pytest.mark.parametrize(("k", "m"), [(2, 0), (3, 1), (2, 2)])
def test_derivatives_equal_differences_for_other_orders(k, m):
    assert_is_the_derivative(simulation(discretisation=nv.Discretisation(k=k, m=m)))


def test_derivatives_equal_differences_on_a_periodic_cell():
    assert_is_the_derivative(simulation(box((1, 1), maxh=0.4, periodic="x")))


def test_derivatives_equal_differences_on_a_curved_wall():
    assert_is_the_derivative(simulation(disc(1.0, maxh=0.7)))


def test_derivatives_equal_differences_about_an_axis():
    assert_is_the_derivative(simulation(symmetry="axisymmetric", hyperviscosity=None))
