"""phi'(z) at the points of a rule and its derivative: by arrays, a material's response, or symbolically."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.forms.mesh.points import CellPoints
from ngvisco.forms.system import Step
from ngvisco.physics.arrays import slope_along
from ngvisco.physics.material import conjugates
from ngvisco.physics.pointwise import ExpressionResponse, array_slope, where_energy_is


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
            self.arrays = None
            return
        self.arrays, self.is_checked = array_slope(material, dim), False
        self.at, self.slope = points.function(self.components), points.function(self.components + 1)
        z = states.tensors(lambda: self.at)
        slope = states.components(conjugates(material, z))
        both = CF((*(slope[i] for i in range(self.components)), material.energy(z)))
        self.expression: CoefficientFunction = both.Compile()

    @property
    def is_local(self) -> bool:
        """Whether it is made of z at some points alone, by arrays that threads may share."""
        return self.arrays is not None and not self.lagged.any()

    def check(self, z_values: Callable[[], np.ndarray]) -> None:
        """See once, by z at all points, whether the energy by arrays is the one by its expression."""
        if self.arrays is not None and not self.is_checked:
            self._checked(np.ascontiguousarray(z_values().real))

    def __call__(self, z_values: np.ndarray) -> np.ndarray:
        """phi'(z), (n, points), for z at the points, (n, points), real or with a tiny imaginary part."""
        if not self.lagged.any():
            return self._whole(z_values)
        return np.where(self.lagged, self._whole(z_values), self._whole(self._seen(z_values)))

    def derivative(self, z_values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The map dz -> phi''(z) dz at the points, both (n, points), for z as above."""
        own = self._whole_derivative(z_values)
        if not self.lagged.any():
            return own
        of_others = self._whole_derivative(self._seen(z_values))
        return lambda dz: np.where(self.lagged, own(dz), of_others(np.where(self.lagged, 0.0, dz)))

    def hessian(self, z_values: np.ndarray) -> np.ndarray:
        """phi''(z), (n, n, points), for real z."""
        along = self.derivative(z_values)
        units = np.eye(self.components)[:, :, None]
        return np.stack([along(np.broadcast_to(e, z_values.shape)) for e in units], axis=1)

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
        arrays = self._checked(z_values)
        return self._by_expression(z_values) if arrays is None else arrays(z_values)

    def _whole_derivative(self, z_values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        if self.response is None and (arrays := self._checked(z_values)) is not None:
            return lambda dz: slope_along(arrays, z_values, dz)
        if self._curvature is None:
            self._curvature = by_expression = ExpressionResponse(self.material, self.dim)
            by_expression.check()
        hessian = self._curvature(z_values.T).hessian
        return lambda dz: np.einsum("pnm,mp->np", hessian, dz)

    def _checked(self, z_values: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        """The slope by arrays; None for an energy that means something else with them, or has none.

        That is seen once: where both slopes are numbers they have to agree, up to rounding of the largest.
        """
        if self.arrays is not None and not self.is_checked:
            self.is_checked = True
            # at rest much of an energy is zero, and agrees whatever it means, or only up to rounding
            away = z_values + 0.05 * np.random.default_rng(0).standard_normal(z_values.shape)
            slope, expected = (
                np.concatenate([by(z) for z in (z_values, away)], axis=1)
                for by in (self.arrays, self._by_expression)
            )
            known = np.isfinite(expected).all(axis=0)
            size = abs(expected[:, known]).max(initial=0.0)
            if not np.allclose(slope[:, known], expected[:, known], rtol=1e-9, atol=1e-12 * size):
                self.arrays = None
        return self.arrays

    def _by_expression(self, z_values: np.ndarray) -> np.ndarray:
        self.points.read(self.at, self.components)[:] = z_values
        self.slope.Interpolate(self.expression)
        *slope, energy = self.points.read(self.slope, self.components + 1).copy()
        return where_energy_is(energy, np.array(slope))
