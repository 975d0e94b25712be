"""A solute that spreads and swells a gel, by both solvers, and its exchange through walls."""

import numpy as np
import pytest
from ngsolve import CF, cos, pi, x, z
from test_facet_tangent import VISCOSITY, swelling

import ngvisco as nv
from ngvisco.errors import ParameterError
from ngvisco.forms.term import PointTerm
from ngvisco.geometries import box
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Concentration, Distortion, Jacobian, ReciprocalJacobian


def gel(energy=swelling):
    return nv.CustomMaterial(transported=(ReciprocalJacobian(), Concentration()), stored_energy=energy)


def run_of(solver="auto", maxh=0.15, walls=None, through=None, start=None, material=None, **options):
    law = nv.Diffusion(variable="c", mobility=0.1, walls=through or {})
    model = nv.Model(material=material or gel(), viscosity=VISCOSITY, diffusion=law)
    initial = nv.Initial(values={"c": 0.5 + 0.3 * cos(pi * x) if start is None else start}, density=1.0)
    options = {"dt": 0.05, "initial": initial, "walls": walls or {}, "solver": solver} | options
    return nv.Simulation(box((1, 1), maxh=maxh), model, **options)


GROWN = 1 - cos(10 * nv.time)
FLUX = {"left": nv.WallExchange(flux=0.05 * GROWN)}


def both(parts, until):
    """Ledgers by the split solver, which ``"auto"`` chooses for 98 triangles, and by the coupled solver."""
    runs = [run_of(solver, **parts) for solver in ("auto", "coupled")]
    ledgers = [run.run(until=until) for run in runs]
    assert runs[0].mesh.ne == 98 and runs[0].solver.method == "split"
    for ledger in ledgers:
        assert abs(ledger.column("closure_relative")).max() < 1e-12
    for name in ("kinetic", "stored", "amount_c", "dissipation_diffusion_c", "exchange_c_left"):
        split, coupled = (ledger.column(name)[1:] for ledger in ledgers)
        assert np.allclose(split, coupled, rtol=1e-9, atol=0), name
    return ledgers


def test_swelling_is_the_same_by_both_solvers_in_eight_iterations_a_step():
    for ledger in both({"through": FLUX}, until=0.1):
        assert ledger.column("newton_iterations").max() <= 8


@pytest.mark.long
@pytest.mark.parametrize("top", [nv.Open(), nv.Open(values={"c": 0.5})], ids=["open", "given value"])
def test_swelling_is_the_same_by_both_solvers_where_matter_crosses_a_wall(top):
    both({"through": FLUX, "walls": {"top": top}}, until=0.1)


@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_the_amount_grows_by_the_exchange_through_walls(solver):
    through = {"left": nv.WallExchange(flux=0.1), "right": nv.WallExchange(potential=0.6, coefficient=2.0)}
    ledger = run_of(solver, 0.6, through=through).run(until=0.15)
    came = 0.05 * (ledger.column("exchange_c_left") + ledger.column("exchange_c_right"))[1:]
    assert abs(came).max() > 1e-3
    assert np.allclose(np.diff(ledger.column("amount_c")), came, rtol=1e-12)


def test_an_exchange_that_reads_z_is_refused_in_the_plane():
    with pytest.raises(ParameterError, match=r"walls\['left'\] = .*a mesh in the plane has no z"):
        run_of(through={"left": nv.WallExchange(potential=z, coefficient=1.0)})


def test_the_steady_potential_is_linear_between_a_flux_and_a_reservoir():
    """In the steady state mu = p + q/h at the reservoir's wall, with the slope -q/M."""
    flux, potential, coefficient = 0.02, 0.6, 2.0
    through = {
        "left": nv.WallExchange(flux=flux),
        "right": nv.WallExchange(potential=potential, coefficient=coefficient),
    }
    run = run_of("split", 0.6, through=through, start=CF(0.5), dt=20.0)
    run.run(until=400.0)
    mu = run.rothe_step.now.zeta_tensors["c"]
    for place in (0.1, 0.9):
        expected = potential + flux / coefficient + flux / 0.1 * (1 - place)
        assert abs(mu(run.mesh(place, 0.4)) / expected - 1) < 1e-6


def test_a_resumed_run_with_diffusion_equals_the_uninterrupted_run(tmp_path):
    whole = run_of(maxh=0.6, solver="split").run(until=0.2)
    checkpoints = nv.Checkpoints(tmp_path / "run.h5")
    run_of(maxh=0.6, solver="split", observers=[checkpoints]).run(until=0.1)
    second = run_of(maxh=0.6, solver="split")
    second.restore(tmp_path / "run.h5")
    again = second.run(until=0.2)
    assert again.column("stored")[-1] == whole.column("stored")[-1]


class Reader(PointTerm):
    """A term of one's own that reads c."""

    def cells(self, u, w):
        return [u.z_tensors["c"] * w.rho]


def test_a_material_without_the_variable_is_refused_by_name():
    rubber = nv.NeoHookean(K_e=10, G_e=5, epsilon=0.1)
    with pytest.raises(ParameterError, match=r"Diffusion.variable = 'c'.*conserved scalar.*NeoHookean"):
        run_of(material=rubber)
    with pytest.raises(
        ParameterError, match=r"since the term Reader reads 'c', which the material does not carry"
    ):
        nv.Simulation(box((1, 1), maxh=0.6), nv.Model(material=rubber), dt=0.1, terms=[Reader()])


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"through": {"nowhere": nv.WallExchange(flux=1.0)}}, "nowhere"),
        ({"discretisation": nv.Discretisation(m=0)}, "no gradient"),
    ],
)
def test_impossible_diffusion_is_refused_with_the_reason(parts, message):
    with pytest.raises(Exception, match=message):
        run_of(maxh=0.6, **parts)


def test_a_wall_that_exchanges_nothing_is_refused():
    with pytest.raises(ParameterError, match="a flux, or a potential and a coefficient"):
        nv.WallExchange()
    with pytest.raises(ParameterError, match="have to be given together"):
        nv.WallExchange(potential=1.0)


def test_start_values_of_a_solute_do_not_contradict_the_distortion(recwarn):
    def energy(F, J, c):
        return square(F) + 5 * (J - 1 - c) * (J - 1 - c) + c * c

    gel = nv.CustomMaterial(transported=(Distortion(), Jacobian(), Concentration("c")), stored_energy=energy)
    start = nv.Initial(values={"c": 0.5})
    nv.Simulation(box((1, 1), maxh=1), nv.Model(material=gel), dt=0.05, initial=start)
    assert not [str(warning.message) for warning in recwarn if "does not follow" in str(warning.message)]
