"""Linear maps D of symmetric 3x3 tensors to such, in the three notations in use.

* ``"tensor"``: D_ijkl, (3, 3, 3, 3), with D_ijkl = D_jikl = D_ijlk.
* ``"voigt"``: (6, 6), from (e_11, e_22, e_33, 2 e_23, 2 e_13, 2 e_12) to (s_11, s_22, s_33, s_23, s_13,
  s_12); its entries are the D_ijkl themselves.
* ``"mandel"``: (6, 6), from (e_11, e_22, e_33, sqrt(2) e_23, sqrt(2) e_13, sqrt(2) e_12) to the same of s:
  the matrix of D in an orthonormal basis, whose eigenvalues are those of D.
"""

from typing import Literal, TypeAlias

import numpy as np

from ngvisco.errors import ParameterError

Notation: TypeAlias = Literal["mandel", "voigt", "tensor"]

PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Entries in the order of the 6x6 notations: 11, 22, 33, 23, 13, 12."""

_TOLERANCE = 1e-12
"""Of symmetry and of eigenvalues, over the largest entry: what rounding in the input leaves."""


def mandel_matrix(field: str, value: object, notation: Notation) -> np.ndarray:
    """D as a symmetric (6, 6) matrix in Mandel's notation.

    Raises ParameterError for another shape, entries that are no finite numbers, and a D that is not
    symmetric: the message has the entries that differ.

    Parameters
    ----------
    field : str
        The parameter's name, for errors.
    value : array_like
        (6, 6), or (3, 3, 3, 3) for ``"tensor"``.
    notation : str
        ``"mandel"``, ``"voigt"`` or ``"tensor"``.
    """
    shape = (3, 3, 3, 3) if notation == "tensor" else (6, 6)
    expected = f"{'x'.join(map(str, shape))} finite numbers in the notation {notation!r}"
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ParameterError(field, value, expected) from None
    if array.shape != shape:
        raise ParameterError(field, f"an array of shape {array.shape}", expected)
    if not np.isfinite(array).all():
        raise ParameterError(field, value, expected)
    if notation == "tensor":
        for axes, names in (((1, 0, 2, 3), "jikl"), ((0, 1, 3, 2), "ijlk"), ((2, 3, 0, 1), "klij")):
            _require_equal(field, array, array.transpose(axes), f"D_ijkl = D_{names}")
        matrix = np.array([[array[*first, *second] for second in PAIRS] for first in PAIRS])
    else:
        _require_equal(field, array, array.T, "a symmetric D")
        matrix = 0.5 * (array + array.T)
    weights = _WEIGHTS if notation != "mandel" else np.ones(6)
    return weights[:, None] * matrix * weights


def full_tensor(mandel: np.ndarray) -> np.ndarray:
    """D_ijkl, (3, 3, 3, 3), of a matrix in Mandel's notation."""
    entries = mandel / _WEIGHTS[:, None] / _WEIGHTS
    tensor = np.empty((3, 3, 3, 3))
    for a, (i, j) in enumerate(PAIRS):
        for b, (m, n) in enumerate(PAIRS):
            for row in ((i, j), (j, i)):
                tensor[*row, m, n] = tensor[*row, n, m] = entries[a, b]
    return tensor


def require_semidefinite(field: str, value: object, mandel: np.ndarray) -> None:
    """Raise ParameterError, with the strain that shows it, where e : D e < 0 for some e."""
    eigenvalues, modes = np.linalg.eigh(mandel)
    if eigenvalues[0] < -_TOLERANCE * max(abs(eigenvalues[-1]), abs(eigenvalues[0])):
        e = modes[:, 0] / _WEIGHTS
        shown = ", ".join(f"e_{i + 1}{j + 1} = {x:.3g}" for x, (i, j) in zip(e, PAIRS, strict=True))
        expected = f"e : D e >= 0 for every strain rate e; it is {eigenvalues[0]:.3g} for {shown}"
        raise ParameterError(field, value, expected)


_WEIGHTS = np.array([1.0, 1.0, 1.0, *(3 * [2**0.5])])


def _require_equal(field: str, one: np.ndarray, other: np.ndarray, expected: str) -> None:
    difference = np.abs(one - other)
    at = np.unravel_index(int(np.argmax(difference)), one.shape)
    if difference[at] > _TOLERANCE * np.abs(one).max():
        place = "".join(str(int(i) + 1) for i in at)
        raise ParameterError(
            field,
            f"{float(one[at])!r} at {place}",
            f"{expected}: there is {float(other[at])!r} opposite to it",
        )
