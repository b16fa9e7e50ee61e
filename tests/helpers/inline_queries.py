"""Queries in this process, for tests of what they say: the start of their own takes longer than the answer.

How the child process is limited, refuses and fails is tested with the real one, in test_query.py.
"""

from __future__ import annotations

import io
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

from inspect_pipeline.errors import QueryError
from inspect_pipeline.index import query, query_child

if TYPE_CHECKING:
    import pytest


def answer_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of starting the child; a statement that fails raises what DuckDB raises."""
    monkeypatch.setattr(query, "_run_child", _run)
    monkeypatch.setattr(query_child, "fail", _fail)


def _run(job: dict[str, Any], _timeout_s: float, sink: IO[bytes]) -> None:
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()) as printed:
        written = Path(folder) / "rows"
        if job["format"] in ("csv", "parquet"):
            job = {**job, "copy_path": str(written)}
        query_child.check_statement(job["sql"])
        with query_child.open_index(job) as connection:
            query_child.run_statement(connection, job)
        sink.write(written.read_bytes() if written.exists() else printed.getvalue().encode())
        sink.flush()


def _fail(_kind: str, message: str) -> NoReturn:
    raise QueryError(message)
