"""A run warns if, and only if, its velocities alternate from step to step."""

import warnings

import pytest
from ngsolve import CF, sqrt, x, y

import ngvisco as nv
from ngvisco.geometries import annulus


def _ring(startup: int, stretch: float = 1.0) -> nv.Simulation:
    """A ring of nearly incompressible matter with the strains of a bent strip but without their pressure."""
    r = sqrt(x * x + y * y)
    along, c, s = stretch * r / 0.5**0.5 + 1 - stretch, x / r, y / r
    F = CF((c / along, -along * s, 0, s / along, along * c, 0, 0, 0, 1), dims=(3, 3))
    strains = {"F": F} if stretch else {}
    return nv.Simulation(
        annulus(0.5, 1.0, 0.35),
        nv.Model(
            material=nv.ReferentialNeoHookean(K_e=200.0, G_e=0.5),
            viscosity=nv.StokesViscosity(K_v=1.0, G_v=0.2),
        ),
        time=nv.TimeSteps(dt=0.1, scheme="midpoint", startup=startup),
        walls={"inner": nv.Open(), "outer": nv.Open()},
        initial=nv.Initial(density=0.05, **strains),
    )


@pytest.mark.long
@pytest.mark.ci
def test_waves_that_alternate_for_ten_steps_warn_once() -> None:
    run = _ring(startup=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", nv.RingingWarning)
        run.run(0.9)
    with pytest.warns(nv.RingingWarning, match=r"time.startup = 2") as said:
        run.run(1.5)
    assert sum(one.category is nv.RingingWarning for one in said) == 1


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize(("startup", "stretch"), [(2, 1.0), (0, 0.0)])
def test_damped_waves_and_rounding_at_rest_do_not_warn(startup: int, stretch: float) -> None:
    run = _ring(startup, stretch)
    with warnings.catch_warnings():
        warnings.simplefilter("error", nv.RingingWarning)
        run.run(2.5)


@pytest.mark.long
@pytest.mark.ci
def test_a_resolved_vibration_does_not_warn() -> None:
    run = _ring(startup=0).on(annulus(0.5, 1.0, 0.35), dt=0.004, solver="split")
    with warnings.catch_warnings():
        warnings.simplefilter("error", nv.RingingWarning)
        run.run(0.08)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("goes_on", [nv.Simulation.restore, nv.resume_changed])
def test_a_restored_run_counts_alternating_steps_anew(tmp_path, goes_on) -> None:
    file = tmp_path / "states.h5"
    run = _ring(startup=0)
    run.observers.append(nv.Checkpoints(file))
    with pytest.warns(nv.RingingWarning):
        run.run(1.5)
    goes_on(run, file)
    with pytest.warns(nv.RingingWarning):
        run.run(2.8)
