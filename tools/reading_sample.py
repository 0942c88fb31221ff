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
_NOT_PROSE = ("noqa", "type: ignore", "fmt:")  # comments for tools


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
    """Yield the names that a file defines, each with what an editor's completion list shows: class, type, signature.

    `file` and `line` are for the second person; the reader of the names gets no source file.
    """
    file, module = str(path.relative_to(PACKAGE.parent)), ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    if path.stem != "__init__":
        yield {"kind": "module", "name": path.stem, "package": module.rpartition(".")[0], "file": file, "line": 1}
    yield from (
        {**entry, "package": module, "file": file} for entry in _members(ast.parse(path.read_text("utf-8")), None)
    )


def _members(parent: ast.AST, of_class: str | None) -> Iterator[dict[str, Any]]:
    """Yield the classes, functions, methods, fields and constants that a node defines, those inside functions too."""
    for node in ast.iter_child_nodes(parent):
        entry: dict[str, Any] | None = None
        if isinstance(node, ast.ClassDef):
            entry = {"kind": "class", "name": node.name, "bases": [ast.unparse(base) for base in node.bases]}
        elif isinstance(node, ast.FunctionDef):
            returns = ast.unparse(node.returns) if node.returns else "?"
            signature = f"({ast.unparse(node.args)}) -> {returns}"
            entry = {"kind": "method" if of_class else "function", "name": node.name, "signature": signature}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and _has_members(parent):
            kind = "field" if of_class else "constant"
            entry = {"kind": kind, "name": node.target.id, "type": ast.unparse(node.annotation)}
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and _has_members(parent):
            entry = {"kind": "constant", "name": node.targets[0].id, "type": _type_of(node.value)}
        if entry is not None and not entry["name"].startswith("__"):
            yield entry | ({"class": of_class} if of_class else {}) | {"line": getattr(node, "lineno", 1)}
        if not isinstance(node, ast.expr):
            inside = node.name if isinstance(node, ast.ClassDef) else None
            yield from _members(node, inside)


def _type_of(value: ast.expr) -> str:
    """Return the type of a constant that has no annotation, or the types for which an alias stands."""
    if isinstance(value, ast.Constant):
        return type(value.value).__name__
    if isinstance(value, ast.Call):
        return ast.unparse(value.func)
    return ast.unparse(value) if isinstance(value, ast.Subscript) else type(value).__name__.lower()


def _has_members(node: ast.AST) -> bool:
    """Whether names assigned directly in the node are constants or fields, not local variables."""
    return isinstance(node, ast.Module | ast.ClassDef)


if __name__ == "__main__":
    main()
