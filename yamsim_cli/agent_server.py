"""Commands of yamsim as tools of the Model Context Protocol, for coding agents.

Each tool runs one command with `--json` in a separate process. The tools read datasets below one folder, change
nothing, and are bounded in time, size and number.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from . import __version__
from .core.errors import UsageError, YamsimError
from .core.extras import require_library

if TYPE_CHECKING:
    from mcp.server import MCPServer

MAX_TRIALS = 200  # of a call: about a minute of two cores
MAX_EPISODES = 20  # that a call of verify reproduces
_MAX_ANSWER_BYTES = 200_000  # of a command's JSON: the length that an agent can read in one answer
_MAX_VIEW_PX = 960  # width of a rendered view: some 300 kB of PNG
_MAX_ERROR_CHARS = 2000  # of what a failed command wrote

_NAME = r"^[A-Za-z0-9_]+(\+[A-Za-z0-9_]+)?$"  # of a task, a rig or an arm with a gripper; no path and no flag
_INSTRUCTIONS = (
    "yamsim simulates the I2RT YAM arm. Answers are the commands' own JSON, in m, rad and s. With exit_code 4, a "
    "report lists problems; the tool has not failed. Datasets are folders below the server's root. To record, "
    "export or evaluate, use the command line: docs/SKILL.md and `yamsim --help`."
)

Name = Annotated[str, Field(pattern=_NAME, max_length=100)]
Dataset = Annotated[str, Field(description="Folder of a dataset, relative to the server's root.", max_length=1000)]


class CommandRunner:
    """Runs commands of yamsim one at a time.

    Args:
        root: folder to which datasets are limited, absolute.
        seconds: limit of a command, s.
    """

    def __init__(self, root: Path, seconds: float) -> None:
        self._root, self._seconds = root, seconds
        self._one_at_a_time = threading.Lock()

    def dataset(self, path: str) -> str:
        """Return the absolute path of a dataset.

        Raises:
            UsageError: it lies outside the root.
        """
        found = (self._root / path).resolve()
        if not found.is_relative_to(self._root):
            raise UsageError(
                f"dataset {path!r} lies outside {self._root}; give a folder below it, or start yamsim mcp "
                "with another --root"
            )
        return str(found)

    def run(self, *arguments: str) -> dict[str, Any]:
        """Return the exit code of a command, and its JSON object as `report`.

        Raises:
            UsageError: the command failed, took too long, or its answer is too large; with its own message.
        """
        command = [sys.executable, "-m", "yamsim_cli", *arguments, "--json"]
        with self._one_at_a_time:
            code, out, err = _run_bounded(command, self._seconds)
        shown = f"yamsim {' '.join(arguments)}"
        if code is None:
            raise UsageError(
                f"{shown}: stopped after {self._seconds:g} s; give fewer episodes or trials, or start yamsim mcp "
                "with a larger --seconds"
            )
        if len(out) > _MAX_ANSWER_BYTES:
            raise UsageError(
                f"{shown}: its JSON has {len(out)} bytes; an answer has at most {_MAX_ANSWER_BYTES}; give fewer "
                "episodes or trials"
            )
        try:
            report = json.loads(out)
        except ValueError:
            raise UsageError(f"{shown}: exit code {code}: {err[-_MAX_ERROR_CHARS:].strip()}") from None
        return {"exit_code": code, "report": report}


def make_server(root: Path, seconds: float) -> MCPServer:
    """Return the server with all tools.

    Args:
        root: folder to which datasets are limited.
        seconds: limit of a command, s.

    Raises:
        ResourceError: the extra `mcp` is not installed.
        UsageError: the root is no folder.
    """
    require_library("yamsim mcp", "mcp", "mcp")
    if not root.is_dir():
        raise UsageError(f"--root {root} is not a folder; give the folder of the datasets")

    from mcp.server import MCPServer
    from mcp.types import ToolAnnotations

    runner = CommandRunner(root.resolve(), seconds)
    reads = ToolAnnotations(read_only_hint=True, open_world_hint=False)
    server = MCPServer("yamsim", version=__version__, instructions=_INSTRUCTIONS, log_level="WARNING")
    for tool in (*_listing_tools(runner), *_dataset_tools(runner), _trials_tool(runner), _views_tool(runner)):
        server.add_tool(_with_own_messages(tool), annotations=reads)
    return server


def tool_descriptions(server: MCPServer) -> list[dict[str, Any]]:
    """Return name, description and JSON schema of the input of each tool."""
    import anyio

    tools = anyio.run(server.list_tools)
    return [{"name": one.name, "description": one.description, "input": one.input_schema} for one in tools]


def _with_own_messages(tool: Callable[..., Any]) -> Callable[..., Any]:
    """Return a tool that answers errors of yamsim by their message; of other errors an agent sees no text."""
    from mcp.server.mcpserver.exceptions import ToolError

    @functools.wraps(tool)
    def answered(**arguments: Any) -> Any:
        try:
            return tool(**arguments)
        except YamsimError as error:
            raise ToolError(str(error)) from error

    return answered


def _listing_tools(runner: CommandRunner) -> Sequence[Any]:
    def tasks() -> dict[str, Any]:
        """List all tasks, with objects, skills and instructions."""
        return runner.run("tasks", "list")

    def robots() -> dict[str, Any]:
        """List arms, grippers and stations, with compatible models, sources and meshes."""
        return runner.run("robots", "list")

    return tasks, robots


def _dataset_tools(runner: CommandRunner) -> Sequence[Any]:
    def summarize(dataset: Dataset) -> dict[str, Any]:
        """Check all files of a dataset, and report statistics and problems. Exit code 4: there are errors."""
        return runner.run("summarize", runner.dataset(dataset))

    def verify(
        dataset: Dataset,
        sample: Annotated[int, Field(ge=1, le=MAX_EPISODES, description="Episodes, spread over the dataset.")] = 3,
    ) -> dict[str, Any]:
        """Reproduce episodes from seeds and actions, and compare all values. Exit code 4: a value differs."""
        return runner.run("verify", runner.dataset(dataset), "--sample", str(sample), "--offline")

    return summarize, verify


def _trials_tool(runner: CommandRunner) -> Any:
    def pickplace_batch(
        n: Annotated[int, Field(ge=1, le=MAX_TRIALS, description="Trials.")] = 20,
        seed: Annotated[int, Field(ge=0, lt=2**32)] = 0,
        task: Name = "pickplace",
        rig: Name | None = None,
    ) -> dict[str, Any]:
        """Run trials of a task's expert from sampled starts without rendering, and count the successes."""
        rigs = ["--rig", rig] if rig else []
        return runner.run("pickplace", "batch", "--n", str(n), "--seed", str(seed), "--task", task, *rigs, "--offline")

    return pickplace_batch


def _views_tool(runner: CommandRunner) -> Any:
    from mcp.server.mcpserver import Image

    def render_views(
        rig: Name = "single", width: Annotated[int, Field(ge=160, le=_MAX_VIEW_PX, multiple_of=4)] = 480
    ) -> Any:
        """Render a rig from the front, from nearly above and from close by, in one picture."""
        with tempfile.TemporaryDirectory(prefix="yamsim-mcp-") as folder:
            size = f"{width}x{width * 3 // 4}"
            runner.run("render-views", "--rig", rig, "--size", size, "--out", folder, "--offline")
            return Image(data=(Path(folder) / "views.png").read_bytes(), format="png")

    return render_views


def _run_bounded(command: Sequence[str], seconds: float) -> tuple[int | None, str, str]:
    """Return exit code, output and error output; no exit code if a command was ended after `seconds`."""
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,  # the agent's messages come on this process's
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # so that its worker processes end with it
    ) as process:
        try:
            out, err = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return None, "", ""
    return process.returncode, out, err
