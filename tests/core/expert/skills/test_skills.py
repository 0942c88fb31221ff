"""Every skill achieves its purpose in a task of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.programs import ONTO_PLATE, STATION, changed, first_attempt, session_of
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.expert.skills.program import SKILLS

CUBE = {"of": "cube_red"}
HERE = {"x": [0.34, 0.36], "y": [-0.12, -0.10], "yaw_deg": [-10, 10]}
PICK = {"pick": {"thing": "cube"}}


def _task(expert: list[dict[str, Any]], goal: dict[str, Any], **parts: Any) -> dict[str, Any]:
    """A task with a cube before two arms, and optional further objects."""
    things, starts = {"cube": CUBE, **parts.get("things", {})}, {"cube": HERE, **parts.get("starts", {})}
    return changed(
        {
            ("rig",): STATION,
            ("things",): {name: one for name, one in things.items() if one},
            ("starts",): {name: one for name, one in starts.items() if one},
            ("goal",): goal,
            ("expert",): expert,
        }
    )


BIN = {"bin": {"of": "bin"}}
BIN_HERE = {"bin": {"x": [0.40, 0.40], "y": [0.10, 0.10], "yaw_deg": [90, 90]}}
TRAY = {"cube": None, "tray": {"of": "serving_tray"}}
TRAY_HERE = {"cube": None, "tray": {"x": [0.36, 0.38], "y": [-0.01, 0.01], "yaw_deg": [-3, 3]}}
CUP = {"cube": None, "cup": {"of": "kitchen_cup"}}
CUP_HERE = {"cube": None, "cup": {"x": [0.34, 0.36], "y": [-0.1, -0.05], "attitudes": ["lying"]}}
CAN = {"cube": None, "can": {"of": "007_tuna_fish_can"}}
CAN_HERE = {"cube": None, "can": {"x": [0.33, 0.35], "y": [-0.12, -0.10]}}
CUP_AWAY = {"cube": None, "cup": {"x": [0.36, 0.36], "y": [0.0, 0.0], "yaw_deg": [0, 0], "attitudes": ["lying"]}}
HUNG = {"cube": None, "mug": {"of": "large_mug"}, "stand": {"of": "peg_stand"}}
HUNG_HERE = {
    "cube": None,
    "stand": {"x": [0.48, 0.48], "y": [0.0, 0.0], "yaw_deg": [0, 0]},
    "mug": {"x": [0.29, 0.30], "y": [-0.15, -0.14], "yaw_deg": [-90, -80]},
}
CABINET = {"cube": None, "cabinet": {"of": "drawer_cabinet"}}
CABINET_HERE = {"cube": None, "cabinet": {"x": [0.52, 0.53], "y": [-0.01, 0.01], "yaw_deg": [-3, 3]}}

# Skill -> task that needs it.
TASKS: dict[str, dict[str, Any]] = {
    "pick": _task(
        [PICK], {"all": [{"held_by": {"thing": "cube"}}, {"above": {"thing": "cube", "other": "table", "by": 0.03}}]}
    ),
    "place": ONTO_PLATE,
    "insert": _task(
        [PICK, {"insert": {"thing": "cube", "into": "bin"}}],
        {"in": {"thing": "cube", "container": "bin"}},
        things=BIN,
        starts=BIN_HERE,
    ),
    "handover": _task([PICK, {"handover": {"thing": "cube"}}], {"handed_over": {"thing": "cube"}}),
    "put_aside": _task(
        [PICK, {"put_aside": {"thing": "cube"}}],
        {
            "all": [
                {"on": {"thing": "cube", "surface": "table"}},
                {"near": {"thing": "cube", "place": [0.34, 0.05], "radius": 0.12}},
            ]
        },
    ),
    "push": _task(
        [{"push": {"thing": "can", "to": [0.42, 0.0]}}],
        {"near": {"thing": "can", "place": [0.42, 0.0], "radius": 0.02}},
        things=CAN,
        starts=CAN_HERE,
    ),
    "operate": _task(
        [{"operate": {"thing": "cabinet", "joint": "drawer", "to": 1}}],
        {"open": {"thing": "cabinet", "joint": "drawer", "share": 0.85}},
        things=CABINET,
        starts=CABINET_HERE,
    ),
    "set_upright": _task(
        [{"pick": {"thing": "cup"}}, {"set_upright": {"thing": "cup"}}],
        {"all": [{"upright": {"thing": "cup", "tilt_deg": 5}}, {"on": {"thing": "cup", "surface": "table"}}]},
        things=CUP,
        starts=CUP_HERE,
    ),
    # Its foot is nearer to the arms at the start than at the end.
    "turn": _task(
        [{"pick": {"thing": "cup"}}, {"turn": {"thing": "cup"}}],
        {
            "all": [
                {"near": {"thing": "cup", "place": [0.38, 0.04], "radius": 0.04}},
                {"not": {"upright": {"thing": "cup"}}},
            ]
        },
        things={"cube": None, "cup": {"of": "kitchen_measuring_cup"}},
        starts=CUP_AWAY,
    ),
    "hang": _task(
        [{"pick": {"thing": "mug"}}, {"hang": {"thing": "mug", "onto": "stand"}}],
        {"hung": {"thing": "mug", "onto": "stand"}},
        things=HUNG,
        starts=HUNG_HERE,
    ),
    "regrasp": _task(
        [PICK, {"regrasp": {"thing": "cube"}}],
        {"all": [{"held_by": {"thing": "cube"}}, {"near": {"thing": "cube", "place": [0.34, 0.05], "radius": 0.12}}]},
    ),
    "lift": _task(
        [{"lift": {"thing": "tray"}}],
        {
            "all": [
                {"held_by": {"thing": "tray", "arm": "both"}},
                {"above": {"thing": "tray", "other": "table", "by": 0.06}},
            ]
        },
        things=TRAY,
        starts=TRAY_HERE,
    ),
    "fold": {
        **_task(
            [{"fold": {"thing": "napkin"}}],
            {"folded": {"thing": "napkin"}},
            things={"cube": None, "napkin": {"of": "soft_napkin"}},
            starts={"cube": None, "napkin": {"x": [0.35, 0.37], "y": [-0.01, 0.01], "yaw_deg": [-5, 5]}},
        ),
        "timing": {"timestep": 0.004, "physics_steps_per_tick": 8},
    },
    "flatten": {
        **_task(
            [{"flatten": {"thing": "napkin"}}],
            {"spread": {"thing": "napkin"}},
            things={"cube": None, "napkin": {"of": "soft_napkin"}},
            starts={"cube": None, "napkin": {"x": [0.35, 0.37], "y": [-0.01, 0.01], "crumpled": [0.15, 0.15]}},
        ),
        "timing": {"timestep": 0.004, "physics_steps_per_tick": 8},
    },
}

# Slower than two seconds.
SLOW = ("set_upright", "turn", "fold", "flatten")


@pytest.mark.parametrize(
    "skill", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in TASKS]
)
def test_a_skill_does_what_it_is_for(skill: str, tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, TASKS[skill])) as simulators:
        simulator, attempt = first_attempt(simulators)
        outcome = simulate_expert(simulator, attempt).outcome
    assert outcome.success, (outcome.cause, outcome.detail, outcome.recoveries)
    assert outcome.margins is not None and outcome.margins.velocity < 1 and outcome.margins.torque < 1


def test_no_skill_is_forgotten() -> None:
    assert set(TASKS) == set(SKILLS)
