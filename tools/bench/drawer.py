"""Open and shut a drawer by script with the teleoperated arm: by friction, from above.

python -m tools.bench.drawer --n 20
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.drawers import cabinet_sdf


class _Nowhere:
    """Accepts demonstrations and drops them."""

    next_attempt = 0

    def hand_in(self, demonstration: Any) -> None:
        return None


def cabinet_session(folder: Path, seed: int, locations: Any) -> Any:
    """A teleoperation session with a cabinet that faces the arm, its drawer shut."""
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.recording import RecordConfig
    from yamsim_cli.core.config.session import Session
    from yamsim_cli.objects.importing.file_import import import_with_defaults
    from yamsim_cli.viewers.teleop.teleop_scene import TeleopScene

    file = folder / "cabinet.sdf"
    file.write_text(cabinet_sdf())
    where = replace(locations, assets=folder / "assets")
    overrides = {
        ("task", "object"): "058_golf_ball",
        ("task", "target"): str(import_with_defaults(file, where).path),
        ("task", "sampling", "target_yaw_deg"): (-12, 12),
        ("task", "sampling", "x"): (0.34, 0.44),
        ("task", "sampling", "y"): (-0.2, 0.2),
        ("rig",): "single_linear",
        ("grasp",): "contact",
        ("seed",): seed,
    }
    config = load_config(RecordConfig, "record", "default", where, {k: ("--x", v) for k, v in overrides.items()})
    return TeleopScene(Session(config, where), _Nowhere())  # type: ignore[arg-type]


def steps(session: Any, seconds: float) -> None:
    for _ in range(round(seconds / session.tick_seconds)):
        session.tick()


def go(session: Any, T: np.ndarray, seconds: float) -> None:
    """Move the target to a pose in a straight line, and wait there."""
    start = session.target
    ticks = max(1, round(seconds / session.tick_seconds))
    for k in range(1, ticks + 1):
        at = T.copy()
        at[:3, 3] = start[:3, 3] + (T[:3, 3] - start[:3, 3]) * k / ticks
        session.aim(at)
        session.tick()
    steps(session, 0.4)


def open_and_shut(session: Any) -> tuple[float, float]:
    """Return the opening of the drawer after opening and after shutting it, m."""
    model, data = session.model, session.data
    steps(session, 0.5)
    joint = model.joint("cabinet_drawer")
    site = data.site("cabinet_drawer_handle_fin")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    if session.target[:3, 1] @ T[:3, 1] < 0:
        # Fingers close in either of two orientations: take the one nearer to the hand's.
        T[:3, :2] *= -1
    way = data.xmat[model.body("cabinet").id].reshape(3, 3) @ np.array([-1.0, 0, 0])
    above = T.copy()
    above[2, 3] += 0.12
    session.set_gripper(0.03)
    go(session, above, 2.0)
    go(session, T, 1.5)
    session.set_gripper(0.0)
    steps(session, 0.8)
    out = T.copy()
    out[:3, 3] += 0.09 * way
    go(session, out, 2.5)
    opened = float(data.qpos[joint.qposadr[0]])
    go(session, T, 2.5)
    return opened, float(data.qpos[joint.qposadr[0]])


def main(count: int) -> None:
    import os

    from yamsim_cli.core.files.resources import Locations

    done = []
    with tempfile.TemporaryDirectory() as scratch:
        for seed in range(count):
            session = cabinet_session(Path(scratch), seed, Locations.from_environment(os.environ))
            opened, shut = open_and_shut(session)
            done.append(opened > 0.07 and shut < 0.02)
            print(f"{seed}: open {opened * 1000:.0f} mm, then {shut * 1000:.0f} mm")
    print(f"{sum(done)} of {count}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=20)
    main(parser.parse_args().n)
