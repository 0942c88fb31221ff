from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.terminal.console import print_json


def mcp(
    root: Annotated[
        Path, typer.Option(metavar="DIRECTORY", help="Folder of the datasets. The server reads no dataset outside it.")
    ] = Path(),
    seconds: Annotated[float, typer.Option(min=1, max=3600, help="Longest time of a tool's command, s.")] = 120.0,
    json: Annotated[bool, typer.Option("--json", help="Serve nothing; print the tools as JSON.")] = False,
) -> None:
    """Serve read-only commands and `pickplace batch` to a coding agent, on stdin and stdout.

    The protocol is the Model Context Protocol. The agent's program starts this command.

    Example: yamsim mcp --root dataset
    """
    from yamsim_cli.agent_server import make_server, tool_descriptions

    server = make_server(root, seconds)
    if json:
        print_json({"tools": tool_descriptions(server)})
        return
    server.run()
