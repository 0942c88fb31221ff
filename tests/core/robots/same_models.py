"""Compiled scenes as hashes of their arrays: recordings repeat only in the same models."""

from __future__ import annotations

import hashlib
import re

import mujoco
import numpy as np

# All arrays of physics, rendering and recording; sizes follow from these.
ARRAYS = (
    *("body_parentid", "body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos", "body_iquat"),
    *("body_gravcomp", "jnt_type", "jnt_bodyid", "jnt_axis", "jnt_range", "dof_armature", "dof_frictionloss"),
    *("dof_invweight0", "qpos0", "geom_type", "geom_bodyid", "geom_size", "geom_pos", "geom_quat", "geom_friction"),
    *("geom_solref", "geom_solimp", "geom_condim", "geom_priority", "geom_contype", "geom_conaffinity"),
    *("geom_group", "geom_rgba", "geom_matid", "mat_rgba", "site_bodyid", "site_pos", "site_quat", "cam_bodyid"),
    *("cam_pos", "cam_quat", "cam_fovy", "exclude_signature", "eq_type", "eq_obj1id", "eq_obj2id", "eq_data"),
    *("actuator_trnid", "actuator_gainprm", "actuator_biasprm", "actuator_ctrlrange", "actuator_forcerange"),
)


# Shadow casters of the table, the posts and the banana; the banana's first two looks are its brown ends.
SHADOW_CASTER = re.compile(r".*_core|banana_look_[2-9]")


def figures(model: mujoco.MjModel) -> dict[str, str]:
    """Array -> hash of its content, to ten decimals; and one hash of all names.

    Shadow-casting geoms are omitted: they touch nothing, are hidden, and are newer than the kept figures.
    """
    casts = [SHADOW_CASTER.fullmatch(model.geom(k).name) is not None for k in range(model.ngeom)]
    assert not np.any(model.geom_contype[casts] | model.geom_conaffinity[casts])
    names = bytes(model.names)
    for k in np.flatnonzero(casts):
        names = names.replace(model.geom(k).name.encode() + b"\0", b"", 1)
    found = {"names": hashlib.sha256(names).hexdigest()[:16]}
    for name in ARRAYS:
        array = np.asarray(getattr(model, name))
        if name.startswith("geom_"):
            array = array[np.logical_not(casts)]
        plain = np.round(array.astype(np.float64), 10) + 0.0
        found[name] = hashlib.sha256(f"{array.shape}".encode() + plain.tobytes()).hexdigest()[:16]
    return found
