"""Camera files as people have them: ours, OpenCV's as OpenCV writes them, ROS's; and each fault with its one line."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from yamsim_cli.core.config.cameras.camera import CameraConfig
from yamsim_cli.core.config.loader import load_config, validate_file
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.resources import Locations

K = [[610.5, 0.0, 322.25], [0.0, 608.0, 236.75], [0.0, 0.0, 1.0]]
DISTORTION = [-0.12, 0.05, 0.001, -0.0005, 0.01]
WANTED = CameraModel(640, 480, tuple(map(tuple, K)), tuple(DISTORTION))

FLAT = [number for row in K for number in row]

OURS = f"width: 640\nheight: 480\nK: {K}\ndistortion: {DISTORTION}\n"

ROS = f"""\
image_width: 640
image_height: 480
camera_name: head
camera_matrix:
  rows: 3
  cols: 3
  data: {FLAT}
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: {DISTORTION}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [580.0, 0.0, 321.0, 0.0, 0.0, 590.0, 237.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""

# What `ros2 topic echo --once /camera_info` prints.
ROS_MESSAGE = f"""\
header:
  stamp: {{sec: 12, nanosec: 5}}
  frame_id: head
height: 480
width: 640
distortion_model: plumb_bob
d: {DISTORTION}
k: {FLAT}
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [580.0, 0.0, 321.0, 0.0, 0.0, 590.0, 237.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {{x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}}
"""

# What a page of Python that dumps OpenCV's arrays makes.
DUMPED = f"camera_matrix: {K}\ndist_coeff: [{DISTORTION}]\nwidth: 640\nheight: 480\n"


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def model_of(text: str, locations: Locations) -> CameraModel:
    Path("c.yaml").write_text(text)
    return validate_file(CameraConfig, Path("c.yaml"), locations).model


def refusal(text: str, locations: Locations) -> str:
    with pytest.raises(ConfigError) as caught:
        model_of(text, locations)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("c.yaml:")
    return message


def file_storage(path: Path, names: tuple[str, str, str, str], column: bool) -> Path:
    """A camera file as OpenCV itself writes it."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Sat Nov 21 2026")
    storage.write(names[0], 640)
    storage.write(names[1], 480)
    storage.write(names[2], np.array(K))
    storage.write(names[3], np.array(DISTORTION).reshape(-1, 1) if column else np.array([DISTORTION]))
    storage.write("avg_reprojection_error", 0.21)
    storage.release()
    return path


@pytest.mark.parametrize(
    "text",
    [OURS, OURS.replace(str(K), str(FLAT)), DUMPED, ROS, ROS_MESSAGE],
    ids=["ours", "flat", "dumped", "ros", "message"],
)
def test_files_written_by_hand_or_by_ros(text: str, locations: Locations) -> None:
    assert model_of(text, locations) == WANTED


@pytest.mark.parametrize("column", [True, False])
@pytest.mark.parametrize(
    "names",
    [
        ("image_width", "image_height", "camera_matrix", "distortion_coefficients"),
        ("image_Width", "image_Height", "Camera_Matrix", "Distortion_Coefficients"),
        ("imageWidth", "imageHeight", "cameraMatrix", "distCoeffs"),
        ("width", "height", "mtx", "dist"),
        ("width", "height", "K", "D"),
    ],
)
def test_what_opencv_itself_writes(
    tmp_path: Path, locations: Locations, names: tuple[str, str, str, str], column: bool
) -> None:
    path = file_storage(tmp_path / "c.yaml", names, column)
    assert path.read_text().startswith("%YAML")
    assert load_config(CameraConfig, "cameras", str(path), locations).model == WANTED


def test_whole_numbers_and_no_distortion(locations: Locations) -> None:
    model = model_of("width: 640\nheight: 480\nK: [[600, 0, 320], [0, 600, 240], [0, 0, 1]]\n", locations)
    assert (model.distortion, model.focal) == ((), 600.0)


def test_the_focal_lengths_uncertainty_is_kept_from_any_file(locations: Locations) -> None:
    assert model_of(OURS, locations).focal_sigma == 0.003
    for text in (OURS, ROS, ROS_MESSAGE):
        assert model_of(text + "focal_sigma: 0.02\n", locations).focal_sigma == 0.02


def test_the_shipped_example(locations: Locations) -> None:
    model = load_config(CameraConfig, "cameras", "example_640x480", locations).model
    assert (model.width, model.height, model.focal) == (640, 480, 600.0)


@pytest.mark.parametrize(
    ("old", "new", "line", "part"),
    [
        ("width: 640\n", "", None, "width: missing"),
        ("640", "0", 1, "greater than or equal to 16"),
        ("height: 480", "hieght: 480", 2, "did you mean 'height'?"),
        ("610.5", "0.0", None, "must be above 0 px"),
        ("610.5", "-600", None, "must be above 0 px"),
        ("610.5", "six", 3, "'six'"),
        ("610.5", ".nan", 3, "finite"),
        ("610.5, 0.0,", "610.5, 3.0,", None, "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0, 2.0]", None, "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"),
        (", [0.0, 0.0, 1.0]", "", 3, "K must have 3 x 3 numbers"),
        # In millimetres.
        ("610.5", "3.6", None, "does not fit images of 640 x 480: its focal length is 3.6 px"),
        # Of images twice or half as large, or of a crop that lies elsewhere.
        ("width: 640\nheight: 480", "width: 1280\nheight: 960", None, "middle of images of about 644 x 474"),
        ("width: 640\nheight: 480", "width: 320\nheight: 240", None, "principal point is (322.25, 236.75)"),
        ("width: 640\nheight: 480", "width: 400\nheight: 300", None, "middle of images of about 644 x 474"),
        ("322.25", "-20", None, "principal point is (-20, 236.75)"),
        (str(DISTORTION), "[-0.1, 0.0, 0.0]", None, "distortion has 3 numbers; OpenCV's model has 0, 4, 5, 8, 12"),
        (str(DISTORTION), "none", 4, "'none'"),
        ("distortion:", "focal_sigma: 3\ndistortion:", 4, "less than or equal to 0.5"),
    ],
)
def test_each_fault_of_a_plain_file_is_one_line(
    old: str, new: str, line: int | None, part: str, locations: Locations
) -> None:
    assert OURS.count(old) >= 1
    message = refusal(OURS.replace(old, new, 1), locations)
    assert part in message
    if line is not None:
        assert message.startswith(f"c.yaml:{line}: ")


@pytest.mark.parametrize(
    ("text", "start", "part"),
    [
        (ROS.replace("plumb_bob", "equidistant"), "c.yaml:8: distortion_model", "'equidistant' is not valid"),
        (ROS.replace("plumb_bob", "fisheye"), "c.yaml:8: distortion_model", "valid: plumb_bob, rational_polynomial"),
        (DUMPED + "fisheye_model: 1\n", "c.yaml", "'fisheye' is not valid"),
        (ROS.replace("image_width: 640\n", ""), "c.yaml:1: width", "missing"),
        (ROS.replace("image_width: 640", "image_width: 64000"), "c.yaml:1: width", "64000"),
        (ROS.replace("610.5, ", ""), "c.yaml:5: K", "K must have 3 x 3 numbers"),
        (ROS.replace("data: [610.5", "dates: [610.5"), "c.yaml:5: K", "K must have 3 x 3 numbers"),
        (ROS.replace("0.01]", "0.01, 0.0]"), "c.yaml:1: config", "distortion has 6 numbers"),
    ],
)
def test_each_fault_of_another_programs_file_is_one_line(
    text: str, start: str, part: str, locations: Locations
) -> None:
    message = refusal(text, locations)
    assert message.startswith(start)
    assert part in message


def test_a_rectangular_crop_keeps_its_off_centre_principal_point(locations: Locations) -> None:
    text = OURS.replace("322.25", "500").replace("236.75", "300")
    assert model_of(text, locations).K[0][2] == 500
