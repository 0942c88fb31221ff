"""Names and paths of all files in a dataset directory. No other module defines them.

<dataset>/config.yaml            the resolved configuration
attempts.jsonl         ledger: one line per attempt, successes and failures, in order
manifest.json          index of the published episodes; can be regenerated from them
provenance.json        sources of the episodes, in a dataset that `yamsim merge`, `split` or `filter` wrote
ep_000000/episode.json seed, outcome, versions, sha256 of every file
rgb/<camera>/000000.jpg
lowdim/000000.pkl
depth/<camera>/000000.npz, segmentation/<camera>/000000.png, truth/<camera>.npz, truth/labels.json
.staging/              incomplete episodes that are being written; never read
.lock                  names the process that records into the dataset; removed afterwards
.damaged/              quarantined episodes and ledgers; never read
"""

from __future__ import annotations

import re
from pathlib import Path

CONFIG_FILE = "config.yaml"
LEDGER_FILE = "attempts.jsonl"
MANIFEST_FILE = "manifest.json"
PROVENANCE_FILE = "provenance.json"
EPISODE_FILE = "episode.json"
TRUTH_LABELS_FILE = "truth/labels.json"
TRUTH_FOLDERS = ("depth/", "segmentation/", "truth/")  # folders of an episode with ground truth
STAGING_FOLDER = ".staging"
RECORDINGS_FOLDER = ".recordings"  # folder of teleoperation recordings in progress, or left by a killed session
LOCK_FILE_NAME = ".lock"
QUARANTINE_FOLDER = ".damaged"

EPISODE_FORMAT = "yamsim-episode"  # value of `format` in episode.json
DATASET_FORMAT = "yamsim-dataset"  # value of `format` in manifest.json
FORMAT_VERSION = 4  # version of what is written; `upgrade` brings records of versions 1 to 3 to this form

# Names of the temporary files that `files.writing.write_file` renames to the final files. A crash may leave them.
_PART_NAME = re.compile(
    rf"^\.({re.escape(CONFIG_FILE)}|{re.escape(LEDGER_FILE)}|{re.escape(MANIFEST_FILE)})\.[0-9a-f]{{32}}\.part$"
)
_EPISODE_NAME = re.compile(r"^ep_(\d{6,})$")


def episode_name(number: int) -> str:
    """Return the directory name of an episode."""
    return f"ep_{number:06d}"


def image_path(camera: str, frame: int) -> str:
    """Return the path of a colour image, relative to its episode."""
    return f"rgb/{camera}/{frame:06d}.jpg"


def lowdim_path(frame: int) -> str:
    """Return the path of a frame's low-dimensional data, relative to its episode."""
    return f"lowdim/{frame:06d}.pkl"


def depth_path(camera: str, frame: int) -> str:
    """Return the path of a depth image, relative to its episode."""
    return f"depth/{camera}/{frame:06d}.npz"


def segmentation_path(camera: str, frame: int) -> str:
    """Return the path of a segmentation image, relative to its episode."""
    return f"segmentation/{camera}/{frame:06d}.png"


def truth_path(camera: str) -> str:
    """Return the path of one camera's poses, keypoints and boxes, relative to its episode."""
    return f"truth/{camera}.npz"


def is_leftover(name: str) -> bool:
    """Return whether an entry of a dataset directory is left over from writing and holds no data."""
    return name in (STAGING_FOLDER, LOCK_FILE_NAME) or _PART_NAME.match(name) is not None


def episode_directories(dataset: Path) -> list[tuple[int, Path]]:
    """Return the number and directory of every published episode, in order."""
    found = [
        (int(match.group(1)), path)
        for path in dataset.iterdir()
        if (match := _EPISODE_NAME.match(path.name)) and path.is_dir()
    ]
    return sorted(found)
