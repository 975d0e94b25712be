"""Fixtures of the solvers' tests."""

import numpy as np
import pytest

from ngvisco.algebra import precision


@pytest.fixture
def double_precision(monkeypatch):
    """The flow's operator in double precision, so that a wrong term shows to rounding."""
    monkeypatch.setattr(precision, "SINGLE", np.float64)
