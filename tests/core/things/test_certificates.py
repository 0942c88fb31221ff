"""Certificates on the disk, and what a recording makes of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.core.record.fake_episodes import Recording
from yamsim_cli.core.assets import load_lock
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.things.thing import ObjectConfig
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.things.certificates import Standing, find_certificate, inputs_hash, store_certificate

GOOD: dict[str, Any] = {"ok": True, "checks": [{"code": "rest.moves", "ok": True, "figures": {}, "note": ""}]}
BAD: dict[str, Any] = {"ok": False, "checks": [{"code": "rest.moves", "ok": False, "figures": {}, "note": "rolls"}]}


@pytest.fixture
def bowl(locations: Locations) -> ObjectConfig:
    return load_config(ObjectConfig, "objects", "024_bowl", locations)


def changed(item: ObjectConfig) -> ObjectConfig:
    return item.model_copy(update={"inertia": item.inertia.model_copy(update={"mass_g": 200.0})})


def test_a_certificate_is_of_one_thing_as_it_was(bowl: ObjectConfig, tmp_path: Path, locations: Locations) -> None:
    lock = load_lock(locations)
    assert find_certificate(tmp_path, bowl, lock).standing is Standing.NONE
    path = store_certificate(tmp_path, bowl, lock, GOOD, {"mujoco": "4"})
    assert find_certificate(tmp_path, bowl, lock) == (stands := find_certificate(tmp_path, bowl, lock))
    assert (stands.standing, stands.path) == (Standing.GOOD, path)
    assert find_certificate(tmp_path, changed(bowl), lock).standing is Standing.STALE
    # The kitchen's bowl is called the same, and is another thing.
    ours = load_config(ObjectConfig, "objects", "kitchen_bowl", locations)
    assert find_certificate(tmp_path, ours, lock).standing is Standing.NONE
    store_certificate(tmp_path, bowl, lock, BAD, {})
    failed = find_certificate(tmp_path, bowl, lock)
    assert (failed.standing, failed.failed) == (Standing.FAILED, ("rest.moves",))


def test_the_hash_holds_the_meshes(bowl: ObjectConfig, locations: Locations) -> None:
    lock = load_lock(locations)
    assert inputs_hash(bowl, lock) == inputs_hash(bowl, lock)
    scan = bowl.mesh.model_copy(update={"file": "029_plate.stl"})
    assert inputs_hash(bowl.model_copy(update={"mesh": scan}), lock) != inputs_hash(bowl, lock)


def test_a_damaged_certificate_is_none(bowl: ObjectConfig, tmp_path: Path, locations: Locations) -> None:
    lock = load_lock(locations)
    store_certificate(tmp_path, bowl, lock, GOOD, {}).write_text("{")
    assert find_certificate(tmp_path, bowl, lock).standing is Standing.NONE


def recording(make_config: Callable[..., RecordConfig], tmp_path: Path, locations: Locations) -> Recording:
    made = Recording(make_config({("episodes",): 1}), tmp_path / "dataset")
    made.locations = Locations(locations.data, tmp_path / "assets")
    return made


def test_what_has_failed_is_not_recorded(
    make_config: Callable[..., RecordConfig], tmp_path: Path, locations: Locations
) -> None:
    job = recording(make_config, tmp_path, locations)
    path = store_certificate(tmp_path / "assets", job.config.task.target, load_lock(locations), BAD, {})
    with pytest.raises(ResourceError, match=r"plate has failed its certificate: rest\.moves; mend it and run"):
        job.run()
    assert not job.path.exists()
    path.unlink()
    job.run()


def test_of_what_has_changed_a_recording_warns(
    make_config: Callable[..., RecordConfig], tmp_path: Path, locations: Locations
) -> None:
    job = recording(make_config, tmp_path, locations)
    store_certificate(tmp_path / "assets", changed(job.config.task.target), load_lock(locations), GOOD, {})
    job.run()
    assert [text for text in job.warnings if "certificate of plate" in text] != []
