"""`yamsim overlay` on photos, on a recorded episode, and on bad input."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.board_photos import facing, photograph
from tests.cli.run_cli import Run, yamsim
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, pose

pytestmark = pytest.mark.render

CAMERA = "width: 640\nheight: 480\nK: [[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1]]\n"
VGA = CameraModel.from_focal_length(640, 480, 600.0)
NEAR = facing(0.0, 0.0, 0.75, 0.6, 0.15)
# The same camera in raiden's file, beside another one.
RAIDEN = {
    "cameras": {
        name: {"intrinsics": {"camera_matrix": K, "distortion_coeffs": [0.0] * 5, "image_size": [640, 480]}}
        for name, K in {
            "left_wrist_camera": [[450.0, 0, 320.0], [0, 450.0, 240.0], [0, 0, 1]],
            "scene_camera": [[600.0, 0, 319.5], [0, 600.0, 239.5], [0, 0, 1]],
        }.items()
    }
}
ARGS = ("overlay", "--img", "photo.png", "--rig", "russet", "--camera", "camera.yaml")
JOINTS = "arm1: [0.9, 1.3, 1.1, -0.2, 0.1, 0.3, 0.03]\n"


def save_photo(
    path: Path, locations: Locations, camera: CameraModel, T_world_in_cam: Array, pushed: float = 0.0, seed: int = 0
) -> None:
    """Save a photo of both boards of russet, without arms; the second base is pushed along y, m."""
    rig = load_config(RigConfig, "rigs", "russet", locations)
    placed = []
    for k, arm in enumerate(rig.arms):
        push = pose((0, pushed if k else 0.0, 0))
        placed.append((arm.board.board_in_metres, T_world_in_cam @ rig.T_base_in_world(k) @ push @ arm.T_board_in_base))
    assert cv2.imwrite(str(path), photograph(camera, placed, seed=seed))


@pytest.fixture(scope="module")
def boards_photo(locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("photo") / "photo.png"
    save_photo(path, locations, VGA, NEAR)
    return path


@pytest.fixture
def folder(tmp_path: Path, boards_photo: Path) -> Path:
    """A user's folder, whose path has a space: a photo, its camera, its joints."""
    path = tmp_path / "my photos"
    path.mkdir()
    (path / "photo.png").write_bytes(boards_photo.read_bytes())
    (path / "camera.yaml").write_text(CAMERA)
    (path / "calibration_results.json").write_text(json.dumps(RAIDEN))
    (path / "joints.yaml").write_text(JOINTS)
    return path


def no_complaints(run: Run) -> bool:
    """Nothing on stderr except notes on primitives and on progress."""
    return all(line.startswith(("The meshes of ", "overlays: ")) for line in run.err.splitlines())


@pytest.mark.parametrize("camera", ["camera.yaml", "calibration_results.json:scene_camera"])
def test_as_the_readme_has_it(folder: Path, camera: str) -> None:
    run = yamsim(*ARGS[:-1], camera, "--joints", "joints.yaml", cwd=folder)
    assert run.code == 0, run.err
    assert no_complaints(run)
    right, left, margin, last = run.out.splitlines()
    assert right.startswith("photo.png: arm1: ok, 9/9 markers, 0.")
    assert left.startswith("photo.png: arm2: ok, 9/9 markers, 0.")
    assert re.fullmatch(r"photo\.png: margin measured: 0\.59(09|10|11) m", margin)
    assert last == "2 files, such as overlays/photo_overlay.png"
    assert sorted(path.name for path in (folder / "overlays").iterdir()) == ["overlay.json", "photo_overlay.png"]


def test_json_is_what_the_report_file_holds(folder: Path) -> None:
    run = yamsim(
        "overlay", "--img", folder, "--rig", "russet", "--mask", "--trust-margin", "--out", "o", "--json", cwd=folder
    )
    assert run.code == 0, run.err
    assert no_complaints(run)
    assert run.json == json.loads((folder / "o" / "overlay.json").read_text())
    (image,) = run.json["images"]
    assert image["camera"]["source"] == "estimated"
    assert image["joints"] == "home"
    assert run.json["files"] == ["o/photo_overlay.png", "o/photo_mask.png", "o/overlay.json"]


def test_a_pose_beyond_the_limits_is_uncertain_and_in_the_report(folder: Path) -> None:
    (found,) = yamsim(*ARGS, "--json", "--out", "found", cwd=folder).json["images"]
    for limit in ("--max-turn", "--max-shift"):
        run = yamsim(*ARGS, "--json", limit, "0", "--out", limit.strip("-"), cwd=folder)
        assert run.code == 4
        (image,) = run.json["images"]
        for arm, located in zip(image["arms"], found["arms"], strict=True):
            assert (arm["status"], located["status"]) == ("uncertain", "ok")
            for key in ("T_board_in_cam", "T_base_in_cam", "covariance"):
                np.testing.assert_allclose(arm[key], located[key], atol=1e-4)
            assert arm["rotation_sigma_rad"] > 0 and arm["position_sigma_m"] > 0


@pytest.mark.slow
def test_boards_from_the_front_give_no_pose_without_a_camera(folder: Path, locations: Locations) -> None:
    """Regression: a long lens far above was taken for a usual lens near by, with both arms `ok` metres off."""
    far = facing(0.0, 0.0, 2.0, 0.02, 0.01)
    save_photo(folder / "photo.png", locations, CameraModel.from_focal_length(1280, 960, 3425.0), far)
    run = yamsim("overlay", "--img", "photo.png", "--rig", "russet", "--json", cwd=folder)
    assert run.code == 4
    assert run.message.endswith("give --camera")
    assert run.message.count("--camera") == 1
    (image,) = run.json["images"]
    for arm in image["arms"]:
        assert (arm["status"], arm["markers_found"], arm["T_base_in_cam"]) == ("poor_fit", 9, None)
        assert arm["reason"].endswith("give --camera")
    camera = image["camera"]
    assert (camera["focal_low"] or 0.0) < 3425 < (camera["focal_high"] or 1e9)
    assert image["margin_m"] is None
    # With the camera, the same photo gives both poses.
    (folder / "long.yaml").write_text("width: 1280\nheight: 960\nK: [[3425, 0, 639.5], [0, 3425, 479.5], [0, 0, 1]]\n")
    args = ("overlay", "--img", "photo.png", "--rig", "russet", "--camera", "long.yaml", "--json", "--out", "known")
    known = yamsim(*args, cwd=folder)
    assert known.code == 0, known.err
    low, high = known.json["images"][0]["camera"]["focal_low"], known.json["images"][0]["camera"]["focal_high"]
    assert low < 3425 < high


@pytest.fixture(scope="module")
def series(locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten photos of both boards of russet; before the sixth, the second arm is pushed aside by 4 mm."""
    folder = tmp_path_factory.mktemp("series")
    (folder / "camera.yaml").write_text(CAMERA)
    for number in range(10):
        save_photo(folder / f"{number:02d}.png", locations, VGA, NEAR, 0.004 if number >= 5 else 0.0, seed=number)
    return folder


@pytest.mark.slow
def test_a_base_that_was_pushed_is_told_with_the_photo(series: Path, tmp_path: Path) -> None:
    asked = ("overlay", "--img", series, "--rig", "russet", "--camera", series / "camera.yaml")
    run = yamsim(*asked, "--out", tmp_path / "all", "--fail-if-moved", "--json")
    assert run.code == 4
    # A slow machine also shows its progress.
    assert "05.png (number 5): before this photo, the base of arm2 was moved by 4.0 mm" in run.err.splitlines()[-1]
    (move,) = run.json["moved"]
    assert (move["frame"], move["what"], move["arm"], run.json["still"]) == (5, "base", "arm2", False)
    assert move["shift_m"] == pytest.approx(0.004, abs=3e-4)
    assert move["shift_in_base_m"][1] == pytest.approx(0.004, abs=3e-4)
    few = yamsim(*asked, "--out", tmp_path / "few", "--every", "2", "--json")
    assert few.code == 0
    assert (len(few.json["images"]), few.json["still"], few.json["moved"]) == (5, None, [])
    assert few.json["still_unknown"]


def test_a_wrong_margin_is_told_on_stderr_and_in_json(folder: Path) -> None:
    run = yamsim(*ARGS, "--margin", "0.596", cwd=folder)
    assert run.code == 0
    notes = [line for line in run.err.splitlines() if line.startswith("photo.png: ")]
    assert len(notes) == 1
    assert "0.59" in notes[0] and "0.5960 m in rig 'russet'" in notes[0]
    report = json.loads((folder / "overlays" / "overlay.json").read_text())
    assert notes[0] == f"photo.png: {report['images'][0]['notes'][0]}"


@pytest.mark.slow
def test_what_would_help_a_refused_board_is_told(folder: Path) -> None:
    """Text and JSON name the remedy if the other board gives a pose; otherwise the error does."""
    path = folder / "photo.png"
    photo = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    # Arm 1's board, in the lower half, is far out of focus.
    photo[240:] = cv2.GaussianBlur(photo, (0, 0), 12)[240:]
    cv2.imwrite(str(path), photo)
    told = yamsim(*ARGS, cwd=folder)
    assert told.code == 0, told.err
    asked = yamsim(*ARGS, "--json", "--out", "asked", cwd=folder)
    (arm,) = [arm for arm in asked.json["images"][0]["arms"] if arm["T_base_in_cam"] is None]
    assert arm["reason"] and arm["advice"]
    line = f"photo.png: {arm['name']}: {arm['reason']}; advice: {', '.join(arm['advice'])}"
    assert line in told.err.splitlines()
    assert line not in asked.err


def test_another_rigs_boards_are_named(folder: Path) -> None:
    rig = (Path(__file__).parents[2] / "configs" / "rigs" / "single.yaml").read_text()
    (folder / "mine.yaml").write_text(rig.replace("first_id: 217", "first_id: 10"))
    run = yamsim("overlay", "--img", "photo.png", "--rig", "./mine.yaml", "--camera", "camera.yaml", cwd=folder)
    assert run.code == 4
    seen = ", ".join(map(str, range(217, 235)))
    assert run.message.startswith("photo.png: ")
    assert "10-18 (DICT_6X6_250)" in run.message and seen in run.message


def test_limits_end_with_4(folder: Path) -> None:
    mask = np.zeros((480, 640), np.uint8)
    mask[:100, :100] = 255
    cv2.imwrite(str(folder / "robot.png"), mask)
    limits = ("--mask-image", "robot.png", "--min-iou", "0.9", "--max-reprojection", "0.5")
    run = yamsim(*ARGS, *limits, cwd=folder)
    assert run.code == 4
    assert run.err.splitlines()[-1].startswith("yamsim: photo.png: ")


@pytest.mark.parametrize(
    ("args", "code", "part"),
    [
        ([], 2, "give either --img or --episode"),
        (["--img", "photo.png", "--episode", "ep"], 2, "give either --img or --episode"),
        (["--img", "photo.png", "--episode-camera", "c"], 2, "--episode-camera needs --episode"),
        (
            ["--episode", "ep", "--camera", "camera.yaml"],
            2,
            "--camera needs --img; a recorded episode has its own camera",
        ),
        (["--img", "photo.png", "--min-iou", "0.5"], 2, "--min-iou needs --mask-image"),
        (["--img", "photo.png", "--opacity", "2"], 2, "--opacity"),
        (["--img", "photo.png", "--rig", "nothing"], 3, "unknown rig 'nothing'"),
        (["--img", "photo.png", "--camera", "none.yaml"], 3, "camera config file none.yaml does not exist"),
        (["--img", "photo.png", "--camera", "calibration_results.json"], 3, "calibration_results.json: has 2 cameras"),
        (["--img", "photo.png", "--camera", "no"], 3, "unknown camera 'no'; valid: example_640x480"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_a_call_that_cannot_be_is_one_line_before_anything_is_loaded(
    folder: Path, args: list[str], code: int, part: str
) -> None:
    run = yamsim("overlay", *args, cwd=folder)
    assert (run.code, run.out) == (code, "")
    assert part in run.message
    assert not (folder / "overlays").exists()


@pytest.mark.parametrize(
    ("args", "code", "part"),
    [
        (["--img", "none.png"], 4, "none.png"),
        (["--img", "joints.yaml"], 4, "joints.yaml"),
        (["--episode", "."], 4, "DATASET/ep_NNNNNN"),
        (["--img", "photo.png", "--joints", "camera.yaml"], 3, "width, height, K"),
        (["--img", "photo.png", "--out", "camera.yaml"], 4, "camera.yaml cannot be made: File exists"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_files_that_cannot_be_used_are_one_line(folder: Path, args: list[str], code: int, part: str) -> None:
    run = yamsim("overlay", *args, cwd=folder)
    assert (run.code, run.out) == (code, "")
    assert part in run.err.splitlines()[-1]
    assert not (folder / "overlays").exists()


@pytest.mark.parametrize("taken", ["photo_overlay.png", "photo_mask.png", "overlay.json"])
def test_a_result_that_exists_is_refused(folder: Path, taken: str) -> None:
    (folder / "overlays").mkdir()
    file = folder / "overlays" / taken
    file.write_bytes(b"mine")
    run = yamsim(*ARGS, "--mask", cwd=folder)
    assert (run.code, file.read_bytes(), list((folder / "overlays").iterdir())) == (2, b"mine", [file])
    assert run.message.endswith(f"{taken} exists; replace it with --overwrite, or give another path")


def test_overwrite_replaces_results(folder: Path) -> None:
    (folder / "overlays").mkdir()
    files = [folder / "overlays" / name for name in ("photo_overlay.png", "photo_mask.png", "overlay.json")]
    for file in files:
        file.write_bytes(b"mine")
    assert yamsim(*ARGS, "--mask", "--overwrite", cwd=folder).code == 0
    assert all(file.read_bytes() != b"mine" for file in files)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "dataset"
    run = yamsim("record", "--n", "1", "--workers", "1", "--seed", "3", "--size", "192x144", "--out", path)
    assert run.code == 0, run.err
    # A few frames are enough.
    episode = path / "ep_000000"
    for file in [*episode.glob("rgb/*/*.jpg"), *episode.glob("lowdim/*.pkl")]:
        if int(file.stem) % 19:
            file.unlink()
    return path


@pytest.mark.slow
def test_an_episode_is_drawn_where_it_was_recorded(dataset: Path, tmp_path: Path) -> None:
    """The outline of the simulated arm meets the arm's edges in the recorded pictures."""
    run = yamsim("overlay", "--episode", dataset / "ep_000000", "--out", tmp_path / "o", "--json")
    assert run.code == 0, run.err
    assert no_complaints(run)
    assert len(run.json["images"]) == len(list((dataset / "ep_000000" / "rgb" / "scene_camera").iterdir()))
    for image in run.json["images"]:
        assert (image["camera"]["source"], image["joints"]) == ("episode", "episode")
        (arm,) = image["arms"]
        assert arm["status"] == "recorded"
        assert arm["T_board_in_cam"] is None
        assert np.array(arm["T_base_in_cam"]).shape == (4, 4)
        # An object beside the arm has edges too.
        assert arm["edge_residual_px"] < 1
    assert np.median([image["arms"][0]["edge_residual_px"] for image in run.json["images"]]) < 0.6


@pytest.mark.slow
def test_an_episode_is_drawn_with_its_own_rig(tmp_path: Path) -> None:
    """Without --rig, the episode's two arms are drawn, and not the default rig."""
    out = tmp_path / "two"
    small = ("--n", "1", "--workers", "1", "--size", "192x144", "--quality", "fast")
    run = yamsim("record", *small, "--rig", "russet", "--out", out)
    assert run.code == 0, run.err
    episode = out / "ep_000000"
    for file in [*episode.glob("rgb/*/*.jpg"), *episode.glob("lowdim/*.pkl")]:
        if int(file.stem):
            file.unlink()
    drawn = yamsim("overlay", "--episode", episode, "--out", tmp_path / "o", "--json")
    assert drawn.code == 0, drawn.err
    (image,) = drawn.json["images"]
    assert [arm["name"] for arm in image["arms"]] == ["arm1", "arm2"]
    assert [arm["status"] for arm in image["arms"]] == ["recorded", "recorded"]
    assert all(arm["edge_residual_px"] < 1.0 for arm in image["arms"])
    # A given --rig is used.
    other = yamsim("overlay", "--episode", episode, "--rig", "single", "--out", tmp_path / "s", "--json")
    assert (other.code, "rig 'single'" in other.err) in ((3, True), (0, False))
    moved = yamsim("overlay", "--episode", episode, "--margin", "0.6", "--out", tmp_path / "m")
    assert (moved.code, "give --rig with --margin" in moved.message) == (2, True)
