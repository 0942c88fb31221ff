"""Bad input gives one clear line and the documented exit code, and loses nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim

USAGE, CONFIG, MISSING = 2, 3, 4


@pytest.mark.parametrize(
    ("args", "code", "parts"),
    [
        (["record", "--rig", "singel"], CONFIG, ["--rig", "'singel'", "did you mean 'single'", "valid:"]),
        (["record", "--task", "nothing"], CONFIG, ["--task", "'nothing'", "valid:", "handover, hang_mug, lift_tray"]),
        (["record", "--config", "nothing"], CONFIG, ["'nothing'", "valid: default"]),
        (["record", "--config", "nowhere.yaml"], CONFIG, ["nowhere.yaml", "does not exist"]),
        (["record", "--n", "0"], USAGE, ["--n", "0 is not valid", "greater than or equal to 1"]),
        (["record", "--n", "many"], USAGE, ["--n", "integer"]),
        (["record", "--workers", "0"], USAGE, ["--workers", "0 is not valid"]),
        (["record", "--seed", "-1"], USAGE, ["--seed", "-1 is not valid"]),
        (["record", "--size", "-640x480"], USAGE, ["--size", "-640x480", "such as 640x480"]),
        (["record", "--size", "640"], USAGE, ["--size", "'640'", "WIDTHxHEIGHT"]),
        (["record", "--size", "2x2"], USAGE, ["--size", "'2x2'", "16..4096"]),
        (["record", "--jpeg-quality", "101"], USAGE, ["--jpeg-quality", "101", "100"]),
        (["record", "--grasp", "suction"], USAGE, ["--grasp", "'suction'", "weld"]),
        (["record", "--resume", "--overwrite"], USAGE, ["--resume", "--overwrite"]),
        (["record", "--nonsense"], USAGE, ["--nonsense"]),
        (["pickplace", "batch", "--threshold", "-1"], USAGE, ["--threshold", "-1", "0..1 m"]),
        (["pickplace", "batch", "--n", "0"], USAGE, ["--n", "0 is not valid"]),
        (["summarize", "nowhere"], MISSING, ["nowhere", "yamsim record"]),
        (["summarize", "."], MISSING, ["no episodes", "yamsim record"]),
        (["summarize", ".", "--threshold", "0"], USAGE, ["--threshold", "0"]),
        (["export", "raiden", "x", "out", "--fps", "0"], USAGE, ["--fps", "'0'", "1..500", "such as 30, or source"]),
        (["export", "raiden", "x", "out", "--fps", "fast"], USAGE, ["--fps", "'fast'", "or source"]),
        (
            ["export", "raiden", "x", "out", "--fps", "source", "--pictures", "draw"],
            USAGE,
            ["--pictures draw", "--fps"],
        ),
        (["export", "raiden", "x", "out", "--images", "bmp"], USAGE, ["--images", "'bmp'", "'png', 'jpg'"]),
        (["export", "raiden", "x", "out", "--hand-frame", "tcp"], USAGE, ["--hand-frame", "'tcp'", "'yamsim', 'i2rt'"]),
        (["export", "raiden", "x", "out", "--pictures", "nearest"], MISSING, ["x is not a directory"]),
        (["record", "--out", "x" * 300], MISSING, ["cannot be written", "255 bytes", "choose another --out"]),
        (["summarize", "x" * 300], MISSING, ["cannot be read", "too long", "yamsim record"]),
        (["verify", "x" * 300], MISSING, ["is not a valid path", "255 bytes"]),
        (["replay", "x" * 300], MISSING, ["is not a valid path", "255 bytes"]),
        (["config", "show", "rigs", "nothing"], CONFIG, ["'nothing'", "valid:", "single"]),
        (["config", "show", "nonsense", "x"], CONFIG, ["'nonsense'", "valid:", "rigs"]),
        (["config", "show", "record"], USAGE, ["say which one; valid: default"]),
        (["config", "show", "rigs"], USAGE, ["say which one; valid: bimanual, russet, single,"]),
        (
            ["record", "--rig", "russet", "--task", "handover", "--grasp", "contact"],
            USAGE,
            ["--grasp: grasp 'contact' needs a gripper with pads", "use --rig yam_station_linear_4310_d405"],
        ),
        (["pickplace", "batch", "--threshold", "0,05"], USAGE, ["--threshold", "'0,05'", "write 0.05"]),
        (["pickplace", "batch", "--threshold", "50"], USAGE, ["--threshold: 50.0", "in mm? Then give 0.05"]),
        (["compose-xml", "--rig", "bimanual", "--margin", "591"], USAGE, ["--margin: 591.0", "in mm? Then give 0.591"]),
        (["assets", "fetch", "nonsense"], USAGE, ["'nonsense'", "valid:", "ycb"]),
        (["nonsense"], USAGE, ["nonsense"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) and value and not value[0].startswith("'") else None,
)
def test_one_line_and_the_exit_code(args: list[str], code: int, parts: list[str], tmp_path: Path) -> None:
    run = yamsim(*args, cwd=tmp_path)
    assert (run.code, run.out) == (code, "")
    for part in parts:
        assert part in run.message
    assert list(tmp_path.iterdir()) == []


def test_unknown_key_in_a_file_is_named_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("rig: single\nscene: tabletop\ntask: pickplace\nimage:\n  size_px: [64, 48]\n  jpeg_qality: 9\n")
    run = yamsim("record", "--config", file, cwd=tmp_path)
    assert run.code == CONFIG
    assert f"{file}:6: image.jpeg_qality: unknown key; did you mean 'jpeg_quality'?" in run.message


def test_output_that_is_in_the_way_is_left_alone(tmp_path: Path) -> None:
    precious = tmp_path / "dataset" / "precious.txt"
    precious.parent.mkdir()
    precious.write_text("keep me")
    run = yamsim("record", "--n", "1", cwd=tmp_path)
    assert run.code == USAGE
    assert all(part in run.message for part in ("dataset", "--resume", "--overwrite"))
    assert precious.read_text() == "keep me"
    assert [path.name for path in precious.parent.iterdir()] == ["precious.txt"]


@pytest.mark.parametrize("command", [["record", "--n", "1"], ["compose-xml"]], ids=lambda command: command[0])
def test_where_one_stands_is_not_moved_aside(command: list[str], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("keep me")
    run = yamsim(*command, "--out", ".", "--overwrite", cwd=tmp_path)
    assert run.code == USAGE
    assert str(tmp_path) in run.message
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("command", "code", "told"),
    [
        (
            ["record", "--n", "1"],
            USAGE,
            "is not a directory: it is a link to gone, which does not exist; move it aside",
        ),
        (["render-views", "--size", "64x48"], MISSING, "cannot be written: it is a link to gone, which does not exist"),
        (["compose-xml"], USAGE, "exists; move it aside with --overwrite"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_a_link_that_leads_nowhere_is_named(command: list[str], code: int, told: str, tmp_path: Path) -> None:
    (tmp_path / "out").symlink_to("gone")
    run = yamsim(*command, "--out", "out", cwd=tmp_path)
    assert run.code == code
    assert f"out {told}" in run.message
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_resuming_what_is_no_dataset_leaves_it_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("keep me")
    run = yamsim("record", "--n", "1", "--out", tmp_path, "--resume")
    assert run.code == MISSING
    assert "cannot be resumed" in run.message
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_output_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    run = yamsim("record", "--n", "1", "--out", tmp_path / "file" / "dataset")
    assert run.code == MISSING
    assert "cannot be written" in run.message


def test_no_gl_backend_is_said_before_anything_is_made(tmp_path: Path) -> None:
    run = yamsim("record", "--n", "1", "--out", tmp_path / "d", env={"MUJOCO_GL": "glfw", "DISPLAY": ""})
    assert run.code == MISSING
    assert "no OpenGL backend" in run.message
    assert "apt-get install" in run.message
    assert not (tmp_path / "d").exists()


def test_without_opengl_an_export_says_what_needs_none(tmp_path: Path) -> None:
    run = yamsim("export", "raiden", tmp_path, tmp_path / "out", env={"MUJOCO_GL": "glfw", "DISPLAY": ""})
    assert run.code == MISSING
    assert run.message.endswith("give --pictures nearest or --fps source")


def test_help_needs_nothing_heavy(tmp_path: Path) -> None:
    import subprocess
    import sys

    code = (
        "import sys; sys.argv = ['yamsim', '--help']\n"
        "from yamsim_cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print(sorted({'mujoco', 'mink', 'cv2', 'numpy', 'pydantic', 'yaml'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_json_errors_leave_stdout_empty(tmp_path: Path) -> None:
    run = yamsim("summarize", tmp_path, "--json")
    assert (run.code, run.out) == (MISSING, "")
