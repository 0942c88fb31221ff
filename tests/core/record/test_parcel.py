from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.core.attempts import planned
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.record.executors import pack, unpack, unpacked_runner
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.session import Session
from yamsim_cli.core.types import EpisodeJob


def test_what_is_unpacked_is_what_was_packed(tmp_path: Path, config: RecordConfig) -> None:
    for root, text in (("mine", "mine"), ("built_in", "theirs")):
        for name in ("arm/arm.xml", "arm/deep/part.xml"):
            (tmp_path / root / "robot_models" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / root / "robot_models" / name).write_text(text)
    (tmp_path / "mine/robot_models/arm/deep/part.xml").unlink()
    (tmp_path / "set").mkdir()
    (tmp_path / "set/link.stl").write_bytes(b"\0\xff")
    locations = Locations((tmp_path / "mine", tmp_path / "built_in", tmp_path / "nowhere"), tmp_path / "cache")

    locations = replace(locations, meshes={"set": tmp_path / "set", "missing": None})
    parcel = pickle.loads(pickle.dumps(pack(Session(config, locations))))
    unpacked = unpack(parcel, tmp_path / "there")
    assert unpacked.config == config
    there = unpacked.locations
    assert there.file("robot_models/arm/arm.xml").read_text() == "mine"
    assert there.file("robot_models/arm/deep/part.xml").read_text() == "theirs"
    assert there.meshes == {"set": tmp_path / "there/meshes/set", "missing": None}
    assert (tmp_path / "there/meshes/set/link.stl").read_bytes() == b"\0\xff"


def test_a_runner_needs_nothing_but_its_parcel(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    config = make_config({("image", "size_px"): [16, 16]})
    with unpacked_runner(pack(Session(config, locations))) as runner:
        assert planned(runner._simulators.of(EpisodeJob(0, 0)), 0).states
    assert list(tmp_path.iterdir()) == [], "something is left on the node"
