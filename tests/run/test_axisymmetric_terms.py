"""Every kind of term about an axis: heat, bodies, damage, diffusion, passive fields, transfer, case files."""

import numpy as np
import pytest
from ngsolve import x, y
from support import by_both_solvers, by_ci, small_run

import ngvisco as nv
from ngvisco.case.build import parse_case
from ngvisco.case.faults import CaseError
from ngvisco.errors import ParameterError
from ngvisco.geometries import structured_box

VORTEX = (0.3 * x * (1 - x) * (1 - 2 * y), -0.3 * (2 - 3 * x) * y * (1 - y))
"""The flow v_r and v_y, without divergence about the axis x = 0."""
ELASTIC = nv.LinearElastic(K_e=10.0, G_e=5.0)
HOT = nv.Thermal(material=ELASTIC, c=2.0, theta_R=100.0, expansion=1e-3)
WET = nv.StokesViscosity(K_v=0.1, G_v=0.1)
SOFT = nv.ReferentialNeoHookean(K_e=10.0, G_e=2.0)
BODIES = [
    nv.Body(
        name="ball",
        material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0),
        creep=nv.Perzyna(G_m=2.0, sigma_Y=0.1, H=1.0),
        density=2.0,
        where=nv.Ball((0.0, 0.5), 0.4),
    ),
    nv.Body(name="rest", material=SOFT, viscosity=WET, density=1.0),
]
TERMS = {
    "heat": {
        "material": HOT,
        "viscosity": WET,
        "heat": nv.Heat(conductivity=0.5, source=1.0),
        "walls": {"right": nv.Slip(heat=nv.WallHeat(temperature=90.0, coefficient=2.0))},
    },
    "bodies": {"bodies": BODIES},
    "diffusion of the density": {"regularisation": nv.Regularisation(delta_density=1e-2)},
    "cut-off and damping": {"regularisation": nv.Regularisation(rho_max=0.9, width=0.5, epsilon=0.1)},
    "damage": {"material": nv.Damaged(material=ELASTIC, G_c=0.1, length=0.5)},
    "springs": {"walls": {"right": nv.Open(stiffness=(3.0, 1.0))}, "creep": nv.Creep(G_m=1.0)},
}


@pytest.mark.parametrize("name", [by_ci(name) if name == "bodies" else name for name in TERMS])
def test_the_ledger_closes_and_both_solvers_agree(name):
    def make(solver):
        return small_run(symmetry="axisymmetric", velocity=VORTEX, solver=solver, **TERMS[name])

    for run in by_both_solvers(make, 0.04):
        last = run.ledger.rows[-1]
        if name == "bodies":
            assert not any(value < 0 for key, value in last.items() if key.startswith("dissipation_creep"))
        if name == "heat":
            made = sum(value for key, value in last.items() if key.startswith("entropy_"))
            change = run.ledger.rows[-1]["entropy"] - run.ledger.rows[-2]["entropy"]
            assert 0.02 * (made) == pytest.approx(change, rel=1e-9)


@pytest.mark.long
@pytest.mark.ci
def test_heat_of_a_rod_leaves_through_its_side():
    """If heat is produced evenly, the mean temperature exceeds the temperature outside by q R^2/(8 kappa) + q
    R/(2 h). On eight cells, the error is between a millionth and two thousandths."""
    q, kappa, h = 0.08, 0.5, 2.0
    run = small_run(
        structured_box((1, 0.125), (8, 1)),
        5.0,
        symmetry="axisymmetric",
        material=nv.Thermal(material=ELASTIC, c=2.0, theta_R=100.0, expansion=0.0),
        heat=nv.Heat(conductivity=kappa, source=q),
        walls={"right": nv.Slip(heat=nv.WallHeat(temperature=100.0, coefficient=h))},
        solver="coupled",
    )
    run.run(30.0)
    mean = run.rothe_step.quadrature.integrate_cells(run.fields["temperature"]) / 0.0625 - 100.0
    off = abs(mean / (q / (8 * kappa) + q / (2 * h)) - 1)
    assert 1e-6 <= off <= 2e-3


def test_without_creep_the_total_distortion_equals_F():
    run = small_run(
        0.4,
        0.01,
        symmetry="axisymmetric",
        velocity=VORTEX,
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        passive=["F_tot"],
        discretisation=nv.Discretisation(m=2),
    )
    run.run(0.1)
    at = run.mesh(0.31, 0.17)
    F, F_tot = (np.reshape(run.fields[name](at), (3, 3)) for name in ("F", "F_tot"))
    assert np.abs(F - F_tot).max() <= 0.05 * np.abs(F - np.eye(3)).max()
    assert abs(F[2, 2] - 1) >= 0.2 * np.abs(F - np.eye(3)).max()
    assert np.linalg.det(F) == pytest.approx(run.fields["J"](at), abs=2e-3)


def test_a_transfer_of_an_axisymmetric_run_keeps_the_mass():
    runs = [small_run(h, symmetry="axisymmetric", density=1 + x * y, velocity=VORTEX) for h in (0.5, 0.3)]
    runs[0].run(0.04)
    done = nv.transfer(*runs)
    assert done.mass == pytest.approx(runs[0].ledger.rows[-1]["mass"], rel=1e-12)
    assert abs(done.scaled - 1) <= 1e-2
    with pytest.raises(ParameterError, match="symmetry 'none'"):
        nv.transfer(runs[0], small_run(0.3))


CASE = """
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.5
symmetry = "axisymmetric"

[material]
kind = "LinearElastic"
K_e = 10
G_e = 5

[initial]
velocity = ["0.3*x*(1 - x)", 0]

[time]
dt = 0.02
until = 0.04
"""


def test_a_case_file_sets_the_symmetry(tmp_path):
    """With domain.symmetry the mass is that of a cylinder over 2 pi, and the case differs from that in plane
    strain."""
    case, plane = (
        parse_case(text, "case.toml", tmp_path) for text in (CASE, CASE.replace("axisymmetric", "none"))
    )
    assert case.simulation(case.mesh()).run(0.04).rows[-1]["mass"] == pytest.approx(0.5, rel=1e-12)
    assert case.hash != plane.hash
    assert 'symmetry = "axisymmetric"' in case.resolved


def test_an_axisymmetric_case_on_a_three_dimensional_mesh_is_refused_under_its_key(tmp_path):
    text = CASE.replace("size = [1, 1]", "size = [1, 1, 1]").replace('x)", 0]', 'x)", 0, 0]')
    case = parse_case(text, "case.toml", tmp_path)
    with pytest.raises(CaseError, match=r"domain\.symmetry"):
        case.simulation(case.mesh())
