"""The fields of a step: trial functions, test functions or known values of the unknowns, with the step's
data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

from ngsolve import CoefficientFunction

from ngvisco.forms.context import Context, StepLayout
from ngvisco.forms.spaces import Proxies
from ngvisco.forms.unknown_values import Part, UnknownValues


class Fields(UnknownValues):
    """Trial functions, test functions or known values of a step's unknowns, with the step's context."""

    layout: StepLayout

    def __init__(
        self,
        layout: StepLayout,
        parts: Mapping[str, Any],
        context: Context | None = None,
        gradient: Callable[[str], Any] | None = None,
        rows: int | None = None,
        functions: Proxies | None = None,
    ) -> None:
        """``parts`` are proxies, grid functions or arrays of values by the unknowns' names.

        ``context`` has the known data at the same points, by default the layout's data. ``gradient`` returns
        the gradient of a part, by default by NGSolve.  With ``rows = 1`` the fields have one component of v,
        because forms linear in v, a and the hyperstress are equal for all components.  ``functions``, if
        given, are the trial or test functions with these parts.
        """
        super().__init__(layout, parts, gradient, rows, functions)
        self._context = context

    @classmethod
    def of(cls, layout: StepLayout, parts: Sequence[Any]) -> Fields:
        """Fields of trial or test proxies, or of a grid function's components, in the layout's order."""
        return cls(layout, dict(zip(layout.names, parts, strict=True)))

    @property
    def context(self) -> Context:
        """Data of the step at the fields' points: old fields, step length, normal, upwinding."""
        return self.layout.context if self._context is None else self._context


class Tests(Fields):
    """Tests of the unknowns; with bodies rho has no equation and no test."""

    rho = Part()
    rho_hat = Part()

    @cached_property
    def grad_rho(self) -> CoefficientFunction:
        return self.gradient("rho")
