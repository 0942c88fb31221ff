from collections.abc import Callable
from pathlib import Path

import pytest

from tests.core.dataset.making import CONFIG, Made, made, publish
from yamsim_cli.core.dataset.writing.opening import OpenMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter


@pytest.fixture
def build(tmp_path) -> Callable[..., Path]:
    """Writes a dataset of these episodes, three by default."""

    def write(*episodes: Made) -> Path:
        path = tmp_path / "dataset"
        with DatasetWriter(path, CONFIG, OpenMode.NEW) as writer:
            for episode in episodes or [made(k) for k in range(3)]:
                publish(writer, episode)
            writer.finish()
        return path

    return write


@pytest.fixture
def dataset(build) -> Path:
    return build()
