"""Plain MuJoCo: a picture of a composed scene in its keyframe, as an array (480, 640, 3) in a .npy file."""

import json
import sys

import mujoco
import numpy as np

scene, out = sys.argv[1:]
model = mujoco.MjModel.from_xml_path(scene)
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 480, 640) as renderer:
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance, camera.azimuth, camera.elevation = [0.3, 0, 0], 1.4, 150, -35
    renderer.update_scene(data, camera)
    np.save(out, renderer.render())
print(json.dumps({"mujoco": mujoco.__version__}))
