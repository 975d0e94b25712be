"""Tensors of bodies with sharp interfaces: slopes in cut cells, and determinants that follow from the volume.

The rates of B and J keep det B = J^p, since tr Pi = 0; here J = 1/N. If matter is strained unequally, the
mean of its tensors has a larger determinant, and no flow takes this mean back to I. A body that has recovered
its shape would therefore keep a strain, unless determinants are restored.
"""

from __future__ import annotations

import numpy as np
from scipy.special import factorial

from ngvisco.forms.spaces import Layout
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.mixture import Mixture

LEAST = 1e-3
"""Fraction below which a cell does not contain a body."""
_LEAST_DET = 0.05
"""Least determinant, relative to its right value, of a tensor that is restored completely."""


def quotients(amount: np.ndarray, X: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Linear B, values at corners of cells, (components, cells, corners): X/n projected with the weight n.

    ``amount`` has the values of n, (cells, corners), and ``X`` has the values of its tensors. Corners with n
    < 0 are left out. So that B stays bounded where n vanishes, a trace of the mean amount of all matter,
    ``total``, (cells,), is added with the mean of X/n.  If X is n times a constant, B is this constant.
    """
    trace, one = LEAST * total, np.eye(amount.shape[1])
    X, amount = np.where(amount > 0, X, 0.0), np.maximum(amount, 0.0) + trace[:, None]
    X = X + (trace / np.maximum(amount.mean(axis=1) - trace, LEAST * trace) * X.mean(axis=2))[..., None]
    powers = one[:, None] + one, one[:, None, None] + one[:, None] + one
    pairs, triples = (np.prod(factorial(of), axis=-1) for of in powers)  # integrals of products of lambda
    matrices = np.einsum("kc,abc->kab", amount, triples) / (len(one) + 2)
    return np.asarray(np.linalg.solve(matrices, np.einsum("skb,ab->kas", X, pairs)).transpose(2, 0, 1))


class Determinants:
    """Restores det B of bodies with linear energies in all cells, without a rise of the stored energy."""

    def __init__(self, layout: Layout, material: Mixture, ranks: Communicator) -> None:
        slices, spaces = layout.states.slices, layout.states.spaces
        names = [body.name for body in material.bodies]
        self._amounts = [slices[AMOUNT + name].start for name in names]
        self._tensors = [
            [
                (slices[X.name], spaces[X.name].columns, X.power)
                for X in material.contents(name)
                if X.power is not None
            ]
            for name in names
        ]
        """Components of each X_i, their basis, and the power p of det B = J^p."""
        self._strained = 3 if layout.symmetry.is_axisymmetric else layout.states.dim
        """Number of directions in which matter is strained: 2 in plane strain, else 3."""
        self._is_uniform = not material.parameters
        """Whether the energies have the same moduli everywhere."""
        self._ranks = ranks

    def restore(self, u: np.ndarray, masses: np.ndarray) -> None:
        """Change ``u`` in place so that det B has its value at all corners.

        ``u`` has values at corners, (components, cells, corners), with the integrals ``masses``, (cells,
        corners).  Where det B is too small, only a share of the change is made, so that the energy does not
        rise.
        """
        total, d = u[self._amounts].sum(axis=0), self._strained
        for n, tensors in zip(self._amounts, self._tensors, strict=True):
            cell, corner = np.nonzero((u[n] > LEAST * total) & (total > 0))
            amount, density = u[n, cell, corner], total[cell, corner]
            for where, columns, power in tensors:
                B = (columns @ u[where, cell, corner] / amount).T.reshape(-1, 3, 3)
                excess = np.linalg.det(B) * density**power
                is_sound = np.linalg.eigvalsh(B)[:, 0] > 0
                change = np.where(is_sound, np.maximum(excess, _LEAST_DET) ** (-1 / d), 1.0) - 1
                energies = np.trace(B[:, :d, :d], axis1=1, axis2=2) * amount * masses[cell, corner] * change
                falls = -self._ranks.total(energies[change < 0].sum())
                rises = self._ranks.total(energies[change > 0].sum())
                share = min(1.0, falls / rises) if rises > 0 and self._is_uniform else 0.0
                B[:, :d, :d] *= (1 + np.where(change > 0, share, 1.0) * change)[:, None, None]
                u[where, cell, corner] = columns.T @ B.reshape(-1, 9).T * amount
