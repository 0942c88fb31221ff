"""The files of a new arm, with comments, for a user to change."""

from __future__ import annotations

from collections.abc import Mapping

_YAML = """\
# The arm {name}: check it with `yamsim robots check {name}`; `--rig {name}+linear_4310` then means it in every command.
mjcf: arm.xml
source: a skeleton, its figures are invented   # where your figures are from
base: base_link     # the body in arm.xml whose frame is the arm's base frame
flange: flange      # the last body; a gripper becomes part of it

# From the base to the flange: stops, rad; the motor's no-load speed at the joint, revolutions a minute; and the fastest
# motion that the drive reports, rad/s. The names are those of joints, and of their drives, in arm.xml.
joints:
- {{name: joint1, range: [-3.0, 3.0], motor_rpm: 52.5, reported_rad_s: 10}}
- {{name: joint2, range: [-1.8, 1.8], motor_rpm: 52.5, reported_rad_s: 10}}
- {{name: joint3, range: [0.0, 2.8], motor_rpm: 52.5, reported_rad_s: 10}}
- {{name: joint4, range: [-0.5, 3.0], motor_rpm: 200, reported_rad_s: 30}}
- {{name: joint5, range: [-1.5, 1.5], motor_rpm: 200, reported_rad_s: 30}}
- {{name: joint6, range: [-3.1, 3.1], motor_rpm: 200, reported_rad_s: 30}}
home: [0, -0.4, 2.0, 1.5, 0, 0]      # at rest, rad
start: [0, 0.3, 1.29, 1.55, 0, 0]    # where tasks start, rad

# Gripper -> how it sits on the flange: `mount: {{position: [x, y, z], quat: [w, x, y, z]}}`, m.
grippers:
  linear_4310: {{}}
"""

_XML = """\
<!-- From the base to the flange, with a position drive for each joint. Lengths in m, masses in kg. -->
<mujoco model="{name}">
  <compiler angle="radian" autolimits="true"/>
  <option integrator="implicitfast"/>
  <default>
    <default class="{name}">
      <joint axis="0 1 0" armature="0.02" frictionloss="0.1"/>
      <!-- kp in N m/rad, kv in N m s/rad, torques in N m; the range is that of the joint. -->
      <position inheritrange="1" kp="80" kv="5" forcerange="-28 28"/>
      <!-- What collides; its masses are in the <inertial> of each body. -->
      <geom type="capsule" size="0.025" group="3" mass="0" rgba="0.5 0.5 0.5 1"/>
    </default>
  </default>
  <worldbody>
    <body name="base_link" childclass="{name}">
      <inertial mass="1" pos="0 0 0.02" diaginertia="0.002 0.002 0.002"/>
      <geom type="cylinder" size="0.05 0.02" pos="0 0 0.02"/>
      <!-- gravcomp="1": the drives make up for the body's weight. -->
      <body name="link1" pos="0 0 0.06" gravcomp="1">
        <inertial mass="0.3" pos="0 0 0.02" diaginertia="0.0002 0.0002 0.0002"/>
        <joint name="joint1" axis="0 0 1"/>
        <body name="link2" pos="0 0 0.06" gravcomp="1">
          <inertial mass="0.8" pos="0 0 0.17" diaginertia="0.008 0.008 0.0004"/>
          <joint name="joint2"/>
          <geom fromto="0 0 0 0 0 0.30"/>
          <body name="link3" pos="0 0 0.34" gravcomp="1">
            <inertial mass="0.5" pos="0 0 0.16" diaginertia="0.004 0.004 0.0003"/>
            <joint name="joint3"/>
            <geom fromto="0 0 0.06 0 0 0.24" size="0.02"/>
            <body name="link4" pos="0 0 0.30" gravcomp="1">
              <inertial mass="0.2" pos="0 0 0.02" diaginertia="0.0002 0.0002 0.0002"/>
              <joint name="joint4"/>
              <body name="link5" pos="0 0 0.05" gravcomp="1">
                <inertial mass="0.2" pos="0 0 0.02" diaginertia="0.0002 0.0002 0.0002"/>
                <joint name="joint5" axis="1 0 0"/>
                <body name="flange" pos="0 0 0.04" gravcomp="1">
                  <inertial mass="1e-6" pos="0 0 0" diaginertia="1e-9 1e-9 1e-9"/>
                  <joint name="joint6" axis="0 0 1"/>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
{drives}
  </actuator>
</mujoco>
"""


def arm_files(name: str) -> Mapping[str, str]:
    """File name -> text of the skeleton of an arm of six joints."""
    names = [f"joint{k}" for k in range(1, 7)]
    drives = "\n".join(f'    <position name="{one}" joint="{one}" class="{name}"/>' for one in names)
    return {"model.yaml": _YAML.format(name=name), "arm.xml": _XML.format(name=name, drives=drives)}
