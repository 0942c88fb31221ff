"""The calibration file beside our export for raiden, read as `overlay --camera` reads one of raiden's own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.core.export.conftest import CAMERAS, jpeg
from tests.core.unrendered import SIZE, write_dataset
from yamsim_cli.core.config.cameras.camera import CameraConfig
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.export.raiden import export_raiden
from yamsim_cli.core.export.raiden_schema import RaidenOptions
from yamsim_cli.core.export.source import open_source
from yamsim_cli.core.resources import Locations


def test_its_cameras_are_those_that_were_recorded(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path
) -> None:
    dataset = tmp_path / "dataset"
    write_dataset(dataset, make_config({("wrist",): True, ("image", "size_px"): list(SIZE)}), locations, 1, jpeg)
    source = open_source(dataset, "0", locations)
    export_raiden(source, tmp_path / "out", locations, lambda *_: None, RaidenOptions(fps=None))
    frame = next(source.episodes()).frames()[0]
    file = tmp_path / "out" / "calibration_results.json"
    # A lone arm is the left one there.
    names = {"right_wrist_camera": "left_wrist_camera"}
    for camera in CAMERAS:
        model = load_config(CameraConfig, "cameras", f"{file}:{names.get(camera, camera)}", locations).model
        assert (model.width, model.height) == SIZE
        np.testing.assert_allclose(model.K, frame["intrinsics"][camera], rtol=1e-6)
