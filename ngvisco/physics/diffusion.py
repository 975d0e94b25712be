"""Diffusion of what a material carries, as a solute: down the gradient of its chemical potential."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.heat import Function
from ngvisco.physics.material import Material
from ngvisco.physics.parameters import require_fields


@dataclass(frozen=True, kw_only=True)
class WallExchange:
    """The flux into the body through a wall: flux + coefficient (potential - mu), mu that inside.

    A large coefficient holds the wall at the potential.  Raises ParameterError if a parameter is out of its
    range, one of potential and coefficient is given without the other, or nothing is.

    Parameters
    ----------
    potential : float, optional
        That of the surroundings, with a coefficient; a function of the place and the run's time.
    coefficient : float, optional
        How readily the wall lets through; a function of the place and the run's time.
    flux : float, optional
        What comes in besides, whatever the potential; a function of the place and the run's time.
    """

    potential: Annotated[Function | None, Quantity("Pa", example=2.0)] = None
    coefficient: Annotated[Function | None, Quantity("m/(Pa s)", ">= 0", 10.0)] = None
    flux: Annotated[Function | None, Quantity("m/s", example=0.1)] = None

    def __post_init__(self) -> None:
        require_fields(self)
        if (self.potential is None) != (self.coefficient is None):
            missing = "potential" if self.potential is None else "coefficient"
            expected = "a value: potential and coefficient go together"
            raise ParameterError(f"WallExchange.{missing}", None, expected)
        if self.potential is None and self.flux is None:
            raise ParameterError("WallExchange.flux", None, "a flux, or a potential and a coefficient")


@dataclass(frozen=True, kw_only=True)
class Diffusion:
    """dc/dt + div(c v) = div(M grad mu), mu = d phi/d c: what a material carries spreads until mu is even.

    It dissipates M |grad mu|^2.  An energy that reads c beside J swells by it.  Raises ParameterError if a
    parameter is out of its range.

    Parameters
    ----------
    variable : str
        Name of c among the material's variables, a scalar that is conserved (``Concentration``).
    mobility : float
        M, of c in its own unit [c] in [c]^2 m^2/(Pa s).
    walls : mapping of boundary names to WallExchange, optional
        Walls that it comes through; no flux through others.
    """

    variable: Annotated[str, Quantity(example="c")]
    mobility: Annotated[float, Quantity("m^2/(Pa s)", "> 0", 0.1)]
    walls: Annotated[Mapping[str, WallExchange], Quantity(example={"left": {"flux": 0.1}})] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        require_fields(self)

    def require(self, material: Material) -> None:
        """Raise ParameterError for a material that does not carry the variable, or not so."""
        known = [v.name for v in material.variables if v.kind == "scalar" and v.is_conserved]
        if self.variable not in known:
            of, carried = type(material).__name__, ", ".join(v.name for v in material.variables)
            expected = (
                f"a conserved scalar of the material: {of} carries {carried}, of which such are {known}"
            )
            raise ParameterError("Diffusion.variable", self.variable, expected)
