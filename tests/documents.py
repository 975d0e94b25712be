"""The project's Markdown: its files, the blocks of code in them, their lists."""

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def tracked(pattern: str) -> list[Path]:
    """Files of the project that match a pattern; in a clone, files that git tracks or would add."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", pattern]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\n")
    return [path for path in sorted({ROOT / name for name in names if name}) if path.is_file()]


def marked_blocks(path: Path) -> dict[str, list[str]]:
    """Python blocks after ``<!-- NAME: a test executes this block -->``, by name in the file's order.

    Blocks with the same name are parts of one program.
    """
    found = re.findall(
        r"<!-- (\w+): a test executes this block -->\n+```python\n(.*?)```", path.read_text(), re.DOTALL
    )
    programs: dict[str, list[str]] = {}
    for name, text in found:
        programs.setdefault(name, []).append(text)
    return programs


def section(path: Path, heading: str) -> str:
    """The text under a heading of the second level, up to the next one."""
    parts = re.split(r"^## ", path.read_text(), flags=re.MULTILINE)
    (text,) = [part for part in parts if part.startswith(f"{heading}\n")]
    return text
