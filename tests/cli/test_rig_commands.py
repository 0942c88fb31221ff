"""The commands that show a rig, as a user runs them."""

from __future__ import annotations

import zipfile
from pathlib import Path

import cv2
import pytest

from tests.cli.run_cli import yamsim


@pytest.mark.render
def test_render_views_as_the_readme_has_it(tmp_path: Path) -> None:
    run = yamsim("render-views", "--rig", "russet", "--size", "320x240", "--json", cwd=tmp_path)
    assert run.code == 0, run.err
    names = ["front.png", "near_top.png", "low_close_up.png", "views.png"]
    assert run.json == {"files": [f"views/{name}" for name in names]}
    images = [cv2.imread(str(tmp_path / "views" / name)) for name in names]
    assert [image.shape for image in images[:3]] == [(240, 320, 3)] * 3
    assert images[3].shape[0] == 240
    assert images[3].shape[1] > 3 * 320


def test_compose_xml_folder_and_zip(tmp_path: Path) -> None:
    run = yamsim("compose-xml", "--rig", "bimanual", "--out", tmp_path / "b", "--json")
    assert run.code == 0, run.err
    assert (run.json["nq"], run.json["nu"]) == (16, 14)
    assert {"arm", "arm2_arm", "base_board", "arm2_base_board"} <= set(run.json["bodies"])
    assert sorted(run.json["files"]) == sorted(
        path.relative_to(tmp_path / "b").as_posix() for path in (tmp_path / "b").rglob("*") if path.is_file()
    )
    run = yamsim("compose-xml", "--rig", "bimanual", "--out", tmp_path / "b", "--zip", "--json")
    assert run.code == 0, run.err
    with zipfile.ZipFile(tmp_path / "b.zip") as archive:
        assert archive.testzip() is None
        for name in archive.namelist():
            assert archive.read(name) == (tmp_path / name).read_bytes()


@pytest.mark.parametrize(
    ("args", "code", "part"),
    [
        (["compose-xml", "--rig", "nothing"], 3, "'nothing'"),
        (["compose-xml", "--rig", "bimanual", "--margin", "-1"], 2, "--margin"),
        (["record", "--arm", "left", "--n", "1"], 2, "--arm: arm 'left'"),
        (
            ["pickplace", "batch", "--rig", "bimanual", "--arm", "middle"],
            2,
            "'middle' is not valid: must be 'left' or 'right'",
        ),
        (
            ["record", "--task", "handover", "--rig", "single", "--n", "1"],
            2,
            "--rig: the step `handover`",
        ),
        (["compose-xml", "--task", "nothing"], 3, "'nothing'"),
        (["render-views", "--quality", "superb"], 3, "valid: auto, balanced, fast, high, photo"),
        (["render-views", "--size", "9999x10"], 2, "16..4096"),
        (["boards", "--out", "boards.doc"], 2, "boards.doc"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_input(args: list[str], code: int, part: str, tmp_path: Path) -> None:
    run = yamsim(*args, cwd=tmp_path)
    assert (run.code, run.out) == (code, "")
    assert part in run.message
    assert list(tmp_path.iterdir()) == []
