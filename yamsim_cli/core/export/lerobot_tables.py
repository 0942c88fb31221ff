"""The Parquet files of a LeRobot dataset, written episode by episode. The only module that knows pyarrow."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..closing import Closing
from ..errors import ResourceError
from . import lerobot_schema as schema
from .lerobot_schema import Feature, Place

_MEGABYTE = 1_000_000


def require_parquet() -> None:
    """Make sure that Parquet files can be written here.

    Raises:
        ResourceError: pyarrow is not installed.
    """
    try:
        import pyarrow  # noqa: F401
    except ModuleNotFoundError as error:
        if error.name != "pyarrow":
            raise
        raise ResourceError(
            "a LeRobot dataset needs pyarrow, which is not here: pip install 'yamsim[lerobot]'"
        ) from error


class TableSeries(Closing):
    """Writes tables with the same columns to a series of Parquet files. A new file begins when one is large enough.

    Use it as a context manager: leaving it writes the last file's footer.

    Args:
        root: the dataset's directory.
        pattern: the pattern of the files' paths, see `lerobot_schema`.
        limit_mb: size at which a file is closed, MB.
    """

    def __init__(self, root: Path, pattern: str, limit_mb: float) -> None:
        self._root, self._pattern, self._limit = root, pattern, limit_mb * _MEGABYTE
        self._writer: Any = None
        self._place = Place(0)
        self._path = root

    def next_place(self) -> Place:
        """The file that the next table will go into."""
        if self._writer is not None and self._path.stat().st_size >= self._limit:
            self.close()
            self._place = Place(self._place.number + 1)
        return self._place

    def write(self, table: Any) -> None:
        """Add a table."""
        import pyarrow.parquet

        place = self.next_place()
        if self._writer is None:
            self._path = self._root / place.path(self._pattern)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pyarrow.parquet.ParquetWriter(self._path, table.schema, compression="snappy")
        self._writer.write_table(table)

    def close(self) -> None:
        """Write the last file's footer."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def frames_table(columns: Mapping[str, Feature], values: Mapping[str, NDArray[Any]]) -> Any:
    """A table of an episode's frames, from values (frames, ...) by feature."""
    import pyarrow

    arrays = [_array(feature, np.asarray(values[key], feature.dtype)) for key, feature in columns.items()]
    return pyarrow.table(arrays, names=list(columns))


def _array(feature: Feature, values: NDArray[Any]) -> Any:
    import pyarrow

    if feature.shape == (1,):
        return pyarrow.array(values.ravel())
    (width,) = feature.shape
    return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(values.ravel()), width)


def episode_table(row: Mapping[str, Any]) -> Any:
    """A table of one episode's row in `meta/episodes`: numbers, a list of texts, and statistics as arrays."""
    import pyarrow

    plain = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in row.items()}
    return pyarrow.table({key: pyarrow.array([value]) for key, value in plain.items()})


def write_tasks(root: Path, tasks: Sequence[str]) -> None:
    """Write `meta/tasks.parquet`: the tasks' numbers, with the texts as the index that pandas reads."""
    import pyarrow
    import pyarrow.parquet

    def column(name: str, kind: str, numpy_type: str) -> dict[str, Any]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_type, "metadata": None}

    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "pandas_version": "2.0.0",
    }
    table = pyarrow.table({"task_index": pyarrow.array(range(len(tasks)), pyarrow.int64()), "task": list(tasks)})
    table = table.replace_schema_metadata({"pandas": json.dumps(pandas)})
    (root / schema.TASKS).parent.mkdir(parents=True, exist_ok=True)
    pyarrow.parquet.write_table(table, root / schema.TASKS)
