"""ngvisco: compressible viscoelastic solids and fluids at large strains in the Eulerian frame.

Implements T. Roubíček, "Time discretization in visco-elastodynamics at large displacements and
strains in the Eulerian frame" (2024) on Netgen/NGSolve.  Labels in docstrings, such as
ED-Euler-large2, denote the paper's equations.
"""

from ngvisco import interrupts as _interrupts  # noqa: F401  # isort: skip (before the imports that take long)
import importlib.metadata
import importlib.util
from pathlib import Path

from ngvisco.errors import (
    CheckpointError,
    InitialDataError,
    InputWarning,
    MeshError,
    NgviscoError,
    NgviscoWarning,
    NotANumberError,
    ParameterError,
    StepError,
    StopRequested,
    UnknownNameError,
)
from ngvisco.forms.context import time
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.start.given import function_field, grid_field
from ngvisco.forms.start.initial import Initial
from ngvisco.forms.term import Entry, Integrand, PointTerm
from ngvisco.notices import print_own
from ngvisco.physics import flow_rules, materials
from ngvisco.physics.activation import WLF, Activated, ActivatedViscosity
from ngvisco.physics.bodies import Body
from ngvisco.physics.diffusion import Diffusion, WallExchange
from ngvisco.physics.energy_checks import (
    ConvexityReport,
    ConvexityWarning,
    IsotropyReport,
    check_convexity,
    check_isotropy,
)
from ngvisco.physics.flow_rules import *  # noqa: F403
from ngvisco.physics.heat import Heat, WallHeat
from ngvisco.physics.loads import BodyForce, CentralGravity, Gravity
from ngvisco.physics.material import Material
from ngvisco.physics.materials import *  # noqa: F403
from ngvisco.physics.model import Model
from ngvisco.physics.parameters import Parameter
from ngvisco.physics.regularisation import Regularisation
from ngvisco.physics.rheology import (
    Carreau,
    Cross,
    HyperViscosity,
    LinearViscosity,
    PowerLaw,
    StokesViscosity,
    Viscosity,
)
from ngvisco.physics.signals import pulse, step, table
from ngvisco.physics.walls import (
    Inflow,
    NavierFriction,
    NoSlip,
    Open,
    PrescribedNormal,
    PrescribedTangential,
    Slip,
    Traction,
)
from ngvisco.run.adaptive import AdaptiveSteps, DamageWarning
from ngvisco.run.body_tables import Bodies, SmearedWarning
from ngvisco.run.checkpoint import Checkpoints
from ngvisco.run.contours import Contours
from ngvisco.run.inlets import InflowWarning
from ngvisco.run.ledger import ClosureWarning, DefectWarning
from ngvisco.run.momentum import MomentumWarning
from ngvisco.run.observers import LedgerCSV, NotebookProgress, Progress, VTKSeries
from ngvisco.run.pictures import plot_fields
from ngvisco.run.plots import plot_energies, plot_schemes
from ngvisco.run.probes import Integrals, LineSamples, Probes, WallForces
from ngvisco.run.record import record
from ngvisco.run.refinement import Refinement, run_refined
from ngvisco.run.ringing import RingingWarning
from ngvisco.run.self_contact import SelfContactWarning
from ngvisco.run.signs import CreepPowerWarning, DissipationWarning, EntropyWarning
from ngvisco.run.simulation import Observer, Simulation
from ngvisco.run.snapshot import read_ledger
from ngvisco.run.stepping import Rejection, TimeSteps
from ngvisco.run.transfer import Transfer, resume_changed, transfer
from ngvisco.sensitivity.data import DataError
from ngvisco.sensitivity.fit import Fit, fit
from ngvisco.sensitivity.gradient import Gradient, gradient
from ngvisco.sensitivity.numbers import Misfit
from ngvisco.shapes.files import ClosedSurface, Image
from ngvisco.shapes.shape import Ball, Block, HalfSpace, Polygon, Shape, Subdomain
from ngvisco.solver.options import NewtonOptions
from ngvisco.timestepping.scheme import SCHEMES, TimeScheme

try:
    __version__ = importlib.metadata.version("ngvisco")
except importlib.metadata.PackageNotFoundError:  # a clone without installation
    __version__ = "0+unknown"


if importlib.util.find_spec("ngvisco.geometries") is None:  # in a clone, geometries/ lies beside ngvisco/
    __path__.append(str(Path(__file__).resolve().parents[1]))  # noqa: F405
print_own()

# imported after geometries, which the catalogue of case files lists
from ngvisco.case import Case, CaseError, RunDirectoryError, load, load_case  # noqa: E402

# fmt: off
__all__ = [  # noqa: RUF022 (by subject)
    "Case", "load", "load_case",
    "Body", "Diffusion", "Heat", "Material", "Model", "Parameter", "Regularisation",
    "Activated", "ActivatedViscosity", "Carreau", "Cross", "HyperViscosity", "LinearViscosity",
    "WLF", "PowerLaw", "StokesViscosity", "Viscosity",
    "ConvexityReport", "IsotropyReport", "check_convexity", "check_isotropy",
    "BodyForce", "CentralGravity", "Gravity", "pulse", "step", "table", "time",
    "Inflow", "NavierFriction", "NoSlip", "Open", "Slip", "Traction",
    "PrescribedNormal", "PrescribedTangential", "WallExchange", "WallHeat",
    "Ball", "Block", "ClosedSurface", "HalfSpace", "Image", "Polygon", "Shape", "Subdomain",
    "Entry", "Integrand", "PointTerm",
    "Discretisation", "Initial", "function_field", "grid_field",
    "SCHEMES", "AdaptiveSteps", "NewtonOptions", "Rejection", "TimeScheme", "TimeSteps",
    "Observer", "Refinement", "Simulation", "Transfer", "resume_changed", "run_refined", "transfer",
    "Bodies", "Checkpoints", "Contours", "Integrals", "LedgerCSV", "LineSamples",
    "NotebookProgress", "Probes", "Progress", "VTKSeries", "WallForces",
    "plot_energies", "plot_fields", "plot_schemes", "read_ledger", "record",
    "Fit", "Gradient", "Misfit", "fit", "gradient",
    "CaseError", "CheckpointError", "DataError", "InitialDataError", "MeshError",
    "NgviscoError", "NotANumberError", "ParameterError",
    "RunDirectoryError", "StepError", "StopRequested", "UnknownNameError",
    "ClosureWarning", "ConvexityWarning", "CreepPowerWarning", "DamageWarning", "DefectWarning",
    "DissipationWarning", "EntropyWarning", "InflowWarning", "InputWarning",
    "MomentumWarning", "NgviscoWarning", "RingingWarning", "SelfContactWarning", "SmearedWarning",
]
# fmt: on
__all__ += flow_rules.__all__
__all__ += materials.__all__
