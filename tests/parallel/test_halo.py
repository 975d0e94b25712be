"""Cells across shared facets come after a rank's own, and what they are given goes back to their ranks."""

import numpy as np
import pytest

from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.halo import Halo, HaloUnknowns


class Facets(Exchange):
    """Three facets of a rank, the last two of which it shares with a rank that has ``theirs`` there."""

    theirs: np.ndarray

    def __init__(self):
        super().__init__(3, {1: np.array([1, 2])}, Communicator())

    def others(self, values):
        self.sent = values
        return np.broadcast_to(self.theirs, values.shape).copy()


@pytest.fixture
def halo():
    """Of four cells, of which the third has both shared facets."""
    return Halo(Facets(), np.array([2, 2]), 4)


def test_values_of_cells_beyond_come_last(halo):
    halo.facets.theirs = np.array([7.0, 8.0])
    values = np.arange(12.0).reshape(4, 3)
    found = halo.with_others(values)
    assert (found[:4] == values).all() and (found[4:] == [[7.0] * 3, [8.0] * 3]).all()
    assert (halo.facets.sent == values[[2, 2]].T).all()


def test_a_cell_with_two_shared_facets_gets_what_both_give(halo):
    halo.facets.theirs = np.array([7.0, 8.0])
    rows = np.arange(6.0)
    assert (halo.added(rows) == [0, 1, 2 + 7 + 8, 3]).all()
    assert (halo.facets.sent == rows[4:]).all() and rows[2] == 2


def test_unknowns_of_cells_stand_one_after_the_other(halo):
    halo.facets.theirs = np.array([7.0, 8.0])
    unknowns = HaloUnknowns(halo, 2)
    values = np.arange(16.0).reshape(2, 8)
    found = unknowns.with_others(values)
    assert found.shape == (2, unknowns.count) == (2, 12)
    assert (found[:, :8] == values).all() and (found[:, 8:] == [7, 7, 8, 8]).all()
    assert (unknowns.of_owners(found) == found).all()
    assert (unknowns.owned == ([True] * 8 + [False] * 4)).all()
    assert (unknowns.of_cells_alone(values)[:, 8:] == 0).all()
    added = unknowns.added(found) - values
    assert (added == np.array([[0, 0, 0, 0, 15, 15, 0, 0]] * 2)).all()


def test_one_process_does_nothing():
    halo = Halo(Exchange(3, {}, Communicator()), np.zeros(0, dtype=np.int64), 4)
    unknowns, values = HaloUnknowns(halo, 2), np.arange(8.0)
    assert unknowns.count == unknowns.of_cells == 8
    for function in (unknowns.with_others, unknowns.of_cells_alone, unknowns.added):
        assert function(values) is values
    assert halo.with_others(values) is values and halo.added(values) is values
