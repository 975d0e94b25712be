"""For every mutant, a wrong sign or factor of a term, a test of the default suite or of CI fails
(``mutants.py``)."""

import pytest
from mutants import MUTANTS, ROOT, copy_with, seen


@pytest.mark.parametrize("mutant", MUTANTS, ids=[mutant.name for mutant in MUTANTS])
def test_each_mutant_changes_one_place_and_names_an_existing_test(mutant):
    text = (ROOT / mutant.file).read_text(encoding="utf-8")
    assert text.count(mutant.old) == 1
    path, _, name = mutant.seen_by.partition("::")
    assert f"def {name}" in (ROOT / path).read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.parametrize("mutant", MUTANTS, ids=[mutant.name for mutant in MUTANTS])
def test_each_mutant_makes_its_test_fail(mutant, tmp_path):
    copy_with(mutant, tmp_path)
    assert seen(mutant, tmp_path)
