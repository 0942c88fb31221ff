"""yamsim's .rrd files in two versions of rerun: the oldest that docs/exports.md promises, and the newest."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.clients.environments import REPOSITORY, Interpreter
from tests.export.conftest import CAMERAS, jpeg
from tests.unrendered import SIZE, write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.export.export_source import SimulatedSource, open_source

pytestmark = pytest.mark.client


@pytest.fixture(scope="module")
def source(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path_factory: pytest.TempPathFactory
) -> SimulatedSource:
    path = tmp_path_factory.mktemp("recorded") / "dataset"
    write_dataset(path, make_config({("wrist",): True, ("image", "size_px"): list(SIZE)}), locations, 1, jpeg)
    return open_source(path, None, locations)


@pytest.fixture(scope="module")
def file(source: SimulatedSource, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from yamsim_cli.export.rrd import export_rerun

    out = tmp_path_factory.mktemp("rrd") / "out"
    export_rerun(source, out, lambda done, total: None)
    return out / "ep_000000.rrd"


def test_the_extra_writes_with_no_version_older_than_the_oldest_reader() -> None:
    with (REPOSITORY / "pyproject.toml").open("rb") as project:
        assert tomllib.load(project)["project"]["optional-dependencies"]["rerun"] == ["rerun-sdk>=0.30,<1"]


@pytest.mark.parametrize("row", ["rerun-0.30", "rerun-0.41"])
def test_rerun_reads_all_that_was_recorded(
    row: str, client: Callable[[str], Interpreter], source: SimulatedSource, file: Path
) -> None:
    read = client(row).run("rerun_read.py", file)
    assert read["verified"], read["said"]
    assert read["recordings"] == {"dataset-ep_000000": ["dataset/ep_000000"]}
    episode = next(source.open_episodes())
    frames = episode.frames()
    assert read["frames"] == list(range(len(frames)))
    np.testing.assert_allclose(read["seconds"], [frame["timestamp"] for frame in frames], atol=1e-6)
    columns = read["columns"]

    def column(entity: str, part: str) -> np.ndarray:
        return np.array(columns[f"{entity}:{part}"], float)

    for k in range(7):
        drive = f"joint{k + 1}" if k < 6 else "gripper"
        for key in ("joints", "ctrl"):
            np.testing.assert_array_equal(
                column(f"/{key}/{drive}", "Scalars:scalars")[:, 0], [float(frame[key][k]) for frame in frames]
            )
    for camera in CAMERAS:
        place = f"/base/{camera}"
        hashes = [hashlib.sha256(episode.image(camera, k)).hexdigest() for k in range(len(frames))]
        assert columns[f"{place}/rgb:EncodedImage:blob"] == hashes
        stored = column(place, "Pinhole:image_from_camera")
        # rerun stores matrices column by column.
        intrinsics = [np.ravel(frame["intrinsics"][camera], "F") for frame in frames]
        np.testing.assert_allclose(stored, intrinsics, rtol=1e-6)
        np.testing.assert_array_equal(column(place, "Pinhole:resolution"), [SIZE] * len(frames))
    stands = {camera: [frame["extrinsics"][camera] for frame in frames] for camera in CAMERAS}
    stands |= {thing: [frame[f"{thing}_pose"] for frame in frames] for thing in ("banana", "plate")}
    for entity, given in (stands | {"hand": [frame["ee_pose"] for frame in frames]}).items():
        poses = np.array(given)
        np.testing.assert_allclose(column(f"/base/{entity}", "Transform3D:translation"), poses[:, :3, 3], atol=1e-6)
        turned = column(f"/base/{entity}", "Transform3D:mat3x3").reshape(-1, 3, 3).transpose(0, 2, 1)
        np.testing.assert_allclose(turned, poses[:, :3, :3], atol=1e-6)
    np.testing.assert_array_equal(column("/weld", "Scalars:scalars")[:, 0], [frame["magnet"] for frame in frames])
    assert str(frames[0]["language_prompt"]) in columns["/episode:TextDocument:text"][0][0]
