"""Cost of a policy in another process: requests with three pictures of 224 x 224, chunks of 30 actions, answered at
once by a server on this machine, with each protocol.

    python -m tools.bench.policies
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from tests.policies.servers import act_server, openpi_server
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.policy import PolicyConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.act import ActClient
from yamsim_cli.policies.evaluate.policy_factory import _CONFIGS
from yamsim_cli.policies.external_policy import MappedPolicy, PolicyClient, PolicyScene
from yamsim_cli.policies.openpi import OpenpiClient, pack_openpi, unpack_openpi

QUESTIONS = 300
ANSWER = {"actions": np.zeros((30, 14))}
STATION = PolicyScene(
    "station", ("left", "right"), 7, (0.0475, 0.0475),
    {"top": "top_rgb", "left_wrist": "left_rgb", "right_wrist": "right_rgb"},
)  # fmt: skip


def answer(_: Mapping[str, Any]) -> dict[str, Any]:
    return ANSWER


def unpacked(data: bytes) -> bytes:
    unpack_openpi(data)
    return pack_openpi(ANSWER)


def serve(scheme: str, pipe: Connection) -> None:
    """Serve in a separate process until the pipe is closed."""
    server = act_server(answer) if scheme == "act" else openpi_server(unpacked)
    with server as url:
        pipe.send(url)
        pipe.poll(None)


def main() -> None:
    rng = np.random.default_rng(0)
    observation = {"joints": np.zeros(14), "prompt": "hand the bar over", "time": 0.0}
    observation |= {
        f"{name}_rgb": rng.integers(0, 255, (480, 640, 3), dtype=np.uint8) for name in ("top", "left", "right")
    }
    clients: dict[str, Callable[[str, float], PolicyClient]] = {"act": ActClient, "ws": OpenpiClient}
    for scheme, make in clients.items():
        ours, theirs = multiprocessing.Pipe()
        process = multiprocessing.get_context("spawn").Process(target=serve, args=(scheme, theirs), daemon=True)
        process.start()
        config = load_config(PolicyConfig, "policies", _CONFIGS[scheme], Locations.from_environment(os.environ))
        policy = MappedPolicy(make(ours.recv(), 10.0), config, STATION)
        policy.reset(0)
        seconds = []
        for _ in range(QUESTIONS):
            began = time.perf_counter()
            policy(observation)
            seconds.append(time.perf_counter() - began)
        policy.close()
        ours.send(None)
        process.join()
        median, p95 = np.median(seconds) * 1000, np.percentile(seconds, 95) * 1000
        rate = QUESTIONS / sum(seconds)
        print(
            f"{scheme}://  median {median:.1f} ms, 95 % {p95:.1f} ms, {rate:.0f} questions/s, {30 * rate:.0f} actions/s"
        )


if __name__ == "__main__":
    main()
