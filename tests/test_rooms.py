"""Each folder of the package is a room: its README names its files and what they may import."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from documents import ROOT, section, tracked

TOPS = {"ngvisco": ROOT / "ngvisco", "ngvisco.geometries": ROOT / "geometries"}
"""Where the packages' sources are; ``geometries`` stands beside ``ngvisco`` in a clone."""


def _modules() -> dict[str, Path]:
    found = {}
    for top, folder in TOPS.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            parts = parts[:-1] if parts[-1] == "__init__" else parts
            found[".".join((top, *parts))] = path
    return found


MODULES = _modules()
ROOMS = {name: path.parent for name, path in MODULES.items() if path.name == "__init__.py"}


def room_of(module: str) -> str:
    """The package that a module lies in, itself if it is one."""
    return module if module in ROOMS else module.rpartition(".")[0]


def floor_of(module: str) -> str:
    """What READMEs call it: a room of the first level, or a module beside the rooms, without ``ngvisco.``."""
    return ".".join(module.split(".")[1:2]) or "ngvisco"


def imports_of(tree: ast.Module, module: str, known: dict[str, Path] | set[str]) -> Iterator[str]:
    """Modules that a file imports when it runs, also inside functions; not what only a type checker reads."""
    todo: list[ast.AST] = [tree]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            todo += node.orelse
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{module}: imports are absolute"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                if (target := full if full in known else node.module) in known:
                    yield target
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            yield from (a.value for a in node.args if isinstance(a, ast.Constant) and a.value in known)
        todo += ast.iter_child_nodes(node)


@cache
def graph() -> dict[str, tuple[str, ...]]:
    """What each module of the package imports of the package."""
    return {
        module: tuple(sorted({*imports_of(ast.parse(path.read_text()), module, MODULES)} - {module}))
        for module, path in MODULES.items()
    }


def cycle_in(imports: dict[str, tuple[str, ...]]) -> list[str] | None:
    """A chain of imports that ends where it begins, or None."""
    state: dict[str, str] = {}

    def visit(module: str, above: list[str]) -> list[str] | None:
        if state.get(module) == "done":
            return None
        if state.get(module) == "open":
            return [*above[above.index(module) :], module]
        state[module] = "open"
        for target in imports.get(module, ()):
            if found := visit(target, [*above, module]):
                return found
        state[module] = "done"
        return None

    return next((found for module in imports if (found := visit(module, []))), None)


def longest_chain(imports: dict[str, tuple[str, ...]], modules: set[str]) -> list[str]:
    """The longest chain of imports within some modules: as many levels as it has members."""

    @cache
    def chain(module: str) -> tuple[str, ...]:
        below = [chain(target) for target in imports[module] if target in modules]
        return (module, *max(below, key=len, default=()))

    return list(max((chain(module) for module in sorted(modules)), key=len))


def readme(room: str) -> Path:
    return ROOMS[room] / "README.md"


def stated(room: str, label: str) -> str:
    """What a line ``Label: ...`` of a room's README says."""
    found = re.findall(rf"^{label}: (.*)$", readme(room).read_text(), re.MULTILINE)
    assert len(found) == 1, f"{readme(room).relative_to(ROOT)}: one line '{label}: ...', found {found}"
    return found[0]


def listed(room: str) -> list[str]:
    """The files that a README lists under 'Files', in its order; folders end in a slash."""
    return re.findall(r"^1\. (?:\[)?`([\w./]+)`", section(readme(room), "Files"), re.MULTILINE)


@pytest.mark.parametrize("room", ROOMS)
def test_every_file_of_a_room_is_in_its_readme(room):
    inside = [path.relative_to(ROOMS[room]) for path in tracked(f"{ROOMS[room].relative_to(ROOT)}/*")]
    there = {f"{path.parts[0]}/" if len(path.parts) > 1 else path.name for path in inside} - {"README.md"}
    named = listed(room)
    assert len(named) == len(set(named)), named
    lines = {name: f"1. `{name}` — {first_line(ROOMS[room] / name)}" for name in sorted(there - set(named))}
    assert not lines, "\n".join(["not in the README:", *lines.values()])
    assert set(named) <= there, f"not in the folder: {sorted(set(named) - there)}"


def first_line(path: Path) -> str:
    """What a module or a room says of itself."""
    text = (path / "__init__.py" if path.is_dir() else path).read_text()
    return (ast.get_docstring(ast.parse(text)) or "").split("\n")[0] if path.suffix in ("", ".py") else ""


@pytest.mark.parametrize("room", ROOMS)
def test_files_are_listed_after_those_that_they_import(room):
    """So that a room can be read from top to bottom; ``__init__.py`` is the door and may stand first."""
    order = {name: place for place, name in enumerate(listed(room))}
    for module, targets in graph().items():
        if module == room or room_of(module) != room or module in ROOMS:
            continue
        for target in targets:
            if target != room and room_of(target) == room and target not in ROOMS:
                user, used = (MODULES[m].name for m in (module, target))
                assert order[used] < order[user], f"{user} imports {used}, which is listed after it"


@pytest.mark.parametrize("room", ROOMS)
def test_imports_are_those_that_the_readme_allows(room):
    """A room may import itself, its parents' and inner rooms, and what its line 'May import' names."""
    allowed = set(re.findall(r"`([\w.]+)`", stated(room, "May import"))) | {floor_of(room)}
    known = {floor_of(module) for module in MODULES}
    assert allowed <= known, f"no such room or module: {sorted(allowed - known)}"
    used = set()
    for module, targets in graph().items():
        if room_of(module) != room or (room == "ngvisco" and module != room):
            continue  # modules beside the rooms have lines of their own
        for target in targets:
            assert floor_of(target) in allowed, f"{module} imports {target}"
            used.add(floor_of(target))
    assert allowed <= used | {floor_of(room)}, f"allowed and not used: {sorted(allowed - used)}"


def test_modules_beside_the_rooms_import_what_their_line_allows():
    text = section(readme("ngvisco"), "Files")
    for module in MODULES:
        if room_of(module) == "ngvisco" and module != "ngvisco":
            line = re.findall(rf"^1\. `{MODULES[module].name}` .*?(?=^1\. |^$)", text, re.M | re.S)
            (imports,) = re.findall(r"Imports (nothing|`.*?`)\.", " ".join(line[0].split()))
            allowed = set(re.findall(r"`(\w+)`", imports))
            assert {floor_of(target) for target in graph()[module]} == allowed, module


def test_no_import_goes_round_in_a_cycle():
    assert cycle_in(graph()) is None


@pytest.mark.parametrize("room", [room for room in ROOMS if room.count(".") == 1])
def test_levels_of_imports_are_no_more_than_stated(room):
    """Counted within a room and its inner rooms, without their doors (``__init__``)."""
    inside = {m for m in MODULES if m.startswith(f"{room}.") and m not in ROOMS}
    chain = longest_chain(graph(), inside)
    limit = int(stated(room, "Levels of imports").removeprefix("at most ").rstrip("."))
    assert len(chain) <= limit, f"{len(chain)} levels: {' -> '.join(chain)}"


def test_checks_see_cycles_chains_and_imports_in_functions():
    assert cycle_in({"a": ("b",), "b": ("c",), "c": ("b",)}) == ["b", "c", "b"]
    assert cycle_in({"a": ("b", "c"), "b": ("c",), "c": ()}) is None
    assert longest_chain({"a": ("b", "c"), "b": ("c",), "c": ()}, {"a", "b", "c"}) == ["a", "b", "c"]
    source = "if TYPE_CHECKING:\n    import p.a\ndef f():\n    from p import b\n    import_module('p.c')\n"
    assert set(imports_of(ast.parse(source), "m", {"p", "p.a", "p.b", "p.c"})) == {"p.b", "p.c"}
