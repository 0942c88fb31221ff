"""A small scene with the names of ABC's: two arms of boxes, six bottles and a bin."""

from __future__ import annotations

from pathlib import Path

_JOINTS = "".join(
    f'<body pos="0 0 0.02"><joint name="SIDE_joint{k}" axis="0 0 1" armature="0.1" damping="1"/>'
    '<geom size="0.01" mass="0.1" contype="0" conaffinity="0"/>'
    for k in range(1, 7)
)
_ARM = f"""
<body pos="0 Y 0.8">{_JOINTS}
  <site name="SIDE_grasp_site"/><camera name="SIDE" fovy="58"/>
  <body><joint name="SIDE_left_finger" type="slide" axis="0 1 0" range="0 0.05" armature="0.1" damping="1"/>
    <geom size="0.01" mass="0.1" contype="0" conaffinity="0"/></body>
{"</body>" * 6}</body>
"""
_ACTUATORS = "".join(f'<position name="SIDE_joint{k}" joint="SIDE_joint{k}" kp="20" kv="2"/>' for k in range(1, 7))
_TETRAHEDRON = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def write_miniature(folder: Path) -> Path:
    """Write the model files, and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "solid.obj").write_text(_TETRAHEDRON)
    # As in ABC's scene, the sixth bottle's mesh is named after its seventh.
    names = [*(f"bottle_{k}_shape" for k in (0, 1, 2, 3, 4, 7)), "water_bottle_bin"]
    meshes = "".join(f'<mesh name="{name}" file="solid.obj"/>' for name in names)
    bodies = "".join(
        f'<body><freejoint name="bottle_{k + 1}_joint"/>'
        '<inertial pos="0 0 0" mass="0.05" diaginertia="1e-4 1e-4 1e-4"/>'
        f'<geom type="mesh" mesh="{names[k]}" contype="0" conaffinity="0"/></body>'
        for k in range(6)
    )
    arms = [(side, text.replace("SIDE", side)) for side in ("left", "right") for text in (_ARM,)]
    fixed = "".join(f'<camera name="{name}" pos="0 0 2" fovy="58"/>' for name in ("top", "overhead"))
    (folder / "put_bottle.xml").write_text(
        f"""<mujoco><option gravity="0 0 0"/><compiler angle="radian"/><asset>{meshes}</asset><worldbody>
        <light pos="0 0 3"/>{fixed}
        <body><freejoint name="bin_joint"/><inertial pos="0 0 0" mass="0.5" diaginertia="1e-2 1e-2 1e-2"/>
        <geom type="mesh" mesh="water_bottle_bin" contype="0" conaffinity="0"/></body>
        {"".join(text.replace("Y", "0.3" if side == "left" else "-0.3") for side, text in arms)}{bodies}</worldbody>
        <actuator>{
            "".join(
                _ACTUATORS.replace("SIDE", side)
                + f'<position name="{side}_gripper" joint="{side}_left_finger" kp="400" kv="14"/>'
                for side in ("left", "right")
            )
        }</actuator></mujoco>"""
    )
    return folder
