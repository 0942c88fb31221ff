"""Output of raiden's sharder, unmodified, for an export: `raiden_shards.py CHECKOUT EXPORT OUT CAMERA`."""

from __future__ import annotations

import io
import json
import os
import sys
import tarfile
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

CHECKOUT, EXPORT, OUT, CAMERA = (*map(Path, sys.argv[1:4]), sys.argv[4])

# raiden keeps its configuration below the home.
os.environ["HOME"] = str(OUT)
sys.path.insert(0, str(CHECKOUT))
sys.modules["rerun"] = mock.MagicMock()

from raiden import shardify  # noqa: E402

# It finds cameras by their poses, which were not recorded.
config = shardify.ShardifyConfig(
    output_dir=OUT / "shards", resize_images_size=(96, 96), use_depth=False, camera_names=[CAMERA]
)
shardify.run_shardify(sorted(path for path in EXPORT.iterdir() if path.is_dir()), config)
pictures, said, controls = 0, set(), set()
samples: dict[str, dict[str, Any]] = {}
for tar in sorted((OUT / "shards" / "shards").glob("*.tar")):
    with tarfile.open(tar) as archive:
        for member in archive:
            name, _, kind = member.name.partition(".")
            file = archive.extractfile(member)
            assert file is not None
            pictures += kind.endswith(".jpg")
            if kind == "language_instructions.json":
                said.update(json.loads(file.read())["original"])
            elif kind == "metadata.json":
                told = json.loads(file.read())
                controls.add(told["control"])
                samples.setdefault(name, {})["anchor"] = (told["anchor_timestep"], told["anchor_relative_idx"])
            elif kind == "lowdim.npz":
                with np.load(io.BytesIO(file.read())) as held:
                    samples.setdefault(name, {}).update(
                        {key: held[key] for key in held.files if "joint_position" in key}
                    )
rows: dict[str, dict[int, list[float]]] = {}
for sample in samples.values():
    frame, row = sample.pop("anchor")
    for key, window in sample.items():
        rows.setdefault(key.partition("::")[0], {})[frame] = window[row].tolist()
print(json.dumps({"pictures": pictures, "said": sorted(said), "controls": sorted(controls), "rows": rows}))
