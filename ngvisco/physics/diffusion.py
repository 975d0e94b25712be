"""Diffusion of a concentration that a material carries, such as a solute, by its chemical potential."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.heat import Function, require_together
from ngvisco.physics.material import Material
from ngvisco.physics.parameters import Checked


@dataclass(frozen=True, kw_only=True)
class WallExchange(Checked):
    """The flux into the body through a wall: flux + coefficient (potential - mu), mu the body's potential.

    A large coefficient holds the wall at the potential.  Raises ParameterError if a parameter is out of its
    range, one of potential and coefficient is given without the other, or no parameter is given.

    Parameters
    ----------
    potential : float, optional
        Potential of the surroundings, which needs a coefficient; a function of the place and the run's time.
    coefficient : float, optional
        Transfer coefficient of the wall; a function of the place and the run's time.
    flux : float, optional
        Further flux inwards, independent of the potential; a function of the place and the run's time.
    """

    potential: Annotated[Function | None, Quantity("Pa", example=2.0)] = None
    coefficient: Annotated[Function | None, Quantity("m/(Pa s)", ">= 0", 10.0)] = None
    flux: Annotated[Function | None, Quantity("m/s", example=0.1)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_together(self, "potential", "coefficient")
        if self.potential is None and self.flux is None:
            raise ParameterError("WallExchange.flux", None, "a flux, or a potential and a coefficient")


@dataclass(frozen=True, kw_only=True)
class Diffusion(Checked):
    """Diffusion of c until mu = d phi/d c is uniform: dc/dt + div(c v) = div(M grad mu).

    Diffusion dissipates M |grad mu|^2.  A material whose energy couples c and J swells with c.  Raises
    ParameterError if a parameter is out of its range.

    Parameters
    ----------
    variable : str
        Name of c among the material's variables, a scalar that is conserved (``Concentration``).
    mobility : float
        M, in [c]^2 m^2/(Pa s) for c in its unit [c].
    walls : mapping of boundary names to WallExchange, optional
        Walls with exchange; the flux through all other walls is zero.
    """

    variable: Annotated[str, Quantity(example="c")]
    mobility: Annotated[float, Quantity("m^2/(Pa s)", "> 0", 0.1)]
    walls: Annotated[Mapping[str, WallExchange], Quantity(example={"left": {"flux": 0.1}})] = field(
        default_factory=dict
    )

    def require(self, material: Material) -> None:
        """Raise ParameterError for a material that does not carry the variable as a conserved scalar."""
        conserved = [v.name for v in material.variables if v.kind == "scalar" and v.is_conserved]
        if self.variable not in conserved:
            owner, carried = type(material).__name__, ", ".join(v.name for v in material.variables)
            those = f"one of {', '.join(conserved)}" if conserved else f"but {owner} has none"
            expected = f"a conserved scalar of the material, {those}; {owner} carries {carried}"
            raise ParameterError("Diffusion.variable", self.variable, expected)
