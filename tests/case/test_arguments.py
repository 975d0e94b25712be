"""Arguments without a key in case files have an effect: another value changes the results, or is refused.

The tests in this file sweep the arguments of public classes that no key sets; ``tests/case/test_effects.py``
sweeps the keys of case files. Each argument has two values. The test compares the state and the ledger's row
after a step on six triangles; for classes that write it compares the files and columns of two steps.
"""

import inspect
import io
import re
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from ngsolve import CF, x
from support import LINEAR, SWIRL, one_of, small_run, state
from test_key_reference import ENTRIES, owners

import ngvisco as nv
from ngvisco.forms.context import time
from ngvisco.forms.term import Entry, Integrand, PointTerm
from ngvisco.physics.tensors import inner, square, tr
from ngvisco.physics.variables import Distortion, Jacobian, LeftCauchyGreen
from ngvisco.solver.options import SplitOptions

MADE = {
    *("Case", "ConvexityReport", "Fit", "Gradient", "IsotropyReport", "Rejection", "Transfer"),
    *("FlowRule", "Material", "Observer", "PointTerm", "Shape", "Viscosity"),
}
"""Classes that users do not make: classes of results, and base classes."""

BY_ITS_OWN = {
    "Body.order": "run/test_bodies.py",
    "Entry.difference_of": "forms/test_heat.py",
    "Body.parts": "run/test_parting.py",
    "Model.diffusion": "solver/test_diffusion.py",
    **dict.fromkeys(("Bodies.measures", "Contours.every", "Contours.bodies"), "run/test_outlines.py"),
    "NotebookProgress.seconds": "run/test_notebook.py",
    "NotebookProgress.until": "run/test_notebook.py",
    "CustomMaterial.bounds": "run/test_no_numbers.py",
    "Simulation.sources": "verification/test_convergence.py",
}
"""Arguments that need more than two steps on six triangles to have an effect, with the tests that name
them."""


def run_of(**options):
    """A run that starts from a swirl, unless another start is given."""
    starts = {} if "initial" in options or "sources" in options else {"velocity": SWIRL}
    return small_run(**starts | options)


def left_by(**options):
    run = run_of(**options)
    row = run.advance()
    return str(row), state(run).tolist()


def by_B(energy, **parameters):
    variables = (LeftCauchyGreen(exponent=-2 / 3), Jacobian())
    return nv.CustomMaterial(transported=variables, stored_energy=energy, **parameters)


def gent(B, J, G=5.0):
    return 5 * (J - 1) * (J - 1) + G * tr(B)


def by_F(F, J):
    return 5 * (J - 1) * (J - 1) + 5 * square(F)


FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 5 * (J - 2 + 1 / J))
HONEY = nv.StokesViscosity(K_v=0.1, G_v=0.1)
GAS = nv.Thermal(material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0), c=2.0, theta_R=300.0, expansion=1e-3)


def bodies(**changed):
    own = {"name": "disc", "where": nv.Ball((0.5, 0.5), 0.3), "material": FLUID, "density": 2.0} | changed
    run = run_of(bodies=[nv.Body(**own), nv.Body(name="rest", material=FLUID, density=1.0)])
    return str(run.advance()), sorted(run.fields), state(run).tolist()


def hot_bodies(heat):
    disc = {"name": "disc", "where": nv.Ball((0.5, 0.5), 0.3), "heat": heat}
    both = [nv.Body(**one, material=GAS, density=1.0) for one in (disc, {"name": "rest"})]
    return left_by(bodies=both, temperature=300 + 30 * x, velocity=SWIRL)


def carried(mean="arithmetic", **options):
    """A step with the modulus G = 1 + theta, where theta grows from 1 to 2 along x."""
    theta = nv.Parameter(**{"name": "theta", "start": 1 + x, "mean": mean} | options)
    return left_by(material=nv.LinearElastic(K_e=10.0, G_e=1.0 + theta))


class Drag(PointTerm):
    """The force -2 v per volume. Its ledger entry is the dissipated power 2 |v|^2; keyword arguments replace
    parts of the entry."""

    def __init__(self, **entry):
        self.entry = {"name": "drag", "kind": "dissipation"} | entry

    def cells(self, u, w):
        return 2 * inner(u.v, w.v)

    def entries(self, u):
        return [Entry(**{"integrand": Integrand(cells=2 * inner(u.v, u.v))} | self.entry)]


def dragged(material=None, **entry):
    """The row of a step with a drag, and the warnings."""
    options = {} if material is None else {"material": material, "temperature": 300.0}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        row = run_of(terms=[Drag(**entry)], **options).advance()
    return str(row), [str(warning.message) for warning in caught]


def integrand(**parts):
    of = {name: CF(value) for name, value in parts.items()}
    return dragged(integrand=Integrand(**of), kind="monitor")


def misfit(sigma=1.0, value=0.1):
    return nv.Misfit(data={"kinetic at 0.04": value}, sigma=sigma).residuals(np.array([0.3])).tolist()


def tableau(A, b, name="own"):
    return left_by(scheme=nv.TimeScheme(name=name, A=A, b=b))


GAMMA = 1 - 0.5**0.5
SDIRK = ((GAMMA, 0.0), (1 - GAMMA, GAMMA))
POINTS = {"middle": (0.5, 0.4)}
IN_ROWS = {"every": (1, 2), "path": ("a.csv", "b.csv")}


MODEL = nv.Model(material=LINEAR)
OTHER = nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=1.0))
PAIRS = {
    "CustomMaterial.transported": [
        partial(left_by, material=by_B(gent)),
        partial(
            left_by, material=nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=by_F)
        ),
    ],
    "CustomMaterial.stored_energy": [
        partial(left_by, material=by_B(gent)),
        partial(left_by, material=by_B(lambda B, J: gent(B, J, 6.0))),
    ],
    "CustomMaterial.rho_R": [
        partial(left_by, material=by_B(gent, rho_R=rho), density=None, velocity=SWIRL) for rho in (1.0, 2.0)
    ],
    "IsotropicStrainEnergy.strain_energy": [
        partial(left_by, material=nv.IsotropicStrainEnergy(strain_energy=lambda E, G=G: G * square(E)))
        for G in (5.0, 6.0)
    ],
    "PerMass.material": [
        partial(left_by, material=nv.PerMass(material=nv.NeoHookean(K_e=10.0, G_e=G, epsilon=0.1), rho_R=1.0))
        for G in (5.0, 6.0)
    ],
    "PerMass.rho_R": [
        partial(
            left_by, material=nv.PerMass(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1), rho_R=rho)
        )
        for rho in (1.0, 2.0)
    ],
    "Parameter.name": [lambda name=name: [nv.Parameter(name).name] for name in ("theta", "chi")],
    "Parameter.kind": [partial(carried, kind=kind) for kind in ("scalar", "full")],
    "Parameter.start": [partial(carried, start=start) for start in (1 + x, 2 + x)],
    "Parameter.typical": [
        lambda typical=typical: (5.0 + nv.Parameter("theta", start=x, typical=typical)).typical
        for typical in (1.0, 2.0)
    ],
    "Parameter.mean": [partial(carried, mean=mean) for mean in ("arithmetic", "harmonic")],
    "Model.material": [partial(left_by, material=of.material) for of in (MODEL, OTHER)],
    "Model.viscosity": [partial(left_by, viscosity=of) for of in (None, HONEY)],
    "Model.hyperviscosity": [
        partial(left_by, hyperviscosity=of) for of in (None, nv.HyperViscosity(mu=1e-3, p=4))
    ],
    "Model.creep": [
        partial(left_by, creep=of, F=[[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]) for of in (None, nv.Creep(G_m=1.0))
    ],
    "Model.loads": [partial(left_by, loads=of) for of in ((), (nv.Gravity((0.0, -1.0)),))],
    "Model.regularisation": [
        partial(left_by, regularisation=of) for of in (None, nv.Regularisation(delta_density=0.1))
    ],
    "Model.bodies": [partial(bodies, density=rho) for rho in (2.0, 3.0)],
    "Model.heat": [
        partial(left_by, material=GAS, temperature=300 + 30 * x, velocity=SWIRL, heat=of)
        for of in (None, nv.Heat(conductivity=1.0))
    ],
    "Body.name": [partial(bodies, name=name) for name in ("disc", "ball")],
    "Body.where": [partial(bodies, where=nv.Ball((0.5, 0.5), radius)) for radius in (0.3, 0.4)],
    "Body.material": [
        partial(bodies, material=of) for of in (FLUID, nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0))
    ],
    "Body.viscosity": [partial(bodies, viscosity=of) for of in (None, HONEY)],
    "Body.creep": [
        partial(bodies, material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0), creep=of)
        for of in (None, nv.Creep(G_m=0.1))
    ],
    "Body.heat": [partial(hot_bodies, of) for of in (None, nv.Heat(conductivity=1.0))],
    "Body.density": [partial(bodies, density=rho) for rho in (2.0, 3.0)],
    "Entry.name": [partial(dragged, name=name) for name in ("drag", "pull")],
    "Entry.kind": [partial(dragged, kind=kind) for kind in ("dissipation", "monitor")],
    "Entry.integrand": [partial(integrand, cells=value) for value in (1.0, 2.0)],
    "Entry.evaluate": [
        partial(dragged, integrand=Integrand(), kind="monitor", evaluate=lambda number=number: number)
        for number in (1.0, 2.0)
    ],
    "Entry.is_outside": [partial(dragged, GAS, is_outside=of) for of in (True, False)],
    "Entry.has_sign": [
        partial(dragged, integrand=Integrand(cells=CF(-1.0)), has_sign=of) for of in (True, False)
    ],
    "Integrand.cells": [partial(integrand, cells=value) for value in (1.0, 2.0)],
    "Integrand.facets": [partial(integrand, facets=value) for value in (1.0, 2.0)],
    "Integrand.collocated": [partial(integrand, collocated=value) for value in (1.0, 2.0)],
    "Misfit.data": [partial(misfit, value=value) for value in (0.1, 0.2)],
    "Misfit.sigma": [partial(misfit, sigma=value) for value in (1.0, 2.0)],
    "TimeScheme.name": [
        lambda name=name: nv.TimeScheme(name=name, A=((1.0,),), b=(1.0,)).name for name in "ab"
    ],
    "TimeScheme.A": [partial(tableau, A, (1.0,)) for A in (((1.0,),), ((0.5,),))],
    "TimeScheme.b": [partial(tableau, SDIRK, b) for b in ((1 - GAMMA, GAMMA), (0.5, 0.5))],
    "NewtonOptions.split": [
        partial(left_by, newton=nv.NewtonOptions(method="split", split=SplitOptions(margin=margin)))
        for margin in (0.1, 1e-9)
    ],
    "Simulation.mesh": [partial(left_by, mesh=mesh) for mesh in (0.5, 0.4)],
    "Simulation.model": [lambda of=of: left_by(material=of.material) for of in (MODEL, OTHER)],
    "Simulation.time": [partial(left_by, time=nv.TimeSteps(dt=dt)) for dt in (0.02, 0.01)],
    "Simulation.initial": [
        partial(left_by, initial=nv.Initial(density=1.0, velocity=SWIRL, F=F))
        for F in (None, [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]])
    ],
    "Simulation.walls": [partial(left_by, walls=of) for of in ({}, {"left": nv.NoSlip()})],
    "Simulation.discretisation": [
        partial(left_by, discretisation=nv.Discretisation(k=2, m=m)) for m in (1, 2)
    ],
    "Simulation.newton": [
        partial(left_by, newton=nv.NewtonOptions(method="coupled", tolerance=of)) for of in (1e-10, 1e-2)
    ],
    "Simulation.solver": [partial(left_by, solver=of) for of in ("coupled", "split")],
    "Simulation.observers": [
        lambda of=of: (run_of(observers=of).advance(), len(of)) for of in ([], [nv.Bodies()])
    ],
    "Simulation.terms": [partial(left_by, terms=of) for of in ((), (Drag(),))],
    "Simulation.passive": [lambda of=of: sorted(run_of(passive=of).fields) for of in ((), ("F_tot",))],
    "Simulation.symmetry": [partial(left_by, symmetry=of) for of in ("none", "axisymmetric")],
    "Simulation.steps": [partial(left_by, dt=dt) for dt in (0.02, 0.01)],
}
"""For each argument, two runs that differ in this argument alone."""
HOW = {
    "Bodies": (nv.Bodies, {}, {"every": (1, 2), "path": ("a.csv", "b.csv")}),
    "Checkpoints": (
        nv.Checkpoints,
        {"path": "run.h5", "every": 1},
        {"path": ("run.h5", "b.h5"), "every": (1, 5), "keep": (2, 1), "attributes": (None, {"by": "a test"})},
    ),
    "Contours": (nv.Contours, {"directory": "contours"}, {"directory": ("contours", "others")}),
    "Integrals": (
        nv.Integrals,
        {"integrands": {"mass": "density"}},
        IN_ROWS | {"integrands": ({"mass": "density"}, {"mass": "2*density"})},
    ),
    "LedgerCSV": (nv.LedgerCSV, {}, {"path": ("a.csv", "b.csv")}),
    "LineSamples": (
        nv.LineSamples,
        {"start": (0.1, 0.1), "end": (0.9, 0.9), "points": 3, "path": "line.csv"},
        {"start": ((0.1, 0.1), (0.2, 0.1)), "end": ((0.9, 0.9), (0.8, 0.9)), "points": (3, 4)}
        | {"fields": (["density"], ["J"]), "every": (1, 2), "path": ("a.csv", "b.csv")},
    ),
    "Probes": (
        nv.Probes,
        {"points": POINTS},
        IN_ROWS | {"points": (POINTS, {"middle": (0.4, 0.5)}), "fields": (["density"], ["J"])},
    ),
    "Progress": (
        nv.Progress,
        {"until": 0.04},
        {"every": (1, 5), "until": (0.04, 40.0), "stream": (None, None)},
    ),
    "VTKSeries": (
        nv.VTKSeries,
        {"directory": "vtk", "every": 5},
        {"directory": ("vtk", "other"), "every": (1, 2), "fields": (["density"], ["J"])}
        | {"subdivision": (0, 1), "times": ((), (0.02,))},
    ),
    "WallForces": (
        nv.WallForces,
        {},
        IN_ROWS | {"walls": (["left"], ["right"]), "about": ((0.0, 0.0), (0.0, 1.0))},
    ),
}
"""For each class that writes files: the class, its required arguments, and two values of each other
argument."""
OBSERVED = [(name, argument) for name, (_, _, of) in HOW.items() for argument in of]


@pytest.mark.parametrize("argument", one_of(3, PAIRS))
def test_each_argument_has_an_effect_or_is_refused(argument):
    found = []
    for leave in PAIRS[argument]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            time.Set(0.0)
            try:
                found.append(leave())
            except nv.NgviscoError as error:
                assert found, f"the first is refused: {error}"
                found.append(str(error))
    assert found[0] != found[1], f"{argument} has no effect"


@pytest.mark.parametrize("observed", one_of(3, OBSERVED), ids=".".join)
def test_arguments_of_observers_that_write_output_have_an_effect(observed, tmp_path):
    name, argument = observed
    cls, needed, of = HOW[name]
    found = []
    for i, value in enumerate(of[argument]):
        place = tmp_path / str(i)
        place.mkdir()
        streams = io.StringIO(), io.StringIO()
        given = {**needed, argument: value}
        if name == "Progress":  # the second stream gets the text that the first stream does not get
            given["stream"] = streams[i if argument == "stream" else 0]
        given = {k: place / v if k in ("path", "directory") else v for k, v in given.items()}
        observer = cls(**given)
        disc = nv.Body(name="disc", where=nv.Ball((0.5, 0.5), 0.3), material=FLUID, density=1.0)
        both = {"bodies": [disc, nv.Body(name="rest", material=FLUID, density=1.0)]}
        run_of(observers=[observer], **(both if name in ("Bodies", "Contours") else {})).run(0.04)
        files = [path for path in sorted(place.rglob("*")) if path.is_file()]
        left = [(path.relative_to(place).as_posix(), path.read_bytes()) for path in files]
        said = [re.sub(r"[\d.]+ s(?= left)", "", stream.getvalue()) for stream in streams]
        found.append((left, str(getattr(observer, "rows", None)), said))
    assert found[0] != found[1], f"{name}.{argument} has no effect"


def arguments():
    """Public classes with their arguments that no key of a case file sets."""
    keys, described = {entry.path[-1] for entry in ENTRIES}, owners()
    for name in nv.__all__:
        cls = getattr(nv, name)
        if not inspect.isclass(cls) or issubclass(cls, BaseException) or name in MADE:
            continue
        of_cases = keys if cls in described else set()
        yield from (f"{name}.{one}" for one in inspect.signature(cls).parameters if one not in of_cases)


def test_the_sweep_of_arguments_contains_every_argument():
    swept = {*PAIRS, *(f"{name}.{argument}" for name, argument in OBSERVED), *BY_ITS_OWN}
    assert set(arguments()) <= swept
    for argument, module in BY_ITS_OWN.items():
        text = (Path(__file__).parents[1] / module).read_text()
        name = argument.split(".")[-1]
        assert re.search(rf"\b{name}\s*=|[\"']{name}[\"']", text), f"{argument} in {module}"
