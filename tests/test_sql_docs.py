"""docs/sql.md: every statement runs, every table, view and column is named with its type."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import duckdb
import flights
import pytest

from inspect_pipeline import index
from inspect_pipeline.query import run_query
from inspect_pipeline.store import Store

TEXT = (Path(__file__).parents[1] / "docs" / "sql.md").read_text()
STATEMENTS = re.findall(r"```sql\n(.*?)```", TEXT, re.DOTALL)
SECTIONS = dict(re.findall(r"^### (\w+)\n(.*?)(?=^##)", TEXT, re.DOTALL | re.MULTILINE))


@pytest.fixture(scope="module")
def index_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An index in which every documented statement finds something."""
    store = Store(tmp_path_factory.mktemp("store"))
    flight_id = flights.flight_id_of("documented")
    with store.write_flight(flight_id) as staging:
        with flights.FlightWriter(staging.path, flight_id) as writer:
            for i in range(60):
                found = flights.detections(0 if 20 <= i < 40 else 2)
                writer.add_frame(flights.frame(i), found, infer_ms=3.0, sharpness=1.0 if i == 7 else 9.0)
            writer.add_frame(flights.frame(60, "corrupt JPEG"), None)
            totals = writer.finish()
        staging.commit(flights.record("documented", totals))
    index.publish(store)
    return store.index_path


@pytest.mark.parametrize("sql", STATEMENTS)
def test_documented_statements_find_something(index_path: Path, tmp_path: Path, sql: str) -> None:
    run_query(index_path, sql, format="json", output=tmp_path / "rows.json")
    assert json.loads((tmp_path / "rows.json").read_text())


def test_every_column_is_documented(index_path: Path) -> None:
    with duckdb.connect(index_path, read_only=True) as connection:
        columns = connection.execute(
            "SELECT table_name, column_name, data_type, table_name IN (SELECT view_name FROM duckdb_views())"
            " FROM duckdb_columns() WHERE NOT internal"
        ).fetchall()
    assert {table for table, *_ in columns} == set(SECTIONS)
    for table, name, kind, is_view in columns:
        lines = [line for line in SECTIONS[table].splitlines() if f"`{name}`" in line]
        assert lines, f"{table}.{name}"
        assert is_view or kind in lines[0], f"{table}.{name} is a {kind}"


@pytest.mark.parametrize("damage", ["deleted", "corrupt", "cut"])
def test_a_remade_index_gives_the_documented_answers(index_path: Path, tmp_path: Path, damage: str) -> None:
    store = Store(shutil.copytree(index_path.parent, tmp_path / "store"))
    before, whole = answers(store), store.index_path.read_bytes()
    store.index_path.unlink()
    if damage == "corrupt":
        store.index_path.write_bytes(b"\xff" * len(whole))
    if damage == "cut":
        store.index_path.write_bytes(whole[: len(whole) // 2])
    index.publish(store)
    assert answers(store) == before


def answers(store: Store) -> list[list[tuple[Any, ...]]]:
    """Of all documented statements; where they leave the order open, it is ours."""
    with duckdb.connect(store.index_path, read_only=True) as connection:
        return [sorted(connection.execute(sql).fetchall(), key=repr) for sql in STATEMENTS]
