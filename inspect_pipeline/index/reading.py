"""Read the index by this program's own statements; users' SQL goes to query.py."""

from __future__ import annotations

from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any

import duckdb

from inspect_pipeline.errors import StoreError, StoreVersionError
from inspect_pipeline.index.schema import (
    CONFIG,
    DATABASE_ERRORS,
    REBUILD,
    count_migrations,
    has_views,
    index_error,
)
from inspect_pipeline.resources import MIGRATIONS, read_schema

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import pyarrow as pa

    from inspect_pipeline.store.store import Store

_BATCH_ROWS = 10_000


class IndexReader:
    """An open index. Statements raise the errors of DuckDB, which `open_index` turns into StoreError."""

    def __init__(self, connection: duckdb.DuckDBPyConnection) -> None:
        self.connection = connection
        self._readers: list[pa.RecordBatchReader] = []

    def select(self, sql: str, values: Sequence[Any] | dict[str, Any] = ()) -> list[dict[str, Any]]:
        """Return rows as dicts."""
        cursor = self.connection.execute(sql, values if isinstance(values, dict) else list(values))
        names = [column[0] for column in cursor.description or ()]
        return [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]

    def read_export(self, name: str, flight_ids: Sequence[str]) -> pa.RecordBatchReader:
        """Read the rows of schemas/exports/`name`.sql for some flights in batches, until `close`."""
        sql = read_schema(f"exports/{name}.sql")
        cursor = self.connection.cursor()  # of its own, so that several can be read at a time
        reader = cursor.sql(sql, params={"flight_ids": list(flight_ids)}).to_arrow_reader(_BATCH_ROWS)
        self._readers.append(reader)
        return reader

    def iter_rows(self, name: str, flight_id: str) -> Iterator[dict[str, Any]]:
        """Iterate over the rows of schemas/exports/`name`.sql for one flight as dicts."""
        for batch in self.read_export(name, [flight_id]):
            yield from batch.to_pylist()

    def close(self) -> None:
        """End what is being read.

        DuckDB waits for ever, with Python's lock, to open an index again while a reader of it is open, as in
        the traceback of an error that somebody keeps.
        """
        for reader in self._readers:
            reader.close()


@contextmanager
def open_index(store: Store) -> Iterator[IndexReader]:
    """Open the index of a store for reading.

    Raises StoreError when there is none, or it cannot be read, also while it is open.
    """
    path = store.index_path
    if not path.exists():
        raise StoreError(store.root, "there is no index", "run lsnet-pipe process first")
    try:
        with duckdb.connect(path, read_only=True, config=CONFIG) as connection:
            if count_migrations(connection) != len(MIGRATIONS) or not has_views(connection):
                raise StoreVersionError(path, "the index is of another version", REBUILD)
            with closing(IndexReader(connection)) as reader:
                yield reader
    except DATABASE_ERRORS as error:
        raise index_error(path, error) from error


def select(store: Store, sql: str, values: Sequence[Any] | dict[str, Any] = ()) -> list[dict[str, Any]]:
    """Return the rows of a statement as dicts.

    Raises StoreError when there is no index, or it cannot be read.
    """
    with open_index(store) as index:
        return index.select(sql, values)
