"""The lifted C0 interior penalty: exact Hessians, a gradient of its potential, its dissipation."""

import numpy as np
import pytest
from ngsolve import CF, CoefficientFunction, x, y, z
from support import (
    Case,
    central_difference,
    parts_of,
    random_direction,
    randomise,
    residual,
    step_of,
    uncondensed,
)

from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.start.initial import _recover_hessian, complete
from ngvisco.forms.system import Step
from ngvisco.forms.terms.hyperviscosity import Hyperviscosity
from ngvisco.forms.unknown_values import hessian_basis
from ngvisco.physics.tensors import square

QUADRATIC = {
    2: (x * x - 3 * x * y, 0.5 * y * y + x * y + 2 * x),
    3: (x * x - 3 * x * y + z * z, y * z + 2 * x, x * y + 0.5 * z * z - y * y),
}
CUBIC = {
    2: (x * x * x - 3 * x * y * y, y * y * y + x * x * y),
    3: (x * y * z + x * x * x, y * y * z - x * x * y, z * z * z + x * x),
}
CASES = [
    Case(),
    Case(p=2.0, mu_1=0.3, creep=False),
    Case(k=3, m=2, p=3.5, mu_1=0.3),
    Case(p=1.5),
    Case(dim=3),
    Case(dim=3, material="linear", m=0, p=3.5, mu_1=0.3),
    Case(dim=3, material="linear", k=3, p=4.0, creep=False),
]
by_case = pytest.mark.parametrize("case", CASES, ids=str)


def hyperviscosity(step: Step) -> Hyperviscosity:
    (term,) = (term for term in step.terms if isinstance(term, Hyperviscosity))
    return term


def hessian(step: Step) -> CoefficientFunction:
    """The recovered S_ijk = d_k d_j v_i from its components, (dim, dim^2)."""
    basis = hessian_basis(step.mesh.dim)
    return step.now.hess * CF(tuple(basis.T.ravel()), dims=basis.T.shape)


def make_consistent(step: Step) -> None:
    """Local unknowns from (v, a): the Hessian by lifting, the others by elimination."""
    _recover_hessian(step, hyperviscosity(step))
    step.local_unknowns.update()
    if step.model.hyperviscosity.is_linear:
        parts, law = parts_of(step), step.model.hyperviscosity
        parts["hyperstress"].vec.data = (law.mu + law.mu_1) * parts["hess"].vec


def set_smooth(step: Step, v: tuple[CoefficientFunction, ...]) -> None:
    """Set v to a function of its space, and a to d_n v, which is equal on both sides of a facet."""
    step.state.vec[:] = 0.0
    parts_of(step)["v"].Set(CF(v))
    complete(step)


def exact_hessian(v: tuple[CoefficientFunction, ...], dim: int) -> CoefficientFunction:
    axes = (x, y, z)[:dim]
    return CF(tuple(f.Diff(a).Diff(b) for f in v for a in axes for b in axes), dims=(dim, dim * dim))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("k, fields", [(2, QUADRATIC), (3, QUADRATIC), (3, CUBIC)], ids=["2-2", "3-2", "3-3"])
def test_hessian_of_a_polynomial_of_degree_k_is_exact(dim: int, k: int, fields: dict) -> None:
    step = step_of(Case(dim=dim, material="linear", k=k, creep=False))
    set_smooth(step, fields[dim])
    sampler = Sampler(step.mesh, step.quadrature)
    error = sampler.values(hessian(step) - exact_hessian(fields[dim], dim))
    assert np.abs(sampler.values(hessian(step))).max() > 1
    assert np.abs(error).max() < 1e-11
    assert step.quadrature.integrate_facets(square(step.now.jump)) < 1e-24


def rows(step: Step) -> np.ndarray:
    trial, test = step.layout.space.TnT()
    parts = hyperviscosity(step).form(Fields.of(step.layout, trial), Fields.of(step.layout, test))
    return residual(uncondensed(step, parts), step.state.vec)


def of_velocity(step: Step) -> np.ndarray:
    """Mask of the coefficients of v and a."""
    mask = np.zeros(step.layout.space.ndof, dtype=bool)
    for name in ("v", *(f"a_{i + 1}" for i in range(step.mesh.dim))):
        mask[step.layout.ranges[name]] = True
    return mask


def potential(step: Step) -> float:
    """Psi(v, a) of the module's docstring, at consistent local unknowns."""
    law, u, h, chi = step.model.hyperviscosity, step.now, step.context.h, step.context.curvature
    s = square(u.hess)
    power = (s + law.floor**2) ** (law.p / 2)
    cells = 0.5 * law.mu_1 * s + law.mu / law.p * power
    size = s + square(u.jump) / (h * h) + chi * chi
    slope = law.mu_1 + law.mu * size ** ((law.p - 2) / 2)
    facets = 0.5 * law.penalty / h * slope * square(u.jump)
    return step.quadrature.integrate_cells(cells) + step.quadrature.integrate_facets(facets)


@by_case
def test_residual_is_the_gradient_of_the_potential(case: Case) -> None:
    """<R, (w, b)> = d/ds Psi(v + s w, a + s b), with all local unknowns eliminated."""
    step = step_of(case)
    randomise(step, 2)
    make_consistent(step)
    mask = of_velocity(step)
    base = step.state.vec.FV().NumPy().copy()
    direction = np.where(mask, random_direction(step).FV().NumPy(), 0.0)
    power = rows(step) @ direction

    def along(s: float) -> float:
        step.state.vec.FV().NumPy()[:] = base + s * direction
        make_consistent(step)
        return potential(step)

    assert central_difference(along, 1e-3) == pytest.approx(power, rel=1e-7)
    assert abs(power) > 1e-4


@by_case
def test_dissipation_is_the_power_of_the_hyperstress(case: Case) -> None:
    """<Psi'(v, a), (v, a)> is the ledger's entry, and is >= p Psi where mu_1 and chi do not act."""
    step = step_of(case)
    randomise(step, 3)
    make_consistent(step)
    power = rows(step)[of_velocity(step)] @ step.state.vec.FV().NumPy()[of_velocity(step)]
    (entry,) = hyperviscosity(step).entries(step.now)
    entered = step.quadrature.integrate_cells(entry.integrand.cells)
    entered += step.quadrature.integrate_facets(entry.integrand.facets)
    assert (entry.name, entry.kind) == ("dissipation_hyper", "dissipation")
    assert entered == pytest.approx(power, rel=1e-12)
    assert entered > 0
