from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from yamsim_cli.commands.session import randomization, record_config
from yamsim_cli.core.config.record import RecordConfig
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.resources import Locations


@pytest.mark.parametrize(
    ("flag", "own", "wanted"),
    [
        (None, {}, None),
        (None, {"mass": [1, 2]}, None),
        (True, {}, "default"),
        (True, {"mass": [1, 2]}, None),
        (False, {}, "none"),
        (False, {"mass": [1, 2]}, "none"),
    ],
)
def test_the_flag_takes_the_default_and_leaves_ones_own_ranges(
    flag: bool | None, own: dict, wanted: str | None, make_config: Callable[..., RecordConfig]
) -> None:
    assert randomization(flag, make_config({("randomization",): own})) == wanted


def test_a_file_may_name_or_spell_out_a_randomization(tmp_path: Path, locations: Locations, repository: Path) -> None:
    text = (repository / "configs/record/default.yaml").read_text()
    mine = tmp_path / "mine.yaml"
    mine.write_text(text.replace("randomization: none", "randomization: default"))
    assert "distractors" in record_config(str(mine), locations, {}).randomization.parts
    mine.write_text(text.replace("randomization: none", "randomization: {lens_deg: [-1, 1]}"))
    assert record_config(str(mine), locations, {}).randomization.parts == ("lens_deg",)


@pytest.mark.parametrize(
    ("ranges", "named"),
    [
        ("{lens: [-1, 1]}", "randomization.lens: unknown key; did you mean 'lens_deg'?"),
        ("{mass: [0, 1]}", "randomization.mass: [0, 1] is not valid: factors must be above 0"),
        ("{mass: [2, 1]}", "a range is [low, high]"),
        ("{table: {saturation: [0, 1], value: [0, 1], contrast: [0, 1], textures: {wood: 1}}}", "wood"),
        (
            "{distractors: {objects: [aple], count: [0, 1], x: [0, 1], y: [0, 1], clearance: 0.1}}",
            "randomization.distractors.objects[0]: unknown object 'aple'; did you mean '013_apple'?",
        ),
        (
            "{distractors: {objects: [plate], count: [0, 1], x: [0, 1], y: [0, 1], clearance: 0.1}}",
            "distractors and the task's objects must all differ: banana, plate, plate",
        ),
    ],
)
def test_what_is_wrong_with_ranges_is_told(
    ranges: str, named: str, tmp_path: Path, locations: Locations, repository: Path
) -> None:
    mine = tmp_path / "mine.yaml"
    text = (repository / "configs/record/default.yaml").read_text()
    mine.write_text(text.replace("randomization: none", f"randomization: {ranges}"))
    with pytest.raises(ConfigError) as caught:
        record_config(str(mine), locations, {})
    assert named in str(caught.value)
    assert str(mine) in str(caught.value)
