"""Motion that no variable feels: the part of a velocity of order k beyond the order m + 1 within cells.

grad P_{m+1} = P_m: a variable of order m in cells feels the strains of velocities up to the order m + 1.  For
m < k - 1 only inertia and viscosity act on velocities of higher order. For k, m = 1, 0 or 2, 1 no velocity is
of higher order. A wave in a box without viscosity, for k = 2 and m = 0, has 63 % of its kinetic energy beyond
P_1 after 2 s: a run needs a viscosity or a hyperviscosity that damps this motion.  With the cellwise
projection Pi onto P_{m+1},

    unfelt = 1/2 int rho |v - Pi v|^2 >= 0,

which is of order h^{2m + 4} for smooth motion.
"""

from __future__ import annotations

import numpy as np
from ngsolve import CF, CoefficientFunction, GridFunction, VectorL2

from ngvisco.errors import InputWarning, ParameterError
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.projections import LocalProjection
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.term import tested
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.model import Model
from ngvisco.physics.parameters import typical_value
from ngvisco.physics.rheology import StokesViscosity
from ngvisco.physics.tensors import square
from ngvisco.words import call

UNFELT = "unfelt"
"""Ledger column of the energy of unfelt motion, J, in runs with m < k - 1."""
_SHARE = 0.1
"""Share of the kinetic energy above which a warning is given."""


def require_held(model: Model, orders: Discretisation) -> None:
    """Raise ParameterError for m < k - 1 if nothing damps the motion that no variable feels.

    A hyperviscosity, or a shear viscosity in every body, damps such motion.
    """
    k, m = orders.k, orders.m
    if m >= k - 1 or model.hyperviscosity is not None:
        return
    laws = {f" of the body {body.name!r}": body.viscosity for body in model.bodies} or {"": model.viscosity}
    for whose, law in laws.items():
        if law is None or (isinstance(law, StokesViscosity) and typical_value(law.G_v) == 0):
            expected = (
                f"{k - 1}, or ",
                call("Discretisation", k=m + 1, m=m),
                f", or a shear viscosity{whose}, since with k = {k} "
                f"and m = {m} no other stress resists motion within cells",
            )
            raise ParameterError("Discretisation.m", m, *expected)


class Unfelt:
    """Measure of the unfelt motion of a state, with one warning if its share is large."""

    def __init__(self, u: Fields, quadrature: Quadrature, m: int) -> None:
        self.quadrature, self.is_said, mesh = quadrature, False, quadrature.mesh
        self._ranks = Communicator.of(mesh)
        within = GridFunction(VectorL2(mesh, order=m + 1))
        self._project = LocalProjection(within, quadrature, tested(u.v))
        self._densities: CoefficientFunction = CF(
            (0.5 * u.rho * square(u.v - within), 0.5 * u.rho * square(u.v))
        ).Compile()

    def __call__(self) -> float:
        """Energy of the unfelt motion at the present state, J."""
        self._project()
        unfelt, kinetic = (float(E) for E in np.asarray(self.quadrature.integrate_cells(self._densities)))
        if unfelt > _SHARE * kinetic and not self.is_said:
            self.is_said = True
            message = (
                f"{unfelt / kinetic:.0%} of the kinetic energy is motion within cells that no stress "
                "resists; take discretisation.m = k - 1, or a shear viscosity"
            )
            self._ranks.warn(message, InputWarning, stacklevel=4)
        return unfelt
