"""Conservative sharpening of interfaces between bodies at the end of a step, which keeps their width.

Transport smears a jump of the amounts n_i over more and more cells. After each step
(``Discretisation.sharp``) two moves separate bodies i and j in cells that contain no other body, and a third
move restores determinants. Two kinds of cells have no planes: cells with more than two bodies, and cells that
an interface crosses within one step (lower than the strips swept through them). In cells with more than two
bodies negative means are filled up too, and one factor for all slopes brings fractions into [0, 1].

1. *Between cells.*  The step has carried the amounts F_i, F_j out of a cell through a facet.  At the start
   of the step a plane bounds body i in this cell; the share s of the strip that was swept through the facet
   lay behind this plane, in body i. The two cells of the facet exchange the defect of the flux,

       s (F_i + F_j) - F_i    of body i, and as much of body j in the other direction,

   scaled so that no cell gives more of a body than it has (Zalesak, J. Comput. Phys. 31, 1979).  A second
   pass exchanges the amounts that this scaling has held back. An amount also moves the tensors X, in the
   ratio X/n of the giving cell. Transport may leave cells with negative means: neighbours give such a cell
   the missing amount of the body, and take the cell's X/n in exchange.
2. *In a cell* n_i becomes its mean plus the slope of the projected indicator of body i's part, scaled so
   that theta_i is in [0, 1]. n_j becomes the rest of n_i + n_j, and X becomes n B.  The slopes of B are those
   of the quotient X/n that the step has carried, projected with the weight n; its mean keeps int X.
3. *Determinants.*  At corners of cells det B gets the value that follows from N.  Where det B was too small,
   a share of the change is made. This share is the same everywhere, so that the energy in sum does not rise.

The normal of the plane that bounds body i in a cell is the slope of theta_i averaged at the vertices; the
plane cuts off the mean of theta_i from the cell.  The strip is a prism between the facet and its place
before the step.  About an axis shares are those of volumes, with the weight r.  With
``Discretisation.outlines`` level lines of a carried distance take the place of planes
(``ngvisco.forms.level_lines``); the exchanges and their integrals stay.

The moves keep N at every point and int n_i; all moves but the third keep int X_i. They therefore keep masses
and sum theta = 1 and, since bodies have one density, rho and momentum. A common volumetric energy depends on
N alone. If f is linear in X, n f(X/n) = C : (X - n I), and its integral depends on the integrals of n and X
alone. Hence the third move lowers the stored energy, the other moves keep it to rounding, and the step's
identity holds. With a nonlinear f of degree one in (n, X) energy would be lost; moreover the f of bodies have
this degree only up to traces of matter. Therefore nonlinear f are refused.
"""

from __future__ import annotations

from itertools import combinations
from typing import TypeAlias

import numpy as np
from ngsolve import (
    CF,
    ET,
    VOL,
    CoefficientFunction,
    Discontinuous,
    FacetFESpace,
    GridFunction,
    IntegrationRule,
    LinearForm,
    x,
    y,
    z,
)

from ngvisco.errors import InputWarning
from ngvisco.forms.cut_simplices import before, level, share_above
from ngvisco.forms.cut_strains import LEAST, Determinants, quotients
from ngvisco.forms.level_lines import CarriedDistances, LevelLines
from ngvisco.forms.mesh.mesh_arrays import VERTICES
from ngvisco.forms.mesh.quadrature import compiled
from ngvisco.forms.sharp_models import SHARP, check_sharp
from ngvisco.forms.surroundings import Surroundings, numbers_of_cells
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.bodies import AMOUNT, NO_INTERFACE
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import if_positive
from ngvisco.words import Mention, Words

_PASSES = 2
"""Number of exchanges between cells; the second exchange starts from the amounts that the first has moved."""
_PLANES = 2
"""Number of planes that are placed in a cell, each with a better normal."""
_ROUNDING = 1e-12
"""Share of a cell's amounts below which an amount is rounding, whose sign must have no effect."""
FAR = 0.7
"""Largest strip that a step may sweep at an interface, in heights of its cell (errors: FORMULATION.md)."""


_Moves: TypeAlias = list[tuple[int, int, np.ndarray, np.ndarray]]
"""Bodies i, j; cells, (2, moves); and the amounts of i that the first cells give for as much of j,
(moves,)."""


class Sharpening:
    """Separation of bodies in a step's present state; raises ParameterError for an unsuitable model."""

    def __init__(self, step: Step) -> None:
        check_sharp(step.model, step.mesh, step.layout.discretisation)
        self.step, self.mesh, self.dim = step, step.mesh, step.mesh.dim
        material, slices = step.model.material, step.layout.states.slices
        assert isinstance(material, Mixture)
        self._names = names = [body.name for body in material.bodies]
        self._layers = [-1 if body.where is None else body.order for body in material.bodies]
        self._distances: CarriedDistances | None = None
        self._amounts = [slices[AMOUNT + name].start for name in names]
        self._contents = [
            [i for X in material.contents(name) for i in range(slices[X.name].start, slices[X.name].stop)]
            for name in names
        ]
        kind = ET.TRIG if self.dim == 2 else ET.TET
        rule = IntegrationRule(VERTICES[kind], [0.0] * (self.dim + 1))
        self._corners = self.mesh.MapToAllElements({kind: rule}, VOL)
        self._x = np.asarray(CF((x, y, z)[: self.dim])(self._corners)).reshape(-1, self.dim + 1, self.dim)
        self._basis, self._functions, self._inverse, self._masses = self._of_cells()
        self._mass = self._masses.sum(axis=1)
        self._ranks = Communicator.of(self.mesh)
        self._determinants = Determinants(step.layout, material, self._ranks)
        around = Surroundings(self.mesh, self._x, bool(step.walls.periodic), self._ranks)
        self._vertices, self._facets, self._sides = around.vertices, around.facets, around.sides
        self._shared, self._halo, self._at_border = around.shared, around.halo, around.at_border
        self._outflows = [self._outflow(step.now.z[n]) for n in self._amounts]
        self._on = np.array([np.delete(range(self.dim + 1), opposite) for opposite in range(self.dim + 1)])
        edges = self._x[:, 1:] - self._x[:, :1]
        self._volumes = np.abs(np.linalg.det(edges)) / (2 if self.dim == 2 else 6)
        self._longest = self._ranks.most(self._volumes.max(initial=0.0)) ** (1 / self.dim)
        # weights of volumes at corners
        self._radii = np.maximum(self._x[:, :, 0], 0.0) if step.layout.symmetry.is_axisymmetric else None
        slopes = np.swapaxes(np.linalg.inv(edges), 1, 2)
        # gradients of lambda
        self._slopes = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)
        self.swept, self._is_said = 0.0, False
        """Height of the longest strip of the last step, in heights of its cell."""

    def follow(self, distances: CarriedDistances) -> None:
        """Take outlines from the carried distances of bodies; planes are then not used."""
        self._distances = distances

    # --- a step, as the integrator's ``carried`` objects follow it ---------------------------------------

    def begin(self) -> None:
        """Begin a step, or repeat it, from the present state."""
        self._start = self._carried = self._values()
        self.swept = 0.0
        shape = self._x.shape
        self._flux, self._velocity = np.zeros((len(self._amounts), *shape[:2])), np.zeros(shape)

    def stage(self, weights: np.ndarray, share: float) -> None:
        """Add the amounts that the present state of a stage carries through facets, times ``share``."""
        self._velocity += share * np.asarray(self.step.now.v(self._corners)).reshape(self._x.shape)
        for flux, form in zip(self._flux, self._outflows, strict=True):
            out = form.Assemble().vec.FV().NumPy().reshape(self._sides.shape)
            flux += share * np.take_along_axis(out, self._sides, axis=1)

    def end(self, weights: np.ndarray) -> None:
        """Accept the step; warn, once, if it carried an interface too far for the planes at the start."""
        if self.swept > FAR and not self._is_said:
            self._is_said = True
            longest = 0.9 * FAR / self.swept * self._tau
            message = (
                f": the step moved an interface by {self.swept:.2g} heights of a cell. Steps of more than "
                f"{FAR:g} heights make the place of the interface inaccurate. Take dt or dt_max <= "
                f"{longest:.2g} s, or larger cells there"
            )
            self._ranks.warn(Words(Mention(SHARP), " = ", True, message), InputWarning, stacklevel=5)

    def put_apart(self, tau: float) -> None:
        """Separate bodies of the present state at the end of a step of length ``tau``, s."""
        u, self._tau = self._values(), tau
        self._carried = u.copy()
        if self._distances is not None:
            self._distances.carry(tau)
        strips = np.maximum(-np.einsum("kond,kod->kon", tau * self._velocity[:, self._on], self._slopes), 0.0)
        is_passed = strips.max(axis=(1, 2), initial=0.0) >= 1  # strips reach beyond the cell
        pairs = {
            (i, j): ~is_passed & self._is_pair(self._start, i, j) & self._is_pair(u, i, j)
            for i, j in combinations(range(len(self._amounts)), 2)
        }
        self._between(u, pairs, strips)
        self.swept = self._ranks.most(self.swept)
        self._fill(u)
        is_apart = self._within(u, pairs)
        if len(pairs) > 1 or is_passed.any():
            self._bound(u, np.flatnonzero(~is_apart))
        self._determinants.restore(u, self._masses)
        self._state()[:, self._basis] = np.einsum("kfc,skc->skf", self._inverse, u)

    def _state(self) -> np.ndarray:
        """View of the present coefficients of z, (components, functions)."""
        state = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
        return state.reshape(self.step.layout.states.size, -1)

    def _values(self) -> np.ndarray:
        """Values of the present z at the cells' corners, (components, cells, corners)."""
        return np.einsum("kcf,skf->skc", self._functions, self._state()[:, self._basis])

    def _means(self, u: np.ndarray) -> np.ndarray:
        """Cell means of linear functions with values (components, cells, corners)."""
        return np.einsum("skc,kc->sk", u, self._masses) / self._mass

    def _is_pair(self, u: np.ndarray, i: int, j: int) -> np.ndarray:
        """Mask of cells with no other bodies than i and j, (cells,)."""
        amounts = self._means(u[self._amounts])
        return np.asarray(amounts[[i, j]].sum(axis=0) > (1 - LEAST) * amounts.sum(axis=0))

    def _averaged(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Values at corners of cells, (cells, corners), averaged over the corners at each vertex."""
        weights = np.repeat(weights, values.shape[1])
        count, at = self._shared.count, self._vertices.ravel()
        sums = self._shared.sum(
            np.array([np.bincount(at, w, count) for w in (weights * values.ravel(), weights)])
        )
        return (sums[0] / np.maximum(sums[1], np.finfo(float).tiny))[self._vertices]

    def _behind(self, u: np.ndarray, i: int, j: int) -> np.ndarray:
        """Values at corners, (cells, corners), of linear functions: > 0 in body i's part of a cell, < 0 in
        body j's part, and 0 in cells without an interface.  Exchange of i and j changes the signs.

        The first normals are slopes of averaged differences of the fractions. The second normals are slopes
        of averaged distances from the first planes.
        """
        amounts, (theta, is_shared) = u[self._amounts], self._shared_by(u, i, j)
        values = np.clip(0.5 + 0.5 * (amounts[i] - amounts[j]) / amounts.sum(axis=0), 0, 1)
        is_cut, height = np.ones(len(theta), dtype=bool), values
        for _ in range(_PLANES):
            height = np.where(is_cut[:, None], self._averaged(values, is_cut * self._volumes), height)
            has_slope = np.ptp(height, axis=1) > NO_INTERFACE
            height = np.where(has_slope[:, None], height - level(height, theta, self._radii)[:, None], 0.0)
            is_cut = has_slope & is_shared
            size = np.linalg.norm(np.einsum("kc,kcd->kd", height, self._slopes), axis=1) * self._longest
            values = height / np.where(is_cut, size, 1.0)[:, None]
        return height

    def _shared_by(self, u: np.ndarray, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Share of body i in each cell, (cells,), in [0, 1], where half of each trace of another body counts;
        and a mask of the cells with bodies i and j."""
        means = self._means(u[self._amounts])
        theta = np.clip(means / means.sum(axis=0), 0, 1)[[i, j]]
        return 0.5 + 0.5 * (theta[0] - theta[1]), theta.min(axis=0) > LEAST

    def _defects(self, i: int, j: int, strips: np.ndarray) -> np.ndarray:
        """Outflow of body i in a step by the strips that cross the facets, minus the transported outflow,
        (cells, facets). The body's share of a strip follows from its planes or outlines at the step's start.

        Facets are numbered by their opposite corners. ``strips`` are the heights of the strips at the corners
        of facets, (cells, facets, corners of the facet), relative to the height of the cell.
        """
        out = self._tau * self._flux
        swept = self._swept_of_planes if self._distances is None else self._swept_of_outlines
        return np.asarray(swept(i, j, strips) * (out[i] + out[j]) - out[i])

    def _swept_of_planes(self, i: int, j: int, strips: np.ndarray) -> np.ndarray:
        """Shares of body i in the strips, (cells, facets), by planes."""
        height, on = self._behind(self._start, i, j), self._on
        cut = np.flatnonzero(np.ptp(height, axis=1) > 0)
        path, slopes, sizes = self._tau * self._velocity[cut], self._slopes[cut], strips[cut]
        self.swept = max(self.swept, float(sizes.max(initial=0.0)))

        def prisms(values: np.ndarray) -> np.ndarray:
            """Values at the vertices of the simplices of strips, (cut cells, facets, simplices, vertices)."""
            ends, starts = values[cut], before(values[cut], path, slopes)
            parts = ((ends[:, on[:, n:]], starts[:, on[:, : n + 1]]) for n in range(self.dim))
            return np.stack([np.concatenate(part, axis=2) for part in parts], axis=2)

        radii = None if self._radii is None else np.maximum(prisms(self._radii), _ROUNDING * self._longest)
        shares = share_above(prisms(height), radii)
        sizes = sizes if radii is None else sizes * radii.mean(axis=3)
        size = sizes.sum(axis=2)
        behind = np.repeat(self._shared_by(self._start, i, j)[0][:, None], self.dim + 1, axis=1)
        behind[cut] = np.divide((shares * sizes).sum(axis=2), size, out=behind[cut], where=size > 0)
        return behind

    def _swept_of_outlines(self, i: int, j: int, strips: np.ndarray) -> np.ndarray:
        """Shares of body i in the strips, (cells, facets), by outlines."""
        lines, behind = self._lines(self._start, i, j, at_start=True)
        cut = lines.cells
        self.swept = max(self.swept, float(strips[cut].max(initial=0.0)))
        corners = np.repeat(np.eye(self.dim + 1)[None], len(cut), axis=0)
        path, slopes = self._tau * self._velocity[cut], self._slopes[cut]
        starts = np.stack([before(corners[..., c], path, slopes) for c in range(self.dim + 1)], axis=2)
        radii = None if self._radii is None else self._radii[cut]
        for facet, on in enumerate(self._on):
            share = lines.shares(corners[:, on], starts[:, on], radii)
            is_some = (strips[cut, facet].sum(axis=1) > 0) & np.isfinite(share)
            behind[cut[is_some], facet] = share[is_some]
        return behind

    def _lines(self, u: np.ndarray, i: int, j: int, at_start: bool) -> tuple[LevelLines, np.ndarray]:
        """Outlines between bodies i and j in the cells with both bodies, and shares of body i in all cells,
        (cells, corners)."""
        theta, is_shared = self._shared_by(u, i, j)
        cut = np.flatnonzero(is_shared)
        upper, sign = (i, 1.0) if self._layers[i] > self._layers[j] else (j, -1.0)
        assert self._distances is not None
        phi = self._distances.of(self._names[upper], at_start)
        radii = None if self._radii is None else self._radii[cut]
        lines = LevelLines(self.mesh, sign * phi, cut, theta[cut], radii)
        return lines, np.repeat(theta[:, None], self.dim + 1, axis=1)

    def _between(self, u: np.ndarray, pairs: dict[tuple[int, int], np.ndarray], strips: np.ndarray) -> None:
        """Exchange the fluxes' defects between cells, in place; all pairs together, in any order."""
        moves, across = _Moves(), len(self._halo.beside)
        for (i, j), here in pairs.items():
            pair = self._halo.with_others(here.astype(float)) > 0
            defects = np.pad(self._defects(i, j, strips), ((0, across), (0, 0)))
            defects[len(defects) - across :, 0] = self._halo.swapped(defects[*self._at_border])
            facets = self._facets[pair[self._facets[:, 0]] & pair[self._facets[:, 2]]]
            cell, corner, neighbour, opposite = facets.T
            left = defects[cell, corner] - defects[neighbour, opposite]
            cells = np.where(left > 0, (cell, neighbour), (neighbour, cell))
            moves.append((i, j, cells, np.abs(left)))
        self._exchange(u, moves, _PASSES)

    def _fill(self, u: np.ndarray) -> None:
        """Fill up cells with a negative amount of a body, in place. Surroundings give this body in proportion
        to their amounts of it, and get the other bodies in proportion to the cell's amounts."""
        cell, _, neighbour, _ = self._facets.T
        giving, taking = np.concatenate([cell, neighbour]), np.concatenate([neighbour, cell])
        amounts, moves = self._contained(u)[self._amounts], _Moves()
        has = np.maximum(amounts, 0.0)
        for i, lacks in enumerate(np.maximum(-amounts, 0.0)):
            total, others = self._received(0, taking, has[i, giving])[0], has.sum(axis=0) - has[i]
            filling = (lacks / np.where(total > 0, total, 1.0))[taking] * has[i, giving]
            for j in set(range(len(amounts))) - {i}:
                share = has[j] / np.where(others > 0, others, 1.0)
                moves.append((i, j, np.array([giving, taking]), filling * share[taking]))
        self._exchange(u, moves, 1)

    def _exchange(self, u: np.ndarray, moves: _Moves, passes: int) -> None:
        """Make the ``moves`` in place, as far as cells have the amounts; a further pass moves the amounts
        held back. In exchange for matter that fills up a negative amount a cell gives matter with its X/n."""
        if not moves:  # one body
            return
        body = np.concatenate([np.repeat([[i], [j]], len(part), axis=1) for i, j, _, part in moves], axis=1)
        source, wanted = (np.concatenate(parts, axis=-1) for parts in list(zip(*moves, strict=True))[2:])
        target = source[::-1]
        for _ in range(passes):
            has = self._contained(u)[self._amounts]
            least = _ROUNDING * has.sum(axis=0)
            gives = self._received(body, source, np.array([wanted, wanted]))
            share = np.minimum(1.0, np.where(has > least, has, 0.0) / np.where(gives > 0, gives, 1.0))
            amount = np.tile((wanted * share[body, source]).min(axis=0), (2, 1))
            wanted = wanted - amount[0]
            takes, lacks = self._received(body, target, amount), np.where(-has > least, -has, 0.0)
            filling = amount * np.minimum(1.0, lacks / np.where(takes > 0, takes, 1.0))[body, target]
            for part, at in ((filling, target), (amount - filling, source)):
                whole = self._contained(u)
                for i, (n, contents) in enumerate(zip(self._amounts, self._contents, strict=True)):
                    own, to, here = (of[body == i] for of in (part, target, at))
                    is_some = abs(whole[n, here]) > least[here]
                    share = np.where(is_some, own / np.where(is_some, whole[n, here], 1.0), 0.0)
                    for component, carried in ((n, own), *((X, share * whole[X, here]) for X in contents)):
                        change = self._sums(to, carried) - self._sums(source[body == i], carried)
                        u[component] += (change / self._mass)[:, None]

    def _contained(self, u: np.ndarray) -> np.ndarray:
        """Integrals over own and halo cells of functions with corner values ``u``, (components, cells)."""
        return self._halo.with_others((self._means(u) * self._mass).T).T

    def _sums(self, cells: np.ndarray, amounts: np.ndarray) -> np.ndarray:
        """Sums of ``amounts`` over the own cells with the numbers ``cells``, (own cells,)."""
        return np.bincount(cells, amounts, self._halo.count)[: self._halo.cells]

    def _received(self, body: np.ndarray | int, cells: np.ndarray, amounts: np.ndarray) -> np.ndarray:
        """Sums of the bodies' ``amounts`` over own cells, and over halo cells by owners, (bodies, cells)."""
        count = len(self._amounts)
        sums = np.bincount((cells * count + body).ravel(), amounts.ravel(), self._halo.count * count)
        return self._halo.with_others(sums.reshape(-1, count)[: self._halo.cells]).T

    def _within(self, u: np.ndarray, pairs: dict[tuple[int, int], np.ndarray]) -> np.ndarray:
        """Separate the bodies of each pair by planes, in place; return a mask of cells with interfaces."""
        means, is_apart = self._means(u), np.zeros(len(self._mass), dtype=bool)
        deviation = np.zeros_like(u[self._amounts])  # traces of other bodies have no slope
        for (i, j), pair in pairs.items():
            if self._distances is not None:
                chosen = np.flatnonzero(pair)
                slope = self._projected(u, i, j)[chosen]
            else:
                height = self._behind(u, i, j)
                chosen = np.flatnonzero(pair & (np.ptp(height, axis=1) > 0))
                doubled = (np.insert(height, c, height[:, c], axis=1)[chosen] for c in range(self.dim + 1))
                slope = np.stack([share_above(heights) for heights in doubled], axis=1)
            slope -= (slope * self._masses[chosen]).sum(axis=1, keepdims=True) / self._mass[chosen, None]
            # the projection's factor; ``_deviate`` scales the slope to 0.6 or less
            slope *= (self.dim + 2) * means[self._amounts][[i, j]][:, chosen].sum(axis=0)[:, None]
            deviation[i, chosen] += slope
            deviation[j, chosen] -= slope
            is_apart[chosen] = True
        chosen = np.flatnonzero(is_apart)
        self._deviate(u, chosen, deviation[:, chosen])
        return is_apart

    def _projected(self, u: np.ndarray, i: int, j: int) -> np.ndarray:
        """Integrals of (dim + 1) lambda over the part of a cell that body i's outline encloses, divided by
        the cell's size, (cells, corners)."""
        lines, result = self._lines(u, i, j, at_start=False)
        result[lines.cells] = lines.projected()
        return result

    def _bound(self, u: np.ndarray, cells: np.ndarray) -> None:
        """Bring fractions into [0, 1] in ``cells``, in place."""
        amounts, means = u[self._amounts][:, cells], self._means(u)[self._amounts][:, cells]
        self._deviate(u, cells, amounts - (means / means.sum(axis=0))[:, :, None] * amounts.sum(axis=0))

    def _deviate(self, u: np.ndarray, cells: np.ndarray, deviation: np.ndarray) -> None:
        """Set amounts in ``cells`` to an even mixture with their means plus ``deviation``, (bodies, cells,
        corners), in place. One factor of the deviations brings fractions into [0, 1]; tensors follow amounts.

        Deviations have the mean 0 in each cell and the sum 0 at each corner, so that means and N stay.
        """
        means = self._means(u)[:, cells]
        size = means[self._amounts].sum(axis=0)
        even = (means[self._amounts] / size)[:, :, None] * u[self._amounts][:, cells].sum(axis=0)
        lowered = np.maximum(-deviation, np.finfo(float).tiny)  # an absent body has a mean of either sign
        most = np.where(lowered > _ROUNDING * size[:, None], np.maximum(even, 0.0) / lowered, 1.0)
        deviation = np.minimum(1.0, most.min(axis=(0, 2)))[:, None] * deviation
        for n, contents, amounts in zip(self._amounts, self._contents, even + deviation, strict=True):
            u[n, cells] = amounts
            u[np.array(contents, int)[:, None], cells] = means[contents][..., None]  # no slope where n = 0
            some = means[n] > NO_INTERFACE * size  # avoids quotients of two rounding errors
            if contents and some.any():
                weights = self._masses[cells[some]] * amounts[some] / self._mass[cells[some], None]
                carried = self._carried[:, cells[some]]
                B = quotients(carried[n], carried[contents], carried[self._amounts].sum(axis=0).mean(axis=1))
                B += ((means[contents][:, some] - (B * weights).sum(axis=2)) / means[n, some])[..., None]
                u[np.ix_(contents, cells[some])] = amounts[some] * B

    def _of_cells(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Four arrays: numbers of the functions of each cell, (cells, functions); matrices from coefficients
        to values at corners, (cells, corners, functions); the inverse matrices; and integrals of the linear
        functions that are 1 at one corner, by the rule of the forms, (cells, corners)."""
        space = self.step.layout.scalar_space("z")
        dofs = numbers_of_cells(space)
        function, values = GridFunction(space), np.empty((*self._x.shape[:2], dofs.shape[1]))
        for j in range(dofs.shape[1]):
            function.vec.FV().NumPy()[:] = 0.0
            function.vec.FV().NumPy()[dofs[:, j]] = 1.0
            values[:, :, j] = np.asarray(function(self._corners)).reshape(values.shape[:2])
        form = LinearForm(space)
        form += self.step.quadrature.cells(space.TestFunction())
        integrals = form.Assemble().vec.FV().NumPy()[dofs]
        inverse = np.linalg.inv(values)
        return dofs, values, inverse, np.einsum("kf,kfc->kc", integrals, inverse)

    def _outflow(self, amount: CoefficientFunction) -> LinearForm:
        """Form of the amount that the upwind flux carries out of the cells; one row for each side of a
        facet."""
        side = Discontinuous(FacetFESpace(self.mesh, order=0))
        context = self.step.context
        speed = context.crossed * (self.step.now.v * context.normal)
        form = LinearForm(side)
        form += self.step.quadrature.facets(
            compiled(if_positive(speed, speed, 0 * speed) * amount * side.TestFunction())
        )
        return form
