"""The maker's reader, its review tab's requests, and its converter to ABC: `maker_reads.py CHECKOUT EPISODES OUT`.

EPISODES has a folder of episodes for each task. OUT gets `read.npz`, with the arrays and pictures that its reader
returns, `film.mp4` of the review tab, and the folder `abc`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np


def read(episodes: list[Path], out: Path) -> None:
    from yam_abc_reproduce.data.formats import get_reader

    arrays: dict[str, Any] = {}
    for folder in episodes:
        meta, buffers = get_reader("default").read_episode(folder)
        assert len(meta.cameras) == 3
        arrays |= {f"{folder.name}/{key}": np.asarray(value) for key, value in buffers.items()}
    np.savez(out, **arrays)


def review(root: Path, out: Path) -> dict[str, Any]:
    """Return what the review tab shows of the first episode."""
    from fastapi.testclient import TestClient
    from yam_abc_reproduce.config import RobotConfig, StationConfig
    from yam_abc_reproduce.gui.server import create_app

    station = StationConfig(robot=RobotConfig(type="mock", num_arm_joints=6), cameras=[], save_root=str(root))
    with TestClient(create_app(station, mock=True)) as client:
        listed = client.get("/api/review/episodes").json()["episodes"]
        place = f"/api/review/{listed[-1]['id']}"
        film = client.get(f"{place}/video/top")
        assert film.status_code == 200, film.text
        assert film.headers["content-type"] == "video/mp4"
        out.write_bytes(film.content)
        signals = client.get(f"{place}/signals").json()
        return {"listed": listed, "meta": client.get(f"{place}/meta").json(), "signals": signals}


def main(checkout: str, episodes: str, out: str) -> None:
    sys.path.insert(0, checkout)
    from yam_abc_reproduce.cli import convert

    root, target = Path(episodes), Path(out)
    (task,) = root.iterdir()
    read(sorted(folder for folder in task.iterdir() if (folder / "write_complete.flag").exists()), target / "read.npz")
    shown = review(root, target / "film.mp4")
    convert([str(task), "--to", "abc", "--repo-id", "x", "--out", str(target / "abc")])
    print(json.dumps(shown))


if __name__ == "__main__":
    main(*sys.argv[1:])
