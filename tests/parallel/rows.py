"""Rows of the split solver's residual and of its derivative, and what it factorises, by any number of ranks.

Run by ``test_reduced``: the first rank writes them into a file, in the numbering of one process.
"""

import sys

import numpy as np
from ngsolve import CF, cos, pi, sin, x, y
from runs import bodies

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.parallel.exchange import Exchange
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.solver.split.transport import TransportSweeps

SWIRL = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y), CF(0))
SLIP = {"top": nv.Traction(f=(1.0, 0.0), friction=0.2), "left": nv.NavierFriction(0.3)}
CREEP = {"creep": nv.Creep(G_m=2.0)}
CUT_OFF = {"regularisation": nv.Regularisation(rho_max=1.0, width=0.5)}
DELTA = {"regularisation": nv.Regularisation(delta_density=1e-3, r=3.0, delta_fields=1e-2, rho_max=1.0)}
CREEP_FIELD = {"creep": nv.Creep(G_m=2.0, nu=1e-3, q=4)}


def simulation(dim=2, maxh=0.4, k=2, p=4.0, walls=None, **parts) -> nv.Simulation:
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        viscosity=nv.StokesViscosity(K_v=0.05, G_v=0.05),
        hyperviscosity=None if p is None else nv.HyperViscosity(mu=1e-4, p=p),
        loads=[nv.Gravity((0.0,) * (dim - 1) + (-1.0,))],
        **parts,
    )
    return nv.Simulation(
        box((1,) * dim, maxh=maxh),
        model,
        dt=0.02,
        initial=nv.Initial(velocity=SWIRL[:dim]),
        walls=walls,
        discretisation=nv.Discretisation(k=k),
        solver="coupled",
    )


def carried() -> nv.Simulation:
    """Diffusion of variables in which the energy is linear, beside a parameter's own slope."""
    theta = nv.Parameter("theta", start=0.5 + 0.4 * sin(3 * x) * cos(2 * y))
    material = nv.NeoHookean(K_e=10.0, G_e=1 + 4 * theta, epsilon=0.1, elastic_state="B")
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=0.05, G_v=0.05), **DELTA)
    initial = nv.Initial(velocity=SWIRL[:2])
    return nv.Simulation(box((1, 1), maxh=0.4), model, dt=0.02, initial=initial, solver="coupled")


CASES = {
    "bodies": lambda: bodies("coupled", 0.3),
    "creep and walls with slip": lambda: simulation(walls=SLIP, **CREEP),
    "a creep rate field": lambda: simulation(p=2.0, **CREEP_FIELD),
    "k = 3": lambda: simulation(k=3, maxh=0.6),
    "no hyperviscosity": lambda: simulation(p=None),
    "3D": lambda: simulation(dim=3, maxh=0.9),
    "a cut-off": lambda: simulation(p=None, **CUT_OFF),
    "delta": lambda: simulation(p=None, **DELTA),
    "delta in 3D": lambda: simulation(dim=3, maxh=0.9, p=None, **DELTA),
    "delta and what does not diffuse": carried,
}


def rows(run: nv.Simulation) -> dict[str, np.ndarray]:
    """By residual or derivative and unknown, on the first rank; at a state away from a solution."""
    step, numbering, ranks = run.rothe_step, run.numbering, run.ranks
    reduced = ReducedResidual(step, Exchange.of(step.layout.space, ranks))
    unknowns = reduced.unknowns
    state, direction = numbering.whole(step.state.vec.FV().NumPy()).copy(), None
    if ranks.is_first:
        random = np.random.default_rng(1)
        direction = random.standard_normal(len(state))
        for name in unknowns.names:
            where = numbering.layout.ranges[name]
            state[where] += 1e-2 * random.standard_normal(where.stop - where.start)
    step.state.vec.FV().NumPy()[:] = numbering.own(state if ranks.is_first else None)
    d = numbering.own(direction)[unknowns.places(unknowns.names)]
    step.context.set_step(0.02, 0.04, 0.02, 0.02)
    reduced.start()
    at = reduced(unknowns.pack())
    found = {}
    made = {"residual": at.residual.parts(), "derivative": reduced.derivative(at)(d).parts()}
    names = dict.fromkeys(made, unknowns.names)
    if reduced.diffusion is not None:
        made["inverse"], names["inverse"] = factorised(reduced, at, d), [*unknowns.density, "z"]
    for kind, parts in made.items():
        values = np.zeros(step.layout.space.ndof)
        values[unknowns.places(names[kind])] = np.concatenate([part.ravel() for part in parts])
        whole = numbering.whole(values)
        if ranks.is_first:
            for name in names[kind]:
                found[f"{kind} of {name}"] = whole[numbering.layout.ranges[name]]
    return found


def factorised(reduced: ReducedResidual, at: Evaluation, d: np.ndarray) -> list[np.ndarray]:
    """Solutions of the density's and the diffusing fields' systems for rows ``d``, packed."""
    unknowns, sweep = reduced.unknowns, TransportSweeps(reduced)
    sweep.update(at)
    sweep.linearise()
    z = d[unknowns.slices["z"]].reshape(unknowns.components["z"], -1)
    dz = sweep.fields(np.ascontiguousarray(z.T)).T
    return [sweep.density(d[unknowns.density_slice]), dz * reduced.diffusion.strains[:, None]]


if __name__ == "__main__":
    path, *names = sys.argv[1:]
    result = {}
    for name in names:
        run = CASES[name]()
        result |= {f"{name}: {key}": value for key, value in rows(run).items()}
    if run.ranks.is_first:
        np.savez(path, **result)
