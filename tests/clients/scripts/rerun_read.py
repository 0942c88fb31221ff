"""Content of an .rrd file by rerun's verifier, and by the storage of its viewer and catalog."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from rerun.server import Server

path = Path(sys.argv[1]).absolute()
verified = subprocess.run(
    [Path(sys.executable).with_name("rerun"), "rrd", "verify", path], capture_output=True, text=True, check=False
)
with Server(datasets={"read": [path]}) as server:
    dataset = server.client().get_dataset("read")
    segments = dataset.segment_table().to_arrow_table().to_pylist()
    table = dataset.reader(index="frame").to_arrow_table().sort_by("frame")
columns = {}
for name in table.column_names:
    if not name.startswith("/"):
        continue
    rows = table[name].to_pylist()
    if name.endswith("EncodedImage:blob"):
        columns[name] = [hashlib.sha256(bytes(row[0])).hexdigest() for row in rows]
    elif not name.endswith(":xyz"):
        columns[name] = [np.ravel(row).tolist() if isinstance(row, list) else row for row in rows]
print(
    json.dumps(
        {
            "verified": verified.returncode == 0,
            "said": verified.stdout + verified.stderr,
            "recordings": {row["rerun_segment_id"]: row["property:RecordingInfo:name"] for row in segments},
            "frames": table["frame"].to_pylist(),
            "seconds": [value.total_seconds() for value in table["time"].to_pylist()],
            "columns": columns,
        },
        default=str,
    )
)
