"""The example in the README of ``sensitivity`` runs."""

from documents import ROOT, marked_blocks


def test_the_example_of_the_readme_runs():
    (program,) = marked_blocks(ROOT / "ngvisco/sensitivity/README.md")["sensitivity"]
    exec(compile(program, "README.md", "exec"), {})
