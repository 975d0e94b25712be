"""The benchmark's command works, on tiny meshes; no time is asserted."""

import json
from itertools import product

import pytest

from tests.benchmarks.__main__ import main
from tests.benchmarks.ranks import markdown
from tests.benchmarks.table import against, summary


@pytest.mark.long
def test_quick_run_saves_its_table(tmp_path, capsys):
    assert main(["--quick", "--steps", "1", "-o", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "benchmark.json").read_text())
    assert {(row["dim"], row["method"]) for row in rows} == set(product((2, 3), ("split", "coupled")))
    assert all(row["closure"] <= 1e-10 and row["memory"] > 0 for row in rows)
    head, line, *said = (tmp_path / "benchmark.md").read_text().splitlines()
    assert all(head.count("|") == one.count("|") for one in (line, *said[: len(rows)]))
    text = (tmp_path / "benchmark.md").read_text()
    assert "coupled over split" in text
    assert "one thread over two" in capsys.readouterr().out


def test_exponents_are_fitted():
    row = {"dim": 3, "method": "split", "threads": 2, "maxh": 1.0}
    rows = [
        row | {"cells": n, "step": 2e-3 * n**1.1, "memory": 1e-4 * n, "maxh": 1 / n}
        for n in (1000, 4000, 16000)
    ]
    text = summary(rows)
    assert "step grows like cells^1.10" in text
    assert "memory grows like cells^1.00" in text


def test_table_has_a_row_for_each_number_of_ranks():
    ledger = [{"kinetic": 1.0, "stored": 1.0, "closure": 0.0}]
    of_rank = {"coarse": "direct", "imports": 0.1, "memory": 1.0, "ledger": ledger}
    taken = ("wall", "busy", "iterations", "linear", "messages", "bytes", "reductions")
    of_rank |= {name: [20.0, 2.0, 2.0] for name in taken}
    rows = [of_rank | {"ranks": n, "own cells": cells} for n, cells in ((0, 12), (2, 0), (2, 5), (2, 7))]
    text = markdown(rows)
    assert "| no MPI | direct | 12 | 2.00 s |" in text and "| 2 | direct | 5 to 7 |" in text


def test_rows_of_one_table_only_are_named():
    rows = [{"n": 1, "step": 2.0}, {"n": 2, "step": 1.0}, {"n": 3, "failed": "no"}]
    text = against(rows, [{"n": 1, "step": 4.0}, {"n": 3, "step": 1.0}], ["n"], ["step"])
    assert "| 1 | 0.50 |" in text
    assert "only in the new table: (2,)" in text and "only in the old table: (3,)" in text
    assert against(rows, [], ["n"], ["step"]) == ""
