"""Camera files of yamsim and of other programs, files of several cameras, and malicious files."""

from __future__ import annotations

import json
import re
from collections import OrderedDict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from yamsim_cli.core.config.cameras.camera import CameraConfig
from yamsim_cli.core.config.loader import load_config, validate_file
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel

K = [[610.5, 0.0, 322.25], [0.0, 608.0, 236.75], [0.0, 0.0, 1.0]]
DISTORTION = [-0.12, 0.05, 0.001, -0.0005, 0.01]
WANTED = CameraModel(640, 480, tuple(map(tuple, K)), tuple(DISTORTION))
RADTAN = CameraModel(640, 480, tuple(map(tuple, K)), tuple(DISTORTION[:4]))


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def read(name: str, locations: Locations) -> CameraModel:
    """Read a name as `--camera` does; `config validate` must agree."""
    model = load_config(CameraConfig, "cameras", name, locations).camera_model
    assert validate_file(CameraConfig, Path(name), locations).camera_model == model
    return model


def refusal(name: str, locations: Locations) -> str:
    with pytest.raises(ConfigError) as caught:
        read(name, locations)
    with pytest.raises(ConfigError) as again:
        validate_file(CameraConfig, Path(name), locations)
    message = str(caught.value)
    assert str(again.value) == message
    assert "\n" not in message
    return message


def model_of_text(text: str, locations: Locations) -> CameraModel:
    Path("c.yaml").write_text(text)
    return read("c.yaml", locations)


def refusal_of_text(text: str, locations: Locations) -> str:
    Path("c.yaml").write_text(text)
    message = refusal("c.yaml", locations)
    assert message.startswith("c.yaml:")
    return message


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


# A Python script's dump of OpenCV's arrays.
DUMPED = f"camera_matrix: {K}\ndist_coeff: [{DISTORTION}]\nwidth: 640\nheight: 480\n"


@pytest.mark.parametrize(
    "text",
    [OURS, OURS.replace(str(K), str(FLAT)), DUMPED, ROS],
    ids=["ours", "flat", "dumped", "ros"],
)
def test_files_written_by_hand_or_by_ros(text: str, locations: Locations) -> None:
    assert model_of_text(text, locations) == WANTED


def test_the_focal_lengths_uncertainty_is_kept_from_any_file(locations: Locations) -> None:
    assert model_of_text(OURS, locations).focal_sigma == 0.003
    for text in (OURS, ROS):
        assert model_of_text(text + "focal_sigma: 0.02\n", locations).focal_sigma == 0.02


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
        # Of images twice or half as large, or of an offset crop.
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
    message = refusal_of_text(OURS.replace(old, new, 1), locations)
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
    message = refusal_of_text(text, locations)
    assert message.startswith(start)
    assert part in message


OPENCV_NAMES = ("image_width", "image_height", "camera_matrix", "distortion_coefficients")


def write_file_storage(
    name: str, distortion: np.ndarray[Any, Any], comment: str = "", keys: tuple[str, ...] = OPENCV_NAMES
) -> None:
    """A file of OpenCV's calibration program, with its further values and comment."""
    storage = cv2.FileStorage(name, cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", 'Sat Nov 21 2026 "<&>"')
    storage.write("nr_of_frames", 20)
    storage.write(keys[0], 640)
    storage.write(keys[1], 480)
    storage.write("flags", 0)
    if comment:
        storage.writeComment(comment)
    storage.write("fisheye_model", 0)
    storage.write(keys[2], np.array(K))
    storage.write(keys[3], distortion)
    storage.write("per_view_reprojection_errors", np.array([[0.2], [np.nan]], np.float32))
    storage.startWriteStruct("grid", cv2.FileNode_SEQ)
    storage.write("", 1.5)
    storage.write("", 'two "words"')
    storage.endWriteStruct()
    storage.write("names", ["a", "b c"])
    storage.release()


@pytest.mark.parametrize("shape", [(5, 1), (1, 5), (5,)], ids=str)
@pytest.mark.parametrize("comment", ["", "flags: +fix_aspectRatio, +zero_tangent_dist"], ids=["plain", "commented"])
@pytest.mark.parametrize("ending", ["yaml", "yml", "json", "xml"])
def test_files_written_by_opencv_are_read(
    ending: str, comment: str, shape: tuple[int, ...], locations: Locations
) -> None:
    write_file_storage(f"c.{ending}", np.array(DISTORTION).reshape(shape), comment)
    assert (comment in Path(f"c.{ending}").read_text()) == bool(comment) or not comment
    assert read(f"c.{ending}", locations) == WANTED


@pytest.mark.parametrize(
    "keys",
    [
        ("image_Width", "image_Height", "Camera_Matrix", "Distortion_Coefficients"),
        ("imageWidth", "imageHeight", "cameraMatrix", "distCoeffs"),
        ("width", "height", "mtx", "dist"),
        ("width", "height", "K", "D"),
    ],
)
def test_the_keys_of_other_calibration_programs(keys: tuple[str, ...], locations: Locations) -> None:
    write_file_storage("c.yaml", np.array(DISTORTION), keys=keys)
    assert read("c.yaml", locations) == WANTED


@pytest.mark.parametrize("ending", ["json", "xml"])
def test_faults_in_opencvs_files_are_told_with_their_line(ending: str, locations: Locations) -> None:
    write_file_storage(f"c.{ending}", np.array(DISTORTION), "a comment")
    path = Path(f"c.{ending}")
    text = path.read_text()
    line = next(k for k, each in enumerate(text.splitlines(), start=1) if "image_width" in each)
    path.write_text(text.replace("640", "64000", 1))
    assert refusal(path.name, locations).startswith(f"c.{ending}:{line}: width: 64000 is not valid: must be less")
    path.write_text(re.sub(r"(fisheye_model\W+)0", r"\g<1>1", text))
    assert "'fisheye' is not valid: calibrate with one of OpenCV's pinhole models" in refusal(path.name, locations)


def test_plain_json_however_it_is_laid_out(locations: Locations) -> None:
    data = {"width": 640, "height": 480, "K": K, "distortion": DISTORTION, "focal_sigma": 0.003}
    for layout in ({}, {"indent": 2}, {"indent": "\t"}, {"separators": (",", ":")}):
        Path("c.json").write_text(json.dumps(data, **layout))
        assert read("c.json", locations) == WANTED
    Path("c.json").write_text('{"width": 640, "width": 640}')
    assert refusal("c.json", locations) == "c.json:1: duplicate key 'width', first at line 1; remove one"
    Path("c.json").write_text('{"width": 640,, }')
    assert refusal("c.json", locations).startswith("c.json:1: not valid JSON: ")
    Path("c.json").write_text("[1, 2]")
    assert refusal("c.json", locations) == "c.json: the top level must be a mapping of keys to values"


# Fields of sensor_msgs/msg/CameraInfo, in order.
MESSAGE = OrderedDict(
    header=OrderedDict(stamp=OrderedDict(sec=12, nanosec=5), frame_id="head"),
    height=480,
    width=640,
    distortion_model="plumb_bob",
    d=DISTORTION,
    k=[number for row in K for number in row],
    r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
    p=[580.0, 0.0, 321.0, 0.0, 0.0, 590.0, 237.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    binning_x=0,
    binning_y=0,
    roi=OrderedDict(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
)


class RosDumper(yaml.Dumper):
    """Mappings in their order, as rosidl_runtime_py writes them."""


RosDumper.add_representer(
    OrderedDict,
    lambda dumper, data: yaml.nodes.MappingNode(
        "tag:yaml.org,2002:map", [(dumper.represent_data(key), dumper.represent_data(data[key])) for key in data]
    ),
)


def echoed(flow: bool) -> str:
    """Output of `ros2 topic echo` for one message."""
    text = yaml.dump(MESSAGE, Dumper=RosDumper, allow_unicode=True, width=1 << 60, default_flow_style=flow)
    return f"{text}---\n"


@pytest.mark.parametrize("flow", [False, True])
def test_output_of_ros2_topic_echo_is_read(flow: bool, locations: Locations) -> None:
    Path("c.yaml").write_text(echoed(flow))
    assert read("c.yaml", locations) == WANTED
    Path("c.yaml").write_text(echoed(flow) * 3)
    message = refusal("c.yaml", locations)
    line = echoed(flow).count("\n") + 1
    assert message == f"c.yaml:{line}: not valid YAML: a second document begins here; keep one"


def kalibr_camera(**changes: Any) -> dict[str, Any]:
    camera = {
        "camera_model": "pinhole",
        "cam_overlaps": [1],
        "distortion_coeffs": DISTORTION[:4],
        "distortion_model": "radtan",
        "intrinsics": [610.5, 608.0, 322.25, 236.75],
        "resolution": [640, 480],
        "rostopic": "/cam0/image_raw",
        "timeshift_cam_imu": -0.0042,
        "T_cam_imu": np.eye(4).tolist(),
    }
    return camera | changes


def write_camchain(**cameras: dict[str, Any]) -> None:
    # As its ConfigReader writes it, with PyYAML's styles before and since version 5.1.
    Path("camchain.yaml").write_text(yaml.dump(cameras, default_flow_style=None))
    assert yaml.safe_load(yaml.dump(cameras)) == cameras


def test_kalibrs_chains(locations: Locations) -> None:
    other = kalibr_camera(
        intrinsics=[458.0, 457.0, 367.0, 248.0], resolution=[752, 480], T_cn_cnm1=np.eye(4).tolist(), cam_overlaps=[0]
    )
    write_camchain(cam0=kalibr_camera(), cam1=other)
    assert read("camchain.yaml:cam0", locations) == RADTAN
    second = read("camchain.yaml:cam1", locations)
    assert (second.width, second.height) == (752, 480)
    assert second.K == ((458.0, 0.0, 367.0), (0.0, 457.0, 248.0), (0.0, 0.0, 1.0))
    write_camchain(cam0=kalibr_camera())
    assert read("camchain.yaml", locations) == read("camchain.yaml:cam0", locations) == RADTAN
    write_camchain(cam0=kalibr_camera(distortion_model="none", distortion_coeffs=[]))
    assert read("camchain.yaml", locations).distortion == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"distortion_model": "equidistant"}, "cam0.distortion_model: 'equidistant' is not valid: calibrate with one"),
        ({"distortion_model": "fov"}, "valid: none, radtan"),
        ({"distortion_model": "none"}, "remove the coefficients"),
        ({"camera_model": "omni", "intrinsics": [0.9, 1.0, 2.0, 3.0, 4.0]}, "cam0.camera_model: 'omni' is not valid"),
        ({"camera_model": "ds"}, "valid: pinhole"),
        ({"intrinsics": [1.0, 2.0]}, "cam0.intrinsics: [1.0, 2.0] is not valid: must be 4 numbers"),
        ({"intrinsics": ["six", 608.0, 322.25, 236.75]}, "'six' is not valid"),
        ({"resolution": 640}, "cam0.resolution: 640 is not valid: must be 2 numbers"),
        ({"resolution": [1280, 960]}, "K does not fit images of 1280 x 960"),
        ({"distortion_coeffs": [0.1]}, "distortion has 1 numbers"),
    ],
)
def test_faults_in_a_chain(changes: dict[str, Any], part: str, locations: Locations) -> None:
    write_camchain(cam0=kalibr_camera(**changes), cam1=kalibr_camera())
    message = refusal("camchain.yaml:cam0", locations)
    assert message.startswith("camchain.yaml:")
    assert part in message
    assert read("camchain.yaml:cam1", locations) == RADTAN


@pytest.mark.parametrize("key", ["camera_model", "distortion_model", "distortion_coeffs", "intrinsics", "resolution"])
def test_a_missing_key_of_a_kalibr_chain_is_named(key: str, locations: Locations) -> None:
    camera = kalibr_camera()
    del camera[key]
    write_camchain(cam0=camera)
    assert f"cam0.{key}: missing; add it" in refusal("camchain.yaml", locations)


def raiden_camera(kind: str) -> dict[str, Any]:
    """As raiden's CalibrationRunner writes a camera of 640 x 480."""
    return {
        "type": kind,
        "serial_number": 37038161,
        "intrinsics": {
            "camera_matrix": K,
            "distortion_coeffs": DISTORTION,
            "image_size": [640, 480],
            "source": "zed_sdk_factory_calibration",
        },
        "num_poses_used": 8,
    }


def write_raiden(cameras: dict[str, Any]) -> None:
    results = {"version": "1.0", "coordinate_frame": "left_arm_base", "cameras": cameras, "bimanual_transform": None}
    with Path("calibration_results.json").open("w") as file:
        json.dump(results, file, indent=2)


def test_raidens_calibration(locations: Locations) -> None:
    write_raiden({"left_wrist_camera": raiden_camera("hand_eye"), "scene_camera": raiden_camera("scene")})
    assert read("calibration_results.json:scene_camera", locations) == WANTED
    assert refusal("calibration_results.json", locations) == (
        "calibration_results.json: has 2 cameras; name one, as in calibration_results.json:left_wrist_camera; "
        "valid: left_wrist_camera, scene_camera"
    )
    assert refusal("calibration_results.json:scene_cam", locations) == (
        "calibration_results.json: has no camera 'scene_cam'; did you mean 'scene_camera'? "
        "valid: left_wrist_camera, scene_camera"
    )
    bare = {key: value for key, value in raiden_camera("scene").items() if key != "intrinsics"}
    write_raiden({"scene_camera": bare})
    message = refusal("calibration_results.json", locations)
    assert message == "calibration_results.json:5: cameras.scene_camera.intrinsics: missing; add it"
    write_raiden({"scene_camera": None})
    assert "cameras.scene_camera.intrinsics: missing" in refusal("calibration_results.json", locations)


def test_the_cameras_of_a_file(locations: Locations) -> None:
    write_raiden({"left": raiden_camera("hand_eye"), "scene_camera": raiden_camera("scene")})
    write_camchain(cam0=kalibr_camera())
    for name, parts in {
        "calibration_results.json": ["calibration_results.json:left", "calibration_results.json:scene_camera"],
        "calibration_results.json:left": ["calibration_results.json:left"],
        "camchain.yaml": ["camchain.yaml:cam0"],
    }.items():
        assert list(map(str, CameraConfig.config_paths_in_file(Path(name)))) == parts


def test_a_camera_name_for_a_single_camera_and_a_missing_file_are_refused(locations: Locations) -> None:
    write_file_storage("c.json", np.array(DISTORTION))
    assert refusal("c.json:head", locations) == "c.json: its camera has no name: leave out ':head'"
    Path("c.txt").write_text("width: 640\n")
    for name, part in {
        "none.json": "camera config file none.json does not exist",
        "none.xml:head": "camera config file none.xml does not exist",
        "c.txt": "unknown camera 'c.txt'; valid: example_640x480; the name of a file must end in .yaml or",
    }.items():
        with pytest.raises(ConfigError) as caught:
            load_config(CameraConfig, "cameras", name, locations)
        assert part in str(caught.value)


BOMB = """<?xml version="1.0"?>
<!DOCTYPE opencv_storage [
  <!ENTITY a "1 2 3 4 5 6 7 8 9">
  <!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
]>
<opencv_storage><image_width>&b;</image_width></opencv_storage>
"""
FILE_OF_OURS = """<!DOCTYPE x SYSTEM "file:///etc/passwd"><opencv_storage><a>1</a></opencv_storage>"""


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (BOMB, "c.xml:2: no document type is allowed: remove <!DOCTYPE ...>"),
        (FILE_OF_OURS, "c.xml:1: no document type is allowed"),
        ("<opencv_storage>&a;</opencv_storage>", "c.xml:1: not valid XML: undefined entity"),
        ("<opencv_storage>" + "<a>" * 60 + "</a>" * 60 + "</opencv_storage>", "nested more than 50 levels deep"),
        ("<opencv_storage><a>1</opencv_storage>", "not valid XML: mismatched tag"),
        ("", "not valid XML: no element found"),
        ('<?xml version="1.0" encoding="none"?><opencv_storage/>', "not valid XML: unknown encoding"),
        (
            "<calibration>\n</calibration>",
            "c.xml:1: <calibration> is not the root of OpenCV's XML files, <opencv_s",
        ),
        ("<opencv_storage>\n<a>1</a>\n<a>2</a></opencv_storage>", "c.xml:3: duplicate key 'a'; remove one"),
        ("<opencv_storage>1 2</opencv_storage>", "the top level must be a mapping"),
        ("<opencv_storage><width>" + "9" * 5000 + "</width></opencv_storage>", "c.xml: not valid: "),
        ("<opencv_storage>" + "<a/>" * 300_000 + "</opencv_storage>", "is too large for a config"),
    ],
    ids=range(12),
)
def test_xml_without_a_camera_or_with_an_attack_is_refused(text: str, part: str, locations: Locations) -> None:
    Path("c.xml").write_text(text)
    assert part in refusal("c.xml", locations)
