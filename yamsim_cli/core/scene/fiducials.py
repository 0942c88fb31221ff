"""The marker board beside an arm's base, and the board's mount, as mocap bodies.

Each body has the pose of its arm's base. Its geom has the constant pose of the board or mount in the base's frame.
"""

from __future__ import annotations

from pathlib import Path

import mujoco

from ..config.rig import ArmConfig, BoardConfig, MountConfig
from ..errors import ConfigError
from ..geometry.board_mount import mount_mesh
from ..geometry.se3 import Array, quat_from_rotation
from ..geometry.stl import encode_stl
from ..images.board_image import board_texture
from ..images.png import encode_png
from .objects.object_geoms import VISIBLE_GROUP

BOARD_BODY = "base_board"
MOUNT_BODY = "base_mount"

_STL_SCALE = (0.001, 0.001, 0.001)  # m per mm; files for 3D printers are in millimetres


def add_base_board(spec: mujoco.MjSpec, arm: ArmConfig, T_base_in_world: Array) -> None:
    """Add an arm's board and mount, if any, as bodies `<prefix>base_board` and `<prefix>base_mount`."""
    if arm.mount is not None:
        _add_mount(spec, arm, arm.mount, T_base_in_world)
    if arm.board is not None:
        _add_board(spec, arm, arm.board, T_base_in_world)


def _mocap_body(spec: mujoco.MjSpec, name: str, T_base_in_world: Array) -> mujoco.MjsBody:
    return spec.worldbody.add_body(
        name=name, mocap=True, pos=T_base_in_world[:3, 3], quat=quat_from_rotation(T_base_in_world[:3, :3])
    )


def _add_board(spec: mujoco.MjSpec, arm: ArmConfig, config: BoardConfig, T_base_in_world: Array) -> None:
    board, name = config.board_in_metres, f"{arm.prefix}{BOARD_BODY}"
    file = f"textures/{config.name}.png"
    spec.assets = {**spec.assets, file: encode_png(board_texture(board))}
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file)
    # Specular highlights would overexpose markers.
    material = spec.add_material(name=name, specular=0, shininess=0, texuniform=False)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
    T = arm.T_board_in_base
    _mocap_body(spec, name, T_base_in_world).add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=T[:3, 3],
        quat=quat_from_rotation(T[:3, :3]),
        size=[board.width / 2, board.height / 2, 0.01],
        material=material.name,
        group=VISIBLE_GROUP,
        contype=0,
        conaffinity=0,
        castshadow=False,
    )


def _add_mount(spec: mujoco.MjSpec, arm: ArmConfig, config: MountConfig, T_base_in_world: Array) -> None:
    name = f"{arm.prefix}{MOUNT_BODY}"
    T = arm.robot.T_base_mesh
    file = f"meshes/mounts/{config.name}.stl"
    spec.assets = {**spec.assets, file: _mount_stl(config, arm.board)}
    # A negative scale mirrors a user's STL. `mount_mesh` has already mirrored a generated mount.
    scale = (-_STL_SCALE[0], *_STL_SCALE[1:]) if config.stl and config.mirror_x else _STL_SCALE
    spec.add_mesh(name=name, file=file, scale=scale)
    material = spec.add_material(name=name, rgba=(0.93, 0.93, 0.93, 1), specular=0.1, shininess=0.1)
    _mocap_body(spec, name, T_base_in_world).add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        pos=T[:3, 3],
        quat=quat_from_rotation(T[:3, :3]),
        material=material.name,
        group=VISIBLE_GROUP,
        contype=0,
        conaffinity=0,
    )


def _mount_stl(config: MountConfig, board: BoardConfig | None) -> bytes:
    """Return the mount's STL, mm, in the frame of the base's mesh."""
    if config.stl is not None:
        try:
            return Path(config.stl).read_bytes()
        except OSError as error:
            raise ConfigError(f"mount {config.name!r}: stl {config.stl} cannot be read: {error.strerror}") from error
    if board is None:
        raise ConfigError(f"mount {config.name!r} has neither a board nor an stl; give one, or leave the mount out")
    size_mm = (board.board_in_metres.width * 1000, board.board_in_metres.height * 1000)
    vertices, faces = mount_mesh(
        config.x_mm, config.y_mm, config.z_mm, board.position_mm, size_mm, mirror_x=config.mirror_x
    )
    return encode_stl(vertices * 1000, faces)
