"""L2 projections, each on one space: no projection needs a matrix over all unknowns of a step.

The mass matrix of a facet unknown has one block per facet, and that of a cell unknown has one block per cell.
All components of a vector have the same matrix.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from ngsolve import (
    CF,
    H1,
    BaseMatrix,
    BilinearForm,
    CoefficientFunction,
    FESpace,
    GridFunction,
    LinearForm,
    Mesh,
    Periodic,
    VectorH1,
    VectorL2,
    dx,
    grad,
)

from ngvisco.forms.context import Context, StepLayout
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.mesh_arrays import rules
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.term import Integrand, Integrands, tested
from ngvisco.forms.unknown import Unknown
from ngvisco.forms.upwinding import mean_share
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.petsc import inverse_of, release
from ngvisco.physics.bodies import Interface, Layers
from ngvisco.physics.mixed_viscosity import MixedViscosity
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import inner, log


class LocalProjection:
    """Cellwise L2 projection of integrands in cells and on their boundaries to the function ``target``."""

    def __init__(self, target: GridFunction, quadrature: Quadrature, integrands: Integrands) -> None:
        self.target, space = target, target.space
        self.load = LinearForm(space)
        quadrature.add(self.load, integrands(space.TestFunction()))
        self.inverse_mass = inverse_mass(space, quadrature)

    def __call__(self) -> None:
        self.load.Assemble()
        self.target.vec.data = self.inverse_mass * self.load.vec


class FacetProjection:
    """Sets ``target``, a function of order 0, to means over facets. The mean is over both sides' values,
    weighted by their shares."""

    def __init__(
        self,
        target: GridFunction,
        quadrature: Quadrature,
        share: CoefficientFunction,
        value: CoefficientFunction,
        kept: Callable[[np.ndarray], np.ndarray] = lambda values: values,
    ) -> None:
        """``kept`` maps the computed values to the stored ones."""
        self.target, self._kept, space = target, kept, target.space
        self._exchange = Exchange.of(space, Communicator.of(space.mesh))
        test = space.TestFunction()
        mass, self.load = LinearForm(space), LinearForm(space)
        mass += quadrature.facets(share * test)
        self.load += quadrature.facets(share * value * test)
        areas = self._exchange.sum(mass.Assemble().vec.FV().NumPy().copy())
        self._areas = np.where(areas > 0, areas, 1.0)

    def __call__(self) -> None:
        loads = self._exchange.sum(self.load.Assemble().vec.FV().NumPy().copy())
        self.target.vec.FV().NumPy()[:] = self._kept(loads / self._areas)


class RecoveredSlope:
    """Slope in each cell K of a function s that is constant in cells: int_dK (s_hat - s) n over |K|.

    s_hat is the mean of both sides' values on facets, and s on walls.
    """

    def __init__(
        self,
        space: FESpace,
        quadrature: Quadrature,
        share: CoefficientFunction,
        normal: CoefficientFunction,
        value: CoefficientFunction,
    ) -> None:
        """``space`` has constants on facets; ``share`` is the share of a side's value in s_hat."""
        mean = GridFunction(space)
        self.target = GridFunction(VectorL2(quadrature.mesh, order=0))
        self._mean = FacetProjection(mean, quadrature, share, value)
        jump = mean - value
        self._project = LocalProjection(
            self.target, quadrature, lambda test: [Integrand(facets=jump * inner(normal, test))]
        )

    def __call__(self) -> None:
        self._mean()
        self._project()


class VertexSlope:
    """Slope of a function by means at vertices; a mean is over the cells at the vertex.

    The function may be constant in cells. The means define a continuous function, linear in simplices, and
    the result is the slope of this continuous function.  With ``of_slope`` the given function is a slope. The
    means then define the result itself, which is continuous and linear in simplices.  The normal of a curved
    interface then varies in a cell.
    """

    def __init__(self, mesh: Mesh, value: CoefficientFunction, periodic: bool, of_slope: bool) -> None:
        """``value`` is the function, or its slope in cells if ``of_slope``."""
        space, in_the_middle = (VectorH1 if of_slope else H1)(mesh, order=1), dx(intrules=rules(mesh.dim, 1))
        space = Periodic(space) if periodic else space
        test = space.TestFunction()
        self._exchange = Exchange.of(space, Communicator.of(mesh))
        self._recovered = GridFunction(space)
        self._load = LinearForm(inner(value, test) * in_the_middle)
        one = CF((1.0,) * mesh.dim) if of_slope else CF(1.0)
        volumes = self._summed(LinearForm(inner(one, test) * in_the_middle))
        self._volumes = np.where(volumes > 0, volumes, 1.0)
        self.target = self._recovered if of_slope else grad(self._recovered)

    def __call__(self) -> None:
        self._recovered.vec.FV().NumPy()[:] = self._summed(self._load) / self._volumes

    def _summed(self, form: LinearForm) -> np.ndarray:
        return self._exchange.sum(form.Assemble().vec.FV().NumPy().copy())


def slopes_of_interfaces(
    model: Model, layout: StepLayout, context: Context, quadrature: Quadrature
) -> dict[Interface, RecoveredSlope | VertexSlope]:
    """Slopes at a step's start, along the normals of interfaces.

    Fractions that are constant in cells need them; so do layered bodies, whose tension along an interface
    must not count as shear."""
    slopes: dict[Interface, RecoveredSlope | VertexSlope] = {}
    law, has_slopes = model.material.at_interfaces, layout.discretisation.m > 0
    if law is not None and (not has_slopes or isinstance(law, Layers)):
        of_cells = context.rates.slope_of_mean(law.interface, context.old)
        value = of_cells if has_slopes else log(law.interface.mean(context.old.z_tensors))
        slopes[law.interface] = VertexSlope(layout.mesh, value, layout.periodic, has_slopes)
    if has_slopes:
        return slopes
    series = model.viscosity.interface if isinstance(model.viscosity, MixedViscosity) else None
    if series is not None and series not in slopes:
        share, value = mean_share(context.inner), series.mean(context.old.z_tensors)
        of_facets = layout.scalar_space("z_hat")
        slopes[series] = RecoveredSlope(of_facets, quadrature, share, context.normal, value)
    return slopes


def inverse_mass(space: FESpace, quadrature: Quadrature) -> BaseMatrix:
    """Inverse of the cells' mass matrix by the rule of the forms.

    ``Mass`` has the inverse only for straight simplices without a weight.
    """
    if quadrature.has_constant_weights:
        return space.Mass(1).Inverse()
    trial, test = space.TnT()
    mass = BilinearForm(space, symmetric=True, condense=True)
    mass += quadrature.cells(inner(trial, test))
    mass.Assemble()
    return mass.inner_solve  # the inverse is made cell by cell, because all unknowns belong to cells


def project(
    unknown: Unknown, target: GridFunction, quadrature: Quadrature, value: CoefficientFunction
) -> None:
    """Set an evolving unknown to the L2 projection of ``value``, in cells or on its walls.

    Prescribed coefficients stay.
    """
    if unknown.is_local:
        LocalProjection(target, quadrature, tested(value))()
        return
    space = target.space
    trial, test = space.TnT()
    mass, load = BilinearForm(space, symmetric=True), LinearForm(space)
    weight, integral = (1.0, quadrature.cells) if unknown.on is None else (unknown.on, quadrature.walls)
    mass += integral(weight * inner(trial, test))
    load += integral(weight * inner(value - target, test))
    inverse = inverse_of(mass.Assemble().mat, space.FreeDofs(), Communicator.of(space.mesh))
    target.vec.data += inverse * load.Assemble().vec
    release(inverse)


def set_traces(layout: StepLayout, state: GridFunction, context: Context, quadrature: Quadrature) -> None:
    """Set the state's traces to the means of both sides' rho, z, ... and d_n v, by L2 projection on every
    facet."""
    parts, now = dict(zip(layout.names, state.components, strict=True)), Fields.of(layout, state.components)
    kinds: dict[tuple[str, int], list[Unknown]] = {}
    for name in layout.names_of("facets", "normals"):
        unknown = layout.unknowns[name]
        if unknown.trace_of is not None:
            kinds.setdefault((unknown.place, unknown.order), []).append(unknown)
    for (place, _), unknowns in kinds.items():
        space, n = layout.scalar_space(unknowns[0].name), context.normal
        # an unknown of ``normals`` is a multiple of the cells' outward normal
        trial, test = (f * n if place == "normals" else f for f in space.TnT())
        mass = BilinearForm(space)
        mass += quadrature.facets(trial * test)
        # facets of coarser meshes and identified copies are not free
        inverse = inverse_of(mass.Assemble().mat, space.FreeDofs(), Communicator.of(layout.mesh))
        for unknown in unknowns:
            target, traced = parts[unknown.name].vec, unknown.trace_of or ""
            value = (now.grad_v * n)[unknown.component] if place == "normals" else now.parts[traced]
            for i in range(value.dim):
                component = value[i] if value.dim > 1 else value
                row = (inverse * LinearForm(quadrature.facets(component * test)).Assemble().vec).Evaluate()
                target[i * len(row) : (i + 1) * len(row)] = row
        release(inverse)
