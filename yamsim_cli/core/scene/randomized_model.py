from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.randomization import RandomizationConfig, SurfaceRanges
from ..config.recording import SCENE_CAMERA
from ..config.scene import SceneConfig
from ..config.variation import ArmDynamicsSample, LightSample, RandomizationSample, SurfaceSample
from ..files.resources import MeshFolders
from ..geometry.se3 import Array, UprightPose, pose_from_quat, quat_from_rotation, rotation_from_vector, rotation_z
from .compiled import ArmAddresses, CompiledScene
from .objects.object_geoms import HIDDEN_GROUP
from .objects.scene_object import add_object

_ABSENT_GROUP, _ABSENT_POSITION = 4, (0.0, 0.0, -5.0)  # unrendered geom group and position, m, of unused distractors
_TEXTURED = "_textured"
_TEXTURE_SIZE = 256  # px, edge of a texture
_OCTAVES = 4  # noise grids, each twice as fine as the previous one
_FLOOR_TEXTURE = "floor_tiles"
_FLOOR_REPEAT = 8  # per repetition of the table's texture: the floor is ten times as wide
_SURFACES = {"table": "table", "floor": "safety_plane"}  # surface in the config -> name of its geom

_RANDOMIZED_FIELDS = (  # fields of `MjModel` that a variation can change; `apply_randomization` resets them
    "light_diffuse", "light_dir", "light_pos",
    "body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "body_pos", "body_quat",
    "dof_M0", "dof_invweight0", "tendon_invweight0", "actuator_acc0", "cam_poscom0", "light_poscom0",
    "geom_friction", "geom_matid", "geom_group", "geom_contype", "geom_conaffinity",
    "cam_fovy", "cam_pos", "cam_quat", "mat_rgba", "mat_specular", "mat_shininess",
)  # fmt: skip
_SAVED_HEADLIGHT = ("ambient", "diffuse")


def _is_textured(ranges: SurfaceRanges | None, part: str) -> bool:
    """The floor's checker pattern is a mesh, so it needs no image texture."""
    untextured = {"plain", "checker"} if part == "floor" else {"plain"}
    return ranges is not None and not untextured.issuperset(ranges.textures)


def add_randomized_parts(spec: mujoco.MjSpec, config: RandomizationConfig, meshes: MeshFolders) -> None:
    """Add the distractors of a randomization config, and materials with an image texture, to a scene's spec."""
    for item in config.distractor_configs:
        add_object(spec, item, meshes, fixed=True)
    for part in _SURFACES:
        if _is_textured(getattr(config, part), part):
            name = part + _TEXTURED
            spec.add_texture(
                name=name,
                type=mujoco.mjtTexture.mjTEXTURE_2D,
                builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
                rgb1=(1, 1, 1),
                width=_TEXTURE_SIZE,
                height=_TEXTURE_SIZE,
            )
            repeat = _FLOOR_REPEAT if part == "floor" else 1
            material = spec.add_material(
                name=name, specular=0.1, shininess=0.1, texuniform=False, texrepeat=[repeat, repeat]
            )
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


class RandomizedModel:
    """A compiled model with the parts of `add_randomized_parts`, which is reset and then varied for each attempt.

    Renderers must upload `textures`, whose ids the last `apply_randomization` changed.
    """

    def __init__(self, model: mujoco.MjModel, config: RandomizationConfig, scene: SceneConfig) -> None:
        self._model = model
        self._camera = model.cam(SCENE_CAMERA).id
        self._lights = [model.light(f"light_{k}").id for k in range(len(scene.lights))]
        self._extras = {item.name: model.body(item.name).id for item in config.distractor_configs}
        self._materials = {model.material(k).name: k for k in range(model.nmat)}
        of_body = model.body_rootid[model.geom_bodyid]
        self._distractor_geoms = {body: list(np.flatnonzero(of_body == body)) for body in self._extras.values()}
        self._saved = {key: getattr(model, key).copy() for key in _RANDOMIZED_FIELDS}
        self._headlight = {key: getattr(model.vis.headlight, key).copy() for key in _SAVED_HEADLIGHT}
        self.textures: list[int] = []

    def apply_randomization(self, variation: RandomizationSample) -> None:
        """Reset the model to its compiled values, and apply a variation."""
        model = self._model
        for key, value in self._saved.items():
            getattr(model, key)[:] = value
        for key, value in self._headlight.items():
            getattr(model.vis.headlight, key)[:] = value
        self.textures = []
        # Masses come first, because `scale_masses` recomputes constants from the whole model.
        if variation.mass:
            scale_masses(model, variation.mass)
        for number, light in zip(self._lights, variation.lights, strict=False):
            self._apply_light(number, light)
        if variation.headlight:
            model.vis.headlight.diffuse *= variation.headlight[0]
            model.vis.headlight.ambient *= variation.headlight[1]
        for name, factor in variation.friction.items():
            self._apply_friction(name, factor)
        if variation.lens_deg is not None:
            model.cam_fovy[self._camera] += variation.lens_deg
        if variation.camera:
            self._move_camera(np.array(variation.camera))
        for part, surface in (("table", variation.table), ("floor", variation.floor)):
            if surface:
                self._apply_surface(part, surface)
        for name, look in variation.looks.items():
            material = self._materials[name]
            model.mat_rgba[material, :3] = look.rgb
            model.mat_specular[material], model.mat_shininess[material] = look.specular, look.shininess
        for name in self._extras:
            self.place_distractor(name, variation.distractors.get(name))

    def place_distractor(self, name: str, where: UprightPose | None) -> None:
        """Place a distractor at `[x, y, z, yaw]` in `world`, m and rad, or remove it if None."""
        model, body = self._model, self._extras[name]
        geoms = self._distractor_geoms[body]
        if where is None:
            model.body_pos[body] = _ABSENT_POSITION
            model.geom_group[geoms] = _ABSENT_GROUP
            model.geom_contype[geoms] = model.geom_conaffinity[geoms] = 0
            return
        x, y, z, yaw = where
        model.body_pos[body] = x, y, z
        model.body_quat[body] = quat_from_rotation(rotation_z(yaw))
        for key in ("geom_group", "geom_contype", "geom_conaffinity"):
            getattr(model, key)[geoms] = self._saved[key][geoms]

    def _apply_light(self, number: int, light: LightSample) -> None:
        model = self._model
        centre = model.light_pos[number] + model.light_dir[number]
        direction = rotation_from_vector(light.turn) @ model.light_dir[number]
        model.light_dir[number] = direction
        # The position of a directional light only centres its shadow map, so the map keeps its centre.
        model.light_pos[number] = centre - direction
        model.light_diffuse[number] *= light.colour

    def _apply_friction(self, name: str, factor: float) -> None:
        model = self._model
        if name in _SURFACES:
            geoms = [model.geom(_SURFACES[name]).id]
        else:
            geoms = list(np.flatnonzero(model.body_rootid[model.geom_bodyid] == model.body(name).id))
        model.geom_friction[geoms, 0] *= factor

    def _move_camera(self, moved: Array) -> None:
        model, camera = self._model, self._camera
        R = pose_from_quat((0, 0, 0), model.cam_quat[camera])[:3, :3]
        model.cam_pos[camera] += moved[:3]
        model.cam_quat[camera] = quat_from_rotation(rotation_from_vector(moved[3:]) @ R)

    def _apply_surface(self, part: str, surface: SurfaceSample) -> None:
        model = self._model
        tiles = part == "floor" and surface.texture in ("plain", "checker")
        if tiles or surface.texture == "plain":
            for material, colour in zip((part, _FLOOR_TEXTURE), surface.colours, strict=True):
                if material == part or part == "floor":
                    model.mat_rgba[self._materials[material], :3] = colour
            return
        material = part + _TEXTURED
        model.geom_matid[model.geom(_SURFACES[part]).id] = self._materials[material]
        if part == "floor":
            model.geom_group[model.geom(_FLOOR_TEXTURE).id] = HIDDEN_GROUP
        texture = model.texture(material).id
        start = int(model.tex_adr[texture])
        image = texture_image(surface)
        model.tex_data[start : start + image.size] = image.ravel()
        self.textures.append(texture)


def scale_masses(model: mujoco.MjModel, factors: Mapping[str, float]) -> None:
    """Multiply the masses and inertias of objects with their links, and recompute MuJoCo's derived constants."""
    for name, factor in factors.items():
        bodies = model.body_rootid == model.body(name).id
        model.body_mass[bodies] *= factor
        model.body_inertia[bodies] *= factor
    mujoco.mj_setConst(model, mujoco.MjData(model))


def texture_image(surface: SurfaceSample, size: int = _TEXTURE_SIZE) -> NDArray[np.uint8]:
    """Return the RGB image (size, size, 3) of a surface's pattern. Opposite edges match, except for a gradient."""
    first, second = np.array(surface.colours) * 255.0
    match surface.texture:
        case "checker":
            cell = np.arange(size) * 2 * surface.repeat // size
            share = ((cell[:, None] + cell[None, :]) % 2).astype(float)
        case "gradient":
            turn = 2 * np.pi * np.random.default_rng(surface.seed).uniform()
            along = np.linspace(-0.5, 0.5, size)
            share = 0.5 + (along[:, None] * np.sin(turn) + along[None, :] * np.cos(turn)) / np.sqrt(2)
        case "noise":
            share = _smooth_noise(np.random.default_rng(surface.seed), surface.repeat, size)
        case _:
            share = np.zeros((size, size))
    image: NDArray[np.uint8] = np.rint(first + share[..., None] * (second - first)).astype(np.uint8)
    return image


def _smooth_noise(rng: np.random.Generator, cells: int, size: int) -> NDArray[np.float64]:
    """Return smooth noise (size, size) in 0..1: a sum of random grids with decreasing cell size and amplitude."""
    total = np.zeros((size, size))
    for octave in range(_OCTAVES):
        n = cells * 2**octave
        grid = rng.uniform(size=(n, n))
        at = np.arange(size) * n / size
        low = at.astype(int)
        high, part = (low + 1) % n, at - low
        part = part * part * (3 - 2 * part)
        rows = grid[low] * (1 - part)[:, None] + grid[high] * part[:, None]
        total += (rows[:, low] * (1 - part) + rows[:, high] * part) / 2**octave
    total -= total.min()
    return total / max(float(total.max()), 1e-9)


class RandomizedArms:
    """A compiled scene whose arms vary between attempts in delays, readings and gravity compensation.

    The model was compiled for the longest delays. The scene's `arms` have the delays of an attempt without variation.
    """

    def __init__(self, scene: CompiledScene) -> None:
        self._scene = scene
        self.apply_randomization(())  # replaces the longest delays, with which the model was compiled

    def apply_randomization(self, variations: Sequence[ArmDynamicsSample]) -> CompiledScene:
        """Return the scene with one variation for each arm, or none if empty. The model changes in place."""
        arms, model = self._scene.arms, self._scene.model
        if variations:
            arms = tuple(_randomized_arm(arm, by) for arm, by in zip(arms, variations, strict=True))
        for arm in arms:
            model.actuator_delay[arm.drive_ctrl] = arm.command_delay
            if arm.sensors is not None:
                model.sensor_delay[arm.sensors] = arm.sensor_delay
        return replace(self._scene, arms=arms)


def _randomized_arm(arm: ArmAddresses, by: ArmDynamicsSample) -> ArmAddresses:
    gravity = by.gravity if arm.gravity_error is None else arm.gravity_error + by.gravity
    return replace(
        arm,
        gravity_error=np.array(gravity) if np.any(gravity) else None,
        command_delay=arm.command_delay + by.command_delay_ms / 1000,
        sensor_delay=arm.sensor_delay + by.sensor_delay_ms / 1000,
        sensor_noise=arm.sensor_noise + by.sensor_noise_rad,
        encoder_step=arm.encoder_step + by.encoder_step_rad,
    )
