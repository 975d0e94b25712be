"""Bad input of a script: a typed error names field, value and valid values. NumPy's numbers are accepted."""

import ast
import math
import re
from functools import cache

import numpy as np
import pytest
from ngsolve import CF, Id, log, sqrt, x, z
from support import LINEAR, NEO_HOOKEAN, small_box

import ngvisco as nv
from ngvisco import geometries
from ngvisco.errors import ParameterError
from ngvisco.physics import variables
from ngvisco.shapes.fractions import fractions
from ngvisco.shapes.shape import Union, Where  # noqa: F401  of the tables

ELASTIC = nv.Model(material=LINEAR)
FINITE = nv.Model(material=NEO_HOOKEAN)
PAIR = CF((x, x))
WARM = nv.Thermal(material=LINEAR, c=1.0, theta_R=1.0)
REFLECTION = CF((-1, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
OUT_OF_PLANE = CF((1, 0, 0.5, 0, 1, 0, 0, 0, 1), dims=(3, 3))
NOT_SYMMETRIC = CF((0, 1, 0, 0, 0, 0, 0, 0, 0), dims=(3, 3))
NAN_HALF = log(x - 0.5)
STOKES = nv.StokesViscosity(K_v=1, G_v=1)
TWICE, K = [variables.Distortion()] * 2, [variables.LogJacobian()]


def simulation(model=FINITE, **options):
    return nv.Simulation(small_box(2), model, **{"dt": 0.1, **options})


def of(name, where):
    return nv.Body(
        name=name, where=where, material=nv.ReferentialNeoHookean(K_e=1, G_e=1, elastic_state="B"), density=1
    )


DISC = nv.Ball((0.0, 1.0), 0.4)
DISC_IN_BOX = nv.Model(bodies=[of("disc", DISC), of("rest", None)])


def start(model=FINITE, **initial):
    return simulation(model, initial=nv.Initial(**initial))


def loaded(*loads):
    return simulation(nv.Model(material=LINEAR, loads=loads))


def without_energy():
    return nv.CustomMaterial(
        transported=(variables.Distortion(), variables.Jacobian()),
        stored_energy=lambda F, J: log(F[0, 0] - 2) + J,
    )


@cache
def names():
    """Names for the expressions in the tables below."""
    known = {name: getattr(nv, name) for name in dir(nv)} | vars(variables) | vars(geometries) | globals()
    return known | {"inf": math.inf, "nan": math.nan, "np": np, "sqrt": sqrt}


def rows(table):
    """Test parameters from lines EXPRESSION | VALUES | FURTHER ENTRIES; each value replaces _ in the
    expression."""
    found = []
    for line in table.strip().splitlines():
        make, values, *rest = line.split(" | ")
        parsed = ast.parse(values).body[0].value
        for value in parsed.elts if isinstance(parsed, ast.Tuple) else [parsed]:
            text = ast.unparse(value)
            found.append(pytest.param(make, text, *rest, id=f"{make} of {text}"))
    return found


def made(make, value):
    return eval(make, {**names(), "_": value})


POSITIVE = """\
LinearElastic(K_e=1, G_e=_) | LinearElastic.G_e
NeoHookean(K_e=_, G_e=1, epsilon=1) | NeoHookean.K_e
NeoHookean(K_e=1, G_e=_, epsilon=1) | NeoHookean.G_e
NeoHookean(K_e=1, G_e=1, epsilon=_) | NeoHookean.epsilon
HyperViscosity(mu=_) | HyperViscosity.mu
HyperViscosity(mu=1, penalty=_) | HyperViscosity.penalty
HyperViscosity(mu=1, floor=_) | HyperViscosity.floor
simulation(dt=_) | TimeSteps.dt
"""
NAMED = "\n".join(
    line.replace(" | ", " | 0, -1.0, nan, inf, '1', None, True | ") + " | a finite number > 0"
    for line in POSITIVE.splitlines()
)
NAMED += """
HyperViscosity(mu=1, p=_) | 1, 0.5, nan | HyperViscosity.p | a finite number > 1
HyperViscosity(mu=1, mu_1=_) | -1, inf | HyperViscosity.mu_1 | number >= 0
StokesViscosity(K_v=_, G_v=1) | -1e-9, nan | StokesViscosity.K_v | number >= 0
StokesViscosity(K_v=1, G_v=_) | -1e-9, nan | StokesViscosity.G_v | number >= 0
Creep(G_m=_) | 0, -1, nan | Creep.G_m | a finite number > 0
Discretisation(k=_) | 0, 4, 2.0, "2" | Discretisation.k | a whole number from 1 to 3
Discretisation(m=_) | -1, 3, True, 1.0 | Discretisation.m | a whole number from 0 to 2
Discretisation(quadrature_bonus=_) | -1, 0.5 | Discretisation.quadrature_bonus | a whole number from 0 to 12
NewtonOptions(tolerance=_) | 0, -1.0, nan, inf, '1', True, 1 | NewtonOptions.tolerance | a number in (0, 1)
NewtonOptions(refresh=_) | 1.0, 2 | NewtonOptions.refresh | a number in (0, 1)
NewtonOptions(min_damping=_) | 1 | NewtonOptions.min_damping | a number in (0, 1)
NewtonOptions(max_iterations=_) | 0, 2.5 | NewtonOptions.max_iterations | a whole number >= 1
NewtonOptions(inverse=_) | "sparsecholesky" | NewtonOptions.inverse | one of umfpack
simulation(velocity_scale=_) | 0, -1, "1" | TimeSteps.velocity_scale | number > 0
Simulation(_, FINITE, dt=0.1) | "mesh", None | Simulation.mesh | a ngsolve.Mesh
Simulation(small_box(2), _, dt=0.1) | LINEAR | Simulation.model | a ngvisco.Model
simulation(initial=_) | 1.0 | Simulation.initial | a ngvisco.Initial
simulation(discretisation=_) | 2 | Simulation.discretisation | a ngvisco.Discret
simulation(newton=_) | 1e-8 | Simulation.newton | a ngvisco.NewtonOptions
Model(material=_) | None, "steel" | Model.material | a Material
Model(material=LINEAR, viscosity=_) | 1.0 | Model.viscosity | a Viscosity
Model(material=LINEAR, hyperviscosity=_) | 1 | Model.hyperviscosity | a HyperVisc
Model(material=LINEAR, creep=_) | 1.0 | Model.creep | a FlowRule
Model(material=LINEAR, loads=_) | 9.81 | Model.loads | Gravity or BodyForce
loaded(Gravity(_)) | (0, 0, -1), (1,) | loads['gravity'].g | a vector with 2 components, not
loaded(Gravity(_)) | 9.81 | loads['gravity'].g | a vector with 2 components
loaded(Gravity(_)) | (0, nan), "xy" | loads['gravity'].g | finite numbers
loaded(BodyForce(_)) | (1, 2, 3), | loads['body_force'].force | a vector with 2 components, not 3
start(velocity=_) | (1, 0, 0), | Initial.velocity | a vector with 2 components, not 3
start(velocity=_) | (nan, 0), | Initial.velocity | finite numbers
start(velocity=_) | CF(1.0) | Initial.velocity | a vector with 2 components, not 1
start(density=_) | "1", (), True | Initial.density | a number or a scalar
start(density=_) | CF((1, 2)) | Initial.density | scalar
start(F=_) | [1, 0, 0, 1], 1.0 | Initial.F | a 3x3 coefficient function
start(F=_) | Id(2) | Initial.F | 3x3 coefficient function, also in 2D
start(values={"J": _}) | "1" | Initial.values['J'] | a number or a scalar
start(values={"F": _}) | Id(2) | Initial.values['F'] | 3x3
Distortion(_) | "F e", "", 3 | Variable.name | a Python identifier
Distortion(exponent=_) | nan, "1" | Distortion.exponent | a finite number
Cofactor(exponent=_) | inf | Cofactor.exponent | a finite number
IsotropicStrainEnergy(strain_energy=_) | 1.0 | IsotropicStrainEnergy.strain_energy | a function of E
CustomMaterial(transported=[Distortion()], stored_energy=_) | 1.0 | CustomMaterial.stored_energy | a function
box(_, 1.0) | (1, 0), (1,), (1, inf), (1, 1, 1, 1) | box.size | two or three
box((1, 1), _) | 0, -1, inf | box.maxh | a finite number > 0
simulation().run(until=_) | 0.25 | until | a multiple of dt = 0.1
simulation().run(until=_) | -0.1, nan, inf, "1" | until | number >= 0
simulation(scheme="theta", theta=_) | None, 0.49, 1.01, -1, nan, "half", True | TimeSteps.theta | in [1/2, 1]
simulation(scheme="midpoint", theta=_) | 0.6 | TimeSteps.theta | no theta with the scheme 'midpoint'
simulation(scheme="midpoint", relaxation=_) | True | TimeSteps.relaxation | 'midpoint' with adaptive
simulation(scheme="midpoint", relaxation=_) | "yes" | TimeSteps.relaxation | True or False
simulation(scheme="midpoint", startup=_) | -1, 1.5, True | TimeSteps.startup | a whole number >= 0
simulation(scheme=_) | 2 | TimeSteps.scheme | or a TimeScheme
simulation(halvings=_) | -1, 1.5, 21, "two" | TimeSteps.halvings | a whole number from 0 to 20
AdaptiveSteps(dt_min=_, dt_max=1.0) | 0.0 | AdaptiveSteps.dt_min | a finite number > 0
AdaptiveSteps(dt_min=0.1, dt_max=_) | 0.01 | AdaptiveSteps.dt_max | at least dt_min = 0.1
AdaptiveSteps(dt_min=0.1, dt_max=1.0, tolerance=_) | -1.0 | AdaptiveSteps.tolerance | a finite number > 0
AdaptiveSteps(dt_min=0.1, dt_max=1.0, patience=_) | 0 | AdaptiveSteps.patience | a whole number >= 1
"""
OF_LAWS = """\
MooneyRivlin(K_e=1, G_e=1, epsilon=1, G_mr=_) | -1 | MooneyRivlin.G_mr | >= 0
ReferentialNeoHookean(K_e=1, G_e=_) | nan | ReferentialNeoHookean.G_e | a finite number > 0
IsochoricNeoHookean(K_e=1, G_e=1, J_min=_) | 0 | IsochoricNeoHookean.J_min | a finite number > 0
LogarithmicNeoHookean(K_e=1, G_e=1, epsilon=_) | 0 | LogarithmicNeoHookean.epsilon | a finite number > 0
ReferentialMooneyRivlin(K_e=1, G_e=1, G_mr=1, kappa=_) | -1 | ReferentialMooneyRivlin.kappa | >= 0
BarotropicFluid(B=1, gamma=_) | 1 | BarotropicFluid.gamma | a finite number > 1
BarotropicFluid(B=1, gamma=2, form=_) | "rho" | BarotropicFluid.form | one of J, A
HardeningElastic(K_e=1, G_e=1, K_h=1, G_h=1, s=_) | 2 | HardeningElastic.s | a finite number > 2
NeoHookean(K_e=Parameter("theta", start=x), G_e=_, epsilon=0.1) | "5" | NeoHookean.G_e | an expression of
WithQuadratic(material=LINEAR, delta=_) | 0 | WithQuadratic.delta | a finite number > 0
Yosida(material=NEO_HOOKEAN, eps=_) | 0.0, -1.0, nan, inf, "a", None | Yosida.eps | a finite number > 0
Yosida(material=_, eps=1.0) | 3 | Yosida.material | a Material
Damaged(material=LINEAR, length=1, G_c=_) | 0.0 | Damaged.G_c | a finite number > 0
Damaged(material=LINEAR, G_c=1, length=_) | -1.0 | Damaged.length | a finite number > 0
Damaged(material=LINEAR, G_c=1, length=1, healing_viscosity=_) | 0.0 | Damaged.healing_viscosity | > 0
Damaged(material=LINEAR, G_c=1, length=1, viscosity=_) | -1.0 | Damaged.viscosity | a finite number >= 0
Damaged(material=LINEAR, G_c=1, length=1, floor=_) | 1.0 | Damaged.floor | a number in (0, 1)
Damaged(material=LINEAR, G_c=1, length=1, law=_) | "AT3" | Damaged.law | one of AT1, AT2
PerMass(material=BarotropicFluid(B=1, gamma=2), rho_R=_) | 0.0 | PerMass.rho_R | a finite number > 0
PerReferentialVolume(material=_) | 3 | PerReferentialVolume.material | a Material
PerReferentialVolume(material=NEO_HOOKEAN, rho_R=_) | -1.0 | PerReferentialVolume.rho_R | > 0
Thermal(material=LINEAR, c=_, theta_R=300.0) | 0.0, inf | Thermal.c | a finite number > 0
Thermal(material=LINEAR, c=3.0, theta_R=_) | -1.0 | Thermal.theta_R | a finite number > 0
Thermal(material=LINEAR, c=3.0, theta_R=300.0, expansion=_) | -1.0 | Thermal.expansion | a finite number >= 0
Thermal(material=LINEAR, c=3.0, theta_R=300.0, expansion=0.1, gruneisen=_) | 1.0 | Thermal.gruneisen | None
Thermal(material=LINEAR, c=3.0, theta_R=300.0, p_infinity=_) | 1.0 | Thermal.p_infinity | a stiffened gas
Thermal(c=3.0, theta_R=300.0, gruneisen=_) | None | Thermal.gruneisen | which gives the pressure of a gas
Thermal(material=_, c=3.0, theta_R=300.0) | 3 | Thermal.material | a Material
Thermal(material=_, c=3.0, theta_R=300.0) | WARM | Thermal.material | a material without heat
Thermal(material=_, c=3.0, theta_R=300.0) | Yosida(material=LINEAR, eps=1) | Thermal.material | put the Yosida
Heat(conductivity=_) | -1.0, "much" | Heat.conductivity | number >= 0
Heat(conductivity=_) | [[1, 1, 0], [0, 1, 0], [0, 0, 1]] | Heat.conductivity | a symmetric 3x3 matrix
Heat(source=_) | "hot" | Heat.source | a scalar function of the place and the time
WallHeat(temperature=300.0, coefficient=_) | -1.0 | WallHeat.coefficient | a finite number >= 0
WallHeat(temperature=300.0, coefficient=_) | None | WallHeat.coefficient | have to be given together
WallHeat(temperature=_, coefficient=1.0) | 0.0 | WallHeat.temperature | a finite number > 0
WallHeat(flux=_) | nan | WallHeat.flux | a finite number
WallHeat(flux=_) | None | WallHeat.flux | or a share of the friction
WallHeat(friction_share=_) | 1.5 | WallHeat.friction_share | a number in [0, 1]
Creep(G_m=1, nu=_) | -1 | Creep.nu | a finite number >= 0
Creep(G_m=1, q=_) | 1 | Creep.q | a finite number > 1
Creep(G_m=1, q=_) | 3.0 | Creep.q | no effect with nu = 0
Norton(A=1.0, n=3, rate_floor=_) | 1e-3 | Norton.rate_floor | no effect with nu = 0
Norton(A=_, n=3) | -1.0 | Norton.A | a finite number > 0
Norton(A=1.0, n=_) | 0.5, nan | Norton.n | a number from 1 to 10
Norton(A=1.0, n=3, nu=_) | -1.0 | Norton.nu | a finite number >= 0
Norton(A=1.0, n=3, rate_floor=_) | 0.0 | Norton.rate_floor | a finite number > 0
Perzyna(sigma_Y=1.0, G_m=1.0, rate_floor=_) | -1e-3, nan, "1e-3" | Perzyna.rate_floor | a finite number > 0
Perzyna(sigma_Y=_, G_m=1.0) | -1.0 | Perzyna.sigma_Y | a finite number > 0
Perzyna(sigma_Y=1.0, G_m=_) | 0.0 | Perzyna.G_m | a finite number > 0
Perzyna(sigma_Y=1.0, G_m=1.0, n=_) | 20 | Perzyna.n | a number from 1 to 10
Perzyna(sigma_Y=1.0, G_m=1.0, H=_) | -1.0 | Perzyna.H | a finite number >= 0
Perzyna(sigma_Y=1.0, G_m=1.0, Q=1.0, b=_) | 0.0 | Perzyna.b | a finite number > 0
DruckerPrager(cohesion=_, friction_angle=30.0, G_m=1.0) | -1.0 | DruckerPrager.cohesion | >= 0
DruckerPrager(cohesion=1.0, friction_angle=_, G_m=1.0) | 90.0, "30" | DruckerPrager.friction_angle | degrees
Eyring(A=1.0, sigma_0=_) | 0.0 | Eyring.sigma_0 | a finite number > 0
Eyring(A=1.0, sigma_0=1.0, rate_floor=_) | inf | Eyring.rate_floor | a finite number > 0
Activated(rule=_, E=1, theta_R=1) | STOKES | Activated.rule | a FlowRule
Activated(rule=Creep(G_m=1), E=1, theta_R=1, temperature=_) | -3 | Activated.temperature | a finite number > 0
Composite(rules=_) | ((),) | Composite.rules | at least one flow rule
Composite(rules=(Perzyna(sigma_Y=1.0, G_m=1.0, H=_),)) | 1.0 | Composite.rules[0].H | no hardening
Composite(rules=(Creep(G_m=1.0, nu=_),)) | 1.0 | Composite.rules[0].nu | 0 in a sum of flow rules
StokesViscosity(K_v=_, G_v=Parameter("theta", start=x)) | -1.0 | StokesViscosity.K_v | a finite number >= 0
PowerLaw(K_v=1, consistency=_, n=0.5) | 0 | PowerLaw.consistency | a finite number > 0
PowerLaw(K_v=1, consistency=1, n=_) | 0 | PowerLaw.n | a number in (0, 5]
PowerLaw(K_v=1, consistency=1, n=0.5, floor=_) | 0 | PowerLaw.floor | a finite number > 0
Carreau(K_v=1, G_0=1, relaxation=_, n=0.5) | -1 | Carreau.relaxation | a finite number > 0
Carreau(K_v=_, G_0=1, relaxation=1, n=0.5) | -1 | Carreau.K_v | a finite number >= 0
Cross(K_v=1, G_0=1, relaxation=1, m=_) | 1.5 | Cross.m | a number in (0, 1]
ActivatedViscosity(viscosity=_, E=1, theta_R=1) | 3 | ActivatedViscosity.viscosity | a Viscosity
ActivatedViscosity(viscosity=STOKES, E=1, theta_R=_) | 0 | ActivatedViscosity.theta_R | a finite number > 0
HyperViscosity(mu=1, p=_) | Parameter("theta", start=x) | HyperViscosity.p | a finite number > 1
Regularisation(delta_density=_) | -1 | Regularisation.delta_density | a finite number >= 0
Regularisation(rho_max=_) | 0 | Regularisation.rho_max | a finite number > 0
Parameter(_) | "1st" | Variable.name | a Python identifier
Parameter("theta", start=_) | nan | Parameter.start | a finite number or a real scalar function
NavierFriction(_) | -1.0 | NavierFriction.coefficient | a finite number >= 0, or a scalar function
Traction(f=(1, 0), friction=_) | -1.0 | Traction.friction | a finite number >= 0
Open(impedance=_) | (1.0,), (1.0, -1.0), 2.0, ("a", 0.0) | Open.impedance | 2 finite numbers >= 0
Open(stiffness=_) | (1.0,), (1.0, -1.0), 2.0, ("a", 0.0) | Open.stiffness | 2 finite numbers >= 0
CentralGravity(strength=1.0, radius=_) | 0.0 | CentralGravity.radius | a finite number > 0
CentralGravity(strength=1.0, centre=_) | (0.0,), | CentralGravity.centre | two or three finite numbers
"""
OF_PLACES = """\
box(_, 0.5) | (1e200, 1), | box.size | two or three lengths, each a length between
box(_, 0.5) | 1.0, "ab" | box.size | two or three
box((1, 1), 0.5, periodic=_) | "z" | box.periodic | some of x, y
box((1, 1), 0.5, periodic=_) | ["x", "x"] | box.periodic | some of x, y, and none twice
disc(_, 0.5) | -1 | disc.radius | a finite number > 0
disc(_, 1e-7) | 1e-6 | disc.radius | take a smaller unit of length
disc(1, 0.5, order=_) | 11, 2.5 | disc.order | an integer from 1 to 10
annulus(_, 1, 0.5) | 2 | annulus.inner | a number < outer = 1
block_with_hole((1, 1), _, 0.5) | 0.5 | block_with_hole.radius | a number < 0.5
block_with_hole((1, 1), _, 0.5) | 1e-8 | block_with_hole.radius | of the domain's largest length
sphere(_, 1e-4) | 1e-4 | sphere.radius | take a smaller unit of length
sphere(1, 0.5, order=_) | 0 | sphere.order | an integer from 1 to 10
bar(1, 1, 0.5, dim=_) | 1 | bar.dim | 2 or 3
geometries.load(_) | "part.stl" | load.path | a name that ends in .vol, .step, .stp, .brep, .msh
Ball((0, 0), _) | -1.0 | Ball.radius | a finite number > 0
Ball(_, 1.0) | (0,), | Ball.centre | two or three finite numbers
Ball(_, 1.0) | 0.5 | Ball.centre | two or three finite numbers
Block((0, 0), _) | (1, 0), (1, 1, 1) | Block.high | coordinates above those of low
HalfSpace((0, 0), _) | (0, 0), | HalfSpace.normal | a nonzero vector with 2 components
Polygon(_) | ((0, 0), (1, 1)), | Polygon.points | at least three points of two finite numbers
"""


@pytest.mark.parametrize(("make", "value", "field", "expected"), rows(NAMED + OF_LAWS + OF_PLACES))
def test_bad_parameter_is_named_with_its_value(make, value, field, expected):
    value = eval(value, names())
    with pytest.raises(nv.ParameterError) as error:
        made(make, value)
    assert isinstance(error.value, nv.NgviscoError) and isinstance(error.value, ValueError)
    assert error.value.field == field
    assert error.value.value is value or error.value.value == value or isinstance(value, CF)
    assert expected in error.value.expected
    if not isinstance(value, CF):
        assert str(error.value) == f"{field} = {value!r}: expected {error.value.expected}"


LISTS = """\
CustomMaterial(transported=(), stored_energy=_) | lambda: CF(1) | CustomMaterial.variables | at least one
CustomMaterial(transported=TWICE, stored_energy=_) | lambda F: F[0] | CustomMaterial.variables | distinct
CustomMaterial(transported=K, stored_energy=_) | lambda K: -K | CustomMaterial.variables | also 'A', which
Composite(rules=_) | (3,), | Composite.rules | a sequence of FlowRule objects
Heat(conductivity=_) | np.diag([1.0, 1.0, -1.0]) | Heat.conductivity | positive semidefinite
Heat(conductivity=_) | lambda theta: 1 - theta | Heat.conductivity | a function of the temperature
Parameter("theta", start=_) | PAIR | Parameter.start | a real scalar function
StokesViscosity(K_v=_, G_v=1.0) | PAIR | StokesViscosity.K_v | a function of the initial place
box(_, 0.5) | (1, 1e-8), | box.size | at least 1e-06 of the domain's largest length
annulus(1, _, 0.5) | 1 + 1e-9 | annulus.thickness | at least 1e-06 of the domain's largest length
Polygon(_) | ((0, 0), (2, 0), (2, 1), (3, 0), (1, 0), (1, -1)), | Polygon.points | edges 1 and 4 overlap
Polygon(_) | ((0, 0), (2, 0), (1, 0), (1, 1)), | Polygon.points | edges 1 and 2 overlap
Polygon(_) | ((0, 0), (1, 1), (1, 0), (0, 1)), | Polygon.points | but edges 1 and 3 cross
Polygon(_) | ((0, 0), (0, 0), (1, 0), (0, 1)), | Polygon.points | none of which equals the point before it
Union(_) | ((),) | Union.shapes | at least one shape
Union((Ball((0, 0), 1.0), _)) | 3 | Union.shapes | a sequence of Shape objects
Where(_) | PAIR | Where.function | scalar
"""


@pytest.mark.parametrize(("make", "value", "field", "expected"), rows(LISTS))
def test_a_bad_list_is_refused_with_the_name_of_its_argument(make, value, field, expected):
    with pytest.raises(nv.ParameterError) as error:
        made(make, eval(value, names()))
    assert error.value.field == field and expected in error.value.expected


INITIAL = """\
start(density=_) | 0.0, x - 0.3 | density rho_0 | > 0
start(density=_) | nan, NAN_HALF | density rho_0 | finite
start(F=_) | REFLECTION, x * Id(3) | det F_0 | > 0
start(F=_) | NAN_HALF * Id(3) | det F_0 | finite
start(F=_) | OUT_OF_PLANE | F_0 | plane strain
start(ELASTIC, F=_) | OUT_OF_PLANE | E_0 | plane strain
start(ELASTIC, values={"E": _}) | NOT_SYMMETRIC | E_0 | symmetric
start(ELASTIC, values={"E": _}) | NAN_HALF * Id(3) | E_0 | finite
start(values={"J": _}) | -1 | projected J_0 | > 0
start(values={"J": _}) | nan | material variables | finite
start(velocity=_) | (NAN_HALF, 0), | |v_0|^2 | finite
start(Model(material=_)) | without_energy() | stored energy | finite
start(DISC_IN_BOX, values={"B_disc": _}) | Id(3) | B_disc_0 | times the body's amount
"""


@pytest.mark.parametrize(("make", "value", "field", "expected"), rows(INITIAL))
def test_bad_initial_data_are_named(make, value, field, expected):
    with pytest.raises(nv.InitialDataError) as error:
        made(make, eval(value, names()))
    assert error.value.field == field
    assert expected in error.value.expected
    assert str(error.value).startswith(f"initial {field}: ")


def test_tensor_of_a_body_may_be_given_where_the_body_is():
    share, _ = fractions(simulation().mesh, [DISC], 1)
    given = simulation(DISC_IN_BOX, initial=nv.Initial(values={"B_disc": share * Id(3)}))
    default = simulation(DISC_IN_BOX)
    assert np.allclose(given.rothe_step.state.vec.FV(), default.rothe_step.state.vec.FV(), atol=1e-12)


def test_sharp_interfaces_refuse_a_tensor_whose_determinant_they_would_change():
    share, _ = fractions(simulation().mesh, [DISC], 1)
    tensors = [share * CF((2, 0, 0, 0, 0.5, 0, 0, 0, 1), dims=(3, 3)), 1.1 * share * Id(3)]
    starts = [nv.Initial(values={"B_disc": tensor}) for tensor in tensors]
    sharp = {"discretisation": nv.Discretisation(m=1, sharp=True)}
    simulation(DISC_IN_BOX, initial=starts[0], **sharp)
    with pytest.raises(nv.InitialDataError, match=r"initial B_disc_0: .* determinant that follows from F"):
        simulation(DISC_IN_BOX, initial=starts[1], **sharp)


@pytest.mark.parametrize(("name", "nearest"), [("dtt", "dt"), ("observer", "observers"), ("wals", "walls")])
def test_wrong_keyword_of_a_simulation_suggests_the_nearest(name, nearest):
    with pytest.raises(TypeError, match=f"unknown keyword argument '{name}'; did you mean '{nearest}'"):
        simulation(**{name: 1})


TYPED = """\
simulation(adaptive=_) | 1, "a", {}, AdaptiveSteps
simulation(walls=_) | 1, "top", NoSlip(), {"top": 1}, {1: NoSlip()}, {"top": None}, [NoSlip()], [("top",)]
simulation(walls=_) | {"top": NoSlip}, {("top", 1): NoSlip()}
simulation(observers=_) | 1, None, "a", [1], [Progress], Progress(until=1), {"a": 1}
simulation().run(0.2, _) | 1, None, "a", ["a"], [None], [nan], {"a": 1}
simulation(passive=_) | 1, None, "F_tot", ["a"], [1]
simulation(sources=_) | 1, "a"
simulation(solver=_) | 1, "a", True, ["split"]
simulation(dt=_) | "a", None, [1], np.array([0.1]), 1j, True
simulation().run(_) | "a", None, [0.2], np.array([0.1])
simulation(velocity_scale=_) | "a", [1], 0, inf
start(density=_) | "1", [1]
start(velocity=_) | 1, "ab", (1,), {"x": 1}, (None, 1)
start(F=_) | 1, [[1, 0], [0, 1]], np.eye(2), "I"
start(values=_) | 1, {"J": "a"}, {"Q": 1}, {"F": np.eye(2)}, [1]
Model(material=LINEAR, loads=_) | 1, None, "a", [1], [Gravity], Gravity((0, 1))
loaded(_) | Gravity((0, "1")), Gravity(1), Gravity(None), BodyForce({"a": 1}), Gravity((0, 1 / (x - x)))
loaded(Gravity((0, 1), name=_)) | "", "a b", 3, "wall_top"
CentralGravity(strength=1.0, **_) | {"centre": 1}, {"centre": "ab"}, {"centre": (1,)}, {"radius": "a"}
CentralGravity(strength=1.0, exponent=_) | None
simulation(walls={"top": NavierFriction(_)}) | x - 0.5
simulation(walls={"top": Traction(f=_)}) | 1, (1, "a"), (NAN_HALF, 0)
simulation(walls={"top": PrescribedTangential(_)}) | 1, (0, 1), "ab"
simulation(Model(material=WARM, heat=Heat(source=_))) | sqrt(x - 0.5)
simulation(Model(material=WARM, heat=Heat()), walls={"top": Slip(heat=WallHeat(flux=_))}) | sqrt(x - 0.5)
simulation(Model(material=WARM), walls={"top": Slip(heat=WallHeat(temperature=_, coefficient=1.0))}) | x - 0.5
simulation(Model(material=WARM), walls={"top": Slip(heat=WallHeat(temperature=1.0, coefficient=_))}) | x - 0.5
NavierFriction(_) | None, "a", -1, [1], nan
Simulation(_, ELASTIC, dt=0.1) | None, "a", small_box(2).ngmesh
AdaptiveSteps(dt_min=_, dt_max=1.0) | "a", None
AdaptiveSteps(dt_min=0.1, dt_max=1.0, tolerance=_) | "a"
AdaptiveSteps(dt_min=0.1, dt_max=1.0, patience=_) | 1.5, "a", 0
Checkpoints("unused.h5", **_) | {"every": 0}, {"every": "a"}, {"keep": 1.5}, {"every": True}
Checkpoints(_) | None, 3
VTKSeries("unused", **_) | {"every": 0}, {"subdivision": -1}, {"subdivision": "a"}
VTKSeries("unused", times=_) | 1, ["a"]
VTKSeries("unused", fields=_) | "J", 1
VTKSeries(_) | None
Progress(_) | None, "a", -1
Progress(1, every=_) | "a"
refine_walls(box((1, 1), 1), _) | None, 1, ["a"]
refine_walls(box((1, 1), 1), "top", _) | -1, "a"
box((1, 1), 1, refine=_) | 1, {"top": "a"}
box((1, 1), 1, periodic=_) | "q", 1
box((1, 1), _) | None
box(_, 1) | None, {"a": 1, "b": 2}
disc(_, 1) | "a"
bar(1, 1, 1, dim=_) | 4, "a"
channel(1, _, 1) | None
geometries.load(_) | None, 3
Regularisation(**_) | {"epsilon": "a"}, {"delta_density": -1}, {"rho_max": "a"}, {"rho_max": 0}
NeoHookean(K_e=10, G_e=5, epsilon=0.1, kappa=_) | "a", -1
NeoHookean(K_e=_, G_e=5, epsilon=0.1) | [1], PAIR
NeoHookean(K_e=10, G_e=5, epsilon=0.1, J_min=_) | "a", -1
BarotropicFluid(B=1, gamma=_) | 1
BarotropicFluid(B=1, gamma=1.4, form=_) | "Q", 1
Yosida(material=_, eps=1) | 1
WithQuadratic(material=LINEAR, delta=1, only=_) | "E2", 1
WithQuadratic(material=LINEAR, delta=_) | "a"
NewtonOptions(**_) | {"tolerance": "a"}, {"max_iterations": "a"}, {"max_iterations": True}, {"inverse": 1}
NewtonOptions(**_) | {"inverse": "mumps"}, {"method": 1}, {"coarse": 1}, {"refresh": None}
Discretisation(**_) | {"k": "2"}, {"k": None}, {"m": 1.5}, {"quadrature_bonus": None}, {"k": [2]}
check_convexity(LINEAR, **_) | {"dim": 1}, {"dim": "a"}, {"spread": "a"}, {"seed": "a"}
check_convexity(_) | 1
simulation().restore(_) | None, 3, "/nonexistent"
nv.load(_) | None, 3, "/nonexistent"
load_case(_) | None, "/nonexistent"
simulation().ledger.column(_) | None, 3, "a"
"""


@pytest.mark.parametrize(("make", "value"), rows(TYPED))
def test_a_wrong_input_is_refused_by_a_typed_error(make, value):
    with pytest.raises(nv.NgviscoError) as error:
        made(make, eval(value, names()))
    assert re.search("expected|known|does not exist|not a run|cannot be read", str(error.value))


NUMPY = """\
simulation(dt=np.float32(0.1)).run(np.float32(0.1))
simulation(dt=np.array(0.1)).run(np.array(0.2), stops=np.array([0.1]))
simulation(Model(material=NeoHookean(K_e=np.int64(10), G_e=np.float32(5), epsilon=np.array(0.1)))).run(0.1)
simulation(Model(material=LINEAR, viscosity=StokesViscosity(K_v=np.int32(1), G_v=np.float64(1)))).run(0.1)
simulation(Model(material=LINEAR, creep=Creep(G_m=np.array(5)))).run(0.1)
simulation(Model(material=LINEAR, hyperviscosity=HyperViscosity(mu=np.float32(1e-3), p=np.int64(4)))).run(0.1)
simulation(discretisation=Discretisation(k=np.int64(2), m=np.array(1))).run(0.1)
start(velocity=np.array([0.0, 0.0]), density=np.float32(2)).run(0.1)
start(velocity=np.matrix([0.0, 0.0])).run(0.1)
start(velocity=np.matrix([[0], [0]])).run(0.1)
start(F=np.diag([1.1, 1, 1])).run(0.1)
start(F=np.matrix(np.eye(3))).run(0.1)
start(F=[[1, 0, 0], [0, 1 + 0.1 * x, 0], [0, 0, 1]]).run(0.1)
loaded(Gravity(np.array([0, -1])), BodyForce(np.float32([0, 1]))).run(0.1)
loaded(CentralGravity(strength=np.float32(1), centre=np.array([-1, 0]), exponent=np.int64(0))).run(0.1)
box(np.array([1, 1]), np.float32(0.5), refine={"top": np.float64(0.2)})
bar(np.int64(2), np.float32(1), 1, dim=np.int64(2))
simulation(adaptive=AdaptiveSteps(dt_min=np.float32(0.01), dt_max=np.int64(1), patience=np.int64(2))).run(0.1)
simulation(newton=NewtonOptions(tolerance=np.float64(1e-9), max_iterations=np.int32(30))).run(0.1)
simulation(walls={"top": NavierFriction(np.int64(1))}).run(0.1)
simulation(walls={"left": Traction(f=np.array([0, 1.0]), friction=np.float32(0.1))}).run(0.1)
simulation(walls={"bottom": PrescribedTangential(np.array([1, 0]))}).run(0.1)
simulation(velocity_scale=np.float32(1)).run(0.1)
Checkpoints("unused.h5", every=np.int64(2), keep=np.int32(1))
check_convexity(LINEAR, dim=np.int64(2), spread=np.float32(0.3), seed=np.int64(1))
"""


@pytest.mark.filterwarnings("ignore:the matrix subclass:PendingDeprecationWarning")
@pytest.mark.parametrize("text", NUMPY.splitlines())
def test_numbers_and_arrays_of_numpy_are_accepted(text):
    eval(text, names())


def test_unknown_names_are_refused_with_the_known_names_or_the_nearest_name():
    with pytest.raises(nv.UnknownNameError, match=r"unknown material variable 'E' \(known: F, J\)") as error:
        start(values={"E": Id(3)})
    assert isinstance(error.value, KeyError)
    with pytest.raises(nv.UnknownNameError, match="unknown ledger column 'kinetik'; did you mean 'kinetic'"):
        simulation().ledger.column("kinetik")


def test_two_loads_of_one_name_are_refused_and_the_second_is_reported():
    with pytest.raises(nv.ParameterError, match=r"loads\[1\].name = 'gravity': .*column power_gravity"):
        nv.Model(material=LINEAR, loads=[nv.Gravity((0, 1)), nv.Gravity((1, 0))])


def test_the_end_time_may_miss_a_multiple_of_the_step_by_rounding():
    """In floating point 0.1 * 3 is not 0.3, but it is three steps."""
    ledger = simulation(ELASTIC).run(until=0.1 * 3)
    assert len(ledger.rows) == 4 and ledger.rows[-1]["time"] == 3 * 0.1


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"initial": nv.Initial(density=1 + z)}, "Initial.density"),
        ({"initial": nv.Initial(velocity=(z, 0))}, "Initial.velocity"),
        ({"initial": nv.Initial(values={"J": 1 + z})}, r"Initial.values\['J'\]"),
        ({"walls": {"top": nv.Open(pressure=z)}}, r"walls\['top'\].pressure"),
        ({"walls": {"top": nv.Traction(f=(z, 0))}}, r"walls\['top'\].f"),
        ({"model": nv.Model(material=NEO_HOOKEAN, loads=[nv.Gravity((0, -z))])}, r"loads\['gravity'\].g"),
        ({"model": nv.Model(material=nv.NeoHookean(K_e=1, G_e=1 + z, epsilon=1))}, "NeoHookean.G_e"),
        ({"model": nv.Model(bodies=[of("a", 0.5 - z), of("b", None)])}, "Where.function"),
        ({"observers": [nv.Integrals({"a": "z*density"})]}, r"Integrals.integrands\['a'\]"),
    ],
    ids=["density", "velocity", "value", "pressure", "traction", "load", "modulus", "body", "integral"],
)
def test_a_function_of_z_is_refused_in_the_plane(options, field):
    """NGSolve's z is 0 on a mesh of two dimensions."""
    with pytest.raises(ParameterError, match=rf"^{field} = .*x and y, since a mesh in the plane has no z"):
        simulation(**options).run(0.1)


TIMES = {"late": (5, 6), "over": (-3, -1), "within": (0.05, 6), "around": (-1, 1)}


@pytest.mark.parametrize("where", ["load", "wall"])
@pytest.mark.parametrize("name", [*TIMES, "late step", "step at the start"])
def test_a_function_of_time_that_the_run_does_not_reach_is_warned_of(name, where, recwarn):
    steps = {"late step": nv.step(3.0), "step at the start": nv.step(0.0)}
    given = steps[name] if name in steps else nv.table(TIMES[name], (0, 1))
    loads = [nv.Gravity((0, given))] if where == "load" else []
    walls = {"top": nv.Open(pressure=given)} if where == "wall" else {}
    run = simulation(nv.Model(material=NEO_HOOKEAN, viscosity=STOKES, loads=loads), walls=walls)
    run.check_data(0.1)
    said = [str(w.message) for w in recwarn if "the run is from 0 to 0.1 s; give times" in str(w.message)]
    assert bool(said) == (name in ("late", "over", "late step"))
    assert all("gravity" in text or "walls['top'].pressure" in text for text in said)
