"""Bad input: a typed error that names the field, the value and what is right."""

import math
from collections.abc import Callable

import pytest
from ngsolve import CF, Id, log, x
from support import LINEAR, NEO_HOOKEAN, small_box

from ngvisco import (
    BodyForce,
    Creep,
    CustomMaterial,
    Discretisation,
    Gravity,
    HyperViscosity,
    Initial,
    InitialDataError,
    IsotropicStrainEnergy,
    LinearElastic,
    Model,
    NeoHookean,
    NewtonOptions,
    NgviscoError,
    ParameterError,
    Simulation,
    StokesViscosity,
    UnknownNameError,
)
from ngvisco.geometries import box
from ngvisco.physics.variables import Cofactor, Distortion, Jacobian, LogJacobian

ELASTIC = Model(material=LINEAR)
FINITE = Model(material=NEO_HOOKEAN)


def simulation(model: Model = FINITE, **options) -> Simulation:
    return Simulation(small_box(2), model, **{"dt": 0.1, **options})


def starting(model: Model = FINITE, **initial) -> Callable[[], Simulation]:
    return lambda: simulation(model, initial=Initial(**initial))


def loaded(load) -> Callable[[], Simulation]:
    return lambda: simulation(Model(material=LINEAR, loads=(load,)))


NOT_POSITIVE = (0, -1.0, math.nan, math.inf, "1", None, True)
POSITIVE = "a finite number > 0"
PARAMETERS = {
    **{
        f"{field} = {bad!r}": (make, field, bad, POSITIVE)
        for field, of in {
            "LinearElastic.K_e": lambda v: LinearElastic(K_e=v, G_e=1.0),
            "LinearElastic.G_e": lambda v: LinearElastic(K_e=1.0, G_e=v),
            "NeoHookean.K_e": lambda v: NeoHookean(K_e=v, G_e=1.0, epsilon=1.0),
            "NeoHookean.G_e": lambda v: NeoHookean(K_e=1.0, G_e=v, epsilon=1.0),
            "NeoHookean.epsilon": lambda v: NeoHookean(K_e=1.0, G_e=1.0, epsilon=v),
            "HyperViscosity.mu": lambda v: HyperViscosity(mu=v),
            "HyperViscosity.penalty": lambda v: HyperViscosity(mu=1.0, penalty=v),
            "HyperViscosity.floor": lambda v: HyperViscosity(mu=1.0, floor=v),
            "TimeSteps.dt": lambda v: simulation(dt=v),
            "NewtonOptions.tolerance": lambda v: NewtonOptions(tolerance=v),
        }.items()
        for bad in NOT_POSITIVE
        for make in [lambda of=of, bad=bad: of(bad)]
    },
    **{
        f"{field} = {bad!r}": (make, field, bad, expected)
        for field, of, bads, expected in (
            (
                "HyperViscosity.p",
                lambda v: HyperViscosity(mu=1, p=v),
                (1, 0.5, math.nan),
                "a finite number > 1",
            ),
            ("HyperViscosity.mu_1", lambda v: HyperViscosity(mu=1, mu_1=v), (-1, math.inf), "number >= 0"),
            (
                "StokesViscosity.K_v",
                lambda v: StokesViscosity(K_v=v, G_v=1),
                (-1e-9, math.nan),
                "number >= 0",
            ),
            (
                "StokesViscosity.G_v",
                lambda v: StokesViscosity(K_v=1, G_v=v),
                (-1e-9, math.nan),
                "number >= 0",
            ),
            ("Creep.G_m", lambda v: Creep(G_m=v), (0, -1, math.nan), POSITIVE),
            ("Creep.R", Creep.from_reciprocal, (-1, math.nan, math.inf), "a finite number >= 0"),
            ("Discretisation.k", lambda v: Discretisation(k=v), (1, 4, 2.0, "2"), "one of 2, 3"),
            ("Discretisation.m", lambda v: Discretisation(m=v), (-1, 3, True, 1.0), "one of 0, 1, 2"),
            (
                "Discretisation.quadrature_bonus",
                lambda v: Discretisation(quadrature_bonus=v),
                (-1, 0.5),
                "one of 0, 1",
            ),
            ("NewtonOptions.refresh", lambda v: NewtonOptions(refresh=v), (1.0, 2), "a number in (0, 1)"),
            ("NewtonOptions.min_damping", lambda v: NewtonOptions(min_damping=v), (1,), "a number in (0, 1)"),
            (
                "NewtonOptions.max_iterations",
                lambda v: NewtonOptions(max_iterations=v),
                (0, 2.5),
                "integer >= 1",
            ),
            (
                "NewtonOptions.inverse",
                lambda v: NewtonOptions(inverse=v),
                ("sparsecholesky",),
                "one of umfpack",
            ),
            ("TimeSteps.velocity_scale", lambda v: simulation(velocity_scale=v), (0, -1, "1"), "number > 0"),
            ("Simulation.mesh", lambda v: Simulation(v, FINITE, dt=0.1), ("mesh", None), "a ngsolve.Mesh"),
            ("Simulation.model", lambda v: Simulation(small_box(2), v, dt=0.1), (LINEAR,), "a ngvisco.Model"),
            ("Simulation.initial", lambda v: simulation(initial=v), (1.0,), "a ngvisco.Initial"),
            ("Simulation.discretisation", lambda v: simulation(discretisation=v), (2,), "a ngvisco.Discret"),
            ("Simulation.newton", lambda v: simulation(newton=v), (1e-8,), "a ngvisco.NewtonOptions"),
            ("Model.material", lambda v: Model(material=v), (None, "steel"), "a Material"),
            ("Model.viscosity", lambda v: Model(material=LINEAR, viscosity=v), (1.0,), "a StokesViscosity"),
            ("Model.hyperviscosity", lambda v: Model(material=LINEAR, hyperviscosity=v), (1,), "a HyperVisc"),
            ("Model.creep", lambda v: Model(material=LINEAR, creep=v), (1.0,), "a Creep"),
            ("Model.loads", lambda v: Model(material=LINEAR, loads=v), (9.81,), "Gravity or BodyForce"),
            (
                "loads['gravity'].g",
                lambda v: loaded(Gravity(v))(),
                ((0, 0, -1), (1,)),
                "a vector of length 2, not",
            ),
            ("loads['gravity'].g", lambda v: loaded(Gravity(v))(), (9.81,), "a vector of length 2"),
            ("loads['gravity'].g", lambda v: loaded(Gravity(v))(), ((0, math.nan), "xy"), "finite numbers"),
            (
                "loads['body_force'].force",
                lambda v: loaded(BodyForce(v))(),
                ((1, 2, 3),),
                "a vector of length 2, not 3",
            ),
            (
                "Initial.velocity",
                lambda v: starting(velocity=v)(),
                ((1, 0, 0),),
                "a vector of length 2, not 3",
            ),
            ("Initial.velocity", lambda v: starting(velocity=v)(), ((math.nan, 0),), "finite numbers"),
            ("Initial.density", lambda v: starting(density=v)(), ("1", (), True), "a number or a scalar"),
            ("Initial.F", lambda v: starting(F=v)(), ([1, 0, 0, 1], 1.0), "a 3x3 coefficient function"),
            ("Initial.values['J']", lambda v: starting(values={"J": v})(), ("1",), "a number or a scalar"),
            ("Variable.name", Distortion, ("F e", "", 3), "a Python identifier"),
            ("Distortion.exponent", lambda v: Distortion(exponent=v), (math.nan, "1"), "a finite number"),
            ("Cofactor.exponent", lambda v: Cofactor(exponent=v), (math.inf,), "a finite number"),
            (
                "IsotropicStrainEnergy.strain_energy",
                lambda v: IsotropicStrainEnergy(strain_energy=v),
                (1.0,),
                "a function of E",
            ),
            (
                "CustomMaterial.stored_energy",
                lambda v: CustomMaterial(transported=(Distortion(),), stored_energy=v),
                (1.0,),
                "a function of the variables",
            ),
            ("box.size", lambda v: box(v, 1.0), ((1, 0), (1,), (1, math.inf), (1, 1, 1, 1)), "two or three"),
            ("box.maxh", lambda v: box((1, 1), v), (0, -1, math.inf), POSITIVE),
            ("until", lambda v: simulation().run(until=v), (0.25,), "a multiple of dt = 0.1"),
            ("until", lambda v: simulation().run(until=v), (-0.1, math.nan, math.inf, "1"), "number >= 0"),
        )
        for bad in bads
        for make in [lambda of=of, bad=bad: of(bad)]
    },
}


@pytest.mark.parametrize("make, field, value, expected", PARAMETERS.values(), ids=PARAMETERS)
def test_bad_parameter_is_named_with_its_value(make, field: str, value: object, expected: str) -> None:
    with pytest.raises(ParameterError) as error:
        make()
    assert isinstance(error.value, NgviscoError) and isinstance(error.value, ValueError)
    assert error.value.field == field
    assert error.value.value is value or error.value.value == value
    assert expected in error.value.expected
    assert str(error.value) == f"{field} = {value!r}: expected {error.value.expected}"


@pytest.mark.parametrize(
    "make, field, expected",
    [
        (starting(density=CF((1, 2))), "Initial.density", "scalar"),
        (starting(F=Id(2)), "Initial.F", "3x3 coefficient function, also in 2D"),
        (starting(values={"F": Id(2)}), "Initial.values['F']", "3x3"),
        (starting(velocity=CF(1.0)), "Initial.velocity", "a vector of length 2, not 1"),
        (
            lambda: Model(material=LINEAR, loads=(Gravity((0, 1)), Gravity((1, 0)))),
            "Model.loads",
            "distinct names",
        ),
        (
            lambda: CustomMaterial(transported=(), stored_energy=lambda: CF(1.0)),
            "CustomMaterial.variables",
            "at least one variable",
        ),
        (
            lambda: CustomMaterial(transported=(Distortion(), Distortion()), stored_energy=lambda F: F[0]),
            "CustomMaterial.variables",
            "distinct names",
        ),
        (
            lambda: CustomMaterial(transported=(LogJacobian(),), stored_energy=lambda K: -K),
            "CustomMaterial.variables",
            "'A' too: the rate of 'K' reads it",
        ),
    ],
)
def test_bad_shape_or_list_is_named(make: Callable[[], object], field: str, expected: str) -> None:
    with pytest.raises(ParameterError) as error:
        make()
    assert error.value.field == field and expected in error.value.expected


REFLECTION = CF((-1, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
OUT_OF_PLANE = CF((1, 0, 0.5, 0, 1, 0, 0, 0, 1), dims=(3, 3))
NOT_A_NUMBER = log(x - 0.5)
INITIAL = {
    "density 0": (starting(density=0.0), "density rho_0", "> 0"),
    "density negative somewhere": (starting(density=x - 0.3), "density rho_0", "> 0"),
    "density NaN": (starting(density=math.nan), "density rho_0", "finite"),
    "density NaN somewhere": (starting(density=NOT_A_NUMBER), "density rho_0", "finite"),
    "reflection": (starting(F=REFLECTION), "det F_0", "> 0"),
    "det F_0 = 0 somewhere": (starting(F=x * Id(3)), "det F_0", "> 0"),
    "F NaN": (starting(F=NOT_A_NUMBER * Id(3)), "det F_0", "finite"),
    "F out of plane": (starting(F=OUT_OF_PLANE), "F_0", "plane strain"),
    "E out of plane": (starting(ELASTIC, F=OUT_OF_PLANE), "E_0", "plane strain"),
    "E not symmetric": (
        starting(ELASTIC, values={"E": CF((0, 1, 0, 0, 0, 0, 0, 0, 0), dims=(3, 3))}),
        "E_0",
        "symmetric",
    ),
    "E NaN": (starting(ELASTIC, values={"E": NOT_A_NUMBER * Id(3)}), "E_0", "finite"),
    "J negative": (starting(values={"J": -1}), "projected J_0", "> 0"),
    "J NaN": (starting(values={"J": math.nan}), "material variables", "finite"),
    "velocity NaN": (starting(velocity=(NOT_A_NUMBER, 0)), "|v_0|^2", "finite"),
    "energy NaN": (
        starting(
            Model(
                material=CustomMaterial(
                    transported=(Distortion(), Jacobian()), stored_energy=lambda F, J: log(F[0, 0] - 2) + J
                )
            )
        ),
        "stored energy",
        "finite",
    ),
}


@pytest.mark.parametrize("make, field, expected", INITIAL.values(), ids=INITIAL)
def test_bad_initial_data_are_named(make: Callable[[], object], field: str, expected: str) -> None:
    with pytest.raises(InitialDataError) as error:
        make()
    assert error.value.field == field
    assert expected in error.value.expected
    assert str(error.value).startswith(f"initial {field}: ")


def test_unknown_variable_is_named_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown material variable 'E' \(known: F, J\)") as error:
        starting(values={"E": Id(3)})()
    assert isinstance(error.value, KeyError)


def test_unknown_ledger_column_is_named_with_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="unknown ledger column 'kinetik'; did you mean 'kinetic'"):
        simulation().ledger.column("kinetik")


def test_until_may_miss_a_multiple_by_rounding() -> None:
    """0.1 * 3 is not 0.3 in floating point; it is three steps."""
    ledger = simulation(ELASTIC).run(until=0.1 * 3)
    assert len(ledger.rows) == 4 and ledger.rows[-1]["time"] == 3 * 0.1
