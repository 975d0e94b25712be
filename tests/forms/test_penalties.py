"""Interior penalties let jumps between cells decay: without penalties, fields that are constant in cells
would never change."""

import math

import numpy as np
import pytest
from ngsolve import L2, GridFunction, IfPos, Integrate, x
from test_field_diffusion import DELTA, Diffusion

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.physics.regularisation import Regularisation

LENGTH, DIFFUSIVITY, UNTIL = 1.0, 0.5, 0.1
EXACT = sum(
    8 / (math.pi * n) ** 2 * math.exp(-DIFFUSIVITY * (math.pi * n / LENGTH) ** 2 * UNTIL)
    for n in range(1, 40, 2)
)
"""Difference between the means of both halves, by the Fourier series of a jump."""


def left(run, field):
    """The difference between the means of the halves, relative to the difference at the start, which is 1."""
    sides = IfPos(x - 0.5 * LENGTH, 1.0, -1.0)
    return 2 / (LENGTH * 0.25) * Integrate(run.fields[field] * sides, run.mesh)


def halves(model, start):
    """A run that begins with ``start`` of a field that is 0 in the left half and 1 in the right one."""
    mesh = structured_box((LENGTH, 0.25), (6, 1))
    step = GridFunction(L2(mesh, order=0))
    step.Set(IfPos(x - 0.5 * LENGTH, 1.0, 0.0))
    options = {"dt": UNTIL / 5, "scheme": "sdirk2", "solver": "coupled"}
    run = nv.Simulation(mesh, model, initial=start(step), **options)
    run.run(UNTIL)
    return run


SOLID = nv.LinearElastic(K_e=1e3, G_e=1e3)


@pytest.mark.long
@pytest.mark.ci
def test_a_jump_of_the_temperature_decays_by_fourier_s_law():
    material = nv.Thermal(material=SOLID, c=2.0, theta_R=100.0)
    model = nv.Model(material=material, heat=nv.Heat(conductivity=2.0 * DIFFUSIVITY))
    run = halves(model, lambda step: nv.Initial(density=1.0, temperature=100 + step))
    assert left(run, "temperature") == pytest.approx(EXACT, rel=0.03)


def test_a_jump_of_the_density_decays_by_fick_s_law():
    model = nv.Model(material=SOLID, regularisation=Regularisation(delta_density=DIFFUSIVITY, r=2.0))
    run = halves(model, lambda step: nv.Initial(density=1 + step))
    assert left(run, "density") == pytest.approx(EXACT, rel=0.03)


@pytest.mark.parametrize("m", [1, 2])
def test_field_diffusion_lowers_a_jump_by_its_penalty(m):
    """The mesh has two triangles with constant fields. The penalty dissipates delta s/h C [zeta]^2/4 on each
    side of the facet, in addition to the dissipation by the slope."""
    B, gamma, found = 10.0, 1.4, {}
    slope = -B * gamma * np.array([1.1, 0.9]) ** (-gamma - 1)
    for penalty in (4.0, 8.0):
        diffusion = Diffusion(nv.BarotropicFluid(B=B, gamma=gamma), box((1, 1), maxh=1), m, penalty)
        assert diffusion.step.mesh.ne == 2
        at = np.repeat([1.1, 0.9], diffusion.op.points.per_cell)[None]
        found[penalty] = np.array(diffusion.power(diffusion.projected(at)))
    h, compliance = diffusion.step.context.h.vec[0], 1 / (B * gamma * (gamma + 1))
    of_one = math.sqrt(2) * (m + 1) ** 2 / h * compliance * np.diff(slope)[0] ** 2 / 4
    # the powers are those of the form and of the ledger
    assert found[8.0] - found[4.0] == pytest.approx(2 * [DELTA * 4 * 2 * of_one], rel=1e-10)
