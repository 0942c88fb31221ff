"""Names and paths of everything in a dataset's directory, which only this module defines.

<dataset>/config.yaml            the resolved configuration
attempts.jsonl         one line per attempt, successes and failures, in order
manifest.json          the published episodes; made from them, and can be made again
ep_000000/episode.json seed, outcome, versions, sha256 of every file
rgb/<camera>/000000.jpg
lowdim/000000.pkl
depth/<camera>/000000.npz, segmentation/<camera>/000000.png, truth/<camera>.npz, truth/labels.json
.staging/              episodes being written; never read
.lock                  the process that records into the dataset; removed afterwards
.damaged/              damaged episodes and ledgers that were moved away; never read
"""

from __future__ import annotations

import re
from pathlib import Path

CONFIG = "config.yaml"
ATTEMPTS = "attempts.jsonl"
MANIFEST = "manifest.json"
EPISODE = "episode.json"
TRUTH_LABELS = "truth/labels.json"
TRUTH_FOLDERS = ("depth/", "segmentation/", "truth/")
STAGING = ".staging"
RECORDINGS = ".recordings"  # current recordings of teleoperation, or those of a killed session
LOCK = ".lock"
DAMAGED = ".damaged"

EPISODE_FORMAT = "yamsim-episode"
DATASET_FORMAT = "yamsim-dataset"
FORMAT_VERSION = 1  # recordings of engine 1, with an object and a target
PROGRAM_FORMAT_VERSION = 2  # tasks with any number of things
REAL_FORMAT_VERSION = 3  # imported recordings

# Files that a crash may leave beside the final files, see `files.write_file`.
_PART_NAME = re.compile(rf"^\.({re.escape(CONFIG)}|{re.escape(ATTEMPTS)}|{re.escape(MANIFEST)})\.[0-9a-f]{{32}}\.part$")
_EPISODE_NAME = re.compile(r"^ep_(\d{6,})$")


def episode_name(number: int) -> str:
    """Directory name of an episode."""
    return f"ep_{number:06d}"


def image_name(camera: str, frame: int) -> str:
    """Path of a colour image inside its episode."""
    return f"rgb/{camera}/{frame:06d}.jpg"


def lowdim_name(frame: int) -> str:
    """Path of a frame's low-dimensional data inside its episode."""
    return f"lowdim/{frame:06d}.pkl"


def depth_name(camera: str, frame: int) -> str:
    """Path of a depth image inside its episode."""
    return f"depth/{camera}/{frame:06d}.npz"


def segmentation_name(camera: str, frame: int) -> str:
    """Path of a segmentation image inside its episode."""
    return f"segmentation/{camera}/{frame:06d}.png"


def truth_name(camera: str) -> str:
    """Path of one camera's poses, keypoints and boxes inside its episode."""
    return f"truth/{camera}.npz"


def is_leftover(name: str) -> bool:
    """Whether an entry of a dataset's directory is a remainder of writing, without data."""
    return name in (STAGING, LOCK) or _PART_NAME.match(name) is not None


def episode_directories(dataset: Path) -> list[tuple[int, Path]]:
    """Number and directory of every published episode, in order."""
    found = [
        (int(match.group(1)), path)
        for path in dataset.iterdir()
        if (match := _EPISODE_NAME.match(path.name)) and path.is_dir()
    ]
    return sorted(found)
