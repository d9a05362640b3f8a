"""README's files and commands, as a newcomer would copy them."""

from __future__ import annotations

import re
from pathlib import Path

README = Path(__file__).parents[2] / "README.md"
_BLOCK = re.compile(r"<!-- (file|command): (\S+) -->\n```\w+\n(.*?)```", re.DOTALL)


def blocks(kind: str) -> dict[str, str]:
    """Marked code blocks by name."""
    return {name: text for found, name, text in _BLOCK.findall(README.read_text("utf-8")) if found == kind}


def write_files(folder: Path) -> None:
    """Every marked file of the README, in `folder`."""
    for name, text in blocks("file").items():
        (folder / name).write_text(text, "utf-8")
