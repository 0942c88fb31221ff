"""Objects with moving parts as description files: a cabinet with a drawer, in SDFormat, URDF and MJCF."""

from __future__ import annotations

# The drawer opens towards -x, where the arm stands when the cabinet faces it.
SDF = """<?xml version="1.0"?>
<sdf version="1.9"><model name="cabinet">
<static>{static}</static>
<link name="box">
 <inertial><mass>3</mass><pose>0 0 0.03 0 0 0</pose>
  <inertia><ixx>0.02</ixx><iyy>0.02</iyy><izz>0.03</izz></inertia></inertial>
 {walls}
</link>
<link name="drawer"><pose>0 0 0.012 0 0 0</pose>
 <inertial><mass>0.4</mass><pose>0 0 0.02 0 0 0</pose>
  <inertia><ixx>0.001</ixx><iyy>0.001</iyy><izz>0.0015</izz></inertia></inertial>
 {drawer}
</link>
<joint name="slide" type="prismatic"><parent>box</parent><child>drawer</child>
 <axis><xyz>-1 0 0</xyz><limit><lower>0</lower><upper>0.1</upper></limit>
 <dynamics><damping>2</damping><friction>0.5</friction></dynamics></axis></joint>
<frame name="handle_fin" attached_to="drawer"><pose relative_to="drawer">-0.112 0 0.035 3.14159265 0 0</pose></frame>
</model></sdf>
"""

_WALLS = {
    "floor": ((0, 0, 0.005), (0.16, 0.2, 0.01)),
    "left": ((0, 0.095, 0.035), (0.16, 0.01, 0.05)),
    "right": ((0, -0.095, 0.035), (0.16, 0.01, 0.05)),
    "back": ((0.075, 0, 0.035), (0.01, 0.18, 0.05)),
    "top": ((0, 0, 0.065), (0.16, 0.2, 0.01)),
}
# A fin at its front is its handle: fingers from above close on both sides of it.
_DRAWER = {
    "bottom": ((0, 0, 0.003), (0.13, 0.16, 0.006)),
    "front": ((-0.085, 0, 0.02), (0.008, 0.19, 0.055)),
    "side_l": ((-0.008, 0.077, 0.02), (0.146, 0.006, 0.034)),
    "side_r": ((-0.008, -0.077, 0.02), (0.146, 0.006, 0.034)),
    "rear": ((0.062, 0, 0.02), (0.006, 0.15, 0.034)),
    "fin": ((-0.109, 0, 0.03), (0.04, 0.012, 0.04)),
}


def _boxes(parts: dict[str, tuple[tuple[float, ...], tuple[float, ...]]], rgba: str) -> str:
    text = []
    for name, (centre, size) in parts.items():
        at, large = (" ".join(f"{value:g}" for value in values) for values in (centre, size))
        body = f"<pose>{at} 0 0 0</pose><geometry><box><size>{large}</size></box></geometry>"
        text.append(f'<visual name="{name}">{body}<material><diffuse>{rgba}</diffuse></material></visual>')
        text.append(f'<collision name="{name}">{body}</collision>')
    return "\n ".join(text)


def cabinet_sdf(*, static: bool = True) -> str:
    """A cabinet of 16 x 20 x 7 cm with a drawer that opens by 10 cm."""
    return SDF.format(
        static=str(static).lower(), walls=_boxes(_WALLS, "0.75 0.62 0.45 1"), drawer=_boxes(_DRAWER, "0.85 0.8 0.7 1")
    )


URDF = """<?xml version="1.0"?>
<robot name="flip">
<material name="red"><color rgba="0.8 0.1 0.1 1"/></material>
<link name="jar"><inertial><mass value="0.3"/>
 <inertia ixx="3e-4" iyy="3e-4" izz="2e-4" ixy="0" ixz="0" iyz="0"/></inertial>
 <visual><origin xyz="0 0 0.04"/><geometry><cylinder radius="0.03" length="0.08"/></geometry></visual>
 <collision><origin xyz="0 0 0.04"/><geometry><cylinder radius="0.03" length="0.08"/></geometry></collision></link>
<link name="lid"><inertial><origin xyz="-0.03 0 0.003"/><mass value="0.02"/>
 <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
 <visual><origin xyz="-0.03 0 0.003"/><geometry><cylinder radius="0.03" length="0.006"/></geometry>
 <material name="red"/></visual>
 <collision><origin xyz="-0.03 0 0.003"/>
 <geometry><cylinder radius="0.03" length="0.006"/></geometry></collision></link>
<joint name="hinge" type="revolute"><parent link="jar"/>
 <child link="lid"/><origin xyz="0.03 0 0.08"/><axis xyz="0 1 0"/>
 <limit lower="0" upper="1.9" effort="1" velocity="1"/><dynamics damping="0.001" friction="0.002"/></joint>
</robot>
"""

MJCF = """<mujoco model="door"><compiler angle="degree"/>
<asset><material name="wood" rgba="0.5 0.3 0.1 1"/></asset>
<worldbody><body name="frame"><freejoint/>
 <geom name="a" type="box" size="0.06 0.005 0.08" pos="0 0.05 0.08" material="wood" mass="0.5"/>
 <geom name="b" type="box" size="0.005 0.05 0.08" pos="0.055 0 0.08" mass="0.3"/>
 <body name="door" pos="-0.06 -0.05 0.08"><joint name="hinge" type="hinge" axis="0 0 1" range="0 90" damping="0.02"
  frictionloss="0.01"/>
  <geom type="box" size="0.055 0.004 0.075" pos="0.055 0 0" mass="0.2"/>
  <site name="handle_knob" pos="0.1 -0.01 0" xyaxes="0 0 1 1 0 0"/></body>
</body></worldbody></mujoco>
"""
