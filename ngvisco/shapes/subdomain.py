"""Shapes that the mesh itself has: its named subdomains."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ngvisco.errors import ParameterError, Quantity, UnknownNameError, require_names
from ngvisco.shapes.places import Places
from ngvisco.shapes.shape import Shape


@dataclass(frozen=True)
class Subdomain(Shape):
    """The cells of named subdomains (NGSolve: materials) of the mesh: exactly these, nothing is cut.

    Parameters
    ----------
    names : str or sequence of str
        Names of subdomains of the mesh.

    Raises
    ------
    ParameterError
        If a parameter is out of its range.
    """

    names: Annotated[str | Sequence[str], Quantity(example=["inclusion"])]

    def __post_init__(self) -> None:
        names = (self.names,) if isinstance(self.names, str) else require_names("Subdomain.names", self.names)
        if not names:
            raise ParameterError("Subdomain.names", self.names, "at least one name")
        object.__setattr__(self, "names", tuple(names))

    def level(self, at: Places) -> np.ndarray:
        known = at.mesh.GetMaterials()
        for name in self.names:
            if name not in known:
                raise UnknownNameError("subdomain", name, known)
        wanted = np.array([name in self.names for name in known])
        elements = at.mesh.ngmesh.Elements2D() if at.mesh.dim == 2 else at.mesh.ngmesh.Elements3D()
        index = elements.NumPy()["index"][at.cell_numbers]  # from 1
        return np.where(wanted[index - 1], 1.0, -1.0)
