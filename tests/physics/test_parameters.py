"""Parameters carried with the matter: their expressions, and operations that concern strains alone."""

import operator
from functools import partial

import ngsolve
import numpy as np
import pytest
from ngsolve import CF, L2, GridFunction, x, y

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.physics.arrays import Array
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian

theta, chi = nv.Parameter("theta", start=x), nv.Parameter("chi", start=0.3)


def test_an_expression_of_parameters_has_the_value_of_its_formula():
    expression = 2 - (3 * theta + 1) / chi**2 + -theta * 0.5
    at = {"theta": 0.7, "chi": 1.2}
    assert expression.at(at) == pytest.approx(2 - (3 * 0.7 + 1) / 1.2**2 - 0.35, rel=1e-15)
    assert expression.parameters == (theta, chi)
    assert repr(1 + 4 * theta) == "(1.0 + (4.0 * theta))"
    assert theta.typical == 0.5 and chi.typical == 0.3


def test_a_modulus_may_contain_a_parameter_of_ngsolve():
    known = ngsolve.Parameter(2.0)
    assert nv.StokesViscosity(K_v=1.0, G_v=x * known).G_v.parameters[0].start is not None


@pytest.mark.parametrize("combine", [operator.add, operator.sub, operator.mul, operator.truediv])
def test_a_parameter_does_not_combine_with_a_function_of_the_place(combine):
    known = GridFunction(L2(box((1, 1), 1.0)))
    for place in (x, 1 + x * y, known, CF((x, y))):
        for left in (theta, 1 + theta):
            with pytest.raises(nv.ParameterError, match=r"written as nv.Parameter\(name, start=...\)"):
                combine(left, place)
            # NGSolve raises this error
            with pytest.raises(TypeError, match="incompatible function arguments"):
                combine(place, left)


def custom(energy=None):
    def by_default(F, J, theta):
        return (1 + theta) * square(F) + 5 * (J - 1) * (J - 1)

    return nv.CustomMaterial(
        transported=(Distortion(), Jacobian(), theta), stored_energy=energy or by_default
    )


def test_a_custom_energy_that_reads_a_parameter_which_is_not_transported_is_told_how_to_read_it():
    theta = nv.Parameter("theta", start=1.0)

    def energy(F, J):
        return (3 + theta) * square(F) / J ** (2 / 3) + 4 * (J + 1 / J)

    def with_argument(F, J, theta):
        return (3 + theta) * square(F) / J ** (2 / 3) + 4 * (J + 1 / J)

    strains = (Distortion(), Jacobian())
    for law, message in [(energy, "CustomMaterial.transported"), (with_argument, "names of transported")]:
        with pytest.raises(nv.ParameterError, match=message):
            nv.CustomMaterial(transported=strains, stored_energy=law)
    assert nv.CustomMaterial(transported=(*strains, theta), stored_energy=with_argument)


def test_two_parameters_of_one_name_are_refused_in_any_place():
    """A parameter must not have the name of a variable of the material either. One parameter may appear in
    many places."""
    one, five = nv.Parameter("chi", start=1 + x), nv.Parameter("chi", start=5 + x)

    def material(parameter):
        def energy(J, chi):
            return J - 2 + (1 + chi) / J

        return nv.CustomMaterial(transported=(Jacobian(), parameter), stored_energy=energy)

    def bodies(first, second, G_v=1.0):
        viscosity = nv.StokesViscosity(K_v=1.0, G_v=G_v)
        disc = nv.Body(name="disc", where=x, material=material(first), density=1.0, viscosity=viscosity)
        return [disc, nv.Body(name="rest", material=material(second), density=1.0)]

    def of_one_material(parameter):
        viscosity = nv.StokesViscosity(K_v=0.1, G_v=parameter)
        return nv.Model(material=material(one), viscosity=viscosity)

    of_bodies = (
        partial(nv.Model, bodies=bodies(one, five)),
        partial(nv.Model, bodies=bodies(one, one, G_v=five)),
    )
    for make in (*of_bodies, partial(of_one_material, five)):
        with pytest.raises(nv.ParameterError, match="'chi': expected a name that no other parameter has"):
            make()
    assert [v.name for v in of_one_material(one).material.variables] == ["J", "chi"]
    carried = [v for v in nv.Model(bodies=bodies(one, one, G_v=one)).material.variables if v.name == "chi"]
    assert carried == [one] and carried[0].start is one.start


@pytest.mark.parametrize("name", ["disc", "G", "G_e"])
def test_names_of_a_body_s_parameters_get_the_prefix_of_the_body_once(name):
    """Names get the prefix of the body once, also if the modulus has a name with the same beginning, or if a
    second model is made of the bodies."""
    material = nv.ReferentialNeoHookean(K_e=1.0, G_e=1 + x)
    body = nv.Body(name=name, where=0.5 - x, material=material, density=1.0)
    rest = nv.Body(name="rest", material=material, density=1.0)
    model = nv.Model(bodies=[body, rest])
    for same in (model, nv.Model(bodies=model.bodies)):
        parameters = [v.name for v in same.material.variables if isinstance(v, nv.Parameter)]
        assert parameters == [f"{name}_G_e", "rest_G_e"]


def test_convexity_is_required_in_the_strains_at_fixed_parameters():
    """(1 + theta) |F|^2 is not jointly convex in (F, theta), but is convex in F for every theta > -1."""
    assert nv.check_convexity(custom(), warn=False).passed
    negative = np.array([[1.0] * 10 + [-3.0]])  # a state with theta < -1, for which the energy is concave
    assert not nv.check_convexity(custom(), warn=False, states=negative).passed
    with_concave = custom(lambda F, J, theta: square(F) + theta * (J - 1) * (J - 1) - 2 * theta * J * J * J)
    assert not nv.check_convexity(with_concave, warn=False).passed


def names(model):
    return [variable.name for variable in model.material.variables]


def arrhenius(start, of_creep=None):
    stokes, linear = nv.StokesViscosity(K_v=1.0, G_v=1.0), nv.Creep(G_m=1.0)
    viscosity = nv.ActivatedViscosity(viscosity=stokes, E=1e4, theta_R=300.0, temperature=start)
    creep = nv.Activated(rule=linear, E=2e4, theta_R=300.0, temperature=of_creep)
    return {"viscosity": viscosity, "creep": creep}


def test_laws_share_a_carried_parameter_if_they_are_given_the_same_function():
    solid = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F")
    start = 300 + 10 * x
    assert names(nv.Model(material=solid, **arrhenius(start, start))) == ["F", "J", "temperature"]
    both = nv.Model(material=solid, **arrhenius(start, 300 + 10 * y))
    assert names(both) == ["F", "J", "temperature", "temperature_2"]
    rules = nv.Composite(rules=(nv.Norton(A=0.1 + x, n=3), nv.Norton(A=0.2 + y, n=1)))
    assert names(nv.Model(material=solid, creep=rules)) == ["F", "J", "A", "A_2"]
    body = {"material": nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0), "creep": rules, "density": 1.0}
    bodies = [nv.Body(name="a", where=nv.Ball((0.5, 0.5), 0.2), **body), nv.Body(name="b", **body)]
    assert names(nv.Model(bodies=bodies))[-4:] == ["a_A", "a_A_2", "b_A", "b_A_2"]


def test_without_a_thermal_material_the_temperature_given_to_laws_is_the_run_s_temperature():
    solid = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
    start = 300 + 10 * x
    model = nv.Model(material=solid, **arrhenius(start, start))
    run = nv.Simulation(structured_box((1, 1), (2, 2)), model, dt=0.02, initial=nv.Initial(velocity=(y, 0)))
    run.advance()
    assert run.fields["temperature"](run.mesh(0.4, 0.5)) == pytest.approx(304, abs=0.5)
    warm = nv.Thermal(material=solid, c=1.0, theta_R=300.0)
    assert names(nv.Model(material=warm, **arrhenius(start)))[-1] == "temperature_2"
    with pytest.raises(nv.ParameterError, match=r"Activated\.temperature.*the material has no temperature"):
        nv.Model(material=solid, **arrhenius(start))


@pytest.mark.parametrize("mean", ["arithmetic", "geometric", "harmonic", "root"])
def test_a_carried_parameter_returns_its_value_and_is_averaged_by_the_stated_mean(mean):
    parameter, share = nv.Parameter("eta", start=2.0, mean=mean), 1e-5
    low, high = (parameter.carried(np.array([value])) for value in (1.0, 1e6))
    assert parameter.at({"eta": Array(high)}).value == pytest.approx(1e6, rel=1e-12)
    mixed = float(parameter.at({"eta": Array((1 - share) * low + share * high)}).value[0])
    expected = {"arithmetic": 11.0, "geometric": 1e6**share, "harmonic": 1 + share}
    assert mixed == pytest.approx(expected.get(mean, 1 + 8 * share * (1e6**0.125 - 1)), rel=1e-6)
    assert parameter.typical == 2.0


def test_moduli_that_depend_on_place_have_the_mean_of_their_law():
    solid = nv.LinearElastic(K_e=1 + x, G_e=2 + x)
    model = nv.Model(
        material=solid,
        viscosity=nv.StokesViscosity(K_v=1 + y, G_v=2 + y),
        creep=nv.Composite(rules=(nv.Creep(G_m=1 + x), nv.Norton(A=1 + x, n=3))),
    )
    found = {v.name: v.mean for v in model.material.variables if isinstance(v, nv.Parameter)}
    expected = {"G_e": "geometric", "G_m": "harmonic", "A": "arithmetic"}
    assert found == expected | dict.fromkeys(("K_e", "K_v", "G_v"), "root")


def test_a_geometric_mean_requires_positive_values():
    with pytest.raises(nv.ParameterError, match=r"Parameter\.start = -1.*> 0, with mean = 'geometric'"):
        nv.Parameter("eta", start=-1.0, mean="geometric")
    with pytest.raises(nv.ParameterError, match=r"Parameter\.mean = 'median'"):
        nv.Parameter("eta", mean="median")
