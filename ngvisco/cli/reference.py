"""``ngvisco list``, ``explain`` and ``new``: what there is, what a key means, a case to start from."""

import argparse
import json
from collections.abc import Callable

from ngvisco.case import catalogue, reference, template
from ngvisco.case.schema import CaseSections
from ngvisco.case.section import section
from ngvisco.run.fields import NAMES as FURTHER
from ngvisco.run.passive import NAMES as PASSIVE
from ngvisco.timestepping.scheme import SCHEMES


def explain(options: argparse.Namespace) -> int:
    """Say what a key of a case file means."""
    print(reference.explain(options.key))
    return 0


def new(options: argparse.Namespace) -> int:
    """Print an annotated case."""
    if options.name is None:
        for name, path in template.demos().items():
            title = path.read_text(encoding="utf-8").split("\n")[0].partition("=")[2].strip().strip('"')
            print(f"{name:15s} {title}")
    else:
        print(template.template(options.name), end="")
    return 0


_FORMS: dict[str, Callable[[], str]] = {
    "keys": lambda: reference.listing() + "\n",
    "markdown": reference.markdown,
    "schema": lambda: json.dumps(reference.json_schema(), indent=1) + "\n",
}


def listing(options: argparse.Namespace) -> int:
    """Say what a case file can name, or every key."""
    if options.form is not None:
        print(_FORMS[options.form](), end="")
        return 0
    groups = (
        ("geometries: [domain] geometry =", "geometry", catalogue.GEOMETRIES),
        ("materials: [material] kind =", "kind", catalogue.MATERIALS),
        ("materials of another one, [material.material]: [material] kind =", "kind", catalogue.WRAPPERS),
        ("mechanisms: [rheology.NAME]", None, catalogue.MECHANISMS),
        ("flow rules: [rheology.creep] kind =", "kind", catalogue.CREEPS),
        ("viscosities: [rheology.viscosity] kind =", "kind", catalogue.ALL_VISCOSITIES),
        ("loads: [[loads]] kind =", "kind", catalogue.LOADS),
        ("walls: [walls.NAME] kind =", "kind", catalogue.WALLS),
    )
    for title, tag, table in groups:
        print(title)
        for name, target in table.items():
            keys = section(target, (tag, name) if tag else None).model_fields
            required = [key for key, f in keys.items() if f.is_required() and key != tag]
            shown = [*required, *(f"[{key}]" for key, f in keys.items() if not f.is_required())]
            print(f"  {name}: {', '.join(shown)}" if shown else f"  {name}")
    print("time schemes: [time] scheme =")
    for name, make in SCHEMES.items():
        note = "; takes theta in [1/2, 1]" if name == "theta" else ""
        text = (make.__doc__ or "").splitlines()[0].rstrip(".")
        print(f"  {name}: {text}{note}")
    print("outputs: [output.vtk] fields =")
    print(
        "  velocity, density, cauchy_stress, pressure, von_mises, the material's variables (F, B, J, E, ...)"
    )
    print(f"  by name only: {', '.join(FURTHER)}")
    print("  also ledger.csv, run.h5, log.txt; ngvisco plot and ngvisco scene make PNG and HTML of them")
    print("passive: [output] passive =")
    print(f"  {', '.join(PASSIVE)}")
    others = ", ".join(
        name for name in CaseSections.model_fields if name not in ("domain", "material", "loads")
    )
    print(f"other sections: {others}")
    return 0
