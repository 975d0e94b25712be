"""The model of scaling finds what counted rows were made of; nothing is run."""

import json

import pytest

from tests.benchmarks.ranks import markdown
from tests.benchmarks.scaling import ALL_FACES, FACES, Network, fitted, main, report, seconds

FIXED, OF_CELL, SURFACE, EXCHANGES = 0.3, 1.4e-3, 4e4, 800


def row(n, ranks, rank):
    cells = 6 * n**3
    own = cells // max(ranks, 1) if rank or not ranks else 0
    sent = SURFACE * FACES.get(ranks, ALL_FACES) * own ** (2 / 3)
    twice = {"wall": 2.0, "busy": FIXED + OF_CELL * own, "bytes": sent, "reductions": 250, "linear": 80}
    twice |= {"messages": EXCHANGES * (ranks - 1) if own and ranks else 0, "iterations": 9}
    ledger = [{"kinetic": 1.0, "stored": 1.0, "closure": 0.0}]
    return {
        "n": n,
        "ranks": ranks,
        "rank": rank,
        "coarse": "direct",
        "cells": cells,
        "own cells": own,
        "neighbours": ranks - 1 if own and ranks else 0,
        "imports": 0.1,
        "memory": 1.0,
        "ledger": ledger,
    } | {name: [10 * value, value, value] for name, value in twice.items()}


ROWS = [row(n, ranks, rank) for n in (6, 10) for ranks in (1, 2, 4, 8) for rank in range(ranks + 1)]


def test_fit_finds_what_rows_are_made_of():
    fit = fitted(ROWS)
    assert (fit.fixed, fit.of_cell) == pytest.approx((FIXED, OF_CELL), rel=1e-6)
    assert (fit.surface, fit.spread, fit.exchanges) == pytest.approx((SURFACE, 1.0, EXCHANGES), rel=1e-6)


def test_model_is_what_was_measured_where_nothing_is_sent():
    assert seconds(fitted(ROWS), Network(), 6000, 1)["step"] == pytest.approx(FIXED + OF_CELL * 6000)


def test_only_a_slower_network_costs_more():
    fit = fitted(ROWS)
    fast, slow = (seconds(fit, Network(latency=latency), 1e6, 500) for latency in (1e-6, 1e-5))
    assert slow["step"] > fast["step"] and slow["cells"] == fast["cells"]
    assert slow["messages"] == pytest.approx(10 * fast["messages"])


@pytest.mark.long
@pytest.mark.ci
def test_report_has_a_picture_and_says_that_it_is_a_model(tmp_path):
    (tmp_path / "ranks.json").write_text(json.dumps(ROWS))
    assert main([str(tmp_path / "ranks.json"), "-o", str(tmp_path)]) == 0
    assert (tmp_path / "scaling.png").stat().st_size > 1000
    assert "A model" in (tmp_path / "scaling.md").read_text() and "| 1000 |" in report(ROWS, Network())


def test_table_has_a_row_for_each_number_of_ranks():
    text = markdown([row(6, ranks, rank) for ranks in (0, 2) for rank in range(max(ranks, 0) + 1)])
    assert "| no MPI |" in text and "| 2 |" in text
