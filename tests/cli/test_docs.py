"""README, docs and --help agree with the command line."""

from __future__ import annotations

import ast
import importlib.util
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from tests.e2e import page_lines
from tests.pages import DOCS, PAGES, README, TEXT, blocks, shell_blocks, without_blocks
from tools import reference
from yamsim_cli.main import app

REPOSITORY = Path(__file__).resolve().parents[2]


def _commands(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield every command and group with the words that lead to it."""
    for name, child in getattr(command, "commands", {}).items():
        yield (*path, name), child
        yield from _commands(child, (*path, name))


ROOT = typer.main.get_command(app)
COMMANDS = {" ".join(path): command for path, command in _commands(ROOT)}
LEAVES = {path: command for path, command in COMMANDS.items() if not hasattr(command, "commands")}


def parse(line: str) -> None:
    """Parse a shell line with the executable's own parser, without running it."""
    name, *words = shlex.split(line, comments=True)
    assert name == "yamsim", line
    if words == ["--version"]:
        return
    words = words[: next((k for k, word in enumerate(words) if word in (">", "|", "&&", "2>")), len(words))]
    command, context = ROOT, None
    while hasattr(command, "commands"):
        context = typer.Context(command, parent=context, info_name=name)
        name, command, words = command.resolve_command(context, words)
    command.make_context(name, words, parent=context)


def example(command: Any) -> str:
    """The line after `Example:` that ends a command's help; empty if there is none."""
    found = re.search(r"^\s*Example: (yamsim .*)\Z", (command.help or "").rstrip(), re.MULTILINE)
    return found[1] if found else ""


SHELL_LINES = [line for block in shell_blocks() for line in block.commands]
YAMSIM_LINES = [line for line in SHELL_LINES if line.startswith("yamsim ")]


def test_help_says_what_each_command_and_parameter_does() -> None:
    for path, command in COMMANDS.items():
        assert command.help, path
        for parameter in command.params:
            assert getattr(parameter, "help", None), f"{path}: {parameter.name} has no help"


def test_each_command_is_shown_on_a_page_and_in_its_help_and_can_answer_in_json() -> None:
    for path, command in LEAVES.items():
        shown = any(line.startswith(f"yamsim {path} ") for line in (f"{line} " for line in YAMSIM_LINES))
        assert shown, f"no shell block of README.md or docs/ has a line `yamsim {path} ...`"
        line = example(command)
        assert line.startswith(f"yamsim {path}"), f"the help of {path} does not end in 'Example: yamsim {path} ...'"
        parse(line)
        assert any("--json" in parameter.opts for parameter in command.params), path


def test_the_pages_command_lines_parse() -> None:
    for line in sorted(set(YAMSIM_LINES)):
        parse(line)
        # The line as the test of pages runs it parses too.
        parse(page_lines.prepared(line, policy_port=8081))


def episodes_outside(lines: list[str]) -> list[str]:
    """Return lines that name an episode outside their dataset, as the test of pages runs them."""
    recorded: dict[str, int] = {}
    outside = []
    for shown in lines:
        line = page_lines.prepared(shown, policy_port=8081)
        words = shlex.split(line)
        if line.startswith("yamsim record "):
            out = words[words.index("--out") + 1] if "--out" in words else "dataset"
            count = int(words[words.index("--n") + 1]) if "--n" in words else 0
            recorded[out.strip("/")] = max(count, recorded.get(out.strip("/"), 0))
        named = [(path, int(number)) for path, number in re.findall(r"(\S+?)/ep_(\d+)", line)]
        ranges = re.findall(r"--episodes? (\S+)", shown)
        paths = [word.rstrip("/") for word in words if word.rstrip("/") in recorded]
        named += [(paths[0], int(number)) for one in ranges for number in re.findall(r"\d+", one) if paths]
        if any(number >= recorded.get(path, number + 1) for path, number in named):
            outside.append(shown)
    return outside


def test_the_pages_name_episodes_that_their_commands_record() -> None:
    assert episodes_outside(YAMSIM_LINES) == []


def test_an_episode_that_is_not_recorded_is_found() -> None:
    begun = ["yamsim record --n 500 --workers 4"]
    assert episodes_outside([*begun, "yamsim export rerun dataset/ rrd/ --episodes 0-3"]) == []
    for line in ("yamsim export rerun dataset/ rrd/ --episodes 0-9", "yamsim replay dataset/ep_000004"):
        assert episodes_outside([*begun, line]) == [line]


def test_no_range_of_episodes_is_made_smaller() -> None:
    """A range of episodes outside the dataset must fail when the pages' lines are run."""
    line = "yamsim export rerun dataset/ rrd/ --episodes 0-7"
    assert page_lines.prepared(line, policy_port=8081) == line


def test_a_line_gets_the_flags_that_it_lacks_with_and_without_values(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_lines, "CHEAPER", {"yamsim record": "--n 1 --no-wrist --size 64x48 --json"})
    for line, prepared in {
        "yamsim record --out a": "yamsim record --out a --n 1 --no-wrist --size 64x48 --json",
        "yamsim record --json --n 2": "yamsim record --json --n 2 --no-wrist --size 64x48",
    }.items():
        assert page_lines.prepared(line, policy_port=8081) == prepared


def missing_packages(text: str) -> set[str]:
    """Return imported packages of a page that neither the test environment nor the page installs."""
    trees = [ast.parse(block.text) for block in blocks(text) if block.language == "python"]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    packages = {name.split(".")[0] for name in names}
    return {name for name in packages if importlib.util.find_spec(name) is None and f"`pip install {name}`" not in text}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_pages_python_imports_what_is_installed_or_said_to_be_needed(page: Path) -> None:
    assert missing_packages(page.read_text(encoding="utf-8")) == set()


def test_a_package_that_nobody_installs_is_found() -> None:
    code = "```python\nimport no_such_package.part\n```\n"
    assert missing_packages(code) == {"no_such_package"}
    assert missing_packages(f"{code}Install it: `pip install no_such_package`.") == set()


def test_the_pages_make_targets_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    shown = re.findall(r"^make ([a-z-]+)", "\n".join(SHELL_LINES), re.MULTILINE)
    named = re.findall(r"`make ([a-z-]+)`", TEXT)
    assert {*shown, *named} - targets == set()


def test_what_is_known_of_the_pages_lines_is_about_some() -> None:
    patterns = [*page_lines.SMALLER, *page_lines.NOT_RUN, *page_lines.CHEAPER, *page_lines.SERVERS]
    assert [pattern for pattern in patterns if not any(re.search(pattern, line) for line in SHELL_LINES)] == []
    assert any(page_lines.serves(line) for line in SHELL_LINES)


def test_the_pages_name_only_flags_that_exist() -> None:
    parameters = [parameter for command in (ROOT, *COMMANDS.values()) for parameter in command.params]
    known = {flag for parameter in parameters for flag in (*parameter.opts, *parameter.secondary_opts)}
    text = without_blocks(TEXT)
    # Typer adds it when it parses.
    known.add("--help")
    # An option with a dot belongs to another program.
    flag = r"(?<!\S)--[a-z][a-z-]*(?![\w.])"
    # Benchmarks and other programs have flags of their own.
    codes = [
        code for code in re.findall(r"`([^`]+)`", text) if not re.search(r"python -m tools\.|^inspect-robots ", code)
    ]
    named = {name for code in codes for name in re.findall(flag, code)}
    assert named - known == set()


def test_the_readme_is_read_at_one_sitting() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 250


@pytest.fixture(scope="module")
def reference_pages() -> dict[str, str]:
    return reference.pages()


def test_every_page_is_in_the_index_and_in_the_readme(reference_pages: dict[str, str]) -> None:
    pages = {page for page in DOCS.rglob("*.md") if page.name != "index.md"}
    assert pages - set(PAGES) == {DOCS / "reference" / name for name in reference_pages}
    assert [page for page in pages if str(page.relative_to(REPOSITORY)) not in README.read_text(encoding="utf-8")] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    """Sphinx checks links between pages of docs/; this test also reads README and CONTRIBUTING."""
    for target, anchor in re.findall(
        r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", without_blocks(page.read_text(encoding="utf-8"))
    ):
        if "://" in target:
            continue
        path = page.parent / target if target else page
        assert path.is_file(), f"{page.name}: there is no {target}"
        assert not anchor or anchor in anchors(path), f"{page.name}: {target} has no heading #{anchor}"


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub and Sphinx derive from a page's headings."""
    headings = re.findall(r"^#+ (.+)$", without_blocks(page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_pages_of_docs_link_to_nothing_outside() -> None:
    """The site has only docs/."""
    for page in PAGES:
        if page.parent == DOCS:
            assert "](../" not in page.read_text(encoding="utf-8"), page.name


def test_the_readme_names_every_extra() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra in project["optional-dependencies"]:
        assert f"yamsim[{extra}]" in README.read_text(encoding="utf-8"), f"README.md never mentions yamsim[{extra}]"


@pytest.mark.parametrize(
    "line",
    ["yamsim record --no-such-flag", "yamsim no-such-command", "yamsim record --n many", "yamsim config show rigs"],
)
def test_a_line_that_would_fail_does_not_parse(line: str) -> None:
    with pytest.raises(typer.exceptions.TyperException):
        parse(line)


def test_reference_pages_say_what_the_code_says(reference_pages: dict[str, str]) -> None:
    for name, page in reference_pages.items():
        assert (reference.PAGES / name).read_text(encoding="utf-8") == page, "stale: python -m tools.reference"


def test_the_page_for_agents_lists_all_commands_and_is_a_skill() -> None:
    text = reference.SKILL.read_text(encoding="utf-8")
    assert text == reference.skill_page(text), "stale: python -m tools.reference"
    assert all(f"| `yamsim {path}` |" in text for path in LEAVES)
    # The format of agents' skills: a name of small letters, and a description of at most 1024 characters.
    head = re.match(r"---\nname: ([a-z-]{1,64})\ndescription: (.{1,1024})\n---\n", text)
    assert head and head[1] == "yamsim"


def test_a_page_without_its_marks_is_not_overwritten() -> None:
    with pytest.raises(ValueError, match=r"SKILL\.md lacks the line"):
        reference.skill_page("# For coding agents\n")
