"""A velocity as what goes through each facet: the mean of its normal component, one number a facet."""

from ngsolve import CoefficientFunction, GridFunction, HDiv, Mesh


class FacetFlux:
    """The Raviart-Thomas field of lowest order with a velocity's mean normal components.

    With fields of order 0 a trace has one value a facet.  By sides that differ from point to point it is a
    mean of both cells' values where v . n changes its sign along the facet, and what leaves a cell is taken
    from its neighbour too: a density may become negative.  By the side of the mean it is the value of one
    cell, and the implicit step has an M-matrix.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    velocity : CoefficientFunction
        m/s, a polynomial of order ``order``.
    """

    def __init__(self, mesh: Mesh, velocity: CoefficientFunction, order: int) -> None:
        self.function = GridFunction(HDiv(mesh, order=0, RT=True))
        self._velocity, self._order = velocity, order

    def __call__(self) -> None:
        """Follow the present velocity."""
        self.function.Set(self._velocity, dual=True, bonus_intorder=self._order)
