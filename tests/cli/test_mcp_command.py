"""`yamsim mcp` by the client of the package `mcp`."""

from __future__ import annotations

import os
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from yamsim_cli import agent_server
from yamsim_cli.agent_server import CommandRunner, make_server
from yamsim_cli.core.errors import ResourceError, UsageError

pytest.importorskip("mcp", reason="yamsim[mcp] is not installed")

import anyio
from mcp import Client, StdioServerParameters

PATIENCE_S = 600  # the machine may be busy
TOOLS = ["tasks", "robots", "summarize", "verify", "pickplace_batch", "render_views"]


def talk(server: Any, say: Callable[[Client], Awaitable[Any]]) -> Any:
    async def session() -> Any:
        async with Client(server, read_timeout_seconds=PATIENCE_S) as client:
            return await say(client)

    return anyio.run(session)


def call(root: Path, tool: str, **arguments: object) -> Any:
    return talk(make_server(root, PATIENCE_S), lambda client: client.call_tool(tool, arguments))


def refusal(answer: Any) -> str:
    assert answer.is_error
    return str(answer.content[0].text)


def test_tools_say_that_they_only_read(tmp_path: Path) -> None:
    async def listed(client: Client) -> Any:
        return (await client.list_tools()).tools

    tools = talk(make_server(tmp_path, PATIENCE_S), listed)
    assert [tool.name for tool in tools] == TOOLS
    assert all(tool.annotations.read_only_hint and tool.description for tool in tools)


@pytest.mark.parametrize(
    ("tool", "arguments", "says"),
    [
        ("summarize", {"dataset": "../other"}, "lies outside"),
        ("verify", {"dataset": "/etc"}, "lies outside"),
        ("verify", {"dataset": "here", "sample": 21}, "less than or equal to 20"),
        ("pickplace_batch", {"n": 201}, "less than or equal to 200"),
        ("pickplace_batch", {"task": "--video"}, "should match pattern"),
        ("pickplace_batch", {"rig": "/tmp/rig.yaml"}, "should match pattern"),
        ("render_views", {"width": 4000}, "less than or equal to 960"),
    ],
)
def test_what_is_beyond_the_limits_is_refused_before_a_command_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tool: str, arguments: dict[str, Any], says: str
) -> None:
    def runs(*_: object) -> Any:
        raise AssertionError("a command was run")

    monkeypatch.setattr(agent_server, "_run_bounded", runs)
    assert says in refusal(call(tmp_path, tool, **arguments))


def test_a_link_out_of_the_root_is_refused(tmp_path: Path) -> None:
    (tmp_path / "root").mkdir()
    (tmp_path / "root" / "link").symlink_to(tmp_path)
    with pytest.raises(UsageError, match="lies outside"):
        CommandRunner((tmp_path / "root").resolve(), 1).dataset("link")


def test_a_command_that_takes_too_long_or_says_too_much_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match=r"yamsim robots list: stopped after 0\.01 s"):
        CommandRunner(tmp_path, 0.01).run("robots", "list")
    monkeypatch.setattr(agent_server, "_MAX_ANSWER_BYTES", 10)
    monkeypatch.setattr(agent_server, "_run_bounded", lambda *_: (0, '{"items": []}', ""))
    with pytest.raises(UsageError, match="its JSON has 13 bytes; an answer has at most 10;"):
        CommandRunner(tmp_path, 1).run("robots", "list")


def test_without_a_folder_or_the_extra_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="is not a folder"):
        make_server(tmp_path / "none", 1)
    monkeypatch.setitem(sys.modules, "mcp", None)
    with pytest.raises(ResourceError, match=r"pip install 'yamsim\[mcp\]'"):
        make_server(tmp_path, 1)


@pytest.mark.slow
def test_an_agents_program_starts_it_and_gets_reports_and_messages(tmp_path: Path) -> None:
    command = ["-m", "yamsim_cli", "mcp", "--root", str(tmp_path)]
    server = StdioServerParameters(command=sys.executable, args=command, env=dict(os.environ))

    async def say(client: Client) -> Any:
        return await client.call_tool("tasks", {}), await client.call_tool("summarize", {"dataset": "none"})

    tasks, missing = talk(server, say)
    assert not tasks.is_error and tasks.structured_content["exit_code"] == 0
    assert "pickplace" in str(tasks.structured_content["report"])
    assert "none is not a directory" in refusal(missing)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.render
def test_trials_views_and_checks(tmp_path: Path) -> None:
    from yamsim_cli import record

    record(tmp_path / "made", episodes=1, seed=1, size=(96, 72))
    report = call(tmp_path, "summarize", dataset="made").structured_content
    assert report["exit_code"] == 0 and report["report"]["episodes"] == 1
    report = call(tmp_path, "verify", dataset="made", sample=1).structured_content
    assert report["exit_code"] == 0
    report = call(tmp_path, "pickplace_batch", n=2, seed=1).structured_content
    assert report["report"]["n"] == 2
    (picture,) = call(tmp_path, "render_views", rig="single", width=160).content
    assert (picture.type, picture.mime_type) == ("image", "image/png")
