"""Each folder of the package is a room: its README names its files and what they may import."""

from __future__ import annotations

import re

import pytest
from documents import section
from rooms import (
    MODULES,
    ROOMS,
    chain_of,
    circles_in,
    files_of,
    floor_of,
    graph,
    imported_by,
    levels_allowed,
    listed,
    readme,
    room_of,
    stated,
    updated,
)


@pytest.mark.parametrize("room", ROOMS)
def test_every_file_of_a_room_is_in_its_readme(room):
    there, named = files_of(room), listed(room)
    assert len(named) == len(set(named)), named
    assert there <= set(named), f"not in the README: {sorted(there - set(named))}, see tests/rooms.py"
    assert set(named) <= there, f"not in the folder: {sorted(set(named) - there)}"


@pytest.mark.parametrize("room", ROOMS)
def test_readme_of_a_room_has_at_most_two_pages(room):
    """Longer texts are pages beside the README: measurements are in NOTES.md, tables for users in pages
    named after their subject."""
    assert len((ROOMS[room] / "README.md").read_text().splitlines()) <= 80


@pytest.mark.parametrize("room", ROOMS)
def test_files_are_listed_after_those_that_they_import(room):
    """A room can then be read from top to bottom; ``__init__.py``, its entrance, may stand first."""
    order = {name: place for place, name in enumerate(listed(room))}
    for module, targets in graph().items():
        if module == room or room_of(module) != room or module in ROOMS:
            continue
        for target in targets:
            if target != room and room_of(target) == room and target not in ROOMS:
                user, used = (MODULES[m].name for m in (module, target))
                assert order[used] < order[user], f"{user} imports {used}, which is listed after it"


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_import_only_what_their_readme_allows(room):
    """A room may import itself, its parents' and inner rooms, and the rooms in its line 'May import'."""
    allowed = set(re.findall(r"`([\w.]+)`", stated(room, "May import"))) | {floor_of(room)}
    known = {floor_of(module) for module in MODULES}
    assert allowed <= known, f"no such room or module: {sorted(allowed - known)}"
    for module, targets in graph().items():
        if room_of(module) == room and (room != "ngvisco" or module == room):
            for target in targets:
                assert floor_of(target) in allowed, f"{module} imports {target}"
    unused = allowed - imported_by(room) - {floor_of(room)}
    assert not unused, f"allowed and not used: {sorted(unused)}"


def test_modules_beside_the_rooms_import_what_their_line_allows():
    text = section(readme("ngvisco"), "Files")
    for module in MODULES:
        if room_of(module) == "ngvisco" and module != "ngvisco":
            line = re.findall(rf"^1\. `{MODULES[module].name}` .*?(?=^1\. |^$)", text, re.M | re.S)
            (imports,) = re.findall(r"Imports (nothing|`.*?`)\.", " ".join(line[0].split()))
            allowed = set(re.findall(r"`(\w+)`", imports))
            assert {floor_of(target) for target in graph()[module]} == allowed, module


def test_imports_have_no_cycle_even_with_imports_for_types():
    assert circles_in(graph(typed=True)) == []


@pytest.mark.parametrize("room", [room for room in ROOMS if room.count(".") == 1])
def test_levels_of_imports_are_no_more_than_stated(room):
    """Levels are counted within a room and its inner rooms, without their ``__init__``."""
    chain = chain_of(room)
    assert len(chain) <= levels_allowed(room), f"{len(chain)} levels: {' -> '.join(chain)}"


@pytest.mark.parametrize("room", ROOMS)
def test_an_update_of_readmes_keeps_their_files_and_the_order(room):
    """``python tests/rooms.py`` would write the same files in the same order."""
    names = re.findall(r"^1\. `([\w./]+)`", updated(room), re.MULTILINE)
    assert names == listed(room)
