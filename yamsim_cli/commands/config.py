"""`yamsim config`: list, show and check configs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.flags.session_options import Json, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_table
from yamsim_cli.terminal.tables import NameValueTable

app = typer.Typer(help="List, show and check configs.", no_args_is_help=True)

ConfigKindArgument = Annotated[
    str,
    typer.Argument(help="A kind of config, such as rigs; `yamsim config list` prints all kinds.", show_default=False),
]


@app.command("list")
def list_configs(json: Json = False) -> None:
    """List the configs that commands accept by name.

    Example: yamsim config list
    """
    from yamsim_cli.core.config.loader import CONFIG_KINDS

    where = session_opener.find_locations()
    items = [
        {"kind": kind, "name": name, "path": str(where.config_file(kind, name))}
        for kind in CONFIG_KINDS
        for name in where.config_names(kind)
    ]
    if json:
        print_json({"items": items})
        return
    print_table(
        NameValueTable(
            (kind, ", ".join(item["name"] for item in items if item["kind"] == kind)) for kind in CONFIG_KINDS
        )
    )
    for root in where.data:
        print_line(f"Configs are files such as {root / 'configs' / 'KIND' / 'NAME.yaml'}")


def _require_config_name(context: typer.Context, name: str) -> str:
    kind = context.params.get("kind", "")
    if name or context.resilient_parsing:
        return name
    from yamsim_cli.core.config.loader import config_model

    config_model(kind)
    raise typer.BadParameter(
        f"say which one; valid: {', '.join(session_opener.find_locations().config_names(kind)) or 'none'}"
    )


@app.command()
def show(
    kind: ConfigKindArgument,
    name: Annotated[
        str, typer.Argument(help="A config's name or a YAML file.", show_default=False, callback=_require_config_name)
    ] = "",
    json: Json = False,
) -> None:
    """Show a config with its references resolved and its defaults filled in.

    Example: yamsim config show tasks pickplace
    """
    from yamsim_cli.core.config.loader import config_model, load_config
    from yamsim_cli.core.files.documents.yaml_document import dump_yaml

    data: dict[str, Any] = load_config(config_model(kind), kind, name, session_opener.find_locations()).model_dump(
        mode="json"
    )
    if json:
        print_json(data)
    else:
        print_line(dump_yaml(data).rstrip())


@app.command()
def validate(
    file: Annotated[Path, typer.Argument(help="The file.", show_default=False)],
    kind: Annotated[str | None, typer.Option(help="The file's kind.  [default: the name of its folder]")] = None,
    json: Json = False,
) -> None:
    """Check a file. Exit code 3, and one line with file, key and value, if the file is not valid.

    The file is YAML; a camera's file may also come from another program. If a file has several cameras, all are
    checked. FILE:CAMERA selects one.

    Example: yamsim config validate my_rig.yaml --kind rigs
    """
    from yamsim_cli.core.config.loader import CONFIG_KINDS, config_model, validate_file
    from yamsim_cli.program_checks import check_task_config

    guessed = kind or file.resolve().parent.name
    if kind is None and guessed not in CONFIG_KINDS:
        raise UsageError(f"{file} is in no folder named after a kind of config; give --kind: {', '.join(CONFIG_KINDS)}")
    model, where = config_model(guessed), session_opener.find_locations()
    parts = model.config_paths_in_file(file)
    for part in parts:
        validate_file(model, part, where, check=check_task_config)
    if json:
        print_json({"valid": True, "kind": guessed, "path": str(file), "parts": list(map(str, parts))})
    else:
        for part in parts:
            print_line(f"{part} is a valid {guessed.removesuffix('s')} config")


@app.command()
def schema(kind: ConfigKindArgument, json: Json = False) -> None:
    """Print the JSON schema of a kind of config, for editors that complete and check YAML. The output is always JSON.

    Example: yamsim config schema rigs > rig.schema.json
    """
    from yamsim_cli.core.config.loader import config_model

    print_json(config_model(kind).model_json_schema())
