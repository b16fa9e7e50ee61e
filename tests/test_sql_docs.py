"""docs/sql.md: every question has the answer shown; every table, view and column is named with its type."""

from __future__ import annotations

import re
import shutil
from typing import TYPE_CHECKING, Any

import documented
import duckdb
import pytest

from inspect_pipeline.index import publish as index
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TEXT = documented.DOCUMENT.read_text(encoding="utf-8")
QUESTIONS = documented.QUESTION.findall(TEXT)
SECTIONS = dict(re.findall(r"^### (\w+)\n(.*?)(?=^##)", TEXT, re.DOTALL | re.MULTILINE))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Store]:
    """Its index stays open, so that each question need not wait for that."""
    store = documented.make_store(tmp_path_factory.mktemp("store"))
    with duckdb.connect(store.index_path, read_only=True):
        yield store


@pytest.mark.parametrize(("sql", "shown"), QUESTIONS)
def test_documented_questions_have_the_answers_shown(store: Store, sql: str, shown: str) -> None:
    assert documented.answer(store, sql) == shown
    assert "(0 rows)" not in shown


def test_there_are_twenty_questions() -> None:
    assert len(QUESTIONS) >= 20
    assert len(QUESTIONS) == TEXT.count("```sql")


def test_every_column_is_documented(store: Store) -> None:
    with duckdb.connect(store.index_path, read_only=True) as connection:
        columns = connection.execute(
            "SELECT table_name, column_name, data_type, table_name IN (SELECT view_name FROM duckdb_views())"
            " FROM duckdb_columns() WHERE NOT internal"
        ).fetchall()
    assert {table for table, *_ in columns} == set(SECTIONS)
    for table, name, kind, is_view in columns:
        lines = [line for line in SECTIONS[table].splitlines() if f"`{name}`" in line]
        assert lines, f"{table}.{name}"
        assert is_view or kind in lines[0], f"{table}.{name} is a {kind}"


def test_a_remade_index_gives_the_documented_answers(store: Store, tmp_path: Path) -> None:
    store = Store(shutil.copytree(store.root, tmp_path / "store"))
    before = answers(store)
    store.index_path.write_bytes(b"\xff" * store.index_path.stat().st_size)
    index.publish(store)
    assert answers(store) == before


def answers(store: Store) -> list[list[tuple[Any, ...]]]:
    """Of all documented statements; where they leave the order open, it is ours."""
    with duckdb.connect(store.index_path, read_only=True) as connection:
        return [sorted(connection.execute(sql).fetchall(), key=repr) for sql, _ in QUESTIONS]
