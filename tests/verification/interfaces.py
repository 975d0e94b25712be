"""Bodies carried by given flows: how far their interfaces smear, by the package's own terms and limiters.

The flows are incompressible and steady but for a factor of time, v = c(t) w.  Their transport matrix is
M/tau + |c| K^+-, with K of the flow or of its reverse, linearised once from the terms of the equations; a
step is one sparse solve.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import scipy.sparse as sp
from ngsolve import (
    CF,
    BilinearForm,
    CoefficientFunction,
    FESpace,
    GridFunction,
    IfPos,
    Integrate,
    Mesh,
    TaskManager,
    x,
    y,
)
from scipy.sparse.linalg import splu

import ngvisco as nv
from ngvisco.forms.bounds import Bounds
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.start.initial import set_initial
from ngvisco.forms.system import Step
from ngvisco.forms.terms.transport import Kinematics, UpwindTrace
from ngvisco.physics.materials.heterogeneous import Heterogeneous
from ngvisco.physics.mixture import AMOUNT

Carrier: TypeAlias = Literal["amounts", "rate zero", "reference map"]
"""Conserved amounts of bodies, a parameter with rate zero, or a function of carried coordinates."""


Level: TypeAlias = Callable[[CoefficientFunction, CoefficientFunction], CoefficientFunction]
"""A function of two coordinates."""


@dataclass(frozen=True)
class Smear:
    """What is left of a body at the end.

    Attributes
    ----------
    error : float
        L1 distance of the fraction from the exact one over the body's area.
    width : float
        Area where the fraction is from 0.05 to 0.95 over the length of the interface, in cells' sizes.
    least, largest : float
        Of the fraction.
    drift : float
        Relative change of the body's area.
    """

    error: float
    width: float
    least: float
    largest: float
    drift: float


def carried(
    shape: nv.Shape,
    level: Level,
    perimeter: float,
    flow: tuple[CoefficientFunction, CoefficientFunction],
    factor: Callable[[float], float],
    end: float,
    *,
    mesh: Mesh,
    maxh: float,
    m: int,
    carrier: Carrier,
    tau: float = 0.01,
    midpoint: bool = True,
) -> Smear:
    """A body of this shape after a flow that brings it back to where it was.

    Parameters
    ----------
    level : callable
        The function of the place that is > 0 inside it.
    perimeter : float
        Length of its boundary, m.
    flow : two coefficient functions
        w, m/s.
    factor : callable
        c of t, s.
    end : float
        s.
    tau : float
        Length of the steps, s, of the midpoint rule or of backward Euler; their ends are limited.
    """
    fluid = nv.BarotropicFluid(B=1.0, gamma=1.4)
    exact = shape.inside(mesh, max(m, 1))
    if carrier == "amounts":
        bodies = (
            nv.Body(name="body", where=shape, material=fluid, density=1.0),
            nv.Body(name="rest", material=fluid, density=1.0),
        )
        model, names = nv.Model(bodies=bodies), [AMOUNT + "body", AMOUNT + "rest"]
    else:
        starts = {"theta": exact} if carrier == "rate zero" else {"X": x, "Y": y}
        parameters = tuple(nv.Parameter(name, start=start) for name, start in starts.items())
        model, names = nv.Model(material=Heterogeneous(material=fluid, carried=parameters)), list(starts)
    step = Step(mesh, model, nv.Discretisation(m=m))
    sampler = Sampler(mesh, step.quadrature)
    set_initial(step, nv.Initial(), sampler)
    bounds = Bounds(step, sampler)
    transport = _Transport(step, flow, names, tau)
    area = _area(exact)
    t = 0.0
    while t < end - 0.5 * tau:
        transport.advance(factor(t + 0.5 * tau) if midpoint else factor(t + tau), midpoint)
        bounds.limit()
        t += tau
    values = step.now.z_tensors
    theta = values[names[0]]
    if carrier == "amounts":
        theta = theta / (theta + values[names[1]])
    elif carrier == "reference map":
        theta = IfPos(level(values["X"], values["Y"]), 1.0, 0.0)
    at = sampler.values(theta)
    partial = _integral(mesh, _between(theta))
    error = _integral(mesh, _size(theta - exact))
    return Smear(
        error / area,
        partial / perimeter / maxh,
        float(at.min()),
        float(at.max()),
        _integral(mesh, theta) / area - 1,
    )


class _Transport:
    """Implicit Euler steps of some scalar variables by a given flow."""

    def __init__(
        self, step: Step, flow: tuple[CoefficientFunction, ...], names: list[str], tau: float
    ) -> None:
        self.step, self.tau, self._factor = step, tau, np.nan
        space, size = step.layout.blocks["z"], step.layout.states.size
        hat = step.layout.blocks["z_hat"]
        self._per = space.ndof // size, hat.ndof // size
        self._components = [step.layout.states.slices[name].start for name in names]
        mass, one = self._matrix(flow, 1.0), self._matrix(flow, 2.0)
        self._mass = (mass[0] - one[0]) * 2.0  # rows of z: M/tau + K at tau = 1 and 2
        self._flows = {1.0: self._matrix(flow, 1.0), -1.0: self._matrix(tuple(-v for v in flow), 1.0)}

    def _matrix(self, flow: tuple[CoefficientFunction, ...], tau: float) -> list[sp.csr_matrix]:
        """Blocks (z, z), (z, z_hat), (z_hat, z), (z_hat, z_hat) of the first of the components."""
        step = self.step
        layout = step.layout
        space = FESpace([layout.blocks["z"], layout.blocks["z_hat"]])
        v = GridFunction(layout.blocks["v"])
        v.Set(CF(flow))
        step.wind.Set(CF(flow))
        step.follow_wind()
        (z, z_hat), (G, G_hat) = space.TnT()
        step.context.set_step(tau, 0.0, 0.0, tau)
        step.context.eta.Set(1e-4)
        u = Fields(layout, {"v": v, "z": z, "z_hat": z_hat})
        w = Fields(layout, {"z": G, "z_hat": G_hat})
        form = BilinearForm(space)
        for term in (Kinematics(step.model), UpwindTrace()):
            step.quadrature.add(form, term.form(u, w))
        with TaskManager():
            form.AssembleLinearization(GridFunction(space).vec)
        matrix = csr(form.mat)
        i, (n, h) = self._components[0], self._per
        own = slice(i * n, (i + 1) * n)
        start = layout.blocks["z"].ndof + i * h
        trace = slice(start, start + h)
        return [matrix[rows, columns].tocsc() for rows in (own, trace) for columns in (own, trace)]

    def advance(self, factor: float, midpoint: bool) -> None:
        """One step by ``factor`` times the flow."""
        length = self.tau / 2 if midpoint else self.tau
        if factor != self._factor:
            self._factor, self._solve = factor, self._factorised(factor, length)
        values = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
        values = values.reshape(self.step.layout.states.size, -1)
        for i in self._components:
            load = np.concatenate([self._mass @ values[i] / length, np.zeros(self._per[1])])
            end = self._solve(load)[: self._per[0]]
            values[i] = 2 * end - values[i] if midpoint else end

    def _factorised(self, factor: float, length: float) -> Callable[[np.ndarray], np.ndarray]:
        of_z, of_hat, hat_z, hat_hat = self._flows[1.0 if factor >= 0 else -1.0]
        K, C = abs(factor) * (of_z - self._mass), abs(factor) * of_hat
        solve: Callable[[np.ndarray], np.ndarray] = splu(
            sp.bmat([[self._mass / length + K, C], [hat_z, hat_hat]], format="csc")
        ).solve
        return solve


def _area(theta: GridFunction) -> float:
    return _integral(theta.space.mesh, theta)


def _integral(mesh: Mesh, f: CoefficientFunction) -> float:
    return float(Integrate(f, mesh, order=8))


def _size(f: CoefficientFunction) -> CoefficientFunction:
    return IfPos(f, f, -f)


def _between(theta: CoefficientFunction) -> CoefficientFunction:
    return IfPos(theta - 0.05, IfPos(0.95 - theta, 1.0, 0.0), 0.0)
