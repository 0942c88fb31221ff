"""Photos of a rig with known truth, through all of `yamsim overlay` except its command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.board_photos import pose_error, scaled_camera
from tests.rig_photos import RigPhoto, standing
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.errors import ConfigError, PartialJobError, ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose
from yamsim_cli.core.images.image_files import read_image
from yamsim_cli.photos.overlay import overlay_run as overlayer
from yamsim_cli.photos.overlay.overlay_report import OverlayReport
from yamsim_cli.photos.overlay.overlay_run import OverlayRequest, photo_jobs, run_overlays
from yamsim_cli.photos.overlay.photos import Photo, find_photos

pytestmark = pytest.mark.render

Runner = Callable[..., OverlayReport]


@pytest.fixture
def run(russet_shot: RigPhoto, locations: Locations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Runner:
    """Run photos with the shot's camera and joints, with primitives, into `out`; further options may be given."""
    monkeypatch.chdir(tmp_path)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    quality = load_config(RenderConfig, "quality", "fast", locations)

    def run_photos(
        *paths: str,
        photos: list[Photo] | None = None,
        stands: Any = (russet_shot.stands,),
        out: Path = Path("out"),
        camera: CameraModel | None = russet_shot.camera,
        write_masks: bool = False,
        mask_images: Path | None = None,
        **changes: Any,
    ) -> OverlayReport:
        photos = photos or [Photo(path) for path in find_photos([Path(path) for path in paths])]
        jobs = photo_jobs(photos, out, postures=stands, write_masks=write_masks, mask_images=mask_images)
        request = OverlayRequest(jobs, out, camera, **changes)
        return run_overlays(russet_shot.rig, request, scene, quality, locations, lambda done, total: None)

    return run_photos


@pytest.fixture
def photo(russet_shot: RigPhoto, tmp_path: Path) -> Path:
    path = tmp_path / "photo.png"
    save(path, russet_shot.image)
    return path


def save(path: Path, image: np.ndarray) -> None:
    assert cv2.imwrite(str(path), image[..., ::-1])


def off(T: Array, truth: Array) -> tuple[float, float]:
    """Error of a pose, mm and degrees."""
    shift, turn = pose_error(T, truth)
    return shift * 1000, float(np.rad2deg(turn))


def nothing_but(folder: Path, *names: str) -> None:
    assert sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()) == sorted(names)


def test_one_photo_gives_an_overlay_a_mask_and_a_report(run: Runner, photo: Path, russet_shot: RigPhoto) -> None:
    save(photo.parent / "truth.png", np.dstack([russet_shot.mask * np.uint8(255)] * 3))
    report = run("photo.png", mask_images=Path("truth.png"))
    report.raise_for_failures()
    (result,) = report.results
    for k, arm in enumerate(result.arms):
        assert arm.status == "ok"
        mm, degrees = off(arm.T_base_in_cam, russet_shot.T_base_in_cam(k))
        assert mm < 1.0
        assert degrees < 0.3
        # The drawing ends at the photo's edges, and covers exactly the arms' pixels.
        assert arm.edge_residual < 0.5
    assert result.iou > 0.98
    assert (result.lens.source, result.joints_source) == ("file", "file")
    assert result.margin == pytest.approx(0.591, abs=0.001)
    nothing_but(photo.parent / "out", "overlay.json", "photo_overlay.png")
    assert read_image(Path("out/photo_overlay.png")).shape == russet_shot.image.shape
    assert json.loads(Path("out/overlay.json").read_text()) == report.to_json_data()


def test_the_report_has_what_is_promised(run: Runner, photo: Path) -> None:
    report = run("photo.png")
    plain = report.to_json_data()
    assert list(plain) == ["images", "files", "failures", "unreadable", "still", "still_unknown", "moved"]
    assert plain["files"] == ["out/photo_overlay.png", "out/overlay.json"]
    (image,) = plain["images"]
    assert {"image", "camera", "joints", "ids_seen", "arms", "T_arm2_in_arm1", "margin_m", "rig_margin_m"} <= set(image)
    assert image["image"] == "photo.png"
    assert set(image["camera"]) == {
        "source",
        "K",
        "distortion",
        "width",
        "height",
        "focal_sigma",
        "focal_low",
        "focal_high",
    }
    for arm, name in zip(image["arms"], ("arm1", "arm2"), strict=True):
        assert (arm["name"], arm["status"], arm["reason"]) == (name, "ok", "")
        # A finger's tip hides a corner of one of the 18.
        assert arm["markers_found"] == len(arm["marker_ids"]) >= 8
        T_base_in_cam, T_cam_in_base = np.array(arm["T_base_in_cam"]), np.array(arm["T_cam_in_base"])
        assert T_cam_in_base @ T_base_in_cam == pytest.approx(np.eye(4), abs=1e-9)
        assert np.array(arm["T_board_in_cam"]).shape == (4, 4)
        assert np.array(arm["covariance"]).shape == (6, 6)
        assert 0 < arm["reprojection_rms_px"] < 0.1
        assert arm["position_sigma_m"] > 0
    assert image["rig_margin_m"] == 0.591
    assert json.loads(json.dumps(plain)) == plain


def test_wrong_joints_raise_the_edge_residual(run: Runner, photo: Path, russet_shot: RigPhoto) -> None:
    joints = russet_shot.joints.copy()
    joints[0, 1] += 0.1
    arms = run("photo.png", stands=[standing(joints)]).results[0].arms
    assert arms[0].edge_residual > 2.0 > 0.5 > arms[1].edge_residual


def test_a_mask_has_each_arms_number_and_is_its_own_measure(run: Runner, photo: Path) -> None:
    run("photo.png", write_masks=True, out=Path("first"))
    nothing_but(photo.parent / "first", "overlay.json", "photo_mask.png", "photo_overlay.png")
    labels = cv2.imread("first/photo_mask.png", cv2.IMREAD_UNCHANGED)
    assert labels.shape == (480, 640)
    assert set(np.unique(labels)) == {0, 1, 2}
    # Arm 1 stands on the left in this photo.
    assert np.nonzero(labels == 1)[1].mean() < 320 < np.nonzero(labels == 2)[1].mean()
    report = run("photo.png", mask_images=Path("first"), min_iou=0.999)
    assert report.results[0].iou == 1.0
    report.raise_for_failures()
    shifted = np.roll(labels, 12, axis=1)
    cv2.imwrite("first/photo_mask.png", shifted)
    report = run("photo.png", mask_images=Path("first/photo_mask.png"), min_iou=0.9)
    assert 0.5 < report.results[0].iou < 0.9
    with pytest.raises(ResourceError, match=r"photo\.png: overlap 0\.\d+ with the mask is below 0\.9"):
        report.raise_for_failures()


def test_a_mask_of_another_size_is_refused(run: Runner, photo: Path) -> None:
    cv2.imwrite("small.png", np.zeros((240, 320), np.uint8))
    with pytest.raises(ConfigError, match=r"the mask for photo\.png has 320 x 240 pixels, the photo 640 x 480"):
        run("photo.png", mask_images=Path("small.png"))


@pytest.mark.parametrize("together", [False, True])
def test_refining_keeps_a_good_pose_and_what_the_margin_promises(
    run: Runner, photo: Path, russet_shot: RigPhoto, together: bool
) -> None:
    report = run("photo.png", trust_margin=together, refine=True)
    T = report.results[0].base_poses
    for k in (0, 1):
        mm, degrees = off(T[k], russet_shot.T_base_in_cam(k))
        assert mm < 1.5
        assert degrees < 0.3
        sighting = report.results[0].arms[k].detection
        # The board moved with its arm, and the figure is that of the new pose.
        T_board = russet_shot.rig.arms[k].T_board_in_base
        assert sighting.T_board_in_cam == pytest.approx(T[k] @ T_board, abs=1e-9)
        assert 0.0 < sighting.reprojection_rms < 0.5
    apart = invert_pose(russet_shot.T_base_in_cam(0)) @ russet_shot.T_base_in_cam(1)
    assert (np.abs(invert_pose(T[0]) @ T[1] - apart).max() < 1e-9) == together


def test_a_folder_and_its_own_overlays(run: Runner, photo: Path) -> None:
    """In the photos' own folder, the second call takes no overlay or mask of the first for a photo."""
    before = photo.read_bytes()
    for _ in range(2):
        assert len(run(".", out=Path(), write_masks=True).results) == 1
        nothing_but(photo.parent, "overlay.json", "photo.png", "photo_mask.png", "photo_overlay.png")
    assert photo.read_bytes() == before


def test_an_input_is_never_overwritten(run: Runner, photo: Path, russet_shot: RigPhoto) -> None:
    save(Path("photo_overlay.png"), russet_shot.image)
    run("photo.png", out=Path("masks"), write_masks=True)
    before = {path: path.read_bytes() for path in photo.parent.rglob("*.png")}
    with pytest.raises(UsageError, match=r"photo_overlay\.png is an input and would be overwritten; choose another"):
        run("photo.png", "photo_overlay.png", out=Path())
    with pytest.raises(UsageError, match=r"masks/photo_mask\.png is an input"):
        run("photo.png", mask_images=Path("masks"), out=Path("masks"), write_masks=True)
    Path("link").symlink_to(photo.parent)
    with pytest.raises(UsageError, match="is an input"):
        run("photo.png", "photo_overlay.png", out=Path("link"))
    assert {path: path.read_bytes() for path in photo.parent.rglob("*.png") if "link" not in path.parts} == before


@pytest.mark.slow
def test_photos_of_equal_names(run: Runner, photo: Path, russet_shot: RigPhoto) -> None:
    save(Path("photo.jpg"), russet_shot.image)
    run("photo.png", "photo.jpg")
    nothing_but(photo.parent / "out", "overlay.json", "photo_jpg_overlay.png", "photo_png_overlay.png")
    Path("deeper").mkdir()
    save(Path("deeper/photo.png"), russet_shot.image)
    run("photo.png", "deeper/photo.png", out=Path("two"))
    nothing_but(photo.parent / "two", "000000_photo_png_overlay.png", "000001_photo_png_overlay.png", "overlay.json")


def test_one_damaged_photo_does_not_cost_the_others(run: Runner, photo: Path) -> None:
    Path("a.png").write_bytes(photo.read_bytes()[:5000])
    Path("b.jpg").write_text("no picture")
    report = run(".")
    assert [result.path.name for result in report.results] == ["photo.png"]
    assert report.to_json_data()["unreadable"] == report.unreadable
    message = r"^a\.png is not a valid PNG or JPEG; export it again \(and 1 more\)$"
    with pytest.raises(PartialJobError, match=message):
        report.raise_for_failures()
    assert json.loads(Path("out/overlay.json").read_text())["unreadable"] == report.unreadable
    with pytest.raises(ResourceError, match=r"a\.png is not a valid PNG"):
        run("a.png", "b.jpg")


def test_a_photo_without_boards(run: Runner, photo: Path) -> None:
    cv2.imwrite("empty.png", np.full((480, 640), 120, np.uint8))
    report = run("empty.png")
    assert report.to_json_data()["images"][0]["arms"][0]["T_base_in_cam"] is None
    with pytest.raises(ResourceError) as caught:
        report.raise_for_failures()
    assert str(caught.value).startswith(
        "empty.png: no board gives a pose: looked for marker ids 217-225 (DICT_6X6_250), 226-234 (DICT_6X6_250), "
        "saw none; arm1: none of its markers was found; advice: add light or contrast"
    )
    with pytest.raises(PartialJobError, match=r"1 of 2 photos give no pose, first empty\.png: no board gives"):
        run("empty.png", "photo.png").raise_for_failures()


def test_each_photo_of_a_series_is_told_of_the_one_before(run: Runner, photo: Path, monkeypatch: Any) -> None:
    told = []
    find = overlayer.find_arms

    def finds(rig: Any, photo: Any, grey: Any, lens: Any, trust: bool, before: Any, limits: Any) -> Any:
        told.append(before)
        return find(rig, photo, grey, lens, trust, before, limits)

    monkeypatch.setattr(overlayer, "find_arms", finds)
    Path("q.png").write_bytes(photo.read_bytes())
    run("photo.png", "q.png")
    assert [one and [arm.status for arm in one.arms] for one in told] == [None, ["ok", "ok"]]


def test_a_camera_of_another_size(run: Runner, photo: Path) -> None:
    with pytest.raises(ConfigError, match="has 640 x 480 pixels, but the camera is calibrated for 1280 x 960: give"):
        run("photo.png", camera=CameraModel.from_focal_length(1280, 960, 1200.0))


@pytest.mark.slow
def test_reprojection_above_the_limit(run: Runner, photo: Path, russet_shot: RigPhoto) -> None:
    run("photo.png", max_reprojection=0.1).raise_for_failures()
    report = run("photo.png", max_reprojection=0.003)
    assert len(report.failures) == 2
    message = (
        r"^photo\.png: arm1's reprojection error of 0\.\d\d px is above 0\.003: check the camera file \(and 1 more\)$"
    )
    with pytest.raises(ResourceError, match=message):
        report.raise_for_failures()
    # An invisible board does not pass either.
    hidden = russet_shot.image.copy()
    hidden[240:300, 340:430] = 120
    save(Path("hidden.png"), hidden)
    with pytest.raises(ResourceError, match=r"hidden\.png: arm2 is not located"):
        run("hidden.png", max_reprojection=1.0).raise_for_failures()


def test_an_unknown_camera_and_unknown_joints_are_said_to_be_so(
    run: Runner, photo: Path, russet_shot: RigPhoto
) -> None:
    # A camera's exposure makes prints whiter than the studio's light; too little contrast bounds no interval.
    save(photo, cv2.convertScaleAbs(russet_shot.image, alpha=1.2))
    result = run("photo.png", camera=None, stands=None).results[0]
    assert (result.lens.source, result.joints_source) == ("estimated", "home")
    assert result.lens.focal.low < russet_shot.camera.mean_focal_length < result.lens.focal.high


def test_a_row_of_joints_for_each_photo(run: Runner, photo: Path, russet_shot: RigPhoto) -> None:
    save(Path("q.png"), russet_shot.image)
    wrong = russet_shot.joints.copy()
    wrong[:, 1] += 0.1
    results = run("photo.png", "q.png", stands=[standing(wrong), russet_shot.stands]).results
    assert results[0].edge_residual > 2.0 > 0.5 > results[1].edge_residual
    with pytest.raises(ConfigError, match="--joints has 2 rows for 1 photos; give one row, or one for each"):
        run("photo.png", stands=[standing(wrong)] * 2)


@pytest.mark.slow
def test_a_video_of_all_photos(run: Runner, photo: Path, russet_shot: RigPhoto) -> None:
    av = pytest.importorskip("av", reason="yamsim[video] is not installed")
    for k in range(3):
        save(Path(f"p{k}.png"), russet_shot.image)
    report = run("p0.png", "p1.png", "p2.png", output_video=Path("out/all.mp4"), frame_period=0.1)
    assert Path("out/all.mp4") in report.files
    with av.open("out/all.mp4") as container:
        frames = list(container.decode(video=0))
    assert len(frames) == 3
    shown = frames[1].to_ndarray(format="rgb24").astype(int)
    assert np.abs(shown - read_image(Path("out/p1_overlay.png"))).mean() < 4
    save(Path("small.png"), russet_shot.image[:240, :320])
    with pytest.raises(UsageError, match=r"--video needs photos of one size, but small\.png differs in size"):
        run("p0.png", "small.png", camera=None, output_video=Path("out/two.mp4"))
    assert not list(Path("out").glob("*two*"))


def test_an_output_folder_that_cannot_be_made_is_refused(run: Runner, photo: Path) -> None:
    Path("file").write_text("in the way")
    for out in (Path("file"), Path("file/deeper")):
        with pytest.raises(ResourceError, match=r"cannot be made: (File exists|Not a directory); choose another --out"):
            run("photo.png", out=out)


def test_a_grey_photo_and_one_of_a_bare_rig(run: Runner, photo: Path, russet_shot: RigPhoto) -> None:
    grey = cv2.cvtColor(russet_shot.image, cv2.COLOR_RGB2GRAY)
    cv2.imwrite("grey.png", grey)
    result = run("grey.png").results[0]
    assert [arm.status for arm in result.arms] == ["ok", "ok"]
    assert off(result.base_poses[0], russet_shot.T_base_in_cam(0))[0] < 1.0


def test_two_cameras_in_one_call(run: Runner, photo: Path, russet_shot: RigPhoto) -> None:
    """An episode's photos state their camera; the renderer is made anew where it changes."""
    half = cv2.resize(russet_shot.image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    small = scaled_camera(russet_shot.camera, 0.5)
    save(Path("half.png"), half)
    T = russet_shot.T_base_in_cam(0)
    photos = [
        Photo(photo, russet_shot.camera, russet_shot.stands, "episode", T),
        replace(Photo(Path("half.png"), small, russet_shot.stands, "episode", T)),
    ]
    results = run(photos=photos, stands=None, camera=None).results
    assert [(result.lens.source, result.joints_source) for result in results] == [("episode", "episode")] * 2
    assert [result.lens.camera.width for result in results] == [640, 320]
    # In the small photo, board poses are known to a degree and a half.
    assert results[0].edge_residual < 0.5
    assert results[1].edge_residual < 1.0
