"""Safe SQL over the index: one reading statement, run in a child process with limits and a timeout.

The child (query_child.py) opens the index read-only with file access off and refuses everything but one
SELECT. SQL is code all the same, and so is a database file: open only indexes that you made.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import threading
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal

from inspect_pipeline.atomic import appearing, fsync_path
from inspect_pipeline.errors import QueryError, QueryTimeoutError, StoreError, StoreVersionError
from inspect_pipeline.index.schema import BUSY, REBUILD
from inspect_pipeline.resources import MIGRATIONS
from inspect_pipeline.store.store import as_store

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pandas as pd
    import pyarrow as pa

    from inspect_pipeline.errors import InspectError
    from inspect_pipeline.store.store import Store

Format = Literal["table", "csv", "json", "parquet"]

_PRINTED_ROWS = 1000


@dataclass(frozen=True, slots=True)
class QueryLimits:
    """What a query may use; `max_rows` limits tables: by default 1,000 rows on a terminal."""

    timeout_s: float = 60.0
    memory_bytes: int = 512 << 20
    max_rows: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class QueryResult:
    """The rows of a query: columns in their order, all rows."""

    _table: pa.Table

    @property
    def columns(self) -> list[str]:
        """The names of the columns."""
        return list(self._table.column_names)

    def arrow(self) -> pa.Table:
        """Return the rows as a pyarrow Table."""
        return self._table

    def df(self) -> pd.DataFrame:
        """Return the rows as a pandas DataFrame; raises QueryError where pandas is not installed."""
        try:
            import pandas  # noqa: F401, PLC0415 - pyarrow needs it, the rest does not
        except ImportError as error:
            raise QueryError("pandas is not installed; pip install pandas") from error
        return self._table.to_pandas()

    def fetchall(self) -> list[tuple[Any, ...]]:
        """Return the rows as tuples of Python values."""
        return list(zip(*(column.to_pylist() for column in self._table.columns), strict=True))

    def __len__(self) -> int:
        """The number of rows."""
        return int(self._table.num_rows)


def query(
    store: Store | Path | str,
    sql: str,
    *,
    limits: QueryLimits = QueryLimits(),
    allow_files: bool = False,
) -> QueryResult:
    """Run one reading statement on the index of a store and return its rows.

    Args:
        store: The store or its folder.
        sql: One SELECT, WITH, EXPLAIN, DESCRIBE, SHOW or SUMMARIZE.
        limits: Time and memory the statement may use.
        allow_files: Let the statement read files, as read_csv does.

    Raises:
        QueryError: The statement is refused, fails or hits a limit.
        StoreError: There is no index, or it cannot be read.
        StoreVersionError: The index was written by a newer version.
    """
    import pyarrow as pa  # noqa: PLC0415 - the command does without

    job = _job(as_store(store).index_path, sql, "arrow", limits, allow_files=allow_files)
    with tempfile.NamedTemporaryFile() as file:
        _run_child(job, limits.timeout_s, file.file)
        # Mapped, so the system may drop pages of a large result; the file lives as long as the table.
        with pa.memory_map(file.name) as source, pa.ipc.open_stream(source) as reader:
            return QueryResult(reader.read_all())


def run_query(
    index_path: Path,
    sql: str,
    *,
    format: Format = "table",  # noqa: A002
    output: Path | None = None,
    limits: QueryLimits = QueryLimits(),
    allow_files: bool = False,
) -> None:
    """Run one statement and write its rows to stdout or, whole or not at all, to the file `output`.

    A table on stdout has shortened cells; on a terminal it is cut to its width and to `limits.max_rows` rows.
    Raises the errors of `query`, and QueryError for an output that cannot be written.
    """
    if output is None and sys.stdout is None:
        raise QueryError("stdout is closed; write to a file")
    is_terminal = output is None and sys.stdout.isatty()
    if format == "parquet" and is_terminal:
        raise QueryError("Parquet is not text to print; write it to a file")
    job = _job(index_path, sql, format, limits, allow_files=allow_files)
    job["width"] = shutil.get_terminal_size().columns if is_terminal else None
    if output is not None:
        with _appearing(output) as path:
            _write_file(job, limits.timeout_s, path)
    elif format == "parquet":
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "rows.parquet"
            _write_file(job, limits.timeout_s, path)
            with path.open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
    else:
        job["is_shortened"] = True
        job["max_rows"] = limits.max_rows or (_PRINTED_ROWS if is_terminal else None)
        _run_child(job, limits.timeout_s, sys.stdout.buffer)


def _job(
    index_path: Path, sql: str, form: Format | Literal["arrow"], limits: QueryLimits, *, allow_files: bool
) -> dict[str, Any]:
    """Return what the child needs to know; raises StoreError where there is no index."""
    if not index_path.exists():
        raise StoreError(index_path.parent, "there is no index", "run lsnet-pipe process first")
    return {
        "index_path": str(index_path),
        "sql": sql,
        "format": form,
        "allow_files": allow_files,
        "memory_bytes": limits.memory_bytes,
        "cpu_s": int(2 * limits.timeout_s) + 2,
        "is_shortened": False,
        "max_rows": limits.max_rows,
        "version": len(MIGRATIONS),
        "copy_path": "/dev/stdout",
    }


@contextmanager
def _appearing(output: Path) -> Iterator[Path]:
    """Yield a path to write to, which becomes `output` at the end of the block; raises QueryError."""
    try:
        with appearing(output) as path:
            yield path
            fsync_path(path)
    except OSError as error:
        raise QueryError(f"{output}: {error.strerror}; use another file") from error


def _write_file(job: dict[str, Any], timeout_s: float, path: Path) -> None:
    copy_path = {"copy_path": str(path)} if job["format"] == "parquet" else {}
    with path.open("wb") as file:
        _run_child({**job, **copy_path}, timeout_s, file)


def _run_child(job: dict[str, Any], timeout_s: float, sink: IO[bytes]) -> None:
    """Give the job to a child, copy its stdout to `sink`, and kill it at the timeout."""
    command = [sys.executable, "-P", str(Path(__file__).with_name("query_child.py"))]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe) as child:
        timer = threading.Timer(timeout_s, child.kill)
        timer.start()
        try:
            message = _converse(child, job, sink)
        finally:
            is_late = not timer.is_alive()
            timer.cancel()
            child.kill()
    if is_late and child.returncode != 0:
        raise QueryTimeoutError(timeout_s)
    if child.returncode != 0:
        raise _explain(Path(job["index_path"]), child.returncode, message)


def _converse(child: subprocess.Popen[bytes], job: dict[str, Any], sink: IO[bytes]) -> bytes:
    """Send the job, copy stdout to `sink` until its end, and return stderr."""
    if child.stdin is None or child.stdout is None or child.stderr is None:
        raise ValueError("the child needs three pipes")
    with suppress(BrokenPipeError), child.stdin:  # a child that died at once says why on stderr
        child.stdin.write(json.dumps(job).encode())
    shutil.copyfileobj(child.stdout, sink)
    sink.flush()
    message = child.stderr.read()
    child.wait()
    return message


def _explain(index_path: Path, returncode: int, message: bytes) -> InspectError:
    """Return the error of a child that failed."""
    try:
        error = json.loads(message)
    except ValueError:
        return QueryError(f"the query ran out of memory or time (child ended with {returncode}); narrow it")
    if error["kind"] == "version":
        return StoreVersionError(index_path, error["message"], "upgrade lsnet-pipe")
    if error["kind"] == "busy":
        return StoreError(index_path, *BUSY)
    if error["kind"] == "store":
        return StoreError(index_path, error["message"], REBUILD)
    return QueryError(error["message"])
