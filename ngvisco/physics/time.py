"""The run's time, of which loads, wall velocities and tractions may be functions, and who else reads it."""

import numpy as np
from ngsolve import CoefficientFunction, Parameter
from ngsolve.meshes import MakeStructured2DMesh

time = Parameter(0.0)
"""Time in seconds, to be used in what depends on it; its value is the end of the last step."""

_PLACES = (0.1, 0.35, 0.6, 0.9)


def reads_time(function: CoefficientFunction) -> bool:
    """Whether a function has other values at other times; other parameters of NGSolve's are numbers."""
    if "ParameterCoefficientFunction" not in str(function):
        return False
    present, found = time.Get(), []
    try:
        for t in (present, present + 0.37, 2 * present + 1.9):
            time.Set(t)
            found.append(sampled(function))
    finally:
        time.Set(present)
    return not all(one_value(list(values)) for values in zip(*found, strict=True))


def sampled(function: CoefficientFunction) -> list[float]:
    """The values at places in cells of different sizes; inf and NaN together where there is none."""
    found = []
    for cells in (1, 3):
        mesh = MakeStructured2DMesh(quads=False, nx=cells, ny=cells)
        try:
            found += [function(mesh(place, 0.5 * place)) for place in _PLACES]
        except Exception:  # NGSolve's own, for what cannot be evaluated on any mesh
            return [np.inf, np.nan]
    return found


def one_value(found: list[float]) -> bool:
    """Whether values are the same but for rounding."""
    return bool(np.allclose(found, found[0], rtol=1e-12, atol=0.0, equal_nan=True))
