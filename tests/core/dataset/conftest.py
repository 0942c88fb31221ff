from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from tests.core.dataset.making import write_dataset


@pytest.fixture
def build(tmp_path) -> Callable[..., Path]:
    """Write a dataset of given episodes, three by default."""
    return partial(write_dataset, tmp_path / "dataset")


@pytest.fixture
def dataset(build) -> Path:
    return build()
