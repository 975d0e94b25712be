"""Heat in motion against manufactured solutions: rates in space and time, with a negative control."""

from functools import partial
from itertools import pairwise

from ngsolve import CF, CoefficientFunction

from tests.verification.case import Cases, Outcome, each, measured
from tests.verification.convergence import coupled_rates, free_solution, separation
from tests.verification.rates import RateTable
from tests.verification.sources import Sources

CASES = Cases("Heat")

KIND = "with heat"


class WithoutItsHeat(Sources):
    """Sources that do not know that what dissipates is heat, nor that heat is conducted."""

    def heating(self, Pi: CoefficientFunction) -> CoefficientFunction:
        return CF(0.0)


def _in_space(p: float | None) -> Outcome:
    right, wrong = (
        coupled_rates(KIND, 2, p, 2, 1, 0.4, 3, regularised=p is not None, delta=False, sources=sources)
        for sources in (Sources, WithoutItsHeat)
    )
    wrong.title += ", sources without heat"
    values = {f"rate of {name}": right.last(name) for name in right.errors}
    return measured(
        values | {"rate of z where the sources have no heat": wrong.last("z")},
        right.table("h, m"),
        wrong.table("h, m"),
    )


def _space(name: str, p: float | None, terms: str, least: dict[str, float]) -> None:
    CASES(f"""{name}
        A moving body that is heated by {terms}, and conducts it, converges to a manufactured solution of v,
          rho, F, J, A and s.
        label: heat-entropy, heat-temperature
        setting: Unit square, 0.4 m refined twice, k = 2, m = 1; gruneisen = 0.8, kappa = theta^1.5/4 W/(m K),
          gravity; two steps of 0.05 s with the discrete time derivative in the sources.
        {each(f"- rate of {of} >= {rate}: as without heat" for (of, rate) in least.items())}
        - rate of z where the sources have no heat <= 0.5: the negative control: an error stays
        """)(partial(_in_space, p))


_space("heat-moving", None, "viscosity and creep", {"v": 2.7, "rho": 1.85, "z": 1.85})
_space(
    "heat-moving-hyper",
    4.0,
    "viscosity, hyperviscosity with p = 4, epsilon |v|^(p-2) v and creep",
    {"v": 1.7, "rho": 1.75, "z": 1.75},
)


@CASES(f"""heat-moving-time
    With manufactured sources that drive every mechanism and heat, the midpoint rule is of order 2 in v, rho
      and z, the entropy among these.
    label: heat-weak
    setting: As heat-moving with hyperviscosity (p = 2) and epsilon-terms; one mesh, differences of successive
      runs of 4, 8, 16, 32 steps in 0.1 s.
    {each(f"- rate of {name} >= 1.9: second order" for name in ("v", "rho", "z"))}
    """)
def _in_time() -> Outcome:
    runs = [
        free_solution(
            KIND, steps, 0.1, p=2.0, driven=True, delta=False, scheme="midpoint", velocity_scale=3e5
        )
        for steps in (4, 8, 16, 32)
    ]
    table = RateTable("differences of successive steps")
    for steps, (coarse, fine) in zip((4, 8, 16), pairwise(runs), strict=True):
        table.add(0.1 / steps, **separation(fine, coarse))
    return measured(
        {f"rate of {name}": table.last(name) for name in table.errors},
        table.table("tau, s"),
        "The upwinding is smooth up to 30 m/s: with 0.3 m/s rho has the rate 1.4, with 3 m/s 1.8.",
    )
