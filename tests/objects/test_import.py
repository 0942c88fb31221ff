from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

import pytest

from tests.mugs import has_import_extra
from tests.objects.test_fits import ball, block
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.errors import ConfigError, ResourceError, UsageError, YamsimError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.assets import AssetStore, resolve_user_set
from yamsim_cli.objects.building import ImportOptions
from yamsim_cli.objects.importing.file_import import import_file
from yamsim_cli.objects.importing.ycb_import import import_ycb
from yamsim_cli.objects.readers.object_reader import UnitOptions
from yamsim_cli.program_checks import check_task_config

needs_extra = pytest.mark.skipif(not has_import_extra(), reason="needs the extra: pip install 'yamsim[import]'")


def own(tmp_path: Path, locations: Locations) -> Locations:
    return replace(locations, data=(tmp_path, *locations.data), assets=tmp_path / "assets")


def test_an_own_stl_becomes_an_object_by_name(
    tmp_path: Path, locations: Locations, make_config: Callable[..., RecordConfig]
) -> None:
    where = own(tmp_path, locations)
    (tmp_path / "drawn.stl").write_bytes(block((0.05, 0.02, 0.03)))
    made = import_file(tmp_path / "drawn.stl", UnitOptions(), ImportOptions("brick", mass=0.12), where, None)
    assert made.path == tmp_path / "configs/objects/brick.yaml"
    item = load_config(ObjectConfig, "objects", "brick", where)
    assert item == made.config
    folder = resolve_user_set(AssetStore(where.assets), item.mesh.set)
    assert folder is not None and (folder / item.mesh.file).is_file()
    assert item.inertia.mass == pytest.approx(0.12)
    a, b, c = 0.1, 0.04, 0.06
    moments = sorted(0.12 / 12 * (x * x + y * y) for x, y in ((a, b), (a, c), (b, c)))
    assert sorted(item.inertia.diagonal) == pytest.approx(moments, rel=1e-3)
    assert [part.type for part in item.collision] == ["box"]
    assert not item.needs_meshes
    config = make_config({("task", "things", "object", "of"): str(made.path)})
    assert config.task.things["object"].of == (item,)
    assert config.task.language_prompt == "pick up the brick and put it on the plate"
    with pytest.raises(UsageError, match="exists; move it away"):
        import_file(tmp_path / "drawn.stl", UnitOptions(), ImportOptions("brick"), where, None)


@pytest.mark.slow
def test_a_set_that_was_changed_is_not_used(tmp_path: Path, locations: Locations) -> None:
    where = own(tmp_path, locations)
    (tmp_path / "drawn.stl").write_bytes(block((0.05, 0.02, 0.03)))
    brick = ImportOptions("brick", mass=0.12)
    made = import_file(tmp_path / "drawn.stl", UnitOptions(), brick, where, None)
    store = AssetStore(where.assets)
    folder = resolve_user_set(store, made.config.mesh.set)
    assert folder is not None
    file = folder / made.config.mesh.file
    file.write_bytes(file.read_bytes() + b"x")
    assert resolve_user_set(store, made.config.mesh.set) is None
    again = import_file(tmp_path / "drawn.stl", UnitOptions(), brick, where, tmp_path / "b.yaml")
    assert again.config == made.config
    assert resolve_user_set(store, made.config.mesh.set) == folder


TETRAHEDRON = "v 0 0 0\nv 60 0 0\nv 0 60 0\nv 0 0 60\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MESH_LINK = '<robot name="a"><link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link></robot>'


@pytest.mark.parametrize(
    ("name", "content", "unit", "code", "message"),
    [
        ("mm.stl", ball(30.0), None, 2, "60 x 60 x 60 m*--unit mm*0.06 m*[[]size]"),
        ("cut.stl", ball(0.03)[:-20], None, 4, "its header gives * faces, * [[]damaged]"),
        ("noise.glb", bytes(100), None, 4, "it does not begin with the header of a GLB [[]damaged]"),
        ("bare.obj", TETRAHEDRON, None, 2, "--unit cm * or --unit mm *--up z, y or x [[]unit]"),
        ("bare.obj", TETRAHEDRON, "m", 2, "--unit mm*0.06 m*[[]size]"),
        ("gone.urdf", MESH_LINK.format("no.obj"), None, 4, "'no.obj' is not in its folder [[]missing]"),
        ("out.urdf", MESH_LINK.format("../a.obj"), None, 4, "'../a.obj', which * [[]outside]"),
        ("thing.step", b"ISO-10303-21;", None, 4, "the suffix '.step' are not supported; valid: * [[]unknown-kind]"),
    ],
)
@needs_extra
def test_a_file_that_cannot_be_imported_is_one_line_with_what_to_do(
    name: str, content: str | bytes, unit: str | None, code: int, message: str, tmp_path: Path, locations: Locations
) -> None:
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    where, units = own(tmp_path, locations), UnitOptions(unit, unit and "z")
    with pytest.raises(YamsimError) as caught:
        import_file(tmp_path / name, units, ImportOptions("thing"), where, None)
    assert fnmatch(str(caught.value), f"{tmp_path / name}: *{message}"), str(caught.value)
    assert caught.value.exit_code == code and "\n" not in str(caught.value)
    assert not (tmp_path / "configs").exists() and not where.assets.exists()


def test_imports_that_cannot_work_are_refused(tmp_path: Path, locations: Locations) -> None:
    where = own(tmp_path, locations)
    with pytest.raises(ResourceError, match=r"no\.stl: it cannot be read"):
        import_file(tmp_path / "no.stl", UnitOptions(), ImportOptions("ball"), where, None)
    with pytest.raises(UsageError, match="'my ball' is not valid"):
        import_file(tmp_path / "mm.stl", UnitOptions(), ImportOptions("my ball"), where, None)
    with pytest.raises(UsageError, match="unknown YCB object '013_aple'; did you mean '013_apple'"):
        import_ycb("013_aple", where, None, None)
    with pytest.raises(UsageError, match=r"give --out FILE\.yaml"):
        import_ycb("013_apple", replace(locations, data=locations.data[-1:]), None, None)
    with pytest.raises(ResourceError, match="yamsim assets fetch ycb_small"):
        import_ycb("013_apple", where, None, None)


@pytest.mark.slow
def test_a_shipped_config_is_what_import_writes(tmp_path: Path, locations: Locations, repository: Path) -> None:
    try:
        made = import_ycb("058_golf_ball", locations, None, tmp_path / "golf.yaml")
    except ResourceError:
        pytest.skip("the meshes are not here: yamsim assets fetch")
    assert made.path.read_text() == (repository / "configs/objects/058_golf_ball.yaml").read_text()


def test_objects_and_targets_are_named_by_number_or_without(locations: Locations) -> None:
    by_id = pickplace("013_apple", "024_bowl", locations)
    assert by_id == pickplace("apple", "bowl", locations)
    played = by_id.task.with_objects_of(by_id.task.typical_roles)
    assert played.language_task == "pick_place_apple"
    assert played.language_prompt == "pick up the apple and put it in the bowl"


@pytest.mark.parametrize(
    ("item", "target", "said"),
    [
        ("013_aple", "024_bowl", "unknown object '013_aple'; did you mean '013_apple'? valid: 005_tomato_soup_can"),
        ("054_softball", "024_bowl", "object 'softball' is too wide to be picked up: 95 mm, and gripper crank of rig"),
        ("024_bowl", "029_plate", "object 'bowl' has no `grasp`"),
        ("013_apple", "014_lemon", "target 'lemon' has neither a floor nor a flat top"),
        ("013_apple", "013_apple", "the target and the object can both have the name 'apple'"),
    ],
)
def test_unsuitable_objects_of_a_task_are_refused(item: str, target: str, said: str, locations: Locations) -> None:
    with pytest.raises(ConfigError) as caught:
        pickplace(item, target, locations)
    assert said in str(caught.value)


def pickplace(item: str, target: str, locations: Locations) -> RecordConfig:
    roles = {"object": item, "target": target}
    overrides = {("task", "things", role, "of"): ("test", name) for role, name in roles.items()}
    return load_config(RecordConfig, "record", "default", locations, overrides, check_task_config)
