"""phi'(z) at the points of a rule and its derivative: by arrays, a material's response, or symbolically."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.forms.mesh.points import CellPoints
from ngvisco.forms.system import Step
from ngvisco.physics.arrays import slope_along
from ngvisco.physics.material import conjugates
from ngvisco.physics.pointwise import array_slope, respond


class PointwiseSlope:
    """phi'(z) at the points of a rule, in components."""

    def __init__(self, step: Step, points: CellPoints) -> None:
        self.material, self.dim = material, dim = step.model.material, step.mesh.dim
        states = step.layout.states
        self.components, self.points, self._step = states.size, points, step
        self.lagged = np.zeros((states.size, 1), dtype=bool)
        """Components of lagged variables."""
        for name in material.lagged:
            self.lagged[states.slices[name]] = True
        self._frozen: tuple[np.ndarray, np.ndarray] | None = None
        self.response = self._curvature = material.response(dim)
        if self.response is not None:
            return
        self.arrays, self.is_checked = array_slope(material, dim), False
        self.at, self.slope = points.function(self.components), points.function(self.components)
        expression = states.components(conjugates(material, states.tensors(lambda: self.at)))
        if self.components == 1:
            expression = CF((expression[0], 0.0))
        self.expression: CoefficientFunction = expression.Compile()

    def __call__(self, z_values: np.ndarray) -> np.ndarray:
        """phi'(z), (n, points), for z at the points, (n, points), real or with a tiny imaginary part."""
        if not self.lagged.any():
            return self._whole(z_values)
        return np.where(self.lagged, self._whole(z_values), self._whole(self._seen(z_values)))

    def _seen(self, z_values: np.ndarray) -> np.ndarray:
        """z as the conjugates of what does not lag see it."""
        lagged = self._step.lagged
        assert lagged is not None
        values = lagged.vec.FV().NumPy()
        if self._frozen is None or not np.array_equal(self._frozen[0], values):
            at_points = self.points.function(self.components)
            at_points.Interpolate(lagged)
            self._frozen = values.copy(), self.points.read(at_points, self.components).copy()
        return np.where(self.lagged, self._frozen[1], z_values)

    def _whole(self, z_values: np.ndarray) -> np.ndarray:
        """phi'(z) of all variables at one z."""
        if np.iscomplexobj(z_values):
            z, dz = np.ascontiguousarray(z_values.real), np.ascontiguousarray(z_values.imag)
            return self._whole(z) + 1j * self._whole_derivative(z)(dz)
        if self.response is not None:
            return np.ascontiguousarray(self.response(z_values.T).slope.T)
        if self.arrays is None:
            return self._by_expression(z_values)
        slope = self.arrays(z_values)
        if not self.is_checked:
            self.is_checked = True
            # at rest much of an energy is zero, and agrees whatever it means, or only up to rounding
            away = z_values + 0.05 * np.random.default_rng(0).standard_normal(z_values.shape)
            if not self._agrees(z_values, away):
                self.arrays = None  # an energy that means something else with arrays
                return self._by_expression(z_values)
        return slope

    def _agrees(self, *states: np.ndarray) -> bool:
        """Whether both slopes are the same, where they are numbers, up to rounding of the largest."""
        assert self.arrays is not None
        slope = np.concatenate([self.arrays(z) for z in states], axis=1)
        expected = np.concatenate([self._by_expression(z) for z in states], axis=1)
        known = np.isfinite(expected).all(axis=0)
        size = abs(expected[:, known]).max(initial=0.0)
        return np.allclose(slope[:, known], expected[:, known], rtol=1e-9, atol=1e-12 * size)

    def derivative(self, z_values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The map dz -> phi''(z) dz at the points, both (n, points), for z as above."""
        own = self._whole_derivative(z_values)
        if not self.lagged.any():
            return own
        of_others = self._whole_derivative(self._seen(z_values))
        return lambda dz: np.where(self.lagged, own(dz), of_others(np.where(self.lagged, 0.0, dz)))

    def _whole_derivative(self, z_values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        arrays = self.arrays if self.response is None else None
        if arrays is not None:
            return lambda dz: slope_along(arrays, z_values, dz)
        if self._curvature is None:
            self._curvature = respond(self.material, self.dim)
        hessian = self._curvature(z_values.T).hessian
        return lambda dz: np.einsum("pnm,mp->np", hessian, dz)

    def _by_expression(self, z_values: np.ndarray) -> np.ndarray:
        self.points.read(self.at, self.components)[:] = z_values
        self.slope.Interpolate(self.expression)
        return self.points.read(self.slope, self.components).copy()
