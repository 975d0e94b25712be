"""The benchmark's command works, on tiny meshes; no time is asserted."""

import json

import pytest

from tests.benchmarks.__main__ import main
from tests.benchmarks.table import summary


@pytest.mark.long
@pytest.mark.ci
def test_quick_run_saves_its_table(tmp_path, capsys):
    assert main(["--quick", "--steps", "1", "-o", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "benchmark.json").read_text())
    assert {(row["dim"], row["method"]) for row in rows} == {
        (2, "split"),
        (3, "split"),
        (2, "coupled"),
        (3, "coupled"),
    }
    assert all(row["closure"] <= 1e-10 and row["memory"] > 0 for row in rows)
    assert "coupled over split" in (tmp_path / "benchmark.md").read_text()
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
