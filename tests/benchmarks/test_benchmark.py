"""The benchmark's command works, on tiny meshes; no time is asserted."""

import json

import pytest

from tests.benchmarks import schemes
from tests.benchmarks.__main__ import main
from tests.benchmarks.table import summary, summary_of_schemes


@pytest.mark.long
def test_quick_run_saves_its_table(tmp_path, capsys):
    assert main(["--quick", "--steps", "1", "-o", str(tmp_path)]) == 0
    every = json.loads((tmp_path / "benchmark.json").read_text())
    rows = [row for row in every if "dim" in row]
    assert {(row["dim"], row["method"]) for row in rows} == {
        (2, "split"),
        (3, "split"),
        (2, "coupled"),
        (3, "coupled"),
    }
    assert all(row["closure"] <= 1e-10 and row["memory"] > 0 for row in rows)
    of_schemes = [row for row in every if "dim" not in row]
    assert {row["scheme"] for row in of_schemes} == set(schemes.COMPARED)
    text = (tmp_path / "benchmark.md").read_text()
    assert "coupled over split" in text
    assert "backward-euler over midpoint" in text
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


@pytest.mark.parametrize("order", [1, 2])
def test_steps_to_an_error_are_nearly_the_fewest(order):
    """Of a scheme whose error is C/n^p with a term of higher order."""

    def error(steps):
        return 10.0 / steps**order + 20.0 / steps ** (order + 1)

    rows = schemes.within([0.002, 0.02], lambda n: {"kinetic": 1 - error(n), "steps": n}, 1.0, order)
    assert [row["tolerance"] for row in rows] == [0.02, 0.002]
    for row in rows:
        assert row["error"] == pytest.approx(error(row["steps"])) and row["error"] <= row["tolerance"]
        assert error(0.9 * row["steps"] - 1) > row["tolerance"]


def test_extrapolated_value_is_free_of_the_leading_error():
    assert schemes.extrapolated(3.0 + 0.4**2, 3.0 + 0.2**2, order=2) == pytest.approx(3.0)


@pytest.mark.long
@pytest.mark.ci
def test_runs_of_every_scheme_come_within_the_error_asked_for():
    """On a coarse mesh over 0.06 s; no time is asserted."""
    rows = schemes.main(maxh=0.5, until=0.06, finest=6, tolerances=[0.2])
    assert [row["scheme"] for row in rows] == list(schemes.COMPARED)
    assert all(row["error"] <= 0.2 and row["closure"] <= 1e-10 for row in rows)
    assert rows[0]["steps"] > rows[1]["steps"]
    assert "to 20.0%: backward-euler over sdirk2" in summary_of_schemes(rows)
