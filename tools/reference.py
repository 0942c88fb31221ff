"""The reference pages of `docs/reference/`, made from the commands' and the configs' own definitions.

`python -m tools.reference` writes them; a test says when they are stale.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer

from yamsim_cli.core.config.loader import CONFIG_KINDS
from yamsim_cli.main import app

PAGES = Path(__file__).resolve().parents[1] / "docs" / "reference"
# For coding agents; between its two marks it lists the commands.
SKILL = PAGES.parent / "SKILL.md"
_LIST_BEGIN, _LIST_END = "<!-- Commands, made by `python -m tools.reference`: -->\n", "<!-- End of the commands. -->\n"

_MADE = "<!-- Made by `python -m tools.reference`; change the code instead. -->\n\n"


def pages() -> dict[str, str]:
    """File name -> Markdown of every reference page."""
    return {"commands.md": commands_page(), "configs.md": configs_page()}


def commands_page() -> str:
    """Every command with its flags, from Typer."""
    root = typer.main.get_command(app)
    parts = [
        _MADE,
        "# Commands\n\n",
        "Every command takes `--help`, and `--json`, which prints one JSON object on stdout and nothing else. Flags "
        "override the config file.\n",
    ]
    for path, command in sorted(_leaves(root)):
        parts.append(f"\n## yamsim {path}\n\n{_prose(command.help)}\n")
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        options = [p for p in command.params if p.param_type_name == "option"]
        if arguments:
            parts.append("\n| argument | what |\n|---|---|\n")
            parts += [f"| `{p.name.upper()}` | {_cell(p.help or '')} |\n" for p in arguments]
        if options:
            parts.append("\n| flag | value | what |\n|---|---|---|\n")
            parts += [_option_row(p, typer.Context(command)) for p in options]
    return "".join(parts)


def skill_page(text: str) -> str:
    """Return the page for coding agents with its list of commands made anew: a line for each, from its help."""
    head, _, rest = text.partition(_LIST_BEGIN)
    _, mark, tail = rest.partition(_LIST_END)
    if not mark:
        raise ValueError(f"{SKILL.name} lacks the line {_LIST_BEGIN!r} or {_LIST_END!r}")
    rows = ["\n| command | what |\n|---|---|\n"]
    for path, command in sorted(_leaves(typer.main.get_command(app))):
        first = " ".join(inspect.cleandoc(command.help).partition("\n\n")[0].split())
        rows.append(f"| `yamsim {path}` | {_cell(first)} |\n")
    return "".join([head, _LIST_BEGIN, *rows, "\n", _LIST_END, tail])


def _leaves(command: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    for name, child in getattr(command, "commands", {}).items():
        full = f"{path} {name}".strip()
        if hasattr(child, "commands"):
            yield from _leaves(child, full)
        else:
            yield full, child


def _prose(text: str) -> str:
    """A docstring as Markdown, its example as a block."""
    lines = inspect.cleandoc(text).splitlines()
    body = "\n".join(line for line in lines if not line.startswith("Example: ")).strip()
    examples = "".join(f"\n\n```console\n$ {line[9:]}\n```" for line in lines if line.startswith("Example: "))
    return body + examples


def _option_row(option: Any, context: typer.Context) -> str:
    flags = ", ".join(f"`{flag}`" for flag in (*option.opts, *option.secondary_opts))
    value = "" if option.is_flag else f"`{option.metavar or option.display_type(context).strip('<>')}`"
    default = option.default
    shown = f" Default: `{getattr(default, 'value', default)}`." if _has_default(option) else ""
    return f"| {flags} | {_cell(value)} | {_cell((option.help or '').rstrip())}{shown} |\n"


def _has_default(option: Any) -> bool:
    return not (option.default is None or option.is_flag or callable(option.default) or option.default == ())


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", "\\|").strip()


def configs_page() -> str:
    """Every kind of config with its keys, from pydantic."""
    parts = [
        _MADE,
        "# Configs\n\n",
        "A config is a YAML file in `configs/KIND/`, or your own. Keys with a unit in their name are in that unit; "
        "all others are in metres, radians, seconds and newtons. `yamsim config schema KIND` prints the JSON schema.\n",
    ]
    for kind, model in CONFIG_KINDS.items():
        schema = model.model_json_schema(by_alias=False)
        parts.append(f"\n## {kind}\n\n")
        parts.append(_model(schema, inspect.cleandoc(model.__doc__ or "")))
    shared: dict[str, Mapping[str, Any]] = {}
    top = {model.__name__ for model in CONFIG_KINDS.values()}
    for model in CONFIG_KINDS.values():
        for name, schema in model.model_json_schema().get("$defs", {}).items():
            if name not in top:
                shared.setdefault(name, schema)
    parts.append("\n## Parts of configs\n")
    for name in sorted(shared):
        parts.append(f"\n### {name}\n\n{_model(shared[name], shared[name].get('description', ''))}")
    return "".join(parts)


def _model(schema: Mapping[str, Any], text: str) -> str:
    summary, said = _attributes(inspect.cleandoc(text))
    required = set(schema.get("required", ()))
    rows = [
        f"| `{key}` | {_type(value)} | {_default(key, value, required)} | {_cell(said.get(key, ''))} |\n"
        for key, value in schema.get("properties", {}).items()
    ]
    if not rows:
        return summary + "\n"
    return f"{summary}\n\n| key | value | default | what |\n|---|---|---|---|\n{''.join(rows)}"


def _attributes(text: str) -> tuple[str, dict[str, str]]:
    """Return a docstring's prose, and key -> text of its section `Attributes`."""
    prose, _, section = text.partition("Attributes:\n")
    said: dict[str, str] = {}
    for entry in re.split(r"\n(?=    \S)", "\n" + section):
        names, colon, what = entry.strip().partition(":")
        if colon:
            said |= dict.fromkeys((name.strip() for name in names.split(",")), what.strip())
    return prose.strip(), said


def _default(key: str, value: Mapping[str, Any], required: set[str]) -> str:
    if key in required:
        return "required"
    if value.get("default") is None:
        return "left out"
    text = json.dumps(value["default"])
    return f"`{text}`" if len(text) <= 60 else "as its parts are by default"


def _type(value: Mapping[str, Any]) -> str:
    """Describe the values that a JSON schema admits."""
    if "$ref" in value:
        name = value["$ref"].rsplit("/", 1)[1]
        return f"[{name}]({_anchor(name)})"
    for key in ("anyOf", "oneOf"):
        if key in value:
            return " or ".join(dict.fromkeys(_type(part) for part in value[key] if part.get("type") != "null"))
    if "enum" in value or "const" in value:
        return " or ".join(f"`{choice}`" for choice in value.get("enum", [value.get("const")]))
    match value.get("type"):
        case "array":
            if "prefixItems" in value:
                items = value["prefixItems"]
                return f"{len(items)} times {_type(items[0])}" if items else "list"
            return f"list of {_type(value.get('items', {}))}"
        case "object":
            inner = value.get("additionalProperties")
            return f"name -> {_type(inner)}" if isinstance(inner, dict) else "mapping"
        case "number" | "integer" as kind:
            return kind + _bounds(value)
        case "boolean":
            return "true or false"
        case "string":
            return "text" + (f" like `{value['pattern']}`".replace("|", "\\|") if "pattern" in value else "")
    return "anything"


def _bounds(value: Mapping[str, Any]) -> str:
    words = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}
    found = [f"{word} {value[key]:g}" for key, word in words.items() if key in value]
    return f", {', '.join(found)}" if found else ""


def _anchor(name: str) -> str:
    kinds = {model.__name__: kind for kind, model in CONFIG_KINDS.items()}
    return f"#{kinds.get(name, name).lower()}"


def main() -> None:
    """Write the pages."""
    PAGES.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (PAGES / name).write_text(text, encoding="utf-8")
    SKILL.write_text(skill_page(SKILL.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
