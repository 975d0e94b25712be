"""The themes of the plane in three dimensions, small: stability, estimates, limits."""

from functools import partial

from tests.verification.case import Cases, Outcome, each
from tests.verification.cases import sequence, stability, whole_scheme
from tests.verification.setups import KINDS, LABELS, cube_mesh

CASES = Cases("Three dimensions")

CUBE = (
    "The block of the plane's cases as a cube of 1 m, its eddy multiplied by 1 + 0.3 cos(pi z), gravity, "
    "where there is any, along -z; "
)
COARSE, FINE = 1.0, 0.5
"""Sizes of the cells, m: 12 and 28 tetrahedra."""

# --- stability, estimates, limits: the plane's measurements on other meshes -----------------------------

TAUS = {"linearised": (1e-3, 1e-1, 10.0), "finite": (1e-3, 1e-2, 1e-1)}
"""s; at finite strain no longer ones, for the time that they take."""

SIZES = (1e-2, 1e-3)


def stable(kind: str) -> Outcome:
    """``stability`` on a cube."""
    return stability.measure(kind, 0.0, cube_mesh(FINE), TAUS[kind], 3)


def estimated(kind: str) -> Outcome:
    """``whole_scheme`` on cubes."""
    return whole_scheme.estimates(kind, {h: cube_mesh(h) for h in (COARSE, FINE)}, SIZES, 4)


def limits(kind: str) -> Outcome:
    """``sequence`` on a cube."""
    return sequence.sequence(
        kind,
        {FINE: cube_mesh(FINE)},
        sequence.STEPS,
        sequence.SIZES[kind][-2:] if kind == "finite" else SIZES,
    )


# --- the cases --------------------------------------------------------------------------------------------


for kind in KINDS:
    finite = kind == "finite"
    CASES(f"""space-stability-{kind}
        In three dimensions too energy never rises in a step of {KINDS[kind]}.
        label: {stability.BALANCES[kind]}
        setting: {CUBE}cells of {FINE} m, three steps each of tau = 1e-3,
          {"0.01 and 0.1" if finite else "0.1 and 10"} s.
        {stability.BOUNDS}
        """)(partial(stable, kind))
    CASES(f"""space-estimates-{kind}
        In three dimensions too the estimates of {KINDS[kind]} hold with all its terms.
        label: {"Euler-large-est, Euler-large-est+" if finite else "Euler-small-est, Euler-small-est+"}
        setting: {CUBE}all terms of the scheme; cells of {COARSE} and {FINE} m, four steps of
          {whole_scheme.TAU} s, epsilon = delta = 1e-2 and 1e-3.
        {each(whole_scheme.bounds(kind))}
        """)(partial(estimated, kind))
    CASES(f"""space-limits-{kind}
        In three dimensions too {KINDS[kind]} converges as tau, delta and epsilon -> 0 in turn.
        label: {LABELS[kind]}, {"ED-Euler-large-polyconvex-eta" if finite else "Euler-small-converge+"}
        setting: {CUBE}all terms of the scheme; cells of {FINE} m, until {sequence.DURATION} s; 8 to 64 steps,
          then delta, then epsilon of {"1e-4 and 1e-5" if finite else "1e-2 and 1e-3"}.
        {each(sequence.bounds(kind))}
        """)(partial(limits, kind))
