"""How what the transport carries through facets changes in a direction of (v, rho, z)."""

from __future__ import annotations

import numpy as np

from ngvisco.solver.split.facets import Facets


class FacetChanges:
    """The derivative of ``Facets`` at its present state, for the direction of the last ``set``."""

    def __init__(self, facets: Facets) -> None:
        self.f = facets

    def update(self, z: np.ndarray) -> None:
        """Evaluate what all directions share, at coefficients ``z``."""
        f, eta = self.f, self.f.context.eta.Get()
        a = f.normal_velocity
        self._modulus = np.sqrt(a * a + eta * eta)
        self._inflow_slope = -0.5 * f.inner * eta * eta / self._modulus**3
        self._values = f.z(z)

    def set(self, dv: np.ndarray, dz: np.ndarray) -> None:
        """Evaluate the changes of the upwinding, of z's trace and of its jump."""
        f = self.f
        through = np.einsum("ip,ip->p", f.points.normals, f.v(dv))
        along = f.inner * through
        modulus = f.normal_velocity / self._modulus * along
        self.inflow = self._inflow_slope * through
        self.carried = through * f.inflow + f.through * self.inflow
        self.up, self.down = 0.5 * (modulus + along), 0.5 * (modulus - along)
        values = f.z(dz)
        trace = f.trace_mass.solve(f.hat.test((1 - f.inflow) * values - self.inflow * self._values))
        self.jump = f.hat(trace) - values

    def fields(self) -> np.ndarray:
        """Of the rows of z, as ``Facets.fields``."""
        return self.f.z.test(self.carried * self.f.jump + self.f.carried * self.jump)

    def density(self, drho: np.ndarray) -> np.ndarray:
        """Of the rows of rho, as ``Facets.density``."""
        f, rho = self.f, self.f.z(drho)
        loads = self.up * f.rho + f.up * rho - self.down * f.rho_hat
        trace = f.hat(f.density_mass.solve(f.hat.test(loads)))
        return f.z.test(self.up * f.rho + f.up * rho - self.down * f.rho_hat - f.down * trace)

    def elastic_force(self, zeta: np.ndarray, dzeta: np.ndarray) -> np.ndarray:
        """Of the rows of v, as ``Facets.elastic_force``."""
        f, at, change = self.f, self.f.z(zeta), self.f.z(dzeta)
        density = -self.inflow * np.einsum("np,np->p", f.jump, at)
        density -= f.inflow * np.einsum("np,np->p", self.jump, at)
        density -= f.inflow * np.einsum("np,np->p", f.jump, change)
        return f.v.test(density * f.points.normals)
