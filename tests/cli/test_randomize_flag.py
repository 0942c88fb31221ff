from __future__ import annotations

from pathlib import Path

import pytest

from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.flags.session_options import session_opener

MINE = "{lens_deg: [-1, 1]}"


def write_config(path: Path, repository: Path, randomization: str) -> Path:
    text = (repository / "configs/record/default.yaml").read_text()
    assert "randomization: none" in text
    path.write_text(text.replace("randomization: none", f"randomization: {randomization}"))
    return path


@pytest.mark.parametrize(
    ("flag", "own", "wanted"),
    [
        (None, "none", "none"),
        (None, MINE, "lens_deg"),
        (True, "none", "default"),
        (True, MINE, "lens_deg"),
        (False, "none", "none"),
        (False, MINE, "none"),
    ],
)
def test_the_flag_takes_the_default_and_leaves_ones_own_ranges(
    flag: bool | None, own: str, wanted: str, tmp_path: Path, locations: Locations, repository: Path
) -> None:
    mine = write_config(tmp_path / "mine.yaml", repository, own)
    parts = session_opener.load_record_config(str(mine), locations, randomize=flag).randomization.varied_parts
    if wanted == "default":
        assert len(parts) > 5
    else:
        assert parts == (() if wanted == "none" else (wanted,))


def test_ranges_are_named_by_a_flag_that_says_more_than_the_other(locations: Locations) -> None:
    for randomize in (None, True):
        found = session_opener.load_record_config("default", locations, randomize=randomize, randomization="arms")
        assert found.randomization.varied_parts == ("arm_dynamics",)
    with pytest.raises(UsageError, match="--randomization and --no-randomize contradict each other"):
        session_opener.load_record_config("default", locations, randomize=False, randomization="arms")
    with pytest.raises(ConfigError, match="unknown randomization 'arm'; did you mean 'arms'"):
        session_opener.load_record_config("default", locations, randomization="arm")


def test_a_file_may_name_or_spell_out_a_randomization(tmp_path: Path, locations: Locations, repository: Path) -> None:
    mine = write_config(tmp_path / "mine.yaml", repository, "default")
    assert "distractors" in session_opener.load_record_config(str(mine), locations).randomization.varied_parts
    write_config(mine, repository, MINE)
    assert session_opener.load_record_config(str(mine), locations).randomization.varied_parts == ("lens_deg",)


@pytest.mark.parametrize(
    ("ranges", "named"),
    [
        ("{lens: [-1, 1]}", "randomization.lens: unknown key; did you mean 'lens_deg'?"),
        ("{mass: [0, 1]}", "randomization.mass: [0, 1] is not valid: factors must be above 0"),
        ("{mass: [2, 1]}", "a range is [low, high]"),
        ("{table: {saturation: [0, 1], value: [0, 1], contrast: [0, 1], textures: {wod: 1}}}", "wod"),
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
    mine = write_config(tmp_path / "mine.yaml", repository, ranges)
    with pytest.raises(ConfigError) as caught:
        session_opener.load_record_config(str(mine), locations)
    assert named in str(caught.value)
    assert str(mine) in str(caught.value)
