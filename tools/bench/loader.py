"""Frames a second of `ChunkWindows` in PyTorch's loader, by number of workers; needs PyTorch.

    python -m tools.bench.loader DATASET [--camera scene_camera] [--workers 0,1,2] [--batch 64]

Each number of workers begins without a cache, in a process of its own. The first epoch has the time of decoding all
images into the cache. Memory is the largest resident memory of the main process, and of the largest worker.
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

from yamsim_cli import ChunkWindows, ShuffledBatches, open_dataset


def measure(dataset: Path, cameras: list[str], workers: int, batch: int, chunk: int, epochs: int) -> dict[str, object]:
    """Return frames, and for each epoch the wall seconds and processor seconds of this process and of its workers."""
    import torch

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
    processes = {"main": resource.RUSAGE_SELF, **({"worker": resource.RUSAGE_CHILDREN} if workers else {})}
    memory = {name: resource.getrusage(who).ru_maxrss * 1024 for name, who in processes.items()}
    return {"workers": workers, "epochs": rows, "cache_bytes": size, "memory_bytes": memory}


def _processor_seconds() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def main() -> None:
    """Measure each number of workers, and print a line for each epoch."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--camera", action="append", help="may be repeated; by default scene_camera")
    parser.add_argument("--workers", default="0,1,2")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--chunk", type=int, default=32)
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--here", action="store_true", help="measure in this process, and print JSON")
    given = parser.parse_args()
    cameras = given.camera or ["scene_camera"]
    if given.here:
        found = measure(given.dataset, cameras, int(given.workers), given.batch, given.chunk, given.epochs)
        print(json.dumps(found))
        return
    for workers in given.workers.split(","):
        flags = [f"--workers={workers}", f"--batch={given.batch}", f"--chunk={given.chunk}", f"--epochs={given.epochs}"]
        flags += [f"--camera={camera}" for camera in cameras]
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
