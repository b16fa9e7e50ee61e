"""Stores of older versions are brought up to this one without loss; those of newer versions are refused."""

from __future__ import annotations

import hashlib
import re
import tarfile
from pathlib import Path
from typing import Any

import duckdb
import pytest
from flights import versions, versions_in_index
from stores import contents

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.flight_tables import ROW_TABLES
from inspect_pipeline.index.schema import create_tables
from inspect_pipeline.index.verify import verify
from inspect_pipeline.resources import MIGRATIONS, read_schema
from inspect_pipeline.store.records import RESULT_VERSION
from inspect_pipeline.store.store import Store

# Stores of two flights, written when there were one and three migrations; the second one with user input.
OLD_STORES = [Path(__file__).parents[2] / "data" / f"store_{number}.tar.xz" for number in ("0001", "0003")]
# Tables that a new version does not compute anew.
KEPT = (
    "flights",
    "runs",
    "models",
    "channels",
    "frames",
    "segments",
    "lines",
    "tracks",
    "reviews",
    "flight_tags",
)
FROZEN = {
    "0001_initial.sql": "0ee23018945213101837cf58fd1ff54a7c9f3e02ec4d8c4bc6d5176fb12beb55",
    "0002_runs.sql": "afd24f9c8e64f3b6354f978b03861af96164dd7d3a94304a5cdbd2ef28f4b474",
    "0003_inspection.sql": "e14853becf2b2686d5994ff6f28077bf7ebd768b5a4e127407b4442e449c24d6",
}
RESULT_COLUMNS = (4, "708cab689f736eb79d7dc50f25cb00e8632a03fa4dc1024640f4fe911abd241a")


@pytest.fixture(params=OLD_STORES, ids=lambda path: path.name)
def old_store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    with tarfile.open(request.param) as archive:
        archive.extractall(tmp_path / "store", filter="data")
    return Store(tmp_path / "store")


def rows(store: Store, tables: dict[str, str]) -> dict[str, list[tuple[Any, ...]]]:
    """The given columns of tables."""
    with duckdb.connect(store.index_path, read_only=True) as connection:
        return {
            table: connection.execute(f"SELECT {columns} FROM {table} ORDER BY ALL").fetchall()
            for table, columns in tables.items()
        }


def columns(store: Store) -> dict[str, str]:
    with duckdb.connect(store.index_path, read_only=True) as connection:
        listed = connection.execute(
            "SELECT table_name, string_agg(column_name, ', ' ORDER BY column_index) FROM duckdb_columns()"
            " JOIN duckdb_tables() USING (table_name) WHERE table_name <> 'schema_version' GROUP BY ALL"
        ).fetchall()
    return dict(listed)


def test_released_migrations_never_change() -> None:
    assert list(FROZEN) == list(MIGRATIONS[: len(FROZEN)])
    for name, digest in FROZEN.items():
        statements = re.sub(r"\s*--.*", "", read_schema(name))  # comments may be mended
        assert hashlib.sha256(statements.encode()).hexdigest() == digest, name


def test_other_columns_of_a_flight_are_another_result_version() -> None:
    """A new column is NULL in flights of before; only with another version is the inbox processed again."""
    with duckdb.connect(":memory:") as connection:
        create_tables(connection)
        columns_of_rows = connection.execute(
            "SELECT table_name, column_name, data_type FROM duckdb_columns()"
            " WHERE table_name IN (SELECT unnest(?)) ORDER BY ALL",
            [ROW_TABLES],
        ).fetchall()
    digest = hashlib.sha256(str(columns_of_rows).encode()).hexdigest()
    assert (RESULT_VERSION, digest) == RESULT_COLUMNS


def test_an_old_store_is_brought_up_without_loss(old_store: Store) -> None:
    old_columns = {table: names for table, names in columns(old_store).items() if table in KEPT}
    before = rows(old_store, old_columns)
    assert set(before) >= set(KEPT[:7])
    assert all(before[table] for table in KEPT[:7])
    assert index.publish(old_store).n_written == 0
    assert rows(old_store, old_columns) == before
    with duckdb.connect(old_store.index_path, read_only=True) as connection:
        assert connection.execute("SELECT max(version) FROM schema_version").fetchone() == (len(MIGRATIONS),)
    assert versions(old_store) == versions_in_index(old_store) == {"a": 3, "b": 4}
    assert verify(old_store) == ()


def test_a_brought_up_index_is_the_one_that_a_rebuild_makes(old_store: Store) -> None:
    index.publish(old_store)
    migrated = contents(old_store)
    index.rebuild(old_store)
    assert contents(old_store) == migrated


def test_user_input_of_an_old_store_is_kept(tmp_path: Path) -> None:
    with tarfile.open(OLD_STORES[1]) as archive:
        archive.extractall(tmp_path, filter="data")
    index.publish(Store(tmp_path))
    with duckdb.connect(tmp_path / "index.duckdb", read_only=True) as connection:
        assert connection.execute("SELECT key, value FROM flight_tags").fetchall() == [("line", "L12")]
        reviews = connection.execute("SELECT anomaly_id, verdict, note, reviewed_by FROM reviews").fetchall()
    assert reviews == [("0a1b2c3d4e5f", "dismissed", "a bird", "")]
