from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.flags.session_options import Json
from yamsim_cli.terminal.console import print_note, print_result_now


def serve_policy(
    policy: Annotated[str, typer.Option(help="module:Class or file.py:Class.", show_default=False)],
    host: Annotated[
        str,
        typer.Option(help="Address to listen on. Beyond 127.0.0.1, anyone who reaches the address can use the policy."),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 selects a free port.")] = 8080,
    json: Json = False,
) -> None:
    """Serve a policy to `yamsim eval --policy http://HOST:PORT`, for example on a GPU machine. Ctrl-C ends the server.

    Example: yamsim serve-policy --policy my_policy.py:MyPolicy --port 8080
    """
    from yamsim_cli.policies.policy_loading import load_policy
    from yamsim_cli.policies.policy_server import LOOPBACK, PolicyServer

    # Load the policy once, so that errors are reported before a client connects.
    load_policy(policy, Path.cwd())
    with PolicyServer(lambda: load_policy(policy, Path.cwd()), host, port) as server:
        if host != LOOPBACK:
            print_note(f"Anyone who reaches {server.url} can use the policy: it has no password.")
        print_result_now({"url": server.url}, f"{server.url}  (Ctrl-C ends)", json)
        server.serve_forever()
