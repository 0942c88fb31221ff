import json

import pytest

from tests.core.dataset.making import FAILURE, SUCCESS, failed_attempt, made
from yamsim_cli.core.attempt_data import (
    Attempt,
    AttemptJob,
    AttemptPayload,
    FailureCause,
    MotionMargins,
    ObjectLayout,
    Outcome,
)
from yamsim_cli.core.dataset.dataset_paths import episode_directories
from yamsim_cli.core.dataset.records import (
    AttemptRecord,
    EpisodeRecord,
    Manifest,
    ManifestEntry,
    attempt_record,
    file_hashes,
    from_json,
    record_data,
    to_json,
)
from yamsim_cli.core.errors import DatasetError

MANIFEST = Manifest(
    task="pickplace",
    seed=7,
    attempts=1,
    frames=4,
    bytes=10,
    episodes=[ManifestEntry(episode=0, path="ep_000000", attempt=0, frames=4, bytes=10, sha256="x")],
)
RECORDS = [made(3).record, made(3).attempt, failed_attempt(5), MANIFEST]


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
@pytest.mark.parametrize("indent", [None, 1])
def test_a_record_reads_back_as_it_was_written(record, indent):
    text = to_json(record, indent=indent)
    assert text.endswith(b"\n")
    assert from_json(type(record), text, "x") == record
    assert json.loads(text) == record_data(record)
    assert to_json(from_json(type(record), text, "x"), indent=indent) == text


def test_without_indent_a_record_is_one_line():
    attempt = failed_attempt(5).model_copy(update={"outcome": FAILURE.model_copy(update={"detail": "two\nlines ü"})})
    assert to_json(attempt).count(b"\n") == 1


def test_keys_of_a_later_version_are_kept_out_of_the_way():
    data = record_data(made(3).record) | {"added_later": 1}
    assert from_json(EpisodeRecord, json.dumps(data), "x") == made(3).record


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "lerobot"}, "episode.json: format: String should match pattern '^yamsim-episode$'"),
        ({"frames": "many"}, "episode.json: frames: Input should be a valid integer"),
        ({"cameras": {"c": [1]}}, "episode.json: cameras.c.1: Field required"),
        ({"outcome": None}, "episode.json: outcome: Input should be"),
    ],
)
def test_the_first_fault_of_a_record_is_named(change, message):
    with pytest.raises(DatasetError) as caught:
        from_json(EpisodeRecord, json.dumps(record_data(made(3).record) | change), "episode.json")
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", ["episode", "attempt", "seed", "files", "content_sha256", "outcome", "cameras"])
def test_a_missing_key_is_named(key):
    data = record_data(made(3).record)
    del data[key]
    with pytest.raises(DatasetError, match=f"^here: {key}: Field required"):
        from_json(EpisodeRecord, json.dumps(data), "here")


@pytest.mark.parametrize(
    "text", [b"", b"{", b"null", b"[]", b"\xff\xfe", b"{}{}", '{"a": "\ud800"}'.encode("utf8", "ignore")]
)
def test_an_invalid_record_is_a_dataset_error(text):
    with pytest.raises(DatasetError, match=r"^here: "):
        from_json(AttemptRecord, text, "here")


def test_an_attempt_is_written_down_with_its_outcome():
    payload = AttemptPayload(
        Attempt(
            AttemptJob(seed=7, attempt=4), ObjectLayout.from_places({"banana": (1.0, 2.0, 3.0, 0.6, 0.0, 0.0, 0.8)})
        ),
        outcome=Outcome(
            False,
            FailureCause.DROPPED,
            "at 1.2 s",
            dxy=0.2,
            dz=-0.01,
            speed=0.3,
            margins=MotionMargins(velocity=0.5, torque=0.4, joint=0.2, slip=0.001, tilt=0.01),
        ),
    )
    record = attempt_record(payload, None)
    assert record_data(record) == {
        "attempt": 4,
        "seed": 7,
        "episode": None,
        "outcome": {
            "success": False,
            "cause": "dropped",
            "detail": "at 1.2 s",
            "dxy_m": 0.2,
            "dz_m": -0.01,
            "speed_mps": 0.3,
            "plan_error_m": None,
            "tilt_rad": None,
            "margins": {
                "velocity_share": 0.5,
                "torque_share": 0.4,
                "joint_rad": 0.2,
                "slip_m": 0.001,
                "object_tilt_rad": 0.01,
            },
            "measures": [],
            "recoveries": [],
        },
        "layout": {"banana": pytest.approx([1.0, 2.0, 3.0, 0.6, 0.0, 0.0, 0.8])},
        "randomized": record_data(failed_attempt(5))["randomized"],
        "cast": None,
        "phrasing": "",
    }
    assert from_json(AttemptRecord, to_json(record), "x") == record
    assert attempt_record(payload, 2).episode == 2


@pytest.mark.parametrize(
    ("change", "within"),
    [
        ({}, True),
        ({"dxy_m": 0.05}, True),
        ({"dxy_m": 0.0500001}, False),
        ({"dz_m": 0.1}, True),
        ({"dz_m": 0.11}, False),
        ({"dz_m": 0.0}, True),
        ({"dz_m": -0.001}, False),
        ({"cause": "unstable"}, False),
        # Thrown onto the plate is not placed.
        ({"cause": "dropped"}, False),
        ({"cause": "slipped"}, False),
        ({"cause": "collided"}, False),
        ({"cause": "limits"}, False),
        ({"cause": "off_target", "success": False}, True),
        ({"dxy_m": None}, False),
        ({"dz_m": None}, False),
    ],
)
def test_an_outcome_can_be_scored_by_another_threshold(change, within):
    assert SUCCESS.model_copy(update=change).is_within(0.05, max_height=0.1) is within


def test_hashes_come_in_the_order_of_paths():
    hashes = file_hashes({"b": b"2", "a": b"1"})
    assert list(hashes) == ["a", "b"]
    # Source: sha256sum of the one character.
    assert hashes["a"] == "6b86b273ff34fce19d6b804eff5a3f5747ada4eaa22f1d49c01e52ddb7875b4b"


def test_only_published_episodes_are_found_in_order(tmp_path):
    for name in ("ep_000010", "ep_000002", "ep_1234567", ".staging/ep_000003", "ep_12", "ep_00000x", "old_ep_000004"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "ep_000005").write_text("a file")
    assert [(number, path.name) for number, path in episode_directories(tmp_path)] == [
        (2, "ep_000002"),
        (10, "ep_000010"),
        (1234567, "ep_1234567"),
    ]
