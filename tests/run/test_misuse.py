"""Wrong scripts get an error that names the fault, not an error of Python or a wrong result."""

import math
import re
from functools import cache, partial
from types import SimpleNamespace  # noqa: F401

import numpy as np  # noqa: F401
import pytest
from ngsolve import CF, sqrt, x, y  # noqa: F401  of the table, as further names below
from support import LINEAR, small_run, swirling  # noqa: F401

import ngvisco as nv
from ngvisco import geometries
from ngvisco.geometries import box
from ngvisco.physics import variables
from ngvisco.physics.tensors import square, tr  # noqa: F401
from ngvisco.run.frames import read_pvd
from ngvisco.run.pictures import CrossSection, plot_fields, write_movie
from ngvisco.run.plots import plot_history  # noqa: F401
from ngvisco.shapes.fractions import volumes  # noqa: F401
from ngvisco.shapes.shape import Where  # noqa: F401

DT = 0.02
PLANE, FILE, inf, nan = box((1, 1), 1.0), __file__, math.inf, math.nan
NEO = partial(nv.NeoHookean, K_e=1.0, G_e=1.0, epsilon=0.1)
ELASTIC = nv.ReferentialNeoHookean(K_e=2.0, G_e=1.0)
BREAKING = partial(nv.Damaged, G_c=0.1, length=0.6, viscosity=0.01)
BROKEN, WARM = BREAKING(material=ELASTIC), nv.Thermal(material=LINEAR, c=1.0, theta_R=1.0)
THETA = nv.Parameter("theta", start=x)
VARIED = nv.CustomMaterial(
    transported=(variables.Distortion(), variables.Jacobian(), THETA),
    stored_energy=lambda F, J, theta: (1 + theta) * square(F) + 5 * (J - 1) * (J - 1),
)
FLAT = nv.CustomMaterial(transported=(variables.Jacobian(),), stored_energy=lambda J: (J - 1) ** 4)
ADAPTIVE = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.02)
STEPS, MODEL = nv.TimeSteps(dt=0.1), nv.Model(material=LINEAR)
NOT_POSITIVE = CF((1, 2, 0, 2, 1, 0, 0, 0, 1), dims=(3, 3))


def top(wall):
    return small_run(walls={"top": wall})


def right(wall, **options):
    return small_run(1.0, walls={"right": wall}, **{"material": ELASTIC} | options)


def observed(observer):
    return small_run(observers=[observer]).run(DT)


def refined(**options):
    return nv.run_refined(small_run(), nv.Refinement(**{"field": "J", "every": 0.04} | options), 0.08)


NONSENSE = r"""
# fields of functions and of grids
function_field(PLANE, 3) | a function of the arrays
function_field(PLANE, lambda x, y: "a") | finite numbers
function_field(PLANE, lambda x, y: x[:3]) | shape \(3,\)
function_field(PLANE, lambda x, y: np.log(x - 2 * y + 0j).real / 0 * x) | finite
function_field(PLANE, lambda x, y: x, order=9) | 0 to 6
grid_field(PLANE, ([0, 1],), [1, 2]) | 2 axes
grid_field(PLANE, 3, [1, 2]) | grid_field\.axes = 3: expected 2 axes
grid_field(PLANE, ([0, 1], [0, "a"]), [[1, 2], [3, 4]]) | grid_field\.axes = .*finite numbers
grid_field(PLANE, ([0, 1], [0, 1]), [["a", 2], [3, 4]]) | grid_field\.values = .*an array of numbers
read_prony(1) | read_prony\.path = 1: expected a path
grid_field(PLANE, ([0, 1], [0, 1]), [[1, 2]]) | increasing axes
grid_field(PLANE, ([0, 1], [0, 0.5]), [[1, 2], [3, 4]]) | axes, y.*\[0.0, 0.5\].*\[0.0
# tables and signals
table([0, 1, 1], [1, 2, 3]) | times that increase
table([0, 1], [1, 2, 3]) | one value or one row
table([0], [1]) | two rows
table([0, 1], [1, nan]) | finite
table(["a", 1], [1, 2]) | times
table("missing.csv", ()) | can be read
step("a") | expected
pulse(0, -1) | expected
pulse(inf, 1) | expected
# what is carried over, and refined
transfer(swirling(), swirling(box((2, 0.5), 0.4))) | is not in the old mesh
transfer(swirling(), swirling(box((1, 0.5), 0.4))) | volume
transfer(swirling(), swirling(passive=["F_tot"])) | F_tot.*the source carries too
transfer(MODEL, swirling()) | transfer\.source = .*expected a ngvisco\.Simulation
transfer(swirling(), MODEL) | transfer\.target = .*expected a ngvisco\.Simulation
transfer(swirling(), small_run(material=LINEAR)) | the variables E.*the variables of the source, F, J
refined(field="vorticity") | vorticity
refined(above=1.5) | Refinement.above
refined(levels=0) | Refinement.levels
refined(every=0.03) | Refinement.every
# observers
observed(Probes({"a": (2, 2)})) | points\['a'\].*which lies in \[0, 1\] x
observed(Probes([(1, 1, 1)])) | points of 2 finite coordinates
observed(Probes([(nan, 1)])) | finite
observed(Probes([("a", "b")])) | finite coordinates
observed(Probes(3)) | points, or a mapping
observed(Probes([])) | at least one
observed(Probes([(0, 0)], ["velocty"])) | did you mean 'velocity'
observed(Probes([(0, 0)], every=0)) | Probes.every
observed(LineSamples((0, 0), (0, 0))) | a point that differs from start
observed(LineSamples((0, 0), (0, 3))) | LineSamples.end
observed(LineSamples((0, 0), (1, 0), 1)) | a whole number from 2 to 100000
observed(WallForces(["lef"])) | did you mean 'left'
observed(WallForces("left")) | a sequence of names
observed(WallForces(about=(1,))) | WallForces.about
observed(Integrals({})) | with at least one name
observed(Integrals({"a": CF((1, 2))})) | scalar
observed(Integrals({"a": "densty"})) | did you mean 'density'
observed(Integrals({"time": "density"})) | expected another name than 'time'
observed(Bodies()) | bodies
small_run(observers=[LedgerCSV("a.csv"), Probes([(0, 0)], path="a.csv")])
  | Simulation\.observers = 'a\.csv': expected each observer once, and a file
small_run(observers=[LedgerCSV("a.csv"), Probes([(0, 0)], path=Path("a.csv").resolve())])
  | Simulation\.observers = .*expected each observer once
small_run(observers=[VTKSeries("v"), VTKSeries("v")]) | Simulation\.observers = 'v': expected each observer
small_run(observers=2 * [Probes([(0, 0)])]) | Simulation\.observers = .*expected each observer once
Bodies(measures=3) | Bodies\.measures = 3: expected a sequence of names
Bodies(measures=["gap", "gap"]) | Bodies\.measures = .*no name twice
Contours("c", bodies=np.array("a")) | Contours\.bodies = array.*expected
Checkpoints("a.h5", attributes=3) | Checkpoints\.attributes = 3: expected a mapping of names to names
Progress(1.0, stream="log.txt") | Progress\.stream = 'log\.txt': expected an open text file, or None
small_run().fields["velocty"] | unknown field 'velocty'; did you mean 'velocity'
small_run().advance("a") | advance\.stop = 'a': expected a number > 0
small_run().advance(0.0) | advance\.stop = 0\.0: expected a number > 0
VTKSeries("vtk", fields=[]) | at least one name, and no name twice
Probes({"p": (0.5, 0.5)}, fields=[]) | at least one name, and no name twice
LineSamples((0, 0), (1, 1), fields=[]) | at least one name, and no name twice
WallForces([]) | at least one name, and no name twice
WallForces(["top", "top"]) | at least one name, and no name twice
Checkpoints(".") | Checkpoints\.path = .*expected the path of a file, but this path is a directory
LedgerCSV(".") | LedgerCSV\.path = .*expected the path of a file, but this path is a directory
Probes({"p": (0.5, 0.5)}, path=".") | \.path = .*expected the path of a file, but this path is a directory
VTKSeries(FILE) | VTKSeries\.directory = .*expected a directory, but this path is a file
record("out", small_run(), DT) | record\.simulation = 'out': expected a ngvisco\.Simulation
record(small_run(), 5, DT) | record.directory
gradient(MODEL, of=["kinetic at 0.1"], by=["material.G_e"], until=0.1) | gradient\.simulation = .*a ngvisco
fit(MODEL, by=["material.G_e"], data={}) | fit\.simulation = .*expected a ngvisco\.Simulation
Misfit({"kinetic at 0.1": 1.0}, sigma="1") | Misfit\.sigma = '1': expected one number > 0
Misfit({"kinetic at 0.1": 1.0}, sigma=[1, 2]) | Misfit\.sigma = .*as many as there are data
plot_energies(small_run(), "a.png") | plot_energies\.ledger = .*expected a ngvisco\.Ledger
record(small_run(), "out", 0.0) | record.until
record(small_run(), "out", nan) | record.until
record(small_run(), "out", DT, show={"none in 2D": "velocity_3"}) | velocity_3
plot_energies(small_run().ledger, "a.png") | ledger = .*: expected a ledger with at least one step
plot_history(small_run().ledger, "a.png") | ledger = .*: expected a ledger with at least one step
plot_fields(PLANE, [("x", x)], "a.png", CrossSection("x")) | section = 'x': expected no section
plot_fields(PLANE, [("T", NOT_POSITIVE)], "a.png") | 'T'.*a scalar
small_run(loads=[Gravity(time)]) | ^loads\['gravity'\]\.g = <Parameter>: expected .* 2 components, not 1
small_run(passive=("F_total",)) | F_tot
small_run(terms=3) | Simulation\.terms
small_run(terms=np.array(3)) | Simulation\.terms
small_run(terms=[3]) | Simulation\.terms
small_run(terms=[SimpleNamespace(form=print, entries=print, unknowns=print)])
  | derives from nv\.PointTerm, since the term has unknowns
# materials and parameters
NEO(elastic_state="C") | NeoHookean.elastic_state = 'C': expected one of F, B
CustomMaterial(transported=(LeftCauchyGreen(), Jacobian()), stored_energy=lambda B, J: B[0, 0] + tr(B) + J)
  | rotation \[\[.*\]\] of B =
CustomMaterial(transported=(LeftCauchyGreen(), Distortion()), stored_energy=lambda B, F: tr(B) + square(F))
  | tensors of one configuration
CustomMaterial(transported=(Distortion(), THETA), stored_energy=lambda F, theta: square(F) + theta * F[0, 0])
  | the same for all observers
Model(material=NEO(), creep=Creep(G_m=1.0, law="conformation")) | a rule that reads no conformation tensor
Creep(G_m=1.0, nu=0.1, law="leonov") | Creep\.nu
FENEP(K_e=1.0, G_e=1.0, b=3) | FENEP\.b = 3: expected a finite number > 3
small_run(material=NEO(elastic_state="B"), values={"B": NOT_POSITIVE}) | projected B_11 B_22 - B_12\^2_0
PerReferentialVolume(material=LINEAR) | 'E' is none of these
PerReferentialVolume(material=BarotropicFluid(B=1.0, gamma=2, form="A")) | 'A' is none of these
PerReferentialVolume(material=Yosida(material=NEO(), eps=1.0)) | around this material
Parameter("theta", typical="a") | Parameter\.typical = 'a': expected a finite number
Parameter("theta", start=x * time) | Parameter.start = .*reads the time
NEO(G_e=1 + time) | NeoHookean.G_e = .*without the time
StokesViscosity(K_v=1.0, G_v=x + time) | StokesViscosity.G_v = .*without the time
2**THETA | exponent = .*expected a finite number
WithQuadratic(material=VARIED, delta=1.0, only=("theta",)) | unknown material variable
small_run(material=NEO(G_e=Parameter("stiff"))) | parameter stiff: no start value is given
small_run(material=NEO(G_e=Parameter("stiff")), values={"stiff": 2 * x - 1})
  | NeoHookean.G_e: the minimum is -1.*expected values > 0
small_run(viscosity=StokesViscosity(K_v=0.1, G_v=x - 0.5)) | StokesViscosity.G_v: the minimum is -0.5
small_run(material=NEO(G_e=Parameter("density", start=2.0))) | Variable.name = 'density': expected another
small_run(material=NEO(G_e=Parameter("pressure", start=2.0))) | Variable.name = 'pressure': expected another
small_run(material=NEO(G_e=Parameter("viscous_stress", start=2.0))) | 'viscous_stress': expected another name
# damage, heat, diffusion
BREAKING(material=NEO()) | without stress at rest
BREAKING(material=Yosida(material=ELASTIC, eps=0.01)) | not that of a Yosida approximation
BREAKING(material=BROKEN) | a material without damage
BREAKING(material=ReferentialNeoHookean(K_e=9.0, G_e=Parameter("damage") + 1)) | do not read the
Model(bodies=[Body(name="a", material=BREAKING(material=ELASTIC, area="reference"), density=1.0)])
  | bodies\['a'\]\.material\.area.*'actual'
Model(material=WithQuadratic(material=BROKEN, delta=0.1)) | Model\.material.*cannot wrap a damaged material
small_run(material=BROKEN, discretisation=Discretisation(m=2)) | Discretisation\.m = 2: expected 1 with damage
small_run(disc(1.0, maxh=0.9), material=BROKEN) | Simulation\.mesh.*straight triangles
small_run(material=BROKEN, values={"grad_damage": CF(0)}) | grad_damage
small_run(material=BROKEN, values={"damage": CF(1.5)}) | parameter damage: the values are from 1\.5 to 1\.5
Model(material=LINEAR, heat=Heat()) | Model\.heat
small_run(walls={"left": Slip(heat=WallHeat(flux=1.0))}) | walls\['left'\]\.heat
small_run(walls={"left": Slip(heat=3.0)}, material=WARM) | Slip\.heat = 3\.0: expected a WallHeat
small_run(temperature=-0.5 + x, material=WARM) | temperature theta_0
small_run(temperature=1.0) | Initial\.temperature
small_run(material=WARM, heat=Heat(numerical_heating=True), scheme="midpoint")
  | numerical_heating.*backward Euler
small_run(regularisation=Regularisation(delta_density=1), discretisation=Discretisation(k=1, m=0))
  | delta_density
small_run(regularisation=Regularisation(delta_fields=0.3), material=FLAT) | WithQuadratic
small_run(discretisation=Discretisation(m=0)) | Discretisation\.m = 0: expected 1, or .*k=1, m=0
# steps
Simulation(PLANE, MODEL) | TimeSteps\.dt = None
Simulation(PLANE, MODEL, time=0.1) | Simulation\.time = 0\.1: expected a ngvisco.TimeSteps
Simulation(PLANE, MODEL, time=STEPS, dt=0.1) | Simulation\.time = .*None, since parameters
Simulation(PLANE, MODEL, time=STEPS, scheme="midpoint") | Simulation\.time = .*None, since parameters
Simulation(PLANE, MODEL, time=STEPS, halvings=1) | Simulation\.time = .*None, since parameters
small_run(adaptive=AdaptiveSteps(dt_min=0.03, dt_max=0.1)) | TimeSteps\.dt = 0\.02
small_run(scheme="sdirk2", relaxation=True, adaptive=ADAPTIVE) | scheme .midpoint.
small_run(scheme="theta", theta=0.5001, adaptive=AdaptiveSteps(dt_min=1e-4, dt_max=0.02, tolerance=1e-3))
  | AdaptiveSteps\.tolerance.*error constant
small_run(scheme="midpont") | scheme = 'midpont': expected one of backward-euler, midpoint
small_run(scheme=TimeScheme("mine", ((0.5,),), (1.0,)), theta=0.5) | only the scheme 'theta'
TimeScheme("mine", ((0.0,),), (1.0,)) | TimeScheme\.A
TimeScheme("mine", ((1.0,),), (0.9,)) | TimeScheme\.b
TimeScheme("mine", ((0.5, 0.5), (0.0, 0.5)), (0.5, 0.5)) | TimeScheme\.A
TimeScheme("mine", ((1.0,),), (0.5, 0.5)) | TimeScheme\.A
TimeScheme("mine", (), ()) | TimeScheme\.A
TimeScheme("mine", ((nan,),), (1.0,)) | TimeScheme\.A
TimeScheme(3, ((0.5,),), (1.0,)) | TimeScheme\.name
TimeScheme("mine", 3, (1.0,)) | TimeScheme\.A
TimeScheme("mine", (0.5,), (1.0,)) | TimeScheme\.A
TimeScheme("mine", ((0.5,),), 2) | TimeScheme\.b
TimeScheme("mine", ((0.5,),), ("a",)) | TimeScheme\.b
# walls
small_run(walls={"topp": NoSlip()}) | did you mean 'top'
small_run(walls=[("top", NoSlip()), ("top", Slip())]) | not two
small_run(walls={"top": NoSlip(), ("top", "left"): Slip()}) | not two
top((NoSlip(), Slip())) | one Wall
small_run(channel(1, 1, 0.5), walls={"left": NoSlip()}) | periodic
top(PrescribedTangential((1, 0, 0))) | with 2 components
top(NavierFriction(0.5 - x)) | \['top'\]\.coefficient = .*a function >= 0; at t = 0 s the value is -0\.\d+
top(NavierFriction(1 / (x - x))) | walls\['top'\]\.coefficient = .*finite values
top(Traction(f=(sqrt(x - 0.5), 0))) | walls\['top'\]\.f = .*finite values; at t = 0 s
top(PrescribedTangential((sqrt(x - 0.5), 0))) | walls\['top'\]\.velocity = .*finite values
top(PrescribedTangential((0, 1))) | walls\['top'\]\.velocity = .*normal part \(1 of 1
top(PrescribedTangential((1.0, 0.1))).run(0.1) | nothing crosses this wall; for an inlet take nv\.Inflow
top(PrescribedTangential((0.0, y))).run(0.1) | nothing crosses this wall; for an inlet take nv\.Inflow
top(PrescribedTangential((x, y))).run(0.1) | nothing crosses this wall; for an inlet take nv\.Inflow
right(Open(density=1 - 2 * y)) | walls\['right'\]\.density = .*density = -\d.* expected density > 0
right(Open(density=1, values={"J": -1.0})) | walls\['right'\]\.values\['J'\] = .* expected J > 0
right(Inflow(velocity=(-1, 0), density=1, values={"H": 1.0})) | \['right'\]\.values\['H'\] = 1.0: .* a 3x3
right(Open(density=1, pressure=sqrt(-1 - x))) | walls\['right'\]\.pressure = .*finite
right(Open(density=1), regularisation=Regularisation(rho_max=2.0))
  | a wall that nothing crosses, since .*rho_max
right(Open(density=1), regularisation=Regularisation(delta_density=1.0))
  | that nothing crosses, since .*delta_density
right(Open(density=1, amounts={"a": 1})) | walls\['right'\]\.amounts = .*without bodies
right(Open(density=1.0, temperature=-3.0), material=WARM) | Open\.temperature = -3\.0: expected .* > 0
Open(amounts=1.0) | Open\.amounts = 1\.0: expected a mapping of names
# meshes and shapes
box((1, 1), 1e-9) | box\.maxh = .*at least \S+ m, since the given size makes about \S+ cells
box((1, 1, 1), 1e-20) | box\.maxh = .*at least \S+ m, since the given size makes about \S+ cells
box((1e7, 1e7, 1e7), 1.0) | box\.maxh = .*at least \S+ m, since the given size makes about \S+ cells
disc(1, 0.5, refine={"wall": 1e-9}) | disc\.refine\['wall'\] = .*at least \S+ m, since the given size
sphere(1, 0.5, refine={"wall": 1e-4}) | sphere\.refine\['wall'\] = .*at least \S+ m, since the given size
box((1, 2e-5), 0.5) | fills 0\.\d+ of the shape
annulus(1, 2, 0.5, refine={"iner": 0.1}) | inner
refine_walls(disc(1, 0.5), ["rim"]) | wall
structured_box((1, 1), (4,)) | cells
structured_box((1, 1), (4, 0)) | cells
structured_box((1, 1), (4, 2), periodic="z") | periodic
structured_box((1, 1), (4, 2), grading={"z": 2.0}) | grading
structured_box((1, 1), (4, 2), grading={"x": 0.0}) | grading
structured_box((1, 1), (4, 2), grading={"x": 1e300}) | grading.*between 1e-06 and 1e.06
structured_box((1, 1), (800, 800)) | cells.*at most 1000000 triangles, not 1280000
structured_box((1, 1, 1), (100, 100, 17)) | at most 1000000 tetrahedra, not 1020000
volumes(PLANE, [Ball((0, 0, 0), 1.0)]) | since the mesh has 2 dimensions
volumes(PLANE, [Block((0, 0, 0), (1, 1, 1))]) | since the mesh has 2 dimensions
volumes(PLANE, [HalfSpace((0, 0, 0), (0, 0, 1))]) | since the mesh has 2 dimensions
volumes(box((1, 1, 1), 1), [Polygon(((0, 0), (1, 0), (0, 1)))]) | needs a mesh of two dimensions
volumes(PLANE, [Where(1 / (x - x))]) | finite
"""
"""Lines MISUSE | MESSAGE; a line that begins with two spaces continues the message."""


@cache
def names():
    known = {name: getattr(nv, name) for name in dir(nv)}
    return known | vars(variables) | vars(geometries) | globals()


def rows():
    text = re.sub(r"^#.*\n", "", NONSENSE.strip(), flags=re.M).replace("\n  ", " ")
    return [pytest.param(*line.split(" | "), id=line.split(" | ")[0]) for line in text.splitlines()]


@pytest.mark.filterwarnings("ignore:.*encountered")
@pytest.mark.parametrize(("what", "said"), rows())
def test_invalid_calls_are_refused_and_nothing_is_written(what, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(nv.NgviscoError, match=said):
        eval(what, names())
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def mesh():
    return box((1, 1), maxh=0.7)


def simulation(mesh, *observers):
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        loads=[nv.Gravity((0.0, -1.0))],
    )
    return nv.Simulation(mesh, model, dt=DT, observers=observers)


class Meddler(nv.Observer):
    def step(self, simulation, row):
        simulation.t = 0.5


def test_an_observer_cannot_set_the_time(mesh):
    run = simulation(mesh, Meddler())
    with pytest.raises(nv.ParameterError, match=r"Simulation\.t = 0\.5: expected no change of a run"):
        run.run(2 * DT)
    assert run.t == DT


def test_a_mesh_refined_during_a_run_ends_the_run():
    mesh = box((1, 1), maxh=0.7)
    run = simulation(mesh)
    run.run(DT)
    cells = mesh.ne
    mesh.Refine()
    with pytest.raises(
        nv.MeshError, match=f"has {mesh.ne} cells, but had {cells} when the run was made.*nv.transfer"
    ):
        run.run(2 * DT)


def test_a_section_of_a_plane_mesh_is_refused(mesh, tmp_path):
    run = simulation(mesh, nv.VTKSeries(tmp_path / "vtk"))
    run.run(DT)
    with pytest.raises(nv.ParameterError, match="section = 'x': expected no section"):
        plot_fields(mesh, [("density", run.fields["density"])], tmp_path / "a.png", CrossSection("x"))
    with pytest.raises(nv.ParameterError, match="section = 'x': expected no section"):
        write_movie(tmp_path / "vtk", tmp_path / "a.gif", section=CrossSection("x"))


@pytest.mark.parametrize("content", [b"\xff\xfe\x00\x81", b"nothing", b'timestep="soon" file="a.vtu"'])
def test_a_damaged_series_is_refused_by_its_name(content, tmp_path):
    (tmp_path / "fields.pvd").write_bytes(content)
    with pytest.raises(nv.CheckpointError, match=r"fields\.pvd: this is not a "):
        read_pvd(tmp_path / "fields.pvd")


def test_a_resumed_run_drops_states_that_an_interrupted_run_wrote(mesh, tmp_path):
    """A resumed run drops from its series the last state that the interrupted run wrote."""

    def files():
        return {path.name for path in tmp_path.glob("vtk/*.vtu")}

    observers = [nv.VTKSeries(tmp_path / "vtk", every=2), nv.Checkpoints(tmp_path / "run.h5", every=1)]
    simulation(mesh, *observers).run(DT)
    assert files() == {"fields_000000.vtu", "fields_000001.vtu"}
    (tmp_path / "vtk" / "fields_000007.vtu").write_text("of a process that was killed before it listed it")
    (tmp_path / "vtk" / "fields_of_mine.vtu").write_text("mine")
    again = simulation(mesh, *observers)
    again.restore(tmp_path / "run.h5")
    again.run(2 * DT)
    assert files() == {"fields_000000.vtu", "fields_000002.vtu", "fields_of_mine.vtu"}
    assert [name for _, name in read_pvd(tmp_path / "vtk/fields.pvd")] == [
        "fields_000000.vtu",
        "fields_000002.vtu",
    ]
