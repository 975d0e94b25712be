"""The flow's and the transport's linear operators against differences of the rows."""

import numpy as np
import pytest
from ngsolve import CF

import ngvisco as nv
from ngvisco.forms.terms.momentum import MomentumBalance, UnbalancedMomentum
from ngvisco.geometries import box
from ngvisco.reduced.residual import CellPart
from ngvisco.solver.split import point_tangent

STEP = 1e-5


pytestmark = pytest.mark.usefixtures("double_precision")


def bodies(viscosity, bulk=10.0):
    """Two bodies whose densities are transported by their flux."""
    inner, outer = (nv.ReferentialNeoHookean(K_e=K, G_e=G) for K, G in ((10.0, 5.0), (bulk, 2.0)))
    return [
        nv.Body(
            name="ball", material=inner, viscosity=viscosity, density=1.0, where=nv.Ball((0.5, 0.5), 0.3)
        ),
        nv.Body(name="rest", material=outer, viscosity=viscosity, density=1.0),
    ]


@pytest.fixture
def run(request):
    """A box at rest with density one, and with the given flow rule or bodies."""
    asked, viscosity = getattr(request, "param", None), nv.StokesViscosity(K_v=0.1, G_v=0.2)
    matter = {
        "material": nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        "viscosity": viscosity,
        "creep": asked if isinstance(asked, nv.Creep) else None,
    }
    options = {}
    if asked == "bodies":
        matter = {"bodies": bodies(viscosity)}
    if asked == "window":  # the bodies' energy has no expression, and is averaged in each cell
        matter = {"bodies": bodies(viscosity, bulk=5.0)}
        options = {"walls": {"right": nv.Open()}, "discretisation": nv.Discretisation(m=0)}
    if asked == "cubic":  # the cubic space has a basis function of v that vanishes on all sides of its cell
        matter = {"bodies": bodies(viscosity)}
        options = {"discretisation": nv.Discretisation(k=3)}
    if asked == "heat":
        solid = nv.Thermal(material=nv.LinearElastic(K_e=10.0, G_e=5.0), c=2.0, theta_R=100.0)
        matter = {"material": solid, "viscosity": viscosity, "heat": nv.Heat(conductivity=5.0)}
    hyper = nv.HyperViscosity(mu=1e-4, p=4)
    model = nv.Model(**matter, hyperviscosity=hyper, loads=[nv.Gravity((0.0, -1.0))])
    run = nv.Simulation(
        box((1, 1), maxh=0.4),
        model,
        dt=0.5,
        initial=nv.Initial(velocity=CF((0.0, 0.0))),
        solver="split",
        **options,
    )
    return run


def linear(run, expressions):
    """Coefficients of a linear velocity, (dim, unknowns), without the conditions of walls."""
    vertices = np.array([vertex.point for vertex in run.mesh.vertices])
    result = np.zeros((2, run.solver.newton.residual.op.v.width))
    for row, values in zip(result, expressions(*vertices.T), strict=True):
        row[: run.mesh.nv] = values
    return result


def prepared(run, v, z_noise=0.0):
    split = run.solver.newton
    run.rothe_step.context.tau.Set(0.5)
    x, slices = split.unknowns.pack(), split.unknowns.slices
    x[slices["v"]] = v.ravel()
    x[slices["z"]] += z_noise * np.random.default_rng(0).standard_normal(x[slices["z"]].shape)
    split.residual.start()
    at = split.residual(x)
    split.preconditioner.operator.update(at)
    return split, at, split.preconditioner.operator


def derivative(split, at, dv, rows):
    """Central difference of ``rows(evaluation)`` in the direction dv."""
    values = []
    for sign in (1, -1):
        x = at.x.copy()
        x[split.unknowns.slices["v"]] += sign * STEP * dv.ravel()
        values.append(rows(split.residual(x)))
    return (values[0] - values[1]) / (2 * STEP)


def test_the_flow_operator_has_inertia_convection_and_viscosity(run):
    v = linear(run, lambda x, y: (1 + 2 * y - x, x + 0.5 * y))
    split, at, operator = prepared(run, v)
    operator.from_fields[:] = 0.0  # this test leaves out the response of the fields
    operator.derivative = None
    dv = linear(run, lambda x, y: (y - 0.3, 2 * x))  # div dv would change the density too
    r = split.residual
    terms = [t for t in r.couplings.at_points if t.linearised or t.is_mass]
    expected = derivative(split, at, dv, lambda at: r.cell_terms.rows(terms, at.cells)["v"].ravel())
    found = operator(np.concatenate([dv.ravel(), np.zeros(split.preconditioner._size - operator.nv)]))
    tests = np.zeros_like(dv, dtype=bool)
    tests[:, : run.mesh.nv] = True  # only the linear basis functions are tested
    difference = (found[: operator.nv] - expected)[tests.ravel()]
    assert np.abs(difference).max() <= 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("run", [None, "bodies", "window", nv.Creep(G_m=1.0)], indirect=True)
def test_a_part_of_the_mesh_without_cells_is_linearised(run):
    """A rank may have no cells."""
    split, at, operator = prepared(run, linear(run, lambda x, y: (x + 2 * y, -y)), 0.01)
    before = operator.from_fields.copy()
    points, empty = operator.points, slice(0, 0)
    operator._form((empty, points.terms.part(empty), CellPart(split.residual, empty)), at)
    assert (operator.from_fields == before).all()


@pytest.mark.parametrize("strain", [0.02, 0.2])
def test_the_resolvent_by_its_series_is_the_inverse(run, strain, monkeypatch):
    """Small strains in a step need few terms of the series, larger strains need more terms. The error is at
    most 1e-4 for both."""
    _, at, operator = prepared(run, strain * linear(run, lambda x, y: (x + 2 * y, -y)), 0.01)
    points = operator.points
    dz = np.random.default_rng(5).standard_normal((points.op.z.width, points.components))
    stored, points._stores = points.resolved(dz), False  # a mesh of several parts stores no resolvents
    operator.update(at)
    assert 0 < points._kept[0][0] <= 14 and points._kept[0][1] is None
    by_series, inverses, series = points.resolved(dz), [], []

    def inverted(N):
        inverses.append(np.linalg.inv(np.eye(N.shape[1]) - N))
        series.append(sum(np.linalg.matrix_power(N, power) for power in range(points._kept[0][0])))
        return inverses[-1], 0

    monkeypatch.setattr(point_tangent, "resolvents", inverted)
    operator.update(at)
    expected = (np.concatenate(inverses) @ dz.reshape(len(inverses[0]), -1, 1)).reshape(dz.shape)
    assert 0.01 < np.abs(expected - dz).max() < 2
    assert max(np.abs(found - expected).max() for found in (by_series, stored)) <= 3e-4
    partial = (np.concatenate(series) @ dz.reshape(len(series[0]), -1, 1)).reshape(dz.shape)
    assert np.abs(by_series - partial).max() <= 3e-6  # the error of each term of the derivative
    assert np.abs(points.resolved(dz) - expected).max() <= 1e-12


@pytest.mark.parametrize("run", [None, "bodies"], indirect=True)
def test_the_force_s_derivative_by_continuous_fields_is_exact(run, monkeypatch):
    """The state is uniform, and the change of the state is linear, so that no facet contributes. Differences
    give phi''. With the density of bodies, the weight, inertia, convection and the balance of momentum change
    as well. The increments do not contain the mass flux through facets.
    """
    place, rng = linear(run, lambda x, y: (x, y)), np.random.default_rng(3)
    v = linear(run, lambda x, y: (0.3 + 2 * y - x, x + 0.5 * y)) * (len(run.model.bodies) > 1)
    split, at, operator = prepared(run, v)
    residual, z = split.residual, split.unknowns.slices["z"]
    op, u = residual.op, at.x.copy()

    def coefficients(values):
        return op.z.test(values) @ residual.inverse_mass

    mean = at.cells.z.value.mean(axis=1, keepdims=True)
    uniform = mean * (1 + 0.02 * rng.standard_normal(mean.shape))
    u[z] = coefficients(np.broadcast_to(uniform, at.cells.z.value.shape).copy()).ravel()
    at = residual(u)
    monkeypatch.setattr(point_tangent, "resolvents", lambda matrices: (np.eye(matrices.shape[1]), 0))
    operator.update(at)
    direction = np.zeros(len(u))
    slope = rng.standard_normal((len(mean), 2))
    direction[z] = coefficients(slope @ op.v(place)).ravel()
    monkeypatch.setattr(MomentumBalance, "facets", lambda *_: [])
    monkeypatch.setattr(UnbalancedMomentum, "value_on_sides", lambda *_: None)
    expected = residual.derivative(at)(direction)[: operator.nv]
    found = operator.force(np.ascontiguousarray(direction[z].reshape(len(mean), -1).T)).ravel()
    free = split.preconditioner.free[: operator.nv]
    assert np.abs(found - expected)[free].max() <= 1e-5 * np.abs(expected[free]).max()


@pytest.mark.parametrize("run", ["bodies", "cubic"], indirect=True)
def test_the_field_equations_derivative_by_the_velocity_is_exact_also_at_jumps(run):
    """Inflow through a facet carries the jump of z, so that the rows of z depend on v at facets, too. The
    derivative of the density fluxes by v has the same form as the derivative of these rows."""
    v, rng = linear(run, lambda x, y: (0.3 + 2 * y - x, 0.1 + x + 0.5 * y)), np.random.default_rng(6)
    split, at, operator = prepared(run, v + 0.05 * rng.standard_normal(v.shape), 0.02)
    direction, z = np.zeros(len(at.x)), split.unknowns.slices["z"]
    dv = rng.standard_normal(v.shape) * split.preconditioner.free[: operator.nv].reshape(v.shape)
    direction[: operator.nv] = dv.ravel()
    expected = split.residual.derivative(at)(direction)[z]
    found = operator.fields_rows(dv, None).T.ravel()
    assert np.abs(found - expected).max() <= 1e-10 * np.abs(expected).max()


@pytest.mark.parametrize("run", ["heat"], indirect=True)
def test_the_derivative_of_conduction_is_exact_at_a_uniform_temperature(run):
    """Heat is conducted between cells by the lifting of the gradient and by the penalty."""
    split, at, _ = prepared(run, np.zeros_like(linear(run, lambda x, y: (x, y))))
    z, entropy = split.unknowns.slices["z"], split.preconditioner.sweep.exchange.rows[0]
    direction = np.zeros(len(at.x))
    dz = direction[z].reshape(at.coefficients["z"].shape)
    dz[entropy] = np.random.default_rng(2).standard_normal(dz.shape[1])
    expected = split.residual.derivative(at)(direction)[z].reshape(dz.shape)[entropy]
    found = split.preconditioner.fields.rows(np.ascontiguousarray(dz.T))[:, entropy]
    storage = split.preconditioner.sweep.of_z(dz.T)[:, entropy]
    assert np.abs(expected - storage).max() > 0.1 * np.abs(expected).max()
    assert np.abs(found - expected).max() <= 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize("run", [None, nv.Creep(G_m=4.0)], indirect=True)
def test_the_fields_systems_are_solved_where_sweeps_alone_fail(run):
    """The solver recovers dz and drho from their rows, in a step with a strain of 0.6 and a Courant number of
    2."""
    v = linear(run, lambda x, y: (1.2 * x - 0.5 * y, 0.5 * x - 1.2 * y))
    split, at, _ = prepared(run, v)
    slices, fields = split.unknowns.slices, split.preconditioner.fields
    rng = np.random.default_rng(2)
    direction = np.zeros(len(at.x))
    for name in ("z", "rho"):
        where = slices[name]
        direction[where] = rng.standard_normal(where.stop - where.start)
    change = split.residual.derivative(at)(direction)
    wanted = direction[slices["z"]].reshape(at.coefficients["z"].shape)

    def missed(found, wanted):
        return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)

    rows = np.ascontiguousarray(change[slices["z"]].reshape(wanted.shape).T)
    assert missed(fields.approximate(rows).T, wanted) > 1.0
    fields.iterations = 60
    assert missed(fields.z(rows, 1e-9).T, wanted) < 1e-7
    assert missed(fields.density(change[slices["rho"]], 1e-9), direction[slices["rho"]]) < 1e-7
