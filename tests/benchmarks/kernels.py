"""The cost of kernels that are written by hand: ``python -m tests.benchmarks.kernels`` in the project's root.

Each kernel is timed by turns with the general code for the same numbers, in processor time. The general code
takes complex increments of the terms, or NGSolve's form where arrays do not take the term. A kernel that is
no longer several times as fast should be removed.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from ngsolve import CF, SetNumThreads, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.arrays import TINY
from ngvisco.reduced.facet_tangent import FacetTangent
from ngvisco.reduced.point_fields import moved
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.reduced.restricted_form import RestrictedForm

MESHES = ((2, 0.12), (3, 0.4))
"""Dimension and size of cells of each row."""
HEAD = ("kernel", "dim", "cells", "by hand, ms", "general way, ms", "ratio")
TURNS = 3


def swirl(dim: int, maxh: float, **laws: object) -> nv.Simulation:
    """A swirl with further ``laws`` of the model in the split solver, after its first step."""
    along = (sin(pi * x) ** 2 * sin(2 * pi * y), -sin(2 * pi * x) * sin(pi * y) ** 2, CF(0.0))
    model = nv.Model(
        material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        **laws,
    )
    initial = nv.Initial(density=1.0, velocity=along[:dim])
    run = nv.Simulation(box((1,) * dim, maxh=maxh), model, dt=0.02, solver="split", initial=initial)
    run.advance()
    return run


Ways = dict[str, tuple[Callable[[], object], Callable[[], object]]]
"""For each name, a kernel and the general code that computes the same numbers."""


def kernels(run: nv.Simulation) -> Ways:
    """Tangents of hyperviscosity and transport at the run's present state; the general code takes complex
    increments."""
    split = run.solver.newton
    residual, preconditioner = split.residual, split.preconditioner
    at = residual(split.unknowns.pack())
    c, rng = at.coefficients, np.random.default_rng(1)
    dv, da = rng.standard_normal(c["v"].shape), rng.standard_normal(c["a"].shape)
    derivative, sweep = preconditioner.operator.derivative, preconditioner.sweep
    along, h = np.concatenate([dv, da], axis=1), TINY * 1j
    moving = [term for term in run.rothe_step.point_terms if term.impulse in ("Kinematics", "Upwinding")]
    size = len(at.cells.z.value)
    tangent = FacetTangent(residual, moving, range(size), sweep.coupling)
    term, step = residual.couplings.of_kernel["hyperviscosity"][0], run.rothe_step
    local = ["hess", "hess_square", "hyper_coefficient", "hyperstress"]
    form = RestrictedForm(step, ["v", *step.layout.names_of("normals"), *local], [term])
    return {
        "hyperviscosity's rows": (lambda: residual.hyper(c["v"], c["a"], c["z"]), form.residual),
        "hyperviscosity's derivative": (
            lambda: derivative(along),
            lambda: residual.hyper(c["v"] + h * dv, c["a"] + h * da, c["z"]).rows.imag / TINY,
        ),
        "transport": (lambda: sweep.update(at), lambda: tangent(at)),
        "density": (lambda: sweep.blocks("rho", at), lambda: increments_of_density(residual, at)),
    }


def increments_of_density(residual: ReducedResidual, at: Evaluation) -> None:
    """Differentiate the continuity equation by rho and its trace, one function of a cell or facet at a time.

    The products of the trace's blocks are left out, so that the time is a lower bound.
    """
    terms, q = residual.couplings.continuity, residual.op.z.local
    in_cells = [slice(a, None, q) for a in range(q)]
    on_facets = residual.mass_of("rho_hat").unknowns.T
    for name, functions in [*(("rho", f) for f in in_cells), *(("rho_hat", f) for f in on_facets)]:
        change = {name: np.zeros_like(at.coefficients[name])}
        change[name][functions] = 1.0
        on_sides = moved(at.facets, residual.facet_terms.fields(change), [name])
        residual.facet_terms.loads(terms, on_sides)
        if name == "rho":
            inside = moved(at.cells, residual.cell_terms.fields(change), [name])
            residual.cell_terms.loads(terms, inside)


def diffusion(run: nv.Simulation) -> Ways:
    """Rows of diffusing fields, and their derivative along a direction, beside NGSolve's form.

    NGSolve's derivative contains the unknowns that the split solver eliminates: the time is a lower bound.
    """
    split = run.solver.newton
    residual, term = split.residual, split.residual.couplings.of_kernel["diffusion"][0]
    by_hand, c, h = residual.diffusion, residual(split.unknowns.pack()).coefficients, TINY * 1j
    names = ["z", "zeta", "z_slope", "zeta_delta_hat", "z_slope_hat"]
    form = RestrictedForm(residual.step, names, [term])
    dz = np.random.default_rng(1).standard_normal(c["z"].shape)
    moving = c | {name: c[name] + h * dz for name in ("z", "zeta")}

    def evaluated(c: dict[str, np.ndarray]) -> np.ndarray:
        return by_hand.rows(c | by_hand.slopes(residual.op.z(c["z"]), c))

    return {
        "diffusion": (lambda: evaluated(c), form.residual),
        "diffusion's derivative": (lambda: evaluated(moving).imag / TINY, form.jacobian),
    }


def rows(meshes: Sequence[tuple[int, float]] = MESHES, turns: int = TURNS) -> Iterator[str]:
    """The lines of a Markdown table."""
    yield "| " + " | ".join(HEAD) + " |"
    yield "|" + "---|" * len(HEAD)
    for dim, maxh in meshes:
        thick = swirl(dim, maxh, hyperviscosity=nv.HyperViscosity(mu=1e-3, p=4.0))
        diffusing = swirl(dim, maxh, regularisation=nv.Regularisation(delta_fields=1e-4))
        for name, ways in (kernels(thick) | diffusion(diffusing)).items():
            seconds = [[], []]
            for _ in range(turns):
                for way, taken in zip(ways, seconds, strict=True):
                    begin = time.process_time()
                    way()
                    taken.append(time.process_time() - begin)
            hand, general = (1e3 * min(taken) for taken in seconds)
            yield f"| {name} | {dim} | {thick.mesh.ne} | {hand:.1f} | {general:.1f} | {general / hand:.1f} |"


if __name__ == "__main__":
    SetNumThreads(1)
    for line in rows():
        print(line)
        sys.stdout.flush()
