"""Small cases with a user's energy, term and tableau, and with all choices of schemes."""

from dataclasses import dataclass

from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.forms.term import Entry, Integrand, PointTerm
from ngvisco.geometries import box
from ngvisco.physics.material import Material
from ngvisco.physics.tensors import dev, inner, square, tr
from ngvisco.physics.variables import Distortion, Jacobian

SWIRL = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
NEO_HOOKEAN = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
CUSTOM = nv.CustomMaterial(
    transported=(Distortion(), Jacobian()),
    stored_energy=lambda F, J: 2.5 * square(F) / J + 5 * (J - 1) * (J - 1),
)
ISOTROPIC = nv.IsotropicStrainEnergy(
    strain_energy=lambda E: 5 * tr(E) * tr(E) + 5 * square(dev(E)) + square(dev(E)) ** 2
)
_DIAGONAL = (3 + 3**0.5) / 6
CROUZEIX = nv.TimeScheme("Crouzeix", ((_DIAGONAL, 0.0), (1 - 2 * _DIAGONAL, _DIAGONAL)), (0.5, 0.5))
ADAPTIVE = nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.1, tolerance=1e-2)


@dataclass(frozen=True)
class Drag(PointTerm):
    """The term int c rho v . w of a user: a resistance by the surroundings."""

    c: float  # 1/s

    def cells(self, u, w):
        return [self.c * u.rho * inner(u.v, w.v)]

    def entries(self, u):
        return [Entry("dissipation_drag", "dissipation", Integrand(self.c * u.rho * square(u.v)))]


def swirl(material: Material = NEO_HOOKEAN, **options) -> nv.Simulation:
    viscosity = nv.StokesViscosity(K_v=0.05, G_v=0.05)
    model = nv.Model(material=material, viscosity=viscosity, loads=[nv.Gravity((0.0, -1.0))])
    initial = nv.Initial(velocity=SWIRL)
    return nv.Simulation(box((1, 1), maxh=0.35), model, dt=0.02, initial=initial, **options)


def of(solver: str) -> dict:
    start = "" if solver == "coupled" else "split "
    cases = {
        "own energy": lambda: swirl(CUSTOM, solver=solver),
        "own isotropic energy": lambda: swirl(ISOTROPIC, solver=solver),
        "own energy, Yosida": lambda: swirl(nv.Yosida(material=CUSTOM, eps=1e-3), solver=solver),
        "own term": lambda: swirl(terms=[Drag(2.0)], solver=solver),
        "own tableau": lambda: swirl(scheme=CROUZEIX, solver=solver),
        "theta": lambda: swirl(scheme="theta", theta=0.7, startup=1, solver=solver),
        "relaxation": lambda: swirl(scheme="midpoint", relaxation=True, adaptive=ADAPTIVE, solver=solver),
    }
    if solver == "split":
        cases["adaptive"] = lambda: swirl(adaptive=ADAPTIVE, solver=solver)
    return {start + name: case for name, case in cases.items()}


COUPLED, SPLIT = of("coupled"), of("split")
CASES = COUPLED | SPLIT
