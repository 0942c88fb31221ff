"""Hashes of a few recordings: `python -m tests.recorded_bytes` renews the list.

The last bits of sums depend on the processor, so each kind of processor has its own list. Renew a list only with a new
format version or model revision, and a reason in CHANGELOG.md: users' recordings must be reproducible from their seeds.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

REPOSITORY = Path(__file__).resolve().parents[1]
KEPT = Path(__file__).with_name("data") / "recorded_bytes.json"

# One episode each, of all options that affect recordings.
CASES = {
    "weld": "--seed 3",
    "contact": "--seed 3 --grasp contact --rig single_linear",
    "wrist and boards": "--seed 4 --wrist --boards",
    "truth": "--seed 5 --truth",
    "randomized": "--seed 6 --randomize",
    "left of two arms": "--seed 7 --rig bimanual --arm left",
    "hand-over": "--seed 8 --rig russet --task handover --wrist",
    "apple into bowl": "--seed 9 --object 013_apple --target 024_bowl --grasp contact --rig single_linear",
}
# Offline, since primitives stand for meshes.
COMMON = "--n 1 --workers 1 --size 96x72 --quality fast --offline --json"


def sums() -> str:
    """Hash of sums and sines whose last bits depend on the processor and its libraries, as those of recordings do."""
    values = np.random.default_rng(0).random((64, 64))
    found = [np.sin(values), np.exp(values), values @ values, np.linalg.inv(values)]
    return hashlib.sha256(b"".join(array.tobytes() for array in found)).hexdigest()


def recorded(case: str, assets: Path | None) -> dict[str, Any]:
    """Return the hashes of an episode of a case.

    Args:
        assets: folder of meshes; None for primitives.

    Returns:
        `content` (hash of the numbers), `images` and `truth` (hashes of files), and their dependencies.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "dataset"
        environ = os.environ | {"YAMSIM_ASSETS": str(assets or Path(folder) / "none"), "PYTHONPATH": str(REPOSITORY)}
        command = [sys.executable, "-m", "yamsim_cli", "record", *COMMON.split(), *CASES[case].split()]
        done = subprocess.run([*command, "--out", str(out)], env=environ, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        record = json.loads((out / "ep_000000" / "episode.json").read_text(encoding="utf-8"))
    files = record["files"]

    def together(*folders: str) -> str:
        chosen = {name: files[name] for name in sorted(files) if name.startswith(folders)}
        return hashlib.sha256(json.dumps(chosen).encode()).hexdigest() if chosen else ""

    return {
        "attempt": record["attempt"],
        "content": record["content_sha256"],
        "images": together("rgb/"),
        "truth": together("depth/", "segmentation/", "truth/"),
        "renderer": record["renderer"],
        "versions": {name: record["versions"][name] for name in ("mujoco", "mink", "daqp", "numpy", "opencv")},
    }


def kept() -> dict[str, dict[str, Any]]:
    """Return the stored list: the processor's `sums` -> case -> hashes."""
    lists: dict[str, dict[str, Any]] = json.loads(KEPT.read_text(encoding="utf-8"))
    return lists


def main() -> None:
    """Write this processor's list; those of others stay."""
    lists = kept() | {sums(): {case: recorded(case, None) for case in CASES}}
    KEPT.write_text(json.dumps(lists, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
