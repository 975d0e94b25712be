"""Tools of the unit tests: constant tensors to and from NGSolve, random states, differences, small runs."""

import importlib.util
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from materials import examples
from netgen.meshing import Element2D, FaceDescriptor, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import (
    CF,
    BaseVector,
    BilinearForm,
    CoefficientFunction,
    GridFunction,
    Id,
    Mesh,
    OuterProduct,
    Trace,
    cos,
    pi,
    sin,
    x,
    y,
)
from ngsolve.meshes import MakeStructured3DMesh

import ngvisco as nv
from ngvisco.case import reference
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.start.initial import set_initial
from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand
from ngvisco.geometries import annulus, box, channel, disc
from ngvisco.physics.tensors import dev, square
from ngvisco.run.ledger import Ledger
from ngvisco.run.stepping import Rejection
from ngvisco.solver.problem import Interval
from ngvisco.solver.rothe import RotheSolver


@cache
def one_triangle() -> Mesh:
    """A mesh of one element, for evaluating constant coefficient functions."""
    mesh = NetgenMesh(dim=2)
    corners = [mesh.Add(MeshPoint(Pnt(x, y, 0))) for x, y in ((0, 0), (1, 0), (0, 1))]
    mesh.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    mesh.Add(Element2D(1, corners))
    return Mesh(mesh)


def tensor(array: np.ndarray) -> CoefficientFunction:
    """A constant coefficient function with the entries and the shape of ``array``."""
    array = np.asarray(array, dtype=float)
    return CF(tuple(array.ravel()), dims=array.shape) if array.shape else CF(float(array))


def value(f: CoefficientFunction) -> np.ndarray:
    """The value of a constant coefficient function, as an array of its shape."""
    flat = np.asarray(f(one_triangle()(0.3, 0.3)))
    return flat.reshape(tuple(f.dims))


def values(named: Mapping[str, CoefficientFunction]) -> dict[str, np.ndarray]:
    return {name: value(f) for name, f in named.items()}


def tensors(named: Mapping[str, np.ndarray]) -> dict[str, CoefficientFunction]:
    return {name: tensor(array) for name, array in named.items()}


def trace_free(A: np.ndarray) -> np.ndarray:
    return A - np.trace(A) / 3 * np.eye(3)


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    Q, R = np.linalg.qr(rng.standard_normal((3, 3)))
    Q = Q @ np.diag(np.sign(np.diag(R)))
    return Q if np.linalg.det(Q) > 0 else -Q


def plane_strain(A: np.ndarray) -> np.ndarray:
    """A copy of ``A`` with zero 13, 23, 31, 32 entries."""
    A = A.copy()
    A[:2, 2] = A[2, :2] = 0.0
    return A


def central_difference(f: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    """The derivative f'(0) by differences of fourth order in h."""
    return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)


def uncondensed(step: Step, integrands: list[Integrand] | None = None) -> BilinearForm:
    """A form of ``integrands``, or of all terms of the step, without static condensation."""
    form = BilinearForm(step.layout.space, check_unused=False)
    if integrands is None:
        trial, test = step.layout.space.TnT()
        u, w = Fields.of(step.layout, trial), Fields.of(step.layout, test)
        integrands = [part for term in step.terms for part in term.form(u, w)]
    step.quadrature.add(form, integrands)
    return form


def residual(form: BilinearForm, state: BaseVector) -> np.ndarray:
    """The residual R(state; .) as an array of coefficients."""
    result = state.CreateVector()
    form.Apply(state, result)
    return result.FV().NumPy().copy()


def jacobian_times(form: BilinearForm, state: BaseVector, direction: BaseVector) -> np.ndarray:
    form.AssembleLinearization(state)
    result = state.CreateVector()
    result.data = form.mat * direction
    return result.FV().NumPy().copy()


def difference_times(
    form: BilinearForm, state: BaseVector, direction: BaseVector, h: float = 1e-3
) -> np.ndarray:
    """The derivative of ``residual`` in ``direction`` by central differences of fourth order."""
    shifted = state.CreateVector()

    def shifted_residual(s: float) -> np.ndarray:
        shifted.data = state + s * direction
        return residual(form, shifted)

    return central_difference(shifted_residual, h)


# --- steps on the smallest meshes --------------------------------------------------------------------

LINEAR = nv.LinearElastic(K_e=3.0, G_e=1.3)
HARDENING = nv.IsotropicStrainEnergy(
    strain_energy=lambda E: 0.7 * Trace(E) * Trace(E) + square(dev(E)) + 2 * square(dev(E)) * square(E)
)
NEO_HOOKEAN = nv.NeoHookean(K_e=3.0, G_e=1.3, epsilon=0.4, elastic_state="F")
MATERIALS: dict[str, nv.Material] = {"linear": LINEAR, "hardening": HARDENING, "neo_hookean": NEO_HOOKEAN}


@dataclass(frozen=True, kw_only=True)
class Case:
    """A model and a discretisation on two triangles or six tetrahedra."""

    dim: int = 2
    material: str = "neo_hookean"
    k: int = 2
    m: int = 1
    p: float | None = 4.0
    mu_1: float = 0.0
    creep: bool = True

    def __str__(self) -> str:
        creep = "creep" if self.creep else "elastic"
        return f"{self.dim}d-{self.material}-k{self.k}-m{self.m}-p{self.p}-mu{self.mu_1}-{creep}"

    @property
    def model(self) -> nv.Model:
        g = (0.3 + x, -1.0 + sin(2 * nv.time)) if self.dim == 2 else (0.3 + x, y * nv.time, -1.0)
        return nv.Model(
            material=MATERIALS[self.material],
            viscosity=nv.StokesViscosity(K_v=0.3, G_v=0.2),
            hyperviscosity=nv.HyperViscosity(mu=0.05, p=self.p, mu_1=self.mu_1) if self.p else None,
            creep=nv.Creep(G_m=1.7) if self.creep else None,
            loads=(nv.Gravity(g), nv.BodyForce((y,) * self.dim)),
        )


@cache
def small_box(dim: int) -> Mesh:
    """Two triangles or six tetrahedra, with named walls."""
    if dim == 2:
        return box((1.0, 0.8), 2.0)
    return MakeStructured3DMesh(hexes=False, nx=1, ny=1, nz=1, mapping=lambda x, y, z: (x, 0.8 * y, 0.9 * z))


@cache
def step_of(case: Case) -> Step:
    """The step of a case. Tests share the step, so that each test must set all fields by ``randomise``."""
    step = Step(small_box(case.dim), case.model, nv.Discretisation(k=case.k, m=case.m))
    step.context.tau.Set(0.3)
    step.context.set_loads(0.2, 0.3)
    step.context.curvature.Set(0.2)
    return step


def randomise(step: Step, seed: int = 0, size: float = 0.15) -> None:
    """Random values of all unknowns, old and new; rho, J and |Hs|^2 positive."""
    rng = np.random.default_rng(seed)
    for target in (step.state_old, step.state):
        target.vec.FV().NumPy()[:] = smooth_state(step)
        target.vec.FV().NumPy()[:] += size * rng.uniform(-1, 1, step.layout.space.ndof)
    step.start_from_old()
    positive = {"rho": step.now.rho, "J": step.now.z_tensors.get("J")}
    if "hess_square" in step.layout.names:
        positive["|Hs|^2"] = step.now.hess_square
    for name, f in positive.items():
        if f is not None:
            Sampler(step.mesh, step.quadrature).require(f, f"random {name}", minimum=0.0)


@cache
def smooth_state(step: Step) -> np.ndarray:
    """Coefficients of a deformed body with variable density, at rest, with |Hs|^2 = 4."""
    shear = OuterProduct(CF((y, x, 0)), CF((1, 1, 0)))
    initial = nv.Initial(density=1.3 + 0.3 * x * y, F=Id(3) + 0.1 * shear)
    set_initial(step, initial, Sampler(step.mesh, step.quadrature))
    if "hess_square" in step.layout.names:
        parts_of(step)["hess_square"].Set(CF(4.0))
    return step.state.vec.FV().NumPy().copy()


def random_direction(step: Step, seed: int = 1) -> BaseVector:
    vector = step.state.vec.CreateVector()
    vector.FV().NumPy()[:] = np.random.default_rng(seed).uniform(-1, 1, step.layout.space.ndof)
    return vector


def parts_of(step: Step) -> dict[str, GridFunction]:
    return dict(zip(step.layout.names, step.state.components, strict=True))


def block(step: Step, array: np.ndarray, name: str) -> np.ndarray:
    """The coefficients of one unknown in an array of all coefficients."""
    return array[step.layout.ranges[name]]


# --- runs --------------------------------------------------------------------------------------------

EXAMPLES: dict[str, nv.Material] = {example.constructor: example.material for example in examples()}
"""An example of every material of the catalogue, by its constructor."""
OF_EACH_KIND = (
    "LinearElastic",
    "NeoHookean",
    'NeoHookean(elastic_state="B")',
    "OldroydB",
    "BarotropicFluid",
    'BarotropicFluid(form="A")',
)
"""Materials that cover every kind of variable."""


def by_ci(*values: Any, id: str | None = None) -> Any:
    """Test parameters that only CI tries."""
    return pytest.param(*values, marks=(pytest.mark.long, pytest.mark.ci), id=id)


def others_by_ci(cases: Iterable[Any], *by_default: Any) -> list[Any]:
    """All cases, each a name or a tuple; the default suite tries the given ones, and CI the others."""
    found = []
    for case in cases:
        made = pytest.param if case in by_default else by_ci
        found.append(made(*case) if isinstance(case, tuple) else made(case))
    assert sum(not each.marks for each in found) == len(by_default)
    return found


def each_once(*factors: Iterable[Any]) -> list[Any]:
    """All combinations of factors; the default suite tries each value of every factor, and CI the others."""
    lists = [list(factor) for factor in factors]
    turns = range(max(map(len, lists)))
    by_default = {tuple(turn % len(values) for values in lists) for turn in turns}
    cases = product(*(enumerate(values) for values in lists))
    return [
        (pytest.param if tuple(i for i, _ in case) in by_default else by_ci)(*(value for _, value in case))
        for case in cases
    ]


def one_of(number: int, cases: Iterable[Any]) -> list[Any]:
    """All cases, each a value. The default suite tries one out of ``number`` cases, and CI tries the
    others."""
    return [by_ci(case) if i % number else case for i, case in enumerate(cases)]


ALL_BY_CI = others_by_ci(EXAMPLES, *OF_EACH_KIND)
"""Names of all materials; the default suite runs one of each kind."""
SWIRL = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
A_BODY = """\
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.6
[material]
kind = "NeoHookean"
K_e = 10
G_e = 5
epsilon = 0.1
"""
"""The tables [domain] and [material] of a case file."""
A_FALL = '[[loads]]\nkind = "Gravity"\ng = [0, -1]\n'
A_SWIRL = '[initial]\nvelocity = ["sin(pi*x)*cos(pi*y)", "-cos(pi*x)*sin(pi*y)"]\n'
TWO_STEPS = "[time]\ndt = 0.02\nuntil = 0.04\n"
NO_VTK = "[output.vtk]\nenabled = false\n"
"""Further tables of a case file: gravity, a swirl, two steps, and no VTK files."""
OF_MODELS, OF_STARTS = ({field.name for field in fields(given)} for given in (nv.Model, nv.Initial))


def refuse_steps(patch: pytest.MonkeyPatch, refuses: Callable[[Interval], bool]) -> None:
    """Let no Rothe step be solved over an interval that ``refuses`` accepts."""
    solve = RotheSolver.solve

    def attempted(self: RotheSolver, interval: Interval) -> Any:
        if refuses(interval):
            raise nv.StepError("refused", [])
        return solve(self, interval)

    patch.setattr(RotheSolver, "solve", attempted)


def small_run(mesh: Mesh | float = 0.5, dt: float = 0.02, **options: Any) -> nv.Simulation:
    """A run in the unit square, with six triangles by default, or on another mesh.

    ``options`` are passed to ``Model``, with a neo-Hookean material by default, ``Initial`` and
    ``Simulation``.
    """
    mesh = mesh if isinstance(mesh, Mesh) else box((1, 1), mesh)
    model, start = (
        {name: options.pop(name) for name in of & options.keys()} for of in (OF_MODELS, OF_STARTS)
    )
    if "bodies" not in model:
        model.setdefault("material", nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1))
    if start:
        options["initial"] = nv.Initial(**start)
    if "time" not in options:
        options["dt"] = dt
    return nv.Simulation(mesh, nv.Model(**model), **options)


def swirling(mesh: Mesh | float = 0.5, dt: float = 0.02, **options: Any) -> nv.Simulation:
    """A small run that starts with a swirl of 1 m/s by default."""
    if options.get("initial") is None:
        dim = mesh.dim if isinstance(mesh, Mesh) else 2
        options = {"velocity": (*SWIRL, CF(0))[:dim]} | options
        options.pop("initial", None)
    return small_run(mesh, dt, **options)


def state(run: nv.Simulation) -> np.ndarray:
    """A copy of all coefficients."""
    found: np.ndarray = run.rothe_step.state.vec.FV().NumPy().copy()
    return found


def evolved(run: nv.Simulation) -> dict[str, np.ndarray]:
    """Coefficients of v, of rho (without bodies), and of z."""
    state, ranges = run.rothe_step.state.vec.FV().NumPy(), run.rothe_step.layout.ranges
    return {name: state[ranges[name]].copy() for name in ("v", "rho", "z") if name in ranges}


def assert_same(run: nv.Simulation, other: nv.Simulation, of: float = 1e-9) -> None:
    """Assert that coefficients of v, rho and z agree up to ``of`` times the largest coefficient of the same
    unknown."""
    first, second = evolved(run), evolved(other)
    for name, values in first.items():
        assert np.abs(values - second[name]).max() <= of * np.abs(values).max(), name


def assert_balanced(ledger: Ledger, bound: float = 1e-10, drift: float = 1e-12) -> None:
    """Assert that the ledger closes and mass is conserved."""
    assert np.abs(ledger.column("closure_relative")).max() <= bound
    assert np.abs(ledger.column("mass_drift")).max() <= drift


def assert_closed(run: nv.Simulation, until: float, bound: float = 1e-12) -> Ledger:
    """Run to a time, assert that the ledger closes and mass is conserved, and return the ledger."""
    ledger = run.run(until)
    assert_balanced(ledger, bound, min(bound, 1e-11))
    return ledger


def assert_goes_on(
    make: Callable[..., nv.Simulation], path: Path, until: float, *steps: int
) -> nv.Simulation:
    """Assert that a run resumed from checkpoints equals the uninterrupted run bit by bit.

    Return the uninterrupted run.

    ``make`` makes a run with observers; ``steps`` are the steps of the checkpoints, -1 for the last but
    one."""
    whole = make(observers=[nv.Checkpoints(path, every=1, keep=99)])
    whole.run(until)
    for step in steps:
        again = make(observers=[])
        again.restore(path, step=step if step > 0 else whole.number + step)
        again.run(until)
        assert state(whole).tobytes() == state(again).tobytes()
        for name in whole.ledger.columns:  # NaN marks numbers that are not defined
            np.testing.assert_array_equal(again.ledger.column(name), whole.ledger.column(name))
        for name, array in {} if whole.passive is None else whole.passive.arrays().items():
            assert np.array_equal(array, again.passive.arrays()[name])
    return whole


def by_both_solvers(
    make: Callable[[str], nv.Simulation], until: float, bound: float = 1e-12
) -> list[nv.Simulation]:
    """Assert that runs of ``make(solver)`` to a time agree, with closed ledgers and conserved mass; return
    the runs."""
    runs = []
    for solver in ("split", "coupled"):
        nv.time.Set(0.0)
        runs.append(make(solver))
        assert_closed(runs[-1], until, bound)
    assert_same(*runs)
    return runs


class Rejections(nv.Observer):
    """Records the reasons of rejected steps."""

    def __init__(self) -> None:
        self.seen: list[Rejection] = []

    def rejected(self, simulation: nv.Simulation, rejection: Rejection) -> None:
        self.seen.append(rejection)


def demo(name: str) -> Any:
    """Import the module of a demo's script."""
    script = Path(__file__).resolve().parents[1] / "demos" / name / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"demo_{name}", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def assert_sound(ledger: Ledger, material: nv.Material) -> None:
    """Assert the paper's claims for a run with gravity and creep."""
    assert_balanced(ledger)
    assert ledger.column("rho_min").min() > 0
    J = ledger.column("J_min")
    assert np.isnan(J).all() or J.min() > 0
    assert ledger.column("bregman").min() >= 0
    assert ledger.column("power_gravity").max() != 0
    assert (ledger.column("dissipation_creep").max() > 0) == any(v.creeps for v in material.variables)


ROTATION = (-y, x)
WALLS = {
    "no slip and slip": (
        lambda: annulus(1, 2, 1),
        {"inner": nv.NoSlip()},
        nv.Initial(density=1 + 0.1 * x, velocity=ROTATION),
        (nv.CentralGravity(strength=1.0),),
    ),
    "accelerated rotating wall": (
        lambda: disc(1, 0.7),
        {"wall": nv.PrescribedTangential((-y * (1 + 9 * nv.time**2), x * (1 + 9 * nv.time**2)))},
        nv.Initial(density=1 + 0.3 * x),
        (),
    ),
    "accelerated lid": (
        lambda: box((1, 1), 0.5),
        {"top": nv.PrescribedTangential((10 * nv.time, 0.0)), ("left", "right"): nv.NoSlip()},
        nv.Initial(density=1 + 0.3 * y),
        (nv.Gravity((0.0, -1.0 - nv.time)),),
    ),
    "two lids, periodic": (
        lambda: channel(1, 1, 0.5),
        {"top": nv.PrescribedTangential((1, 0)), "bottom": nv.PrescribedTangential((-1, 0))},
        nv.Initial(),
        (nv.BodyForce((sin(2 * pi * x) * cos(9 * nv.time), 0)),),
    ),
    "traction with friction": (
        lambda: disc(1, 0.7),
        {"wall": nv.Traction(f=(-y * cos(9 * nv.time), x), friction=0.1)},
        nv.Initial(),
        (),
    ),
    "friction": (
        lambda: box((1, 1), 0.5),
        {"bottom": nv.NavierFriction(2.0), "top": nv.Traction(f=(sin(9 * nv.time), 5.0))},
        nv.Initial(velocity=(sin(pi * x), 0)),
        (),
    ),
}
"""Mesh, walls, initial state and loads of each kind of wall. Data depend on time wherever the wall admits
this."""


def required(section: tuple[str, ...], kind: str | None = None) -> dict[str, Any]:
    """Examples of the keys that a section of this kind requires, by the reference of case files."""
    own = (e for e in reference.entries() if e.path[:-1] == section and kind in (e.kinds or (kind,)))
    needed = {e.path[-1]: e.example for e in own if e.required and e.example is not None}
    return {key: value for key, value in needed.items() if key not in reference.TAGS}


def faults(table: str, texts: Mapping[str, str]) -> list[Any]:
    """Case files and the messages about them, from lines NAME | OLD -> NEW | MESSAGE.

    NAME names a text, in which OLD is replaced by NEW; + LINES appends lines. "; " separates lines. The name
    of a text stands for the text. A line that begins with two spaces continues the line before.
    """
    found = []
    for line in re.sub(r"^#.*\n", "", table, flags=re.M).replace("\n  ", " ").splitlines():
        name, change, message = line.split(" | ")
        line = re.sub(r"[A-Z_]{3,}", lambda known: texts.get(known[0], known[0]), change.replace("; ", "\n"))
        old, _, new = line.partition(" -> ")
        text = texts[name] + old[2:] if old.startswith("+ ") else texts[name].replace(old, new, 1)
        assert text != texts[name], line
        found.append(pytest.param(text, message, id=message))
    return found
