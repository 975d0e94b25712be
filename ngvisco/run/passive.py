"""Passive fields, which the flow carries by the run's own time scheme and which do not act on the flow.

| name          | equation                                              | start |
|---------------|-------------------------------------------------------|-------|
| F_tot         | dt F + (v . grad) F = (grad v) F, total deformation   | F_0   |
| reference_map | dt xi + (v . grad) xi = 0, where a point came from, m | x     |
| creep_strain  | dt kappa + (v . grad) kappa = sqrt(2/3) |Pi|, one field a branch in a network | 0 |

F_0 is the initial elastic distortion, since earlier creep is not known; F_tot equals F until creep sets in.
On meshes of two dimensions the entry F_33 is carried as a scalar unless it is 1; about an axis F_33 grows at
the rate v_r/r.

Each stage of the scheme is a linear problem with the stage's velocity: implicit Euler from the combination of
earlier stages that the scheme prescribes.  Transport has the upwind traces of the material's variables.
Passive fields are discontinuous P_k, with the velocity's order k: in P_1 the cellwise gradient of xi is less
than half of the right value at h = 0.2.  The columns of F_tot share one matrix, and the components of all
other fields share a second matrix; GMRES takes 10 to 20 iterations.  In place of xi the displacement x - xi
is carried, which is periodic in a periodic flow; xi may then lie outside the domain.  Matter that flows in
through a wall has the interior values, since its origin is not known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from ngsolve import CF, CoefficientFunction, FESpace, GridFunction, Mesh, sqrt, x, y, z

from ngvisco.errors import CheckpointError, InputWarning, ParameterError, require_known
from ngvisco.forms import carrier as transport
from ngvisco.forms.carrier import Carrier, cells_of
from ngvisco.forms.distances import Distances
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.tensors import IDENTITY, square

NAMES = ("F_tot", "reference_map", "creep_strain")
CARRIED = (*NAMES, "displacement")
"""Names of the output fields that passive fields give."""


class PassiveFields:
    """The passive fields of a run, some of ``NAMES``; ``F_0``, 3x3, is the start value of F_tot.

    Raises UnknownNameError for any other name; ParameterError for ``creep_strain`` without creep.
    """

    def __init__(self, step: Step, names: Sequence[str], F_0: CoefficientFunction = IDENTITY) -> None:
        require_known("passive field", names, NAMES, "passive")
        self.step, self.names = step, tuple(dict.fromkeys(names))
        dim = step.mesh.dim
        self._stages: list[dict[str, np.ndarray]] = []
        self._unsolved: set[str] = set()
        self._has_warned = False
        self.parts: dict[str, GridFunction] = {}
        """Carried grid functions by name; each one is a scalar or vector part of a field."""
        self._sources: dict[str, CoefficientFunction] = {}
        self._solvers: dict[str, Carrier] = {}
        if "F_tot" in self.names:
            self._add_group("F_tot", dim, Carrier(step, True, step.now.grad_v))
            for j in range(dim):
                self.parts[f"F_tot_{j + 1}"].Set(CF(tuple(F_0[i, j] for i in range(dim))))
        flow = Carrier(step, False, None)
        gap = F_0[2, 2] - 1
        hoop = step.now.hoop
        is_stretched = hoop is not None or (dim == 2 and step.quadrature.integrate_cells(gap * gap) > 0)
        if "F_tot" in self.names and is_stretched:
            self._add_group("F_tot_33", 1, flow if hoop is None else Carrier(step, False, hoop))
            self.parts["F_tot_33_1"].Set(F_0[2, 2])
        if "reference_map" in self.names:
            self._add_group("displacement", dim, flow)
            for i in range(dim):
                self._sources[f"displacement_{i + 1}"] = step.now.v[i]
        if "creep_strain" in self.names:
            rates = step.context.rates.mean_creep(step.now)
            if not rates:
                raise ParameterError("passive", "creep_strain", "no creep strain in a model without creep")
            for suffix, Pi in rates.items():
                self._add_group(f"creep_strain{suffix}", 1, flow)
                self._sources[f"creep_strain{suffix}_1"] = sqrt(2 / 3 * square(Pi))

        self.distances = Distances(step)
        """Distances from the bodies' outlines. The distances have a time scheme of their own."""
        self.parts |= {f"distance_{name}": part for name, part in self.distances.parts.items()}

    def _add_group(self, name: str, count: int, carrier: Carrier) -> None:
        for i in range(count):
            key = f"{name}_{i + 1}"
            self.parts[key] = GridFunction(carrier.cells, name=key)
            self._solvers[key] = carrier

    @property
    def fields(self) -> dict[str, CoefficientFunction]:
        """Passive fields by name: F_tot 3x3 (plane strain in 2D), reference_map and displacement (x less
        the reference map) vectors, creep_strain.
        """
        dim, parts, result = self.step.mesh.dim, self.parts, {}
        if "F_tot" in self.names:
            columns = [parts[f"F_tot_{j + 1}"] for j in range(dim)]
            rows = [[columns[j][i] if max(i, j) < dim else float(i == j) for j in range(3)] for i in range(3)]
            if "F_tot_33_1" in parts:
                rows[2][2] = parts["F_tot_33_1"]
            result["F_tot"] = CF(tuple(entry for row in rows for entry in row), dims=(3, 3))
        if "reference_map" in self.names:
            moved = [parts[f"displacement_{i + 1}"] for i in range(dim)]
            result["reference_map"] = CF(tuple(c - u for c, u in zip((x, y, z), moved, strict=False)))
            result["displacement"] = CF(tuple(moved))
        strains = (key for key in parts if key.startswith("creep_strain"))
        result |= {key.removesuffix("_1"): parts[key] for key in strains}
        return result

    def space(self, key: str, mesh: Mesh) -> FESpace:
        """The space of the part ``key`` on another mesh."""
        return cells_of(mesh, self.step.discretisation.k, key in self._solvers and self._solvers[key].vector)

    @property
    def unsolved(self) -> int:
        """Number of parts whose systems are not solved in the present step; the step itself does not depend
        on these parts."""
        return len(self._unsolved)

    def begin(self) -> None:
        """Begin a step: forget the stages since the last accepted step."""
        first = {key: self.parts[key].vec.FV().NumPy().copy() for key in self._solvers}
        self._stages, self._unsolved = [first], set()

    def stage(self, weights: np.ndarray, share: float = 1.0) -> None:
        """Carry all fields over a stage, which starts from the weighted sum of the stages so far.

        The present state and the length in the step's context must be the stage's.
        """
        for carrier in dict.fromkeys(self._solvers.values()):
            carrier.form.Assemble()  # assembles the matrix for the present velocity and step length
        carried = {}
        for key, solver in self._solvers.items():
            old = _combined(weights, self._stages, key)
            carried[key], is_solved = solver.carry(old, self._sources.get(key))
            if not is_solved:
                self._unsolved.add(key)
        self._stages.append(carried)
        if self._unsolved and not self._has_warned:
            self._has_warned = True
            names = ", ".join(sorted(self._unsolved))
            message = (
                f"no solution was found in {transport.ITERATIONS} iterations for the components {names} of "
                "passive fields. The step itself is solved, and the ledger's column passive_unsolved counts "
                "such components; take smaller steps"
            )
            Communicator.of(self.step.mesh).warn(message, InputWarning, stacklevel=2)

    def end(self, weights: np.ndarray) -> None:
        """Accept the step: the fields become the weighted sum of its stages."""
        for key in self._solvers:
            self.parts[key].vec.FV().NumPy()[:] = _combined(weights, self._stages, key)

    def arrays(self) -> dict[str, np.ndarray]:
        """Copies of all coefficients for a checkpoint, by the parts' names."""
        return {key: field.vec.FV().NumPy().copy() for key, field in self.parts.items()}

    def load(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Load the coefficients that ``arrays()`` gave in an earlier run.

        Raises CheckpointError if an array is missing or of another size.
        """
        for key, field in self.parts.items():
            if key not in arrays or arrays[key].shape != (len(field.vec),):
                message = f"the passive field {key} is missing in the checkpoint, or has another size there"
                raise CheckpointError(message)
            field.vec.FV().NumPy()[:] = arrays[key]


def _combined(weights: np.ndarray, stages: Sequence[Mapping[str, np.ndarray]], key: str) -> np.ndarray:
    """Weighted sum of a part's stages so far; weights of later stages are 0."""
    return sum(weight * stage[key] for weight, stage in zip(weights, stages, strict=False) if weight != 0)
