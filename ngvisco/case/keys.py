"""What each key of a case file means: the class or function that takes it says so.

The meaning is the parameter's text in the numpydoc section ``Parameters`` of the docstring (of a class also
of its bases); unit, range and example are the ``Quantity`` of its annotation.  A text "As for ``NAME``." is
that of the same parameter of NAME, another of the catalogue.
"""

import inspect
import re
from collections.abc import Mapping
from functools import cache
from typing import Any, get_type_hints

from ngvisco.case import catalogue
from ngvisco.errors import Quantity

_SAME = re.compile(r"As for (\w+)")


@cache
def quantities(owner: Any) -> Mapping[str, Quantity]:
    """What the annotations of a class or function say of its parameters; the unit is "1" of other numbers."""
    found = {}
    for name, hint in get_type_hints(owner, include_extras=True).items():
        said = [part for part in getattr(hint, "__metadata__", ()) if isinstance(part, Quantity)]
        is_number = re.search(r"\b(int|float)\b", str(getattr(hint, "__origin__", hint)))
        found[name] = said[0] if said else Quantity("1" if is_number else "")
    return found


@cache
def meanings(owner: Any) -> Mapping[str, str]:
    """What the docstring of a class or function says of its parameters, without the final stop."""
    from docstring_parser import DocstringStyle, parse  # no run needs it

    found = {}
    for each in reversed(inspect.getmro(owner) if inspect.isclass(owner) else (owner,)):
        for part in parse(each.__doc__ or "", DocstringStyle.NUMPYDOC).params:
            text = " ".join((part.description or "").replace("``", "").split()).removesuffix(".")
            same = _SAME.fullmatch(text)
            if part.args[0] != "param":
                continue
            for name in part.arg_name.split(", "):
                found[name] = meanings(_named(same[1]))[name] if same else text
    return found


def summary(owner: Any) -> str:
    """The first line of a docstring, without the final stop."""
    return (inspect.getdoc(owner) or "").split("\n")[0].replace("``", "").removesuffix(".")


def _named(name: str) -> Any:
    return next(made for table in catalogue.TABLES for made in table.values() if made.__name__ == name)
