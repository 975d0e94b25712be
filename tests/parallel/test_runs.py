"""Runs on several ranks equal the run on one process: ledgers, checkpoints, files, refusals and failures."""

import csv
import json
import math
import re
from functools import cache
from pathlib import Path

import h5py
import own
import pytest
from launch import needs_petsc, printed, run
from support import A_BODY, A_SWIRL, by_ci

from ngvisco.run.frames import read_frame

HERE = Path(__file__).parent
pytestmark = needs_petsc

MATERIAL = A_BODY[A_BODY.index("[material]") :]
CASE = f"""\
{A_BODY.replace("0.6", "0.5")}{A_SWIRL}[time]
dt = 0.02
until = 0.06
[solver]
method = "coupled"
[output.checkpoint]
every = 1
[[output.probes]]
name = "centre"
point = [0.5, 0.5]
fields = ["velocity", "F"]
[output.forces]
[output]
passive = ["reference_map"]
"""


REGULARISED = CASE.replace(
    "[initial]",
    "[rheology]\nregularisation = { delta_density = 1e-3, delta_fields = 1e-2, rho_max = 1.0 }\n[initial]",
)
YIELD = """\
[rheology.creep]
kind = "Perzyna"
sigma_Y = 0.05
G_m = 0.1
[initial]"""
CASES = {
    "split": CASE.replace("coupled", "split"),
    "coupled": CASE,
    "regularised": REGULARISED.replace("coupled", "split"),
    "periodic": CASE.replace("maxh = 0.5", "maxh = 0.35\nperiodic = 'x'")
    .replace("coupled", "split")
    .replace('"sin(pi*x)*cos(pi*y)", "-cos(pi*x)*sin(pi*y)"', '"3 + cos(pi*y)", "sin(2*pi*x)*sin(pi*y)"'),
}
ADAPT = """\
[domain.adapt]
field = "pressure"
above = 0.6
every = 0.02
[walls.top]
kind = "Open"
density = 1.0
pressure = -15.0
stiffness = [9.0, 4.0]
"""
CASES["yield"] = CASE.replace("[initial]", YIELD).replace('"F"', '"B"')
CASES["adapted"] = (
    CASES["periodic"].replace(MATERIAL, ADAPT + MATERIAL).replace('"3 + cos(pi*y)"', '"1 - y*y"')
)
"""A run with other cells in every step. Both of its identified walls are divided in the same way, and one
wall is on springs."""


@cache
def found(ranks, *names):
    return printed(HERE / "runs.py", *names, ranks=ranks)


GROUPS = {
    "of default": "split creep; delta, 2D, split",
    # with the cases above, every mechanism runs once by one of the solvers; cases in three dimensions, with
    # oblique walls and with curved walls are among them
    "of CI": "carried; observed; sdirk2; adaptive; own term; channel; quadrilateral; slip disc; split; "
    "split crystal; split bodies; split apart; split parameters; split heated; split Yosida; "
    "split, two levels; split, Newton-Krylov; split, all regularisations; split own tableau; "
    "split relaxation; split block; split turned; split slip disc, two levels; split window; split network; "
    "split revolved; split solute; split broken",
    "apart": "apart; split apart; split apart in space; split outlined",
    "damage": "broken; split broken; split cracked",
    "networks and a solute": "network; split network; solute; split solute",
    "coupled": "carried; carried in space; Yosida; observed; parameters; heated; bodies; observed block; "
    "swirl; midpoint; sdirk2; adaptive; block; disc; lid; window; creep; limited",
    "split": "split Yosida; split bodies; split parameters; split heated; split; split, two levels; "
    "split, Newton-Krylov; split, long steps; split block; split block, two levels; split disc; split lid; "
    "split window; split creep; delta, 2D, split; delta, 3D, split; cut-off, 2D, split; cut-off, 3D, split; "
    "split, all regularisations; split crowded",
    "periodic": "channel; split channel; split channel, two levels; split crystal; split crystal, delta",
    "about an axis": "revolved; split revolved",
    "walls": "slip disc; quadrilateral, k = 3; turned; quadrilateral; ball; turned ball; leaning",
    "split, walls": "split turned; split slip disc; split slip disc, two levels; split quadrilateral; "
    "split quadrilateral, k = 3; split ball; split turned ball; split leaning",
    "of many ranks": "lid; swirl; midpoint; split; split, two levels; split, long steps; split lid; "
    "slip disc; split slip disc; split block, two levels; bodies; split bodies; "
    "delta, 2D, split; delta, 3D, split; cut-off, 2D, split; cut-off, 3D, split",
    "own": "; ".join(own.COUPLED),
    "split, own": "; ".join(own.SPLIT),
}
ACTS = {
    **dict.fromkeys(("limited", "split crowded", "parameters", "split parameters"), "limited_cells"),
    **dict.fromkeys(("broken", "split broken"), "dissipation_damage"),
    "split cracked": "entropy_production_damage",
    **dict.fromkeys(("heated", "split heated"), "entropy_production_conduction"),
    **dict.fromkeys(("own term", "split own term"), "dissipation_drag"),
    **dict.fromkeys(("solute", "split solute"), "dissipation_diffusion_c"),
    **dict.fromkeys(("network", "split network"), "dissipation_creep_hard"),
    **dict.fromkeys(("apart", "split apart", "split apart in space", "split outlined"), "dissipation_creep"),
    "cut-off, 3D, split": "cutoff_volume",
}
"""For each case, the column whose last row shows that its mechanism acts."""


def assert_same_ledger(one, several, spare=0):
    """Assert that energies, dissipations and minima agree to 1e-10 of their size, and that numbers of
    iterations differ by at most ``spare``."""
    energy = one[0]["kinetic"] + one[0]["stored"]
    for row, other in zip(one, several, strict=True):
        assert abs(row["newton_iterations"] - other["newton_iterations"]) <= spare
        row, other = ({**each, "newton_iterations": 0} for each in (row, other))
        for name, value in row.items():
            size = energy if name.startswith("closure") else max(abs(value), 1e-3)
            # defects are differences of determinants near 1
            size = 1.0 if name.startswith("defect_") else size
            # errors of these columns are relative to the momentum
            if "momentum" in name or name.startswith("impulse_"):
                size = max(size, row["momentum_size"])
            if name == "limiter":  # this column is a difference of stored energies
                size = max(size, energy)
            if name == "dissipation_creep":  # directions of the slopes of fractions have few digits
                size = max(size, row["stored"])
            # this column is a square of jumps, whose errors are those of the fields
            if name == "dissipation_upwinding":
                size = max(size, math.sqrt(abs(value)))
            same = math.isnan(value) and math.isnan(other[name])
            assert same or abs(other[name] - value) <= 1e-10 * size, name


def assert_same_tables(one, several, of=1e-10):
    """Assert that columns agree to 1e-10 of the largest number in their table."""
    for table, other in zip(one, several, strict=True):
        assert list(table) == list(other)
        size = max(abs(v) for name, column in table.items() for v in column if name not in ("step", "time"))
        for name, column in table.items():
            for value, found_value in zip(column, other[name], strict=True):
                assert abs(found_value - value) <= of * size, name


@pytest.mark.parametrize(
    ("group", "ranks"),
    [
        ("of default", 3),
        pytest.param("of CI", 3, marks=[pytest.mark.long, pytest.mark.ci]),
        pytest.param("of many ranks", 9, marks=pytest.mark.long),
        *(
            pytest.param(group, ranks, marks=pytest.mark.long)
            for group in GROUPS
            for ranks in (2, 3, 4)
            if not group.startswith("of ")
        ),
    ],
)
def test_ledgers_and_tables_over_ranks_equal_those_of_one_process(group, ranks):
    """The split solver's linear systems take at most 1.1 times as many iterations in all."""
    names = GROUPS[group].split("; ")
    for name in names:
        one, several = found(1, *names)[name], found(ranks, *names)[name]
        assert (one["cells"], one["unknowns"]) == (several["cells"], several["unknowns"])
        # errors of linear systems change the contraction, and with it the number of iterations. For example,
        # with bodies and a tolerance of 1e-12, an increment of 8e-13 ends the iteration on three ranks. In
        # one process an increment of 1e-12 takes two more iterations
        spare = 2 if name == "split bodies" else 1 if "split" in name else 0
        assert_same_ledger(one["rows"], several["rows"], spare)
        assert_same_tables(one["tables"], several["tables"])
        if name not in own.CASES:  # in these cases a single further iteration would be more than a tenth
            assert several["linear"] <= 1.1 * one["linear"], name
        assert name not in ACTS or several["rows"][-1][ACTS[name]] > 0, name


AT_REST = {
    "at rest": (2.0, 0.04),
    "at rest below a wall": (0.3 + 2 - 5 / 6, 0.04),
    "at rest about a point": (2 - 0.4 * 1.4, 0.04),
    "bodies at rest": (2.0, 0.2),
    "at rest, periodic": (2.0, 0.04),
    "at rest in space": (2.0, 0.15),
}
"""For each start: the pressure at the base, Pa, and its largest admissible error. The matter above the base
has the density 3 - 2 y over 1 m, or 3 kg/m^3 over 0.5 m and 1 kg/m^3 over the next 0.5 m. The error is caused
by linear volumes on cells of 0.3 m, or of 0.6 m in space."""


@pytest.mark.parametrize(
    ("names", "ranks"),
    [
        pytest.param(tuple(AT_REST)[:-1], 3, marks=[pytest.mark.long, pytest.mark.ci]),
        pytest.param(tuple(AT_REST), 2, marks=pytest.mark.long),
        pytest.param(tuple(AT_REST)[-1:], 4, marks=pytest.mark.long),
    ],
)
def test_a_start_at_rest_over_ranks_equals_that_of_one_process(names, ranks):
    """Pressure and density at the start agree to 1e-12, and bear the weight above."""
    for name in names:
        one, several = found(1, *names)[name], found(ranks, *names)[name]
        start, other = ({c: v[0] for c, v in each["tables"][0].items()} for each in (one, several))
        exact, spare = AT_REST[name]
        assert start["at 0.0.pressure"] == pytest.approx(exact, abs=spare), name
        size = max(map(abs, start.values()))
        for column, value in start.items():
            assert abs(other[column] - value) <= 1e-12 * size, (name, column)
        assert_same_ledger(one["rows"], several["rows"], 1)


@pytest.mark.long
@pytest.mark.ci
def test_small_linear_systems_may_be_distributed_over_ranks(monkeypatch):
    """The linear systems of the flow, of diffusing fields and of the density are distributed by an option. By
    default one rank has all rows of such small systems."""
    name = "split, all regularisations"
    one = found(1, name)[name]
    monkeypatch.setenv("PETSC_OPTIONS", "-ngvisco_on_one_rank_up_to 0")
    several = printed(HERE / "runs.py", name, ranks=3)[name]
    assert_same_ledger(one["rows"], several["rows"], spare=1)
    assert several["linear"] <= 1.1 * one["linear"]


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, pytest.param(3, marks=pytest.mark.ci)])
@pytest.mark.parametrize("method", ["gamg", "hypre"])
def test_multigrid_takes_the_place_of_the_coarse_factorisation(method, ranks):
    name = f"split block, {method}"
    exact = "split block, two levels"
    one, several = found(1, exact)[exact], found(ranks, name)[name]
    assert_same_ledger(one["rows"], several["rows"], spare=1)
    assert several["linear"] <= 1.3 * one["linear"]


@pytest.fixture
def case_file(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    return path


def ngvisco(*words, ranks=1):
    return run("-m", "ngvisco", *words, ranks=ranks)


COMMANDS = """
import json, sys
from ngvisco.cli.main import main
for words in json.loads(sys.argv[1]):
    code = main(words)
    if code:
        sys.exit(code)
"""


def all_of(*commands, ranks=1):
    """Runs several commands in one process, or in one process on each rank."""
    words = json.dumps([[str(word) for word in command] for command in commands])
    done = run("-c", COMMANDS, words, ranks=ranks)
    assert done.returncode == 0, done.stderr


def rows(directory):
    with (directory / "ledger.csv").open() as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def read(table):
    with table.open() as file:
        names, *body = csv.reader(file)
    return dict(zip(names, ([float(v) for v in column] for column in zip(*body, strict=True)), strict=True))


@pytest.mark.long
@pytest.mark.parametrize(
    "case",
    [
        "split",
        "coupled",
        "periodic",
        *(pytest.param(c, marks=pytest.mark.ci) for c in ("regularised", "adapted", "yield")),
    ],
)
def test_a_run_is_resumed_with_any_number_of_ranks(case_file, tmp_path, case):
    alone, several = tmp_path / "alone", tmp_path / "several"
    case_file.write_text(CASES[case])
    assert ngvisco("run", case_file, "-o", alone, "--quiet").returncode == 0
    begun = ngvisco("run", case_file, "-o", several, "--set", "time.until=0.02", ranks=3)
    assert begun.returncode == 0, begun.stderr
    assert begun.stdout.count("finished: t = 0.02 s after 1 step") == 1  # only the first rank prints
    assert "has 3 ranks" in (several / "log.txt").read_text()
    assert ngvisco("resume", several, "--until", "0.04", "--quiet", ranks=2).returncode == 0
    assert ngvisco("resume", several, "--until", "0.06", "--quiet").returncode == 0
    assert_same_ledger(rows(alone), rows(several))
    for name in ("centre", "forces"):
        tables = [[read(place / "samples" / f"{name}.csv") for place in (alone, several)]]
        assert_same_tables(*zip(*tables, strict=True))
    # ranks write one file, with unknowns numbered as on one process
    with h5py.File(alone / "run.h5") as a, h5py.File(several / "run.h5") as b:
        assert a.attrs["mesh"] == b.attrs["mesh"]
        state, other = (file["checkpoints/00000003/state"][:] for file in (a, b))
        assert abs(state - other).max() <= 1e-10 * abs(state).max()
    series = {path.name for path in (several / "vtk").iterdir()}
    assert {"fields_000000.pvtu", "fields_000000_p1.vtu", "fields_000000_p2.vtu", "fields.pvd"} <= series
    assert ngvisco("scene", several).returncode == 0  # files of several ranks are read as one


@pytest.mark.parametrize(
    ("case", "ranks"),
    [
        # "adapted" is "periodic" with other cells in every step; "regularised" solves all systems of "split"
        *(by_ci(*case) for case in (("coupled", 4), ("regularised", 3), ("adapted", 3), ("yield", 3))),
        *(pytest.param(*case, marks=pytest.mark.long) for case in (("split", 4), ("periodic", 4))),
    ],
)
def test_a_run_is_resumed_bit_for_bit_with_the_same_number_of_ranks(case_file, tmp_path, case, ranks):
    """Ledger, samples and states are equal to the bit, because no sum depends on the order in which messages
    arrive."""
    case_file.write_text(CASES[case].replace("dt = ", 'scheme = "midpoint"\ndt = '))
    whole, parted, until = tmp_path / "whole", tmp_path / "parted", "time.until=0.02"
    all_of(
        ("run", case_file, "-o", whole, "--quiet"),
        ("run", case_file, "-o", parted, "--quiet", "--set", until),
        ("resume", parted, "--until", "0.06", "--quiet"),
        ranks=ranks,
    )
    for name in ("ledger.csv", "samples/centre.csv", "samples/forces.csv"):
        assert (whole / name).read_text() == (parted / name).read_text(), name
    with h5py.File(whole / "run.h5") as a, h5py.File(parted / "run.h5") as b:
        one, other = (file["checkpoints/00000003"] for file in (a, b))
        for name in ("state", *(f"passive/{key}" for key in one["passive"])):
            assert one[name].size and (one[name][:] == other[name][:]).all(), name
        assert len(one["passive"]) == 2


@pytest.mark.long
@pytest.mark.ci
def test_a_run_over_ranks_is_resumed_with_changes_and_from_another_mesh(case_file, tmp_path):
    """The ledger, the costs of the change and of the transfer, and the written case are those of one
    process."""
    places = {}
    for ranks in (1, 3):
        first, other = tmp_path / f"first {ranks}", tmp_path / f"other {ranks}"
        until = ("--set", "time.until=0.02")
        change = ("--set", "material.G_e=4", "--until", "0.04")
        finer = ("--set", "domain.maxh=0.4", "--set", "time.until=0.06", "--from", first)
        all_of(
            ("run", case_file, "-o", first, *until, "--quiet"),
            ("resume", first, *change, "--quiet"),
            ("run", case_file, "-o", other, *finer, "--quiet"),
            ranks=ranks,
        )
        places[ranks] = first, other
    for alone, several in zip(places[1], places[3], strict=True):
        assert_same_ledger(rows(alone), rows(several))
        assert any(abs(row["transfer"]) > 1e-6 for row in rows(several))
        assert_same_tables(*([read(place / "samples" / "centre.csv")] for place in (alone, several)))
        assert (alone / "case.toml").read_text() == (several / "case.toml").read_text()


CURVED = f"""
[domain]
geometry = "disc"
radius = 1
maxh = 0.5
{MATERIAL}[rheology]
viscosity = {{ K_v = 0.05, G_v = 0.05 }}
[initial]
velocity = ["-y", "x + 0.1"]
[time]
dt = 0.02
until = 0.04
[output.checkpoint]
every = 1
"""


@pytest.mark.long
@pytest.mark.ci
def test_a_run_on_a_curved_mesh_is_resumed_with_any_number_of_ranks(tmp_path):
    """The mesh comes from a file, which has curved cells to eight decimals: the geometry curves them again.

    The multipliers of the wall are a part of the checkpoint.
    """
    case, alone, several = tmp_path / "disc.toml", tmp_path / "alone", tmp_path / "several"
    case.write_text(CURVED)
    for place, ranks in ((alone, 1), (several, 3)):
        until = ("--until", "0.06", "--quiet")
        all_of(("run", case, "-o", place, "--quiet"), ("resume", place, *until), ranks=ranks)
    assert_same_ledger(rows(alone), rows(several))


DISTRIBUTED = """
from mpi4py import MPI
from ngvisco.errors import MeshError
from ngvisco.geometries import box, structured_box
from ngvisco.parallel import mesh
from ngvisco.parallel.communicator import Communicator

ranks = Communicator(MPI.COMM_WORLD)

def said(domain):
    try:
        return f"{mesh.distributed(domain, ranks).ne} cells"
    except MeshError as error:
        return str(error)

def narrow(*cells, periodic="xy"):
    return said(structured_box((1, 1, 1), cells, periodic=periodic))

def empty():
    class Empty(mesh.MeshPart):
        ne = 0

    if ranks.rank == 1:
        mesh.MeshPart = Empty
    return said(box((1, 1), 0.5))

every = ranks.mpi.gather([narrow(1, 1, 4), narrow(1, 2, 4), narrow(1, 2, 4, periodic="xyz"), empty()])
if ranks.is_first:
    for said in zip(*every):
        print(*said, sep="; ")
"""


@pytest.mark.long
@pytest.mark.ci
def test_meshes_that_cannot_be_distributed_are_refused_on_every_rank(tmp_path):
    """METIS sometimes leaves a rank without cells if there are one or two cells for each rank."""
    (tmp_path / "distributed.py").write_text(DISTRIBUTED)
    result = run("-m", "mpi4py", tmp_path / "distributed.py", ranks=3)
    assert result.returncode == 0, result.stderr
    narrow, wide, in_space, empty = result.stdout.splitlines()
    for said in (narrow, in_space):
        assert said.count("one cell wide along a periodic direction. Netgen does not distribute") == 3
    assert wide.count("cells") == 3
    assert empty.count("one of 2 ranks gets none of the") == 3


REFUSED = {
    "output.probes=[{name='p',point=[2, 0]}]": "a point of the domain, which lies in",
    "material.G_e=-1": "expected a finite number > 0",
    "initial.density='x - 0.1'": "density rho_0",
    "domain.maxh=1.5": "ranks need at least one cell each",
    "domain={geometry='disc',radius=1,maxh=0.5,order=1}": "between straight facets",
}
REFUSING = """
import sys
from ngvisco.cli.main import main
from ngvisco.parallel.communicator import Communicator
case, place, *settings = sys.argv[1:]
sys.modules["petsc4py"] = None  # as where it is not installed
codes = Communicator.world().gathered(main(["run", case, "-o", place]))
if Communicator.world().is_first:
    print("without petsc4py", codes, flush=True)
del sys.modules["petsc4py"]
for setting in settings:
    options = [word for one in setting.split("; ") for word in ("--set", one)]
    code = main(["run", case, "-o", place, *options])
    codes = Communicator.world().gathered(code)
    if Communicator.world().is_first:
        print(setting, codes, flush=True)
"""


@pytest.mark.long
@pytest.mark.ci
def test_features_that_do_not_run_over_ranks_are_refused_by_name(case_file, tmp_path):
    """Every rank ends with the same code; the first rank gives the reason once, and no file is written."""
    (tmp_path / "refusing.py").write_text(REFUSING)
    result = run(tmp_path / "refusing.py", case_file, tmp_path / "run", *REFUSED, ranks=4)
    assert result.returncode == 0, result.stderr
    for setting, message in REFUSED.items():
        assert result.stderr.count(message) == 1, result.stderr
        assert f"{setting} [2, 2, 2, 2]" in result.stdout, result.stdout
    assert (
        result.stderr.count(
            "ngvisco: petsc4py is missing or does not load; ngvisco/parallel/RANKS.md says what"
        )
        == 1
    )
    assert "without petsc4py [2, 2, 2, 2]" in result.stdout
    assert not (tmp_path / "run").exists()


LID = """\
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.25
[material]
kind = "NeoHookean"
K_e = 20
G_e = 0.05
epsilon = 0.1
[rheology]
viscosity = { K_v = 0.01, G_v = 0.01 }
hyperviscosity = { mu = 0.02, p = 4 }
[walls]
top = { kind = "PrescribedTangential", velocity = [1, 0] }
left = { kind = "NoSlip" }
right = { kind = "NoSlip" }
bottom = { kind = "NoSlip" }
[time]
dt = 0.2
until = 0.5
limiter = false
adaptive = { dt_min = 0.2, dt_max = 0.2 }
[solver]
method = "split"
"""


@pytest.mark.long
@pytest.mark.ci
def test_a_failed_run_over_ranks_has_the_message_of_one_process(tmp_path):
    """The report has the place, the cell, the nearest wall, the warning of deformed corners, and the written
    fields."""
    case, said, reports = tmp_path / "lid.toml", {}, {}
    case.write_text(LID)
    for ranks in (1, 3):
        place = tmp_path / f"on {ranks}"
        failed = ngvisco("run", case, "-o", place, "--quiet", ranks=ranks)
        assert failed.returncode == 1, failed.stderr
        lines = [line for line in failed.stderr.splitlines() if line.startswith("ngvisco: ")]
        said[ranks] = [line.replace(str(place), "").replace(".pvtu", ".vtu") for line in lines]
        report = (place / "failed.txt").read_text().replace(".pvtu", ".vtu")
        # the tolerance of linear systems limits the increments
        reports[ranks] = re.sub(r"\d\.\de-(0[89]|1\d)", "small", report)
        ended = (place / "log.txt").read_text().splitlines()[-1]
        assert "ended: no step of at least dt_min" in ended
    assert said[1] == said[3] and reports[1] == reports[3]
    assert "there are 2 such cells" in said[1][0]
    assert (
        "is not positive" in reports[3] and "in cell" in reports[3] and "on the boundary 'left'" in reports[3]
    )
    several = tmp_path / "on 3"
    one = read_frame(tmp_path / "on 1" / "failed.vtu").fields
    other = read_frame(several / "failed.pvtu").fields
    assert one["out_of_bounds"].sum() == other["out_of_bounds"].sum() > 0
    # on a small mesh, one process has another tangent than several ranks
    assert other["F"].min() == pytest.approx(one["F"].min(), rel=1e-9)
    # the next attempt removes the reports of the failure
    assert ngvisco("resume", several, "--until", "0.2", "--quiet").returncode == 0
    assert not list(several.glob("failed*"))


ROUNDING = """
import json
import warnings
import ngvisco as nv
from ngvisco.geometries import annulus, box

matter = nv.Model(material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0), loads=[nv.Gravity((0.0, -1.0))])
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    start = nv.Initial(density=1.0, equilibrium="hydrostatic", datum="top")
    nv.Simulation(box((1, 1), 0.5), matter, dt=0.1, walls={"top": nv.Open(pressure=0.5)}, initial=start)
ring = nv.Simulation(
    annulus(1.0, 2.0, 0.8),
    nv.Model(material=matter.material),
    dt=0.5,
    halvings=0,
    initial=nv.Initial(density=1e-3),
    walls={"inner": nv.Open(pressure=0.1), "outer": nv.Open()},
    newton=nv.NewtonOptions(method="split"),
)
try:
    ring.run(2.0)
    said = "solved"
except nv.StepError as error:
    said = str(error)
if ring.ranks.rank == 0:
    print(json.dumps([said, [str(one.message) for one in caught]]))
"""


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("ranks", [1, 3])
def test_rounding_and_the_pressure_of_the_datum_are_measured_over_ranks(tmp_path, ranks):
    """With three ranks the first rank has no cells."""
    script = tmp_path / "ring.py"
    script.write_text(ROUNDING)
    said, warned = printed(script, ranks=ranks)
    assert "the increment is rounding of the equations" in said
    assert any("Initial.datum_pressure gives" in text and "0.5 Pa" in text for text in warned)


FAILING = """
import sys
import numpy
import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.petsc import PETScError, SumInverse
from ngvisco.run import state

class Fails:
    def start(self, simulation): pass
    def finish(self, simulation): pass
    def step(self, simulation, row):
        if simulation.ranks.rank == 1 and self.fault == "observer":
            raise OSError(28, "No space left on device", "somewhere")

def broken(*arguments): raise ZeroDivisionError("of this rank")

def failed(fault, regularised):
    steps = nv.AdaptiveSteps(dt_min=0.02, dt_max=0.02, tolerance=1e-12) if fault == "refused" else None
    law = nv.Regularisation(delta_density=1e-3, delta_fields=1e-2, rho_max=1.0) if regularised else None
    material = nv.NeoHookean(K_e=10, G_e=5, epsilon=0.1)
    model = nv.Model(material=material, loads=[nv.Gravity((0, -1))], regularisation=law)
    fails = Fails()
    fails.fault = fault
    options = {"adaptive": steps, "observers": [fails]}
    options["initial"] = nv.Initial(velocity=(1e-3, 0.0))  # through walls: that is warned of
    if fault in ("singular", "unsolved", "petsc", "density"):
        options["solver"] = "split"
    if fault == "unsolved":
        options["newton"] = nv.NewtonOptions(max_iterations=3)
    if fault == "start" and Communicator.world().rank == 1:
        state.typical_velocity = broken
    run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.02, **options)
    if fault == "step" and run.ranks.rank == 1:
        run.ledger.rates = run.integrator.meter = broken
    newton = run.solver.newton if fault in ("singular", "density") else None  # made by all ranks together
    if fault == "singular" and run.ranks.rank == 1:
        def singular(*arguments): raise numpy.linalg.LinAlgError("Singular matrix")
        newton.preconditioner.operator.points.update = singular
    if fault == "density" and run.ranks.rank == 1:
        equation = newton.residual.density
        formed = equation.jacobian
        equation.jacobian = lambda: 0.0 * formed()
    solve = SumInverse.solve
    if fault == "petsc":
        def fails(self, rows):
            if rows.any():  # not what a factorisation is tried with
                raise PETScError("PETSc did not solve a linear system (DIVERGED_PC_FAILED)")
            return rows
        SumInverse.solve = fails
    try:
        run.run(until=0.1)
        message = "ended"
    except (OSError, nv.StepError) as error:
        message = error
    SumInverse.solve = solve
    said = run.ranks.gathered(f"rank {run.ranks.rank} of {run.ranks.size} at step {run.number}: {message}")
    if run.ranks.is_first:
        for line in said:
            print(f"{fault} {regularised}|{line}", flush=True)

for word in sys.argv[1:]:
    fault, _, law = word.partition(" ")
    failed(fault, bool(law))
"""
FAULTS = {
    "observer": r"at step 1: \[Errno 28\] No space left on device: 'somewhere'",
    "singular": "at step 0: step of length 0.0025 s from t = 0 s: a block of the split solver is singular",
    "unsolved": "at step 0: step of length 0.0025 s from t = 0 s: the split solver did not converge",
    "petsc": r"at step 0: .* the split solver did not converge .*; mumps: PETSc .* \(DIVERGED_PC_FAILED\)",
    "petsc regularised": r"at step 0: .* did not converge .*; mumps: PETSc .* \(DIVERGED_PC_FAILED\)",
    "density regularised": r"at step 0: .* mumps cannot be used for the matrix \(PETSc did not .*DIVERGED",
    "refused": "at step 1: no step of at least dt_min = 0.02 s from t = 0.02 s is accepted. The run tried",
}


@pytest.mark.long
@pytest.mark.ci
def test_an_error_on_one_rank_is_raised_on_all_ranks(tmp_path):
    """One rank has a full disk or a singular matrix, or all ranks refuse a step. Every rank raises the error,
    and a warning appears once."""
    (tmp_path / "failing.py").write_text(FAILING)
    result = run(tmp_path / "failing.py", *FAULTS, ranks=3)
    assert result.returncode == 0, result.stderr
    assert result.stderr.count("InputWarning: initial velocity") == 1
    lines = [line.split("|", 1) for line in result.stdout.splitlines() if "|rank" in line]
    for fault, message in FAULTS.items():
        key = f"{fault.split()[0]} {fault.endswith('regularised')}"
        said = [line for name, line in lines if name == key]
        assert len(said) == 3 and len({line.split(" of 3 ")[1] for line in said}) == 1, fault
        for rank, line in enumerate(said):
            assert re.match(f"rank {rank} of 3 {message}", line), line


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("where", ["start", "step"])
def test_an_uncaught_error_of_one_rank_ends_all_ranks(tmp_path, where):
    """The other ranks wait for the failed rank in a computation; none of them stays behind."""
    (tmp_path / "failing.py").write_text(FAILING)
    result = run(tmp_path / "failing.py", where, ranks=3, timeout=60)
    assert result.returncode == 1 and "ZeroDivisionError: of this rank" in result.stderr
