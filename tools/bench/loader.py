"""Frames a second of `ChunkWindows` in PyTorch's loader, by number of workers; needs PyTorch.

    python -m tools.bench.loader DATASET [--camera scene_camera] [--workers 0,1,2] [--batch 64]
    python -m tools.bench.loader EXPORT --lerobot [--camera observation.images.scene_camera] [--frames 4096]

Each number of workers begins without a cache, in a process of its own. The first epoch has the time of decoding all
images into the cache. Memory is the largest resident memory of the main process, and of the largest worker.

With `--lerobot`, the data is an export of `yamsim export lerobot`, and LeRobot's dataset reads it. `--frames` ends an
epoch early, because LeRobot decodes videos again in each epoch.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def measure(dataset: Path, cameras: list[str], workers: int, batch: int, chunk: int, epochs: int) -> dict[str, object]:
    """Return frames, and for each epoch the wall seconds and processor seconds of this process and of its workers."""
    import torch

    from yamsim_cli import ChunkWindows, ShuffledBatches, open_dataset

    cache = Path(tempfile.mkdtemp(prefix="yamsim_loader_"))
    rows = []
    try:
        began, used = time.monotonic(), _processor_seconds()
        windows = ChunkWindows(open_dataset(dataset), cameras, chunk=chunk, cache=cache)
        batches = ShuffledBatches(len(windows), batch)
        for epoch in range(epochs):
            batches.set_epoch(epoch)
            # Workers end with each epoch, so that their processor time is counted.
            loader = torch.utils.data.DataLoader(windows, sampler=batches, batch_size=None, num_workers=workers)
            frames = sum(len(one["action"]) for one in loader)
            rows.append({"wall_s": time.monotonic() - began, "cpu_s": _processor_seconds() - used, "frames": frames})
            began, used = time.monotonic(), _processor_seconds()
        size = sum(file.stat().st_size for file in cache.rglob("*.npy"))
    finally:
        shutil.rmtree(cache, ignore_errors=True)
    return {"workers": workers, "epochs": rows, "cache_bytes": size, "memory_bytes": _largest_memory(workers)}


def measure_lerobot(
    export: Path, cameras: list[str], workers: int, batch: int, chunk: int, epochs: int, frames: int
) -> dict[str, object]:
    """Return what `measure` returns, for the first `frames` shuffled frames of LeRobot's dataset in each epoch."""
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    fps = json.loads((export / "meta" / "info.json").read_text())["fps"]
    began, used = time.monotonic(), _processor_seconds()
    dataset = LeRobotDataset(
        "local/export", root=export, delta_timestamps={"action": [number / fps for number in range(chunk)]}
    )
    rows = []
    for epoch in range(epochs):
        # Workers read ahead, so the sampler ends the epoch.
        chosen = torch.randperm(len(dataset), generator=torch.Generator().manual_seed(epoch))[:frames].tolist()
        loader = torch.utils.data.DataLoader(dataset, batch_size=batch, sampler=chosen, num_workers=workers)
        seen = 0
        for one in loader:
            assert all(camera in one for camera in cameras)
            seen += len(one["action"])
        rows.append({"wall_s": time.monotonic() - began, "cpu_s": _processor_seconds() - used, "frames": seen})
        began, used = time.monotonic(), _processor_seconds()
    return {"workers": workers, "epochs": rows, "cache_bytes": 0, "memory_bytes": _largest_memory(workers)}


def _largest_memory(workers: int) -> dict[str, int]:
    """Return the largest resident memory of this process and of its largest worker, bytes."""
    processes = {"main": resource.RUSAGE_SELF, **({"worker": resource.RUSAGE_CHILDREN} if workers else {})}
    return {name: resource.getrusage(who).ru_maxrss * 1024 for name, who in processes.items()}


def _processor_seconds() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def main() -> None:
    """Measure each number of workers, and print a line for each epoch."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--camera", action="append", help="may be repeated; by default scene_camera")
    parser.add_argument("--lerobot", action="store_true", help="the dataset is an export, which LeRobot reads")
    parser.add_argument("--frames", type=int, default=4096, help="with --lerobot: frames of an epoch")
    parser.add_argument("--workers", default="0,1,2")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--chunk", type=int, default=32)
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--here", action="store_true", help="measure in this process, and print JSON")
    given = parser.parse_args()
    cameras = given.camera or ["observation.images.scene_camera" if given.lerobot else "scene_camera"]
    if given.here:
        common = (given.dataset, cameras, int(given.workers), given.batch, given.chunk, given.epochs)
        found = measure_lerobot(*common, given.frames) if given.lerobot else measure(*common)
        print(json.dumps(found))
        return
    for workers in given.workers.split(","):
        flags = [f"--workers={workers}", f"--batch={given.batch}", f"--chunk={given.chunk}", f"--epochs={given.epochs}"]
        flags += [f"--camera={camera}" for camera in cameras]
        flags += ["--lerobot", f"--frames={given.frames}"] if given.lerobot else []
        command = [sys.executable, "-m", "tools.bench.loader", str(given.dataset), "--here", *flags]
        found = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
        memory = ", ".join(f"{name} {count / 1e6:.0f} MB" for name, count in found["memory_bytes"].items())
        for number, row in enumerate(found["epochs"], 1):
            print(
                f"{workers} workers, epoch {number}: {row['frames'] / row['wall_s']:,.0f} frames/s, "
                f"{row['frames'] / row['cpu_s']:,.0f} frames per processor second; "
                f"memory: {memory}; cache {found['cache_bytes'] / 1e6:.0f} MB",
                flush=True,
            )


if __name__ == "__main__":
    main()
