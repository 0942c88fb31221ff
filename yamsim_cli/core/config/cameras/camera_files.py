"""Reads camera files of yamsim and other programs, and converts them to the keys `K`, `distortion`, `width`, `height`.

Files of one camera: yamsim's, OpenCV's FileStorage (YAML, JSON, XML), and ROS's camera_info. Files of several named
cameras: Kalibr's camchain and raiden's calibration_results.json.

Sources: Kalibr, kalibr_common/ConfigReader.py; raiden, raiden/calibration/runner.py; `ros2 topic echo`,
rosidl_runtime_py/convert.py.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from ...errors import ConfigError, suggest_similar
from ...files.documents.yaml_document import Document, KeyPath, load_yaml, read_config_bytes
from ...files.resources import split_camera_path
from .file_storage import parse_json, parse_xml

# Key of yamsim -> keys of other calibration programs.
_ALIASES = {
    "K": ("camera_matrix", "cameraMatrix", "Camera_Matrix", "mtx", "k"),
    "distortion": (
        "distortion_coefficients",
        "Distortion_Coefficients",
        "distCoeffs",
        "dist_coeffs",
        "dist_coeff",
        "distortion_coeffs",
        "dist",
        "D",
        "d",
    ),
    "width": ("image_width", "image_Width", "imageWidth"),
    "height": ("image_height", "image_Height", "imageHeight"),
}
CameraKeyPath = tuple[str, ...]  # key path of a camera in its file

_FOCAL_SIGMA_KEY = "focal_sigma"

# Names of OpenCV's lens and camera models in other programs.
_ROS_MODELS = ("plumb_bob", "rational_polynomial")
_KALIBR_LENSES = ("radtan", "none")
_KALIBR_MODELS = ("pinhole",)


def read_camera(path: Path) -> Document:
    """Return one camera of a file under yamsim's keys.

    Args:
        path: the file, or `FILE:CAMERA` for a file with several cameras.

    Raises:
        ConfigError: the file is unreadable, or does not have the format of its suffix. Or the camera is missing, `path`
            names none of several cameras, or the camera's model is not OpenCV's pinhole.
    """
    file, name, document = _open_camera_document(path)
    named = _camera_key_paths(document)
    if not named:
        if name:
            raise ConfigError(f"{file}: its camera has no name: leave out {':' + name!r}")
        return _single_camera(document)
    if not name and len(named) > 1:
        example = f"{file}:{min(named)}"
        raise ConfigError(f"{file}: has {len(named)} cameras; name one, as in {example}; {suggest_similar('', named)}")
    name = name or next(iter(named))
    if name not in named:
        raise ConfigError(f"{file}: has no camera {name!r}; {suggest_similar(name, named)}")
    return _convert_kalibr(document, named[name]) if len(named[name]) == 1 else _convert_raiden(document, named[name])


def cameras_in_file(path: Path) -> tuple[Path, ...]:
    """Return `FILE:CAMERA` for each named camera; the path itself if it names a camera or the file has no names.

    Raises ConfigError if the file is unreadable, or does not have the format of its suffix.
    """
    file, name, document = _open_camera_document(path)
    named = _camera_key_paths(document)
    return (path,) if name or not named else tuple(Path(f"{file}:{each}") for each in named)


def _open_camera_document(path: Path) -> tuple[Path, str, Document]:
    file, name = split_camera_path(str(path)) or (path, "")
    parse = {".json": parse_json, ".xml": parse_xml}.get(file.suffix)
    return file, name, parse(read_config_bytes(file), str(file)) if parse else load_yaml(file)


def _camera_key_paths(document: Document) -> dict[str, CameraKeyPath]:
    """Return the name of each camera in a file of Kalibr or raiden -> its key path; empty for other files."""
    data = document.data
    if isinstance(cameras := data.get("cameras"), dict) and cameras:
        return {name: ("cameras", name) for name in cameras}
    return {name: (name,) for name, value in data.items() if re.fullmatch(r"cam\d+", name) and isinstance(value, dict)}


class _CameraConverter:
    """Collects a camera's values under yamsim's keys, each with its line in the file."""

    def __init__(self, document: Document, at: CameraKeyPath) -> None:
        self._document, self._at = document, at
        self._values: Any = document.data
        for key in at:
            self._values = self._values[key]
        self._ours: dict[str, Any] = {}
        self._places: dict[KeyPath, str] = {(): document.place_of(at)}

    def has(self, key: str) -> bool:
        return isinstance(self._values, dict) and key in self._values

    def get(self, key: str, count: int = 0) -> Any:
        """Return the value of a required key; raise ConfigError if it is missing, or no list of `count` items."""
        if not self.has(key):
            raise ConfigError(f"{self._document.place_of(self._at)}: {'.'.join((*self._at, key))}: missing; add it")
        value = self._values[key]
        if count and (not isinstance(value, list) or len(value) != count):
            self.refuse(key, f"must be {count} numbers")
        return value

    def put(self, ours: str, theirs: str, value: Any) -> None:
        self._ours[ours] = value
        self._places[(ours,)] = self._document.place_of((*self._at, theirs))

    def expect(self, key: str, value: str, valid: tuple[str, ...]) -> None:
        """Refuse a camera or lens model that is not OpenCV's."""
        if value not in valid:
            self.refuse(
                key, f"calibrate with one of OpenCV's pinhole models; {suggest_similar(str(value), valid)}", value
            )

    def refuse(self, key: str, why: str, value: Any = None) -> None:
        place, path = self._document.place_of((*self._at, key)), ".".join((*self._at, key))
        raise ConfigError(f"{place}: {path}: {self._values.get(key) if value is None else value!r} is not valid: {why}")

    def document(self) -> Document:
        """Return the collected values, with the focal length's uncertainty if the file has one."""
        if self.has(_FOCAL_SIGMA_KEY):
            self.put(_FOCAL_SIGMA_KEY, _FOCAL_SIGMA_KEY, self._values[_FOCAL_SIGMA_KEY])
        return Document(self._ours, self._document.source, self._places)


def _single_camera(document: Document) -> Document:
    """Return the camera of a file without camera names; a file with yamsim's keys is returned unchanged."""
    data = document.data
    if not any(alias in data for names in _ALIASES.values() for alias in names):
        return document
    camera = _CameraConverter(document, ())
    # `fisheye_model` is a key of OpenCV's calibration program.
    model = "fisheye" if data.get("fisheye_model") else data.get("distortion_model", _ROS_MODELS[0])
    camera.expect("distortion_model", model, _ROS_MODELS)
    for key, aliases in _ALIASES.items():
        for alias in (key, *aliases):
            if camera.has(alias):
                value = _matrix_data(data[alias])
                camera.put(key, alias, _coefficient_list(value) if key == "distortion" else value)
                break
    return camera.document()


def _convert_kalibr(document: Document, at: CameraKeyPath) -> Document:
    camera = _CameraConverter(document, at)
    camera.expect("camera_model", camera.get("camera_model"), _KALIBR_MODELS)
    lens = camera.get("distortion_model")
    camera.expect("distortion_model", lens, _KALIBR_LENSES)
    fu, fv, pu, pv = camera.get("intrinsics", 4)
    camera.put("K", "intrinsics", [[fu, 0.0, pu], [0.0, fv, pv], [0.0, 0.0, 1.0]])
    coefficients = camera.get("distortion_coeffs")
    if lens == "none":
        if any(coefficients or ()):
            camera.refuse("distortion_coeffs", "the distortion_model is 'none'; remove the coefficients or give radtan")
        coefficients = [0.0] * 4  # without coefficients, yamsim would count the distortion as unknown
    camera.put("distortion", "distortion_coeffs", coefficients)
    _put_size(camera, "resolution")
    return camera.document()


def _convert_raiden(document: Document, at: CameraKeyPath) -> Document:
    _CameraConverter(document, at).get("intrinsics")
    camera = _CameraConverter(document, (*at, "intrinsics"))
    camera.put("K", "camera_matrix", camera.get("camera_matrix"))
    camera.put("distortion", "distortion_coeffs", _coefficient_list(camera.get("distortion_coeffs")))
    _put_size(camera, "image_size")
    return camera.document()


def _put_size(camera: _CameraConverter, key: str) -> None:
    width, height = camera.get(key, 2)
    camera.put("width", key, width)
    camera.put("height", key, height)


def _matrix_data(value: Any) -> Any:
    return value["data"] if isinstance(value, dict) and "data" in value else value


def _coefficient_list(value: Any) -> Any:
    if isinstance(value, list) and all(isinstance(part, list) for part in value):
        return [number for part in value for number in part]
    return value
