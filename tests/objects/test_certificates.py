"""Certificates on the disk, and their effect on a recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.recording.fake_episodes import Recording
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import sha256_bytes
from yamsim_cli.core.scene.assets import load_lock
from yamsim_cli.core.scene.certificates import Certificate, CertificateStatus, find_certificate, store_certificate

GOOD: dict[str, Any] = {"ok": True, "checks": [{"code": "rest.moves", "ok": True, "figures": {}, "note": ""}]}
BAD: dict[str, Any] = {"ok": False, "checks": [{"code": "rest.moves", "ok": False, "figures": {}, "note": "rolls"}]}


@pytest.fixture
def bowl(locations: Locations) -> ObjectConfig:
    return load_config(ObjectConfig, "objects", "024_bowl", locations)


def changed(item: ObjectConfig) -> ObjectConfig:
    return item.model_copy(update={"inertia": item.inertia.model_copy(update={"mass_g": 200.0})})


def test_a_certificate_is_of_one_thing_as_it_was(bowl: ObjectConfig, tmp_path: Path, locations: Locations) -> None:
    lock = load_lock(locations)
    assert find_certificate(tmp_path, bowl, lock).status is CertificateStatus.NONE
    path = store_certificate(tmp_path, bowl, lock, GOOD, {"mujoco": "4"})
    assert find_certificate(tmp_path, bowl, lock) == (stands := find_certificate(tmp_path, bowl, lock))
    assert (stands.status, stands.path) == (CertificateStatus.GOOD, path)
    assert find_certificate(tmp_path, changed(bowl), lock).status is CertificateStatus.STALE
    # The kitchen's bowl has the same name, and is another object.
    ours = load_config(ObjectConfig, "objects", "kitchen_bowl", locations)
    assert find_certificate(tmp_path, ours, lock).status is CertificateStatus.NONE
    store_certificate(tmp_path, bowl, lock, BAD, {})
    failed = find_certificate(tmp_path, bowl, lock)
    assert (failed.status, failed.failed) == (CertificateStatus.FAILED, ("rest.moves",))


def of_set(item: ObjectConfig, mesh_set: str) -> ObjectConfig:
    return item.model_copy(update={"mesh": item.mesh.model_copy(update={"set": mesh_set})})


def test_two_imports_under_one_name_have_a_certificate_each(
    bowl: ObjectConfig, tmp_path: Path, locations: Locations
) -> None:
    lock = load_lock(locations)
    first, other = (of_set(bowl, f"own-mug-{digit * 12}") for digit in "12")
    store_certificate(tmp_path, first, lock, BAD, {})
    assert find_certificate(tmp_path, other, lock).status is CertificateStatus.NONE
    store_certificate(tmp_path, other, lock, GOOD, {})
    assert find_certificate(tmp_path, first, lock).status is CertificateStatus.FAILED
    assert find_certificate(tmp_path, other, lock).status is CertificateStatus.GOOD


@pytest.mark.parametrize("mesh_set", ["ycb_objects", "own-mug-111111111111"])
def test_a_certificate_of_version_0_2_0_is_found_and_stale(
    bowl: ObjectConfig, tmp_path: Path, locations: Locations, mesh_set: str
) -> None:
    lock, item = load_lock(locations), of_set(bowl, mesh_set)
    # The file name of that version: name, set without its content hash, file.
    shared = sha256_bytes(f"{item.name} {mesh_set.removesuffix('-111111111111')} {item.mesh.file}".encode())[:8]
    old = tmp_path / "certificates" / f"{item.name}-{shared}.json"
    old.parent.mkdir()
    old.write_text(json.dumps({"inputs": "0" * 64, **BAD}))
    assert find_certificate(tmp_path, item, lock) == Certificate(CertificateStatus.STALE, ("rest.moves",), old)
    store_certificate(tmp_path, item, lock, GOOD, {})
    assert find_certificate(tmp_path, item, lock).status is CertificateStatus.GOOD


def test_a_damaged_certificate_counts_as_missing(bowl: ObjectConfig, tmp_path: Path, locations: Locations) -> None:
    lock = load_lock(locations)
    store_certificate(tmp_path, bowl, lock, GOOD, {}).write_text("{")
    assert find_certificate(tmp_path, bowl, lock).status is CertificateStatus.NONE


def recording(make_config: Callable[..., RecordConfig], tmp_path: Path, locations: Locations) -> Recording:
    made = Recording(make_config({("episodes",): 1}), tmp_path / "dataset")
    made.locations = Locations(locations.data, tmp_path / "assets")
    return made


def plate_of(job: Recording) -> ObjectConfig:
    return job.config.task.things["target"].of[0]


def test_objects_that_failed_their_certificate_are_not_recorded(
    make_config: Callable[..., RecordConfig], tmp_path: Path, locations: Locations
) -> None:
    job = recording(make_config, tmp_path, locations)
    path = store_certificate(tmp_path / "assets", plate_of(job), load_lock(locations), BAD, {})
    with pytest.raises(ResourceError, match=r"plate has failed its certificate: rest\.moves; correct it and run"):
        job.run()
    assert not job.path.exists()
    path.unlink()
    job.run()


def test_a_recording_warns_of_a_stale_certificate(
    make_config: Callable[..., RecordConfig], tmp_path: Path, locations: Locations
) -> None:
    job = recording(make_config, tmp_path, locations)
    store_certificate(tmp_path / "assets", changed(plate_of(job)), load_lock(locations), GOOD, {})
    job.run()
    assert [text for text in job.warnings if "certificate of plate" in text] != []
