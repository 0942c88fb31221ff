"""raiden's raw recordings: `robot_data.npz`, joints of followers and what they were told, at about 100 Hz.

Source: TRI-ML/raiden 2353b10, `recorder.py`: `timestamps` in ns, `follower_l_joint_pos_7d` and `follower_l_joint_cmd`
(n, 7), six joints in rad and the gripper as a share, 0 closed to 1 open; `follower_r` likewise.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..config.rig import RigConfig
from ..errors import DatasetError
from ..geometry.se3 import Array
from ..motion import ArmMotion, Motion
from .columns import sides
from .metadata import problems_of, prompt_of
from .recording import Recording
from .times import from_nanoseconds

ROBOT_DATA = "robot_data.npz"

_FOLLOWERS = {"left": "follower_l", "right": "follower_r"}
_MOST_BYTES = 1 << 30


def read_raiden_raw(path: Path, rig: RigConfig) -> list[Recording]:
    """The recording in a `robot_data.npz`, or in the folder that holds one. Its films are not read.

    Raises:
        DatasetError: it cannot be read, is damaged, or lacks an arm of the rig.
    """
    file = path / ROBOT_DATA if path.is_dir() else path
    try:
        with np.load(file, allow_pickle=False) as data:
            if sum(entry.file_size for entry in data.zip.infolist()) > _MOST_BYTES:
                raise DatasetError(
                    f"{file}: holds more than {_MOST_BYTES / 1e9:.1f} GB; it is no recording of one task"
                )
            arrays = {name: data[name] for name in data.files if name == "timestamps" or name.startswith("follower_")}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise DatasetError(f"{file} cannot be read: {error}; was it copied whole?") from error
    if "timestamps" not in arrays:
        raise DatasetError(
            f"{file}: has no timestamps, but {', '.join(sorted(arrays)) or 'nothing'}: raiden writes them"
        )
    times = from_nanoseconds(np.asarray(arrays["timestamps"]), str(file))
    arms = []
    for side, k in zip(sides(rig), rig.recorded, strict=True):
        follower = _follower(side, arrays, file)
        rows = {
            what: _rows(arrays, f"{follower}_{what}", len(times), rig.drives, file)
            for what in ("joint_pos_7d", "joint_cmd")
        }
        velocities = arrays.get(f"{follower}_joint_vel")
        dof = rig.arms[k].robot.dof
        arms.append(
            ArmMotion(
                side,
                rows["joint_pos_7d"][:, :dof],
                rows["joint_cmd"][:, :dof],
                rows["joint_pos_7d"][:, dof],
                rows["joint_cmd"][:, dof],
                None if velocities is None else np.asarray(velocities, dtype=np.float64)[:, :dof],
            )
        )
    motion = Motion(str(file), times, tuple(arms))
    return [Recording(motion, "share", prompt=prompt_of(file.parent), problems=problems_of(file.parent))]


def _follower(side: str, arrays: dict[str, NDArray[np.generic]], file: Path) -> str:
    if side:
        return _FOLLOWERS[side]
    there = [name for name in _FOLLOWERS.values() if f"{name}_joint_pos_7d" in arrays]
    if len(there) != 1:
        raise DatasetError(f"{file}: holds {len(there)} followers, and the rig one arm; give a --rig with as many")
    return there[0]


def _rows(arrays: dict[str, NDArray[np.generic]], key: str, samples: int, drives: int, file: Path) -> Array:
    if key not in arrays:
        raise DatasetError(f"{file}: has no {key}; it holds {', '.join(sorted(arrays))}; give a --rig with its arms")
    rows = np.asarray(arrays[key], dtype=np.float64)
    if rows.shape != (samples, drives):
        raise DatasetError(f"{file}: {key} is {rows.shape}, and ({samples}, {drives}) is needed: was it cut off?")
    if not np.isfinite(rows).all():
        at = int(np.argwhere(~np.isfinite(rows))[0, 0])
        raise DatasetError(f"{file}: {key} is not finite at sample {at}; take it out")
    return rows
