"""The README's blocks of code, for the tests that hold it to what it says."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

TEXT = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


@dataclass(frozen=True)
class Block:
    """A fenced block: the heading that it stands under, its language (empty for none) and its text."""

    section: str
    language: str
    text: str

    @property
    def commands(self) -> list[str]:
        """Its lines without comments and empty ones."""
        lines = (re.sub(r"(^|\s+)#.*", "", line) for line in self.text.splitlines())
        return [line for line in lines if line]


def blocks(page: str = TEXT) -> list[Block]:
    """All of them, in order; of another page, if its text is given."""
    found, section = [], ""
    for match in re.finditer(r"^```(\w*)\n(.*?)^```$|^#+ ([^\n]+)$", page, re.MULTILINE | re.DOTALL):
        language, text, heading = match.groups()
        if heading is None:
            found.append(Block(section, language, text))
        else:
            section = heading
    return found


def shell_blocks() -> list[Block]:
    """Those with command lines."""
    return [block for block in blocks() if block.language == "sh"]


def snippet(language: str, containing: str) -> str:
    """The text of the one block in a language that contains something."""
    (text,) = (block.text for block in blocks() if block.language == language and containing in block.text)
    return text
