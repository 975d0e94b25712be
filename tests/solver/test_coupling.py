"""The transport's blocks of cells and sides against the derivative of the rows."""

import numpy as np
import pytest
from ngsolve import CF, x, y, z

import ngvisco as nv
from ngvisco.geometries import box, disc

pytestmark = pytest.mark.usefixtures("double_precision")
MESHES = {
    "2D": lambda: box((1, 1), maxh=0.35),
    "3D": lambda: box((1, 1, 1), maxh=0.6),
    "periodic": lambda: box((1, 1), maxh=0.35, periodic="x"),
    "disc": lambda: disc(1.0, maxh=0.5),
}


@pytest.mark.parametrize(
    ("mesh", "m", "bound"),
    [
        *(("2D", 1, 1e-12), ("2D", 0, 1e-12), ("3D", 0, 1e-12), ("periodic", 1, 1e-12)),
        *(("2D", 2, 1e-3), ("disc", 1, 1e-3)),  # rates by the coarse rule, which is not exact there
    ],
)
def test_rows_of_fields_and_density_are_the_derivative(mesh, m, bound):
    """Of random changes, at states that jump between cells."""
    mesh = MESHES[mesh]()
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1), viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.2)
    )
    velocity = CF((CF(x + 2 * y) * (1 - y), CF(1 - x * y), CF(z - x))[: mesh.dim])
    options = {"discretisation": nv.Discretisation(m=m), "initial": nv.Initial(velocity=velocity)}
    run = nv.Simulation(mesh, model, dt=0.01, solver="split", **options)
    split, rng = run.solver.newton, np.random.default_rng(1)
    u, slices, direction = split.unknowns.pack(), split.unknowns.slices, np.zeros(split.unknowns.size)
    for name in ("z", "rho"):
        where = slices[name]
        u[where] += 0.02 * rng.standard_normal(where.stop - where.start)
        direction[where] = rng.standard_normal(where.stop - where.start)
    run.rothe_step.context.tau.Set(0.01)
    run.rothe_step.wind.vec.FV().NumPy()[:] = u[slices["v"]]
    run.rothe_step.follow_wind()
    split.residual.start()
    at = split.residual(u)
    split.preconditioner.update(at)
    expected = split.residual.derivative(at)(direction)
    dz = direction[slices["z"]].reshape(at.coefficients["z"].shape)
    found = split.preconditioner.fields.rows(np.ascontiguousarray(dz.T)).T.ravel()
    of_z, of_rho = expected[slices["z"]], expected[slices["rho"]]
    assert np.abs(found - of_z).max() <= bound * np.abs(of_z).max()
    density = split.preconditioner.sweep.of_rho(direction[slices["rho"]])
    assert np.abs(density - of_rho).max() <= bound * np.abs(of_rho).max()
