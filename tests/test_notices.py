"""Printing of warnings: each warning of ngvisco appears once, without a line of code; others appear as
usual."""

import subprocess
import sys
import warnings

import pytest

import ngvisco as nv
from ngvisco.notices import Notices

SCRIPT = """
import warnings
import ngvisco as nv

def warn_twice():
    for _ in range(2):
        warnings.warn("a wall lets matter through", nv.InputWarning)
        with warnings.catch_warnings():  # after which Python would print it again
            warnings.simplefilter("ignore")

warn_twice()
warn_twice()
warnings.warn("a wall lets matter through", nv.ClosureWarning)
warnings.warn("somebody else's")
"""


def test_a_script_prints_each_warning_once_in_the_packages_words(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    said = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True).stderr
    assert said.splitlines() == [
        "ngvisco: InputWarning: a wall lets matter through",
        "ngvisco: ClosureWarning: a wall lets matter through",
        f"{script}:14: UserWarning: somebody else's",
        """  warnings.warn("somebody else's")""",
    ]


def test_filters_and_records_see_every_warning():
    said = []
    with warnings.catch_warnings():
        warnings.showwarning = Notices(lambda text, category: said.append((text, category)))
        warnings.simplefilter("ignore")
        warnings.warn("one", nv.InputWarning, stacklevel=1)
        assert said == []
        warnings.simplefilter("error")
        for _ in range(2):
            with pytest.raises(nv.InputWarning, match="one"):
                warnings.warn("one", nv.InputWarning, stacklevel=1)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for _ in range(2):
                warnings.warn("one", nv.InputWarning, stacklevel=1)
        assert len(caught) == 2 and said == []
        warnings.simplefilter("always")
        for text in ("one", "one", "two"):
            warnings.warn(text, nv.InputWarning, stacklevel=1)
    assert said == [("one", nv.InputWarning), ("two", nv.InputWarning)]


def test_every_public_warning_derives_from_the_base_class_of_the_package():
    kinds = {name for name in nv.__all__ if isinstance(getattr(nv, name), type)}
    named = {name for name in kinds if name.endswith("Warning")}
    assert len(named) >= 5
    assert all(issubclass(getattr(nv, name), nv.NgviscoWarning) for name in named)
