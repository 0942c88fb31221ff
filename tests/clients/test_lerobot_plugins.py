"""LeRobot's own programs with the plugins in `integrations/`, found as all plugins of LeRobot."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.clients.environments import REPOSITORY, SCRIPTS, Interpreter, yamsim_beside
from tests.export.conftest import jpeg
from tests.unrendered import write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.files.resources import Locations

pytest.importorskip("pyarrow", reason="yamsim[lerobot] is not installed")
pytest.importorskip("av", reason="yamsim[lerobot] is not installed")
import av
import pyarrow.parquet

from yamsim_cli.export.export_source import open_source
from yamsim_cli.export.lerobot import export_lerobot

pytestmark = pytest.mark.client_heavy

PLUGINS = tuple(REPOSITORY / "integrations" / name for name in ("lerobot_env_yamsim", "lerobot_robot_yamsim"))
# s; the machine may be busy
PATIENCE = 1800
JOINTS = [*(f"joint{k}.pos" for k in range(1, 7)), "gripper.pos"]


@dataclass(frozen=True)
class LeRobot:
    """LeRobot's programs, in an environment with yamsim, its plugins, and a policy that plays given actions."""

    interpreter: Interpreter
    programs: Path

    def run(self, name: str, home: Path, *arguments: str) -> str:
        """Run a program of LeRobot, which must succeed, and return output and log."""
        environ = {"HF_LEROBOT_HOME": str(home), "HF_HOME": str(home / "hf"), "SLURM_JOB_ID": "no bars, please"}
        asked = Interpreter(self.interpreter.python, environ)
        done = asked.call([str(self.programs / name), *arguments], timeout_s=PATIENCE, cwd=home)
        told = f"{done.stdout}\n{done.stderr}"
        assert done.returncode == 0, f"{name} {' '.join(arguments)}:\n{told[-4000:]}"
        return told

    def evaluate(self, home: Path, policy: Path, *arguments: str) -> dict[str, Any]:
        """What `lerobot-eval` found."""
        out = home / "evaluated"
        flags = ["--env.type=yamsim", "--env.quality=fast", "--policy.device=cpu", "--seed=0", f"--output_dir={out}"]
        self.run("lerobot-eval", home, f"--policy.path={policy}", *flags, *arguments)
        found: dict[str, Any] = json.loads((out / "eval_info.json").read_text())
        return found


@pytest.fixture(scope="module")
def made() -> dict[str, LeRobot]:
    return {}


@pytest.fixture
def open_lerobot(
    client: Callable[[str], Interpreter], made: dict[str, LeRobot], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], LeRobot]:
    """Opens the environment of a row, made once for all tests here."""

    def open_row(name: str) -> LeRobot:
        alone = client(name)
        if not made:
            more = [*map(str, PLUGINS), str(SCRIPTS / "lerobot_policy_played"), "pytest"]
            both, _ = yamsim_beside(alone, tmp_path_factory.mktemp("plugins") / "both", *more)
            made["it"] = LeRobot(both, alone.python.parent)
        return made["it"]

    return open_row


def successes(found: dict[str, Any]) -> list[bool]:
    (task,) = found["per_task"]
    return [bool(success) for success in task["metrics"]["successes"]]


@pytest.mark.parametrize(("row", "plugin"), [("lerobot-eval", PLUGINS[0]), ("lerobot-record", PLUGINS[1])])
def test_the_plugins_own_tests_pass(
    open_lerobot: Callable[[str], LeRobot], row: str, plugin: Path, tmp_path: Path
) -> None:
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "/dev/null", str(plugin / "tests")]
    done = open_lerobot(row).interpreter.call(words, timeout_s=PATIENCE, cwd=tmp_path)
    assert done.returncode == 0, done.stdout[-4000:]


@pytest.mark.parametrize(
    ("rig", "action", "fps", "arguments"),
    [
        ("single", "drives", 15.625, ["--eval.batch_size=2", "--env.size=64x48"]),
        (
            "single_linear",
            "joints",
            30.0,
            ["--eval.batch_size=4", "--eval.use_async_envs=false", "--env.grasp=contact", "--env.pictures=false"],
        ),
    ],
)
def test_a_policy_that_plays_the_expert_succeeds(
    open_lerobot: Callable[[str], LeRobot], tmp_path: Path, rig: str, action: str, fps: float, arguments: Sequence[str]
) -> None:
    """In several processes with pictures, and in one process by joints alone, as datasets of real arms."""
    lerobot = open_lerobot("lerobot-eval")
    given = (tmp_path / "played", 4, "pickplace", action, fps, rig)
    assert lerobot.interpreter.run("make_played.py", *given, timeout_s=PATIENCE) == {"trials": [0, 1, 2, 3]}
    words = [f"--env.rig={rig}", f"--env.action={action}", f"--env.fps={fps}", "--eval.n_episodes=4", *arguments]
    found = lerobot.evaluate(tmp_path, tmp_path / "played", *words)
    assert successes(found) == [True] * 4
    videos = sorted((tmp_path / "evaluated").glob("videos/pickplace_0/*.mp4"))
    assert len(videos) == 4
    with av.open(str(videos[0])) as video:
        assert float(video.streams.video[0].average_rate or 0) == fps
        assert 10 < sum(1 for _ in video.decode(video=0)) < 20 * fps


def test_a_checkpoint_that_it_has_trained_is_evaluated_and_its_trials_recorded(
    open_lerobot: Callable[[str], LeRobot],
    make_config: Callable[..., RecordConfig],
    locations: Locations,
    tmp_path: Path,
) -> None:
    """After two training steps on an export, the policy moves in each trial, and fails as in yamsim's `eval`."""
    lerobot = open_lerobot("lerobot-eval")
    config = make_config({("wrist",): True, ("image", "size_px"): [64, 48]})
    write_dataset(tmp_path / "dataset", config, locations, 2, jpeg)
    (tmp_path / "local").mkdir()
    export_lerobot(open_source(tmp_path / "dataset", None, locations), tmp_path / "local" / "x", lambda *_: None)
    sizes = ("--policy.dim_model=64", "--policy.n_heads=4", "--policy.dim_feedforward=128")
    lerobot.run(
        "lerobot-train",
        tmp_path,
        *("--dataset.repo_id=local/x", "--dataset.video_backend=pyav", "--policy.type=act", "--policy.device=cpu"),
        *("--policy.push_to_hub=false", "--policy.pretrained_backbone_weights=null", "--num_workers=0"),
        *("--batch_size=2", "--steps=2", "--policy.chunk_size=8", "--policy.n_action_steps=8", *sizes),
        f"--output_dir={tmp_path / 'trained'}",
    )
    checkpoint = tmp_path / "trained" / "checkpoints" / "000002" / "pretrained_model"
    # A second batch is not recorded.
    several = ["--eval.n_episodes=2", "--eval.batch_size=2", "--eval.use_async_envs=false", "--eval.recording=true"]
    words = ["--env.size=64x48", *several]
    found = lerobot.evaluate(tmp_path, checkpoint, *words)

    asked = ["-m", "yamsim_cli", "eval", "--policy", f"lerobot:{checkpoint}", "--n", "2", "--workers", "1"]
    done = lerobot.interpreter.call([*asked, "--size", "64x48", "--quality", "fast", "--json"], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert successes(found) == [trial["outcome"]["success"] for trial in report["trials"]]
    recorded = tmp_path / "evaluated" / "recordings" / "pickplace_0" / "env_1"
    assert json.loads((recorded / "meta" / "info.json").read_text())["fps"] == 15.625
    (table,) = (pyarrow.parquet.read_table(path) for path in recorded.glob("data/*/*.parquet"))
    acted = np.array(table["action"].to_pylist())
    assert acted.shape[1] == 8 and np.isfinite(acted).all() and np.ptp(acted[:, :6], axis=0).max() > 0


def test_it_records_the_expert_and_plays_it_again(open_lerobot: Callable[[str], LeRobot], tmp_path: Path) -> None:
    """Two episodes of different scenes; each succeeds, also when replayed in real time."""
    lerobot = open_lerobot("lerobot-record")
    robot = ["--robot.type=yamsim", "--robot.id=sim", "--robot.quality=fast", "--robot.size=64x48"]
    robot += ["--robot.seed=3", "--robot.cameras=[scene_camera]"]
    told = lerobot.run(
        "lerobot-record",
        tmp_path,
        *robot,
        *("--robot.by_clock=false", "--teleop.type=yamsim_expert", "--teleop.robot_id=sim"),
        *("--dataset.repo_id=local/two", "--dataset.no_stamp=true", "--dataset.push_to_hub=false"),
        # A busy machine needs time for all of the 240 frames.
        *("--dataset.num_episodes=2", "--dataset.episode_time_s=40", "--dataset.reset_time_s=1"),
        *("--dataset.single_task=put the banana on the plate", "--play_sounds=false"),
    )
    assert "trial 0: success" in told and "trial 1: success" in told

    read = lerobot.interpreter.run("read_lerobot.py", tmp_path / "local/two", tmp_path / "two.npz", timeout_s=PATIENCE)
    found = np.load(tmp_path / "two.npz")
    assert read["fps"] == 30 and len(read["tasks"]) == 1
    assert set(read["policy"]) == {"observation.state", "action", "observation.images.scene_camera"}
    features = json.loads((tmp_path / "local/two/meta/info.json").read_text())["features"]
    assert features["action"]["names"] == features["observation.state"]["names"] == JOINTS
    for number in (0, 1):
        mine = found["episode_index"] == number
        state, action = found["observation.state"][mine], found["action"][mine]
        # The arm starts at rest, moves, and releases; afterwards it stays.
        assert np.abs(state[0] - action[0]).max() < 0.05
        assert np.ptp(action[:, 0]) > 0.1 and 0 <= action[:, 6].min() < action[:, 6].max() <= 1
        assert len(action) > 240 and (action[240:] == action[239]).all()
    first = found["observation.images.scene_camera"]
    assert np.abs(first[0] - first[100]).max() > 0.2

    told = lerobot.run("lerobot-replay", tmp_path, *robot, "--dataset.repo_id=local/two", "--dataset.episode=0")
    assert "trial 0: " in told


def test_its_programs_know_the_cameras_of_a_served_arm(open_lerobot: Callable[[str], LeRobot], tmp_path: Path) -> None:
    lerobot = open_lerobot("lerobot-record")
    asks = (
        "from lerobot.cameras.configs import CameraConfig; "
        "from lerobot.utils.import_utils import register_third_party_plugins as find; "
        "find(); print(sorted(CameraConfig.get_known_choices()))"
    )
    done = lerobot.interpreter.call(["-c", asks], cwd=tmp_path)
    assert done.returncode == 0 and "'yamsim'" in done.stdout, done.stderr
