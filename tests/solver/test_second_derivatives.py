"""Second derivatives of users' energies, against central differences of the first."""

from collections.abc import Callable

import ngsolve
import numpy as np
import pytest
from ngsolve import sin, x, y
from support import by_ci

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics import pointwise
from ngvisco.physics.material import Material, rest_stress_and_modulus
from ngvisco.physics.pointwise import ArrayResponse, ExpressionResponse, respond
from ngvisco.physics.tensors import Tensor, cof, square, tr
from ngvisco.physics.variables import Distortion, Jacobian, Values

TOLERANCE = 1e-7


def by_the_package(F: Tensor, J: Tensor) -> Tensor:
    return 0.6 * tr(F.trans * F) + 0.2 * square(cof(F)) + 0.1 * J * square((1 / J) * F) + volumetric(J)


def by_ngsolve(F: Tensor, J: Tensor) -> Tensor:
    """An energy with Cof F in NGSolve's own functions, which arrays do not take."""
    invariants = 0.6 * ngsolve.Trace(F.trans * F) + 0.2 * square(ngsolve.Cof(F))
    return invariants + 0.1 * J * square((1 / J) * F) + volumetric(J)


def volumetric(J: Tensor) -> Tensor:
    """A function of J that cancels the stress at rest."""
    return 4.0 * (J + 1 / J) - 12.6


def material(energy: Callable[..., Tensor] = by_the_package) -> Material:
    return nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=energy)


BOTH = pytest.mark.parametrize(
    "energy, kind", [(by_the_package, ArrayResponse), (by_ngsolve, ExpressionResponse)]
)


@BOTH
@pytest.mark.parametrize("dim", [2, 3])
def test_the_hessian_equals_differences_of_the_slope(
    energy: Callable[..., Tensor], kind: type, dim: int
) -> None:
    law = material(energy)
    response, size, h = respond(law, dim), law.states(dim).size, 1e-5
    assert type(response) is kind
    states = pointwise.rest_state(law, dim) + 0.1 * np.random.default_rng(0).standard_normal((5, size))
    found = response(states).hessian
    ends = [[response(states + s * h * unit).slope for s in (1, -1)] for unit in np.eye(size)]
    expected = np.stack([(ahead - behind) / (2 * h) for ahead, behind in ends], axis=1)
    assert abs(found - expected).max() < TOLERANCE * abs(expected).max()


def gradient_s_derivative(phi: Tensor, variables: Values, along: Values) -> dict[str, Tensor]:
    """Derivatives in the order for which NGSolve has a wrong second derivative."""
    slopes = {name: phi.Diff(variable) for name, variable in variables.items()}
    return {
        name: sum((slope.Diff(variables[other], along[other]) for other in along), 0 * slope)
        for name, slope in slopes.items()
    }


def test_wrong_second_derivative_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pointwise, "conjugates_along", gradient_s_derivative)
    expected = (
        r"CustomMaterial.stored_energy = .*derivative NGSolve computes; the relative error of .* is 0\.\d+"
    )
    with pytest.raises(nv.errors.ParameterError, match=expected):
        respond(material(by_ngsolve), 2)


@BOTH
def test_the_modulus_at_rest_equals_its_closed_form(energy: Callable[..., Tensor], kind: type) -> None:
    """J phi at F = J^(1/3) I is 1.8 J^(5/3) + .6 J^(7/3) + .3 J^(2/3) + 4 J^2 + 4 - 12.6 J."""
    powers, factors = np.array([5 / 3, 7 / 3, 2 / 3, 2.0, 1.0]), np.array([1.8, 0.6, 0.3, 4.0, -12.6])
    stress, modulus = rest_stress_and_modulus(material(energy))
    assert abs(stress) < 1e-12 and abs(powers @ factors) < 1e-12
    assert modulus == pytest.approx((powers * (powers - 1)) @ factors, rel=1e-12)


@pytest.mark.parametrize(
    "energy, kind", [(by_the_package, ArrayResponse), by_ci(by_ngsolve, ExpressionResponse)]
)
def test_both_solvers_run_a_users_energy_with_a_cofactor(energy: Callable[..., Tensor], kind: type) -> None:
    """Newton's method takes few iterations, and the ledger closes with the diffusion of the fields, whose
    equation contains phi''."""
    model = nv.Model(material=material(energy), regularisation=nv.Regularisation(delta_fields=0.01))
    start = nv.Initial(velocity=(sin(3 * y) * x * (1 - x), 0.0))
    stored = []
    for solver in ("coupled", "split"):
        run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.05, solver=solver, initial=start)
        ledger = run.run(until=0.1)
        assert ledger.column("newton_iterations").max() <= 8
        assert abs(ledger.column("closure")).max() < 1e-12
        stored.append(ledger.column("stored")[-1])
    assert stored[0] == pytest.approx(stored[1], rel=1e-9)
