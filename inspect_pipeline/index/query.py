"""Safe SQL over the index: one reading statement, run in a child process that is limited and killed in time.

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
from inspect_pipeline.resources import MIGRATIONS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.errors import InspectError

_PRINTED_ROWS = 1000
Format = Literal["table", "csv", "json", "parquet"]


@dataclass(frozen=True, slots=True)
class QueryLimits:
    """What a query may use; `max_rows` limits tables: by default 1,000 rows, in a file none."""

    timeout_s: float = 60.0
    memory_bytes: int = 512 << 20
    max_rows: int | None = None


def run_query(
    index_path: Path,
    sql: str,
    *,
    format: Format = "table",  # noqa: A002
    output: Path | None = None,
    limits: QueryLimits = QueryLimits(),
    allow_files: bool = False,
) -> None:
    """Run one statement on the index and write its rows to the file `output`, whole or not at all, or stdout.

    Raises QueryError when the statement is refused, fails or hits a limit; StoreError and
    StoreVersionError when there is no index, or none that can be read.
    """
    if not index_path.exists():
        raise StoreError(index_path.parent, "there is no index", "run lsnet-pipe process first")
    if format == "parquet" and output is None and sys.stdout.isatty():
        raise QueryError("Parquet is not text to print; write it to a file")
    job = {
        "index_path": str(index_path),
        "sql": sql,
        "format": format,
        "allow_files": allow_files,
        "memory_bytes": limits.memory_bytes,
        "cpu_s": int(2 * limits.timeout_s) + 2,
        "max_rows": limits.max_rows or (_PRINTED_ROWS if output is None else None),
        "width": shutil.get_terminal_size().columns if output is None and sys.stdout.isatty() else None,
        "version": len(MIGRATIONS),
        "copy_path": "/dev/stdout",
    }
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
        _run_child(job, limits.timeout_s, sys.stdout.buffer)


@contextmanager
def _appearing(output: Path) -> Iterator[Path]:
    """A name to write to, which becomes `output` at the end of the block; raises QueryError."""
    try:
        with appearing(output) as path:
            yield path
            fsync_path(path)
    except OSError as error:
        raise QueryError(f"{output}: {error.strerror}; name another file") from error


def _write_file(job: dict[str, Any], timeout_s: float, path: Path) -> None:
    copy_path = {"copy_path": str(path)} if job["format"] == "parquet" else {}
    with path.open("wb") as file:
        _run_child({**job, **copy_path}, timeout_s, file)


def _run_child(job: dict[str, Any], timeout_s: float, sink: IO[bytes]) -> None:
    """Give the job to a child, copy what it prints to `sink`, and kill it when its time is up."""
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
    """The error of a child that failed."""
    try:
        error = json.loads(message)
    except ValueError:
        return QueryError(f"the query ran out of memory or time (child ended with {returncode}); narrow it")
    if error["kind"] == "version":
        return StoreVersionError(index_path, error["message"], "upgrade lsnet-pipe")
    if error["kind"] == "store":
        return StoreError(index_path, error["message"], "run lsnet-pipe index rebuild")
    return QueryError(error["message"])
