"""The recorded names of a scene's meshes."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.meshes import box
from tests.stand_in_meshes import stand_ins
from yamsim_cli.core.config.mesh_provenance import (
    PRIMITIVES_ONLY,
    PROVENANCE_PATTERN,
    describe_remedy,
    mesh_differences,
)
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.stl import encode_stl
from yamsim_cli.core.scene.build import build_scene, with_mesh_descriptions

Make = Callable[..., RecordConfig]
ARM, GRIPPER, YCB, SMALL = "i2rt_yam_crank", "i2rt_yam_linear_4310", "ycb", "ycb_small"


@pytest.fixture
def drawn(locations: Locations) -> Callable[..., dict[str, str]]:
    def of(config: RecordConfig, meshes: dict[str, Path | None]) -> dict[str, str]:
        said = with_mesh_descriptions(Session(config, replace(locations, meshes=meshes))).config.meshes
        assert said is not None
        for text in said.values():
            assert re.fullmatch(PROVENANCE_PATTERN, text)
        return dict(said)

    return of


def test_content_decides_and_not_where_it_lies(
    config: RecordConfig, drawn: Callable[..., dict[str, str]], locations: Locations, tmp_path: Path
) -> None:
    one = drawn(config, stand_ins(tmp_path / "a", locations, ARM, YCB))
    assert one == drawn(config, stand_ins(tmp_path / "b", locations, ARM, YCB))
    other = stand_ins(tmp_path / "c", locations, ARM, YCB)
    assert other[YCB]
    (other[YCB] / "011_banana.stl").write_bytes(encode_stl(*box(0.021, cuts=1)))
    assert [text.split(":")[0] for text in mesh_differences(one, drawn(config, other))] == [YCB]


def test_files_that_are_not_used_do_not_count(
    config: RecordConfig, drawn: Callable[..., dict[str, str]], locations: Locations, tmp_path: Path
) -> None:
    """An imported object, or a new scan in a set, does not affect a dataset that does not show it."""
    meshes = stand_ins(tmp_path, locations, ARM, YCB)
    before = drawn(config, meshes)
    assert meshes[YCB]
    (meshes[YCB] / "new.stl").write_bytes(b"")
    assert drawn(config, meshes) == before


def test_reduced_meshes_are_told_apart(
    config: RecordConfig, drawn: Callable[..., dict[str, str]], locations: Locations, tmp_path: Path
) -> None:
    full = drawn(config, stand_ins(tmp_path / "full", locations, ARM))
    reduced = drawn(config, stand_ins(tmp_path / "reduced", locations, ARM, reduced=True))
    assert full[ARM].split()[1] == reduced[ARM].split()[1]
    assert reduced[ARM].startswith("reduced ")
    assert full[ARM].startswith("full ")


def test_an_arm_that_lacks_one_of_its_sets_shows_primitives(
    make_config: Make, drawn: Callable[..., dict[str, str]], locations: Locations, tmp_path: Path
) -> None:
    config = make_config({("rig",): "single_linear"})
    meshes = stand_ins(tmp_path, locations, ARM, GRIPPER, YCB)
    assert {text.split()[0] for text in drawn(config, meshes).values()} == {"full"}
    said = drawn(config, meshes | {GRIPPER: None})
    assert (said[ARM], said[GRIPPER]) == (PRIMITIVES_ONLY, PRIMITIVES_ONLY)
    assert said[YCB] != PRIMITIVES_ONLY


def test_two_arms_and_distractors_count(
    make_config: Make, drawn: Callable[..., dict[str, str]], locations: Locations, tmp_path: Path
) -> None:
    meshes = stand_ins(tmp_path, locations, ARM, YCB, SMALL)
    one = drawn(make_config(), meshes)
    two = drawn(make_config({("rig",): "bimanual", ("randomization",): "default"}), meshes)
    assert one == {name: two[name] for name in (ARM, YCB)}
    assert two[SMALL] != PRIMITIVES_ONLY
    assert drawn(make_config({("randomization",): "default"}), meshes | {SMALL: None})[SMALL] == PRIMITIVES_ONLY


def test_a_mount_of_ones_own_counts_where_it_is_seen(
    make_config: Make, drawn: Callable[..., dict[str, str]], tmp_path: Path
) -> None:
    def mounted(edge: float, boards: bool) -> dict[str, str]:
        (tmp_path / "mine.stl").write_bytes(encode_stl(*box(edge, cuts=1)))
        config = make_config({("boards",): boards})
        arm = config.rig.arms[0]
        assert arm.mount
        arm = arm.model_copy(update={"mount": arm.mount.model_copy(update={"stl": str(tmp_path / "mine.stl")})})
        return drawn(config.model_copy(update={"rig": config.rig.model_copy(update={"arms": (arm,)})}), {})

    assert mounted(20.0, boards=True)["mounts"] != mounted(21.0, boards=True)["mounts"]
    assert "mounts" not in mounted(20.0, boards=False)
    assert "mounts" not in drawn(make_config({("boards",): True}), {})


@pytest.mark.parametrize("name", [ARM, YCB])
def test_a_mesh_that_is_gone_is_one_line(config: RecordConfig, locations: Locations, tmp_path: Path, name: str) -> None:
    meshes = stand_ins(tmp_path, locations, name)
    folder = meshes[name]
    assert folder
    for file in folder.iterdir():
        file.unlink()
    with pytest.raises(ResourceError, match=r"^the mesh .*\.stl cannot be read \(No such file .*`yamsim assets fetch`"):
        build_scene(Session(config, replace(locations, meshes=meshes)))


FULL, OTHER = "full " + "0" * 64, "full " + "1" * 64


@pytest.mark.parametrize(
    ("recorded", "now", "told", "todo"),
    [
        ({"a": FULL}, {"a": PRIMITIVES_ONLY}, "a: full 000000000000 there, primitives now", "`yamsim assets fetch`"),
        (
            {"a": PRIMITIVES_ONLY},
            {"a": FULL},
            "a: primitives there, full 000000000000 now",
            "set YAMSIM_ASSETS to an empty",
        ),
        ({"a": FULL}, {"a": OTHER}, "a: full 000000000000 there, full 111111111111 now", "the meshes of the recording"),
        ({"a": FULL}, {}, "a: full 000000000000 there, not used now", "the meshes of the recording"),
    ],
)
def test_what_differs_is_named_with_what_to_do(
    recorded: dict[str, str], now: dict[str, str], told: str, todo: str
) -> None:
    assert mesh_differences(recorded | {"b": FULL}, now | {"b": FULL}) == [told]
    assert todo in describe_remedy(recorded, now)
