"""Plain MuJoCo: a recorded episode's commands in a composed scene, and the arrays of the model that was read.

Called with scene.xml, the episode and the file to write, both .npz.
"""

import json
import sys

import mujoco
import numpy as np

# All model arrays on which its motion depends.
FIELDS = """
body_parentid body_pos body_quat body_ipos body_iquat body_mass body_inertia body_gravcomp body_mocapid
jnt_type jnt_pos jnt_axis jnt_range jnt_limited jnt_stiffness jnt_margin jnt_solref jnt_solimp jnt_actfrclimited
dof_armature dof_damping dof_frictionloss dof_solref dof_solimp qpos0 qpos_spring
geom_type geom_bodyid geom_contype geom_conaffinity geom_condim geom_priority geom_friction geom_solmix geom_solref
geom_solimp geom_margin geom_gap site_pos site_quat cam_pos cam_quat cam_fovy
actuator_trntype actuator_trnid actuator_gaintype actuator_gainprm actuator_biastype actuator_biasprm actuator_dyntype
actuator_dynprm actuator_gear actuator_ctrllimited actuator_ctrlrange actuator_forcelimited actuator_forcerange
eq_type eq_obj1id eq_obj2id eq_active0 eq_solref eq_solimp exclude_signature key_qpos key_ctrl
"""
OPTIONS = """
timestep gravity wind density viscosity impratio integrator cone jacobian solver iterations tolerance ls_iterations
ls_tolerance noslip_iterations noslip_tolerance ccd_iterations ccd_tolerance o_margin o_solref o_solimp o_friction
"""


def arrays(model):
    found = {name: np.array(getattr(model, name)) for name in FIELDS.split()}
    found |= {f"opt.{name}": np.array(getattr(model.opt, name)) for name in OPTIONS.split()}
    # Meshes are visual only; MuJoCo computes a mesh's centre itself.
    solid = model.geom_type != mujoco.mjtGeom.mjGEOM_MESH
    found |= {name: getattr(model, name)[solid] for name in ("geom_pos", "geom_quat", "geom_size")}
    # Newer versions have a further number: whether a weld connects bodies or sites.
    return found | {"eq_data": model.eq_data[:, :11].copy()}


def hold(model, data, weld, hand, item):
    """Make a weld hold an object at its present place in the hand."""
    hand, item = data.body(hand), data.body(item)
    position, quat, inverse = np.empty(3), np.empty(4), np.empty(4)
    mujoco.mju_negQuat(inverse, hand.xquat)
    mujoco.mju_rotVecQuat(position, item.xpos - hand.xpos, inverse)
    mujoco.mju_mulQuat(quat, inverse, item.xquat)
    model.eq_data[weld, :11] = [0, 0, 0, *position, *quat, 1]


scene, episode, out = sys.argv[1:]
model = mujoco.MjModel.from_xml_path(scene)
read = arrays(model)
with np.load(episode) as file:
    start, ctrl, holds, steps = file["qpos"], file["ctrl"], file["holds"], int(file["steps"])
    welds = [model.equality(str(name)).id for name in file["welds"]]
    hands, item = [str(name) for name in file["hands"]], str(file["item"])
data = mujoco.MjData(model)
data.qpos[:] = start
mujoco.mj_forward(model, data)
states = []
for command, held in zip(ctrl, holds, strict=True):
    mujoco.mj_kinematics(model, data)
    for weld, hand, on in zip(welds, hands, held, strict=True):
        if on and not data.eq_active[weld]:
            hold(model, data, weld, hand, item)
        data.eq_active[weld] = on
    data.ctrl[:] = command
    for _ in range(steps):
        mujoco.mj_step(model, data)
    states.append(data.qpos.copy())
np.savez(out, states=states, **read)
print(json.dumps({"ticks": len(states), "mujoco": mujoco.__version__}))
