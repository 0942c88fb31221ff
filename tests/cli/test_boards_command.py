import json

import pytest
import typer
from typer.testing import CliRunner

from yamsim_cli.commands.boards import PaperSize, boards
from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.photos.board_sheet import PAPERS


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    app.command()(boards)
    return lambda *arguments: CliRunner().invoke(app, arguments, catch_exceptions=False)


def test_one_pdf_with_a_page_a_board(run, tmp_path):
    pytest.importorskip("reportlab")
    result = run("--rig", "bimanual", "--paper", "letter", "--json")
    report = json.loads(result.stdout)
    assert report["files"] == ["boards.pdf"]
    assert [(board["arm"], board["name"]) for board in report["boards"]] == [
        ("arm1", "larger_coarse_board"),
        ("arm2", "larger_coarse_board_arm2"),
    ]
    assert [board["ids"] for board in report["boards"]] == [list(range(217, 226)), list(range(226, 235))]
    assert {(board["marker_length_mm"], board["paper"]) for board in report["boards"]} == {(29.230769, "Letter")}
    assert b"/Count 2 " in (tmp_path / "boards.pdf").read_bytes()


def test_a_png_a_board(run, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "print_arm1.png").write_bytes(b"old")
    result = run("--rig", "russet", "--out", "out/print.png", "--overwrite")
    assert result.stdout.split() == ["out/print_arm1.png", "out/print_arm2.png"]
    assert result.stderr == ""
    for name in ("print_arm1.png", "print_arm2.png"):
        assert (tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG")
    assert len(list((tmp_path / "out").iterdir())) == 2


@pytest.mark.parametrize(
    ("out", "message"),
    [("boards.svg", "must end in .pdf or .png"), ("no/b.pdf", "there is no directory .*/no; create it first")],
)
def test_a_bad_out_is_the_command_lines_fault(run, out, message):
    with pytest.raises(UsageError, match=message):
        run("--out", out)


def test_an_out_that_cannot_be_written_says_so(run, tmp_path):
    (tmp_path / "taken_arm1.png").mkdir()
    with pytest.raises(UsageError, match=r"taken_arm1\.png is a directory; give a file"):
        run("--out", "taken.png")


def test_a_rig_without_boards_has_nothing_to_print(run, tmp_path):
    camera = "{position: [0, 0, 0], x_axis: [1, 0, 0], y_axis: [0, 1, 0], fovy_deg: 60}"
    (tmp_path / "bare.yaml").write_text(
        f"arms:\n  - {{name: a, side: right, model: i2rt_yam, gripper: crank, wrist_camera: {camera}}}\n"
    )
    with pytest.raises(ConfigError, match=r"rig 'bare\.yaml' has no boards"):
        run("--rig", "bare.yaml")
    assert not (tmp_path / "boards.pdf").exists()


def test_the_papers_are_those_that_can_be_laid_out():
    assert [str(paper) for paper in PaperSize] == list(PAPERS)
