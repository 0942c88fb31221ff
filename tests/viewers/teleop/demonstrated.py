"""A command stream that completes the task, as a leader arm would send it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.attempts import all_actions, planned
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations

TICK = 0.032


def planned_lines(config: RecordConfig, locations: Locations, attempt: int, began: float = 0.0) -> list[dict[str, Any]]:
    """One recorded attempt: the joints, grippers and welds of the expert, tick by tick, at half its speed."""
    with Simulator(Session(config, locations)) as simulator:
        done = planned(simulator, config.seed, attempt)
        assert done.outcome.success
    actions = all_actions(done.recorded_states)
    joints, magnet = actions.joints, actions.magnet.tolist()
    lines: list[dict[str, Any]] = [{"t": began, "event": "start"}]
    for k, (row, holds) in enumerate(zip(joints, magnet, strict=True)):
        t = round(began + 2 * k * TICK, 6)
        if len(holds) > 1:
            lines.append({"t": t, "joints": row.ravel().tolist()})
            lines += [{"t": t, "arm": side, "magnet": on} for side, on in zip(("left", "right"), holds, strict=True)]
        else:
            (*angles, opening), (on,) = row[0].tolist(), holds
            lines.append({"t": t, "joints": angles, "gripper": max(0.0, opening), "magnet": on})
    lines.append({"t": round(began + (2 * len(joints) + 15) * TICK, 6), "event": "stop"})
    return lines


def write_stream(file: Path, lines: list[dict[str, Any]]) -> Path:
    """Write the lines as a file."""
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return file
