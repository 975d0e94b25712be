"""A material that a user defines: variables and an energy given in a script."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.energy_checks import check_bound, check_energy, require_isotropy
from ngvisco.physics.material import Material, check_material
from ngvisco.physics.parameters import Modulus, Parameter
from ngvisco.physics.tensors import IDENTITY
from ngvisco.physics.variables import Values, Variable


@dataclass(frozen=True, kw_only=True)
class CustomMaterial(Material):
    """A material with phi = stored_energy(**values) for any list of transported variables.

    A run samples the energy and warns where it is not jointly convex, see ``check_convexity``.  A rotation of
    the observer must not change the energy: phi(Q F) = phi(F); for a spatial tensor, E or B = F F^T, this is
    isotropy.  Raises ParameterError in the following cases: ``transported`` is not a list of variables; the
    energy or a bound raises an error, returns anything but a real scalar, or reads anything but the variables
    (the position, the time, a grid function, ...); a bound is not positive at rest and on a convex set; a
    rotation Q of the observer changes the energy, with this rotation in the message.

    Example::

        import ngvisco as nv
        from ngvisco.geometries import box
        from ngvisco.physics.tensors import square
        from ngvisco.physics.variables import Distortion, Jacobian

        def energy(F, J):  # a foam that stiffens as it closes, Pa
            return 4 * square(F) / J ** (2 / 3) + 6 * (J - 1) * (J - 1) + 0.2 / (J * J) + 0.4 * J

        foam = nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=energy)
        viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.1)
        model = nv.Model(material=foam, viscosity=viscosity, loads=[nv.Gravity((0.0, -1.0))])
        ledger = nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.05).run(0.2)
        print(ledger.column("kinetic"), ledger.column("closure_relative"))

    Parameters
    ----------
    transported : sequence of Variable
        Transported variables, e.g. ``(Distortion(), Jacobian())``.
    stored_energy : callable
        Function of the variables' values, by keyword, that returns the energy per actual volume, Pa, e.g.
        ``lambda F, J: 5 * square(F) / J ** (2/3) + 10 * (J - 1) ** 2``.  Joint convexity makes the ledger's
        Bregman column >= 0.
    bounds : mapping of names to callables, optional
        Functions of the variables' values, by keyword, that are > 0 where the energy has a value, e.g.
        ``{"room to stretch": lambda B, J: 3.05 - tr(B)}``.  Each is concave, or at least positive on a convex
        set.  The limiter and the refusal of steps keep them > 0, like J.
    rho_R : float, optional
        Referential density, kg/m^3, > 0.  With rho_R the initial density is rho_R/J, so that density and J
        determine each other.
    """

    energy_parameter = "stored_energy"

    transported: tuple[Variable, ...]
    stored_energy: Callable[..., CoefficientFunction]
    bounds: Mapping[str, Callable[..., CoefficientFunction]] = field(default_factory=dict, hash=False)
    rho_R: Annotated[Modulus | None, Quantity("kg/m^3", "> 0", 1000.0, "arithmetic")] = None

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "transported", tuple(self.transported))
        except TypeError:
            expected = "a sequence of Variable objects"
            raise ParameterError("CustomMaterial.transported", self.transported, expected) from None
        if not callable(self.stored_energy):
            expected = "a function of the variables"
            raise ParameterError("CustomMaterial.stored_energy", self.stored_energy, expected)
        names_and_functions = isinstance(self.bounds, Mapping) and all(
            isinstance(name, str) and callable(bound) for name, bound in self.bounds.items()
        )
        if not names_and_functions:
            expected = (
                "a mapping of names to functions, each of which takes the variables and is positive where "
                "the energy has a value"
            )
            raise ParameterError("CustomMaterial.bounds", self.bounds, expected)
        object.__setattr__(self, "bounds", dict(self.bounds))
        check_material(self)
        super().__post_init__()
        of_volume = (v.volume_ratio(v.from_distortion(IDENTITY)) for v in self.transported)
        if self.rho_R is not None and all(ratio is None for ratio in of_volume):
            expected = (
                ", since J follows from no variable; or add a variable that gives J, such as Jacobian()"
            )
            raise ParameterError("CustomMaterial.rho_R", self.rho_R, None, expected)
        check_energy(self)
        require_isotropy(self)
        for name, bound in self.bounds.items():
            check_bound(self, f"CustomMaterial.bounds[{name!r}]", bound)

    @property
    def variables(self) -> tuple[Variable, ...]:
        return self.transported

    @property
    def referential_density(self) -> Modulus | None:
        return self.rho_R

    def domain(self, z: Values) -> Values:
        told = self._told(z)
        return {name: bound(**told) for name, bound in self.bounds.items()}

    def energy(self, z: Values) -> CoefficientFunction:
        return self.stored_energy(**self._told(z))

    def _told(self, z: Values) -> Values:
        """The values for users' functions: parameters themselves replace their carried numbers."""
        means = (v for v in self.transported if isinstance(v, Parameter) and v.mean != "arithmetic")
        return {**z, **{v.name: v.at(z) for v in means}}
