"""The unknowns that the split solver iterates on, packed into one vector, as are their equations' rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from ngvisco.forms.spaces import Layout
from ngvisco.forms.system import Step
from ngvisco.parallel.exchange import Exchange


def in_cells(layout: Layout) -> list[str]:
    """Unknowns with values at the points of cells: those that are iterated on, and zeta."""
    continuous = [name for name in layout.names_of("continuous") if layout.unknowns[name].space is None]
    density = ["rho"] if "rho" in layout.unknowns else []
    return ["v", *density, "z", "zeta", *continuous]


def derived_in_cells(layout: Layout) -> list[str]:
    """Names of the hyperviscosity's unknowns and of means over cells, which have values there too, and no
    gradients."""
    constants = [name for name in layout.names_of("cells") if layout.unknowns[name].is_mean]
    return [*(name for name in ("hess", "hess_square") if name in layout.unknowns), *constants]


class Unknowns:
    """Views of the state's blocks and a packed copy of those that are iterated.

    ``flow`` are v, the wall stress and the creep rate field where there are such; ``normals`` the facets'
    normal derivatives; ``density`` rho, which of bodies is a sum of components of z and no unknown, and its
    traces where its equation is not linear; then comes z.
    """

    def __init__(self, step: Step) -> None:
        layout = step.layout
        self._step, self.ranges = step, layout.ranges
        self.flow = layout.names_of("velocity", "walls", "continuous")
        self.normals = layout.names_of("normals")
        self.density = ["rho"] if "rho" in layout.unknowns else []
        if density_by_forms(step):
            facets = layout.names_of("facets")
            self.density += [name for name in facets if layout.unknowns[name].trace_of == "rho"]
        self.names = [*self.flow, *self.normals, *self.density, "z"]
        sizes = {name: layout.unknowns[name].size for name in self.names}
        self.components = {name: size for name, size in sizes.items() if size is not None}
        lengths = [self.ranges[name].stop - self.ranges[name].start for name in self.names]
        ends = np.cumsum([0, *lengths]).tolist()
        self.slices = dict(zip(self.names, map(slice, ends[:-1], ends[1:]), strict=True))
        self.size = ends[-1]
        self.flow_slice, self.normal_slice, self.density_slice = map(
            self._joint, (self.flow, self.normals, self.density)
        )

    def _joint(self, names: list[str]) -> slice:
        """The slice of blocks that follow each other."""
        return slice(self.slices[names[0]].start, self.slices[names[-1]].stop) if names else slice(0, 0)

    @property
    def state(self) -> np.ndarray:
        """The coefficients of the step's state, for reading and writing; nothing keeps this view."""
        return self._step.state.vec.FV().NumPy()

    def pack(self) -> np.ndarray:
        """A copy of the iterated unknowns of the state."""
        return np.concatenate([self.state[self.ranges[name]] for name in self.names])

    def unpack(self, x: np.ndarray, derived: Mapping[str, np.ndarray] | None = None) -> None:
        """Put them into the state, and coefficients of other unknowns, by name."""
        for name in self.names:
            self.state[self.ranges[name]] = x[self.slices[name]]
        for name, values in (derived or {}).items():
            if name in self.ranges and name not in self.slices:
                self.state[self.ranges[name]] = values.ravel()

    def places(self, names: Iterable[str]) -> np.ndarray:
        """Where the unknowns ``names`` stand in the state, one after the other."""
        return np.concatenate([np.arange(self.ranges[n].start, self.ranges[n].stop) for n in names])

    def coefficients(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """The iterated unknowns by name, (components, functions); the normal derivatives together as a."""
        result = {name: x[self.slices[name]] for name in self.names if name not in self.normals}
        for name, count in self.components.items():
            result[name] = result[name].reshape(count, -1)
        if self.normals:
            result["a"] = x[self.normal_slice].reshape(len(self.normals), -1)
        return result

    def scales(self, x: np.ndarray, exchange: Exchange) -> np.ndarray:
        """The size of each one's block, for lengths; a thousand times that for what v determines.

        ``exchange`` is that of the packed unknowns.
        """
        scale = np.ones_like(x)
        for name, where in self.slices.items():
            size = exchange.norm(x, where) * (1.0 if self._step.layout.unknowns[name].evolves else 1e3)
            scale[where] = size or 1.0
        return scale


def density_by_forms(step: Step) -> bool:
    """Whether the continuity equation is not linear in rho: with a cut-off or delta-regularisation."""
    law = step.model.regularisation
    return law is not None and law.bends_the_flux
