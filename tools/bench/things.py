"""Measure imported objects: a mug in six formats, and the cost of each kind of collision.

python -m tools.bench.things round-trip
python -m tools.bench.things collision
python -m tools.bench.things reading
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.mugs import HEIGHT, RADIUS, WALL, mug, write_mugs
from tools.bench.setting import use_gl


def imported(file: Path, folder: Path, **wishes: Any) -> Any:
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.objects.building import ImportOptions
    from yamsim_cli.objects.importing.file_import import import_file
    from yamsim_cli.objects.readers.object_reader import UnitOptions

    where = replace(Locations.from_environment(os.environ), assets=folder / "assets")
    plain = file.suffix in (".obj", ".ply", ".stl")
    units = UnitOptions("m", "z") if plain else UnitOptions()
    options = ImportOptions(**{"name": "mug", **wishes})
    made = import_file(file, units, options, where, folder / f"{time.monotonic_ns()}.yaml")
    return made, {made.config.mesh.set: folder / "assets" / made.config.mesh.set}


def scene(config: Any, meshes: Any, *, peg: bool = False, ball: bool = False) -> Any:
    """A mug on a floor, or on a peg, and a ball that falls into it."""
    import mujoco

    from yamsim_cli.core.scene.objects.scene_object import add_object

    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_light(pos=[0.3, -0.3, 1], dir=[-0.3, 0.3, -1])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], rgba=[0.4, 0.4, 0.4, 1])
    spec.worldbody.add_camera(name="c", pos=[0.12, -0.24, 0.2], xyaxes=[0.9, 0.45, 0, -0.25, 0.5, 0.83], fovy=40)
    add_object(spec, config, meshes)
    if peg:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.004, 0, 0], fromto=[0, -0.1, 0.3, 0, 0.1, 0.33]
        )
    if ball:
        body = spec.worldbody.add_body(name="ball", pos=[0.004, 0.003, HEIGHT + 0.05])
        body.add_freejoint(name="ball")
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.012, 0, 0], density=500)
    return spec.compile()


def ball_stays_in(config: Any, meshes: Any) -> tuple[bool, float]:
    """Return whether a ball that falls into a mug lies in it after 2 s, and ms per step."""
    import mujoco

    model = scene(config, meshes, ball=True)
    data = mujoco.MjData(model)
    start = time.perf_counter()
    steps = round(2 / model.opt.timestep)
    for _ in range(steps):
        mujoco.mj_step(model, data)
    taken = (time.perf_counter() - start) / steps * 1000
    at = data.body("ball").xpos - data.body("mug").xpos
    return bool(np.hypot(at[0], at[1]) < RADIUS - WALL and 0 < at[2] < HEIGHT / 2), taken


def hangs(config: Any, meshes: Any) -> float:
    """Return how far a mug that hangs from a peg by its handle has sunk after 3 s, m."""
    import mujoco

    model = scene(config, meshes, peg=True)
    data = mujoco.MjData(model)
    # The peg is in the handle's hole at +x, just under its upper bow; the mug lies on its side.
    hole = np.array([RADIUS + 0.006 + 0.010, 0, HEIGHT / 2])
    address = model.joint("mug").qposadr[0]
    turn = np.array([np.cos(np.pi / 4), 0, -np.sin(np.pi / 4), 0])  # its handle upwards
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, turn)
    data.qpos[address : address + 3] = np.array([0, 0, 0.315]) - R.reshape(3, 3) @ hole
    data.qpos[address + 3 : address + 7] = turn
    mujoco.mj_forward(model, data)
    before = float(data.body("mug").xpos[2])
    for _ in range(round(3 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return before - float(data.body("mug").xpos[2])


def picture_of(config: Any, meshes: Any) -> np.ndarray:
    import mujoco

    model = scene(config, meshes)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, 240, 320) as renderer:
        renderer.update_scene(data, "c")
        return renderer.render().copy()


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Structural similarity of two grey images, over windows of 8 x 8. Source: Wang et al., IEEE TIP 13(4), 2004."""
    import cv2

    x, y = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(float) for image in (a, b))

    def mean(image: np.ndarray) -> np.ndarray:
        return cv2.blur(image, (8, 8))

    mx, my = mean(x), mean(y)
    vx, vy, cov = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    return float((((2 * mx * my + c1) * (2 * cov + c2)) / ((mx**2 + my**2 + c1) * (vx + vy + c2))).mean())


def round_trip(folder: Path) -> None:
    files = write_mugs(folder)
    print(
        "| format | mass, g | collision | SSIM to GLB | ball stays in | hangs on a peg | s |\n"
        "|---|---|---|---|---|---|---|"
    )
    first = None
    for kind in ("glb", "obj", "sdf", "dae", "ply", "stl"):
        start = time.perf_counter()
        made, meshes = imported(files[kind], folder, density=2362.0)
        taken = time.perf_counter() - start
        image = picture_of(made.config, meshes)
        first = image if first is None else first
        stays, _ = ball_stays_in(made.config, meshes)
        sunk = hangs(made.config, meshes)
        kinds = f"{made.built_object.collision[0].kind}, {len(made.config.collision)}"
        print(
            f"| {kind} | {made.built_object.mass * 1000:.2f} | {kinds} | {ssim(image, first):.3f} | "
            f"{'yes' if stays else 'no'} | "
            f"{'yes' if sunk < 0.05 else 'no'} ({sunk * 1000:.0f} mm) | {taken:.1f} |"
        )


def collision(folder: Path) -> None:
    files = write_mugs(folder, segments=100)
    print("| collision | parts | s to import | ball stays in | ms a step |\n|---|---|---|---|---|")
    for kind in ("primitives", "decompose", "sdf", "hull"):
        start = time.perf_counter()
        made, meshes = imported(files["glb"], folder, collision=kind)
        taken = time.perf_counter() - start
        stays, step = ball_stays_in(made.config, meshes)
        print(f"| {kind} | {len(made.config.collision)} | {taken:.1f} | {'yes' if stays else 'no'} | {step:.3f} |")


def core_seconds() -> float:
    """CPU seconds of this process and its children so far."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def reading(folder: Path) -> None:
    """A mug of about 5,000 faces, and a scan of 100,000 with its own colours."""
    import trimesh

    print("| thing | faces | faces drawn | s | s of a core | most memory of a child, MB |\n|---|---|---|---|---|---|")
    mug(100).export(folder / "mug.obj")
    bumps = trimesh.creation.torus(0.04, 0.015, major_sections=250, minor_sections=200)
    bumps.vertices *= 1 + 0.05 * np.sin(8 * bumps.vertices[:, :1] / 0.04)
    colours = (127 + 120 * np.sin(bumps.vertices / 0.01)).clip(0, 255).astype(np.uint8)
    scan = trimesh.Trimesh(bumps.vertices, bumps.faces, vertex_colors=colours, process=False)
    scan.export(folder / "scan.ply")
    for name in ("mug.obj", "scan.ply"):
        start, worked = time.perf_counter(), core_seconds()
        made, _ = imported(folder / name, folder, collision="decompose")
        taken, worked = time.perf_counter() - start, core_seconds() - worked
        faces = len(trimesh.load_mesh(folder / name).faces)
        drawn = (folder / "assets" / made.config.mesh.set / made.config.mesh.file).read_text().count("\nf ")
        most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        print(f"| {name} | {faces:,} | {drawn:,} | {taken:.1f} | {worked:.1f} | {most:.0f} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("round-trip", "collision", "reading"))
    what = parser.parse_args().what
    # After the choice of a backend.
    use_gl()
    with tempfile.TemporaryDirectory() as scratch:
        {"round-trip": round_trip, "collision": collision, "reading": reading}[what](Path(scratch))
