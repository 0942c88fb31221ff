"""Readers of object files: lengths, axes, looks, weight, joints."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.drawers import MJCF, URDF, cabinet_sdf
from tests.mugs import HEIGHT, RADIUS, has_import_extra, picture, write_mugs
from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.geometry.closed_surface import is_closed, uniform_mass_properties
from yamsim_cli.core.images.png import decode_png
from yamsim_cli.objects.part_surfaces import merged_surface
from yamsim_cli.objects.readers.object_parts import ObjectDescription, Surface
from yamsim_cli.objects.readers.object_reader import UnitOptions, convert_to_metres, read_object
from yamsim_cli.objects.readers.reader_process import read_file

pytestmark = pytest.mark.skipif(not has_import_extra(), reason="needs the extra: pip install 'yamsim[import]'")


@pytest.fixture(scope="module")
def mugs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_mugs(tmp_path_factory.mktemp("mugs"), segments=32)


def read_here(path: Path, told: UnitOptions | None = None) -> ObjectDescription:
    """As `read_object`, in this process."""
    return convert_to_metres(read_file(path, path.parent), told or UnitOptions())


def told(kind: str) -> UnitOptions:
    return UnitOptions("m", "z") if kind in ("obj", "ply", "stl") else UnitOptions()


@pytest.mark.parametrize("kind", ["glb", "obj", "sdf", "dae", "ply", "stl"])
def test_a_mug_is_the_same_in_every_format(mugs: dict[str, Path], kind: str) -> None:
    (part,) = read_here(mugs[kind], told(kind)).parts
    vertices, faces = merged_surface(part.looks)
    assert vertices.min(axis=0) == pytest.approx([-RADIUS, -RADIUS, 0], abs=1e-4)
    assert vertices[:, 2].max() == pytest.approx(HEIGHT, abs=1e-5)
    assert vertices[:, 0].max() > RADIUS + 0.02  # its handle
    assert is_closed(faces)
    assert uniform_mass_properties(vertices, faces).volume == pytest.approx(1.27e-4, rel=0.02)


@pytest.mark.parametrize("kind", ["glb", "obj", "sdf", "dae", "ply"])
def test_the_texture_of_a_mug_stays_in_place(mugs: dict[str, Path], kind: str) -> None:
    (part,) = read_here(mugs[kind], told(kind)).parts
    for place, (u, v) in {"left": (0.25, 0.15), "right": (0.75, 0.9)}.items():
        angle = (u - 0.5) * 2 * math.pi
        at = np.array([RADIUS * math.cos(angle), RADIUS * math.sin(angle), v * HEIGHT])
        expected = picture()[int((1 - v) * 511), int(u * 511)]
        assert colour_at(part.looks[0], at) == pytest.approx(expected.astype(float), abs=40), place


def colour_at(surface: Surface, at: np.ndarray) -> np.ndarray:
    """Mean colour of a surface at the triangles around a place."""
    image = decode_png(surface.material.texture or b"")
    assert image is not None and surface.uv is not None
    corners = surface.vertices[surface.faces]
    middles = corners.mean(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = (normals[:, :2] * middles[:, :2]).sum(axis=1) > 0
    on_side = outwards & (np.linalg.norm(middles[:, :2], axis=1) > 0.95 * RADIUS)
    # Barycentric coordinates of the place in the side's triangles: find the triangle that contains it.
    for corner, uv in zip(corners[on_side], surface.uv[on_side], strict=True):
        edges = np.stack([corner[1] - corner[0], corner[2] - corner[0]], axis=1)
        share, *_ = np.linalg.lstsq(edges, at - corner[0], rcond=None)
        if min(share) >= -0.02 and share.sum() <= 1.02 and np.linalg.norm(edges @ share + corner[0] - at) < 1e-3:
            u, v = uv[0] + share[0] * (uv[1] - uv[0]) + share[1] * (uv[2] - uv[0])
            row, column = int((1 - v % 1) * image.shape[0]), int((u % 1) * image.shape[1])
            return image[min(row, image.shape[0] - 1), min(column, image.shape[1] - 1)].astype(float)
    raise AssertionError("nothing there")


def test_a_file_is_read_in_a_child(mugs: dict[str, Path]) -> None:
    (part,) = read_object(mugs["glb"], UnitOptions()).parts
    (here,) = read_here(mugs["glb"]).parts
    assert np.array_equal(part.looks[0].vertices, here.looks[0].vertices)
    assert part.looks[0].material == here.looks[0].material
    assert part.looks[0].uv is not None and np.array_equal(part.looks[0].uv, here.looks[0].uv)


@pytest.mark.slow
def test_a_missing_unit_or_up_axis_is_requested(mugs: dict[str, Path]) -> None:
    with pytest.raises(
        UsageError, match=r"does not state its unit: add --unit m \(0.117 x .*\), and --up z, y or x \[unit\]"
    ):
        read_object(mugs["obj"], UnitOptions())
    with pytest.raises(UsageError, match=r"--up z, --up y or --up x \[up\]"):
        read_object(mugs["obj"], UnitOptions(unit="m"))


def test_an_absurd_size_is_refused_with_a_correction(mugs: dict[str, Path]) -> None:
    with pytest.raises(UsageError, match=r"117 x .* m large.*--unit mm makes it 0\.117 m long.* \[size\]"):
        read_object(mugs["stl"], UnitOptions("m", "z", scale=1000))


def test_the_mass_and_its_centre_come_from_the_sdf(mugs: dict[str, Path]) -> None:
    (part,) = read_here(mugs["sdf"]).parts
    assert part.weight is not None
    assert part.weight.mass == 0.3
    assert part.weight.centre == pytest.approx([0.0037, 0, 0.0384], abs=2e-4)
    assert part.shapes is not None
    assert len(part.shapes) == 1


def test_a_drawer_in_sdf(tmp_path: Path) -> None:
    (tmp_path / "c.sdf").write_text(cabinet_sdf())
    thing = read_here(tmp_path / "c.sdf")
    base, drawer = thing.parts
    assert thing.fixed and base.name == "box" and drawer.parent == 0
    assert drawer.joint is not None
    assert (drawer.joint["type"], drawer.joint["range"], drawer.joint["axis"]) == ("slide", [0, 0.1], [-1, 0, 0])
    assert (drawer.joint["damping"], drawer.joint["friction"]) == (2, 0.5)
    assert drawer.T_in_parent[:3, 3] == pytest.approx([0, 0, 0.012])
    (handle,) = drawer.handles
    assert handle["position"] == pytest.approx([-0.112, 0, 0.035])
    assert handle["approach"] == pytest.approx([0, 0, -1], abs=1e-6)
    assert all(isinstance(shape, dict) and shape["type"] == "box" for shape in base.shapes or ())


def test_the_up_axis_rotates_the_handles_of_the_base(tmp_path: Path) -> None:
    on_box = cabinet_sdf().replace(
        'attached_to="drawer"><pose relative_to="drawer"', 'attached_to="box"><pose relative_to="box"'
    )
    (tmp_path / "c.sdf").write_text(on_box)
    (handle,) = read_here(tmp_path / "c.sdf", UnitOptions(up="y")).parts[0].handles
    assert handle["position"] == pytest.approx([-0.112, -0.035, 0], abs=1e-6)
    assert handle["approach"] == pytest.approx([0, 1, 0], abs=1e-6)


def test_an_include_of_no_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mug" / "model.sdf").mkdir(parents=True)
    (tmp_path / "world.sdf").write_text('<sdf version="1.9"><include><uri>model://mug</uri></include></sdf>')
    with pytest.raises(RefusedError) as caught:
        read_here(tmp_path / "world.sdf")
    assert caught.value.code == "not-a-file"


def test_a_lid_in_urdf(tmp_path: Path) -> None:
    (tmp_path / "flip.urdf").write_text(URDF)
    jar, lid = read_here(tmp_path / "flip.urdf").parts
    assert lid.joint is not None and jar.weight is not None
    assert lid.joint["range"] == pytest.approx([0, math.degrees(1.9)])
    assert lid.T_in_parent[:3, 3] == pytest.approx([0.03, 0, 0.08])
    assert lid.looks[0].material.rgba == (0.8, 0.1, 0.1, 1.0)
    assert lid.shapes is not None and lid.shapes[0]["type"] == "cylinder"  # type: ignore[index]


def test_a_door_in_mjcf(tmp_path: Path) -> None:
    (tmp_path / "door.xml").write_text(MJCF)
    frame, door = read_here(tmp_path / "door.xml").parts
    assert door.joint is not None and frame.weight is not None
    assert door.joint["range"] == pytest.approx([0, 90])
    assert (door.joint["damping"], door.joint["friction"]) == pytest.approx((0.02, 0.01))
    assert frame.weight.mass == pytest.approx(0.8)
    assert [handle["name"] for handle in door.handles] == ["handle_knob"]
    assert frame.looks[0].material.rgba == pytest.approx((0.5, 0.3, 0.1, 1))


def test_links_joined_rigidly_become_one(tmp_path: Path) -> None:
    text = URDF.replace('type="revolute"', 'type="fixed"')
    (tmp_path / "flip.urdf").write_text(text)
    (part,) = read_here(tmp_path / "flip.urdf").parts
    assert part.weight is not None and part.weight.mass == pytest.approx(0.32)
    assert part.weight.centre == pytest.approx([0, 0, 0.02 * 0.083 / 0.32], abs=1e-3)
    assert len(part.looks) == 2


def test_another_axis_can_be_up(mugs: dict[str, Path]) -> None:
    (part,) = read_here(mugs["obj"], UnitOptions("m", "y")).parts
    # The file's z is along -y.
    assert part.looks[0].vertices[:, 1].min() == pytest.approx(-HEIGHT, abs=1e-5)


def test_a_mirrored_mesh_still_has_its_outside_outside(tmp_path: Path, mugs: dict[str, Path]) -> None:
    text = mugs["sdf"].read_text().replace("<uri>model://mug", "<scale>-1 1 1</scale><uri>model://mug")
    copy = mugs["sdf"].with_name("mirrored.sdf")
    copy.write_text(text)
    (part,) = read_here(copy).parts
    assert uniform_mass_properties(*merged_surface(part.looks)).volume > 0


def test_without_the_extra_one_line_names_it(mugs: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    from yamsim_cli.objects.readers import object_reader as read

    monkeypatch.setattr(read, "find_spec", lambda name: None if name == "trimesh" else object())
    with pytest.raises(ResourceError, match=r"needs trimesh: pip install 'yamsim\[import\]'"):
        read_object(mugs["glb"], UnitOptions())
