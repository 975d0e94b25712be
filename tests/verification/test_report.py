"""Tests of the verification's framework: failures are reported; no result is lost or half written."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from ngvisco.run.ledger import Ledger
from tests.verification import cases as package
from tests.verification.__main__ import BAD_INPUT, DONE, FAILED, INTERRUPTED, main
from tests.verification.bounds import CLOSURE, DRIFT, Bound, VerificationError, each
from tests.verification.case import Case, Cases, Curve, Plot, RateTable, Result, Table, collected
from tests.verification.cases import all_cases, select
from tests.verification.runner import run_case, watched


def case(name, value, limit=1.0, **options):
    """A case that measures ``value``, or the value that it returns, with the bound <= ``limit``."""
    calls = options.pop("calls", [])

    def run():
        calls.append(name)
        number = value() if callable(value) else value
        curve = Curve("a", [1.0, 2.0], [1.0, 4.0])
        table = Table("a table", "x | |y|", [[1.0, "a|b<i>"]])
        return [("the error", number), table, Plot("a plot", "x", "y", [curve], "xy"), "A remark."]

    bounds = (Bound("the error", "<=", limit, "a reason"),)
    said = {"theme": "T", "statement": f"{name} & so on", "label": "L", "setting": "S"}
    return Case(name=name, bounds=bounds, run=run, **{**said, **options})


@pytest.fixture
def cases(monkeypatch):
    """A function that replaces the package's cases by a list of cases."""
    chosen = []
    monkeypatch.setattr(package, "all_cases", lambda: tuple(chosen))
    return chosen


def test_report_says_what_holds_what_fails_and_what_ended_in_an_error(cases, tmp_path, capsys):
    """The report has numbers, bounds and pictures; an error in one case does not end it."""
    cases += [case("good", 0.5)]
    assert main(["-o", str(tmp_path / "0")]) == DONE
    assert "1 hold, 0 do not" in capsys.readouterr().out
    cases += [case("bad", 7.25, explanation="It is known."), case("broken", lambda: 1 / 0)]
    assert main(["-o", str(tmp_path / "r")]) == FAILED
    assert "the error 7.25, not <= 1" in capsys.readouterr().out
    page = (tmp_path / "r" / "report.md").read_text()
    assert "1 hold, 1 do not, 1 ended in an error" in page and "DOES NOT HOLD" in page
    assert "7.25" in page and "≤ 1" in page and "a reason" in page and "It is known." in page
    assert "ZeroDivisionError" in page and "not measured" in page
    assert "| x | \\|y\\| |" in page and "| 1 | a\\|b<i> |" in page  # an unescaped bar would add a column
    assert "pictures/good.png" in page and (tmp_path / "r" / "pictures" / "good.png").stat().st_size > 0
    assert json.loads((tmp_path / "r" / "cases" / "good.json").read_text())["status"] == "holds"


def test_cases_that_were_run_again_take_their_places_in_the_kept_report(cases, tmp_path, monkeypatch, capsys):
    kept, new = tmp_path / "kept", tmp_path / "new"
    cases += [case("one", 0.5), case("gone", 0.5), case("two", 0.25)]
    assert main(["-o", str(kept)]) == DONE
    cases[:] = [case("two", 7.5), case("later", 0.5), case("one", 0.5)]
    for name in ("aaa", "bbb"):  # at the second merge, the rows have their own commits
        monkeypatch.setattr("tests.verification.report.commit", lambda name=name: name)
        assert main(["two", "-o", str(new / name), "--into", str(kept)]) == FAILED
    text = (kept / "report.md").read_text()
    assert "2 cases: 1 hold, 1 do not" in text and "Missing: later." in text and "gone" not in text
    assert re.search(
        r"DOES NOT HOLD \| \[two\]\(#two\) .* s \| bbb \|\n\| holds \| \[one\].* s \| e85ab32 \|\n", text
    )
    assert text.index("### two") < text.index("### one") and "| 7.5 | ✗ |" in text
    assert text.count("## T\n") == 1 and text.count("## The labels of the paper") == 1
    cases[:] = [case("two", lambda: 1 / 0)]
    assert main(["-o", str(new / "c"), "--into", str(kept)]) == BAD_INPUT
    assert "two" in capsys.readouterr().err and (kept / "report.md").read_text() == text


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_value_that_is_not_finite_violates_every_bound(cases, tmp_path, value):
    cases += [case("nan", value)]
    assert main(["-o", str(tmp_path / "r")]) == FAILED
    saved = Result.from_json((tmp_path / "r" / "cases" / "nan.json").read_text())
    assert saved.status == "fails" and saved.failed == ["the error"]


@pytest.mark.parametrize("values", [{"a": 0.0}, {"a": 0.0, "b": 0.0, "c": 0.0}], ids=["drop", "add"])
def test_case_can_neither_drop_a_bound_nor_add_one(cases, tmp_path, values):
    bounds = (Bound("a", "in", (0, 1)), Bound("b", "in", (0, 1)))
    cases += [replace(case("sly", 0.0), bounds=bounds, run=values.items)]
    assert main(["-o", str(tmp_path / "r")]) == FAILED
    saved = json.loads((tmp_path / "r" / "cases" / "sly.json").read_text())
    assert saved["status"] == "error" and "must be the same" in saved["error"]


TEXT = """limit-tau (reduced)
    Two runs agree: they
      do.
    label: L1, L2
    setting: A box;
      two steps <= 1 s.
    - rate of [v; rho] in tau >= 0.9: first order
    - closure
    explanation: None.
    """


def test_case_is_declared_by_a_text_above_the_function_that_measures_it():
    cases = Cases("T")
    cases(TEXT)(lambda: (("a", np.float64(number)) for number in (1, 2)))
    (one,) = cases
    assert (one.name, one.theme, one.reduced) == ("limit-tau", "T", True)
    assert one.explanation == "None."
    assert (one.statement, one.label) == ("Two runs agree: they do.", "L1, L2")
    assert one.setting == "A box; two steps <= 1 s."
    rates = [Bound(f"rate of {name} in tau", ">=", 0.9, "first order") for name in ("v", "rho")]
    assert one.bounds == (*rates, CLOSURE) and each(rates).startswith("- rate of v in tau >= 0.9: first")
    with pytest.raises(VerificationError, match="two numbers for one quantity"):
        collected(one.run())
    for wrong, message in {
        "    label: L1, L2\n": "a case without label",
        " >= 0.9": "expected 'quantity <= limit: reason'",
        TEXT[TEXT.index("    - ") : TEXT.index("    expl")]: "without a bound",
    }.items():
        with pytest.raises(VerificationError, match=message):
            cases(TEXT.replace(wrong, ""))(len)
    with pytest.raises(VerificationError, match=r"limit-tau-0\.7: a case's name has"):
        cases(TEXT.replace("limit-tau", "limit-tau-0.7"))


def test_closure_and_drift_are_the_worst_of_all_runs_of_a_case(monkeypatch):
    """Runs that the case drops count too. A case without a run is an error, because it has no closure."""
    monkeypatch.setattr(
        Ledger, "record", lambda ledger, off: {"closure_relative": -off, "mass_drift": off / 2}
    )

    def run():
        for off in (0.25, 0.5, 0.125):
            Ledger.record(None, off)
        return []

    one = replace(case("a", 0.0), bounds=(CLOSURE, DRIFT), run=run)
    result = run_case(one, "1")
    assert result.outcome.values == {CLOSURE.quantity: 0.5, DRIFT.quantity: 0.25}
    assert result.failed == [CLOSURE.quantity, DRIFT.quantity]
    with watched() as seen:
        Ledger.record(None, math.nan)
        run()
    assert math.isnan(seen[CLOSURE.quantity])
    assert run_case(replace(one, run=list), "1").status == "error"


def test_the_error_for_a_misspelt_name_gives_the_nearest_name(cases, tmp_path, capsys):
    cases += [case("limit-tau-finite", 0.0)]
    assert main(["limit-tua", "-o", str(tmp_path / "r")]) == BAD_INPUT
    assert "did you mean 'limit-tau-finite'" in capsys.readouterr().err
    assert not (tmp_path / "r").exists()


def test_beginnings_of_names_and_the_reduced_set_select_cases():
    some = [case("a-x", 0, reduced=True), case("a-y", 0), case("ab", 0)]
    assert [c.name for c in select(some, ["a"])] == ["a-x", "a-y"]
    assert [c.name for c in select(some, [], reduced=True)] == ["a-x"]


def test_the_option_list_runs_no_case(cases, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cases += [case("one", lambda: 1 / 0)]
    assert main(["--list"]) == DONE
    assert "one & so on" in capsys.readouterr().out and not list(tmp_path.iterdir())


def test_a_report_does_not_change_other_files_of_its_directory(cases, tmp_path, capsys):
    """Other files stay, with ``--resume`` or without, and an earlier report stays without ``--resume``."""
    cases += [case("one", 0.5)]
    (tmp_path / "thesis.tex").write_text("mine")
    for options in ([str(tmp_path)], [str(tmp_path), "--resume"], [str(tmp_path / "thesis.tex")]):
        assert main(["-o", *options]) == BAD_INPUT
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]
    assert "something else than a report" in capsys.readouterr().err
    assert main(["-o", str(tmp_path / "r")]) == DONE
    before = (tmp_path / "r" / "report.md").read_bytes()
    assert main(["-o", str(tmp_path / "r")]) == BAD_INPUT
    assert "--resume" in capsys.readouterr().err
    assert (tmp_path / "r" / "report.md").read_bytes() == before


def test_an_interrupted_report_leaves_no_partial_file_and_can_be_resumed(cases, tmp_path, capsys):
    calls, patience = [], []

    def interrupted_once():
        if not patience:
            patience.append(1)
            raise KeyboardInterrupt
        return 0.5

    cases += [case("one", 0.5, calls=calls), case("two", interrupted_once, calls=calls)]
    directory = tmp_path / "r"
    assert main(["-o", str(directory)]) == INTERRUPTED
    assert "--resume" in capsys.readouterr().err
    assert sorted(p.name for p in directory.iterdir()) == ["cases", "verification.json"]
    assert main(["-o", str(directory), "--resume"]) == DONE
    assert calls == ["one", "two", "two"]
    assert (directory / "report.md").exists() and not list(directory.rglob("*.part"))


def test_resume_repeats_cases_that_have_changed_or_ended_in_an_error(cases, tmp_path):
    calls = []
    cases += [case("changed", 0.5, calls=calls), case("error", lambda: 1 / 0, calls=calls)]
    assert main(["-o", str(tmp_path / "r")]) == FAILED
    cases[0] = case("changed", 0.5, limit=0.75, calls=calls)
    cases[1] = case("error", 0.5, calls=calls)
    assert main(["-o", str(tmp_path / "r"), "--resume"]) == DONE
    assert calls == ["changed", "error", "changed", "error"]
    assert "≤ 0.75" in (tmp_path / "r" / "report.md").read_text()


def test_a_result_is_unchanged_by_writing_and_reading_json():
    plot = Plot("p", "x", "y", [Curve("c", [1.0], [2.0])])
    outcome = collected([("a", math.inf), Table("t", ["x"], [[1.5], ["text"]]), plot, "said"])
    result = Result(name="n", fingerprint="f", version="1", status="fails", seconds=1.5, outcome=outcome)
    again = Result.from_json(result.to_json())
    assert again == result and again.outcome.plots[0].curves[0].y == [2.0]


def test_a_rate_table_computes_its_rates_and_refuses_rates_below_a_bound():
    table = RateTable("r", "h", [1.0, 0.5, 0.25], {"a": [1.0, 0.25, 0.0625]})
    assert table.rates("a") == pytest.approx([2, 2])
    table.require(a=1.99)
    with pytest.raises(VerificationError, match=r"rate of a < 2\.1"):
        table.require(a=2.1)
    table.errors["a"][-1] = math.nan
    with pytest.raises(VerificationError):
        table.require(a=1.0)
    assert table.table().columns == ["h", "a", "rate"]


BOTH_MODELS = (
    *("stability-free", "stability-loaded", "whole-estimates", "whole-sequence", "delta-terms", "limit-tau"),
    *("limit-yosida", "mass", "cut-off", "positivity", "hyperviscosity", "manufactured-2d", "robustness"),
    *("manufactured-2d-k3", "manufactured-3d", "manufactured-3d-m2", "manufactured-3d-k3"),
)


def test_cases_exist_for_both_models_and_every_case_is_described():
    names = {c.name for c in all_cases()}
    for name in BOTH_MODELS:
        assert {f"{name}-linearised", f"{name}-finite"} <= names
    for c in all_cases():
        assert c.statement and c.label and c.setting and all(b.reason for b in c.bounds), c.name
        # a sentence without its end shows a string that was left out of the brackets
        assert not re.search(r"[,;:]\s*([,;:.]|$)", f"{c.statement}\n{c.setting}", re.MULTILINE), c.name


@pytest.mark.long
@pytest.mark.ci
def test_the_cases_of_the_reduced_set_keep_their_bounds(tmp_path):
    """One case or two of every theme take minutes; two processes run them, since this test is the last of
    its tier."""
    assert main(["--reduced", "--jobs", "2", "-o", str(tmp_path / "report")]) == DONE


@pytest.mark.long
@pytest.mark.ci
def test_cases_computed_at_once_equal_those_computed_in_turn(tmp_path):
    names = ["stability-free-linearised", "stability-loaded-linearised"]
    found = []
    for jobs in ("1", "2"):
        assert main([*names, "--jobs", jobs, "-o", str(tmp_path / jobs)]) == DONE
        results = [json.loads((tmp_path / jobs / "cases" / f"{name}.json").read_text()) for name in names]
        found.append([result["outcome"]["values"] for result in results])
    assert found[0] == found[1]
