"""Programs whose steps contradict their goal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.programs import STATION, changed, session_of
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.program_checks import program_contradiction

PICK = {"pick": {"thing": "cube"}}
GIVE = {"handover": {"thing": "cube"}}
PLACE = {"place": {"thing": "cube", "on": "plate"}}
ASIDE = {"place": {"thing": "cube", "on": "table", "at": [0.3, 0]}}
ON = {"on": {"thing": "cube", "surface": "plate"}}


@pytest.mark.parametrize(
    ("goal", "steps", "said"),
    [
        (ON, [PICK, PLACE], None),
        ({"all": [ON, {"was_handed_over": {"thing": "cube"}}]}, [PICK, GIVE, PLACE], None),
        ({"any": [ON, {"handed_over": {"thing": "cube"}}]}, [PICK, PLACE], None),
        ({"handed_over": {"thing": "cube"}}, [PICK, GIVE, PLACE], "needs the cube in a hand at the end"),
        ({"was_handed_over": {"thing": "cube"}}, [PICK, PLACE], "no step of the expert hands over the cube"),
        (ON, [PICK, GIVE], "still holds it at the end"),
        ({"on": {"thing": "plate", "surface": "cube"}}, [PICK, ASIDE],
         "no step of the expert moves the plate onto the cube"),
    ],
)  # fmt: skip
def test_a_contradiction_is_named(
    goal: dict[str, Any], steps: list[Any], said: str | None, tmp_path: Path, locations: Locations
) -> None:
    session = session_of(tmp_path, changed({("rig",): STATION, ("goal",): goal, ("expert",): steps}))
    found = program_contradiction(session.config.task)
    assert (found is None) if said is None else (found is not None and said in found), found
