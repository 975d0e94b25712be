"""The package as rooms: the statements in each folder's README, and the imports of the files in the folder.

``python tests/rooms.py`` updates the READMEs' lists of files when files are added, moved or removed. A new
file gets the first line of its docstring; a file is listed after the files that it imports. The program
removes allowed imports and levels that a room no longer needs; allowing more is a decision, made by hand.
Then it prints the modules, lines and levels of each room.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from documents import ROOT, section, tracked

TOPS = {
    "ngvisco": ROOT / "ngvisco",
    "ngvisco.geometries": ROOT / "geometries",
    "tests.verification": ROOT / "tests" / "verification",
}
"""Folders of the rooms' sources; ``geometries`` is beside ``ngvisco`` in a clone, and inside it in a
wheel."""


def _modules() -> dict[str, Path]:
    found = {}
    for top, folder in TOPS.items():
        for path in sorted(set(folder.rglob("*.py")) - set(folder.rglob("test_*.py"))):
            parts = path.relative_to(folder).with_suffix("").parts
            parts = parts[:-1] if parts[-1] == "__init__" else parts
            found[".".join((top, *parts))] = path
    return found


MODULES = _modules()
ROOMS = {name: path.parent for name, path in MODULES.items() if path.name == "__init__.py"}


def room_of(module: str) -> str:
    """The package that contains a module; for a package, the package itself."""
    return module if module in ROOMS else module.rpartition(".")[0]


def floor_of(module: str) -> str:
    """Name of a module's room in READMEs: a room of the first level, or a module beside rooms, without
    ``ngvisco.``."""
    return ".".join(module.split(".")[1:2]) or "ngvisco"


def imports_of(
    tree: ast.Module, module: str, known: dict[str, Path] | set[str], typed: bool = False
) -> Iterator[str]:
    """Modules that a file imports when it runs, also inside functions; if ``typed``, also imports for type
    checkers only."""
    todo: list[ast.AST] = [tree]
    while todo:
        node = todo.pop()
        if not typed and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
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
def graph(typed: bool = False) -> dict[str, tuple[str, ...]]:
    """Imports of the package's modules by each module; ``typed`` is the argument of ``imports_of``."""
    return {
        module: tuple(sorted({*imports_of(ast.parse(path.read_text()), module, MODULES, typed)} - {module}))
        for module, path in MODULES.items()
    }


def circles_in(imports: dict[str, tuple[str, ...]]) -> list[set[str]]:
    """Sets of two or more modules that import each other, directly or not."""
    reached: dict[str, set[str]] = {}
    for module in imports:
        todo, found = list(imports[module]), set[str]()
        while todo:
            if (target := todo.pop()) not in found:
                found.add(target)
                todo += imports.get(target, ())
        reached[module] = found
    circles = {
        frozenset(other for other in found if module in reached.get(other, ()))
        for module, found in reached.items()
        if module in found
    }
    return [set(circle) for circle in sorted(circles, key=sorted)]


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
    """Text of a line ``Label: ...`` of a room's README."""
    found = re.findall(rf"^{label}: (.*)$", readme(room).read_text(), re.MULTILINE)
    assert len(found) == 1, f"{readme(room).relative_to(ROOT)}: one line '{label}: ...', found {found}"
    return found[0]


def listed(room: str) -> list[str]:
    """The files that a README lists under 'Files', in its order; folders end in a slash."""
    return re.findall(r"^1\. (?:\[)?`([\w./]+)`", section(readme(room), "Files"), re.MULTILINE)


def first_line(path: Path) -> str:
    """The first line of a module's or a room's docstring, or the title of a page."""
    if path.suffix == ".md":
        return path.read_text().partition("\n")[0].lstrip("# ")
    source = path / "__init__.py" if path.is_dir() else path
    is_module = source.suffix == ".py" and source.is_file()
    return (ast.get_docstring(ast.parse(source.read_text())) or "").partition("\n")[0] if is_module else ""


def files_of(room: str) -> set[str]:
    """Names of the project's files and folders in a room, without tests; folders end in a slash."""
    inside = [path.relative_to(ROOMS[room]) for path in tracked(f"{ROOMS[room].relative_to(ROOT)}/*")]
    inside = [path for path in inside if not path.name.startswith("test_")]
    return {f"{path.parts[0]}/" if len(path.parts) > 1 else path.name for path in inside} - {"README.md"}


def imported_by(room: str) -> set[str]:
    """Imports of a room's files, by their names in READMEs; modules beside the rooms are left out."""
    modules = [m for m in MODULES if room_of(m) == room and (room != "ngvisco" or m == room)]
    return {floor_of(target) for module in modules for target in graph()[module]} - {floor_of(room)}


def chain_of(room: str) -> list[str]:
    """The longest chain of imports in a room and its inner rooms, without their ``__init__`` modules."""
    return longest_chain(graph(), {m for m in MODULES if m.startswith(f"{room}.") and m not in ROOMS})


def updated(room: str) -> str:
    """The README with updated lists."""
    text = readme(room).read_text()
    body = section(readme(room), "Files")
    items = {
        re.match(r"1\. `([\w./]+)`", item)[1]: item
        for item in re.findall(r"^1\. .*?(?=^1\. |^$)", body, re.M | re.S)
    }
    head = body[: body.index("1. ")]
    tail = body[body.rindex(list(items.values())[-1]) + len(list(items.values())[-1]) :]
    there = files_of(room)
    for name in sorted(there - set(items)):
        # a description begins with lower case; names such as NGSolve or J keep their capital
        line = re.sub(r"^[A-Z](?=[a-z]| )", lambda first: first[0].lower(), first_line(ROOMS[room] / name))
        items[name] = f"1. `{name}` — {line.rstrip('.')}.\n"
    modules = {MODULES[m].name: m for m in MODULES if room_of(m) == room and m != room and m not in ROOMS}
    order: list[str] = []

    def put(name: str) -> None:
        if name in order or name not in there:
            return
        for target in graph().get(modules.get(name, ""), ()):
            if modules.get(MODULES[target].name) == target:
                put(MODULES[target].name)
        order.append(name)

    for name in items:
        put(name)
    text = text.replace(body, head + "".join(items[name] for name in order) + tail)
    allowed = stated(room, "May import")
    kept = [name for name in re.findall(r"`(\w+)`", allowed) if name in imported_by(room)]
    text = text.replace(allowed, ", ".join(f"`{name}`" for name in kept) + ".")
    if room.count(".") == 1 and len(chain_of(room)) < (levels := levels_allowed(room)):
        text = text.replace(f"at most {levels}.", f"at most {len(chain_of(room))}.")
    return text


def levels_allowed(room: str) -> int:
    return int(stated(room, "Levels of imports").removeprefix("at most ").rstrip("."))


if __name__ == "__main__":
    for room in ROOMS:
        new = updated(room)
        if new != readme(room).read_text():
            readme(room).write_text(new)
            print(f"written: {readme(room).relative_to(ROOT)}")
    for room in (room for room in ROOMS if room.count(".") == 1):
        inside = [path for module, path in MODULES.items() if module.startswith(f"{room}.")]
        lines = sum(len(path.read_text().splitlines()) for path in inside)
        steps = " -> ".join(module.removeprefix(f"{room}.") for module in chain_of(room))
        print(f"{room}: {len(inside)} modules, {lines} lines, {len(chain_of(room))} levels: {steps}")
