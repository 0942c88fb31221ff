"""`assets certify`, `assets list` and warnings of `record`."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.meshes import box
from tests.mugs import has_import_extra, write_mugs
from yamsim_cli.core.geometry.stl import encode_stl

needs_extra = pytest.mark.skipif(not has_import_extra(), reason="needs the extra: pip install 'yamsim[import]'")

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_a_certificate_is_made_kept_listed_and_asked_for(tmp_path: Path) -> None:
    own = tmp_path / "mine" / "configs" / "objects"
    own.mkdir(parents=True)
    text = (ROOT / "configs" / "objects" / "kitchen_distractor.yaml").read_text()
    (own / "cube.yaml").write_text(text.replace("name: distractor", "name: cube"))
    env = {"YAMSIM_DATA_DIR": str(tmp_path / "mine"), "YAMSIM_ASSETS": str(tmp_path / "assets")}
    run = yamsim("assets", "certify", "cube", "--json", env=env)
    assert run.code == 0, run.err
    assert (run.json["ok"], run.json["thing"], run.json["collision"]) == (
        True,
        "cube",
        {"kind": "primitives", "parts": 1},
    )
    assert run.json["mass_kg"] == pytest.approx(0.341, abs=0.005)
    assert {check["code"] for check in run.json["checks"]} >= {"mass.density", "rest.moves", "hollow.filled"}
    assert standing(env) == "certified"
    # The same object, implausibly heavy.
    (own / "cube.yaml").write_text((own / "cube.yaml").read_text().replace("shape:\n", "shape:\n  mass_g: 49000\n"))
    assert standing(env) == "stale"
    run = yamsim("assets", "certify", "cube", env=env)
    assert run.code == 4
    assert run.message.startswith("cube: its density is not plausible: 81,")
    assert run.message.endswith("[mass.density]; give its mass in kg")
    assert standing(env) == "failed"
    run = yamsim("record", "--n", "1", "--object", "011_banana", "--target", "cube", cwd=tmp_path, env=env)
    assert run.code == 4
    assert "cube has failed its certificate: mass.density; correct it" in run.err


def standing(env: dict[str, str]) -> str:
    things = yamsim("assets", "list", "--json", env=env).json["things"]
    return {thing["name"]: thing["certificate"] for thing in things}["cube"]


@pytest.mark.slow
@pytest.mark.render
def test_the_page_holds_every_check_and_a_picture(tmp_path: Path) -> None:
    env = {"YAMSIM_ASSETS": str(tmp_path / "assets")}
    page = tmp_path / "page.html"
    run = yamsim("assets", "certify", "kitchen_distractor", "--html", page, env=env)
    assert run.code == 0, run.err
    text = page.read_text()
    for code in ("size.implausible", "mesh.open", "mass.centre", "inertia.impossible", "rest.moves", "grasp.slips"):
        assert f"<h2>{code}</h2>" in text
    assert text.count("data:image/jpeg;base64,") >= 12
    run = yamsim("assets", "certify", "kitchen_distractor", "--html", page, env=env)
    assert (run.code, "--overwrite" in run.message) == (2, True)


def test_an_import_whose_certificate_fails_exits_as_certify_does(tmp_path: Path) -> None:
    (tmp_path / "lump.stl").write_bytes(encode_stl(*box(0.04)))
    env = {"YAMSIM_DATA_DIR": str(tmp_path / "mine"), "YAMSIM_ASSETS": str(tmp_path / "assets")}
    run = yamsim("assets", "import", "lump.stl", "--mass", "5", "--json", cwd=tmp_path, env=env)
    assert run.code == 4, run.err
    assert "lump.yaml is written, but its certificate failed: lump: " in run.message
    assert (tmp_path / "mine" / "configs" / "objects" / "lump.yaml").exists()
    assert run.json["items"][0]["certificate"] == {"ok": False, "failed": ["mass.density"]}
    assert yamsim("assets", "certify", "lump", env=env).code == 4


@pytest.mark.long
@needs_extra
@pytest.mark.slow
def test_a_faceted_mug_passes_with_the_grasp_that_import_proposes(tmp_path: Path) -> None:
    file = write_mugs(tmp_path, 24)["glb"].rename(tmp_path / "my_mug.glb")
    env = {"YAMSIM_DATA_DIR": str(tmp_path / "mine"), "YAMSIM_ASSETS": str(tmp_path / "assets")}
    run = yamsim("assets", "import", file.name, "--json", cwd=tmp_path, env=env)
    assert (run.code, run.json["items"][0]["certificate"]) == (0, {"ok": True, "failed": []}), run.err


@needs_extra
@pytest.mark.long
@pytest.mark.slow
def test_a_ring_thinner_than_the_pads_reach_down_fails_when_imported_and_when_certified(tmp_path: Path) -> None:
    import trimesh

    ring = trimesh.creation.torus(0.03, 0.004, major_sections=48, minor_sections=24)
    ring.export(tmp_path / "ring.stl")
    env = {"YAMSIM_DATA_DIR": str(tmp_path / "mine"), "YAMSIM_ASSETS": str(tmp_path / "assets")}
    for run in (
        yamsim("assets", "import", "ring.stl", "--density", "1000", cwd=tmp_path, env=env),
        yamsim("assets", "certify", "ring", cwd=tmp_path, env=env),
    ):
        assert run.code == 4, run.err
        message = run.err.splitlines()[-1]  # a busy machine shows progress before it
        assert "ring: a gripper cannot pick it up and hold it: the skill `pick` fails: no way" in message
        assert "table and left_finger_collide_pad" in message


def test_an_unknown_thing_is_one_line(tmp_path: Path) -> None:
    run = yamsim("assets", "certify", "kitchen_spon", cwd=tmp_path)
    assert run.code == 3
    assert "did you mean 'kitchen_spoon'?" in run.message
