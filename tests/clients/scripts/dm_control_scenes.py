"""dm_control: composed scenes are parsed and stepped from their keyframe; those without boards are attached to an
arena.

Called with folders of scenes; folders after `--attach` are attached too.
"""

import json
import sys

import numpy as np
from dm_control import mjcf

SPAWN = np.array([0.3, -0.2, 0.5])


def rest(root):
    """How far a scene moves in 500 steps from its keyframe."""
    physics = mjcf.Physics.from_mjcf_model(root)
    with physics.reset_context():
        physics.data.qpos[:], physics.data.ctrl[:] = physics.model.key_qpos[0], physics.model.key_ctrl[0]
    start = physics.data.qpos.copy()
    physics.step(500)
    return float(np.abs(physics.data.qpos - start).max()), physics


split = sys.argv.index("--attach")
alone, attached = {}, {}
for path in sys.argv[1:split]:
    moved, physics = rest(mjcf.from_path(path))
    alone[path] = {"nq": int(physics.model.nq), "nu": int(physics.model.nu), "moved": moved}
for path in sys.argv[split + 1 :]:
    scene = mjcf.from_path(path)
    arena = mjcf.RootElement(model="arena")
    arena.worldbody.add("geom", name="ground", type="plane", size=[2, 2, 0.1], pos=[0, 0, -1])
    frame = arena.attach(scene)
    frame.pos = SPAWN
    moved, physics = rest(arena)
    hand = physics.bind(scene.find("body", "link_6")).xpos
    alone_at = mjcf.Physics.from_mjcf_model(mjcf.from_path(path))
    with alone_at.reset_context():
        alone_at.data.qpos[:] = alone_at.model.key_qpos[0]
    off = np.asarray(hand) - SPAWN - alone_at.named.data.xpos["link_6"]
    attached[path] = {"nu": int(physics.model.nu), "moved": moved, "hand_off": float(np.abs(off).max())}
print(json.dumps({"scenes": alone, "attached": attached}))
