"""Every option has an effect: a changed key changes a result of a run, or is refused.

Each key of the reference has its example and another value, in cases that are otherwise equal.  The test
compares the mesh, and the state and the ledger's row after a step; for keys of output it compares the files
of a run.
"""

import copy
import hashlib
import re
import warnings
from functools import cache
from pathlib import Path

import h5py
import pytest
from ngsolve import CF, Integrate
from test_key_reference import CASES, placed

import ngvisco as nv
from ngvisco.case import toml
from ngvisco.case.build import parse_case
from ngvisco.errors import NgviscoError

ROOT = Path(__file__).parents[1]

ELSEWHERE = {
    "domain.adapt.above": "case/test_adapt.py",
    **dict.fromkeys(
        ("output.bodies.measures", "output.contours.every", "output.contours.bodies"),
        "case/test_body_cases.py",
    ),
    "domain.adapt.levels": "run/test_refinement.py",
    "domain.adapt.field": "case/test_adapt.py",
    "domain.adapt.every": "case/test_adapt.py",
    "domain.crossed": "geometries/test_geometries.py",
    **dict.fromkeys(("domain.split_corners", "domain.refine_corners"), "geometries/test_corner_cells.py"),
    "domain.path": "geometries/test_geometries.py",
    "domain.symmetry": "run/test_axisymmetric_terms.py",
    "domain.maxh file": "geometries/test_geometries.py",
    "domain.order file": "geometries/test_corner_cells.py",
    **dict.fromkeys(
        ("initial.equilibrium", "initial.datum", "initial.datum_point", "initial.datum_pressure"),
        "forms/test_equilibrium.py",
    ),
    "walls.NAME.amounts": "forms/test_what_flows_in.py",
    "bodies.N.where.names": "case/test_body_cases.py",
    "domain.refine sphere": "geometries/test_geometries.py",
    "material.breaking Damaged": "run/test_networks.py",
    "time.drift": "run/test_elastic_state.py",
    "material.E Prony": "case/test_network_cases.py",
    "material.C_1 Prony": "case/test_network_cases.py",
    "material.C_2 Prony": "case/test_network_cases.py",
    "material.theta_R Prony": "case/test_network_cases.py",
    "material.temperature Prony": "case/test_network_cases.py",
    "walls.NAME.backflow": "forms/test_wall_conditions.py",
    "walls.NAME.heat.friction_share": "forms/test_heat.py",
    "time.limiter": "timestepping/test_limiter.py",
    "time.adaptive.dt_min": "run/test_stepping.py",
    "time.halvings": "run/test_stepping.py",
    "solver.min_damping": "solver/test_newton.py",
    **dict.fromkeys(
        (f"material.{key} Python" for key in ("path", "law", "parameters")), "case/test_python_materials.py"
    ),
    "material.p_infinity": "physics/test_thermal.py",
    "bodies.N.where.path": "shapes/test_files.py",
    "bodies.N.where.low Image": "shapes/test_files.py",
    "bodies.N.where.high Image": "shapes/test_files.py",
    "time.adaptive.damage_growth": "run/test_damage.py",
    "bodies.N.where.scale": "shapes/test_files.py",
    "bodies.N.where.threshold": "shapes/test_files.py",
    "bodies.N.where.dark": "shapes/test_files.py",
    "bodies.N.order": "run/test_bodies.py",
    "bodies.N.parts": "run/test_parting.py",
}
"""Keys that need more than a step in a square to have an effect, with the tests that name them."""

SWIRL = {"initial.velocity": ["sin(pi*x)*cos(pi*y)", "-cos(pi*x)*sin(pi*y)"]}
STRAINED = {"initial.F": [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}
LINEAR = {"kind": "LinearElastic", "K_e": 10.0, "G_e": 5.0}
OLDROYD_B = {"kind": "OldroydB", "K_e": 10.0, "G_e": 5.0}
PUSHED = {"initial.velocity": ["sin(pi*x)", 0]}
GRADIENT = {"rheology.creep.nu": 0.1, **STRAINED}
WARM = {"material.thermal": {"c": 2.0, "theta_R": 300.0, "expansion": 1e-3}}
SOLUTE = {
    "material": {
        "kind": "Custom",
        "variables": ["A", "c = amount"],
        "energy": "10*(1 - A - 0.2*c)**2/A + 0.5*c**2/A",
    },
    "rheology.diffusion.variable": "c",
    "rheology.diffusion.mobility": 0.1,
    "initial.values": {"c": "0.5 + 0.1*x"},
}
HALF_BROKEN = {"initial.values": {"damage": 0.5}}

WITH = {
    "material.thermal.expansion": (WARM, 1e-3, 2e-3),
    "material.thermal.gruneisen": ({"material.thermal": {"c": 2.0, "theta_R": 300.0}}, 0.1, 0.2),
    "material.c Gas": ({}, 1e3, 2e3),
    "material.J_min": ({**PUSHED}, 0.99, 0.98),
    "material.healing_viscosity": (HALF_BROKEN, 1.0, 2.0),
    "material.kappa": ({"material.epsilon": 0.1}, 2.0, 3.0),
    "material.floor HardeningElastic": ({"material.s": 2.5}, 1e-8, 1e-3),
    "material.floor Damaged": (HALF_BROKEN, 1e-6, 1e-2),
    "material.parameters": ({**PUSHED}, {"G": 5.0}, {"G": 6.0}),
    "time.startup": ({"time.scheme": "midpoint"}, 0, 1),
    "time.adaptive.dt_max": ({}, 0.02, 0.01),
    "time.velocity_scale": ({"rheology.hyperviscosity.mu": 1e-3}, 1.0, 100.0),
    "time.theta": ({"time.scheme": "theta"}, 0.6, 0.9),
    "time.adaptive.tolerance": ({"time.adaptive.dt_min": 1e-6, "time.adaptive.dt_max": 0.1}, 1e-3, None),
    "time.adaptive.patience": ({"time.adaptive.dt_min": 0.001, "time.adaptive.dt_max": 0.1}, 1, 2),
    "walls.NAME.heat.temperature": (WARM, 300.0, 320.0),
    "walls.NAME.heat.coefficient": (WARM, 10.0, 20.0),
    "walls.NAME.heat.flux": (WARM, 10.0, 20.0),
    "walls.NAME.temperature": ({**WARM, **PUSHED}, 300.0, 320.0),
    "walls.NAME.straight": ({}, False, True),
    "walls.NAME.values": ({**PUSHED, "walls.left.density": 1.0}, {"J": 1.1}, {"J": 1.2}),
    "walls.NAME.velocity PrescribedTangential": ({}, [0.0, 0.1], [0.0, 0.2]),
    "walls.NAME.velocity Inflow": ({}, ["y*(1 - y)", 0.0], ["2*y*(1 - y)", 0.0]),
    "rheology.heat.conductivity": ({**WARM, "initial.temperature": "300 + x"}, 1.0, 2.0),
    "rheology.heat.source": (WARM, 100.0, 200.0),
    "rheology.heat.numerical_heating": (WARM, False, True),
    "rheology.diffusion.variable": (SOLUTE, "c", "d"),
    "rheology.diffusion.mobility": (SOLUTE, 0.1, 0.2),
    "rheology.diffusion.walls.NAME.potential": (
        {**SOLUTE, "rheology.diffusion.walls.left.coefficient": 1.0},
        0.6,
        0.8,
    ),
    "rheology.diffusion.walls.NAME.coefficient": (
        {**SOLUTE, "rheology.diffusion.walls.left.potential": 0.6},
        1.0,
        2.0,
    ),
    "rheology.diffusion.walls.NAME.flux": (SOLUTE, 0.1, 0.2),
    "rheology.viscosity.floor": ({}, 1e-9, 1.0),
    "rheology.hyperviscosity.floor": ({"rheology.hyperviscosity.p": 3.5}, 1e-10, 1.0),
    "rheology.regularisation.r": ({"rheology.regularisation.delta_density": 0.1}, 4.0, 3.0),
    "rheology.regularisation.p": ({"rheology.regularisation.epsilon": 0.1}, 4.0, 3.0),
    "rheology.regularisation.rho_max": ({}, 0.8, 0.9),
    "rheology.regularisation.width": ({"rheology.regularisation.rho_max": 0.8}, 1.0, 2.0),
    "rheology.regularisation.penalty": ({"rheology.regularisation.delta_density": 0.1}, 4.0, 8.0),
    "rheology.regularisation.gradient_floor": ({"rheology.regularisation.delta_density": 0.1}, 1e-3, 1.0),
    "rheology.regularisation.floor": (
        {"rheology.regularisation.epsilon": 0.1, "rheology.regularisation.p": 3.0},
        1e-10,
        1.0,
    ),
    "rheology.creep.law": ({"material": OLDROYD_B, **STRAINED}, "mandel", "conformation"),
    "rheology.creep.q": (GRADIENT, 4.0, 3.0),
    "rheology.creep.floor": ({**GRADIENT, "rheology.creep.q": 3.0}, 1e-10, 1.0),
    "rheology.creep.rate_floor": (GRADIENT, 1e-9, 1.0),
    "rheology.creep.b": ({"rheology.creep.Q": 1.0, **STRAINED}, 10.0, 20.0),
    "solver.tolerance": ({}, 1e-10, 1e-3),
    "solver.max_iterations": ({}, 60, 1),
    "solver.refresh": ({}, 0.25, 1e-3),
    "output.vtk.every": ({}, 1, 2),
    "output.vtk.subdivision": ({}, 0, 1),
    "output.lines.N.every": ({}, 1, 2),
    "output.checkpoint.every": ({}, 1, 10),
    "output.checkpoint.keep": ({"output.checkpoint.every": 1}, 1, 2),
    "title": ({"output.log_every": 1}, "one", "another"),
    "domain.inner": ({}, 0.4, 0.5),
    "domain.outer": ({}, 1.0, 1.2),
    "domain.radius block_with_hole": ({}, 0.2, 0.3),
    "domain.maxh": ({}, 0.5, 0.3),
    "domain.dim": ({}, 2, 3),
    "initial.temperature": (WARM, 300.0, 310.0),
    "loads.N.centre": ({}, [-1.0, -1.0], [-2.0, -1.0]),
    "loads.N.exponent": ({}, 0.0, 1.0),
    "loads.N.radius": ({"loads.0.exponent": 1.0}, 1.0, 2.0),
    "solver.method": ({}, "coupled", "split"),  # "auto" chooses the coupled solver for few cells
}
"""For each key, or key and kind: other values that the key needs to have an effect, and two values of the
key."""

IN_SECTION = {
    ("domain", "annulus"): {"domain.inner": 0.4},
    ("domain", "spherical_shell"): {"domain.inner": 0.4, "domain.maxh": 0.8},
    ("domain", "block_with_hole"): {"domain.radius": 0.2, "domain.maxh": 0.5},
    ("loads", "CentralGravity"): {"loads.0.centre": [-1.0, -1.0]},
    ("rheology", "Perzyna"): STRAINED,
    ("rheology", "Giesekus"): {"material": OLDROYD_B, **STRAINED},
    ("rheology", "PTT"): {"material": OLDROYD_B, **STRAINED},
    ("rheology", "DruckerPrager"): {"material": LINEAR, **STRAINED},
    ("domain", "sphere"): {"domain.maxh": 0.8},
    ("domain", "cylinder"): {"domain.maxh": 0.8},
    ("rheology", "Activated"): {"rheology.creep.temperature": 310.0},
    ("rheology", "WLF"): {"rheology.creep.temperature": 310.0},
    ("rheology", "ActivatedViscosity"): {"rheology.viscosity.temperature": 310.0},
    ("material", "Gas"): {"material.c": 1e3},
}
"""Values that a kind needs to be admitted, and to have an effect."""


@cache
def of_steps(text, steps):
    """Results of a case without output. Results are cached, since keys that one kind requires share the case
    with their examples."""
    case = parse_case(text, "case.toml", Path("."))
    run = case.simulation(case.mesh())
    rows = [run.advance() for _ in range(steps)]
    state = run.rothe_step.state.vec.FV().NumPy().tolist()
    return {"rows": str(rows), "state": str(state), "until": case.until}


def left_by(data, key, place):
    """Results of a case: for keys of the domain the mesh, for keys of output the files, for other keys a
    step's state and row."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        case = parse_case(toml.write(data), "case.toml", Path("."))
        if key.startswith("domain"):
            mesh = case.mesh()
            places = [[v.point for v in mesh.vertices], mesh.GetBoundaries(), mesh.GetCurveOrder()]
            return {"mesh": str(places), "volume": Integrate(CF(1.0), mesh)}
        if "output" not in data:
            return of_steps(toml.write(data), 2 if "adaptive" in data["time"] else 1)
        nv.case.run(case, place)
    found = {}
    for path in sorted(place.rglob("*")):
        if path.suffix in (".csv", ".vtu", ".pvd"):
            found[path.relative_to(place).as_posix()] = hashlib.sha256(path.read_bytes()).hexdigest()
    with h5py.File(place / "run.h5") as file:
        found["checkpoints"] = str(sorted(file["checkpoints"]))
    log = (place / "log.txt").read_text()
    return found | {"log": re.sub(r"\d+:\d+:\d+|\d+ s left", "", log)}


def other(entry, value):
    """Another value of the same kind."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return 1.3 * value if value else 0.3
    if isinstance(value, str):
        choices = re.findall(r'"([^"]*)"', entry.type) if entry.type.startswith("one of") else []
        others = [one for one in choices if one != value]
        return others[0] if others else f"1.3*({value})"
    if isinstance(value, list):
        return [other(entry, one) for one in value]
    return {name: other(entry, one) for name, one in value.items()}


def is_elsewhere(entry, kind):
    return entry.name in ELSEWHERE or f"{entry.name} {kind}" in ELSEWHERE


QUICK = 12
"""The default suite tries one key out of this number of keys, and CI tries all keys."""
TRIED = [
    pytest.param(*case.values, id=case.id, marks=(pytest.mark.long, pytest.mark.ci) if i % QUICK else ())
    for i, case in enumerate(one for one in CASES if not is_elsewhere(*one.values))
]


@pytest.mark.parametrize(("entry", "kind"), TRIED)
def test_each_key_has_an_effect_or_is_refused(entry, kind, tmp_path):
    data = placed(entry, kind)
    path = ".".join({"NAME": "left", "N": "0"}.get(part, part) for part in entry.path)
    default = ({}, entry.example, other(entry, entry.example))
    more, one, two = WITH.get(f"{entry.name} {kind}", WITH.get(entry.name, default))
    for key, value in {**SWIRL, **IN_SECTION.get((entry.path[0], kind), {}), **more}.items():
        toml.override(data, tuple(key.split(".")), value)
    if entry.path[:3] == ("bodies", "N", "where"):
        data["bodies"].append({"name": "rest", "density": 2.0, "material": data["bodies"][0]["material"]})
    found = []
    for name, value in (("one", one), ("two", two)):
        changed = copy.deepcopy(data)
        if value is None:
            changed["time"]["adaptive"].pop(entry.path[-1], None)
        else:
            toml.override(changed, tuple(path.split(".")), value)
        try:
            found.append(left_by(changed, path, tmp_path / name))
        except NgviscoError as error:
            assert found, f"the case itself is refused: {error}"
            found.append(str(error))
    if isinstance(found[1], str):
        assert entry.path[-1] in found[1] or "step of length" in found[1]
    assert found[0] != found[1], f"{entry.name} has no effect"


def test_keys_left_out_of_the_sweep_occur_in_another_test():
    for key, module in ELSEWHERE.items():
        text = (ROOT / module).read_text()
        name = key.split()[0].split(".")[-1]
        assert re.search(rf"\b{name}\s*=|[\"'.]{name}\b", text), f"{key} in {module}"
