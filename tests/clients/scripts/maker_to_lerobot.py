"""The maker's converter to LeRobot: `maker_to_lerobot.py CHECKOUT EPISODES_OF_A_TASK OUT`."""

from __future__ import annotations

import json
import sys
from pathlib import Path


def main(checkout: str, episodes: str, out: str) -> None:
    sys.path.insert(0, checkout)
    from yam_abc_reproduce.cli import convert

    convert([episodes, "--to", "lerobot", "--repo-id", "maker/test", "--out", out])
    print(json.dumps(json.loads((Path(out) / "meta/info.json").read_text())))


if __name__ == "__main__":
    main(*sys.argv[1:])
