"""delta Laplace z dissipates for every convex energy, has no effect on constants, and is consistent."""

import numpy as np
import pytest
from materials import examples
from ngsolve import CF, H1, VOL, ElementId, Integrate, cos, pi, x, y
from support import one_of

import ngvisco as nv
from ngvisco.algebra.sparse import apply, inverse_of_blocks, mass_matrix
from ngvisco.forms.system import Step
from ngvisco.forms.terms.regularisation import FieldDiffusion
from ngvisco.geometries import box
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.energy_checks import StateSampling
from ngvisco.physics.pointwise import rest_state
from ngvisco.physics.regularisation import Regularisation
from ngvisco.reduced.diffusion import FieldDiffusionRows
from ngvisco.reduced.operators import FacetMass, Operators, SideOperators
from ngvisco.reduced.slope import PointwiseSlope

DELTA = 0.3
MATERIALS = {f"{i} {type(e.material).__name__}": e.material for i, e in enumerate(examples())}
CONVEX = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F")
MATERIALS["Yosida"] = nv.Yosida(material=CONVEX, eps=1e-2)
MATERIALS["WithQuadratic"] = nv.WithQuadratic(material=CONVEX, delta=0.01)


class Diffusion:
    """The term of field diffusion alone, for one material on one mesh."""

    def __init__(self, material, mesh, m=1, penalty=4.0):
        law = Regularisation(delta_fields=DELTA, penalty=penalty)
        model = nv.Model(material=material, regularisation=law)
        self.step = step = Step(mesh, model, nv.Discretisation(m=m))
        self.op = op = Operators(step, step.quadrature.volume_degree // 2)
        self.side = SideOperators(step)
        self.slope = PointwiseSlope(step, op.points)
        self.term = next(term for term in step.terms if isinstance(term, FieldDiffusion))
        self.hat = self.side.of("z_hat")
        traces = FacetMass(self.hat, Exchange(self.hat.width, {}, Communicator()))
        self.rows = FieldDiffusionRows(step, op, self.slope, self.term, traces)
        self.inverse_mass = inverse_of_blocks(mass_matrix(op.z.matrix, op.weights))

    def projected(self, values):
        return apply(self.inverse_mass, self.op.z.test(values))

    def power(self, z):
        """The form at G = zeta, and the ledger's entry, W."""
        at = self.op.z(z)
        zeta = self.projected(self.slope(at))
        parts = {"z": z, "zeta": zeta}
        parts |= self.rows.slopes(at, parts)
        state = self.step.state.vec.FV().NumPy()
        for name, values in parts.items():
            state[self.step.layout.ranges[name]] = values.ravel()
        self.step.local_unknowns.update_stored()
        (entry,) = self.term.entries(self.step.now)
        rule = self.step.quadrature
        entered = rule.integrate_cells(entry.integrand.cells)
        entered += rule.integrate_facets(entry.integrand.facets)
        return float((self.rows.rows(parts) * zeta).sum()), float(entered)

    def interior_penalty(self, z):
        """Facet terms of a symmetric interior penalty of z at G = zeta, for comparison."""
        op, side = self.op, self.side
        zeta = self.projected(self.slope(op.z(z)))
        slopes = [np.stack([D(c) for D in op.slopes("z")], axis=1) for c in (z, zeta)]
        cells = (op.weights * slopes[0] * slopes[1]).sum()
        normal, weights = side.points.normals, side.points.weights
        through = [self._on_sides(slope) for slope in slopes]
        flux, G_flux = ((t * normal).sum(axis=1) for t in through)
        jump = side.z(z) - self._mean(side.z(z))
        weight = Regularisation().penalty_weight(1) / side.h
        test = side.z(zeta)
        facets = (weights * (weight * jump * test - flux * (test - self._mean(test)) - G_flux * jump)).sum()
        return DELTA * float(cells + facets)

    def _on_sides(self, slopes):
        """Gradients, constant in a cell for m = 1, on the cell's sides."""
        per_cell = slopes.reshape(*slopes.shape[:2], self.step.mesh.ne, -1)[..., :1]
        return np.repeat(per_cell, self.side.z.per_cell, axis=3).reshape(*slopes.shape[:2], -1)

    def _mean(self, values):
        """Means of both sides' values; on walls the value itself."""
        hat, weights = self.hat, self.side.points.weights
        inverse = inverse_of_blocks(mass_matrix(hat.matrix, weights))
        return hat(apply(inverse, hat.test(values)))


MESH = box((1, 1), maxh=0.5)


def rough_states(diffusion, rng, spread):
    """Coefficients of states that differ from cell to cell, and within cells."""
    material, mesh, op = diffusion.step.model.material, diffusion.step.mesh, diffusion.op
    means = StateSampling(material, mesh.dim, spread, rng).fitting()[: mesh.ne].T
    at = np.repeat(means, op.points.per_cell, axis=1)
    size = 0.5 * spread * np.abs(rest_state(material, mesh.dim)).max()
    return diffusion.projected(at + size * rng.uniform(-1, 1, at.shape))


def continuous_states(diffusion, rng, spread):
    """Coefficients of continuous states, linear in the cells, with random values at the vertices."""
    mesh = diffusion.step.mesh
    vertices = StateSampling(diffusion.step.model.material, mesh.dim, spread, rng).fitting()[: mesh.nv]
    values = diffusion.op.points.values(H1(mesh, order=1))
    return diffusion.projected(np.stack([values @ component for component in vertices.T]))


@pytest.mark.parametrize("name", one_of(3, MATERIALS))
def test_the_power_of_diffusion_equals_the_ledger_s_and_is_positive_at_random_states(name, rng):
    diffusion = Diffusion(MATERIALS[name], MESH)
    for spread in (0.02, 0.2):
        for states in (rough_states, continuous_states):
            power, entry = diffusion.power(states(diffusion, rng, spread))
            assert entry > 0
            assert power == pytest.approx(entry, rel=1e-9)


def test_diffusion_dissipates_where_an_interior_penalty_of_z_creates_energy():
    """A stiff fluid, p = J^-30, is at rest in one cell, and compressed towards one of the vertices in the
    other cell."""
    mesh = box((1, 1), maxh=1)
    diffusion = Diffusion(nv.BarotropicFluid(B=10.0, gamma=30.0), mesh)
    vertices = diffusion.op.points.values(H1(mesh, order=1)).toarray().reshape(mesh.ne, -1, mesh.nv)
    assert mesh.ne == 2
    created = []
    for vertex in mesh[ElementId(VOL, 0)].vertices:
        J = np.full(mesh.nv, 0.84)
        J[vertex.nr] = 0.70
        values = np.stack([vertices[0] @ J, np.ones(vertices.shape[1])])
        z = diffusion.projected(values.reshape(1, -1))
        created.append(diffusion.interior_penalty(z))
        power, entry = diffusion.power(z)
        assert power > 0
        assert power == pytest.approx(entry, rel=1e-9)
    assert min(created) < -1e3


@pytest.mark.parametrize("m", [1, 2])
def test_the_diffused_slope_is_grad_z_with_the_paper_s_power(m):
    """The power is phi''(z) grad z : grad z (Euler-small-calc-Delta), for a smooth z without flux through
    walls."""
    T = 1 + 0.3 * cos(pi * x) * cos(pi * y)
    slopes, powers = [], []
    for maxh in (0.4, 0.2, 0.1):
        mesh = box((1, 1), maxh=maxh)
        diffusion = Diffusion(nv.BarotropicFluid(B=10.0, gamma=1.4), mesh, m)
        values = diffusion.op.points.function(1)
        values.Interpolate(CF((T, 0.0)))
        power, _ = diffusion.power(diffusion.projected(diffusion.op.points.read(values, 1)))
        exact = CF((T.Diff(x), T.Diff(y)))
        error = diffusion.step.now.z_slope.Reshape((2,)) - exact
        slopes.append(Integrate(error * error, mesh, order=8) ** 0.5)
        curvature = 10.0 * 1.4 * 2.4 * T ** (-3.4)  # the second derivative of phi = B J^-gamma
        powers.append(abs(power - DELTA * Integrate(curvature * exact * exact, mesh, order=10)))
    assert np.log2(slopes[1] / slopes[2]) > m - 0.2
    assert np.log2(powers[1] / powers[2]) > 2 * m - 0.4
