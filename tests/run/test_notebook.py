"""Notebook views: well-formed pages with the numbers, and a frame with the ledger's columns."""

import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from support import A_BODY, swirling

import ngvisco as nv
from ngvisco.run.notebook import NotebookError, results_html


def small(observers=()):
    return swirling(0.8, loads=[nv.Gravity((0, -1), name="pull")], observers=list(observers))


def words(page):
    """All texts of a page, which must be well formed."""
    page = page.replace("<br>", "<br/>")
    return " ".join(ElementTree.fromstring(f"<div>{page}</div>").itertext())


def test_a_simulation_shows_its_model_and_its_energies():
    run = small()
    assert "no step yet" in words(run._repr_html_())
    run.run(0.04)
    said = words(run._repr_html_())
    for part in ("K_e=10.0", "pull", "left: Slip", "cells in 2D", "t = 0.04 s, step 2", "kinetic"):
        assert part in said
    assert "<polyline" in run.ledger._repr_html_() and "largest |closure|" in words(run.ledger._repr_html_())


def test_titles_cannot_insert_code_into_the_page():
    ledger = {name: np.array(values) for name, values in small().run(0.02).frame().reset_index().items()}
    page = results_html("<script>alert(1)</script>", 0.02, ledger)
    assert "<script" not in page and "<script>" in words(page)


def test_results_are_displayed_in_a_notebook(tmp_path):
    from ngvisco.case.build import parse_case

    text = A_BODY + "[time]\ndt = 0.1\nuntil = 0.1\n"
    nv.case.run(parse_case(text, "a.toml", tmp_path, ["title=a run"]), tmp_path / "out")
    results = nv.load(tmp_path / "out")
    assert "a run" in words(results._repr_html_())
    assert results.frame()["kinetic"].tolist() == results.ledger["kinetic"].tolist()


def test_the_frame_has_the_ledgers_columns():
    ledger = small().run(0.04)
    frame = ledger.frame()
    assert frame.index.name == "step" and set(frame.columns) == set(ledger.columns) - {"step"}
    assert frame["power_pull"].to_numpy() == pytest.approx(ledger.column("power_pull"))


def test_progress_draws_itself_while_the_run_goes_on(monkeypatch):
    import IPython.display

    pages = []

    class Handle:
        def update(self, shown):
            pages.append(shown.data)

    def display(shown, display_id):
        pages.append(shown.data)
        return Handle()

    monkeypatch.setattr(IPython.display, "display", display)
    small([nv.NotebookProgress(until=0.06, seconds=0)]).run(0.06)
    assert len(pages) == 1 + 3 + 1
    assert "width:33.3%" in pages[1] and "width:100.0%" in pages[-1]
    assert "step 3" in words(pages[-1])


def test_outside_of_a_notebook_progress_prints_nothing():
    assert small([nv.NotebookProgress(0.02)]).run(0.02).column("step")[-1] == 1


@pytest.mark.parametrize("module", ["IPython.display", "pandas"])
def test_a_missing_package_is_named_with_its_installation(module, monkeypatch):
    run = small()
    run.run(0.0)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(NotebookError, match="is missing; run pip install"):
        run.ledger.frame() if module == "pandas" else nv.NotebookProgress(1.0)
