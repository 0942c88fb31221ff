"""A stream that does what the task asks for, as a leader arm in good hands would send it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.attempt.runner import EpisodeRunner
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.types import EpisodeJob

TICK = 0.032


def planned_lines(config: RecordConfig, locations: Locations, attempt: int, began: float = 0.0) -> list[dict[str, Any]]:
    """One recorded attempt: the joints, grippers and magnets of the scripted plan, tick by tick, at half its speed."""
    with EpisodeRunner(config, locations, {}, draw=False) as runner:
        _, outcome, rollout = runner.simulate(EpisodeJob(config.seed, attempt))
        assert outcome.success
        assert rollout
    joints = np.concatenate([state.actions.joints for state in rollout.states])
    magnet = [holds for state in rollout.states for holds in state.actions.magnet]
    settle = config.task.timing.settle_ticks
    lines: list[dict[str, Any]] = [{"t": began, "event": "start"}]
    for k, (row, holds) in enumerate(zip(joints[:-settle], magnet[:-settle], strict=True)):
        t = round(began + 2 * k * TICK, 6)
        if isinstance(holds, tuple):
            lines.append({"t": t, "joints": row.tolist()})
            lines += [{"t": t, "arm": side, "magnet": on} for side, on in zip(("left", "right"), holds, strict=True)]
        else:
            lines.append({"t": t, "joints": row[:6].tolist(), "gripper": max(0.0, float(row[6])), "magnet": holds})
    lines.append({"t": round(began + (2 * len(joints[:-settle]) + 15) * TICK, 6), "event": "stop"})
    return lines


def write_stream(file: Path, lines: list[dict[str, Any]]) -> Path:
    """The lines as a file."""
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return file
