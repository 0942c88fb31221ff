from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.datasets.checks.sample import SampleDataset, episode, look
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.datasets.check_summary import CheckResults


@pytest.fixture
def sample(config: RecordConfig) -> SampleDataset:
    """Three whole episodes."""
    return SampleDataset(config.data_config(), [episode(k) for k in range(3)])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "dataset"


@pytest.fixture
def survey_of(locations: Locations) -> Callable[[Path], CheckResults]:
    return lambda path: look(path, locations)


@pytest.fixture
def found(survey_of: Any) -> Callable[[Path], list[tuple[str, str, str]]]:
    """Return code, episode and file of every problem."""
    return lambda path: [(p.code, p.episode, p.file) for p in survey_of(path).problems]
