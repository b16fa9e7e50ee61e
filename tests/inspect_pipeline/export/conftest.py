"""A published store of three flights with spans, anomalies and reviews, which these tests only read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import documented
import pytest

from inspect_pipeline.publishing import publish

if TYPE_CHECKING:
    from inspect_pipeline.store.store import Store


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = documented.make_store(tmp_path_factory.mktemp("exported"))
    publish(store)
    return store
