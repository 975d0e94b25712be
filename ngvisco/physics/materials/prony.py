"""Prony series: networks given by shares of a modulus and relaxation times."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.activation import WLF, Activated
from ngvisco.physics.flow_rules import Creep, FlowRule
from ngvisco.physics.material import Material
from ngvisco.physics.materials.fluids import OldroydB
from ngvisco.physics.materials.hyperelastic import (
    IsotropicElastic,
    ReferentialMooneyRivlin,
    ReferentialNeoHookean,
)
from ngvisco.physics.materials.linearised import LinearElastic
from ngvisco.physics.materials.network import Branch, Network
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.signals import number_rows
from ngvisco.physics.tensors import as_array

SPRING = "spring"
"""Name of the branch that does not relax; the others are ``mode_1``, ``mode_2``, ..."""
_SHEAR, _BULK = ("G_e", "G_mr", "G_h"), ("K_e", "K_h", "epsilon")
"""Names of moduli that are shared among the branches; and names of volume moduli, which only the first branch
has."""


def prony_network(
    material: Material,
    prony: Annotated[ArrayLike, Quantity("1, s", example=[[0.3, 1.0], [0.2, 10.0]])],
    of: Annotated[Literal["G_0", "G_inf"], Quantity(example="G_0")],
    E: Annotated[float | None, Quantity("J/mol", example=1e5)] = None,
    C_1: Annotated[float | None, Quantity("1", "> 0", 17.4)] = None,
    C_2: Annotated[float | None, Quantity("K", "> 0", 51.6)] = None,
    theta_R: Annotated[float, Quantity("K", "> 0", 293.0)] = 293.0,
    temperature: Annotated[Modulus | None, Quantity("K", "> 0", 300.0)] = None,
) -> Network:
    """A network whose shear modulus relaxes as G(t) = G_inf + sum g_i G exp(-t/tau_i), G = G_0 or G_inf.

    The network has a spring ``spring``, unless shares of G_0 add up to 1, and Maxwell branches ``mode_1``,
    ``mode_2``, ... in the order of the table; its first branch has the whole bulk modulus.  Branches of
    ``OldroydB`` and ``FENEP`` have the law ``conformation``, so that the series also holds for a finite step
    of shear; for other materials the series holds at small strains.  With E, or C_1 and C_2, all times are
    divided by the factor of Arrhenius (``Activated``) or of Williams, Landel and Ferry (``WLF``), which is 1
    at theta_R.  Raises ParameterError for an invalid table, shares of G_0 whose sum is above 1, a material
    whose moduli are not known, and a material that bears no pressure.

    Example::

        import ngvisco as nv

        rubber = nv.ReferentialNeoHookean(K_e=100.0, G_e=5.0)  # G_0 = 10 Pa
        material = nv.prony_network(rubber, prony=[[0.3, 1.0], [0.2, 10.0]], of="G_0")
        print([(name, branch.material.G_e) for name, branch in material.parts.items()])

    Parameters
    ----------
    material : Material
        Material whose modulus is G_0 or G_inf, as ``of`` says: ``LinearElastic``, ``HardeningElastic``,
        ``OldroydB``, ``FENEP``, ``ReferentialNeoHookean``, ``IsochoricNeoHookean`` or
        ``ReferentialMooneyRivlin``.
    prony : array
        Rows of a share g_i > 0 and a relaxation time tau_i > 0 at theta_R; ``read_prony`` reads the rows
        from a file, which a case file names by { file = "table.csv" }.
    of : str
        Modulus G to which the shares refer, and which is the modulus of the material: "G_0", at the shortest
        times, with G_inf = (1 - sum g_i) G_0, or "G_inf", at the longest times, with G_0 = (1 + sum g_i)
        G_inf.
    E : float, optional
        Activation energy of all relaxation times.
    C_1, C_2 : float, optional
        Constants of the shift log10 a_T = -C_1 (theta - theta_R)/(C_2 + theta - theta_R), instead of E.
    theta_R : float
        Temperature to which the times of the table belong.
    temperature : float, optional
        A number, a function of the initial place, or an expression of parameters; None is the material's
        temperature, and ``Thermal`` then has to wrap the network.
    """
    rows = _table(prony)
    shear, law = _shear_modulus(material)
    if of not in ("G_0", "G_inf"):
        raise ParameterError("prony_network.of", of, '"G_0" or "G_inf"')
    shifts = {"E": E, "C_1": C_1, "C_2": C_2}
    if (C_1 is None) != (C_2 is None) or (E is not None and C_1 is not None):
        expected = "E alone, or C_1 and C_2 together, or none of the three"
        raise ParameterError("prony_network.C_1", shifts, expected)
    left = 1 - float(rows[:, 0].sum()) if of == "G_0" else 1.0
    if left < -1e-12:
        expected = f"shares of G_0 whose sum is at most 1, not {1 - left:.6g}; shares of G_inf have no bound"
        raise ParameterError("prony_network.prony", prony, expected)
    parts = {}
    if left > 1e-12:
        parts[SPRING] = Branch(material=_scaled(material, left, keeps_bulk=True))
    for i, (share, time) in enumerate(rows.tolist(), start=1):
        rule: FlowRule = Creep(G_m=2 * share * time * shear, law=law)
        if E is not None:
            rule = Activated(rule=rule, E=E, theta_R=theta_R, temperature=temperature)
        elif C_1 is not None and C_2 is not None:
            rule = WLF(rule=rule, C_1=C_1, C_2=C_2, theta_R=theta_R, temperature=temperature)
        parts[f"mode_{i}"] = Branch(material=_scaled(material, share, keeps_bulk=not parts), creep=rule)
    return Network(branches=parts)


def read_prony(path: str | os.PathLike[str]) -> np.ndarray:
    """The rows (g_i, tau_i), (n, 2), of a CSV file. Comments after # and a line of names are left out.

    Raises ParameterError for a file that cannot be read, for rows that are not two numbers, and for names of
    columns that say that the times come first.
    """
    return _table(number_rows("read_prony.path", path, timed=1).tolist())


def _table(prony: Any) -> np.ndarray:
    rows = as_array(prony)
    if rows.ndim != 2 or rows.shape[1] != 2 or not len(rows) or not (rows > 0).all():
        expected = "rows [g, tau] of two numbers > 0: a share g of the modulus, and a time tau in s"
        raise ParameterError("prony_network.prony", prony, expected)
    return rows


def _shear_modulus(material: Any) -> tuple[Any, Literal["mandel", "conformation"]]:
    """The shear modulus at rest, Pa, and the law of creep."""
    if isinstance(material, LinearElastic):
        return material.G_e, "mandel"
    if isinstance(material, OldroydB):
        return 2 * material.G_e, "conformation"
    if isinstance(material, ReferentialMooneyRivlin):
        return 2 * (material.G_e + material.G_mr), "mandel"
    if isinstance(material, ReferentialNeoHookean):
        return 2 * material.G_e, "mandel"
    expected = (
        "LinearElastic, ReferentialNeoHookean, ReferentialMooneyRivlin, IsochoricNeoHookean, OldroydB or "
        "FENEP"
    )
    if isinstance(material, IsotropicElastic):
        expected += ", since the energy of other materials has no separate part of shear"
    raise ParameterError("prony_network.material", material, expected)


def _scaled(material: Any, share: float, keeps_bulk: bool) -> Material:
    """The material with a share of its shear moduli, and with all of its volume moduli or with none."""
    changes = {name: share * getattr(material, name) for name in _SHEAR if hasattr(material, name)}
    if not keeps_bulk:
        changes |= {name: 0.0 for name in _BULK if hasattr(material, name)}
        if hasattr(material, "J_min"):
            changes["J_min"] = None
    return replace(material, **changes)
