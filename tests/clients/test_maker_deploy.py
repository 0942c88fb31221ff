"""What `eval` sends with `--policy-config maker_rtc`, beside what the maker's own policy client sends.

`YAMSIM_MAKER` names a checkout of i2rt-robotics/yam-abc-reproduce, without its submodules.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from tests.clients.environments import Interpreter, checkout
from tests.policies.servers import openpi_server
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.policy import PolicyConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.action_chunks import ChunkScheduler, ChunkSettings
from yamsim_cli.policies.external_policy import MappedPolicy, PolicyScene
from yamsim_cli.policies.openpi import OpenpiClient, pack_openpi, unpack_openpi
from yamsim_cli.policies.policy_protocol import read_chunk

pytestmark = pytest.mark.client
pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")
pytest.importorskip("websockets", reason="yamsim[remote] is not installed")

STEPS = 40
STATION = PolicyScene(
    "station", ("left", "right"), 7, (1.0, 1.0),
    {"top": "top_rgb", "left_wrist": "left_rgb", "right_wrist": "right_rgb"},
)  # fmt: skip


class Server:
    """Keeps what it is sent; its plans go on from the given end, by 0.01 an action."""

    def __init__(self) -> None:
        self.asked: list[Mapping[str, Any]] = []

    def __call__(self, data: bytes) -> bytes:
        message = unpack_openpi(data)
        self.asked.append(message)
        prefix = message["action_prefix"]
        further = prefix[-1] + 0.01 * np.arange(1, 27, dtype=np.float32)[:, None]
        return pack_openpi({"actions": np.concatenate([prefix, further])})


def ours(server: Server, locations: Locations) -> list[list[float]]:
    """Return the actions of `eval`, of which a control tick is 1/30 s here."""
    with openpi_server(server) as url:
        client = OpenpiClient(url, 20)
        policy = MappedPolicy(client, load_config(PolicyConfig, "policies", "maker_rtc", locations), STATION)
        policy.reset(0)
        player = ChunkScheduler(ChunkSettings(lead=policy.lead), 1 / 30, 1, np.zeros((2, 7)))
        rows = []
        for k in range(STEPS):
            if player.is_due(k):
                pictures = {name: np.full((48, 64, 3), 7, np.uint8) for name in STATION.cameras.values()}
                state = np.full(14, k) * np.array([*[1.0] * 6, 1 / max(k, 1)] * 2)
                player.add_chunk(
                    read_chunk(policy({"joints": state, "prompt": "do it", "time": 0.0, **pictures}), 2, 7), k, 0.0
                )
            rows.append(player.command_at(k)[0].ravel().tolist())
        policy.close()
    return rows


def test_eval_sends_and_executes_what_the_makers_client_does(
    client: Callable[[str], Interpreter], locations: Locations
) -> None:
    theirs, own = Server(), Server()
    with openpi_server(theirs) as url:
        port = url.rpartition(":")[2]
        told = client("maker-deploy").run("maker_deploys.py", checkout("YAMSIM_MAKER"), port, STEPS)
    rows = ours(own, locations)
    joints = [*range(6), *range(7, 13)]
    np.testing.assert_allclose(np.array(rows)[:, joints], np.array(told["rows"])[:, joints], atol=1e-5)
    assert len(theirs.asked) == len(own.asked) == 3
    for one, other in zip(own.asked, theirs.asked, strict=True):
        assert set(one) == set(other) == {"images", "state", "prompt", "action_prefix", "prefix_length"}
        assert set(one["images"]) == set(other["images"])
        assert (one["prompt"], one["prefix_length"]) == (other["prompt"], other["prefix_length"])
        for key in ("state", "action_prefix"):
            assert (one[key].shape, one[key].dtype) == (other[key].shape, other[key].dtype)
        np.testing.assert_allclose(one["action_prefix"][:, joints], other["action_prefix"][:, joints], atol=1e-5)
        for role, image in one["images"].items():
            np.testing.assert_array_equal(image, other["images"][role])
    # With the observation at the eleventh action of fifteen; a busy machine may delay the maker's thread by a step.
    assert [round(float(one["state"][0])) for one in own.asked] == [0, 10, 25]
    assert all(
        0 <= other["state"][0] - one["state"][0] <= 3 for one, other in zip(own.asked, theirs.asked, strict=True)
    )
