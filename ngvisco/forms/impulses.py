"""Changes of a body's momentum in a step: impulses by name, and the defects of the discretisation.

The equations of a step are tested with rigid motions e, which are the constants and the rotations about the
origin. On straight cells rigid motions belong to the velocity's space.  With the momentum functional <m, w>
= int rho v . w

    <m - m_old, e>/tau = sum of forces + thrust of jumps + rest of cells + rest of inertia.

The force of each load and wall is -form(u; e).  The rows of R at coefficients of v that walls hold are not
solved. The walls' force is the sum R(u; e) of these rows, together with the pressure that B_h omits on a
closed wall (``ngvisco.forms.reactions``).  Viscous and hyperviscous stresses have no power at e.  The other
summands vanish for the exact solution; they are momentum that the scheme creates:

- **inertia**: the skew form has half the continuity equation tested with v . e, and v . e is not in the space
  of rho; ``MomentumBalance`` compensates for it if e is constant, and not if e is a rotation;
- **facets**: the elastic force B_h(e; z, zeta) has the facets' share

      sum_K int_{dK} (e . n) ((z_hat - z) : zeta + phi(z)),

  less the parts of ``TangentForce`` and of walls that matter crosses. The thrust of a jump remains where a
  trace has no energy;
- **cells**: the rest of B_h(e; z, zeta) without the shares of facets and walls. It has three causes: the
  quadrature of phi in cells and on facets; on curved cells the projection of (e . grad) z; conjugates of
  another state (``Material.lagged``).

Rotations are no functions on periodic meshes, on which angular momentum is not conserved.  Bodies of
revolution have the translation along their axis alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property, reduce
from operator import add
from typing import TypeAlias

import numpy as np
from ngsolve import (
    CF,
    CoefficientFunction,
    FESpace,
    Grad,
    GridFunction,
    LinearForm,
    VectorH1,
    ZeroCF,
    x,
    y,
    z,
)

from ngvisco.forms.boundary.boundaries import cells_at, facet_indicator
from ngvisco.forms.boundary.wall_terms import HELD_BY_WALLS
from ngvisco.forms.entry_integrals import EntryIntegrals
from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.reactions import beside_the_stress, rigid_motions
from ngvisco.forms.system import Step
from ngvisco.forms.term import CHANGE, ELASTIC, ENTERING, SKEW, Entry, Integrand, impulses_of, refused_by_name
from ngvisco.forms.upwinding import jump_power
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Interpolation
from ngvisco.physics.tensors import inner, is_number, sqrt, square

OnSides: TypeAlias = Callable[[Fields, Fields], dict[str, list[CoefficientFunction]]]
"""Function of the unknowns and a test of v; returns integrands on the sides of cells, by names."""

DEFECTS = ("facets", "cells", "inertia")
"""Names of the momentum defects of the scheme, by their place."""


class Impulses:
    """Forces on the body at the solution of a step, by their cause and by rigid motion.

    Attributes
    ----------
    motions : dict of coefficient functions
        The motions of ``rigid_motions`` about the origin.
    names : list of str
        Names of the causes of forces: loads, walls, further terms.
    """

    def __init__(self, step: Step) -> None:
        self.step, dim, self._ranks = step, step.mesh.dim, Communicator.of(step.mesh)
        given = rigid_motions(step.layout.symmetry, dim, [0.0] * dim)
        is_whole = not step.layout.periodic
        self.motions = {name: e for name, e in given.items() if is_whole or name.startswith("force")}
        mesh = step.mesh
        self._space: FESpace = VectorH1(mesh, order=1 if mesh.GetCurveOrder() < 2 else step.discretisation.k)
        """Space of the motions, without constraints by walls."""
        self.on_sides: Callable[[OnSides], dict[str, np.ndarray]] = lambda integrands: {}
        """Function that returns rows of v, of this rank's cells, by arrays. The forms take longer."""
        test = self._space.TestFunction()
        self._groups = self._by_groups(step.now, self._tests(test, Grad(test)))
        self.names = [name for name in self._groups if name not in (ELASTIC, ENTERING, SKEW, CHANGE)]
        """Names of the causes of forces; loads come first."""
        if self._is_held.any() and HELD_BY_WALLS not in self.names:
            self.names.append(HELD_BY_WALLS)

    def _by_groups(self, u: Fields, on_facets: Tests) -> dict[str, _Rows]:
        """Rows of v at ``u`` by group, on facets for the tests ``on_facets``."""
        rows_of: dict[str, _Rows] = {}
        dim, of_motions = self.step.mesh.dim, {}
        for motion, e in self.motions.items():
            spin = CF(tuple(e[i].Diff(place) for i in range(dim) for place in (x, y, z)[:dim]))
            gradient = spin.Reshape((dim, dim)) if motion.startswith("torque") else None
            of_motions[motion] = self._tests(e, gradient)
        for term in self.step.terms:
            wall = getattr(term, "wall", None)
            on = None if wall is None else [wall]
            with refused_by_name(term):
                for name, parts in impulses_of(term, u, on_facets).items():
                    if facets := [part.facets for part in parts if not _is_zero(part.facets)]:
                        rows_of.setdefault(name, _Rows()).facets.append((reduce(add, facets), on))
                for motion, tests in of_motions.items():
                    for name, parts in impulses_of(term, u, tests).items():
                        if rows := [p for p in parts if not (_is_zero(p.cells) and _is_zero(p.collocated))]:
                            rows_of.setdefault(name, _Rows()).cells.setdefault(motion, []).extend(rows)
        return rows_of

    def _tests(self, v: CoefficientFunction, gradient: CoefficientFunction | None) -> Tests:
        """Tests that are zero for all unknowns but v; if ``gradient`` is None, the gradient of v is zero."""
        layout, dim = self.step.layout, self.step.mesh.dim
        zeros = {name: ZeroCF(tuple(part.dims)) for name, part in self.step.now.parts.items()}

        def gradient_of(name: str) -> CoefficientFunction:
            return gradient if name == "v" and gradient is not None else ZeroCF((*zeros[name].dims, dim))

        return Tests(layout, {**zeros, "v": v}, gradient=gradient_of)

    @cached_property
    def _is_held(self) -> np.ndarray:
        """Mask of the motions with a nonzero coefficient of v that walls hold, (motions,)."""
        layout = self.step.layout
        every = mask_of(layout.velocity_space((None,) * self.step.mesh.dim).FreeDofs())
        held = every & ~mask_of(layout.blocks["v"].FreeDofs())
        moved = abs(self.velocities[:, held]) > _ROUNDING
        return self._ranks.totals(moved.sum(axis=1).astype(float)) > 0

    @cached_property
    def velocities(self) -> np.ndarray:
        """Coefficients of the motions in the velocity's space, (motions, unknowns of v)."""
        return _coefficients(self.step.layout.blocks["v"], self.motions.values())

    @cached_property
    def _in_cells(self) -> EntryIntegrals:
        """Integrals over cells for all groups and motions, by the names of group and motion."""
        entries = {}
        for name, rows in self._groups.items():
            for motion, parts in rows.cells.items():
                integrands = (
                    [value for part in parts if (value := getattr(part, place)) is not None]
                    for place in ("cells", "collocated")
                )
                sums = (reduce(add, terms) if terms else None for terms in integrands)
                entries[f"{name}.{motion}"] = Entry(
                    name, "monitor", Integrand(next(sums), collocated=next(sums))
                )
        return EntryIntegrals(self.step.quadrature, entries)

    @cached_property
    def _on_facets(self) -> dict[str, LinearForm]:
        step, walls = self.step, self.step.walls
        normal_test = self._space.TestFunction() * step.context.normal
        facets = {name: rows.facets for name, rows in self._groups.items() if rows.facets}
        facets |= self._beside(step.now, normal_test)
        forms = {}
        for name, integrands in facets.items():
            forms[name] = LinearForm(self._space)
            for integrand, on in integrands:
                cells = None if on is None else cells_at(step.mesh, walls.region(on))
                step.quadrature.add(forms[name], [Integrand(facets=integrand)], cells)
        return forms

    def _beside(
        self, u: Fields, normal_test: CoefficientFunction
    ) -> dict[str, list[tuple[CoefficientFunction, list[str] | None]]]:
        """Integrands on facets of the thrust of jumps and the pressure on closed walls, with their walls."""
        step, walls = self.step, self.step.walls
        phi = _where_it_is(step.energy.anywhere(u))
        facets: dict[str, list[tuple[CoefficientFunction, list[str] | None]]] = {}
        facets[_THRUST] = [(_thrust(u, phi) * normal_test, None)]
        if closed := [name for name in walls.conditions if name not in walls.crossed]:
            at_walls = facet_indicator(step.mesh, closed) * beside_the_stress(u, phi)
            facets[_PRESSED] = [(at_walls * normal_test, closed)]
        return facets

    def integrands(self, u: Fields) -> dict[str, list[list[Integrand]]]:
        """Summands at ``u`` of the forces and defects that ``__call__`` returns, by names and for each
        motion.

        The force of walls that hold v omits the rows of R, tested by the motions. These rows give the rest of
        the force: ``held_velocities`` times R.
        """
        by_names: dict[str, list[list[Integrand]]] = {name: [] for name in (*self.names, *DEFECTS)}
        for motion, coefficients in zip(self.motions, self._coefficients, strict=True):
            e = GridFunction(self._space)
            e.vec.FV().NumPy()[:] = coefficients
            groups = self._by_groups(u, self._tests(e, Grad(e)))
            parts = {name: rows.of(motion) for name, rows in groups.items()}
            for name, facets in self._beside(u, e * self.step.context.normal).items():
                parts[name] = [Integrand(facets=part) for part, _ in facets]
            for name in self.names:
                by_names[name].append(_negative(parts.get(name, [])))
            if HELD_BY_WALLS in self.names:
                by_names[HELD_BY_WALLS][-1] += parts.get(_PRESSED, [])
            thrust, pressed = parts[_THRUST], parts.get(_PRESSED, [])
            of_facets = [*thrust, *_negative(parts.get(ENTERING, []))]
            elastic = _negative([*parts.get(ELASTIC, []), *pressed, *thrust])
            defects = of_facets, elastic, _negative(parts.get(SKEW, []))
            for where, defect in zip(DEFECTS, defects, strict=True):
                by_names[where].append(defect)
        return by_names

    @property
    def held_velocities(self) -> np.ndarray:
        """``velocities`` of the motions that walls without multipliers hold, zero for other motions."""
        return np.where(self._is_held[:, None], self.velocities, 0.0)

    @cached_property
    def _coefficients(self) -> np.ndarray:
        """Coefficients of the motions in their space, (motions, unknowns)."""
        return _coefficients(self._space, self.motions.values())

    def __call__(self) -> dict[str, np.ndarray]:
        """Forces, N, and torques, N m, of the motions at the present state, by ``names`` and ``DEFECTS``.

        The state must be the solution of the last Rothe step, with its old state, length and loads in place.
        """
        self.step.local_unknowns.update_energy()
        none, of_cells = np.zeros(len(self.motions)), self._in_cells()
        on_sides = {} if self.step.energy.projected is not None else self.on_sides(self._at_sides)
        by_arrays = {name: self.velocities @ rows for name, rows in on_sides.items()}
        forms = {name: form for name, form in self._on_facets.items() if name not in by_arrays}
        rows = [form.Assemble().vec.FV().NumPy() @ self._coefficients.T for form in forms.values()]
        totals = self._ranks.totals(np.array([*rows, *by_arrays.values()]))
        left = dict(zip([*forms, *by_arrays], totals, strict=True))
        thrust, pressed = left.pop(_THRUST), left.pop(_PRESSED, none)
        for name in self._groups:
            values = [of_cells.get(f"{name}.{motion}", 0.0) for motion in self.motions]
            left[name] = left.get(name, none) + np.array(values)
        impulses = {name: -left.get(name, none) for name in self.names}
        if HELD_BY_WALLS in impulses:
            impulses[HELD_BY_WALLS] += np.where(self._is_held, sum(left.values()), 0.0) + pressed
        of_cells_ = -left[ELASTIC] - pressed - thrust
        defects = thrust - left.get(ENTERING, none), of_cells_, -left[SKEW]
        return impulses | dict(zip(DEFECTS, defects, strict=True))

    def _at_sides(self, u: Fields, w: Fields) -> dict[str, list[CoefficientFunction]]:
        """Integrands on the sides of cells, by group, of the forces for a test w."""
        phi, along = _where_it_is(u.context.rates.stored(u)), w.v * u.context.normal
        pressed = (1.0 - u.context.crossed) * beside_the_stress(u, phi)
        by_groups = {_THRUST: [along * _thrust(u, phi)], _PRESSED: [along * pressed]}
        for group in (ELASTIC, ENTERING, SKEW):
            # terms of walls have impulses of their own
            if group in self._groups and all(on is None for _, on in self._groups[group].facets):
                terms = [term for term in self.step.point_terms if term.group == group]
                by_groups[group] = [part for term in terms for part in term.facets(u, w)]
        return by_groups

    def of_rows(self, rows: np.ndarray) -> np.ndarray:
        """Forces, N, and torques from walls' reactions in the rows of v, (motions,).

        Over ranks the rows are sums of the ranks' parts.
        """
        return self._ranks.totals(self.velocities @ rows)

    def momentum(self, fields: Fields | None = None) -> list[CoefficientFunction]:
        """Densities of momentum, kg/(m^2 s), and angular momentum, kg/(m s), by motions, and |rho v|.

        The densities are evaluated at ``fields``, by default the present state.
        """
        u = self.step.now if fields is None else fields
        return [*[u.rho * inner(u.v, motion) for motion in self.motions.values()], sqrt(square(u.rho * u.v))]


def _thrust(u: Fields, phi: CoefficientFunction) -> CoefficientFunction:
    """Thrust (z_hat - z) : zeta + phi on crossed facets, Pa."""
    return u.context.crossed * (phi - jump_power(u))


def _where_it_is(phi: CoefficientFunction) -> CoefficientFunction:
    """Energy on facets, Pa. It is 0 at a trace without energy; the share of this trace then counts in the
    defect of cells."""
    return is_number(phi, phi, 0.0)


_ROUNDING = 1e-12
_THRUST, _PRESSED = "thrust of jumps", "pressed walls"
"""Groups of rows of v that have no column."""


@dataclass
class _Rows:
    """Integrands in cells, by motion; and integrands on facets, either of all cells or of the cells at some
    walls."""

    cells: dict[str, list[Integrand]] = field(default_factory=dict)
    facets: list[tuple[CoefficientFunction, list[str] | None]] = field(default_factory=list)

    def of(self, motion: str) -> list[Integrand]:
        """All summands of a motion."""
        inside = [Integrand(part.cells, collocated=part.collocated) for part in self.cells.get(motion, [])]
        return [*inside, *(Integrand(facets=part) for part, _ in self.facets)]


def _negative(integrands: Iterable[Integrand]) -> list[Integrand]:
    """The given summands with the opposite sign."""
    return [
        Integrand(*(None if part is None else -1 * part for part in (i.cells, i.facets, i.collocated)))
        for i in integrands
    ]


def _is_zero(value: CoefficientFunction | None) -> bool:
    return value is None or str(value).strip() == "ZeroCoefficientFunction"


def _coefficients(space: FESpace, functions: Iterable[CoefficientFunction]) -> np.ndarray:
    interpolated, interpolate, rows = GridFunction(space), Interpolation(space), []
    for function in functions:
        interpolate(interpolated, function)
        rows.append(interpolated.vec.FV().NumPy().copy())
    return np.array(rows)
