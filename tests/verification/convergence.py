"""Tables of errors against the manufactured solutions: transport alone, the coupled system, and in time."""

from collections.abc import Callable
from typing import Any

from ngsolve import GridFunction

import ngvisco as nv
from ngvisco.forms.context import time
from ngvisco.forms.start.initial import complete
from ngvisco.forms.terms.momentum import Continuity
from ngvisco.forms.terms.transport import Kinematics, UpwindTrace
from ngvisco.geometries import box
from ngvisco.physics.tensors import inner
from tests.verification.manufactured import Exact
from tests.verification.models import material, model
from tests.verification.problems import Problem, Source, balls, distance, refinements
from tests.verification.rates import RateTable
from tests.verification.sources import Sources

SHORT = 1e-6
"""Difference in time of the sources, s, where the order in time is measured: its error is of this size."""


def transport_rates(kind: str, dim: int, m: int, maxh: float, levels: int) -> RateTable:
    """Density and E / F / J alone, with the exact velocity given, after two steps of 0.25 s."""
    tau = 0.25
    system = nv.Model(material=material(kind))
    sources = Sources(system, dim, tau)
    load = Source(
        lambda w: [nv.Integrand(-sources.continuity * w.rho), nv.Integrand(-inner(sources.kinematics, w.z))]
    )
    table = RateTable(f"transport alone, {kind}, {dim}D, m = {m}")
    for h, mesh in refinements(dim, maxh, levels):
        problem = Problem(
            mesh,
            system,
            nv.Discretisation(m=m),
            ("rho", "rho_hat", "z", "z_hat"),
            [Continuity(), Kinematics(system), UpwindTrace(), load],
            tau,
        )
        exact = Exact(system, dim, time)
        time.Set(0.0)
        problem.set("rho", exact.rho)
        problem.set("z", exact.z)
        for n in range(2):
            problem.advance(n * tau)
        table.add(h, rho=distance(problem.now.rho, exact.rho, mesh), z=distance(problem.now.z, exact.z, mesh))
    return table


def coupled_rates(
    kind: str,
    dim: int,
    p: float | None,
    k: int,
    m: int,
    maxh: float,
    levels: int,
    *,
    regularised: bool = False,
    delta: bool = True,
    nu: float = 0.0,
    rule: str = "linear",
    curved: bool = False,
    sources: Callable[..., Sources] = Sources,
) -> RateTable:
    """The whole system: creep, gravity, viscosity, hyperviscosity (unless p is None), and delta- and
    epsilon-terms if ``regularised``, without delta if not ``delta``; creep's gradient with nu > 0, by one of
    ``RULES``; in the unit ball if ``curved``; errors in L2 after two steps of 0.05 s, space only.  Other
    ``sources`` than those of the exact fields are for negative controls."""
    system = model(kind, dim, p, regularised, delta, nu, rule)
    terms = (", all terms" if delta else ", all terms but delta") if regularised else ""
    table = RateTable(f"coupled, {kind}, {dim}D, p = {p}, k = {k}, m = {m}{terms}")
    for h, mesh in (balls if curved else refinements)(dim, maxh, levels):
        time.Set(0.0)
        exact, start = Exact(system, dim, time, curved), Exact(system, dim, 0.0, curved)
        given: dict[str, Any] = {"density": start.rho, "values": start.values}
        simulation = nv.Simulation(
            mesh,
            system,
            dt=0.05,
            initial=nv.Initial(velocity=start.v, **({} if system.bodies else given)),
            discretisation=nv.Discretisation(k=k, m=m),
            sources=sources(system, dim, 0.05, curved),
        )
        if system.bodies:
            _mix(simulation, start)
        for _ in range(2):
            simulation.advance()
        table.add(h, **errors(simulation, exact))
    return table


def _mix(simulation: nv.Simulation, start: Exact) -> None:
    """Give a run the exact fields of its bodies, which by themselves start in places of their own."""
    step = simulation.rothe_step
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    parts["z"].Set(start.z)
    complete(step)
    step.state_old.vec.data = step.state.vec
    step.start_from_old()


def errors(simulation: nv.Simulation, exact: Exact) -> dict[str, float]:
    """L2 errors of v, rho and z, and of Pi where it is a field of its own."""
    u, mesh = simulation.rothe_step.now, simulation.mesh
    found = {
        "v": distance(u.v, exact.v, mesh),
        "rho": distance(u.rho, exact.rho, mesh),
        "z": distance(u.z, exact.z, mesh),
    }
    if "Pi" in u.parts:
        found["Pi"] = distance(u.Pi, exact.Pi, mesh)
    return found


def free_solution(
    kind: str,
    steps: int,
    duration: float,
    *,
    p: float | None = None,
    driven: bool = False,
    delta: bool = True,
    **options: Any,
) -> nv.Simulation:
    """A run from the manufactured initial state, with creep, gravity and viscosity.

    ``driven`` has all terms (without ``delta`` not the delta-terms) and the manufactured sources, whose
    difference in time is far shorter than any step; ``p`` is the hyperviscosity's exponent, None for none;
    ``options`` are the simulation's.
    """
    system = model(kind, 2, p, regularised=driven, delta=delta)
    time.Set(0.0)
    exact = Exact(system, 2, 0.0)
    initial = nv.Initial(density=exact.rho, velocity=exact.v, values=exact.values)
    sources = Sources(system, 2, SHORT) if driven else None
    simulation = nv.Simulation(
        box((1, 1), 0.6), system, dt=duration / steps, initial=initial, sources=sources, **options
    )
    simulation.run(duration)
    return simulation


def separation(one: nv.Simulation, other: nv.Simulation) -> dict[str, float]:
    """L2 distances of v, rho and z of two runs on equal meshes of their own."""
    best = one.rothe_step
    copy = GridFunction(best.layout.space)
    copy.vec.data = other.rothe_step.state.vec
    u = best.layout.fields(copy.components)
    return {name: distance(getattr(u, name), getattr(best.now, name), one.mesh) for name in ("v", "rho", "z")}
