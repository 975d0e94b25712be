"""Bodies of revolution: homogeneous stretch, statics, flow, the ledger, both solvers, and refused models."""

from itertools import product

import numpy as np
import pytest
from ngsolve import CF, Integrate, Mesh, SetNumThreads, x, y
from ngsolve.meshes import MakeStructured2DMesh
from support import assert_goes_on, by_both_solvers, each_once, others_by_ci, small_run

import ngvisco as nv
from ngvisco.errors import CheckpointError, MeshError, ParameterError
from ngvisco.geometries import box, structured_box

SOLVERS = ("coupled", "split")
VORTEX = (x * (1 - x) * (1 - 2 * y), -(2 - 3 * x) * y * (1 - y))
"""The flow v_r and v_y, without divergence about the axis x = 0."""


def about_the_axis(mesh=0.5, dt=0.02, **options):
    return small_run(mesh, dt, **{"symmetry": "axisymmetric", **options})


@pytest.mark.parametrize(("solver", "elastic_state"), each_once(SOLVERS, ["F", "B"]))
def test_a_homogeneous_stretch_equals_the_stretch_of_a_material_point(solver, elastic_state):
    """The walls prescribe v = (a r, b y), which carries the body through the walls. F, the density, the
    viscous power and the stress agree to rounding with backward Euler steps of a material point, and F_33 =
    F_rr."""
    a, b, dt, steps, K_v, G_v = 0.5, -0.4, 0.1, 3, 0.3, 0.2
    flow = (a * x, b * y)
    run = about_the_axis(
        structured_box((1, 1), (2, 2)),
        dt,
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state=elastic_state),
        viscosity=nv.StokesViscosity(K_v=K_v, G_v=G_v),
        loads=[nv.Gravity(CF((a * a * x, b * b * y)))],  # this load gives the body its acceleration
        velocity=flow,
        walls={"right": nv.Inflow(velocity=flow), "top": nv.Inflow(velocity=flow)},
        passive=["F_tot"],
        solver=solver,
    )
    ledger = run.run(steps * dt)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-12
    place, fields = run.mesh(0.3, 0.4), run.fields
    div = 2 * a + b
    F = np.diag([(1 - dt * a) ** -steps, (1 - dt * b) ** -steps, (1 - dt * a) ** -steps])
    J, rho = (1 - dt * div) ** -steps, (1 + dt * div) ** -steps
    np.testing.assert_allclose(fields["velocity"](place), (0.3 * a, 0.4 * b), rtol=1e-9)
    np.testing.assert_allclose(np.reshape(fields["F_tot"](place), (3, 3)), F, atol=1e-9)
    np.testing.assert_allclose(fields["J"](place), J, rtol=1e-9)
    np.testing.assert_allclose(fields["density"](place), rho, rtol=1e-9)
    if elastic_state == "F":
        np.testing.assert_allclose(np.reshape(fields["F"](place), (3, 3)), F, atol=1e-9)
    stress = np.reshape(fields["cauchy_stress"](place), (3, 3))
    assert abs(stress[2, 2] - stress[0, 0]) <= 1e-9 * abs(stress).max()
    assert abs(stress[1, 1] - stress[0, 0]) >= 0.1 * abs(stress).max()
    strain = np.array([a, b, a]) - div / 3
    row = ledger.rows[-1]  # the volume of a cylinder of radius and height 1, divided by 2 pi, is 1/2
    assert row["dissipation_stokes_bulk"] == pytest.approx(0.5 * K_v * div**2, rel=1e-9)
    assert row["dissipation_stokes_shear"] == pytest.approx(0.5 * 2 * G_v * strain @ strain, rel=1e-9)


def test_both_solvers_keep_energy_mass_and_axial_momentum():
    """The run is a vortex that creeps by a nonlinear rule, in a box without axial traction at the top."""

    def make(solver):
        return about_the_axis(
            velocity=VORTEX,
            viscosity=nv.PowerLaw(K_v=0.1, consistency=0.1, n=0.5, floor=0.1),
            creep=nv.Perzyna(G_m=2.0, sigma_Y=0.3),
            walls={"top": nv.Open(pressure=0.1, impedance=(0.2, 0.1)), "right": nv.NavierFriction(0.3)},
            loads=[nv.Gravity((0.0, -1.0))],
            time=nv.TimeSteps(dt=0.02, scheme="midpoint"),
            solver=solver,
        )

    for run in by_both_solvers(make, 0.06):
        row = run.ledger.rows[-1]
        assert not [name for name in row if name.startswith(("momentum_1", "angular"))]
        assert abs(row["momentum_defect_2"]) <= 1e-2 * abs(row["momentum_2"])


def test_wall_forces_balance_the_weight():
    """In a can of radius 1 at rest the bottom bears rho g height/2, the weight over 2 pi."""
    forces = nv.WallForces()
    run = about_the_axis(
        1.0,
        1e3,
        material=nv.LinearElastic(K_e=100.0, G_e=0.1),
        loads=[nv.Gravity((0.0, -1.0))],
        observers=[forces],
        equilibrium="hydrostatic",
    )
    run.run(1e3)
    columns = dict(zip(forces.columns, forces.rows[-1], strict=True))
    assert {name.partition(".")[2] for name in columns if "." in name} == {"force_2"}
    assert columns["bottom.force_2"] - columns["top.force_2"] == pytest.approx(-0.5, rel=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
def test_flow_in_a_pipe_is_poiseuille_flow(solver):
    """P_2 contains the exact v_y = rho g (R^2 - r^2)/(4 G_v), which is 1/4 at the axis, twice its mean."""
    run = about_the_axis(
        structured_box((1, 0.5), (3, 1), periodic="y"),
        1.0,
        material=nv.BarotropicFluid(B=10.0, gamma=1.4),
        viscosity=nv.StokesViscosity(K_v=1.0, G_v=1.0),
        loads=[nv.Gravity((0.0, 1.0))],
        walls={"right": nv.NoSlip()},
        solver=solver,
    )
    run.run(10.0)  # each step leaves a seventh of the first mode
    flow = run.fields["velocity"][1] - (1 - x * x) / 4
    assert Integrate(flow * flow, run.mesh) ** 0.5 <= 1e-7
    assert run.fields["velocity"](run.mesh(1e-6, 0.2))[1] == pytest.approx(0.25, rel=1e-6)


def ring(inner: float, cells: int) -> Mesh:
    """The section of a hollow cylinder between the radii ``inner`` and 1 m, one cell high."""
    return MakeStructured2DMesh(
        quads=False, nx=cells, ny=1, mapping=lambda r, h: (inner + (1 - inner) * r, h / cells)
    )


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_thick_cylinder_under_pressure_has_the_stresses_of_lame(solver):
    """In plane strain T_rr and T_33 = p a^2/(1 - a^2) (1 -+ 1/r^2).

    The error in L2, over the pressure, falls with the second order of P_1 from 6 to 12 cells, and is between
    1e-4 and 1e-2 with 12.
    """
    a, p, errors = 0.5, 1e-6, []
    for cells in (6, 12):
        run = about_the_axis(
            ring(a, cells),
            1e3,
            material=nv.LinearElastic(K_e=2.0, G_e=1.0),
            walls={"left": nv.Open(pressure=p), "right": nv.Open()},
            solver=solver,
        )
        run.run(8e3)
        T, of = run.fields["cauchy_stress"], p * a * a / (1 - a * a)
        radial, hoop = T[0, 0] - of * (1 - 1 / x**2), T[2, 2] - of * (1 + 1 / x**2)
        errors.append(Integrate(radial * radial + hoop * hoop, run.mesh) ** 0.5 * cells**0.5 / p)
    assert 1e-4 <= errors[1] <= errors[0] <= 1e-2
    assert 1.7 <= np.log2(errors[0] / errors[1]) <= 2.4


def test_translation_along_the_axis_leaves_a_strained_body_as_it_is():
    """A neo-Hookean body, stretched in one half of a periodic cylinder, is thrown along the axis, and keeps
    its momentum."""
    stretch = CF((1 + 0.2 * y * (1 - y) * x * x, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    run = about_the_axis(
        structured_box((1, 1), (3, 3), periodic="y"),
        material=nv.NeoHookean(K_e=1.0, G_e=0.5, epsilon=0.1, elastic_state="F"),
        velocity=(0, 0.05),
        values={"F": stretch},
        solver="split",
    )
    run.run(0.1)
    first, last = run.ledger.rows[0], run.ledger.rows[-1]
    assert first["momentum_2"] == pytest.approx(0.025, rel=1e-9)
    assert abs(last["momentum_2"] - first["momentum_2"]) <= 1e-9 * last["momentum_size"]
    assert last["momentum_size"] >= 1.02 * last["momentum_2"]  # parts of the body move in opposite directions


@pytest.mark.parametrize(
    ("field", "parts"),
    {
        "Simulation.symmetry": {"symmetry": "cylindrical"},
        "Simulation.symmetry ": {"mesh": box((1, 1, 1), 1.0)},
        "Simulation.symmetry  ": {"mesh": structured_box((1, 1), (2, 2), periodic="x")},
        "walls['left']": {"walls": {"left": nv.NoSlip()}},
        "loads['gravity']": {"loads": [nv.Gravity((1.0, 0.0))]},
        "Hyperviscosity": {"hyperviscosity": nv.HyperViscosity(mu=1e-3, p=4)},
        "CreepRate": {"creep": nv.Creep(G_m=1.0, nu=1.0, q=2)},
        "FieldDiffusion": {"regularisation": nv.Regularisation(delta_fields=1e-3)},
    }.items(),
)
def test_laws_and_walls_without_an_axisymmetric_form_are_refused(field, parts):
    with pytest.raises(ParameterError) as error:
        about_the_axis(**{"symmetry": "axisymmetric", **parts})
    assert field.strip() in str(error.value)


def test_a_mesh_with_points_beyond_the_axis_is_refused():
    mesh = MakeStructured2DMesh(quads=False, nx=2, ny=2, mapping=lambda r, h: (r - 0.5, h))
    with pytest.raises(MeshError, match=r"x = -0\.5 m"):
        about_the_axis(mesh)


def test_an_axisymmetric_run_refuses_a_checkpoint_of_plane_strain(tmp_path):
    """The runs have the same mesh, spaces and material."""
    path = tmp_path / "run.h5"
    run = small_run(velocity=(0, 0), observers=[nv.Checkpoints(path, every=1)])
    run.run(0.02)
    with pytest.raises(CheckpointError, match="about an axis"):
        about_the_axis().restore(path)


YIELDS = nv.Perzyna(G_m=2.0, sigma_Y=0.1, H=1.0)
GOES_ON = {
    "one body": {"creep": YIELDS, "passive": ["F_tot"], "walls": {"top": nv.Open(stiffness=(3.0, 1.0))}},
    "two bodies": {
        "bodies": [
            nv.Body(
                name="ball",
                material=nv.IsochoricNeoHookean(K_e=10.0, G_e=5.0),
                creep=YIELDS,
                density=2.0,
                where=nv.Ball((0.0, 0.5), 0.4),
            ),
            nv.Body(name="gas", material=nv.BarotropicFluid(B=2.5e-3, gamma=1.4), density=0.1),
        ],
        "discretisation": nv.Discretisation(k=1, m=0),
    },
}


# the gas has a small pressure at rest
@pytest.mark.filterwarnings("ignore:bodies .* meet with different stresses")
@pytest.mark.parametrize(
    ("solver", "name"),
    others_by_ci(product(SOLVERS, GOES_ON), ("coupled", "one body")),
)
def test_a_resumed_run_equals_the_uninterrupted_run_bit_for_bit(solver, name, tmp_path):
    """The run is resumed from the first step and from the last but one, with threads pinned to one, so that
    sums have one order."""
    SetNumThreads(1)

    def make(**options):
        time = nv.TimeSteps(dt=0.02, scheme="midpoint")
        return about_the_axis(velocity=VORTEX, time=time, solver=solver, **GOES_ON[name], **options)

    run = assert_goes_on(make, tmp_path / "run.h5", 0.08, 1, -2)
    assert run.ledger.rows[-1]["dissipation_creep"] > 0
