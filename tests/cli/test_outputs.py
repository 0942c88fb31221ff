"""All commands refuse an existing output before they work, and replace it with `--overwrite`."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim

# Command line without its output -> option that names the output, and its file.
WRITERS = {
    "excite": (("excite", "--rig", "single"), "--out", "motion.csv"),
    "excite --log": (("excite", "--rig", "single", "--out", "other.csv"), "--log", "log.csv"),
    "identify": (("identify", "log.csv"), "--out", "arm.yaml"),
    "eval": (("eval", "--policy", "hold_still", "--n", "1"), "--out", "report.json"),
    "eval --html": (("eval", "--policy", "hold_still", "--n", "1"), "--html", "page.html"),
    "pickplace batch": (("pickplace", "batch", "--n", "1"), "--out", "report.json"),
    "pickplace batch --html": (("pickplace", "batch", "--n", "1"), "--html", "page.html"),
    "gap": (("gap", "log.csv"), "--out", "report.json"),
    "gap --html": (("gap", "log.csv"), "--html", "page.html"),
    "summarize": (("summarize", "dataset"), "--html", "page.html"),
    "boards": (("boards",), "--out", "boards.pdf"),
    "render-views": (("render-views",), "--out", "views"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_exists_is_refused_before_the_work(name: str, tmp_path: Path) -> None:
    line, flag, file = WRITERS[name]
    taken = tmp_path / file
    if not taken.suffix:
        taken.mkdir()
        taken /= "views.png"
    taken.write_bytes(b"mine")
    run = yamsim(*line, flag, file, cwd=tmp_path)
    assert (run.code, taken.read_bytes()) == (2, b"mine"), run.err
    assert run.message.endswith("exists; replace it with --overwrite, or give another path")
    assert [path.name for path in tmp_path.iterdir()] == [file]


def test_overwrite_replaces(tmp_path: Path) -> None:
    (tmp_path / "boards.pdf").write_bytes(b"mine")
    assert yamsim("boards", "--overwrite", cwd=tmp_path).code == 0
    assert (tmp_path / "boards.pdf").read_bytes().startswith(b"%PDF")


PORTS = {
    "view": ("view", "--web", "--port"),
    "serve-policy": ("serve-policy", "--policy", "tests.policies.sample_policies:Still", "--port"),
}


@pytest.mark.parametrize("name", PORTS)
def test_a_taken_port_is_a_missing_resource(name: str) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        run = yamsim(*PORTS[name], str(taken.getsockname()[1]))
    assert run.code == 4, run.err
    assert "--port" in run.message


@pytest.mark.parametrize(
    "line", [("record", "--m", "3"), ("export", "mp4", "--nothing"), ("pickplace", "batch", "--n", "x")]
)
def test_a_wrong_option_points_to_the_help_of_its_command(line: tuple[str, ...]) -> None:
    run = yamsim(*line)
    command = " ".join(word for word in line[:2] if not word.startswith("-"))
    assert run.code == 2
    assert run.message.endswith(f"; see yamsim {command} --help")
