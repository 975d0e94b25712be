"""The space that a material's state lives in: all components of its transported variables, side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.physics.tensors import TensorSpace, linear_map, tensor_space
from ngvisco.physics.variables import Values, Variable


class StateSpace:
    """Sizes, places and tensors of a material's variables on a mesh of dimension ``dim``.

    Attributes
    ----------
    size : int
        Number of components N of a state.
    slices : dict
        Where every variable's components stand, by its name.
    spaces : dict
        The space of tensors that a variable's values are in, by its name.
    strains : (size,) array of bool
        Which components are those of strains, and not of parameters.
    by_flux : (size,) array of bool
        Which components are densities, transported by their flux.
    densities : (size,) array
        rho is their sum times the components, kg/m^3, where amounts of matter are among these; else 0.
    """

    def __init__(self, variables: tuple[Variable, ...], dim: int) -> None:
        self.variables, self.dim = variables, dim
        self.spaces: dict[str, TensorSpace] = {v.name: tensor_space(v.kind, dim) for v in variables}
        self.slices: dict[str, slice] = {}
        start = 0
        for name, space in self.spaces.items():
            self.slices[name] = slice(start, start + space.size)
            start += space.size
        self.size = start
        self.strains, self.by_flux = np.ones(start, dtype=bool), np.zeros(start, dtype=bool)
        self.densities = np.zeros(start)
        for variable in variables:
            self.strains[self.slices[variable.name]] = variable.is_strain
            self.by_flux[self.slices[variable.name]] = variable.by_flux
            self.densities[self.slices[variable.name]] = variable.density

    @staticmethod
    @cache
    def of(variables: tuple[Variable, ...], dim: int) -> StateSpace:
        """The one of these variables."""
        return StateSpace(variables, dim)

    def tensor(self, name: str, components: CoefficientFunction) -> CoefficientFunction:
        """A variable's value, a scalar or 3x3, from all components: a coefficient function or an array."""
        where, space = self.slices[name], self.spaces[name]
        if space.is_scalar:
            return components[where.start]
        # one constant matrix that selects and embeds: far cheaper to linearise than component sums
        matrix = np.zeros((9, self.size))
        matrix[:, where] = space.columns
        return linear_map(matrix, components, (3, 3))

    def tensors(self, components: Callable[[], CoefficientFunction]) -> Values:
        """All values by name, each made where it is first asked for."""
        return _Tensors(self, components)

    def density(self, components: CoefficientFunction, size: int = 1) -> CoefficientFunction:
        """sum rho_i n_i of components, or of (components, ``size``) entries, a vector of ``size``."""
        return linear_map(np.kron(self.densities, np.eye(size)), components, (size,))

    def components(self, values: Values) -> CoefficientFunction:
        """All components of values by name, by orthogonal projection."""
        total = None
        for name, space in self.spaces.items():
            matrix = np.zeros((self.size, len(space.columns)))
            matrix[self.slices[name]] = space.columns.T
            value = space.components(values[name]) if space.is_scalar else values[name]
            part = linear_map(matrix, value, (self.size,))
            total = part if total is None else total + part
        return total


class _Tensors(Mapping[str, CoefficientFunction]):
    """Values by name that are made of the components where they are asked for."""

    def __init__(self, space: StateSpace, components: Callable[[], CoefficientFunction]) -> None:
        self._space, self._components = space, components
        self._made: dict[str, CoefficientFunction] = {}

    def __getitem__(self, name: str) -> CoefficientFunction:
        if name not in self._space.slices:
            raise KeyError(name)
        if name not in self._made:
            self._made[name] = self._space.tensor(name, self._components())
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._space.slices)

    def __len__(self) -> int:
        return len(self._space.slices)
