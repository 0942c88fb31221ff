import builtins
import json
import math
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.core.dataset.making import CAMERA, FAILURE, FRAMES, SUCCESS, failed_attempt, frame, jpeg, made, publish
from tests.core.dataset.test_writer import resume, tree
from yamsim_cli.core.dataset.check import check_episode
from yamsim_cli.core.dataset.lowdim import dump_frame
from yamsim_cli.core.dataset.records import to_json
from yamsim_cli.core.dataset.statistics import wilson95
from yamsim_cli.core.dataset.summary import summarize
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files import sha256_bytes
from yamsim_cli.core.vision.jpeg import decode_jpeg

IMAGE = f"rgb/{CAMERA}/000002.jpg"
PICKLE = "lowdim/000002.pkl"


def summary(dataset: Path, thresholds=(0.05, 0.08)) -> dict:
    report = summarize(dataset, thresholds, decode_jpeg, lambda done, total: None)
    json.dumps(report, allow_nan=False)
    return report


def problems(dataset: Path) -> list[tuple[str, str, str]]:
    return [(p["episode"], p["file"], p["problem"]) for p in summary(dataset)["problems"]]


def only_problem(dataset: Path, episode: str, file: str) -> str:
    ((found_episode, found_file, text),) = problems(dataset)
    assert (found_episode, found_file) == (episode, file)
    assert "\n" not in text
    return text


def edit_record(dataset: Path, episode: int = 1, **changes) -> None:
    path = dataset / f"ep_{episode:06d}/episode.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def replace(dataset: Path, name: str, data: bytes) -> None:
    """Put a file into episode 1 and make its hash fit, as someone who means harm would."""
    path = dataset / "ep_000001" / name
    path.write_bytes(data)
    files = json.loads((path.parents[name.count("/")] / "episode.json").read_text())["files"]
    edit_record(dataset, files=files | {name: sha256_bytes(data)})


def test_a_whole_dataset_has_no_problems(dataset):
    assert problems(dataset) == []


def test_checking_changes_nothing(dataset):
    before = tree(dataset)
    summary(dataset)
    assert tree(dataset) == before


def test_a_dataset_is_counted(dataset):
    report = summary(dataset)
    assert (report["episodes"], report["frames"]) == (3, 3 * FRAMES)
    assert report["bytes"] == sum(len(data) for name, data in tree(dataset).items() if name.startswith("ep_"))
    assert report["path"] == str(dataset)
    assert report["cameras"] == {CAMERA: [16, 12]}
    assert (report["tasks"], report["grasps"]) == (["pickplace"], ["weld"])
    assert report["versions"] == [(("numpy", "2.0"),)]


def test_progress_is_told_after_every_episode(dataset):
    told = []
    summarize(dataset, (0.05,), decode_jpeg, lambda done, total: told.append((done, total)))
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_stored_outcomes_are_scored_by_every_threshold(build):
    distances = (0.01, 0.06, 0.07, 0.2)
    path = build(*[made(k, outcome=SUCCESS.model_copy(update={"dxy_m": d})) for k, d in enumerate(distances)])
    report = summary(path, (0.05, 0.065, 0.08))
    assert report["success_rate"] == {"0.05": 0.25, "0.065": 0.5, "0.08": 0.75}
    assert report["wilson95"]["0.065"] == wilson95(2, 4)
    assert report["dxy_m"]["max"] == 0.2
    assert report["dxy_m"]["median"] == pytest.approx(0.065)
    assert report["dz_m"]["median"] == 0.01


def test_every_episode_is_scored_by_the_height_its_own_task_allows(build):
    path = build(made(0), made(1))
    edit_record(path, episode=1, max_height_m=0.001)
    assert summary(path)["success_rate"]["0.05"] == 0.5


def test_start_positions_span_the_workspace(dataset):
    assert summary(dataset)["workspace"] == {
        "banana": {"x": [0.3, pytest.approx(0.32)], "y": [0.1, 0.1]},
        "plate": {"x": [0.5, 0.5], "y": [-0.1, -0.1]},
    }


def test_attempts_are_counted_with_the_causes_of_failure(dataset):
    writer = resume(dataset)
    writer.log(failed_attempt(3))
    writer.log(failed_attempt(4).model_copy(update={"outcome": FAILURE.model_copy(update={"cause": "dropped"})}))
    writer.log(failed_attempt(5))
    writer.finish()
    report = summary(dataset)
    assert report["attempts"] == {
        "n": 6,
        "n_success": 3,
        "success_rate": 0.5,
        "wilson95": wilson95(3, 6),
        "causes": {"off_target": 2, "dropped": 1},
    }
    assert report["problems"] == []


def test_a_dataset_without_episodes_yet_is_a_dataset(dataset):
    for path in dataset.glob("ep_*"):
        shutil.rmtree(path)
    (dataset / "attempts.jsonl").unlink()
    (dataset / "manifest.json").unlink()
    report = summary(dataset)
    assert (report["episodes"], report["success_rate"], report["dxy_m"]) == (0, {"0.05": None, "0.08": None}, None)


@pytest.mark.parametrize("make", [lambda path: None, Path.mkdir, Path.touch])
def test_what_is_no_dataset_is_refused(tmp_path, make):
    make(tmp_path / "x")
    with pytest.raises(DatasetError, match="give the directory that `yamsim record` wrote"):
        summary(tmp_path / "x")


@pytest.mark.parametrize("kept", [0, 1, 100, -1, -2])
def test_a_truncated_image_is_named(dataset, kept):
    path = dataset / "ep_000001" / IMAGE
    path.write_bytes(path.read_bytes()[:kept])
    assert "not a whole JPEG" in only_problem(dataset, "ep_000001", IMAGE)


@pytest.mark.parametrize("kept", [0, 1, 100, -1])
def test_a_truncated_pickle_is_named(dataset, kept):
    path = dataset / "ep_000001" / PICKLE
    path.write_bytes(path.read_bytes()[:kept])
    assert "not a whole pickle" in only_problem(dataset, "ep_000001", PICKLE)


@pytest.mark.parametrize("file", [IMAGE, PICKLE])
def test_a_missing_file_is_named(dataset, file):
    (dataset / "ep_000001" / file).unlink()
    assert only_problem(dataset, "ep_000001", file) == "missing"


@pytest.mark.parametrize("file", ["notes.txt", f"rgb/{CAMERA}/000004.jpg", "lowdim/x/y.pkl", "rgb/other/000000.jpg"])
def test_a_file_too_many_is_named(dataset, file):
    path = dataset / "ep_000001" / file
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_bytes(b"")
    assert only_problem(dataset, "ep_000001", file) == "does not belong to the episode"


def test_a_dangling_link_is_named(dataset):
    path = dataset / "ep_000001" / IMAGE
    path.unlink()
    path.symlink_to("nowhere")
    assert "cannot be read: No such file" in only_problem(dataset, "ep_000001", IMAGE)


def test_one_changed_byte_of_an_image_is_found(dataset):
    path = dataset / "ep_000001" / IMAGE
    data = bytearray(path.read_bytes())
    data[-20] ^= 0x01
    path.write_bytes(data)
    assert decode_jpeg(bytes(data)) is not None
    assert "sha256 differs" in only_problem(dataset, "ep_000001", IMAGE)


def test_one_changed_byte_of_a_pickled_array_is_found(dataset):
    path = dataset / "ep_000001" / PICKLE
    joints = frame(2, 1)["joints"]
    changed = joints.copy()
    changed[3] = np.nextafter(changed[3], np.float32(np.inf))
    data = path.read_bytes()
    assert data.count(joints.tobytes()) == 1
    path.write_bytes(data.replace(joints.tobytes(), changed.tobytes()))
    assert "sha256 differs" in only_problem(dataset, "ep_000001", PICKLE)


def test_values_that_fit_their_hash_but_not_the_content_hash_are_found(dataset):
    replace(dataset, PICKLE, dump_frame(frame(2, seed=99)))
    assert "content_sha256 differs" in only_problem(dataset, "ep_000001", "")


def test_the_same_values_pickled_otherwise_fit_the_content_hash(dataset):
    replace(dataset, PICKLE, pickle.dumps(frame(2, seed=1), 5))
    assert problems(dataset) == []


def test_a_file_without_a_hash_is_named(dataset):
    files = made(1).record.files
    edit_record(dataset, files={name: value for name, value in files.items() if name != IMAGE})
    assert "has no hash" in only_problem(dataset, "ep_000001", IMAGE)


@pytest.mark.parametrize(("width", "height"), [(12, 16), (16, 8), (32, 24)])
def test_an_image_of_another_size_is_named(dataset, width, height):
    replace(dataset, IMAGE, jpeg(width, height))
    assert only_problem(dataset, "ep_000001", IMAGE) == f"is {width}x{height}, not 16x12"


class Bomb:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return builtins.open, (str(self.path), "w")


def test_a_malicious_pickle_is_named_and_not_run(dataset, tmp_path):
    replace(dataset, PICKLE, pickle.dumps(frame(2, 1) | {"joints": Bomb(tmp_path / "pwned")}))
    text = only_problem(dataset, "ep_000001", PICKLE)
    assert "open" in text
    assert "was not run" in text
    assert not (tmp_path / "pwned").exists()


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"joints": np.full(7, np.nan, np.float32)}, "joints has values that are not finite"),
        ({"banana_pose": np.eye(4)}, "banana_pose is float64 (4, 4), not float32 (4, 4)"),
        ({"extrinsics": {}}, f"extrinsics[{CAMERA}] is missing"),
        ({"magnet": 1, "language_task": 2}, "magnet is int, not bool; language_task is int, not str"),
    ],
)
def test_a_frames_faults_are_named(dataset, change, fault):
    replace(dataset, PICKLE, dump_frame(frame(2, 1) | change))
    assert only_problem(dataset, "ep_000001", PICKLE) == fault


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (b"", "Invalid JSON"),
        (b"{", "Invalid JSON"),
        (b"\xff\xfe", "Invalid JSON"),
        (b"{}", "episode: Field required"),
        (b'{"format": "lerobot"}', "format: String should match"),
    ],
)
def test_a_broken_record_is_named_and_the_rest_still_counted(dataset, text, named):
    (dataset / "ep_000001/episode.json").write_bytes(text)
    found = problems(dataset)
    assert [(episode, file) for episode, file, _ in found] == [("ep_000001", "episode.json"), ("", "manifest.json")]
    assert named in found[0][2]
    assert "episode.json" not in found[0][2]
    assert "lists 3 episodes, 2 are readable" in found[1][2]
    assert summary(dataset)["frames"] == 2 * FRAMES


def test_a_missing_record_is_named(dataset):
    (dataset / "ep_000001/episode.json").unlink()
    assert ("ep_000001", "episode.json", "cannot be read: No such file or directory") in problems(dataset)


def test_an_episode_under_anothers_name_is_named(dataset):
    record, found, _ = check_episode(dataset / "ep_000001", 5, decode_jpeg)
    assert record.episode == 1
    assert [(problem.file, problem.problem) for problem in found] == [("episode.json", "says episode 1")]


def test_a_missing_manifest_is_named_with_the_fix(dataset):
    (dataset / "manifest.json").unlink()
    assert only_problem(dataset, "", "manifest.json") == "missing; `yamsim record --resume` writes it again"
    resume(dataset).finish()
    assert problems(dataset) == []


@pytest.mark.parametrize("text", [b"", b"[]", b'{"format": "x"}'])
def test_a_broken_manifest_is_named(dataset, text):
    (dataset / "manifest.json").write_bytes(text)
    assert only_problem(dataset, "", "manifest.json")


def test_an_episode_that_the_manifest_does_not_list_is_a_problem_of_the_manifest(dataset):
    publish(resume(dataset), made(3))
    assert "lists 3 episodes, 4 are readable" in only_problem(dataset, "", "manifest.json")


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_gap_in_the_episodes_is_named(dataset, lost):
    shutil.rmtree(dataset / f"ep_{lost:06d}")
    resume(dataset).finish()
    assert only_problem(dataset, f"ep_{lost:06d}", "") == "missing"


def test_a_gap_is_found_without_a_ledger(dataset):
    shutil.rmtree(dataset / "ep_000001")
    (dataset / "attempts.jsonl").unlink()
    assert ("ep_000001", "", "missing") in problems(dataset)


@pytest.mark.parametrize("damage", [b"{\n", b"\xff\xff\n", b'{"attempt": 9}\n'])
def test_a_damaged_ledger_is_named_and_the_episodes_still_checked(dataset, damage):
    ledger = dataset / "attempts.jsonl"
    lines = ledger.read_bytes().splitlines(keepends=True)
    ledger.write_bytes(lines[0] + damage + lines[2])
    (found,) = problems(dataset)
    assert "attempts.jsonl:2" in found[1]
    assert found[2] == "the ledger is damaged"
    assert summary(dataset)["episodes"] == 3


@pytest.mark.parametrize("times", [(0.0, 0.1, 0.1, 0.2), (0.0, 0.2, 0.1, 0.3), (0.3, 0.2, 0.1, 0.0)])
def test_timestamps_that_do_not_increase_are_a_problem_of_the_episode(build, times):
    frames = [frame(k, 1) | {"timestamp": time} for k, time in enumerate(times)]
    path = build(made(0), made(1, frames=frames))
    assert only_problem(path, "ep_000001", "") == "timestamps do not increase"


def test_a_timestamp_that_is_not_a_number_is_found(build):
    frames = [frame(k, 1) | {"timestamp": math.nan if k == 2 else k * 0.1} for k in range(FRAMES)]
    assert [(episode, file) for episode, file, _ in problems(build(made(0), made(1, frames=frames)))] == [
        ("ep_000001", PICKLE)
    ]


def test_every_problem_is_listed(dataset):
    (dataset / "ep_000000" / IMAGE).unlink()
    (dataset / "ep_000000/extra").touch()
    (dataset / "ep_000002" / PICKLE).write_bytes(b"")
    (dataset / "manifest.json").unlink()
    assert {(episode, file) for episode, file, _ in problems(dataset)} == {
        ("ep_000000", IMAGE),
        ("ep_000000", "extra"),
        ("ep_000002", PICKLE),
        ("", "manifest.json"),
    }


def test_what_is_being_written_is_not_looked_into(dataset):
    (dataset / ".staging/ep_000003.abc").mkdir(parents=True)
    (dataset / ".staging/ep_000003.abc/episode.json").write_bytes(to_json(made(3).record)[:20])
    assert problems(dataset) == []
