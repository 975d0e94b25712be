"""What a run is known by: its mesh, spaces, material and scheme, which a checkpoint has to fit."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
from typing import TYPE_CHECKING, Any

import numpy as np
from ngsolve import Mesh

from ngvisco.forms.mesh.mesh_arrays import coordinates, vertices
from ngvisco.physics.bodies import AMOUNT, Amount, Body
from ngvisco.physics.material import Material
from ngvisco.physics.pointwise import sampled_energies

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

FORMAT = 5
"""Of the file of a run."""


def identity(simulation: Simulation) -> dict[str, Any]:
    """What must be equal for a checkpoint to fit, on the first rank: format, mesh, spaces and material.

    A material is its parameters and energies at some states: functions of one name are different energies.
    """
    layout, mesh = simulation.numbering.layout, simulation.numbering.mesh
    assert layout is not None and mesh is not None
    spaces = ", ".join(f"{name} {layout.blocks[name].ndof}" for name in layout.names)
    return {
        "format": FORMAT,
        "ngvisco": version() or "0+unknown",
        "mesh": mesh_hash(mesh),
        "spaces": spaces,
        "material": material_signature(simulation.model.material),
        "bodies": bodies_signature(simulation.model.material),
        "scheme": scheme_signature(simulation),
        "energies": sampled_energies(simulation.model.material, simulation.mesh.dim),
    }


def mesh_hash(mesh: Mesh) -> str:
    """SHA-256 of coordinates, elements and boundary names."""
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(coordinates(mesh)).tobytes())
    digest.update(vertices(mesh).tobytes())
    digest.update("|".join(mesh.GetBoundaries()).encode())
    digest.update(str(mesh.GetCurveOrder()).encode())
    return digest.hexdigest()


def material_signature(material: object) -> str:
    """Class and numbers of a material, and of the bodies that it is of; functions by their names."""
    values = [
        f"{field.name}={_signature_of(getattr(material, field.name))}"
        for field in (dataclasses.fields(material) if dataclasses.is_dataclass(material) else ())
        if field.repr  # the place of a body is that of the start alone
    ]
    return f"{type(material).__name__}({', '.join(values)})"


def bodies_signature(material: Material) -> str:
    """Bodies in their order with their densities: what their amounts in the state are amounts of."""
    amounts = [v for v in material.variables if isinstance(v, Amount)]
    return ", ".join(f"{v.name.removeprefix(AMOUNT)} of {v.density!r} kg/m^3" for v in amounts)


def _signature_of(value: object) -> str:
    if isinstance(value, (Material, Body)):
        return material_signature(value)
    if isinstance(value, tuple):
        return f"({', '.join(_signature_of(one) for one in value)}{',' * (len(value) == 1)})"
    return getattr(value, "__qualname__", None) or repr(value)


def scheme_signature(simulation: Simulation) -> str:
    """Name and tableau of the time scheme, and its startup and relaxation where there are such."""
    integrator = simulation.integrator
    scheme = integrator.scheme
    text = f"{scheme.name}, A = {scheme.A}, b = {scheme.b}"
    if scheme.averages_loads:
        text += ", loads averaged"
    if integrator.startup:
        text += f", startup = {integrator.startup}"
    return text + (", relaxed" if integrator.relaxed else "")


def version(package: str = "ngvisco") -> str | None:
    """Of an installed package, None of another."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
