"""A store that is published once, copied for tests that change it."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import duckdb
import flights
import pytest

from inspect_pipeline.index import publish as index
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture(scope="session")
def template(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A published store of the flights a (3 frames) and b (4 frames), which no test changes."""
    store = Store(tmp_path_factory.mktemp("template"))
    flights.write_flight(store, "a", 3)
    flights.write_flight(store, "b", 4)
    index.publish(store)
    return store


@pytest.fixture
def store(tmp_path: Path, template: Store) -> Store:
    """A copy of the template."""
    return Store(shutil.copytree(template.root, tmp_path / "inspections"))


@pytest.fixture(scope="module")
def published(template: Store) -> Iterator[Store]:
    """The template with its index open, so that each question need not wait for that."""
    with duckdb.connect(template.index_path, read_only=True):
        yield template
