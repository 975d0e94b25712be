"""Inputs of a script: wrong ones are refused by name before anything runs, NumPy's numbers are numbers."""

import math
import re

import numpy as np
import pytest
from ngsolve import CF, sqrt, x

import ngvisco as nv
from ngvisco.geometries import bar, box, channel, disc, load, refine_walls

SQUARE = box((1, 1), 2.0)
PAIR = CF((x, x))
LINEAR = nv.LinearElastic(K_e=10.0, G_e=5.0)
WARM = nv.Thermal(material=LINEAR, c=1.0, theta_R=1.0)
FINITE = nv.Model(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1))


def simulation(model=None, **options):
    return nv.Simulation(SQUARE, model or nv.Model(material=LINEAR), **{"dt": 0.1, **options})


WRONG = {
    "stepping": [lambda v=v: simulation(stepping=v) for v in (1, "a", {}, nv.AdaptiveSteps)],
    "walls": [
        lambda v=v: simulation(walls=v)
        for v in (
            1,
            "top",
            nv.NoSlip(),
            {"top": 1},
            {1: nv.NoSlip()},
            {"top": None},
            [nv.NoSlip()],
            [("top",)],
            {"top": nv.NoSlip},
            {("top", 1): nv.NoSlip()},
        )
    ],
    "observers": [
        lambda v=v: simulation(observers=v)
        for v in (1, None, "a", [1], [nv.Progress], nv.Progress(until=1), {"a": 1})
    ],
    "stops": [
        lambda v=v: simulation().run(0.2, v) for v in (1, None, "a", ["a"], [None], [math.nan], {"a": 1})
    ],
    "passive": [lambda v=v: simulation(passive=v) for v in (1, None, "F_tot", ["a"], [1])],
    "sources": [lambda v=v: simulation(sources=v) for v in (1, "a")],
    "solver": [lambda v=v: simulation(solver=v) for v in (1, "a", True, ["split"])],
    "dt": [lambda v=v: simulation(dt=v) for v in ("a", None, [1], np.array([0.1]), 1j, True)],
    "until": [lambda v=v: simulation().run(v) for v in ("a", None, [0.2], np.array([0.1]))],
    "velocity_scale": [lambda v=v: simulation(velocity_scale=v) for v in ("a", [1], 0, math.inf)],
    "initial": [
        lambda v=v: simulation(FINITE, initial=nv.Initial(**v))
        for v in (
            {"density": "1"},
            {"density": [1]},
            {"velocity": 1},
            {"velocity": "ab"},
            {"velocity": (1,)},
            {"velocity": {"x": 1}},
            {"velocity": (None, 1)},
            {"F": 1},
            {"F": [[1, 0], [0, 1]]},
            {"F": np.eye(2)},
            {"F": "I"},
            {"values": 1},
            {"values": {"J": "a"}},
            {"values": {"Q": 1}},
            {"values": {"F": np.eye(2)}},
            {"values": [1]},
        )
    ],
    "loads": [
        lambda v=v: simulation(nv.Model(material=LINEAR, loads=v))
        for v in (
            1,
            None,
            "a",
            [1],
            [nv.Gravity],
            nv.Gravity((0, 1)),
            [nv.Gravity((0, "1"))],
            [nv.Gravity(1)],
            [nv.Gravity((0, 1), name="")],
            [nv.Gravity((0, 1), name="a b")],
            [nv.Gravity((0, 1), name=3)],
            [nv.Gravity((0, 1), name="wall_top")],
            [nv.Gravity(None)],
            [nv.BodyForce({"a": 1})],
            [nv.Gravity((0, 1 / (x - x)))],
        )
    ],
    "central": [
        lambda v=v: nv.CentralGravity(strength=1.0, **v)
        for v in ({"centre": 1}, {"centre": "ab"}, {"centre": (1,)}, {"radius": "a"}, {"exponent": None})
    ],
    "walls2": [
        lambda v=v: simulation(walls={"top": v})
        for v in (
            nv.NavierFriction(x - 0.5),
            nv.PrescribedTangential(1),
            nv.PrescribedTangential((0, 1)),
            nv.PrescribedTangential("ab"),
            nv.Traction(f=1),
            nv.Traction(f=(1, "a")),
            nv.Traction(f=(sqrt(x - 0.5), 0)),
        )
    ],
    "heat": [
        lambda v=v: simulation(nv.Model(material=WARM, heat=nv.Heat(source=v.pop("source", None))), **v)
        for v in (
            {"source": sqrt(x - 0.5)},
            {"walls": {"top": nv.Slip(heat=nv.WallHeat(temperature=x - 0.5, coefficient=1.0))}},
            {"walls": {"top": nv.Slip(heat=nv.WallHeat(temperature=1.0, coefficient=x - 0.5))}},
            {"walls": {"top": nv.Slip(heat=nv.WallHeat(flux=sqrt(x - 0.5)))}},
        )
    ],
    "friction": [lambda v=v: nv.NavierFriction(v) for v in (None, "a", -1, [1], math.nan)],
    "mesh": [
        lambda v=v: nv.Simulation(v, nv.Model(material=LINEAR), dt=0.1) for v in (None, "a", SQUARE.ngmesh)
    ],
    "adaptive": [
        lambda v=v: nv.AdaptiveSteps(**{"dt_min": 0.1, "dt_max": 1.0, **v})
        for v in (
            {"dt_min": "a"},
            {"patience": 1.5},
            {"patience": "a"},
            {"tolerance": "a"},
            {"patience": 0},
            {"dt_min": None},
        )
    ],
    "checkpoints": [
        lambda v=v: nv.Checkpoints("unused.h5", **v)
        for v in ({"every": 0}, {"every": "a"}, {"keep": 1.5}, {"every": True})
    ]
    + [lambda: nv.Checkpoints(None), lambda: nv.Checkpoints(3)],
    "vtk": [
        lambda v=v: nv.VTKSeries("unused", **v)
        for v in (
            {"every": 0},
            {"subdivision": -1},
            {"subdivision": "a"},
            {"times": 1},
            {"times": ["a"]},
            {"fields": "J"},
            {"fields": 1},
        )
    ]
    + [lambda: nv.VTKSeries(None)],
    "progress": [lambda v=v: nv.Progress(v) for v in (None, "a", -1)] + [lambda: nv.Progress(1, every="a")],
    "refine": [lambda v=v: refine_walls(box((1, 1), 1), v) for v in (None, 1, ["a"])]
    + [lambda: refine_walls(box((1, 1), 1), "top", -1), lambda: refine_walls(box((1, 1), 1), "top", "a")],
    "geometry": [
        lambda: box((1, 1), 1, refine=1),
        lambda: box((1, 1), 1, refine={"top": "a"}),
        lambda: box((1, 1), 1, periodic="q"),
        lambda: box((1, 1), 1, periodic=1),
        lambda: box((1, 1), None),
        lambda: disc("a", 1),
        lambda: bar(1, 1, 1, dim=4),
        lambda: bar(1, 1, 1, dim="a"),
        lambda: channel(1, None, 1),
        lambda: load(None),
        lambda: load(3),
        lambda: box(None, 1),
        lambda: box({"a": 1, "b": 2}, 1),
    ],
    "regularisation": [
        lambda v=v: nv.Regularisation(**v)
        for v in ({"epsilon": "a"}, {"delta_density": -1}, {"rho_max": "a"}, {"rho_max": 0})
    ],
    "materials": [
        lambda v=v: nv.NeoHookean(**{"K_e": 10.0, "G_e": 5.0, "epsilon": 0.1, **v})
        for v in ({"kappa": "a"}, {"J_min": "a"}, {"J_min": -1}, {"kappa": -1}, {"K_e": [1]}, {"K_e": PAIR})
    ]
    + [
        lambda: nv.BarotropicFluid(B=1, gamma=1),
        lambda: nv.BarotropicFluid(B=1, gamma=1.4, form="Q"),
        lambda: nv.BarotropicFluid(B=1, gamma=1.4, form=1),
        lambda: nv.Yosida(material=1, eps=1),
        lambda: nv.WithQuadratic(material=LINEAR, delta=1, only="E2"),
        lambda: nv.WithQuadratic(material=LINEAR, delta=1, only=1),
        lambda: nv.WithQuadratic(material=LINEAR, delta="a"),
    ],
    "options": [
        lambda v=v: nv.NewtonOptions(**v)
        for v in (
            {"tolerance": "a"},
            {"max_iterations": "a"},
            {"max_iterations": True},
            {"inverse": 1},
            {"inverse": "mumps"},
            {"method": 1},
            {"coarse": 1},
            {"refresh": None},
        )
    ],
    "disc": [
        lambda v=v: nv.Discretisation(**v)
        for v in ({"k": "2"}, {"k": None}, {"m": 1.5}, {"quadrature_bonus": None}, {"k": [2]})
    ],
    "convexity": [
        lambda v=v: nv.check_convexity(LINEAR, **v)
        for v in ({"dim": 1}, {"dim": "a"}, {"spread": "a"}, {"seed": "a"})
    ]
    + [lambda: nv.check_convexity(1)],
    "restore": [lambda v=v: simulation().restore(v) for v in (None, 3, "/nonexistent")],
    "load": [lambda v=v: nv.load(v) for v in (None, 3, "/nonexistent")]
    + [lambda: nv.load_case(None), lambda: nv.load_case("/nonexistent")],
    "column": [lambda v=v: simulation().ledger.column(v) for v in (None, 3, "a")],
}

NUMBERS = {
    "dt": lambda: simulation(dt=np.float32(0.1)).run(np.float32(0.1)),
    "dt0": lambda: simulation(dt=np.array(0.1)).run(np.array(0.2), stops=np.array([0.1])),
    "mat": lambda: simulation(
        nv.Model(
            material=nv.NeoHookean(K_e=np.int64(10), G_e=np.float32(5), epsilon=np.array(0.1)),
            viscosity=nv.StokesViscosity(K_v=np.int32(1), G_v=np.float64(1)),
            creep=nv.Creep(G_m=np.array(5)),
            hyperviscosity=nv.HyperViscosity(mu=np.float32(1e-3), p=np.int64(4)),
        )
    ).run(0.1),
    "disc": lambda: simulation(discretisation=nv.Discretisation(k=np.int64(2), m=np.array(1))).run(0.1),
    "vel": lambda: simulation(initial=nv.Initial(velocity=np.array([0.0, 0.0]), density=np.float32(2))).run(
        0.1
    ),
    "velm": lambda: simulation(initial=nv.Initial(velocity=np.matrix([0.0, 0.0]))).run(0.1),
    "velm2": lambda: simulation(initial=nv.Initial(velocity=np.matrix([[0], [0]]))).run(0.1),
    "F": lambda: simulation(FINITE, initial=nv.Initial(F=np.diag([1.1, 1, 1]))).run(0.1),
    "Fm": lambda: simulation(FINITE, initial=nv.Initial(F=np.matrix(np.eye(3)))).run(0.1),
    "Fl": lambda: simulation(FINITE, initial=nv.Initial(F=[[1, 0, 0], [0, 1 + 0.1 * x, 0], [0, 0, 1]])).run(
        0.1
    ),
    "grav": lambda: simulation(
        nv.Model(material=LINEAR, loads=[nv.Gravity(np.array([0, -1])), nv.BodyForce(np.float32([0, 1]))])
    ).run(0.1),
    "box": lambda: box(np.array([1, 1]), np.float32(0.5), refine={"top": np.float64(0.2)}),
    "bar": lambda: bar(np.int64(2), np.float32(1), 1, dim=np.int64(2)),
    "steps": lambda: simulation(
        stepping=nv.AdaptiveSteps(dt_min=np.float32(0.01), dt_max=np.int64(1), patience=np.int64(2))
    ).run(0.1),
    "newton": lambda: simulation(
        newton=nv.NewtonOptions(tolerance=np.float64(1e-9), max_iterations=np.int32(30))
    ).run(0.1),
    "walls": lambda: simulation(
        walls={
            "top": nv.NavierFriction(np.int64(1)),
            "left": nv.Traction(f=np.array([0, 1.0]), friction=np.float32(0.1)),
            "bottom": nv.PrescribedTangential(np.array([1, 0])),
        }
    ).run(0.1),
    "scale": lambda: simulation(velocity_scale=np.float32(1)).run(0.1),
    "cg": lambda: nv.Simulation(
        SQUARE,
        nv.Model(
            material=LINEAR,
            loads=[nv.CentralGravity(strength=np.float32(1), centre=np.array([-1, 0]), exponent=np.int64(0))],
        ),
        dt=0.1,
    ).run(0.1),
    "chk": lambda: nv.Checkpoints("unused.h5", every=np.int64(2), keep=np.int32(1)),
    "conv": lambda: nv.check_convexity(LINEAR, dim=np.int64(2), spread=np.float32(0.3), seed=np.int64(1)),
}


@pytest.mark.parametrize(
    ("kind", "number"), [(kind, i) for kind, makers in WRONG.items() for i in range(len(makers))]
)
def test_a_wrong_input_is_refused_by_a_typed_error(kind, number):
    with pytest.raises(nv.NgviscoError) as error:
        WRONG[kind][number]()
    assert re.search("expected|known|no such|not a run|cannot be read", str(error.value))


@pytest.mark.filterwarnings("ignore:the matrix subclass:PendingDeprecationWarning")
@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_and_arrays_of_numpy_are_taken(name):
    NUMBERS[name]()
