"""Serves plans as openpi's server does, with openpi's packer: plans.npz. Prints its port; ends with its input."""

import asyncio
import json
import sys
import time

import numpy as np
import websockets.asyncio.server
from openpi_client import msgpack_numpy

PLANS = np.load(sys.argv[1])
ACTIONS = 16


def infer(told):
    assert told["state"].shape == (14,) and told["state"].dtype == np.float32, told["state"]
    assert set(told["images"]) == {"cam_high", "cam_left_wrist", "cam_right_wrist"}
    for image in told["images"].values():
        assert image.shape == (3, 224, 224) and image.dtype == np.uint8, image.shape
        assert image.std() > 1
    assert isinstance(told["prompt"], str) and told["prompt"]
    plan, now = PLANS[str(told["seed"])], round(told["time"] / 0.032)
    return {"actions": plan[np.minimum(now + np.arange(ACTIONS), len(plan) - 1)]}


async def handle(connection):
    packer = msgpack_numpy.Packer()
    await connection.send(packer.pack({"name": "plans"}))
    async for message in connection:
        began = time.monotonic()
        answer = infer(msgpack_numpy.unpackb(message))
        answer["server_timing"] = {"infer_ms": np.float64((time.monotonic() - began) * 1000)}
        await connection.send(packer.pack(answer))


async def main():
    async with websockets.asyncio.server.serve(handle, "127.0.0.1", 0, compression=None, max_size=None) as server:
        print(json.dumps({"port": server.sockets[0].getsockname()[1]}), flush=True)
        await asyncio.to_thread(sys.stdin.read)


asyncio.run(main())
