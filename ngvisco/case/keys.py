"""What each key of a case file means: its unit, a line of words and an example.

Types, defaults and what is required are the schema's (``ngvisco.case.schema``), which takes them from the
dataclasses and functions of the catalogue; ``ngvisco.case.reference`` puts both together.  A key is looked
up as ``Owner.name``, the owner being the class or function that takes it, and then as ``name``: a material
with the usual moduli needs no line of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Key:
    """Unit, meaning and example of a key.

    Attributes
    ----------
    unit : str
        SI unit; "1" for pure numbers, "" for what is no number.  Exponents may be the section's own keys.
    meaning : str
    example : value, as TOML has it
    """

    unit: str
    meaning: str
    example: Any


KEYS: dict[str, Key] = {
    # the case
    "CaseSections.title": Key("", "what the case is, for logs and pictures", "A block under gravity"),
    "CaseSections.units": Key("", "units of plain numbers; SI where nothing is said", None),
    "Units.length": Key("", "of lengths, and of x, y, z in expressions", "km"),
    "Units.time": Key("", "of times, and of t in expressions", "kyr"),
    "Units.velocity": Key("", "of velocities", "cm/yr"),
    "Units.acceleration": Key("", "of accelerations", "m/s^2"),
    "Units.density": Key("", "of densities", "kg/m^3"),
    "Units.pressure": Key("", "of stresses and elastic moduli", "GPa"),
    "Units.viscosity": Key("", "of viscosities and the creep modulus", "Pa s"),
    "CaseSections.domain": Key("", "the domain and its mesh", None),
    "CaseSections.material": Key("", "the material: its variables and its stored energy", None),
    "CaseSections.bodies": Key(
        "", "bodies of different material, each an element of the array, in place of [material]", None
    ),
    "CaseSections.time": Key("", "step length and end", None),
    "CaseSections.walls": Key("", "what holds on the walls, by name; Slip where nothing is said", None),
    "CaseSections.rheology": Key("", "dissipative mechanisms, each a table of its own", None),
    "CaseSections.loads": Key("", "forces, each an element of the array", None),
    "CaseSections.initial": Key("", "the state at t = 0", None),
    "CaseSections.discretisation": Key("", "orders in space", None),
    "CaseSections.solver": Key("", "method and tolerances of a step's solver", None),
    "CaseSections.output": Key("", "what the run directory gets", None),
    "Time.adaptive": Key("", "step lengths chosen by the run; of one length without this table", None),
    "Rheology.viscosity": Key("", "Stokes viscosity", None),
    "Rheology.linear_viscosity": Key("", "any linear viscosity instead of the isotropic one", None),
    "Rheology.hyperviscosity": Key("", "hyperviscosity of second velocity gradients", None),
    "Rheology.creep": Key("", "Maxwellian creep of the deviatoric part", None),
    "Rheology.regularisation": Key("", "the paper's regularising terms", None),
    "Output.vtk": Key("", "the VTK series, for ParaView", None),
    "Output.checkpoint": Key("", "checkpoints in run.h5", None),
    "Output.probes": Key("", "fields at points over time, each a file samples/NAME.csv", None),
    "Output.lines": Key("", "fields along lines over time, each a file samples/NAME.csv", None),
    "Output.forces": Key("", "forces and torques on walls over time, in samples/forces.csv", None),
    "Output.integrals": Key("", "integrals over the domain over time, each a file samples/NAME.csv", None),
    "Output.bodies": Key("", "mass, centroid, energies, ... of each body over time, in bodies.csv", None),
    "BodiesTable.every": Key("1", "a row every so many steps, and at the end", 1),
    # domain
    "geometry": Key("", "which domain", "box"),
    "size": Key("m", "edge lengths, two (plane strain) or three", [1.0, 1.0]),
    "maxh": Key("m", "largest size of a cell", 0.1),
    "file.maxh": Key("m", "largest size of a cell, for STEP and BREP files, which are meshed", 0.1),
    "periodic": Key("", 'directions in which opposite walls are one, some of "x", "y", "z"', "x"),
    "structured_box.cells": Key("1", "rows of cells along each direction, >= 1", [2, 40]),
    "structured_box.grading": Key(
        "1",
        "length of the last row over that of the first one, by direction; 1 where nothing is said",
        {"y": 5.0},
    ),
    "refine": Key("m", "smaller cell sizes at walls, by the wall's name", {"left": 0.05}),
    "channel.refine": Key("m", "smaller cell sizes at walls, by the wall's name", {"top": 0.05}),
    "annulus.refine": Key("m", "smaller cell sizes at walls, by the wall's name", {"inner": 0.05}),
    "spherical_shell.refine": Key("m", "smaller cell sizes at walls, by the wall's name", {"inner": 0.05}),
    "cylinder.refine": Key("m", "smaller cell sizes at walls, by the wall's name", {"side": 0.05}),
    "disc.refine": Key("m", "smaller cell sizes at walls, by the wall's name", {"wall": 0.05}),
    "sphere.refine": Key("m", "smaller cell sizes at walls, by the wall's name", {"wall": 0.05}),
    "split_corners": Key(
        "", "divide cells whose edges at a vertex all lie on walls: for walls that move", True
    ),
    "order": Key("1", "polynomial order of curved cells", 3),
    "inner": Key("m", "inner radius", 1.0),
    "outer": Key("m", "outer radius, above the inner one", 2.0),
    "radius": Key("m", "radius", 0.2),
    "length": Key("m", "length, along x", 2.0),
    "height": Key("m", "height", 1.0),
    "channel.width": Key("m", "width along y; makes the channel three-dimensional", 1.0),
    "thickness": Key("m", "edge of the square cross-section", 0.2),
    "bar.dim": Key("1", "2 (plane strain) or 3", 2),
    "fillet": Key("m", "radius to which edges and corners are rounded; 0 leaves them sharp", 0.05),
    "file.path": Key("", "a .vol, .msh (gmsh), STEP or BREP file; relative to the case file", "part.step"),
    # materials
    "material.kind": Key("", "which material", "NeoHookean"),
    "K_e": Key("Pa", "bulk modulus, > 0; the usual one is K_e + kappa (kappa + 1) epsilon", 10.0),
    "LinearElastic.K_e": Key("Pa", "elastic bulk modulus, > 0: the usual one", 10.0),
    "LogarithmicNeoHookean.K_e": Key("Pa", "bulk modulus, > 0; the usual one is K_e + epsilon", 10.0),
    "G_e": Key("Pa", "elastic modulus of shear, > 0: half the usual shear modulus", 5.0),
    "LinearElastic.G_e": Key("Pa", "elastic shear modulus, > 0: the usual one", 5.0),
    "HardeningElastic.K_e": Key("Pa", "elastic bulk modulus at zero strain, > 0: the usual one", 10.0),
    "HardeningElastic.G_e": Key("Pa", "elastic shear modulus at zero strain, > 0: the usual one", 5.0),
    "K_h": Key("Pa", "bulk hardening modulus, >= 0", 10.0),
    "G_h": Key("Pa", "shear hardening modulus, >= 0", 5.0),
    "s": Key("1", "exponent of the hardening, > 2", 4.0),
    "HardeningElastic.floor": Key("1", "strain below which |E|^s is smoothed, > 0", 1e-8),
    "NeoHookean.K_e": Key(
        "Pa",
        "bulk modulus, > 0; the usual one is K_e + epsilon, with kappa K_e + kappa (kappa + 1) epsilon",
        10.0,
    ),
    "MooneyRivlin.K_e": Key(
        "Pa",
        "bulk modulus, > 0; the usual one is K_e + epsilon, with kappa K_e + kappa (kappa + 1) epsilon",
        10.0,
    ),
    "epsilon": Key("Pa", "weight of the term that is singular at J = 0", 0.1),
    "kappa": Key(
        "1",
        "exponent of epsilon/J^kappa, > 0; NeoHookean and MooneyRivlin without it have -epsilon ln J",
        2.0,
    ),
    "J_min": Key("1", "the singular term is continued linearly below this J, > 0", 0.1),
    "G_mr": Key("Pa", "weight of the cofactor, >= 0; G_e + G_mr is half the usual shear modulus", 2.0),
    "MooneyRivlin.G_e": Key("Pa", "weight of |F|^2, > 0; G_e + G_mr is half the usual shear modulus", 5.0),
    "ReferentialMooneyRivlin.G_e": Key(
        "Pa", "weight of |F|^2, > 0 (C_10); G_e + G_mr is half the usual shear modulus", 5.0
    ),
    "FENEP.b": Key("1", "square of the chains' largest extension, tr B < b; > 3", 50.0),
    "B": Key(
        "Pa", "energy density at the referential density, > 0; the pressure there is (gamma - 1) B", 1.0
    ),
    "gamma": Key("1", "adiabatic exponent, > 1", 1.4),
    "form": Key("", 'the variable that is carried, "J" or "A" = 1/J', "J"),
    "BarotropicFluid.J_min": Key(
        "1", 'with form = "J": the energy is continued linearly below this J, > 0', 0.1
    ),
    "Custom.variables": Key(
        "",
        "what is carried: F, H = cof(F), B = F*trans(F), N = cof(F*trans(F)), J = det(F), A = 1/J, "
        'K = log(J)/J, the small strain E; with a power of J as in "H = J**(-5/6)*F"',
        ["F", "J"],
    ),
    "IsotropicStrainEnergy.energy": Key(
        "Pa",
        "stored energy per actual volume of the small strain E, isotropic and convex",
        "5*tr(E)**2 + 5*norm2(dev(E))",
    ),
    "parameters": Key("any", "numbers that the energy reads by name, as they stand", {"G": 5.0}),
    "Custom.energy": Key(
        "Pa",
        'stored energy of the variables; by per = "mass" in J/kg',
        "3*norm2(F)/J**(2/3) + 4*(J + 1/J)",
    ),
    "Custom.per": Key(
        "",
        'what the energy is per: "volume" (the actual one), "referential volume" or "mass"; by the latter '
        "two what is carried are the tensors over J, and A = 1/J",
        "volume",
    ),
    "rho_R": Key(
        "kg/m^3",
        "density where J = 1, > 0; with it the initial density and J follow from one another",
        1000.0,
    ),
    "IsentropicFluid.a": Key("Pa (m^3/kg)^gamma", "of the state equation p = a rho^gamma, > 0", 1.0),
    "material": Key("", "the material that is regularised, a table with a kind of its own", None),
    "Yosida.eps": Key("1/Pa", "width of the Yosida approximation, > 0", 1e-3),
    "WithQuadratic.delta": Key("Pa^2", "sqrt(delta)/2 |z|^2 is added to the energy, > 0", 1e-6),
    "WithQuadratic.only": Key("", "variables for which it is added; all without this key", ["J"]),
    # bodies
    "Body.name": Key("", "letters, digits and _; fields and columns of the body begin with it", "disc"),
    "Body.where": Key(
        "",
        "where the body is at the start: a condition on x, y, z, a shape, or several of which it is the "
        "union; what the other bodies leave without this key, which one of them at most may lack",
        None,
    ),
    "where.kind": Key("", "which shape", "Ball"),
    "Body.material": Key("", "its material, with the keys of [material]", None),
    "Body.viscosity": Key("", "its Stokes viscosity, with the keys of [rheology.viscosity]", None),
    "Body.linear_viscosity": Key("", "any linear viscosity instead, as [rheology.linear_viscosity]", None),
    "Body.creep": Key("", "its creep, with the keys of [rheology.creep]", None),
    "Body.density": Key(
        "kg/m^3", "its density where J = 1, > 0; that of its material where this has rho_R", 1000.0
    ),
    "Body.order": Key("1", "of two bodies that overlap at the start the one of higher order is there", 1),
    "Ball.centre": Key("m", "its centre, a coordinate for each dimension", [0.6, 0.5]),
    "Block.low": Key("m", "corner of the smallest coordinates", [0.2, 0.2]),
    "Block.high": Key("m", "corner of the largest coordinates", [0.8, 0.4]),
    "HalfSpace.point": Key("m", "a point of the plane", [0.0, 0.5]),
    "HalfSpace.normal": Key("1", "outward normal of the plane, of any length", [0.0, 1.0]),
    "Polygon.points": Key("m", "corners in order; the last is joined to the first", [[0, 0], [1, 0], [0, 1]]),
    "ClosedSurface.path": Key("", "an STL file whose surface closes; relative to the case file", "part.stl"),
    "ClosedSurface.scale": Key("m", "length of the STL file's unit", 1e-3),
    "Image.path": Key("", "a PNG file; relative to the case file", "part.png"),
    "Image.low": Key("m", "place of the picture's lower left corner", [0.0, 0.0]),
    "Image.high": Key("m", "place of its upper right corner", [1.0, 1.0]),
    "Image.threshold": Key("1", "grey, from 0 (black) to 1 (white), below which a pixel belongs to it", 0.5),
    "Image.dark": Key("", "false: what is brighter than the threshold instead", True),
    "Subdomain.names": Key("", "names of subdomains of the mesh", ["inclusion"]),
    # mechanisms
    "K_v": Key("Pa s", "bulk viscosity, >= 0: stress K_v (div v) I", 0.01),
    "G_v": Key("Pa s", "shear viscosity, >= 0: stress 2 G_v dev eps(v), the usual dynamic viscosity", 0.01),
    "LinearViscosity.D": Key(
        "Pa s",
        "viscous stress D eps(v): 6x6 or 3x3x3x3, symmetric and positive semidefinite",
        [
            [4.0, 1.0, 1.0, 0, 0, 0],
            [1.0, 3.0, 1.0, 0, 0, 0],
            [1.0, 1.0, 3.0, 0, 0, 0],
            [0, 0, 0, 2.0, 0, 0],
            [0, 0, 0, 0, 2.0, 0],
            [0, 0, 0, 0, 0, 2.0],
        ],
    ),
    "LinearViscosity.notation": Key(
        "",
        'how D is written, entries in the order 11, 22, 33, 23, 13, 12: "voigt" has the D_ijkl themselves, '
        '"mandel" those of an orthonormal basis; "tensor" is 3x3x3x3',
        "mandel",
    ),
    "mu": Key("W/m^3 (m s)^p", "hyperviscosity: mu |hess v|^p is its dissipation; > 0", 1e-5),
    "HyperViscosity.p": Key("1", "exponent, > 1; the paper's analysis has p > 3", 4.0),
    "mu_1": Key("Pa s m^2", "coefficient of the quadratic part of the hyperviscosity, >= 0", 1e-4),
    "HyperViscosity.penalty": Key("1", "weight of the interior penalty, > 0", 1.0),
    "HyperViscosity.floor": Key("1/(m s)", "|hess v| below which odd powers are smoothed, > 0", 1e-10),
    "G_m": Key(
        "Pa s",
        "creep modulus, > 0: twice the usual viscosity eta of the Maxwell dashpot, G_m = 2 eta; with the "
        "usual shear modulus G the relaxation time of shear is G_m/(2 G)",
        5.0,
    ),
    "Creep.law": Key(
        "", '"mandel" (the paper), or "conformation" or "leonov" of a conformation tensor\'s fluid', "mandel"
    ),
    "nu": Key("W/m^3 (m s)^q", "gradient of the creep rate: nu |grad Pi|^q is its dissipation; >= 0", 1e-4),
    "q": Key("1", "exponent of the creep rate's gradient, > 1; the paper's analysis has q > 3", 4.0),
    "Creep.floor": Key("1/(m s)", "|grad Pi| below which odd powers are smoothed, > 0", 1e-10),
    "delta_density": Key("m^2/s (kg/m^4)^(2-r)", "diffusion of the density by the r-Laplacian, >= 0", 1e-6),
    "Regularisation.r": Key("1", "exponent of the density's diffusion, > 1; the analysis has r > 3", 4.0),
    "delta_fields": Key("m^2/s", "diffusion of all transported variables, >= 0", 1e-6),
    "Regularisation.epsilon": Key("W/m^3 (s/m)^p", "friction epsilon |v|^(p-2) v, >= 0", 1e-3),
    "Regularisation.p": Key("1", "exponent of that friction, > 1", 4.0),
    "Regularisation.rho_max": Key(
        "kg/m^3", "density above which the paper's cut-off acts; none without this key", 10.0
    ),
    "Regularisation.width": Key("kg/m^3", "the cut-off falls to 0 over this width, > 0", 1.0),
    "Regularisation.penalty": Key("1", "weight of the diffusions' interior penalty, > 0", 4.0),
    "gradient_floor": Key(
        "kg/m^4", "|grad rho| below which the r-Laplacian's penalty is constant, > 0", 1e-3
    ),
    "Regularisation.floor": Key(
        "1", "|v| and |grad rho|, in SI units, below which odd powers are smoothed, > 0", 1e-10
    ),
    # loads
    "loads.kind": Key("", "which load", "Gravity"),
    "g": Key("m/s^2", "acceleration, a component for each dimension", [0.0, -9.81]),
    "force": Key("N/m^3", "force per actual volume, a component for each dimension", [0.0, "-sin(t)"]),
    "Gravity.name": Key("", "the ledger's column is power_<name>", "gravity"),
    "CentralGravity.name": Key("", "the ledger's column is power_<name>", "gravity"),
    "BodyForce.name": Key("", "the ledger's column is power_<name>", "body_force"),
    "strength": Key("m/s^2", "acceleration towards the centre at r = radius; negative is outward", 9.81),
    "centre": Key("m", "the centre, a component for each dimension", [0.0, 0.0]),
    "CentralGravity.radius": Key("m", "radius at which the strength holds, > 0", 1.0),
    "exponent": Key(
        "1", "the acceleration goes like r^exponent: 0 constant, 1 inside a ball, -2 outside", 0.0
    ),
    # walls
    "walls.kind": Key("", "which condition", "Slip"),
    "straight": Key("", "straight facets of this wall are meant, though they meet at an angle", True),
    "PrescribedTangential.velocity": Key(
        "m/s", "velocity of the wall, tangential to it", ["0.1*y", "-0.1*x"]
    ),
    "Traction.f": Key("Pa", "tangential traction, a component for each dimension", ["0.1*sin(t)", 0.0]),
    "friction": Key("Pa s/m", "traction -friction v_t besides, >= 0", 0.1),
    "coefficient": Key("Pa s/m", "tangential stress is -coefficient v_t, >= 0", 0.1),
    "elastic_state": Key(
        "",
        'variables of the distortion "F" or of "B" = F F^T, for a body that flows; B where there is creep',
        "B",
    ),
    # start
    "density": Key(
        "kg/m^3", "initial density, > 0; 1 without this key, or rho_R/J for a material with rho_R", 1.0
    ),
    "Initial.velocity": Key(
        "m/s", "initial velocity; at rest without this key", ["sin(pi*x)*cos(pi*y)", "-cos(pi*x)*sin(pi*y)"]
    ),
    "Initial.F": Key(
        "1",
        "initial elastic distortion, 3x3, det F > 0; the identity without it",
        [[1.1, 0, 0], [0, 1, 0], [0, 0, 1]],
    ),
    "Initial.values": Key(
        "1", "initial values of single variables of the material, by name", {"J": "1 + 0.1*x"}
    ),
    # time
    "Time.dt": Key("s", "length of a step; of the first one, with [time.adaptive]", 0.02),
    "Time.until": Key("s", "end of the run, a multiple of dt where steps have one length", 1.0),
    "Time.scheme": Key(
        "",
        'time scheme: "backward-euler" (order 1), "midpoint" (order 2, damps nothing), "sdirk2" (order 2, '
        'damps what the step does not resolve) or "theta"',
        "midpoint",
    ),
    "Time.theta": Key("1", 'of scheme = "theta", in [1/2, 1]: 1/2 is midpoint, 1 backward-euler', 0.6),
    "Time.startup": Key("1", "first steps of the run that are of backward-euler, which damps rough data", 2),
    "Time.relaxation": Key(
        "", "with midpoint and [time.adaptive]: end each step where the scheme dissipates nothing", True
    ),
    "Time.limiter": Key(
        "",
        "whether cells in which rho, J, det F, ... are not positive at a point, though in the mean, are "
        "scaled towards their means after a step; false ends the run there",
        True,
    ),
    "Time.halvings": Key(
        "1",
        "of a step of fixed length that is not solved, before the coupled solver is asked; 0 asks at once",
        3,
    ),
    "velocity_scale": Key(
        "m/s",
        "a typical velocity, which sets the width of the upwinding; default: of flow, walls, free fall or "
        "elastic release, at rest a tenth of the speed of sound",
        1.0,
    ),
    "dt_min": Key("s", "shortest step; a shorter one ends the run", 1e-3),
    "dt_max": Key("s", "longest step", 0.1),
    "AdaptiveSteps.tolerance": Key(
        "1", "of a step's relative error; without it only unsolvable steps are shortened", 1e-3
    ),
    "patience": Key("1", "accepted steps in a row before the length is doubled, without a tolerance", 4),
    # numbers of the scheme and of the solver
    "k": Key("1", "order of the velocity, 2 or 3", 2),
    "m": Key("1", "order of density and transported variables, 0, 1 or 2", 1),
    "quadrature_bonus": Key("1", "added to the degree of all quadrature, 0 to 12", 0),
    "NewtonOptions.tolerance": Key("1", "the iteration ends below this relative increment", 1e-10),
    "max_iterations": Key("1", "iterations that a step may take", 60),
    "refresh": Key("1", "contraction above which the Jacobian is made anew, in (0, 1)", 0.25),
    "min_damping": Key("1", "smallest damping of a Newton step that is tried, in (0, 1)", 1e-3),
    "inverse": Key("", 'sparse direct solver, "umfpack", "pardiso" or "mumps"', "umfpack"),
    "coarse": Key(
        "",
        'for the velocities of vertices on large meshes: "direct", or multigrid of PETSc, "gamg" or "hypre"',
        "direct",
    ),
    "method": Key(
        "", '"coupled" (small meshes), "split" (large ones) or "auto"; both solve the same equations', "auto"
    ),
    # output
    "Output.log_every": Key("1", "a line in log.txt every so many steps", 1),
    "Output.passive": Key(
        "", "further fields to carry along: F_tot, reference_map, creep_strain", ["reference_map"]
    ),
    "VTK.enabled": Key("", "whether the VTK series is written", True),
    "VTK.every": Key("1", "a file every so many steps", 10),
    "VTK.interval": Key("s", "a file at every multiple of this time instead of every so many steps", 0.1),
    "VTK.fields": Key(
        "",
        "which fields; without this key all but creep_rate, mandel_stress, viscous_stress, hyperstress_1 "
        "(to 3), principal_stresses, principal_stretches",
        ["velocity", "density"],
    ),
    "VTK.subdivision": Key("1", "bisections of cells, 0 to 4: fields are linear in the pieces", 1),
    "Checkpoint.every": Key("1", "a checkpoint every so many steps, and at the end", 10),
    "Checkpoint.keep": Key("1", "how many checkpoints run.h5 holds", 2),
    "Probe.name": Key("", "letters, digits, _ and -; the file is samples/NAME.csv", "tip"),
    "Probe.point": Key("m", "where, a coordinate for each dimension", [0.5, 0.5]),
    "Probe.fields": Key(
        "", "fields or components of them; without this key as for output.vtk.fields", ["velocity", "F_12"]
    ),
    "Probe.every": Key("1", "a row every so many steps, and at the end", 1),
    "Line.name": Key("", "letters, digits, _ and -; the file is samples/NAME.csv", "middle"),
    "Line.start": Key("m", "one end, a coordinate for each dimension", [0.0, 0.5]),
    "Line.end": Key("m", "the other end", [1.0, 0.5]),
    "Line.points": Key("1", "how many points, equally spaced, the ends among them", 101),
    "Line.fields": Key(
        "", "fields or components of them; without this key as for output.vtk.fields", ["density"]
    ),
    "Line.every": Key("1", "rows every so many steps, and at the end", 10),
    "Forces.walls": Key("", "names of walls; all without this key", ["left"]),
    "Forces.about": Key("m", "the point that torques refer to; the origin without this key", [0.5, 0.5]),
    "Forces.every": Key("1", "a row every so many steps, and at the end", 1),
    "DomainIntegral.name": Key("", "letters, digits, _ and -; the file is samples/NAME.csv", "momentum"),
    "DomainIntegral.of": Key("", "an expression of x, y, z, t and fields' components", "density*velocity_1"),
    "DomainIntegral.every": Key("1", "a row every so many steps, and at the end", 1),
}


def key(owner: str, name: str) -> Key:
    """The entry of a key; raises KeyError where there is none."""
    return KEYS[f"{owner}.{name}"] if f"{owner}.{name}" in KEYS else KEYS[name]
