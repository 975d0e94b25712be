"""The unknowns that the split solver iterates on, packed into one vector."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from ngvisco.forms.spaces import Layout
from ngvisco.forms.system import Step
from ngvisco.parallel.exchange import Exchange


def in_cells(layout: Layout) -> list[str]:
    """Names of the iterated unknowns that have values in cells, and the name zeta."""
    continuous = [name for name in layout.names_of("continuous") if layout.unknowns[name].space is None]
    return ["v", *(["rho"] if "rho" in layout.unknowns else []), "z", "zeta", *continuous]


def derived_in_cells(layout: Layout) -> list[str]:
    """Names of the derived unknowns that have values in cells and no gradients: the hyperviscosity's local
    unknowns, and means over cells."""
    constants = [name for name in layout.names_of("cells") if layout.unknowns[name].is_mean]
    return [*(name for name in ("hess", "hess_square") if name in layout.unknowns), *constants]


class Unknowns:
    """Packs the iterated unknowns of the state into one vector, and unpacks them.

    The vector has the following blocks in this order.  ``velocity_block`` is v, and the wall stress and the
    creep rate field if the step has them; ``normals`` are the facets' normal derivatives; ``density`` is rho,
    and its traces if the continuity equation is not linear; the last block is z.  With bodies rho is not an
    unknown but a sum of components of z.
    """

    def __init__(self, step: Step) -> None:
        layout = step.layout
        self._step, self.ranges = step, layout.ranges
        self.velocity_block = layout.names_of("velocity", "walls", "continuous")
        self.normals = layout.names_of("normals")
        self.density = ["rho"] if "rho" in layout.unknowns else []
        if density_by_forms(step):
            facets = layout.names_of("facets")
            self.density += [name for name in facets if layout.unknowns[name].trace_of == "rho"]
        self.names = [*self.velocity_block, *self.normals, *self.density, "z"]
        sizes = {name: layout.unknowns[name].size for name in self.names}
        self.components = {name: size for name, size in sizes.items() if size is not None}
        lengths = [self.ranges[name].stop - self.ranges[name].start for name in self.names]
        ends = np.cumsum([0, *lengths]).tolist()
        self.slices = dict(zip(self.names, map(slice, ends[:-1], ends[1:]), strict=True))
        self.size = ends[-1]
        self.flow_slice, self.normal_slice, self.density_slice = map(
            self._joint, (self.velocity_block, self.normals, self.density)
        )

    def _joint(self, names: list[str]) -> slice:
        """The slice of several consecutive blocks."""
        return slice(self.slices[names[0]].start, self.slices[names[-1]].stop) if names else slice(0, 0)

    @property
    def state(self) -> np.ndarray:
        """The coefficients of the step's state, for reading and writing; do not store this view."""
        return self._step.state.vec.FV().NumPy()

    def pack(self) -> np.ndarray:
        """A copy of the iterated unknowns of the state."""
        return np.concatenate([self.state[self.ranges[name]] for name in self.names])

    def unpack(self, x: np.ndarray, derived: Mapping[str, np.ndarray] | None = None) -> None:
        """Put packed unknowns ``x``, and coefficients of ``derived`` unknowns by name, into the state."""
        for name in self.names:
            self.state[self.ranges[name]] = x[self.slices[name]]
        for name, values in (derived or {}).items():
            if name in self.ranges and name not in self.slices:
                self.state[self.ranges[name]] = values.ravel()

    def places(self, names: Iterable[str]) -> np.ndarray:
        """Indices of the unknowns ``names`` in the state, one unknown after the other."""
        return np.concatenate([np.arange(self.ranges[n].start, self.ranges[n].stop) for n in names])

    def coefficients(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """The iterated unknowns by name, (components, functions); "a" has all normal derivatives."""
        result = {name: x[self.slices[name]] for name in self.names if name not in self.normals}
        for name, count in self.components.items():
            result[name] = result[name].reshape(count, -1)
        if self.normals:
            result["a"] = x[self.normal_slice].reshape(len(self.normals), -1)
        return result

    def scales(self, x: np.ndarray, exchange: Exchange) -> np.ndarray:
        """Scales of the unknowns in norms of vectors: the norm of the unknown's block, times 1000 if the
        unknown follows from v.

        ``exchange`` belongs to the packed unknowns.
        """
        scale = np.ones_like(x)
        for name, where in self.slices.items():
            size = exchange.norm(x, where) * (1.0 if self._step.layout.unknowns[name].evolves else 1e3)
            scale[where] = size or 1.0
        return scale


def density_by_forms(step: Step) -> bool:
    """Whether a cut-off or the delta-regularisation makes the continuity equation nonlinear in rho."""
    law = step.model.regularisation
    return law is not None and law.bends_the_flux
