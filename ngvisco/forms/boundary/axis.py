"""Conditions on walls, loads and terms of a body of revolution: the axis is a slip wall, and no load crosses
the axis."""

from collections.abc import Iterable, Iterator

from ngsolve import BND

from ngvisco.errors import MeshError, ParameterError, as_number
from ngvisco.forms.boundary.boundaries import axis_parallel_walls
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.forms.mesh.symmetry import AXISYMMETRIC, ON_AXIS, Symmetry
from ngvisco.forms.term import PointTerm
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.loads import CentralGravity, Gravity
from ngvisco.physics.model import Model
from ngvisco.physics.walls import Slip
from ngvisco.words import call


def require_symmetry(symmetry: Symmetry, walls: Walls, model: Model, terms: Iterable[PointTerm]) -> None:
    """Raise ParameterError for data that a body of revolution cannot have; MeshError if the axis and another
    wall have one name.

    The function refuses a term without an axisymmetric form, an axis that is not ``Slip``, gravity across
    the axis, and a mesh that is periodic in r.
    """
    if symmetry.largest_radius is None:
        return
    for term in terms:
        if term.plane_only is not None:
            expected = f"'none' with {type(term).__name__}, since {term.plane_only}"
            raise ParameterError("Simulation.symmetry", AXISYMMETRIC, expected)
    for load in model.loads:
        across = load.centre[0] if isinstance(load, CentralGravity) else 0.0
        if isinstance(load, Gravity) and isinstance(load.g, (tuple, list)):
            across = load.g[0] if as_number(load.g[0]) is not None else 0.0
        if across != 0:
            expected = "0 for the x component of g or of the centre, since the axis of the body is x = 0"
            raise ParameterError(f"loads[{load.name!r}]", across, expected)
    across_r, _ = axis_parallel_walls(walls.mesh)
    if names := walls.periodic.intersection(across_r[0]):
        expected = f"'none' with the periodic boundary {min(names)!r}, since the radius r is not periodic"
        raise ParameterError("Simulation.symmetry", AXISYMMETRIC, expected)
    for name in axis_of(walls, ON_AXIS * symmetry.largest_radius):
        wall = walls.conditions[name]
        if not isinstance(wall, Slip) or wall.heat is not None:
            expected = " without heat, since the wall is the axis of an axisymmetric body"
            raise ParameterError(f"walls[{name!r}]", wall, call("Slip"), expected)


def axis_of(walls: Walls, near: float) -> Iterator[str]:
    """Yield names of the walls that lie on the axis, up to ``near``, m; collective."""
    ranks, r = Communicator.of(walls.mesh), coordinates(walls.mesh)[:, 0]
    for name in walls.conditions:
        on = [
            bool((r[[v.nr for v in element.vertices]] <= near).all())
            for element in walls.region([name]).Elements()
            if element.VB() == BND
        ]
        if ranks.any(any(on)):
            if not ranks.all(all(on)):
                message = f"a part of the wall {name!r} lies on the axis; give the axis a name of its own"
                raise MeshError(message)
            yield name
