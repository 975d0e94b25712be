"""Norms of the scheme's terms as functions: Riesz representatives in the discontinuous spaces."""

import math
from collections.abc import Sequence
from typing import Any

from ngsolve import BilinearForm, BitArray, Integrate, LinearForm

from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand
from ngvisco.forms.terms.regularisation import DensityDiffusion, FieldDiffusion
from ngvisco.physics.tensors import inner, square


class DeltaTerms:
    """L2 norms of div(delta |grad rho|^{r-2} grad rho) and delta Laplace z, as the scheme has them.

    The function d of a term is defined by (d, w) = form(u; w) for all w of the space of rho or z.
    """

    def __init__(self, step: Step) -> None:
        law = step.model.regularisation
        assert law is not None
        self.step, self.law = step, law
        _, w = self._fields()
        now = step.now
        self._rho = _Representative(step, "rho", DensityDiffusion(law).form(now, w))
        self._z = _Representative(
            step, "z", FieldDiffusion(law, step.model.material, step.mesh.dim).form(now, w)
        )

    def _fields(self) -> tuple[Any, Any]:
        trial, test = self.step.layout.space.TnT()
        return self.step.layout.fields(trial), self.step.layout.fields(test)

    def compensating_force(self) -> float:
        """delta |grad rho|^{r-2} (grad v) grad rho in L^{r'}, of the momentum equation."""
        u, law = self.step.now, self.law
        force = law.diffusivity(square(u.grad_rho)) * (u.grad_v * u.grad_rho)
        dual = law.r / (law.r - 1)
        return float(Integrate(square(force) ** (0.5 * dual), self.step.mesh, order=8)) ** (1 / dual)

    def norms(self) -> tuple[float, float]:
        """Of the density's and of the fields' term at the present state."""
        return self._rho.norm(), self._z.norm()


class _Representative:
    def __init__(self, step: Step, block: str, integrands: Sequence[Integrand]) -> None:
        space = step.layout.space
        trial, test = space.TnT()
        u, w = step.layout.fields(trial), step.layout.fields(test)
        mass = BilinearForm(space, check_unused=False)
        mass += inner(getattr(u, block), getattr(w, block)) * step.quadrature.cells
        mass.Assemble()
        only = BitArray(space.ndof)
        only.Clear()
        only[step.layout.ranges[block]] = True
        self._inverse = mass.mat.Inverse(only, inverse="umfpack")
        self._load = LinearForm(space)
        step.quadrature.add(self._load, integrands)
        self._solution = self._load.vec.CreateVector()

    def norm(self) -> float:
        self._load.Assemble()
        self._solution.data = self._inverse * self._load.vec
        return math.sqrt(max(self._solution.InnerProduct(self._load.vec), 0.0))
