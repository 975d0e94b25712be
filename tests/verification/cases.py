"""The two models of the manufactured solutions, with all the mechanisms asked for."""

from __future__ import annotations

from manufactured import Coefficients

from ngvisco import (
    Creep,
    Gravity,
    HyperViscosity,
    LinearElastic,
    Material,
    Model,
    NeoHookean,
    StokesViscosity,
)

KINDS = ("linear", "neo-hookean")


def material(kind: str) -> Material:
    if kind == "linear":
        return LinearElastic(K_e=2.0, G_e=1.0)
    return NeoHookean(K_e=2.0, G_e=1.0, epsilon=0.5)


def hyperviscosity(p: float | None) -> HyperViscosity | None:
    """Of about the size of the Stokes viscosity on these fields."""
    return None if p is None else HyperViscosity(mu=1e-2 if p == 2 else 1e-3, p=p)


def model(kind: str, dim: int, p: float | None) -> Model:
    """Everything on: creep, gravity, viscosity, and hyperviscosity with exponent p unless None."""
    return Model(
        material=material(kind),
        viscosity=StokesViscosity(K_v=0.3, G_v=0.2),
        hyperviscosity=hyperviscosity(p),
        creep=Creep(G_m=2.0),
        loads=(Gravity((0.0, -0.7, 0.0)[:dim]),),
    )


def coefficients(kind: str, p: float | None) -> Coefficients:
    """The same constants once more, for the formulas in numpy."""
    return Coefficients(
        K_e=2.0,
        G_e=1.0,
        epsilon=0.0 if kind == "linear" else 0.5,
        K_v=0.3,
        G_v=0.2,
        mu=0.0 if p is None else (1e-2 if p == 2 else 1e-3),
        p=2.0 if p is None else p,
        R=0.5,
        g=-0.7,
    )
