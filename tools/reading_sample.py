"""Draws comments, docstrings and names at random, for a test whether a stranger understands them.

    python -m tools.reading_sample --seed 37 --n 60 --out out/reading

A reader who does not know the project gets `prose.json` and one source file for each entry, and explains each comment
in their own words. From `names.json` the reader guesses what each name stands for, without a source file. A second
person compares the answers with the code.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import random
import shutil
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1] / "yamsim_cli"
_NOT_PROSE = ("noqa", "type: ignore")  # comments for tools


def main() -> None:
    """Write the lists, and copies of the files in which the comments stand."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--n", type=int, default=60, help="entries of each list")
    parser.add_argument("--out", type=Path, default=Path("out/reading"))
    given = parser.parse_args()
    prose, names = list[dict[str, Any]](), list[dict[str, Any]]()
    for path in sorted(PACKAGE.rglob("*.py")):
        prose += _prose(path)
        names += _names(path)
    rng = random.Random(given.seed)
    prose, names = rng.sample(prose, given.n), rng.sample(names, given.n)
    given.out.mkdir(parents=True, exist_ok=True)
    for number, entry in enumerate(prose):
        shutil.copy(PACKAGE.parent / entry["file"], given.out / f"{number:02d}.py.txt")
    for name, entries in (("prose", prose), ("names", names)):
        (given.out / f"{name}.json").write_text(json.dumps(entries, indent=1) + "\n")


def _prose(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the docstrings and comments of a file; comments on lines of their own that follow each other are one."""
    text, file = path.read_text(encoding="utf-8"), str(path.relative_to(PACKAGE.parent))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (words := ast.get_docstring(node)):
            name = "the module" if isinstance(node, ast.Module) else node.name
            yield {"file": file, "line": getattr(node, "lineno", 1), "of": name, "text": words}
    found = list[dict[str, Any]]()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT or any(word in token.string for word in _NOT_PROSE):
            continue
        words, line = token.string[1:].strip(), token.start[0]
        stands_alone = token.line.strip().startswith("#")
        if stands_alone and found and found[-1]["end"] == line - 1:
            found[-1] |= {"text": f"{found[-1]['text']} {words}", "end": line}
        else:
            found.append({"file": file, "line": line, "text": words, "end": line if stands_alone else None})
    yield from ({key: value for key, value in one.items() if key != "end"} for one in found)


def _names(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the names of a file's module, classes, functions and methods."""
    module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    if path.stem != "__init__":
        yield {"kind": "module", "name": path.stem, "package": module.rpartition(".")[0]}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("__"):
            kind = "class" if isinstance(node, ast.ClassDef) else "function or method"
            yield {"kind": kind, "name": node.name, "package": module}


if __name__ == "__main__":
    main()
