"""Servers of policies with the real packages, and messages of the real client."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.clients.environments import SCRIPTS, Interpreter, yamsim_beside
from tests.policies.evaluate.test_external_policies import expert_plans
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.policy import PolicyConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.act import dump_json, load_json
from yamsim_cli.policies.action_chunks import ChunkSettings
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialEnd, TrialResult, TrialRunner
from yamsim_cli.policies.external_policy import MappedPolicy, PolicyScene

pytestmark = pytest.mark.render
pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")

HERE = Path(__file__).parent
TRIALS = 2
# Mapping with further values for the served expert, whose plan has one action per control tick.
TELLS_ALL = "time: time\nseed: seed\n"
MAPPINGS = {"act": ("molmoact2_yam", "hz: 30"), "ws": ("openpi_aloha", "hz: 50")}


@pytest.fixture(scope="module")
def experts(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> tuple[RecordConfig, list[TrialResult], Mapping[int, np.ndarray]]:
    """For a task with grasps by friction on two arms: the actions of the scripted policy."""
    config = make_config(
        {
            ("rig",): "yam_station_linear_4310_d405",
            ("task",): "handover",
            ("grasp",): "contact",
            ("episodes",): TRIALS,
            ("workers",): 1,
            ("wrist",): True,
            ("image", "size_px"): [64, 48],
            ("render",): "fast",
        }
    )
    local, plans = expert_plans(config, locations)
    # These protocols have no weld.
    return config, local, {seed: rows[:, :14] for seed, rows in plans.items()}


@contextmanager
def serving(interpreter: Interpreter, script: str, *arguments: object) -> Iterator[int]:
    """Return the port of a server that runs in a client's environment."""
    command = [str(interpreter.python), str(SCRIPTS / script), *map(str, arguments)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        try:
            yield json.loads(process.stdout.readline())["port"]
        finally:
            process.stdin.close()
            process.wait(20)


@pytest.mark.client
@pytest.mark.parametrize(("row", "scheme"), [("act", "act"), ("openpi", "ws")])
def test_an_expert_that_is_served_does_what_it_does_here(
    row: str,
    scheme: str,
    client: Callable[[str], Interpreter],
    experts: tuple[RecordConfig, list[TrialResult], Mapping[int, np.ndarray]],
    locations: Locations,
    tmp_path: Path,
) -> None:
    """Trial by trial, command by command, through their own package."""
    config, local, plans = experts
    np.savez(tmp_path / "plans.npz", **{str(seed): rows for seed, rows in plans.items()})
    name, rate = MAPPINGS[scheme]
    text = locations.config_file("policies", name).read_text()
    assert rate in text
    (tmp_path / "mapping.yaml").write_text(text.replace(rate, "hz: 31.25") + TELLS_ALL)
    with serving(client(row), f"serve_{row}.py", tmp_path / "plans.npz") as port:
        choice = PolicyChoice(
            f"{scheme}://127.0.0.1:{port}",
            HERE,
            time_limit=0.032 * max(result.ticks for result in local),
            mapping=str(tmp_path / "mapping.yaml"),
            chunking=ChunkSettings(execute=12),
        )
        with TrialRunner(Session(config, locations), choice) as runner:
            for own in local:
                served = runner.run(own.attempt.job)
                ended = TrialEnd.SUCCESS if own.outcome.success else TrialEnd.TIME_LIMIT
                assert (served.ended, served.error) == (ended, "")
                assert served.outcome.success == own.outcome.success
                assert own.actions is not None
                assert served.actions is not None
                np.testing.assert_allclose(served.actions.ctrl[: own.ticks], own.actions.ctrl, rtol=0, atol=1e-12)
    assert sum(result.outcome.success for result in local) > 0


@pytest.mark.client
def test_act_is_told_byte_for_byte_what_its_own_client_tells_it(
    client: Callable[[str], Interpreter], locations: Locations, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    pictures = {name: rng.integers(0, 255, (224, 224, 3), dtype=np.uint8) for name in ("top", "left", "right")}
    state = rng.uniform(0, 1, 14)
    np.savez(
        tmp_path / "observed.npz",
        prompt="hand it over",
        state=state,
        **{f"{key}_cam": value for key, value in pictures.items()},
    )
    told = client("act").run("act_sends.py", tmp_path / "observed.npz", tmp_path / "sent.json")
    assert told["actions"] == 30
    theirs = load_json((tmp_path / "sent.json").read_bytes())

    cameras = {"top": "top_rgb", "left_wrist": "left_rgb", "right_wrist": "right_rgb"}
    station = PolicyScene("station", ("left", "right"), 7, (0.0475, 0.0475), cameras)
    config = load_config(PolicyConfig, "policies", "molmoact2_yam", locations)
    joints = state.copy()
    joints[[6, 13]] *= 0.0475
    observed = {"joints": joints, "prompt": "hand it over", "time": 0.0}
    observed |= {f"{name}_rgb": picture for name, picture in pictures.items()}
    message = MappedPolicy(_StubClient(), config, station).make_message(observed)
    ours = load_json(dump_json(message))
    assert ours.keys() == theirs.keys()
    for key, value in theirs.items():
        if isinstance(value, np.ndarray):
            assert (ours[key].dtype, ours[key].shape) == (value.dtype, value.shape), key
            np.testing.assert_array_equal(ours[key], value)
        else:
            assert ours[key] == value


class _StubClient:
    def begin_trial(self, seed: int) -> None:
        pass

    def infer(self, message: object) -> Mapping[str, object]:
        return {}

    def close(self) -> None:
        pass


@pytest.mark.client_heavy
def test_a_checkpoint_of_lerobots_answers_as_in_lerobot(
    client: Callable[[str], Interpreter], locations: Locations, tmp_path: Path
) -> None:
    """The same actions as by its own inference, and trials that run to their end."""
    rng = np.random.default_rng(0)
    state, scene = rng.uniform(-1, 1, 7).astype(np.float32), rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    np.savez(tmp_path / "observed.npz", state=state, scene=scene)
    alone = client("lerobot")
    given = tmp_path / "act", tmp_path / "observed.npz"
    alone.run("make_act.py", *given, tmp_path / "theirs.npy")
    both, _ = yamsim_beside(alone, tmp_path / "both")
    told = both.run("ask_act.py", *given, tmp_path / "ours.npy")
    assert sorted(told.pop("asks")) == ["observation.images.scene_camera", "observation.state"]
    assert told == {"execute": 4}
    theirs, ours = np.load(tmp_path / "theirs.npy"), np.load(tmp_path / "ours.npy")
    assert (theirs.shape, ours.shape) == ((4, 8), (8, 8))
    np.testing.assert_array_equal(ours[:4], theirs)

    words = ["eval", "--policy", f"lerobot:{tmp_path / 'act'}", "--n", "2", "--workers", "1", "--time-limit", "1.6"]
    done = both.call(
        ["-m", "yamsim_cli", *words, "--size", "64x48", "--quality", "fast", "--json"], timeout_s=600, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["stats"]["ended"] == {"time_limit": 2}
    # Fifty ticks: four actions of two ticks between two requests.
    assert report["stats"]["chunks"] == {"chunks": 14, "actions": 112, "stale": 0, "waited_s": 0.0}
