"""The users' pages and their code blocks, for tests of the pages."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
DOCS = REPOSITORY / "docs"
README = REPOSITORY / "README.md"


def _in_the_index() -> list[Path]:
    """Pages of `docs/` in the order of the index, without generated ones."""
    trees = re.findall(r"^```\{toctree\}\n(.*?)^```$", (DOCS / "index.md").read_text("utf-8"), re.MULTILINE | re.DOTALL)
    names = [line for tree in trees for line in tree.splitlines() if line and not line.startswith(":")]
    return [DOCS / f"{name}.md" for name in names if not name.startswith("reference/")]


# In reading order: later pages use recordings of earlier ones.
PAGES = (README, DOCS / "index.md", *_in_the_index(), REPOSITORY / "CONTRIBUTING.md")
TEXT = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)


@dataclass(frozen=True)
class Block:
    """A fenced block: its heading, its language (empty for none) and its text."""

    section: str
    language: str
    text: str

    @property
    def commands(self) -> list[str]:
        """Lines without comments and empty ones."""
        lines = (re.sub(r"(^|\s+)#.*", "", line) for line in self.text.splitlines())
        return [line for line in lines if line]


def blocks(text: str = TEXT) -> list[Block]:
    """Return all blocks in order; of one page, if its text is given."""
    found, section = [], ""
    for match in re.finditer(r"^```(\S*)\n(.*?)^```$|^#+ ([^\n]+)$", text, re.MULTILINE | re.DOTALL):
        language, inside, heading = match.groups()
        if heading is None:
            found.append(Block(section, language, inside))
        else:
            section = heading
    return found


def shell_blocks() -> list[Block]:
    """Those with command lines."""
    return [block for block in blocks() if block.language == "sh"]


def snippet(language: str, containing: str) -> str:
    """Return the text of the only block in a language with a given content; another page may repeat it."""
    (text,) = {block.text for block in blocks() if block.language == language and containing in block.text}
    return text


def without_blocks(text: str) -> str:
    """A page's prose and tables."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
