"""What a case file can name.  A new material, mechanism, load, wall or geometry is one line here.

Keys of a section are the parameters of the dataclass or function, read from its annotations.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from ngvisco.case.meshfile import read_mesh
from ngvisco.forms.initial import Initial
from ngvisco.forms.spaces import Discretisation
from ngvisco.physics.materials import LinearElastic, NeoHookean
from ngvisco.physics.model import BodyForce, Gravity
from ngvisco.physics.rheology import Creep, HyperViscosity, StokesViscosity
from ngvisco.run.stepping import AdaptiveSteps
from ngvisco.solver.newton import NewtonOptions


def _geometries() -> dict[str, Callable[..., Any]]:
    # importable only after ngvisco itself has found them beside it
    geometries = importlib.import_module("ngvisco.geometries")
    return {
        "box": geometries.box,
        "file": read_mesh,
    }


GEOMETRIES = _geometries()

MATERIALS: dict[str, type] = {
    "LinearElastic": LinearElastic,
    "NeoHookean": NeoHookean,
}

MECHANISMS: dict[str, type] = {
    "viscosity": StokesViscosity,
    "hyperviscosity": HyperViscosity,
    "creep": Creep,
}

LOADS: dict[str, type] = {
    "BodyForce": BodyForce,
    "Gravity": Gravity,
}

WALLS: dict[str, type | None] = {
    "slip": None,  # impenetrable, free tangential part: the default of every wall
}

SECTIONS: dict[str, type] = {
    "adaptive": AdaptiveSteps,
    "discretisation": Discretisation,
    "initial": Initial,
    "solver": NewtonOptions,
}
