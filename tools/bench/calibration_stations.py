"""Stations with planted truth for `tools.bench.calibrate`: episodes, their faults, and what a fit should find."""

from __future__ import annotations

import io
import json
import math
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import yaml
from scipy.interpolate import CubicSpline

from yamsim_cli.calibration.chosen_frames import background_pictures, choose_pictures
from yamsim_cli.calibration.episode_pictures import EpisodePictures, TimedPictures
from yamsim_cli.camera_effects.lens_distortion import viewing_ray_grid
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.lowdim import dump_frame, load_frame
from yamsim_cli.core.files.documents.yaml_document import load_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector, rotation_z
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.images.image_files import read_image
from yamsim_cli.core.scene.cameras import wrist_camera_pose

CAMERA = "scene_camera"
ONE_ARM, TWO_ARMS, ONE_ARM_WITH_BOARD = "yam_v1+linear_4310", "bimanual", "single"
CLASSIC, FILAMENT = "classic", "filament"
LENSES = ("none", "given", "hidden")
NOISE, BLUR, JPEG = 3.0, 0.5, 85  # grey levels, px, quality
H264_CRF, H264_GOP = 23, 12  # x264's rate factor, and pictures from one whole picture to the next
MAX_OFFSET, MAX_DELAY = math.radians(1.5), 0.08  # rad, s
HARD_OFFSET, HARD_DELAY = math.radians(3.0), 0.12  # rad, s, the same for hard stations
MIXED_STREAM = 37  # with a station's seed, seeds the choice of its options
TWO_ARM_SHARE = 0.25  # of mixed stations
FOCAL_ERROR = 0.003  # standard deviation, relative
MAX_K1 = 0.08  # of a lens
# Largest errors of the fit's rig: the second base along its axes and about z, and wrist cameras likewise.
BASE_SHIFT, BASE_YAW = 0.02, 3.0  # m, degrees
WRIST_SHIFT, WRIST_TURN = 0.004, math.radians(2.0)  # m, rad
HAND_SHARE, HAND_SIZE = 0.3, 0.12  # share of pictures with a hand, and half its width over the picture's width
READOUT = 0.03  # s, from the exposure of the first row to that of the last; a 30 Hz camera takes at most 0.033 s
_NOT_RENDERED = b"no picture"  # content of a file that the fit must not read: it would end with an error
_SKIN = (142.0, 172.0, 214.0)  # BGR
QUALITY = {
    "multisamples": 0,
    "supersampling": 2,
    "shadow_map_px": 1024,
    "shadow_lights": 1,
    "reduced_meshes": False,
    "reflections": False,
    "slices": 28,
}


@dataclass(frozen=True)
class StationOptions:
    """What a station's pictures show.

    Attributes:
        size: width x height, px.
        task, episodes: of the recording.
        renderer: `CLASSIC`, or `FILAMENT` for the fixed camera's pictures.
        frames: pictures that the fit uses; Filament renders no others.
        arms: 1 or 2.
        wrist: whether wrist cameras are recorded too, with poses that differ from the rig's.
        lens: of the fixed camera, one of `LENSES`: "none" (no distortion), "given" (the camera file states it) or
            "hidden" (it does not).
        wrist_lens: whether wrist cameras have a distortion that their files lack.
        hand: whether a hand hides part of some pictures.
        h264: whether pictures were a video, instead of JPEG.
        boards: whether a fiducial board lies beside the arm's base, in pictures and rig; only with one arm.
        rolling: whether the fixed camera has a rolling shutter; only with Filament.
        hard: whether table and floor have textures, and offsets and delays are up to `HARD_OFFSET` and `HARD_DELAY`.
    """

    size: str = "320x240"
    task: str = "pickplace"
    episodes: int = 4
    renderer: str = CLASSIC
    frames: int = 40
    arms: int = 1
    wrist: bool = False
    lens: str = "none"
    wrist_lens: bool = False
    hand: bool = False
    h264: bool = False
    boards: bool = False
    rolling: bool = False
    hard: bool = False

    @classmethod
    def mixed(cls, seed: int, size: str, frames: int) -> StationOptions:
        """Return a hard station with randomly chosen renderer, lens, hand, compression and number of arms.

        Half of these stations have pictures by Filament, and a third each no, a given and a hidden distortion. Stations
        with two arms have wrist cameras.
        """
        rng = np.random.default_rng([seed, MIXED_STREAM])
        renderer = str(rng.choice([CLASSIC, FILAMENT]))
        lens, hand, h264 = str(rng.choice(LENSES)), bool(rng.random() < 0.5), bool(rng.random() < 0.5)
        two = bool(rng.random() < TWO_ARM_SHARE)
        return cls(
            size=size,
            task="handover" if two else "pickplace",
            renderer=renderer,
            frames=frames,
            arms=2 if two else 1,
            wrist=two,
            lens=lens,
            hand=hand,
            h264=h264 and renderer == CLASSIC,
            hard=True,
        )

    @property
    def rig(self) -> str:
        """Name of the rig that the fit gets."""
        if self.boards:
            return ONE_ARM_WITH_BOARD
        return TWO_ARMS if self.arms == 2 else ONE_ARM

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height, px."""
        width, height = map(int, self.size.split("x"))
        return width, height

    def folder(self, seed: int) -> str:
        """Return a name that tells stations apart."""
        given = asdict(self)
        if self.renderer == CLASSIC:
            del given["frames"]
        shown = [str(value) if not isinstance(value, bool) else key for key, value in given.items() if value]
        return "_".join([str(seed), *shown])


@dataclass(frozen=True)
class Planted:
    """The truth of a station.

    Attributes:
        T_cam_in_base: pose (4, 4) of the fixed camera in the left or only arm's base.
        offsets: joint offsets (arms x 6,), left arm first, rad.
        delay: s.
        focal: px.
        T_arm_in_base: pose (4, 4) of the right arm's base in the left one's; None with one arm.
        k1: of the distortion.
        T_wrist_in_flange: pose (4, 4) of each wrist camera on its flange.
        wrist_k1: of each wrist camera's distortion.
    """

    T_cam_in_base: Array
    offsets: Array
    delay: float
    focal: float
    T_arm_in_base: Array | None
    T_wrist_in_flange: Mapping[str, Array]
    k1: float = 0.0
    wrist_k1: Mapping[str, float] = field(default_factory=dict)

    def save(self, file: Path) -> None:
        """Write the truth as JSON."""
        values = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in vars(self).items()}
        values["T_wrist_in_flange"] = {name: T.tolist() for name, T in self.T_wrist_in_flange.items()}
        file.write_text(json.dumps(values))

    @classmethod
    def load(cls, file: Path) -> Planted:
        """Read the truth."""
        values = json.loads(file.read_text())
        second = values["T_arm_in_base"]
        return cls(
            np.array(values["T_cam_in_base"]),
            np.array(values["offsets"]),
            values["delay"],
            values["focal"],
            None if second is None else np.array(second),
            {name: np.array(T) for name, T in values["T_wrist_in_flange"].items()},
            values.get("k1", 0.0),
            values.get("wrist_k1", {}),
        )


def run_yamsim(*arguments: object, codes: tuple[int, ...] = (0,)) -> str:
    """Return what a command prints. Raise RuntimeError for another exit code."""
    return _run([sys.executable, "-m", "yamsim_cli", *map(str, arguments)], codes)


def _run(command: list[str], codes: tuple[int, ...] = (0,)) -> str:
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode not in codes:
        raise RuntimeError(f"{command}: {run.returncode}\n{run.stderr[-2000:]}")
    return run.stdout


def scene_of(rng: np.random.Generator, arms: int) -> dict[str, Any]:
    """Return a table, a floor, lights and a camera."""
    target = np.array([rng.uniform(0.2, 0.4), rng.uniform(-0.1, 0.1), rng.uniform(0.05, 0.2)])
    azimuth, elevation = rng.uniform(-math.pi, math.pi) * 0.75, math.radians(rng.uniform(20, 70))
    away = np.array([math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), 0.0])
    away[2] = math.sin(elevation)
    position = target + rng.uniform(0.8, 1.3) * away * (1.3 if arms == 2 else 1.0)

    def grey(low: float, high: float) -> list[float]:
        return [round(float(value), 3) for value in rng.uniform(low, high) + rng.uniform(-0.06, 0.06, 3)]

    lights = [
        {
            "direction": [*rng.uniform(-0.6, 0.6, 2).round(3).tolist(), -1],
            "diffuse": grey(low, high),
            "castshadow": True,
        }
        for low, high in ((0.35, 0.5), (0.1, 0.2))
    ]
    return {
        "table": {
            "position": [0.45, 0, -0.011],
            "half_size": [0.30, 0.35 if arms == 1 else 0.70, 0.01],
            "rgba": [*grey(0.2, 0.8), 1],
            "contact": {"friction": [1.0, 0.005, 0.0001], "condim": 4},
        },
        "safety_plane": -0.5,
        "floor_rgba": [grey(0.2, 0.6), grey(0.2, 0.6)],
        "sky": [[0.55, 0.65, 0.75], [0.85, 0.88, 0.90]],
        "ambient": [0.3, 0.3, 0.3],
        "lights": lights,
        "scene_camera": {
            "position": position.round(4).tolist(),
            "look_at": target.round(4).tolist(),
            "fovy_deg": round(float(rng.uniform(42, 58)), 2),
        },
    }


def _textures(locations: Locations) -> dict[str, Any]:
    """Return the table and the floor of the looks for training, without plain ones."""
    looks = load_yaml(locations.config_file("randomization", "looks")).data
    found = {surface: looks[surface] for surface in ("table", "floor")}
    for ranges in found.values():
        del ranges["textures"]["plain"]
    return found


def _write_rig(rng: np.random.Generator, file: Path, options: StationOptions, locations: Locations) -> RigConfig:
    """Write the rig of the recording, whose second base and wrist cameras are not where the fit's rig has them."""
    rig = load_config(RigConfig, "rigs", options.rig, locations)
    arms = []
    for number, arm in enumerate(rig.arms):
        camera = arm.wrist_camera
        turn = rotation_from_vector(rng.uniform(-WRIST_TURN, WRIST_TURN, 3))
        moved = {
            "position": (np.array(camera.position) + rng.uniform(-WRIST_SHIFT, WRIST_SHIFT, 3)).tolist(),
            "x_axis": (turn @ np.array(camera.x_axis)).tolist(),
            "y_axis": (turn @ np.array(camera.y_axis)).tolist(),
            "fovy_deg": camera.fovy_deg,
        }
        shift, yaw = rng.uniform(-BASE_SHIFT, BASE_SHIFT, 3), rng.uniform(-BASE_YAW, BASE_YAW)
        is_second = options.arms == 2 and number != rig.recording_order[0]
        base = {"position": shift.tolist(), "yaw_deg": float(yaw)} if is_second else {}
        named = {"name": arm.name, "side": arm.side, "prefix": arm.prefix}
        robot = {"model": arm.model.name, "gripper": arm.gripper.name}
        arms.append({**named, **robot, "base": base, "wrist_camera": moved})
    file.write_text(yaml.safe_dump({"margin": rig.margin, "arms": arms}))
    return load_config(RigConfig, "rigs", str(file.absolute()), locations)


def record_station(seed: int, folder: Path, options: StationOptions) -> Planted:
    """Record a station's episodes with planted errors into `folder`/episodes, and its camera files."""
    rng = np.random.default_rng(seed)
    locations = Locations.from_environment({})
    files = {
        "scene": scene_of(rng, options.arms),
        "quality": QUALITY,
        "randomization": {
            "lights": {"intensity": [0.8, 1.2], "tint": 0.05, "tilt_deg": 5},
            "distractors": {
                "objects": ["013_apple", "014_lemon", "025_mug"],
                "count": [0, 2],
                "x": [0.2, 0.7],
                "y": [-0.3, 0.3],
                "clearance": 0.03,
            },
            **(_textures(locations) if options.hard else {}),
        },
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content))
    config = {
        key: str((folder / f"{file}.yaml").absolute())
        for key, file in (("scene", "scene"), ("randomization", "randomization"), ("render", "quality"))
    } | {
        "task": options.task,
        "wrist": options.wrist,
        "boards": options.boards,
        "image": {"size_px": [640, 480], "jpeg_quality": 98},
    }
    (folder / "record.yaml").write_text(yaml.safe_dump(config))
    is_own_rig = options.arms == 2 or options.wrist
    if is_own_rig:
        rig = _write_rig(rng, folder / "rig.yaml", options, locations)
    else:
        rig = load_config(RigConfig, "rigs", options.rig, locations)
    run_yamsim(
        *("record", "--config", folder / "record.yaml", "--rig", folder / "rig.yaml" if is_own_rig else options.rig),
        *("--n", options.episodes, "--seed", seed, "--workers", 1),
        *("--size", options.size, "--jpeg-quality", 98, "--out", folder / "clean", "--overwrite"),
    )
    largest_offset, largest_delay = (HARD_OFFSET, HARD_DELAY) if options.hard else (MAX_OFFSET, MAX_DELAY)
    offsets = rng.uniform(-largest_offset, largest_offset, 6 * options.arms)
    delay = float(rng.uniform(0, largest_delay))
    first = load_frame(next((folder / "clean").glob("ep_*/lowdim/*.pkl")).read_bytes())
    matrices = {name: np.array(K, dtype=np.float64) for name, K in first["intrinsics"].items()}
    lenses = _write_cameras(folder, matrices, options, rng)
    spoil = _Spoiling(options, offsets, delay, {name: (matrices[name], lens) for name, lens in lenses.items()}, rng)
    spoil.write_episodes(sorted((folder / "clean").glob("ep_*")), folder)
    truth = _truth(rig, first, options, offsets, delay)
    k1 = {name: lens.distortion[0] for name, lens in lenses.items()}
    return replace(truth, k1=k1.pop(CAMERA, 0.0), wrist_k1=k1)


def _truth(rig: RigConfig, first: Mapping[str, Any], options: StationOptions, offsets: Array, delay: float) -> Planted:
    """Return the truth of the cameras in an episode's first frame.

    The offset of an arm's first joint turns the base in which its measured joints are true.
    """
    recorded = first["intrinsics"]
    own = pose(rotation=rotation_z(float(offsets[0])))
    T_cam_in_base, focal = np.asarray(first["extrinsics"][CAMERA], np.float64), float(recorded[CAMERA][0][0])
    second = None
    if options.arms == 2:
        left, right = rig.recording_order
        T = invert_pose(rig.T_base_in_world(left)) @ rig.T_base_in_world(right)
        second = own @ T @ pose(rotation=rotation_z(-float(offsets[6])))
    wrists = {name: wrist_camera_pose(arm) for arm in rig.arms if (name := arm.wrist_camera_name) in recorded}
    return Planted(own @ T_cam_in_base, offsets, delay, focal, second, wrists)


def camera_with_focal_error(K: Array, size_px: tuple[int, int], rng: np.random.Generator) -> dict[str, Any]:
    """Return the keys of a camera file whose focal length has an error; `K` (3, 3) is the true matrix."""
    guessed = K.copy()
    guessed[[0, 1], [0, 1]] *= 1 + FOCAL_ERROR * rng.standard_normal()
    return {"width": size_px[0], "height": size_px[1], "K": guessed.tolist()}


def _write_cameras(
    folder: Path, matrices: Mapping[str, Array], options: StationOptions, rng: np.random.Generator
) -> dict[str, CameraModel]:
    """Write the cameras' files, with errors of the focal lengths; return the distorted lenses by camera.

    A wrist camera sees its gripper at the border, so its lens has a focal length with which the recorded pictures
    contain its own.
    """
    lenses = {}
    for name in sorted(matrices, key=lambda one: one != CAMERA):
        camera = camera_with_focal_error(matrices[name], options.size_px, rng)
        has_distortion = options.lens != "none" if name == CAMERA else options.wrist_lens
        if has_distortion:
            k1 = float(rng.uniform(-MAX_K1, MAX_K1))
            scale = 1.0 if name == CAMERA else _focal_scale_inside(matrices[name], k1)
            lenses[name] = _lens(matrices[name], scale, k1, options.size_px)
            if name == CAMERA and options.lens == "given":
                camera["distortion"] = list(lenses[name].distortion)
            for row in (0, 1):
                camera["K"][row][row] *= scale
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(camera))
    return lenses


def _lens(K: Array, scale: float, k1: float, size_px: tuple[int, int]) -> CameraModel:
    """Return a distorted lens with `scale` times the focal lengths of a matrix (3, 3)."""
    (fx, _, cx), (_, fy, cy), last = K.tolist()
    matrix = ((scale * fx, 0.0, cx), (0.0, scale * fy, cy), tuple(last))
    return CameraModel(*size_px, matrix, (k1, -k1 / 4, 0.0, 0.0))


def _focal_scale_inside(K: Array, k1: float) -> float:
    """Return the focal length, as a factor of a matrix's (3, 3), at which a distorted picture lies in its picture."""
    r2 = float(((K[:2, 2] + 0.5) ** 2 / np.diag(K)[:2] ** 2).sum())  # of a corner
    return max(1.0, 1.0 / (1.0 + k1 * r2 - k1 / 4 * r2**2))


class _Spoiling:
    """Writes episodes with noise in the pictures, and with joints that have offsets and are later than the pictures."""

    def __init__(
        self,
        options: StationOptions,
        offsets: Array,
        delay: float,
        lenses: Mapping[str, tuple[Array, CameraModel]],
        rng: np.random.Generator,
    ) -> None:
        self._options, self._offsets, self._delay, self._lenses, self._rng = options, offsets, delay, lenses, rng

    def write_episodes(self, clean: Sequence[Path], folder: Path) -> None:
        """Write the joints and pictures of clean episodes into `folder`/episodes."""
        motions = [self._write_joints(one, folder / "episodes" / one.name) for one in clean]
        used = _used_pictures(motions, self._options)
        for one, chosen in zip(clean, used, strict=True):
            for camera in sorted((one / "rgb").iterdir()):
                pictures = sorted(camera.glob("*.jpg"))
                out = folder / "episodes" / one.name / "rgb" / camera.name
                out.mkdir(parents=True, exist_ok=True)
                if camera.name == CAMERA and self._options.renderer == FILAMENT:
                    for picture in pictures:
                        (out / picture.name).write_bytes(_NOT_RENDERED)
                    readout = READOUT if self._options.rolling else 0.0
                    pictures = _filament_pictures(one, folder / "filament" / one.name, chosen, readout)
                self._write_pictures(pictures, out)

    def _write_joints(self, clean: Path, out: Path) -> tuple[Array, Array]:
        """Write an episode's joints, and return times (n,), s, and joints (n, 7 x arms)."""
        (out / "lowdim").mkdir(parents=True, exist_ok=True)
        frames = [load_frame(file.read_bytes()) for file in sorted((clean / "lowdim").glob("*.pkl"))]
        times = np.array([frame["timestamp"] for frame in frames])
        joints = np.array([frame["joints"] for frame in frames], dtype=np.float64)
        later = CubicSpline(times, joints)(np.minimum(times + self._delay, times[-1]))
        for arm in range(self._options.arms):
            later[:, 7 * arm : 7 * arm + 6] += self._offsets[6 * arm : 6 * arm + 6]
        rounded = later.astype(np.float32)
        for k, row in enumerate(rounded):
            data = {"joints": row, "timestamp": float(times[k])}
            (out / "lowdim" / f"{k:06d}.pkl").write_bytes(dump_frame(data))
        return times, rounded.astype(np.float64)

    def _write_pictures(self, files: Sequence[Path], out: Path) -> None:
        spoilt: Iterator[Image] = (self._spoilt(read_image(file)[..., ::-1], out.name) for file in files)
        quality = JPEG
        if self._options.h264:
            spoilt, quality = _through_h264(list(spoilt)), 98
        for file, image in zip(files, spoilt, strict=True):
            cv2.imwrite(str(out / f"{file.stem}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, quality])

    def _spoilt(self, image: Image, camera: str) -> Image:
        if camera in self._lenses:
            image = _through_lens(image, *self._lenses[camera])
        if self._options.hand and self._rng.random() < HAND_SHARE:
            image = _with_hand(image, self._rng)
        soft = cv2.GaussianBlur(image, (0, 0), BLUR).astype(np.float64)
        soft += self._rng.normal(0, NOISE, soft.shape)
        return np.clip(np.round(soft), 0, 255).astype(np.uint8)


def _through_lens(image: Image, K: Array, lens: CameraModel) -> Image:
    """Return the picture of a lens (height, width, 3) in one without distortion, with the matrix `K` (3, 3)."""
    rays = viewing_ray_grid(lens, np.arange(lens.width), np.arange(lens.height))
    across, down = (rays * np.diag(K)[:2] + K[:2, 2]).astype(np.float32).transpose(2, 0, 1)
    warped = cv2.remap(image, across, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, dtype=np.uint8)


def _with_hand(image: Image, rng: np.random.Generator) -> Image:
    """Return the picture with a hand and forearm that reach in from a side, at a random place."""
    height, width = image.shape[:2]
    half = HAND_SIZE * width * rng.uniform(0.5, 1.0)
    palm = rng.uniform([0.2 * width, 0.2 * height], [0.8 * width, 0.8 * height])
    elbow = palm + 2 * width * np.array([math.cos(a := rng.uniform(0, 2 * math.pi)), math.sin(a)])
    colour = tuple(np.array(_SKIN) * rng.uniform(0.6, 1.1))
    hand = image.copy()
    cv2.line(hand, palm.astype(int).tolist(), elbow.astype(int).tolist(), colour, max(1, int(half)), cv2.LINE_AA)
    axes = (int(half), int(0.6 * half))
    cv2.ellipse(hand, palm.astype(int).tolist(), axes, math.degrees(a), 0, 360, colour, -1, cv2.LINE_AA)
    return hand


def _through_h264(images: Sequence[Image]) -> Iterator[Image]:
    """Yield BGR pictures (height, width, 3) after a video of them was written and read."""
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": str(H264_CRF), "g": str(H264_GOP)})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode(None))
    file.seek(0)
    with av.open(file, "r") as video:
        for frame in video.decode(video=0):
            yield np.asarray(frame.to_ndarray(format="bgr24"), dtype=np.uint8)


def _used_pictures(motions: Sequence[tuple[Array, Array]], options: StationOptions) -> list[list[int]]:
    """Return the numbers of the fixed camera's pictures that the fit reads, by episode."""
    sides = range(options.arms) if options.arms == 1 else (1, 0)  # the rig's first arm is the right one
    episodes = [
        EpisodePictures(
            "",
            times - times[0],
            tuple(joints[:, 7 * side : 7 * side + 6] for side in sides),
            tuple(joints[:, 7 * side + 6] for side in sides),
            {CAMERA: TimedPictures(times - times[0], lambda _: [], None)},
        )
        for times, joints in motions
    ]
    chosen = choose_pictures(episodes, CAMERA, options.frames)
    return [
        sorted({*own, *background_pictures(episode, CAMERA)}) for own, episode in zip(chosen, episodes, strict=True)
    ]


def _filament_pictures(clean: Path, out: Path, chosen: Sequence[int], readout: float) -> list[Path]:
    """Render pictures of an episode with Filament, in a program of its own, into `out`."""
    missing = [k for k in chosen if not (out / f"{k:06d}.png").is_file()]
    if missing:
        out.mkdir(parents=True, exist_ok=True)
        module = "tools.bench.filament_episode"
        command = [sys.executable, "-m", module, str(clean), str(out), CAMERA, *map(str, missing)]
        _run([*command, "--readout", str(readout)])
    return [out / f"{k:06d}.png" for k in chosen]
