"""Passive fields: carried along by the flow after each accepted step, without any effect on it.

| name          | equation                                              | start |
|---------------|-------------------------------------------------------|-------|
| F_tot         | dt F + (v . grad) F = (grad v) F, total deformation   | I     |
| reference_map | dt xi + (v . grad) xi = 0, where a point came from, m | x     |
| creep_strain  | dt kappa + (v . grad) kappa = sqrt(2/3) |Pi|          | 0     |

Each is a linear problem with the step's velocity: implicit Euler and upwinding on discontinuous
P_k, k the velocity's order, as the scheme does for its own variables (with P_1 the gradient of xi in the
cells is less than half of what it should be at h = 0.2).  The columns of F_tot share one matrix, the
components of the others a second one; GMRES with cellwise blocks takes a few iterations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from ngsolve import (
    CF,
    L2,
    VOL,
    BilinearForm,
    CoefficientFunction,
    ElementId,
    FESpace,
    Grad,
    GridFunction,
    IfPos,
    LinearForm,
    Parameter,
    VectorL2,
    dx,
    specialcf,
    sqrt,
    x,
    y,
    z,
)
from ngsolve.krylovspace import GMRes

from ngvisco.errors import CheckpointError, UnknownNameError
from ngvisco.forms.system import Step
from ngvisco.forms.transport import Transport
from ngvisco.physics.tensors import inner, square

NAMES = ("F_tot", "reference_map", "creep_strain")


class PassiveFields:
    """The passive fields of a run.

    Parameters
    ----------
    step : Step
    names : sequence of str
        Some of ``NAMES``.

    Raises
    ------
    UnknownNameError
        For any other name.
    """

    def __init__(self, step: Step, names: Sequence[str]) -> None:
        for name in names:
            if name not in NAMES:
                raise UnknownNameError("passive field", name, NAMES)
        self.step, self.names = step, tuple(dict.fromkeys(names))
        self.tau = Parameter(1.0)
        self._v = step.now.v
        dim, order = step.mesh.dim, step.discretisation.k
        scalar = L2(step.mesh, order=order, dgjumps=True)
        vector = VectorL2(step.mesh, order=order, dgjumps=True)
        self._parts: dict[str, GridFunction] = {}
        self._sources: dict[str, CoefficientFunction] = {}
        self._solvers: dict[str, _Carrier] = {}
        if "F_tot" in self.names:
            self._add_group("F_tot", dim, _Carrier(vector, self._v, self.tau, step.now.grad_v))
            for j in range(dim):
                unit = CF(tuple(float(i == j) for i in range(dim)))
                self._parts[f"F_tot_{j + 1}"].Set(unit)
        flow = _Carrier(scalar, self._v, self.tau, None)
        if "reference_map" in self.names:
            self._add_group("reference_map", dim, flow)
            for i, coordinate in enumerate((x, y, z)[:dim]):
                self._parts[f"reference_map_{i + 1}"].Set(coordinate)
        if "creep_strain" in self.names:
            self._add_group("creep_strain", 1, flow)
            Pi = Transport(step.model, step.context).creep_rate(step.now)
            if Pi is not None:
                self._sources["creep_strain_1"] = sqrt(2 / 3 * square(Pi))

    def _add_group(self, name: str, count: int, carrier: _Carrier) -> None:
        for i in range(count):
            key = f"{name}_{i + 1}"
            self._parts[key] = GridFunction(carrier.space, name=key)
            self._solvers[key] = carrier

    @property
    def fields(self) -> dict[str, CoefficientFunction]:
        """Passive fields by name: F_tot 3x3 (plane strain in 2D), reference_map a vector, creep_strain."""
        dim, parts, result = self.step.mesh.dim, self._parts, {}
        if "F_tot" in self.names:
            columns = [parts[f"F_tot_{j + 1}"] for j in range(dim)]
            rows = [[columns[j][i] if max(i, j) < dim else float(i == j) for j in range(3)] for i in range(3)]
            result["F_tot"] = CF(tuple(entry for row in rows for entry in row), dims=(3, 3))
        if "reference_map" in self.names:
            result["reference_map"] = CF(tuple(parts[f"reference_map_{i + 1}"] for i in range(dim)))
        if "creep_strain" in self.names:
            result["creep_strain"] = parts["creep_strain_1"]
        return result

    def advance(self, tau: float) -> None:
        """Carry all fields over the step of length ``tau`` that has just been accepted."""
        self.tau.Set(tau)
        for carrier in dict.fromkeys(self._solvers.values()):
            carrier.update()
        for key, field in self._parts.items():
            self._solvers[key].carry(field, tau, self._sources.get(key))

    def arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint has to keep: copies of all coefficients by name."""
        return {key: field.vec.FV().NumPy().copy() for key, field in self._parts.items()}

    def load(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Take the coefficients of ``arrays()`` of an earlier run.

        Raises
        ------
        CheckpointError
            If one is missing or of another size.
        """
        for key, field in self._parts.items():
            if key not in arrays or arrays[key].shape != (len(field.vec),):
                raise CheckpointError(f"passive field {key}: missing in the checkpoint, or of another size")
            field.vec.FV().NumPy()[:] = arrays[key]


class _Carrier:
    """f/tau + (v . grad) f - A f = f_old/tau + source, with upwind jumps; one matrix for many fields.

    The forms are linear with the step's velocity as a coefficient, so that skeleton integrals are right.
    """

    def __init__(
        self, space: FESpace, v: CoefficientFunction, tau: Parameter, rate: CoefficientFunction | None
    ) -> None:
        self.space = space
        f, g = space.TnT()
        n = specialcf.normal(space.mesh.dim)
        across = v * n
        jump = f.Other() - f
        convected = Grad(f) * v if rate is not None else inner(Grad(f), v)
        if rate is not None:
            convected = convected - rate * f
        self.form = BilinearForm(space)
        self.form += (1 / tau) * inner(f, g) * dx + inner(convected, g) * dx
        # the cell that v enters takes the neighbour's value
        self.form += across * IfPos(across, inner(jump, g.Other()), inner(jump, g)) * dx(skeleton=True)
        self.mass = space.Mass(1)
        self._test = g
        self._blocks = [space.GetDofNrs(ElementId(VOL, i)) for i in range(space.mesh.ne)]
        self._preconditioner = None

    def update(self) -> None:
        """Assemble for the present velocity and step length."""
        self.form.Assemble()
        self._preconditioner = self.form.mat.CreateBlockSmoother(self._blocks)

    def carry(self, field: GridFunction, tau: float, source: CoefficientFunction | None) -> None:
        rhs = field.vec.CreateVector()
        rhs.data = (1 / tau) * (self.mass * field.vec)
        if source is not None:
            rhs.data += LinearForm(source * self._test * dx).Assemble().vec
        GMRes(
            A=self.form.mat,
            b=rhs,
            x=field.vec,
            pre=self._preconditioner,
            tol=1e-12 * rhs.Norm(),
            reltol=1e-12,
            maxsteps=200,
            printrates=False,
        )
