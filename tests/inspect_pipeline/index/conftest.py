"""A store that is published once, copied for tests that change it."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import duckdb
import flights
import pytest
from inline_queries import answer_here

from inspect_pipeline.index.query import run_query
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture(scope="session")
def template(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A published store of the flights a (3 frames) and b (4 frames), which no test changes."""
    return flights.published_store(tmp_path_factory.mktemp("template"), a=3, b=4)


@pytest.fixture
def store(tmp_path: Path, template: Store) -> Store:
    """A copy of the template."""
    return Store(shutil.copytree(template.root, tmp_path / "inspections"))


@pytest.fixture(scope="module")
def published(template: Store) -> Iterator[Store]:
    """The template with its index open, so that each question need not wait for that."""
    with duckdb.connect(template.index_path, read_only=True):
        yield template


@pytest.fixture(scope="session")
def queried(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A published store of one flight of four frames, which no test changes."""
    return flights.published_store(tmp_path_factory.mktemp("store"), a=4)


@pytest.fixture
def ask(ask_child: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The same as `ask_child` in this process."""
    answer_here(monkeypatch)
    return ask_child


@pytest.fixture
def ask_child(queried: Store, tmp_path: Path) -> Any:
    """Runs a statement and returns what was written."""

    def run(sql: str, form: str = "json", **options: Any) -> str:
        output = tmp_path / "rows"
        run_query(queried.index_path, sql, format=form, output=output, **options)
        assert [path.name for path in tmp_path.iterdir()] == ["rows"]
        return output.read_text()

    return run
