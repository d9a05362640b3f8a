"""Rows to Parquet in row groups, so that memory does not grow with the run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.files import replacing

if TYPE_CHECKING:
    import pyarrow as pa

_GROUP = 1 << 13  # rows that are held as Python objects at a time, and a row group of the file


@contextmanager
def writer(path: Path, columns: Mapping[str, str]) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """A function that adds a row to a file under the columns, whose pandas dtypes the file remembers; what a row lacks is missing."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = _schema(columns)
    group: list[Mapping[str, Any]] = []

    def add(row: Mapping[str, Any]) -> None:
        group.append(row)
        if len(group) >= _GROUP:
            flush()

    def flush() -> None:
        arrays = [_array(values, f.type) for f, values in zip(schema, _columns(group, schema.names), strict=True)]
        file.write_batch(pa.RecordBatch.from_arrays(arrays, schema=schema), row_group_size=_GROUP)
        group.clear()

    with replacing(path) as temporary, pq.ParquetWriter(temporary, schema) as file:
        yield add
        flush()


def dtype_of(values: Sequence[Any]) -> str:
    """The pandas dtype of a column with these values, None among them where some rows have none; numbers and strings mixed are strings."""
    kinds = {type(v) for v in values if v is not None}
    if kinds == {bool} and None not in values:
        return "bool"
    if kinds == {int} and None not in values:
        return "int64"
    return "float64" if kinds and kinds <= {int, float} else "string"


def _columns(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[Sequence[Any]]:
    try:
        return list(zip(*map(itemgetter(*names), rows), strict=True)) or [() for _ in names]
    except KeyError:  # rows of different runs
        return [[row.get(name) for row in rows] for name in names]


def _array(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    import pyarrow as pa

    try:
        return pa.array(values, kind, from_pandas=True)
    except pa.ArrowTypeError:
        if not pa.types.is_large_string(kind) and not pa.types.is_string(kind):
            raise
        return pa.array([None if v is None else str(v) for v in values], kind)  # a sweep over numbers and words


def _schema(columns: Mapping[str, str]) -> pa.Schema:
    import pandas as pd
    import pyarrow as pa

    return pa.Schema.from_pandas(pd.DataFrame({name: pd.Series(dtype=dtype) for name, dtype in columns.items()}), preserve_index=False)
