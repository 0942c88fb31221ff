"""Writes a checkpoint of LeRobot that plays the expert's first trials of a task. OUT TRIALS TASK ACTION FPS RIG"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.processor import (
    AddBatchDimensionProcessorStep,
    DeviceProcessorStep,
    PolicyAction,
    PolicyProcessorPipeline,
    RenameObservationsProcessorStep,
)
from lerobot_policy_played import PlayedConfig, PlayedPolicy

from yamsim_cli.station import Station, StationSettings


def main(out: Path, trials: int, task: str, action: str, fps: float, rig: str) -> None:
    grasp = "contact" if action == "joints" else None
    settings = StationSettings(task=task, rig=rig, action=action, fps=fps, grasp=grasp)
    with Station(settings, pictures=False) as station:
        played, numbers = [], []
        while len(played) < trials:
            played.append(station.begin_demonstrated(trial=len(played)))
            numbers.append(station.trial)
        form = station.form
    frames = max(map(len, played))
    config = PlayedConfig(trials=trials, frames=frames, numbers=len(form.action), device="cpu")
    config.input_features = {"observation.state": PolicyFeature(FeatureType.STATE, (len(form.state),))}
    config.output_features = {"action": PolicyFeature(FeatureType.ACTION, (len(form.action),))}
    policy = PlayedPolicy(config)
    for number, rows in enumerate(played):
        policy.rows[number] = torch.from_numpy(np.pad(rows, ((0, frames - len(rows)), (0, 0)), mode="edge"))
    policy.save_pretrained(out)
    steps = [
        RenameObservationsProcessorStep(rename_map={}),
        AddBatchDimensionProcessorStep(),
        DeviceProcessorStep(device="cpu"),
    ]
    PolicyProcessorPipeline(steps, name="policy_preprocessor").save_pretrained(out)
    after = PolicyProcessorPipeline[PolicyAction, PolicyAction]([DeviceProcessorStep(device="cpu")])
    after.name = "policy_postprocessor"
    after.save_pretrained(out)
    print(json.dumps({"trials": numbers}))


if __name__ == "__main__":
    out, trials, task, action, fps, rig = sys.argv[1:]
    main(Path(out), int(trials), task, action, float(fps), rig)
