"""`yamsim verify` on real episodes: valid ones agree bit for bit, and each change is named."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run_cli import Run, yamsim
from tests.unrendered import SIZE, change_frame, change_record, frame_count, read_frame, write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import read_recording_config, select_episode_directories
from yamsim_cli.core.episode.attempt_payload import APPEARANCE_REVISION, SIMULATION_REVISION
from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.datasets.verify import ACTIONS, IMAGES, SEED, EpisodeVerdict, EpisodeVerifier, Tolerances

EPISODES = 3


@pytest.fixture(scope="module")
def original(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> Path:
    path = tmp_path_factory.mktemp("verify") / "dataset"
    write_dataset(path, make_config({("image", "size_px"): SIZE, ("seed",): 5}), locations, EPISODES)
    return path


@pytest.fixture
def dataset(original: Path, tmp_path: Path) -> Path:
    return shutil.copytree(original, tmp_path / "dataset")


@pytest.fixture(scope="module")
def verifier(original: Path, locations: Locations) -> EpisodeVerifier:
    return EpisodeVerifier(
        Session(read_recording_config(original, locations), locations), Tolerances(values=0.0, images=None)
    )


@pytest.fixture
def verdict(dataset: Path, verifier: EpisodeVerifier) -> Callable[[], EpisodeVerdict]:
    """Check the dataset's second episode."""
    return lambda: verifier.run((1, dataset / "ep_000001"))


def test_an_episode_is_made_again_bit_for_bit_from_its_seed_and_from_its_actions(verdict) -> None:
    result = verdict()
    assert result.is_reproduced
    for check in (SEED, ACTIONS):
        assert result.checks[check].max_error == 0.0
        assert {"joints", "banana_pose", "sim_qpos", "outcome.dxy_m"} <= set(result.checks[check].largest)
    assert "start.banana" in result.checks[SEED].largest


@pytest.mark.parametrize("rehash", [True, False])
def test_a_changed_joint_is_named_with_its_frame_whether_or_not_its_hash_was_changed_too(
    dataset: Path, verdict, rehash: bool
) -> None:
    before = read_frame(dataset / "ep_000001", 20)["joints"]
    after = before + np.float32(1e-3) * np.eye(7, dtype=np.float32)[2]
    change_frame(dataset / "ep_000001", 20, rehash=rehash, joints=after)
    result = verdict()
    for check in (SEED, ACTIONS):
        first = result.checks[check].first_difference
        assert (first.frame, first.quantity) == (20, "joints[2]")
        assert first.time_s == pytest.approx(1.28)
        assert (first.stored, first.got) == (float(after[2]), float(before[2]))
        # Joints around 2 rad count relative to themselves.
        assert first.difference == pytest.approx(1e-3 / max(1.0, abs(after[2])), rel=1e-3)
    assert set(result.problems) == (set() if rehash else {"lowdim/000020.pkl"})


def test_a_changed_action_is_named_and_what_it_does_is_seen_one_frame_later(dataset: Path, verdict) -> None:
    actions = read_frame(dataset / "ep_000001", 20)["sim_ctrl"].copy()
    actions[1, 1] += 1e-3
    change_frame(dataset / "ep_000001", 20, rehash=True, sim_ctrl=actions)
    result = verdict()
    assert (result.checks[SEED].first_difference.frame, result.checks[SEED].first_difference.quantity) == (
        20,
        "sim_ctrl[1, 1]",
    )
    assert result.checks[ACTIONS].first_difference.frame == 21
    assert result.checks[ACTIONS].max_error > 1e-5


def test_a_weld_that_was_never_switched_on_drops_the_object(dataset: Path, verdict) -> None:
    directory = dataset / "ep_000001"
    magnets = [read_frame(directory, k)["sim_magnet"] for k in range(frame_count(directory))]
    for k, magnet in enumerate(magnets):
        change_frame(directory, k, rehash=True, sim_magnet=np.zeros_like(magnet))
    taken = next(k for k, magnet in enumerate(magnets) if magnet.any())
    first = verdict().checks[ACTIONS].first_difference
    assert taken <= first.frame < taken + 10
    assert verdict().checks[ACTIONS].max_error > 0.1


def test_a_failure_passed_off_as_a_success_is_found(dataset: Path, verdict) -> None:
    outcome = json.loads((dataset / "ep_000001" / "episode.json").read_text())["outcome"]
    change_record(dataset / "ep_000001", outcome=outcome | {"dxy_m": 0.2, "cause": "off_target"})
    for check in (SEED, ACTIONS):
        first = verdict().checks[check].first_difference
        assert (first.frame, first.quantity, first.stored) == (None, "outcome.cause", "off_target")


def test_an_episode_under_another_attempts_number_is_found(dataset: Path, verdict) -> None:
    change_record(dataset / "ep_000001", attempt=7)
    result = verdict()
    assert result.checks[SEED].first_difference.frame == 0
    assert result.checks[ACTIONS].first_difference is None


@pytest.mark.slow
def test_an_episode_that_shows_other_meshes_than_its_dataset_is_named(
    dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    said = {"i2rt_yam_crank": "full " + "0" * 64, "ycb": "primitives"}
    config = read_recording_config(dataset, locations).model_copy(update={"meshes": said})
    with EpisodeVerifier(Session(config, locations), Tolerances(values=0.0, images=None)) as verifier:
        change_record(dataset / "ep_000001", meshes=said)
        assert verifier.run((1, dataset / "ep_000001")).is_reproduced
        change_record(dataset / "ep_000001", meshes=said | {"i2rt_yam_crank": "primitives"})
        result = verifier.run((1, dataset / "ep_000001"))
        # An earlier version does not state it.
        assert verifier.run((0, dataset / "ep_000000")).is_reproduced
    told = "it shows other meshes than config.yaml says: i2rt_yam_crank: primitives here, full 000000000000 there"
    assert result.problems == {"episode.json": told}
    assert not result.is_reproduced


def test_changed_versions_are_told_and_are_no_fault(dataset: Path, verdict) -> None:
    versions = json.loads((dataset / "ep_000001" / "episode.json").read_text())["versions"]
    change_record(dataset / "ep_000001", versions=versions | {"mujoco": "3.9.9", "retired": "1"})
    result = verdict()
    assert result.is_reproduced
    assert result.changed_versions == {"mujoco": ("3.9.9", versions["mujoco"])}


def test_a_damaged_file_ends_that_episode_alone(dataset: Path, verdict) -> None:
    file = dataset / "ep_000001" / "lowdim" / "000030.pkl"
    file.write_bytes(file.read_bytes()[:100])
    result = verdict()
    assert not result.is_reproduced
    assert "lowdim/000030.pkl" in result.problems[""]
    assert result.checks == {}


def test_an_episode_of_another_scene_is_refused_rather_than_run(dataset: Path, verdict) -> None:
    for k in range(frame_count(dataset / "ep_000001")):
        change_frame(dataset / "ep_000001", k, rehash=True, sim_qpos=np.zeros(9))
    assert "frame 0" in verdict().problems[""]


def test_an_episode_without_simulation_is_skipped_with_the_reason(dataset: Path, verdict) -> None:
    directory = dataset / "ep_000001"
    for k in range(frame_count(directory)):
        change_frame(directory, k, rehash=True, sim_qpos=None, sim_ctrl=None, sim_magnet=None)
    change_record(directory, source="teleop")
    result = verdict()
    assert result.checks == {}
    assert result.skipped[SEED] == "it comes from 'teleop', not from a seed"
    assert "sim_qpos" in result.skipped[ACTIONS]


def test_which_episodes(original: Path, tmp_path: Path) -> None:
    def numbers(episodes: str | None = None, sample: int | None = None) -> list[int]:
        return [number for number, _ in select_episode_directories(original, episodes, sample)]

    assert numbers() == numbers("0-2") == numbers("2,0-1,1") == numbers("ep_000000-ep_000002") == [0, 1, 2]
    assert numbers(sample=1) == [0]
    assert numbers(sample=2) == [0, 2]
    assert numbers(sample=99) == [0, 1, 2]
    for text, fault in (
        ("7", "has no episode 7; valid: 0-2"),
        ("1-3", "has no episode 3"),
        ("0-99999999999", "has no episode 3"),
        ("2-1", "'2-1' is neither a number nor a range; valid: 0-2"),
        ("one", "'one' is neither"),
        ("0,,1", "'' is neither"),
    ):
        with pytest.raises(UsageError, match=fault):
            numbers(text)
    with pytest.raises(DatasetError, match="is not a directory"):
        select_episode_directories(tmp_path / "nowhere", None, None)
    with pytest.raises(DatasetError, match="holds no episodes"):
        select_episode_directories(tmp_path, None, None)


def test_without_a_usable_config_nothing_can_be_made_again(dataset: Path, locations: Locations) -> None:
    (dataset / "config.yaml").write_text("seed: [")
    with pytest.raises(DatasetError, match=r"config\.yaml"):
        read_recording_config(dataset, locations)
    (dataset / "config.yaml").unlink()
    with pytest.raises(DatasetError, match="without it, the dataset cannot be simulated again"):
        read_recording_config(dataset, locations)


def test_the_command_agrees_with_a_whole_dataset(original: Path) -> None:
    run = yamsim("verify", original, "--workers", "3", "--json")
    assert (run.code, run.err) == (0, "")
    report = run.json
    assert (report["episodes"], report["agree"], report["max_error"]) == (3, 3, 0.0)
    assert (report["first_divergence"], report["problems"], report["versions_changed"]) == (None, [], [])
    assert report["checks"]["images"] is None


def test_the_command_for_a_person(original: Path) -> None:
    run = yamsim("verify", original, "--episodes", "2")
    assert run.code == 0
    assert "1 of 1, largest difference 0 (bit for bit)" in run.out


def failing(dataset: Path, *args: str) -> Run:
    run = yamsim("verify", dataset, *args, "--json")
    assert run.code == 4
    return run


@pytest.mark.slow
def test_the_command_tells_what_differs_in_one_line_with_the_versions_that_changed(dataset: Path) -> None:
    after = read_frame(dataset / "ep_000001", 20)["joints"] + np.float32(1e-3)
    change_frame(dataset / "ep_000001", 20, rehash=True, joints=after)
    change_record(
        dataset / "ep_000001", versions={"mujoco": "3.9.9", "looks": APPEARANCE_REVISION, "engine": SIMULATION_REVISION}
    )
    run = failing(dataset)
    assert run.json["first_divergence"]["episode"] == 1
    assert run.json["first_divergence"]["frame"] == 20
    assert run.json["first_divergence"]["quantity"].startswith("joints[")
    assert run.json["agree"] == 2
    assert 0 < run.json["max_error"] <= 1.001e-3
    changed = run.json["versions_changed"]
    assert [(c["name"], c["recorded"], c["episodes"]) for c in changed] == [("mujoco", "3.9.9", "1")]
    assert "ep_000001 frame 20 (1.280 s): joints[" in run.message
    assert "recorded with mujoco 3.9.9 (now " in run.message
    assert "--tolerance 0.005" in run.message
    assert yamsim("verify", dataset, "--tolerance", "0.0011").code == 0


def verdict_without_version(dataset: Path, locations: Locations, name: str) -> EpisodeVerdict:
    """Check an episode of an earlier yamsim, whose record lacks the version `name`."""
    record = json.loads((dataset / "ep_000000" / "episode.json").read_text(encoding="utf-8"))
    change_record(
        dataset / "ep_000000", versions={key: text for key, text in record["versions"].items() if key != name}
    )
    session = Session(read_recording_config(dataset, locations), locations)
    with EpisodeVerifier(session, Tolerances(values=0.0, images=0.0)) as verifier:
        return verifier.run((0, dataset / "ep_000000"))


def test_pictures_of_an_earlier_revision_of_looks_are_reported_and_states_agree(
    dataset: Path, locations: Locations
) -> None:
    found = verdict_without_version(dataset, locations, "looks")
    assert found.is_reproduced
    assert found.checks[SEED].first_difference is None
    assert IMAGES not in found.checks
    assert found.skipped[IMAGES].startswith(
        f"its images have appearance revision 1, but this version renders revision {APPEARANCE_REVISION}"
    )
    assert found.changed_versions["looks"] == ("1", APPEARANCE_REVISION)


def test_an_episode_of_an_earlier_engine_is_repeated_by_its_actions_alone(dataset: Path, locations: Locations) -> None:
    found = verdict_without_version(dataset, locations, "engine")
    assert found.is_reproduced
    assert set(found.checks) == {ACTIONS}
    reason = found.skipped[SEED]
    assert reason.startswith("it was made by engine revision 1 of yamsim ")
    assert f"this version's revision {SIMULATION_REVISION} makes other episodes" in reason
    assert found.skipped[IMAGES] == found.skipped[SEED]
    assert found.changed_versions["engine"] == ("1", SIMULATION_REVISION)


def test_the_command_names_an_altered_file_though_no_value_differs_enough(dataset: Path) -> None:
    frame = read_frame(dataset / "ep_000000", 3)
    change_frame(dataset / "ep_000000", 3, rehash=False, timestamp=frame["timestamp"] + 1e-9)
    run = failing(dataset, "--tolerance", "0.001", "--episodes", "0")
    assert run.json["first_divergence"] is None
    assert "ep_000000/lowdim/000003.pkl: its content is not what was recorded" in run.message


def test_the_command_names_a_damaged_file_once(dataset: Path) -> None:
    (dataset / "ep_000002" / "lowdim" / "000030.pkl").write_bytes(b"no pickle")
    message = failing(dataset, "--episodes", "2").message
    assert "ep_000002/lowdim/000030.pkl: the pickle has the instruction" in message
    assert message.count("ep_000002") == 1


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--episodes", "9"), "has no episode 9; valid: 0-2"),
        (("--episodes", "0", "--sample", "2"), "exclude each other"),
        (("--image-tolerance", "1"), "needs --images"),
    ],
)
def test_a_bad_command_line_is_one_line_and_code_2(original: Path, args: tuple[str, ...], message: str) -> None:
    run = yamsim("verify", original, *args)
    assert run.code == 2
    assert message in run.message
