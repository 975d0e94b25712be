"""``NewtonOptions.coarse``: refused by name, and said where it has no part."""

import sys

import pytest

import ngvisco as nv
from ngvisco.errors import InputWarning, ParameterError
from ngvisco.geometries import box, disc
from ngvisco.parallel import petsc
from ngvisco.solver import options
from ngvisco.solver.options import SplitOptions


def test_multigrid_without_petsc_is_refused_by_name(monkeypatch):
    monkeypatch.setattr(petsc, "_loaded", [])
    monkeypatch.setitem(sys.modules, "petsc4py", None)  # as where it is not installed
    with pytest.raises(ParameterError, match="coarse = 'gamg': expected 'direct': petsc4py is missing"):
        nv.NewtonOptions(coarse="gamg")
    with pytest.raises(ParameterError, match="coarse = 'amg': expected one of direct, gamg, hypre"):
        nv.NewtonOptions(coarse="amg")
    with pytest.raises(ParameterError, match="coarse = 'gamg': expected 'direct' with the method 'coupled'"):
        nv.NewtonOptions(coarse="gamg", method="coupled")


@pytest.mark.parametrize(
    ("domain", "solver", "reason"),
    [
        (lambda: box((1, 1), maxh=1.0), "auto", "the coupled solver, which takes the steps, factorises all"),
        (lambda: box((1, 1), maxh=0.5), "split", "up to 10000 unknowns of v are factorised as a whole"),
        (
            lambda: disc(1.0, maxh=0.9),
            "split",
            "with stresses of oblique or curved walls beside v the matrix",
        ),
    ],
)
def test_multigrid_without_effect_is_warned_of(monkeypatch, domain, solver, reason):
    monkeypatch.setattr(options, "obstacle", lambda method: None)  # also where there is no PETSc
    limit = 0 if "walls" in reason else 10_000
    newton = nv.NewtonOptions(coarse="gamg", split=SplitOptions(direct_up_to=(limit, limit)))
    model = nv.Model(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1))
    with pytest.warns(InputWarning, match=f"coarse = 'gamg' of the solver has no effect: {reason}"):
        assert nv.Simulation(domain(), model, dt=0.02, newton=newton, solver=solver).solver.newton
