"""The side of upwinding where a trace has one value a facet: that of what goes through the facet."""

from unittest.mock import patch

import numpy as np
import pytest
from ngsolve import BitArray, Discontinuous, FacetFESpace, LinearForm, VectorH1, specialcf

import ngvisco as nv
from ngvisco.forms import system
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.start.initial import set_initial
from ngvisco.forms.system import Step
from ngvisco.forms.upwinding import FacetFlux
from ngvisco.geometries import box, disc
from tests.support import uncondensed

MESHES = {
    "triangles": lambda: box((1, 1), 0.3),
    "curved cells": lambda: disc(1, 0.5),
    "tetrahedra": lambda: box((1, 1, 1), 0.6),
}


@pytest.mark.parametrize("name", MESHES)
def test_it_has_the_mean_normal_velocity_of_every_facet(name):
    from ngsolve import GridFunction

    mesh = MESHES[name]()
    velocity = GridFunction(VectorH1(mesh, order=3))
    velocity.vec.FV().NumPy()[:] = np.random.default_rng(0).uniform(-1, 1, velocity.space.ndof)
    flux = FacetFlux(mesh, velocity, 3)
    flux()
    space = Discontinuous(FacetFESpace(mesh, order=0))
    degree = nv.forms.mesh.quadrature.Quadrature(mesh, 10, 10)
    found = []
    for value in (flux.function, velocity):
        load = LinearForm(space)
        load += value * specialcf.normal(mesh.dim) * space.TestFunction() * degree.facets
        found.append(load.Assemble().vec.FV().NumPy().copy())
    assert found[0] == pytest.approx(found[1], abs=1e-12)


def density_of_a_long_step():
    """Least density after a step in which a wild velocity carries matter through many cells."""
    step = Step(
        box((1, 1), 0.3), nv.Model(material=nv.BarotropicFluid(B=1.0, gamma=1.4)), nv.Discretisation(m=0)
    )
    set_initial(step, nv.Initial(), Sampler(step.mesh, step.quadrature))
    rng, ranges = np.random.default_rng(2), step.layout.ranges
    for state in (step.state, step.state_old):
        state.vec.FV().NumPy()[ranges["v"]] = np.random.default_rng(3).uniform(-1, 1, step.wind.space.ndof)
        state.vec.FV().NumPy()[ranges["v"]][~np.array(list(step.wind.space.FreeDofs()))] = 0.0
    step.state_old.vec.FV().NumPy()[ranges["rho"]] = 10 ** rng.uniform(-3, 0, step.mesh.ne)
    step.wind.vec.FV().NumPy()[:] = step.state.vec.FV().NumPy()[ranges["v"]]
    step.follow_wind()
    step.context.eta.Set(1e-9)
    step.context.tau.Set(1.0)
    (term,) = (term for term in step.terms if type(term).__name__ == "Continuity")
    form = uncondensed(step, term.form(*map(step.layout.fields, step.layout.space.TnT())))
    form.AssembleLinearization(step.state.vec)
    free = BitArray(step.layout.space.ndof)
    free.Clear()
    for name in ("rho", "rho_hat"):
        free[ranges[name]] = True
    residual = step.state.vec.CreateVector()
    form.Apply(step.state.vec, residual)
    step.state.vec.data -= form.mat.Inverse(free, inverse="umfpack") * residual
    return step.state.vec.FV().NumPy()[ranges["rho"]].min()


def test_an_implicit_step_of_order_zero_keeps_densities_positive_however_long_it_is():
    """Control: by sides that differ along a facet it does not."""
    assert density_of_a_long_step() > 0
    with patch.object(system, "FacetFlux", lambda mesh, velocity, order: None):
        assert density_of_a_long_step() < 0
