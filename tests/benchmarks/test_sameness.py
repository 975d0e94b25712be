"""The table of sameness over ranks names what misses its bounds; nothing is run."""

import pytest

from tests.benchmarks import sameness


def result(iterations=10, linear=100, kinetic=1.0):
    rows = [{"kinetic": kinetic, "stored": 2.0, "closure": 0.0, "newton_iterations": iterations}]
    return {"cells": 24, "rows": rows, "linear": linear}


def found(**several):
    return {0: {"lid": result()}, 1: {"lid": result()}, 8: {"lid": result(**several)}}


def test_what_is_the_same_misses_no_bound():
    text, missed = sameness.table(found(iterations=13, linear=130, kinetic=1 + 1e-11))
    assert not missed
    assert text.splitlines()[-1] == "| lid | 24 | 10 (100) | 0e+00; 10 (100) | 1e-11; 13 (130) |"


@pytest.mark.parametrize(
    ("several", "message"),
    [
        ({"iterations": 14}, "lid: iterations grow from 10 to 14"),
        ({"linear": 131}, "lid: linear iterations grow from 100 to 131"),
        ({"kinetic": 1 + 2e-10}, "lid on 8 ranks: the ledger differs by 2.0e-10"),
        ({"kinetic": float("nan")}, "lid on 8 ranks: the ledger differs by inf"),
    ],
)
def test_what_misses_a_bound_is_named(several, message):
    assert sameness.table(found(**several))[1] == [message]


def test_ranks_that_fail_are_named(monkeypatch, tmp_path, capsys):
    of_ranks = found() | {8: {"failed": "no memory"}}
    monkeypatch.setattr(sameness, "results", lambda names, ranks, timeout: of_ranks[ranks])
    assert sameness.main(["lid", "--ranks", "1", "8", "-o", str(tmp_path)]) == 1
    assert "lid on 8 ranks: no memory" in capsys.readouterr().out
    assert "| lid | 24 | 10 (100) | 0e+00; 10 (100) | – |" in (tmp_path / "sameness.md").read_text()
