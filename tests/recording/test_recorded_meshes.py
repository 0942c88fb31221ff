"""A dataset states its meshes, and continues with no others."""

from __future__ import annotations

import functools
import json
import pickle
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from tests.core.dataset.making import tree
from tests.meshes import box
from tests.programs import session_of
from tests.recording.fake_episodes import Inline, Recording
from tests.stand_in_meshes import stand_ins
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.loader import parse_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import open_episodes
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.episode.runner import AttemptRunner
from yamsim_cli.core.errors import ConfigError, ResourceError
from yamsim_cli.core.files.documents.yaml_document import load_yaml
from yamsim_cli.core.files.resources import Locations, MeshFolders
from yamsim_cli.core.geometry.stl import encode_stl
from yamsim_cli.core.scene.build import with_mesh_descriptions
from yamsim_cli.core.workers.executors import InlineExecutor
from yamsim_cli.recording.executor_factories import pack_session, unpack_session, unpacked_runner

Make = Callable[..., RecordConfig]
ARM, YCB, SMALL, OBJECTS = "i2rt_yam_crank", "ycb", "ycb_small", "ycb_objects"


@pytest.fixture
def recording(make_config: Make, tmp_path: Path) -> Recording:
    return Recording(make_config({("episodes",): 2, ("seed",): 1}), tmp_path / "dataset")


@pytest.fixture
def meshes(locations: Locations, tmp_path: Path) -> MeshFolders:
    return stand_ins(tmp_path / "meshes", locations, ARM, YCB, SMALL)


def go_on(recording: Recording, meshes: MeshFolders, mode: ExistingDatasetMode = ExistingDatasetMode.RESUME) -> None:
    """Record more, with these meshes."""
    recording.meshes = meshes
    recording.config = recording.config.model_copy(update={"episodes": recording.config.episodes + 1})
    recording.run(mode=mode)


def test_the_config_and_every_episode_name_the_meshes(
    recording: Recording, meshes: MeshFolders, locations: Locations
) -> None:
    recording.meshes = meshes | {YCB: None}
    recording.run()
    said = load_yaml(recording.path / "config.yaml").data["meshes"]
    assert said.keys() == {ARM, YCB}
    assert re.fullmatch("full [0-9a-f]{64}", said[ARM])
    assert said[YCB] == "primitives"
    assert [episode.record.meshes for episode in open_episodes(recording.path)] == [said, said]
    text = (recording.path / "config.yaml").read_text()
    assert parse_config(RecordConfig, text, "config.yaml", locations).meshes == said


def test_meshes_that_came_since_do_not_go_into_the_same_dataset(recording: Recording, meshes: MeshFolders) -> None:
    recording.run()
    before = tree(recording.path)
    with pytest.raises(ConfigError) as caught:
        go_on(recording, meshes)
    changes = "; ".join(rf"{name}: primitives there, full \w{{12}} now" for name in (ARM, YCB))
    assert re.search(
        rf"dataset was recorded with other meshes: {changes}; to continue with primitives, set YAMSIM_ASSETS to an "
        r"empty folder, or record into another --out$",
        str(caught.value),
    )
    assert tree(recording.path) == before
    go_on(recording, {})


def test_meshes_that_went_since_do_not_either(recording: Recording, meshes: MeshFolders) -> None:
    recording.meshes = meshes
    recording.run()
    before = tree(recording.path)
    with pytest.raises(ConfigError) as caught:
        go_on(recording, meshes | {ARM: None})
    assert re.search(
        rf"dataset was recorded with other meshes: {ARM}: full \w{{12}} there, primitives now; run `yamsim ",
        str(caught.value),
    )
    assert tree(recording.path) == before
    go_on(recording, meshes)


@pytest.mark.parametrize("change", [{"edge": 0.03}, {"reduced": True}])
def test_other_meshes_do_not_either(
    recording: Recording, meshes: MeshFolders, locations: Locations, tmp_path: Path, change: dict[str, float]
) -> None:
    recording.meshes = meshes
    recording.run()
    others = stand_ins(tmp_path / "others", locations, ARM, **change)
    with pytest.raises(ConfigError, match=rf"{ARM}: full \w+ there, \w+ \w+ now; set YAMSIM_ASSETS to the meshes of"):
        go_on(recording, meshes | others)


def test_what_is_not_shown_does_not_matter(recording: Recording, meshes: MeshFolders) -> None:
    recording.meshes = meshes
    recording.run()
    go_on(recording, meshes | {SMALL: None})


def test_distractors_matter_where_they_are_shown(recording: Recording, meshes: MeshFolders, make_config: Make) -> None:
    recording.config = make_config({("episodes",): 2, ("seed",): 1, ("randomization",): "default"})
    recording.meshes = meshes
    recording.run()
    with pytest.raises(ConfigError, match=f"{SMALL}: full .* there, primitives now"):
        go_on(recording, meshes | {SMALL: None})


def test_of_another_configuration_its_keys_are_named_first(
    recording: Recording, meshes: MeshFolders, make_config: Make
) -> None:
    recording.run()
    recording.config = make_config({("episodes",): 3, ("seed",): 2})
    with pytest.raises(
        ConfigError, match=rf"another configuration: seed: 1 there, 2 now; meshes\.{ARM}: primitives there"
    ):
        go_on(recording, meshes)


def test_a_recorded_config_asks_for_no_meshes_in_a_new_dataset(recording: Recording, meshes: MeshFolders) -> None:
    """Its statement holds for that dataset only."""
    there = replace(Locations.from_environment({}), meshes=meshes)
    recording.config = with_mesh_descriptions(Session(recording.config, there)).config
    recording.run()
    assert load_yaml(recording.path / "config.yaml").data["meshes"] == {ARM: "primitives", YCB: "primitives"}


def says_nothing(dataset: Path) -> bool:
    """Whether neither a dataset nor one of its episodes states its meshes."""
    said = [
        load_yaml(dataset / "config.yaml").data,
        *map(json.loads, (p.read_text() for p in dataset.glob("*/*.json"))),
    ]
    return all(data.get("meshes") is None for data in said)


class TestOfAnEarlierVersion:
    """A dataset that does not state its meshes."""

    @pytest.fixture
    def old(self, recording: Recording, monkeypatch: pytest.MonkeyPatch) -> Recording:
        with monkeypatch.context() as patch:
            patch.setattr("yamsim_cli.recording.recorder.with_mesh_descriptions", lambda session: session)
            recording.run()
        assert says_nothing(recording.path)
        return recording

    def test_goes_on_saying_nothing_and_the_user_is_told(self, old: Recording, meshes: MeshFolders) -> None:
        before = tree(old.path)
        go_on(old, meshes)
        (told,) = old.warnings
        assert told.startswith(
            f"{old.path}/config.yaml does not name the meshes of the episodes, because an earlier yamsim recorded "
            f"them. New episodes show {ARM}: full "
        )
        assert f"`yamsim verify {old.path} --sample 1 --images` shows whether" in told
        assert len(open_episodes(old.path)) == 3
        assert says_nothing(old.path)
        kept = {name: data for name, data in before.items() if name not in ("manifest.json", "attempts.jsonl")}
        assert kept.items() <= tree(old.path).items()

    @pytest.mark.parametrize("staged", [False, True])
    def test_a_lost_episode_is_made_again_as_it_was(self, old: Recording, tmp_path: Path, staged: bool) -> None:
        before = tree(old.path)
        (old.path / "ep_000001/lowdim/000000.pkl").write_bytes(b"")
        old.stage = tmp_path / "stage" if staged else None
        old.resume()
        assert {name: data for name, data in tree(old.path).items() if ".damaged" not in name} == before


@dataclass
class WithOther:
    """Executors whose workers find other meshes than the recorder."""

    meshes: MeshFolders

    def __call__(self, session: Session, workers: int) -> InlineExecutor:
        session = replace(session, locations=replace(session.locations, meshes=self.meshes))
        factory = functools.partial(AttemptRunner, session, render=True)
        return InlineExecutor(factory)


def test_a_worker_that_would_draw_otherwise_is_refused_at_the_start(recording: Recording, meshes: MeshFolders) -> None:
    recording.meshes = meshes
    with pytest.raises(ResourceError) as caught:
        recording.run(WithOther(meshes | {YCB: None}))
    assert re.fullmatch(
        r"a worker on \S+ would show other meshes than the recorder: "
        rf"{YCB}: full \w{{12}} for the recorder, primitives there; "
        r"install the same meshes and the same yamsim there, then continue with --resume",
        str(caught.value),
    )
    assert json.loads((recording.path / "manifest.json").read_text())["episodes"] == []
    recording.run(Inline(), ExistingDatasetMode.RESUME)


FRUIT = {
    "kind": "program",
    "rig": "single_linear",
    "things": {
        "plate": {"of": "029_plate"},
        "fruit": {"of": ["012_strawberry", "014_lemon", "018_plum", "015_peach"], "count": 2},
    },
    "starts": {
        "plate": {"x": [0.4, 0.42], "y": [0.1, 0.12]},
        "fruit": {"x": [0.25, 0.45], "y": [-0.25, 0.0], "apart": 0.06},
    },
    "phrasings": {"training": ["put the fruit onto the plate"]},
    "goal": {"all": [{"on": {"thing": "fruit", "surface": "plate"}}]},
    "expert": [{"each": {"of": "fruit", "do": [{"pick": {"thing": "it"}}, {"place": {"thing": "it", "on": "plate"}}]}}],
}


def test_every_cast_of_a_task_shows_the_meshes_that_the_recording_states(tmp_path: Path) -> None:
    """The files of a set differ between casts, and the recording states those of all objects."""
    session = session_of(tmp_path, FRUIT)
    meshes = stand_ins(tmp_path / "meshes", session.locations, "i2rt_yam_linear_4310", YCB, SMALL, OBJECTS)
    session = with_mesh_descriptions(replace(session, locations=replace(session.locations, meshes=meshes)))
    said = session.config.meshes
    assert said is not None and said[OBJECTS].startswith("full ")
    AttemptRunner(session, render=True).close()
    # A worker that lacks one of the meshes, even one that the first cast does not use, is refused.
    for mesh in ("012_strawberry", "018_plum", "015_peach"):
        other = stand_ins(tmp_path / mesh, session.locations, "i2rt_yam_linear_4310", YCB, SMALL, OBJECTS)
        assert other[OBJECTS] is not None
        (other[OBJECTS] / f"{mesh}.stl").write_bytes(encode_stl(*box(0.021, cuts=1)))
        with pytest.raises(ResourceError, match=f"{OBJECTS}: full"):
            AttemptRunner(replace(session, locations=replace(session.locations, meshes=other)), render=True)


def test_what_is_unpacked_is_what_was_packed(tmp_path: Path, config: RecordConfig) -> None:
    for root, text in (("mine", "mine"), ("built_in", "theirs")):
        for name in ("arm/arm.xml", "arm/deep/part.xml"):
            (tmp_path / root / "robot_models" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / root / "robot_models" / name).write_text(text)
    (tmp_path / "mine/robot_models/arm/deep/part.xml").unlink()
    (tmp_path / "set").mkdir()
    (tmp_path / "set/link.stl").write_bytes(b"\0\xff")
    locations = Locations((tmp_path / "mine", tmp_path / "built_in", tmp_path / "nowhere"), tmp_path / "cache")

    locations = replace(locations, meshes={"set": tmp_path / "set", "missing": None})
    packed = pickle.loads(pickle.dumps(pack_session(Session(config, locations))))
    unpacked = unpack_session(packed, tmp_path / "there")
    assert unpacked.config == config
    there = unpacked.locations
    assert there.find_data_file("robot_models/arm/arm.xml").read_text() == "mine"
    assert there.find_data_file("robot_models/arm/deep/part.xml").read_text() == "theirs"
    assert there.meshes == {"set": tmp_path / "there/meshes/set", "missing": None}
    assert (tmp_path / "there/meshes/set/link.stl").read_bytes() == b"\0\xff"


@pytest.mark.slow
def test_a_runner_needs_nothing_but_its_packed(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    config = make_config({("image", "size_px"): [16, 16]})
    with unpacked_runner(pack_session(Session(config, locations))) as runner:
        assert runner.run(AttemptJob(0, 0)).outcome.success
    assert list(tmp_path.iterdir()) == [], "something is left on the node"
