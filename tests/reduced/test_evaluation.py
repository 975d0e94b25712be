"""What a term asks for at points; that its rows are those of its form holds ``solver/test_split_solver``."""

import pytest
from support import swirling

import ngvisco as nv
from ngvisco.geometries import disc
from ngvisco.reduced.claims import Claims, asked_slots
from ngvisco.reduced.evaluation import NotAtPointsError


def test_what_a_term_asks_for_is_found_without_values():
    step = swirling(creep=nv.Creep(G_m=0.5, nu=1e-3), solver="split").rothe_step
    asked = {
        type(t).__name__: asked_slots(step, t, step.tabulated_rates)[0] for t in Claims.of(step).at_points
    }
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
