"""``ngvisco list``, ``explain`` and ``new``: what there is, what a key means, a case to start from."""

import argparse
import json
from collections.abc import Callable

from ngvisco.case import catalogue, reference, schema, template
from ngvisco.case.section import TAGS, Section, models_in
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


def _by_kind(choice: object) -> dict[str, type[Section]]:
    """The sections of a choice by their kinds."""
    return {model.__name__: model for model in models_in(choice)}


def listing(options: argparse.Namespace) -> int:
    """Say what a case file can name, or every key."""
    if options.form is not None:
        print(_FORMS[options.form](), end="")
        return 0
    materials = _by_kind(schema.Material)
    of_another = {name: materials.pop(name) for name in catalogue.WRAPPERS}
    mechanisms = {name: schema.Rheology.model_fields[name].annotation for name in catalogue.MECHANISMS}
    groups = (
        ("geometries: [domain] geometry =", _by_kind(schema.Domain)),
        ("materials: [material] kind =", materials),
        ("materials of another one, [material.material]: [material] kind =", of_another),
        ("mechanisms: [rheology.NAME]", {name: models_in(part)[0] for name, part in mechanisms.items()}),
        ("flow rules: [rheology.creep] kind =", _by_kind(schema.Creep)),
        ("viscosities: [rheology.viscosity] kind =", _by_kind(schema.Viscosity)),
        ("loads: [[loads]] kind =", _by_kind(schema.Load)),
        ("walls: [walls.NAME] kind =", _by_kind(schema.Wall)),
    )
    for title, models in groups:
        print(title)
        for name, model in models.items():
            keys = [(key, field) for key, field in model.model_fields.items() if key not in TAGS]
            required = [key for key, field in keys if field.is_required()]
            shown = [*required, *(f"[{key}]" for key, field in keys if not field.is_required())]
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
        name for name in schema.CaseSections.model_fields if name not in ("domain", "material", "loads")
    )
    print(f"other sections: {others}")
    return 0
