"""A fictitious arm of five joints and a gripper, as files of a user."""

from __future__ import annotations

from pathlib import Path

ARM = "stick"
GRIPPER = "tongs"
RIG = "sticks_rig"

_ARM_YAML = """\
mjcf: arm.xml
source: made up for a test
base: foot
flange: wrist_roll
joints:
- {name: turn, range: [-3, 3], motor_rpm: 52.5, reported_rad_s: 10}
- {name: shoulder, range: [-1.8, 1.8], motor_rpm: 52.5, reported_rad_s: 10}
- {name: elbow, range: [0, 2.8], motor_rpm: 52.5, reported_rad_s: 10}
- {name: wrist, range: [-0.5, 3], motor_rpm: 200, reported_rad_s: 30}
- {name: roll, range: [-3.1, 3.1], motor_rpm: 200, reported_rad_s: 30}
home: [0, -0.4, 2.0, 1.5, 0]
start: [0, 0.30, 1.29, 1.55, 0]
"""

_ARM_XML = """\
<mujoco model="stick">
  <compiler angle="radian" autolimits="true"/>
  <option integrator="implicitfast"/>
  <default>
    <default class="stick">
      <joint axis="0 1 0" armature="0.02" frictionloss="0.1"/>
      <position inheritrange="1" kp="80" kv="5" forcerange="-28 28"/>
      <geom type="capsule" size="0.025" group="3" mass="0" rgba="0.2 0.4 0.7 1"/>
    </default>
  </default>
  <worldbody>
    <body name="foot" childclass="stick">
      <inertial mass="1" pos="0 0 0.02" diaginertia="0.002 0.002 0.002"/>
      <geom type="cylinder" size="0.05 0.02" pos="0 0 0.02"/>
      <body name="turret" pos="0 0 0.06" gravcomp="1">
        <inertial mass="0.3" pos="0 0 0.02" diaginertia="0.0002 0.0002 0.0002"/>
        <joint name="turn" axis="0 0 1"/>
        <body name="upper" pos="0 0 0.06" gravcomp="1">
          <inertial mass="0.8" pos="0 0 0.17" diaginertia="0.008 0.008 0.0004"/>
          <joint name="shoulder"/>
          <geom fromto="0 0 0 0 0 0.34"/>
          <body name="lower" pos="0 0 0.34" gravcomp="1">
            <inertial mass="0.5" pos="0 0 0.16" diaginertia="0.004 0.004 0.0003"/>
            <joint name="elbow"/>
            <geom fromto="0 0 0.06 0 0 0.28" size="0.02"/>
            <body name="wrist_pitch" pos="0 0 0.32" gravcomp="1">
              <inertial mass="0.3" pos="0 0 0.03" diaginertia="0.0003 0.0003 0.0002"/>
              <joint name="wrist"/>
              <body name="wrist_roll" pos="0 0 0.07" gravcomp="1">
                <inertial mass="1e-6" pos="0 0 0" diaginertia="1e-9 1e-9 1e-9"/>
                <joint name="roll" axis="0 0 1"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="turn" joint="turn" class="stick"/>
    <position name="shoulder" joint="shoulder" class="stick"/>
    <position name="elbow" joint="elbow" class="stick"/>
    <position name="wrist" joint="wrist" class="stick"/>
    <position name="roll" joint="roll" class="stick"/>
  </actuator>
</mujoco>
"""

_GRIPPER_YAML = """\
mjcf: gripper.xml
source: made up for a test
fingers:
  joints: [thumb, finger]
  bodies: [thumb_body, finger_body]
  drive: squeeze
  range: [-0.004, 0.05]
  full_opening: 0.05
  start_opening: 0.04
  radius: 0.012
  pads: true
wrist_camera: {position: [0, 0.07, 0.05], x_axis: [-1, 0, 0], y_axis: [0, -0.9, -0.43], fovy_deg: 60}
arms:
  stick: {}
  i2rt_yam: {}
"""

# A hand of two plates; its fingers are mirror images: one's joint counts up and the other's down.
_GRIPPER_XML = """\
<mujoco model="tongs">
  <compiler angle="radian" autolimits="true"/>
  <default>
    <default class="hand">
      <joint type="slide" axis="0 1 0" frictionloss="0.1" armature="0.1"/>
      <geom type="box" group="3" mass="0" rgba="0.3 0.3 0.3 1"/>
      <position kp="2000" kv="150" ctrlrange="-0.004 0.05" forcerange="-100 100"/>
      <default class="pad">
        <geom condim="6" friction="1 5e-3 5e-4" solref="0.01 1" priority="1" size="0.009 0.003 0.02"
              rgba="0.1 0.1 0.1 1"/>
      </default>
    </default>
  </default>
  <worldbody>
    <body name="palm" childclass="hand">
      <inertial mass="0.4" pos="0 0 0.03" diaginertia="0.0004 0.0004 0.0003"/>
      <geom size="0.02 0.05 0.015" pos="0 0 0.045"/>
      <site name="grasp_site" pos="0 0 0.13"/>
      <site name="pinch_site" pos="0 0 0.13"/>
      <body name="thumb_body" pos="0 0 0.06" gravcomp="1">
        <inertial mass="0.05" pos="0 0.005 0.04" diaginertia="4e-5 4e-5 1e-5"/>
        <joint name="thumb"/>
        <geom name="thumb_pad" class="pad" pos="0 0.003 0.07"/>
        <geom size="0.008 0.004 0.03" pos="0 0.01 0.03"/>
      </body>
      <body name="finger_body" pos="0 0 0.06" gravcomp="1">
        <inertial mass="0.05" pos="0 -0.005 0.04" diaginertia="4e-5 4e-5 1e-5"/>
        <joint name="finger"/>
        <geom name="finger_pad" class="pad" pos="0 -0.003 0.07"/>
        <geom size="0.008 0.004 0.03" pos="0 -0.01 0.03"/>
      </body>
    </body>
  </worldbody>
  <equality>
    <joint name="coupling" joint1="thumb" joint2="finger" polycoef="0 -1 0 0 0"/>
  </equality>
  <contact>
    <exclude body1="palm" body2="thumb_body"/>
    <exclude body1="palm" body2="finger_body"/>
    <exclude body1="thumb_body" body2="finger_body"/>
  </contact>
  <actuator>
    <position name="squeeze" joint="thumb" class="hand"/>
  </actuator>
</mujoco>
"""

_RIG_YAML = f"""\
arms:
- {{name: only, side: right, model: {ARM}, gripper: {GRIPPER}}}
"""


def write_robot(data: Path) -> None:
    """Write the arm, its gripper and their rig into a data folder, as `YAMSIM_DATA_DIR` names it."""
    files = {
        f"robot_models/{ARM}/model.yaml": _ARM_YAML,
        f"robot_models/{ARM}/arm.xml": _ARM_XML,
        f"robot_models/grippers/{GRIPPER}/gripper.yaml": _GRIPPER_YAML,
        f"robot_models/grippers/{GRIPPER}/gripper.xml": _GRIPPER_XML,
        f"configs/rigs/{RIG}.yaml": _RIG_YAML,
    }
    for name, text in files.items():
        (data / name).parent.mkdir(parents=True, exist_ok=True)
        (data / name).write_text(text, encoding="utf-8")
